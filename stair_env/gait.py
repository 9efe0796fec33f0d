"""A trot that plans its footholds from the stair block.

Everything is planned in the *walking frame*: origin at the base's ground projection, x along the heading, z up with
zero at the ground on which the episode began. The planner is kinematic: feet in stance move backwards with the wanted
velocity, feet in swing fly to footholds clear of the nosings. A policy modulates it (see `GaitAction`); with a zero
action it is the control named "gait".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stair_env.kinematics import LegKinematics
from stair_env.observation import StairBlock
from stair_env.robots import RobotSpec
from stair_env.step_map import StepMap

ACTION_SIZE = 16
REFERENCE_HEIGHT_M = 0.38  # frequencies are those of a robot that stands so high; smaller ones swing faster (Froude)
TROT_OFFSETS = np.array([0.0, 0.5, 0.5, 0.0])  # FR and RL swing together


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

    level: TrotStyle = TrotStyle(frequency_hz=2.4, capture_forward=0.05, capture_lateral=0.15)
    down: TrotStyle = TrotStyle(frequency_hz=4.0, capture_forward=0.1, capture_lateral=0.2)
    swing_fraction: float = 0.5
    flat_speed: float = 0.35
    clearance: float = 0.06
    unknown_clearance: float = 0.12
    nosing_margin: float = 0.05
    drop_margin: float = 0.13
    travel: tuple[float, float] = (0.15, 0.9)
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


@dataclass(frozen=True)
class GaitAction:
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
        return cls(
            feet=action[:12].reshape(4, 3) * config.residual_m,
            speed=1.0 + config.speed_range * float(action[12]),
            clearance=config.clearance_range * float(action[13]),
            frequency=1.0 + config.frequency_range * float(action[14]),
            pitch=config.pitch_range * float(action[15]),
        )


class Gait:
    """Plans joint targets, one control step at a time.

    Args:
        robot: which robot.
        config: numbers of the trot.
    """

    def __init__(self, robot: RobotSpec, config: GaitConfig = GaitConfig()) -> None:
        self.robot = robot
        self.config = config
        self.map = StepMap()
        self._kinematics = LegKinematics(robot)
        self._tempo = math.sqrt(REFERENCE_HEIGHT_M / robot.stand_height)
        self._neutral = robot.nominal_feet
        self._neutral[:, 2] = 0.0
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
        self._feet = self._neutral.copy()  # planned footholds, walking frame
        self._feet[:, 2] = foot_heights
        self._swing_start = self._feet.copy()
        self._landing = self._feet.copy()
        self._in_swing = np.zeros(4, bool)
        self._height = float(np.mean(foot_heights))
        self._pitch = pitch
        self._action = np.zeros(ACTION_SIZE)
        self._heading_error = 0.0
        self._velocity = np.zeros(2)

    @property
    def foothold_heights(self) -> np.ndarray:
        """(4,) planned foothold of each foot relative to their mean, metres."""
        heights = np.where(self._in_swing, self._landing[:, 2], self._feet[:, 2])
        return heights - heights.mean()

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
        self._action = (1 - smoothing) * self._action + smoothing * np.clip(action, -1.0, 1.0)
        modulation = GaitAction.from_array(self._action, self.config)
        self._velocity += (1 - math.exp(-dt / 0.1)) * (odometry_velocity[:2] - self._velocity)
        self._update_map(block, odometry_velocity, dt)
        style = self.config.down if self.map.direction < 0 else self.config.level
        frequency = style.frequency_hz * self._tempo * modulation.frequency
        speed = self._wanted_speed(block, frequency) * style.speed_factor * modulation.speed
        turn_rate = float(
            np.clip(self.config.turn_gain * self._heading_error, -self.config.max_turn_rate, self.config.max_turn_rate)
        )
        self._carry_feet_back(speed, turn_rate, dt)
        unwanted = self._velocity - [speed, 0.0]
        catch = unwanted * [style.capture_forward, style.capture_lateral]
        self._step_feet(frequency, speed, catch, modulation.clearance, dt)
        self._follow_ground(dt)
        return self._kinematics.joint_angles(self._feet_in_base(modulation.pitch) + modulation.feet)

    def _update_map(self, block: StairBlock, odometry_velocity: np.ndarray, dt: float) -> None:
        if block.valid >= 0.5:
            self._heading_error = block.heading_error
        else:
            self._heading_error *= math.exp(-dt / 0.5)
        along = np.array([math.cos(self._heading_error), math.sin(self._heading_error)])
        self.map.advance(float(odometry_velocity[:2] @ along) * dt, dt)
        self.map.observe(block, self.robot.hip_x[0] * along[0])
        if self._first_block and block.valid >= 0.5:
            self._first_block = False
            self._start_on_map()

    def _start_on_map(self) -> None:
        """Reconcile the map with the heights at which the feet were found standing."""
        front, rear = self._feet[:2, 2].mean(), self._feet[2:, 2].mean()
        self.map.assume_on_flight(front - rear)
        self._feet[:, 2] = self.map.heights_at(self._along_stairs(self._feet))
        self._swing_start[:, 2] = self._landing[:, 2] = self._feet[:, 2]
        self._height = float(self._feet[:, 2].mean())

    def _along_stairs(self, points: np.ndarray) -> np.ndarray:
        """Position along the stairs of points (n, 2+) in the walking frame, (n,) metres."""
        return points[:, 0] * math.cos(self._heading_error) + points[:, 1] * math.sin(self._heading_error)

    def _wanted_speed(self, block: StairBlock, frequency: float) -> float:
        """Half a tread per footstep on stairs, so that each tread is used twice."""
        if block.valid >= 0.5 and block.edge_distance < 0.5:
            return min(frequency * block.step_width / 2, 1.2 * self.config.flat_speed)
        return self.config.flat_speed

    def _carry_feet_back(self, speed: float, turn_rate: float, dt: float) -> None:
        """The walking frame moves on; what is fixed to the ground moves back in it."""
        cos, sin = math.cos(turn_rate * dt), math.sin(turn_rate * dt)
        rotation = np.array([[cos, sin], [-sin, cos]])
        for points in (self._feet, self._swing_start, self._landing):
            points[:, 0] -= speed * dt
            points[:, :2] = points[:, :2] @ rotation.T

    def _step_feet(
        self, frequency: float, speed: float, catch: np.ndarray, extra_clearance: float, dt: float
    ) -> None:
        self.phase = (self.phase + frequency * dt) % 1.0
        leg_phase = (self.phase + TROT_OFFSETS) % 1.0
        progress = leg_phase / self.config.swing_fraction
        swings = progress < 1.0
        for leg in range(4):
            if swings[leg]:
                if not self._in_swing[leg]:
                    self._lift(leg, frequency, speed, catch)
                self._fly(leg, float(progress[leg]), extra_clearance)
            elif self._in_swing[leg]:
                self._feet[leg] = self._landing[leg]
        self._in_swing = swings

    def _lift(self, leg: int, frequency: float, speed: float, catch: np.ndarray) -> None:
        """Choose the foothold: where the hip will be in the middle of the next stance."""
        swing_s = self.config.swing_fraction / frequency
        stance_s = (1 - self.config.swing_fraction) / frequency
        self._swing_start[leg] = self._feet[leg]
        landing = self._neutral[leg].copy()
        landing[0] += speed * (swing_s + stance_s / 2)
        landing[:2] += catch
        self._landing[leg] = self._clear(landing, choosing=True)

    def _clear(self, landing: np.ndarray, choosing: bool = False) -> np.ndarray:
        """Foothold (3,) moved clear of the edges, on the ground there."""
        s = float(self._along_stairs(landing[None])[0])
        margin = self.config.nosing_margin
        clear = self.map.clear_of_edges(s, margin, margin, self.config.drop_margin, choosing)
        return np.array([landing[0] + clear - s, landing[1], self.map.heights_at(np.array([clear]))[0]])

    def _fly(self, leg: int, progress: float, extra_clearance: float) -> None:
        """Rise, travel, settle; the foothold follows the map until late in the swing.

        Upwards the foot rises before it travels, so that the toe clears the riser; downwards it travels before it
        settles, so that the shin clears the nosing behind it.
        """
        if progress < 0.7:
            self._landing[leg] = self._clear(self._landing[leg])
        start, landing = self._swing_start[leg], self._landing[leg]
        start_s, end_s = self._along_stairs(np.stack([start, landing]))
        clearance = self.config.clearance if self.map.knows_stairs else self.config.unknown_clearance
        apex = max(start[2], landing[2], self.map.highest_between(start_s, end_s)) + max(
            clearance + extra_clearance, 0.02
        )
        drops = landing[2] < start[2] - 0.02
        begin, end = self.config.drop_travel if drops else self.config.travel
        travel = _smoothstep((progress - begin) / (end - begin))
        self._feet[leg, :2] = start[:2] + travel * (landing[:2] - start[:2])
        if progress < 0.5:
            self._feet[leg, 2] = start[2] + math.sin(math.pi * progress) ** 2 * (apex - start[2])
        else:
            self._feet[leg, 2] = landing[2] + math.sin(math.pi * progress) ** 2 * (apex - landing[2])

    def _follow_ground(self, dt: float) -> None:
        """Trunk height over the mean foothold and pitch along the local slope, both smoothed."""
        travel = np.array([_smoothstep(p) for p in ((self.phase + TROT_OFFSETS) % 1.0) / self.config.swing_fraction])
        blend = np.where(self._in_swing, travel, 0.0)
        ground = self._feet.copy()
        ground[self._in_swing] = (
            self._swing_start + blend[:, None] * (self._landing - self._swing_start)
        )[self._in_swing]
        share = 1 - math.exp(-dt / self.config.smoothing_s)
        self._height += share * (ground[:, 2].mean() - self._height)
        run = ground[:2, 0].mean() - ground[2:, 0].mean()
        slope = math.atan2(ground[:2, 2].mean() - ground[2:, 2].mean(), run)
        self._pitch += share * (-self.config.pitch_follow * slope - self._pitch)

    def _feet_in_base(self, extra_pitch: float) -> np.ndarray:
        """Planned feet (4, 3) in the base frame, metres."""
        pitch = self._pitch + extra_pitch
        cos, sin = math.cos(pitch), math.sin(pitch)
        x, y, z = (self._feet - [0.0, 0.0, self._height + self.robot.stand_height]).T
        return np.stack([cos * x - sin * z, y, sin * x + cos * z], axis=1)


def _smoothstep(t: float) -> float:
    t = min(max(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)
