"""A trot that plans its footholds from the stair block.

Everything is planned in the *walking frame*: origin at the base's ground projection, x along the heading, z up with
zero at the ground on which the episode began. The planner is kinematic: feet in stance move backwards with the wanted
velocity, feet in swing fly to footholds clear of the nosings. A policy modulates it (see `GaitAction`); with a zero
action it is the control named "gait". Four feet are too few for arrays to pay: points are lists of three floats.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stair_env.observation import StairBlock
from stair_env.onboard.kinematics import LegKinematics
from stair_env.onboard.step_map import StepMap
from stair_env.robots import RobotSpec

ACTION_SIZE = 16
VELOCITY_SMOOTHING_S = 0.1  # of the measured velocity that feet are placed to catch
REFERENCE_HEIGHT_M = 0.38  # frequencies are those of a robot that stands so high; smaller ones swing faster (Froude)
TROT_OFFSETS = (0.0, 0.5, 0.5, 0.0)  # FR and RL swing together

Point = list[float]  # x, y, z in the walking frame, metres


@dataclass(frozen=True)
class TrotStyle:
    """How the trot is walked.

    Attributes:
        frequency_hz: full cycles per second.
        speed_factor: on the walking speed.
        capture_forward, capture_lateral: how far a foothold moves per unwanted velocity, seconds. Stepping to where
            the trunk is falling catches it.
    """

    frequency_hz: float
    speed_factor: float = 1.0
    capture_forward: float = 0.0
    capture_lateral: float = 0.0


@dataclass(frozen=True)
class GaitConfig:
    """Numbers of the trot, found by trying it without learning (docs/climbing.md).

    Attributes:
        level: style on flat ground and up stairs.
        down: style down stairs: short, quick steps.
        swing_fraction: share of a leg's cycle in the air.
        leg_offsets: where in the cycle each leg is when the first begins its swing, 0..1, canonical leg order.
        flat_speed: on ground without stairs, m/s.
        clearance: of the swing's apex above the highest ground under it, metres.
        unknown_clearance: the same while no stairs have been heard of, metres.
        nosing_margin: footholds keep this far from edges, metres.
        drop_margin: and this far behind an edge that leads down, or the shin rests on the nosing, metres.
        travel, drop_travel: part of the swing in which the foot moves forward; the same where it steps down.
        pitch_follow: share of the local slope that the trunk takes on.
        smoothing_s: time constant of trunk height and pitch.
        turn_gain: yaw rate per heading error, 1/s.
        max_turn_rate: rad/s.
        residual_m, speed_range, clearance_range, frequency_range, pitch_range: what an action of ±1 does.
        residual_smoothing: share of the new action that gets through each control step.
    """

    level: TrotStyle = TrotStyle(frequency_hz=3.1, speed_factor=0.94, capture_forward=0.14, capture_lateral=0.22)
    down: TrotStyle = TrotStyle(frequency_hz=4.0, capture_forward=0.1, capture_lateral=0.2)
    swing_fraction: float = 0.5
    leg_offsets: tuple[float, float, float, float] = TROT_OFFSETS
    flat_speed: float = 0.35
    clearance: float = 0.08
    unknown_clearance: float = 0.12
    nosing_margin: float = 0.06
    drop_margin: float = 0.13
    travel: tuple[float, float] = (0.3, 0.9)
    drop_travel: tuple[float, float] = (0.05, 0.65)
    pitch_follow: float = 0.8
    smoothing_s: float = 0.15
    turn_gain: float = 1.5
    max_turn_rate: float = 0.5
    residual_m: float = 0.06
    speed_range: float = 0.3
    clearance_range: float = 0.04
    frequency_range: float = 0.2
    pitch_range: float = 0.15
    residual_smoothing: float = 0.4


class GaitAction(NamedTuple):
    """The policy's sixteen numbers, scaled.

    Attributes:
        feet: (4, 3) offsets of the feet in the base frame, metres.
        speed: factor on the walking speed.
        clearance: metres added to the swing's apex.
        frequency: factor on the cycle's frequency.
        pitch: radians added to the trunk's pitch, nose down.
    """

    feet: np.ndarray
    speed: float
    clearance: float
    frequency: float
    pitch: float

    @classmethod
    def from_array(cls, action: np.ndarray, config: GaitConfig) -> GaitAction:
        """Scale an action (16,) in [-1, 1]."""
        speed, clearance, frequency, pitch = action[12:].tolist()
        return cls(
            feet=action[:12].reshape(4, 3) * config.residual_m,
            speed=1.0 + config.speed_range * speed,
            clearance=config.clearance_range * clearance,
            frequency=1.0 + config.frequency_range * frequency,
            pitch=config.pitch_range * pitch,
        )


class Gait:
    """Plans joint targets, one control step at a time.

    Args:
        robot: which robot.
        config: numbers of the trot.
    """

    action_size = ACTION_SIZE

    def __init__(self, robot: RobotSpec, config: GaitConfig = GaitConfig()) -> None:
        self.robot = robot
        self.config = config
        self.map = StepMap()
        self._kinematics = LegKinematics(robot)
        self._tempo = math.sqrt(REFERENCE_HEIGHT_M / robot.stand_height)
        self._neutral: list[Point] = [[x, y, 0.0] for x, y, _ in robot.nominal_feet.tolist()]
        self.reset(np.zeros(4))

    def reset(self, foot_heights: np.ndarray, phase: float = 0.0, pitch: float = 0.0) -> None:
        """Start from standing.

        Args:
            foot_heights: (4,) measured heights of the feet relative to the right front foot, metres.
            phase: where in the cycle to begin, 0..1.
            pitch: of the trunk, nose down, radians.
        """
        self.phase = phase
        self.map.reset()
        self._first_block = True
        heights = np.asarray(foot_heights).tolist()
        self._feet = [[x, y, z] for (x, y, _), z in zip(self._neutral, heights)]
        self._swing_start = [point.copy() for point in self._feet]
        self._landing = [point.copy() for point in self._feet]
        self._in_swing = [False] * 4
        self._height = sum(heights) / 4
        self._pitch = pitch
        self._action = np.zeros(ACTION_SIZE)
        self._heading_error = 0.0
        self._cos, self._sin = 1.0, 0.0  # of the heading error
        self._velocity_forward, self._velocity_left = 0.0, 0.0

    @property
    def foothold_heights(self) -> np.ndarray:
        """(4,) planned foothold of each foot relative to their mean, metres."""
        planned = [
            landing[2] if in_swing else foot[2]
            for in_swing, landing, foot in zip(self._in_swing, self._landing, self._feet)
        ]
        mean = sum(planned) / 4
        return np.array([height - mean for height in planned])

    def joint_targets(
        self, action: np.ndarray, block: StairBlock, odometry_velocity: np.ndarray, dt: float
    ) -> np.ndarray:
        """Plan one control step.

        Args:
            action: (16,) in [-1, 1].
            block: stair block of the last observation.
            odometry_velocity: (2,) measured forward and left velocity over the last step, m/s.
            dt: control step, seconds.

        Returns:
            (12,) canonical joint angles, radians.
        """
        smoothing = self.config.residual_smoothing
        self._action = (1 - smoothing) * self._action + smoothing * action
        modulation = GaitAction.from_array(self._action, self.config)
        forward, left = odometry_velocity[:2].tolist()
        share = 1 - math.exp(-dt / VELOCITY_SMOOTHING_S)
        self._velocity_forward += share * (forward - self._velocity_forward)
        self._velocity_left += share * (left - self._velocity_left)
        self._update_map(block, forward, left, dt)
        style = self.config.down if self.map.direction < 0 else self.config.level
        frequency = style.frequency_hz * self._tempo * modulation.frequency
        speed = self._wanted_speed(block, frequency) * style.speed_factor * modulation.speed
        limit = self.config.max_turn_rate
        turn_rate = min(max(self.config.turn_gain * self._heading_error, -limit), limit)
        self._carry_feet_back(speed, turn_rate, dt)
        catch = (
            (self._velocity_forward - speed) * style.capture_forward,
            self._velocity_left * style.capture_lateral,
        )
        self.phase = (self.phase + frequency * dt) % 1.0
        progress = self._swing_progress()
        self._step_feet(progress, frequency, speed, catch, modulation.clearance)
        self._follow_ground(progress, dt)
        return self._kinematics.joint_angles(self._feet_in_base(modulation.pitch) + modulation.feet)

    def _update_map(self, block: StairBlock, forward: float, left: float, dt: float) -> None:
        if block.valid >= 0.5:
            self._heading_error = float(block.heading_error)
        else:
            self._heading_error *= math.exp(-dt / 0.5)
        self._cos, self._sin = math.cos(self._heading_error), math.sin(self._heading_error)
        self.map.advance(self._along_stairs(forward, left) * dt, dt)
        self.map.observe(block, self.robot.hip_x[0] * math.cos(self._pitch) * self._cos)
        if self._first_block and block.valid >= 0.5:
            self._first_block = False
            self._start_on_map()

    def _start_on_map(self) -> None:
        """Reconcile the map with the heights at which the feet were found standing."""
        self.map.assume_on_flight(_mean_of_pair(self._feet[:2], 2) - _mean_of_pair(self._feet[2:], 2))
        for foot, start, landing in zip(self._feet, self._swing_start, self._landing):
            foot[2] = start[2] = landing[2] = self.map.height_at(self._along_stairs(foot[0], foot[1]))
        self._height = sum(foot[2] for foot in self._feet) / 4

    def _along_stairs(self, forward: float, left: float) -> float:
        """Component along the stairs of a vector in the walking frame."""
        return forward * self._cos + left * self._sin

    def _wanted_speed(self, block: StairBlock, frequency: float) -> float:
        """Half a tread per footstep on stairs, so that each tread is used twice."""
        if block.valid >= 0.5 and block.edge_distance < 0.5:
            return min(frequency * float(block.step_width) / 2, 1.2 * self.config.flat_speed)
        return self.config.flat_speed

    def _carry_feet_back(self, speed: float, turn_rate: float, dt: float) -> None:
        """The walking frame moves on; what is fixed to the ground moves back in it."""
        cos, sin = math.cos(turn_rate * dt), math.sin(turn_rate * dt)
        travelled = speed * dt
        for point in (*self._feet, *self._swing_start, *self._landing):
            x, y, _ = point
            x -= travelled
            point[0], point[1] = cos * x + sin * y, cos * y - sin * x

    def _swing_progress(self) -> list[float]:
        """How far each leg is through its swing, 0..1; from 1 on it stands."""
        return [((self.phase + offset) % 1.0) / self.config.swing_fraction for offset in self.config.leg_offsets]

    def _step_feet(
        self,
        swing_progress: list[float],
        frequency: float,
        speed: float,
        catch: tuple[float, float],
        extra_clearance: float,
    ) -> None:
        for leg, progress in enumerate(swing_progress):
            if progress < 1.0:
                if not self._in_swing[leg]:
                    self._lift(leg, frequency, speed, catch)
                self._fly(leg, progress, extra_clearance)
            elif self._in_swing[leg]:
                self._feet[leg] = self._landing[leg].copy()
            self._in_swing[leg] = progress < 1.0

    def _lift(self, leg: int, frequency: float, speed: float, catch: tuple[float, float]) -> None:
        """Choose the foothold: where the hip will be in the middle of the next stance."""
        swing_s = self.config.swing_fraction / frequency
        stance_s = (1 - self.config.swing_fraction) / frequency
        self._swing_start[leg] = self._feet[leg].copy()
        x, y, _ = self._neutral[leg]
        self._landing[leg] = self._clear(x + speed * (swing_s + stance_s / 2) + catch[0], y + catch[1], choosing=True)

    def _clear(self, x: float, y: float, choosing: bool = False) -> Point:
        """Foothold moved clear of the edges, on the ground there."""
        s = self._along_stairs(x, y)
        margin = self.config.nosing_margin
        clear = self.map.clear_of_edges(s, margin, margin, self.config.drop_margin, choosing)
        return [x + clear - s, y, self.map.height_at(clear)]

    def _fly(self, leg: int, progress: float, extra_clearance: float) -> None:
        """Rise, travel, settle; the foothold follows the map until late in the swing.

        Upwards the foot rises before it travels, so that the toe clears the riser; downwards it travels before it
        settles, so that the shin clears the nosing behind it.
        """
        if progress < 0.7:
            self._landing[leg] = self._clear(self._landing[leg][0], self._landing[leg][1])
        start, landing = self._swing_start[leg], self._landing[leg]
        start_s, end_s = self._along_stairs(start[0], start[1]), self._along_stairs(landing[0], landing[1])
        clearance = self.config.clearance if self.map.knows_stairs else self.config.unknown_clearance
        apex = max(start[2], landing[2], self.map.highest_between(start_s, end_s)) + max(
            clearance + extra_clearance, 0.02
        )
        drops = landing[2] < start[2] - 0.02
        begin, end = self.config.drop_travel if drops else self.config.travel
        travel = _smoothstep((progress - begin) / (end - begin))
        ground = start[2] if progress < 0.5 else landing[2]
        self._feet[leg] = [
            start[0] + travel * (landing[0] - start[0]),
            start[1] + travel * (landing[1] - start[1]),
            ground + math.sin(math.pi * progress) ** 2 * (apex - ground),
        ]

    def _follow_ground(self, swing_progress: list[float], dt: float) -> None:
        """Trunk height over the mean foothold and pitch along the local slope, both smoothed."""
        ground = [self._ground_under(leg, progress) for leg, progress in enumerate(swing_progress)]
        share = 1 - math.exp(-dt / self.config.smoothing_s)
        (x_1, _, z_1), (x_2, _, z_2), (x_3, _, z_3), (x_4, _, z_4) = ground
        self._height += share * ((z_1 + z_2 + z_3 + z_4) / 4 - self._height)
        slope = math.atan2((z_1 + z_2) / 2 - (z_3 + z_4) / 2, (x_1 + x_2) / 2 - (x_3 + x_4) / 2)
        self._pitch += share * (-self.config.pitch_follow * slope - self._pitch)

    def _ground_under(self, leg: int, progress: float) -> Point:
        """Foothold of a standing leg; of a swinging one, a point that glides from the last foothold to the next."""
        if not self._in_swing[leg]:
            return self._feet[leg]
        travel = _smoothstep(progress)
        (x, y, z), (to_x, to_y, to_z) = self._swing_start[leg], self._landing[leg]
        return [x + travel * (to_x - x), y + travel * (to_y - y), z + travel * (to_z - z)]

    def _feet_in_base(self, extra_pitch: float) -> np.ndarray:
        """Planned feet (4, 3) in the base frame, metres."""
        pitch = self._pitch + extra_pitch
        cos, sin = math.cos(pitch), math.sin(pitch)
        base = self._height + self.robot.stand_height
        return np.array([[cos * x - sin * (z - base), y, sin * x + cos * (z - base)] for x, y, z in self._feet])


def _mean_of_pair(points: list[Point], axis: int) -> float:
    return (points[0][axis] + points[1][axis]) / 2


def _smoothstep(t: float) -> float:
    t = min(max(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)
