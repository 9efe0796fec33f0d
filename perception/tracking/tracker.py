"""From single frames to one staircase that a policy can stand on.

The tracker joins late, noisy, sometimes missing or wrong frames with leg odometry, and answers at every control step
with the stair block of the observation. It follows each step by itself, goes on counting while the next edges are out
of view, starts anew when the frames keep disagreeing with it, and says "not valid" when it does not know.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from perception.geometry.results import Nosing, StairEstimate
from perception.tracking.nosing_filter import DEFAULT_TREAD_M, NosingMap
from perception.tracking.pose_history import PlanarOdometry, PlanarPose
from stair_env.common.validation import check_range
from stair_env.observation import NO_STAIRS, StairBlock
from stair_env.onboard.proprioception import base_to_level

MAX_GAP_TREADS = 1.6  # between nosings of one flight, beyond which the far one needs proof
# Going down, no nosing nearer than this to the camera was missed beyond the farthest one measured, on 1500 of them.
DESCENT_CLEAR_M = 1.2
MAX_HIDDEN_EDGES = 2  # between the feet and the first nosing in view of a head camera
# Beyond which no flight goes on: what is there is another one, or a bench at the landing's end.
FLIGHT_ENDS_TREADS = MAX_HIDDEN_EDGES + MAX_GAP_TREADS
FELT_RISE_STD_M = (
    0.003  # of the rise from the soles to the first tread in view: 2.7 mm on 26 starts at the paper's stairs
)
SHARED_RISE_STD_M = 0.01  # of each of several risers that share one: steps of a flight differ


@dataclass(frozen=True)
class TrackerConfig:
    """How the tracker trusts and forgets.

    Args:
        max_age_s: a staircase that no frame has confirmed for so long is forgotten.
        max_range_m: nosings farther from the camera are not believed.
        min_match: least share of a frame's nosings that must fit the map for the frame to count.
        frames_to_reset: consecutive frames that must disagree before the map is thrown away.
        frames_to_trust: frames behind a nosing before confidence is full.
        keep_behind_m: nosings this far behind the base are forgotten.
        heading_std_rad: of one frame, added to what the frame itself states.
        heading_drift: random walk of the gyro's heading, rad / sqrt(s).
        max_heading_rad: stairs seen more from the side than this are not ahead.

    Raises:
        SpecError: a field is out of range (a ValueError).
    """

    max_age_s: float = 3.0
    max_range_m: float = 3.5
    min_match: float = 0.5
    frames_to_reset: int = 4
    frames_to_trust: int = 3
    keep_behind_m: float = 1.0
    heading_std_rad: float = 0.01
    heading_drift: float = 0.01
    max_heading_rad: float = math.radians(80.0)

    def __post_init__(self) -> None:
        check_range("max_age_s", self.max_age_s, 0.1, 5.0)
        check_range("max_range_m", self.max_range_m, 0.5, 10.0)
        check_range("min_match", self.min_match, 0.0, 1.0)
        check_range("frames_to_reset", self.frames_to_reset, 1, 100)
        check_range("frames_to_trust", self.frames_to_trust, 1, 100)
        check_range("keep_behind_m", self.keep_behind_m, 0.1, 10.0)
        check_range("heading_std_rad", self.heading_std_rad, 1e-4, 1.0)
        check_range("heading_drift", self.heading_drift, 0.0, 1.0)
        check_range("max_heading_rad", self.max_heading_rad, 0.1, math.pi / 2)


@dataclass(frozen=True)
class CameraPlacement:
    """Where the camera is in the levelled base frame (x forward, y left) when a frame is taken.

    Attributes:
        forward_m, left_m: of the colour imager.
        heading_rad: of the optical axis, counter-clockwise from the base's forward direction.
        ground_m: height of the ground under the front feet, relative to the imager; None when unknown.
    """

    forward_m: float
    left_m: float
    heading_rad: float
    ground_m: float | None = None


def place_camera(
    camera_to_base: np.ndarray, gravity_camera: np.ndarray, front_soles: np.ndarray | None = None
) -> CameraPlacement:
    """Camera in the levelled base frame, from the mount, gravity and the legs.

    Args:
        camera_to_base: (4, 4) mount.
        gravity_camera: (3,) accelerometer reading at rest in the camera frame, any unit.
        front_soles: (n, 3) where front feet touch the ground, base frame, metres; None or empty when none does.
    """
    up = camera_to_base[:3, :3] @ np.asarray(gravity_camera, dtype=np.float64)
    level = base_to_level(up / np.linalg.norm(up))
    position = level @ camera_to_base[:3, 3]
    axis = level @ camera_to_base[:3, 2]
    ground = None
    if front_soles is not None and len(front_soles):
        ground = float((front_soles @ level[2]).mean() - position[2])
    return CameraPlacement(float(position[0]), float(position[1]), math.atan2(float(axis[1]), float(axis[0])), ground)


class StairTracker:
    """One staircase, followed through time.

    Args:
        hip_forward_m: from the base to the midpoint of the front hips, metres.
        config: see `TrackerConfig`.
    """

    def __init__(self, hip_forward_m: float, config: TrackerConfig = TrackerConfig()) -> None:
        self.config = config
        self._hip_forward_m = hip_forward_m
        self._odometry = PlanarOdometry()
        self._map = NosingMap()
        self._pitch_cos = 1.0
        self.reset(0.0)

    def reset(self, time_s: float = 0.0) -> None:
        """Begin an episode at this time."""
        self._odometry.reset(time_s)
        self._forget()
        self._rejected = 0

    def _forget(self) -> None:
        self._map.clear()
        self._direction = 0
        self._heading, self._heading_variance = 0.0, math.inf
        self._captured_at = -math.inf
        self._frames = 0

    @property
    def nosings(self) -> NosingMap:
        """The map, for inspection."""
        return self._map

    @property
    def direction(self) -> int:
        """+1 ascending, -1 descending, 0 nothing known."""
        return self._direction

    # ------------------------------------------------------------------ input

    def advance(
        self, time_s: float, forward_m_s: float, left_m_s: float, yaw_rate: float, pitch_rad: float = 0.0
    ) -> None:
        """The robot moved.

        Args:
            time_s: now.
            forward_m_s, left_m_s: mean velocity since the last call, level frame of the base, m/s.
            yaw_rate: mean rate of the heading since the last call, rad/s.
            pitch_rad: of the trunk now, either sign; a pitched trunk brings the hips nearer to the base.
        """
        self._pitch_cos = math.cos(pitch_rad)
        before = self._odometry.pose
        pose = self._odometry.advance(time_s, forward_m_s, left_m_s, yaw_rate)
        if pose is before or self._direction == 0:
            return
        self._map.advance(self._along(pose.x - before.x, pose.y - before.y))
        self._heading_variance += self.config.heading_drift**2 * (pose.time_s - before.time_s)
        self._map.forget_behind(self.config.keep_behind_m)
        if len(self._map) == 0 or time_s - self._captured_at > self.config.max_age_s:
            self._forget()

    def _along(self, x: float, y: float) -> float:
        """Component of an odometry-frame vector along the walking direction of the stairs, metres."""
        return math.cos(self._heading) * x + math.sin(self._heading) * y

    def observe(self, estimate: StairEstimate, captured_at_s: float, camera: CameraPlacement) -> bool:
        """Take a frame in.

        Args:
            estimate: of the frame.
            captured_at_s: when it was taken, on the clock of `advance`.
            camera: where the camera was then.

        Returns:
            Whether the frame was believed.
        """
        nosings = tuple(n for n in estimate.nosings if n.distance_m < self.config.max_range_m)
        if not estimate.valid or not nosings:
            return False
        pose = self._odometry.pose_at(captured_at_s)
        heading = pose.heading + camera.heading_rad + estimate.yaw_rad
        starts = self._direction == 0 or self._starts_another_flight(estimate)
        if starts and not _shows_a_flight(nosings):
            return False
        if starts:
            self._forget()
        elif not self._agrees(estimate, heading, pose, camera):
            self._rejected += 1
            if self._rejected < self.config.frames_to_reset or not _shows_a_flight(nosings):
                return False
            self._forget()
        self._rejected = 0
        self._direction = estimate.direction
        self._update_heading(heading, math.hypot(estimate.yaw_std_rad, self.config.heading_std_rad))
        fresh = len(self._map) == 0
        clear = DESCENT_CLEAR_M if estimate.direction < 0 else 0.0
        self._map.update(nosings, self._camera_offset(pose, camera), clear)
        if fresh:
            self._feel_out_of_view(nosings, camera)
        self._captured_at = max(self._captured_at, captured_at_s)
        self._frames += 1
        return True

    def _feel_out_of_view(self, nosings: tuple[Nosing, ...], camera: CameraPlacement) -> None:
        """Risers between the feet and what the first frame shows, known from how high the feet stand.

        From nearby the foot of the first riser lies below the picture, or whole steps do.
        """
        known = [nosing.riser_m for nosing in nosings if nosing.riser_m is not None]
        if camera.ground_m is None or not known:
            return
        nearest, ascending = nosings[0], self._direction > 0
        # Of what is in view, what lies next to the ground: the foot of the nearest riser, or its nosing.
        next_to_ground = nearest.height_m - (nearest.riser_m or 0.0) * ascending
        rise = (next_to_ground - camera.ground_m) * self._direction
        count = round(rise / known[0])
        if count < 1:
            return
        riser, std = rise / count, FELT_RISE_STD_M if count == 1 else SHARED_RISE_STD_M
        if ascending and nearest.riser_m is None:
            self._map.riser.update(0, riser, std)
            count -= 1
        self._map.extend_behind(min(count, MAX_HIDDEN_EDGES), riser, std)

    def _camera_offset(self, pose: PlanarPose, camera: CameraPlacement) -> float:
        """Camera at the time of the frame, along the stairs from where the base is now, metres."""
        now = self._odometry.pose
        cos, sin = math.cos(pose.heading), math.sin(pose.heading)
        mount = self._along(cos * camera.forward_m - sin * camera.left_m, sin * camera.forward_m + cos * camera.left_m)
        return mount - (1.0 + self._map.odometry_scale) * self._along(now.x - pose.x, now.y - pose.y)

    def _starts_another_flight(self, estimate: StairEstimate) -> bool:
        """Whether the known flight is behind the hips and the frame shows one that runs the other way."""
        behind = len(self._map) == 0 or float(self._map.ahead[-1]) < self._hip_ahead()
        return behind and estimate.direction != self._direction

    def _agrees(self, estimate: StairEstimate, heading: float, pose: PlanarPose, camera: CameraPlacement) -> bool:
        if estimate.direction != self._direction:
            return False
        turn = abs(_wrap(heading - self._heading))
        if turn > 0.15 + 4.0 * math.sqrt(self._heading_variance + estimate.yaw_std_rad**2):
            return False
        measured = np.array([nosing.distance_m for nosing in estimate.nosings]) + self._camera_offset(pose, camera)
        _, share = self._map.match(measured)
        return share >= self.config.min_match

    def _update_heading(self, heading: float, std: float) -> None:
        if not math.isfinite(self._heading_variance):
            self._heading, self._heading_variance = heading, std**2
            return
        gain = self._heading_variance / (self._heading_variance + std**2)
        self._heading += gain * _wrap(heading - self._heading)
        self._heading_variance *= 1.0 - gain

    # ------------------------------------------------------------------ output

    def _hip_ahead(self) -> float:
        """Front hips along the stairs, from the base, metres."""
        return self._hip_forward_m * self._pitch_cos * math.cos(self._heading - self._odometry.pose.heading)

    def block(self) -> StairBlock:
        """The stair block for now."""
        if self._direction == 0:
            return NO_STAIRS
        heading_error = _wrap(self._heading - self._odometry.pose.heading)
        ahead = np.nonzero(self._map.ahead > self._hip_ahead())[0]
        riser_known = np.isfinite(self._map.riser.variance).any()
        if len(ahead) == 0 or not riser_known or abs(heading_error) > self.config.max_heading_rad:
            return NO_STAIRS
        index = int(ahead[0])
        if not self._belongs(index):
            return NO_STAIRS
        age = max(self._odometry.pose.time_s - self._captured_at, 0.0)
        return StairBlock(
            valid=1.0,
            direction=float(self._direction),
            step_width=self._map.tread.at(index, fallback=DEFAULT_TREAD_M),
            step_height=self._map.riser.at(index, fallback=0.0),
            edge_distance=float(self._map.ahead[index]) - self._hip_ahead(),
            heading_error=heading_error,
            age=age,
            confidence=self._confidence(index, age),
        )

    def _belongs(self, index: int) -> bool:
        """Whether a nosing continues the flight.

        One that lies apart must have been seen often, riser and all; one far apart must begin a flight of its own.
        """
        apart = self._gap_treads(index)
        if apart < MAX_GAP_TREADS:
            return True
        if apart < FLIGHT_ENDS_TREADS:
            return self._is_proven(index)
        second = index + 1
        if second == len(self._map) or self._gap_treads(second) > MAX_GAP_TREADS:
            return False
        return self._is_proven(index) and self._is_proven(second)

    def _gap_treads(self, index: int) -> float:
        """From the nosing before, in treads; 0 for the first."""
        if index == 0:
            return 0.0
        gap = float(self._map.ahead[index] - self._map.ahead[index - 1])
        return gap / self._map.tread.at(index - 1, fallback=DEFAULT_TREAD_M)

    def _is_proven(self, index: int) -> bool:
        hits = self._map.hits[index] - self._map.misses[index]
        return bool(hits >= self.config.frames_to_trust and math.isfinite(self._map.riser.std_at(index)))

    def _confidence(self, index: int, age_s: float) -> float:
        """0..1: frames behind the map, spread of the next edge and its riser, age."""
        seen = min(self._frames / self.config.frames_to_trust, 1.0)
        place_std = self._map.std_at(index)
        riser_std = min(self._map.riser.std_at(index), 0.02)
        tread_std = min(self._map.tread.std_at(index), 0.03)
        spread = (place_std / 0.03) ** 2 + (riser_std / 0.02) ** 2 + (tread_std / 0.03) ** 2
        return float(seen * math.exp(-age_s / self.config.max_age_s) / (1.0 + spread))


def _shows_a_flight(nosings: tuple[Nosing, ...]) -> bool:
    """Whether more than a single riser is seen: one alone is a box, a kerb, a skirting board as well as a stair."""
    return sum(nosing.riser_m is not None for nosing in nosings) > 1 or any(
        nosing.riser_m is not None and nosing.tread_m is not None for nosing in nosings
    )


def _wrap(angle: float) -> float:
    """Angle in (-pi, pi]."""
    return math.atan2(math.sin(angle), math.cos(angle))
