"""Where the stair block comes from. Everything behind it (gait, policy, reward) is the same for all of them.

| name | the block is |
|---|---|
| oracle | the truth |
| noisy | the truth, spoiled like a camera's measurement: for training without rendering |
| blind | empty, always |
| shuffled | true to another staircase |
| external | what `StairClimbEnv.provide_stair` was last given (a perception wrapper) |
"""

from __future__ import annotations

import copy
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from stair_env.common.constants import BLOCK_SOURCES
from stair_env.common.validation import SpecError, check_choice, has_parts
from stair_env.observation import NO_STAIRS, StairBlock
from stair_env.physics.simulation import BaseState
from stair_env.robots import RobotSpec
from stair_env.stairs import StairProfile, StairSpec
from stair_env.task.step_state import Episode

VIEW_RANGE_M = 2.5  # beyond it a head-mounted D435i sees too little of a step to measure it


class HipPose(NamedTuple):
    """Midpoint of the front hips in the stair frame.

    Attributes:
        x: along the walking direction, metres.
        yaw: heading of the base against the walking direction, radians, positive to the left.
        time_s: of the episode.
    """

    x: float
    yaw: float
    time_s: float


def observe_stairs(
    source: StairSource, episode: Episode, base: BaseState, time_s: float
) -> tuple[StairBlock, StairBlock]:
    """Return the true stair block, and what the source makes of it.

    Args:
        source: fills the block.
        episode: supplies stairs and robot.
        base: state of the base.
        time_s: of the episode.
    """
    pose = front_hips(base, episode.robot, time_s)
    truth = true_block(episode.stairs, episode.profile, pose)
    return truth, source.read(pose, truth)


def front_hips(base: BaseState, robot: RobotSpec, time_s: float) -> HipPose:
    """Return where the front hips are.

    Args:
        base: state of the base.
        robot: supplies the hips.
        time_s: of the episode.
    """
    yaw = base.yaw
    reach = robot.hip_x[0] * math.hypot(base.rotation[0, 0], base.rotation[1, 0])
    return HipPose(float(base.position[0]) + reach * math.cos(yaw), yaw, time_s)


def true_block(spec: StairSpec, profile: StairProfile, pose: HipPose) -> StairBlock:
    """The stair block as the simulator knows it; empty when no edge lies within view ahead."""
    edges, levels = profile.plain
    ahead = bisect_right(edges, pose.x)
    if ahead >= len(edges):
        return NO_STAIRS
    distance = edges[ahead] - pose.x
    if distance > VIEW_RANGE_M:
        return NO_STAIRS
    rise = levels[ahead + 1] - levels[ahead]
    return StairBlock(
        valid=1.0,
        direction=math.copysign(1.0, rise),
        step_width=_run_after(spec, edges, ahead),
        step_height=abs(rise),
        edge_distance=distance,
        heading_error=_wrap(-pose.yaw),
        age=0.0,
        confidence=1.0,
    )


def _run_after(spec: StairSpec, edges: Sequence[float], index: int) -> float:
    """Tread depth behind a nosing; at the end of a flight, where the landing follows, that of the step before."""
    last_of_flight = (index + 1) % spec.num_steps == 0
    if last_of_flight and index % spec.num_steps == 0:
        return spec.tread_depth
    first = index - 1 if last_of_flight else index
    return edges[first + 1] - edges[first]


class StairSource(Protocol):
    """Turns the truth into what the robot is told."""

    def reset(self, spec: StairSpec, rng: np.random.Generator) -> None:
        """Begin an episode.

        Args:
            spec: the staircase.
            rng: of this episode, for every random draw.
        """

    def read(self, pose: HipPose, truth: StairBlock) -> StairBlock:
        """Return the block for this control step.

        Args:
            pose: of the front hips.
            truth: the true block there.
        """


class OracleSource:
    """The truth."""

    def reset(self, spec: StairSpec, rng: np.random.Generator) -> None:
        """Begin an episode."""

    def read(self, pose: HipPose, truth: StairBlock) -> StairBlock:
        """Block for this control step."""
        return truth


class BlindSource:
    """Nothing, ever."""

    def reset(self, spec: StairSpec, rng: np.random.Generator) -> None:
        """Begin an episode."""

    def read(self, pose: HipPose, truth: StairBlock) -> StairBlock:
        """Block for this control step."""
        return NO_STAIRS


class ShuffledSource:
    """The truth about another staircase: same direction, other riser and tread, edges out of step with the real ones.

    A policy that climbs as well on this as on the oracle does not use what it sees.
    """

    def reset(self, spec: StairSpec, rng: np.random.Generator) -> None:
        """Draw the other staircase."""
        other = StairSpec(
            direction=spec.direction,
            riser_height=_elsewhere(rng, spec.riser_height, 0.06, 0.18, 0.03),
            tread_depth=_elsewhere(rng, spec.tread_depth, 0.24, 0.38, 0.04),
            num_steps=spec.num_steps,
            landing_depth=spec.landing_depth,
        )
        self._spec, self._profile = other, other.profile()
        self._shift = float(rng.uniform(-0.5, 0.5)) * other.tread_depth

    def read(self, pose: HipPose, truth: StairBlock) -> StairBlock:
        """Block for this control step."""
        return true_block(self._spec, self._profile, pose._replace(x=pose.x + self._shift))


def _elsewhere(rng: np.random.Generator, value: float, low: float, high: float, gap: float) -> float:
    """Uniform draw from [low, high] at least `gap` away from `value`."""
    while True:
        drawn = float(rng.uniform(low, high))
        if abs(drawn - value) >= gap:
            return drawn


@dataclass(frozen=True)
class PerceptionErrorModel:
    """Errors of the tracked measurement, fitted to StairNetV2 0.25x on a trotting AlienGo (docs/climbing.md).

    Sixteen flights up and down, day and night, gave biases of 1 mm in width and height and 6 mm in distance, and a
    jitter of 8 mm in distance up and 21 mm down, which lasts 0.3 s; 1 % of the blocks were missing and no direction
    was wrong. Sizes are given three times those biases and a block is lost more often: a camera off its calibration.

    Attributes:
        width_bias, height_bias, distance_bias: standard deviation of what stays for an episode, metres.
        width_jitter, height_jitter, distance_jitter: standard deviation of what changes with each frame, metres.
        heading_jitter: radians.
        persistence: share of the jitter that survives into the next frame.
        frame_interval_s: time between measurements.
        dropout: chance that a frame yields nothing.
        blackout: chance per second that the block is lost for blackout_s.
        blackout_s: seconds.
        wrong_direction: chance per second that up is taken for down for one frame.
    """

    width_bias: float = 0.004
    height_bias: float = 0.003
    distance_bias: float = 0.008
    width_jitter: float = 0.001
    height_jitter: float = 0.001
    distance_jitter: float = 0.016
    heading_jitter: float = 0.005
    persistence: float = 0.8
    frame_interval_s: float = 1 / 15
    dropout: float = 0.1
    blackout: float = 0.05
    blackout_s: float = 0.4
    wrong_direction: float = 0.002


class NoisySource:
    """The truth with a perception's errors, so that a policy can be trained for the camera without rendering."""

    def __init__(self, errors: PerceptionErrorModel = PerceptionErrorModel()) -> None:
        self._errors = errors

    def reset(self, spec: StairSpec, rng: np.random.Generator) -> None:
        """Begin an episode and draw its constant errors."""
        self._rng = rng
        errors = self._errors
        scale = np.array([errors.width_bias, errors.height_bias, errors.distance_bias])
        self._bias = rng.normal(size=3) * scale
        self._jitter = np.zeros(4)
        self._flipped = False
        self._measured_at = -math.inf
        self._dark_until = -math.inf

    def read(self, pose: HipPose, truth: StairBlock) -> StairBlock:
        """Block for this control step; between frames the last errors persist, as a tracker's do."""
        errors, rng = self._errors, self._rng
        if pose.time_s - self._measured_at >= errors.frame_interval_s and rng.random() >= errors.dropout:
            self._measured_at = pose.time_s
            scale = [errors.width_jitter, errors.height_jitter, errors.distance_jitter, errors.heading_jitter]
            kept = errors.persistence
            self._jitter = kept * self._jitter + math.sqrt(1.0 - kept**2) * rng.normal(size=4) * scale
            self._flipped = rng.random() < errors.wrong_direction * errors.frame_interval_s
            if rng.random() < errors.blackout * errors.frame_interval_s:
                self._dark_until = pose.time_s + errors.blackout_s
        if truth.valid < 0.5 or pose.time_s < self._dark_until:
            return NO_STAIRS
        return StairBlock(
            valid=1.0,
            direction=-truth.direction if self._flipped else truth.direction,
            step_width=max(truth.step_width + self._bias[0] + self._jitter[0], 0.1),
            step_height=max(truth.step_height + self._bias[1] + self._jitter[1], 0.01),
            edge_distance=truth.edge_distance + self._bias[2] + self._jitter[2],
            heading_error=truth.heading_error + self._jitter[3],
            age=max(pose.time_s - self._measured_at, 0.0) if math.isfinite(self._measured_at) else 0.0,
            confidence=float(rng.uniform(0.6, 1.0)),
        )


class ExternalSource:
    """Hands out the block it was last given."""

    def reset(self, spec: StairSpec, rng: np.random.Generator) -> None:
        """Forget the last episode's block."""
        self._block = NO_STAIRS

    def provide(self, block: StairBlock) -> None:
        """Set the block for the next control step."""
        self._block = block

    def read(self, pose: HipPose, truth: StairBlock) -> StairBlock:
        """Block for this control step."""
        return self._block


_SOURCE_CLASSES: dict[str, type] = {
    "oracle": OracleSource,
    "noisy": NoisySource,
    "blind": BlindSource,
    "shuffled": ShuffledSource,
    "external": ExternalSource,
}


def make_source(source: str | StairSource) -> StairSource:
    """Build a source.

    Args:
        source: a name in BLOCK_SOURCES, or an object with `reset` and `read`, of which a copy is made: environments of
            one process never share it.

    Raises:
        SpecError: it is neither; the message names the choices.
    """
    if isinstance(source, str):
        check_choice("stair_source", source, BLOCK_SOURCES)
        named: StairSource = _SOURCE_CLASSES[source]()
        return named
    if not has_parts(source, ("reset", "read")):
        choices = ", ".join(map(repr, BLOCK_SOURCES))
        raise SpecError(f"stair_source={source!r} must be one of {choices}, or an object with reset and read")
    return copy.deepcopy(source)


def _wrap(angle: float) -> float:
    """Angle in (-pi, pi]."""
    return math.atan2(math.sin(angle), math.cos(angle))
