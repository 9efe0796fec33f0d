"""Compiled maths of the robot's body. Importing this module loads numba.

Arrays of a dozen numbers cost numpy more to hand around than to work on; a control step of the environment meets some
hundred such operations, which outweigh the physics. Here each is a loop over plain floats. Signatures are given, so
that whoever imports this compiles it (or finds it compiled), and no control step ever waits for a compiler.
"""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, float64, void

from stair_env.common.compiling import njit

FLOATS, ROWS, FLAGS = float64[::1], float64[:, ::1], boolean[::1]  # contiguous arrays
Vector = tuple[float, float, float]
# Where a row of a trunk's track holds what; the rotation base_to_world lies row by row.
POSITION, ROTATION, VELOCITY, ANGULAR_VELOCITY, TRACK_WIDTH = 0, 3, 12, 15, 18
READING_WIDTH = 13  # what Bullet tells about a body: position, quaternion, linear and angular velocity


@njit(cache=True, nogil=True, inline="always")
def _vector(numbers: np.ndarray, start: int) -> Vector:
    return numbers[start], numbers[start + 1], numbers[start + 2]


@njit(cache=True, nogil=True, inline="always")
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, nogil=True, inline="always")
def _turned(rotation: np.ndarray, v: Vector) -> Vector:
    """Rotation (9,), row by row, times a vector."""
    return (
        rotation[0] * v[0] + rotation[1] * v[1] + rotation[2] * v[2],
        rotation[3] * v[0] + rotation[4] * v[1] + rotation[5] * v[2],
        rotation[6] * v[0] + rotation[7] * v[1] + rotation[8] * v[2],
    )


@njit(cache=True, nogil=True, inline="always")
def _turned_back(rotation: np.ndarray, v: Vector) -> Vector:
    """The transpose of a rotation (9,) times a vector."""
    return (
        rotation[0] * v[0] + rotation[3] * v[1] + rotation[6] * v[2],
        rotation[1] * v[0] + rotation[4] * v[1] + rotation[7] * v[2],
        rotation[2] * v[0] + rotation[5] * v[1] + rotation[8] * v[2],
    )


@njit(cache=True, nogil=True, inline="always")
def _point_velocity(row: np.ndarray, arm: Vector) -> Vector:
    """Velocity of a point fixed to the trunk, `arm` from the base's origin in base axes."""
    sweep = _cross(_vector(row, ANGULAR_VELOCITY), _turned(row[ROTATION:VELOCITY], arm))
    return row[VELOCITY] + sweep[0], row[VELOCITY + 1] + sweep[1], row[VELOCITY + 2] + sweep[2]


@njit(cache=True, nogil=True, inline="always")
def _write_rotation(quaternion: np.ndarray, after: np.ndarray, rotation: np.ndarray) -> None:
    """Rotation of a quaternion (x, y, z, w) times the rotation `after` (3, 3), into rotation (9,), row by row."""
    x, y, z, w = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    twice = 2.0 / (x * x + y * y + z * z + w * w)
    xx, yy, zz = 1.0 - twice * (y * y + z * z), 1.0 - twice * (x * x + z * z), 1.0 - twice * (x * x + y * y)
    xy, xz, yz = twice * x * y, twice * x * z, twice * y * z
    wx, wy, wz = twice * w * x, twice * w * y, twice * w * z
    for j in range(3):
        a, b, c = after[0, j], after[1, j], after[2, j]
        rotation[j] = xx * a + (xy - wz) * b + (xz + wy) * c
        rotation[3 + j] = (xy + wz) * a + yy * b + (yz - wx) * c
        rotation[6 + j] = (xz - wy) * a + (yz + wx) * b + zz * c


@njit(ROWS(FLOATS, ROWS, FLOATS, FLOATS), cache=True, nogil=True, error_model="numpy")
def forward_legs(joint_angles: np.ndarray, hips: np.ndarray, side_offsets: np.ndarray, links: np.ndarray) -> np.ndarray:
    """Foot centres of four legs.

    Args:
        joint_angles: (12,) abduction, upper and lower angle of each leg, radians.
        hips: (4, 3) base frame, metres.
        side_offsets: (4,) signed distance from hip to leg plane, metres.
        links: (2,) lengths of the upper and lower link, metres.

    Returns:
        (4, 3) float64, base frame, metres.
    """
    feet = np.empty((4, 3))
    for leg in range(4):
        abduction, upper = joint_angles[3 * leg], joint_angles[3 * leg + 1]
        knee = upper + joint_angles[3 * leg + 2]
        down = -links[0] * math.cos(upper) - links[1] * math.cos(knee)
        cos, sin = math.cos(abduction), math.sin(abduction)
        feet[leg, 0] = hips[leg, 0] - links[0] * math.sin(upper) - links[1] * math.sin(knee)
        feet[leg, 1] = hips[leg, 1] + side_offsets[leg] * cos - down * sin
        feet[leg, 2] = hips[leg, 2] + side_offsets[leg] * sin + down * cos
    return feet


@njit(FLOATS(ROWS, ROWS, FLOATS, FLOATS, float64, float64), cache=True, nogil=True, error_model="numpy")
def inverse_legs(
    feet: np.ndarray, hips: np.ndarray, side_offsets: np.ndarray, links: np.ndarray, min_reach: float, max_reach: float
) -> np.ndarray:
    """Joint angles that put four feet where asked, or as near as the legs reach.

    Args:
        feet: (4, 3) base frame, metres.
        hips, side_offsets, links: as in `forward_legs`.
        min_reach, max_reach: distances between hip axis and foot that are asked of a leg, metres.

    Returns:
        (12,) float64, radians.
    """
    upper_length, lower_length = links[0], links[1]
    angles = np.empty(12)
    for leg in range(4):
        x, y, z = feet[leg, 0] - hips[leg, 0], feet[leg, 1] - hips[leg, 1], feet[leg, 2] - hips[leg, 2]
        side = side_offsets[leg]
        down = -math.sqrt(max(y * y + z * z - side * side, 1e-4))
        abduction = math.atan2(z, y) - math.atan2(down, side)
        reach = math.hypot(x, down)
        scale = min(max(reach, min_reach), max_reach) / reach
        x, down, reach = x * scale, down * scale, reach * scale
        bend = (reach * reach - upper_length**2 - lower_length**2) / (2 * upper_length * lower_length)
        lower = -math.acos(min(max(bend, -1.0), 1.0))
        inward = math.atan2(lower_length * math.sin(lower), upper_length + lower_length * math.cos(lower))
        angles[3 * leg] = (abduction + math.pi) % (2 * math.pi) - math.pi
        angles[3 * leg + 1] = math.atan2(-x, -down) - inward
        angles[3 * leg + 2] = lower
    return angles


@njit(ROWS(FLOATS), cache=True, nogil=True, error_model="numpy")
def level_turn(up: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) that takes roll and pitch out and leaves the heading alone; up (3,) points against gravity."""
    x, y, z = 1.0 - up[0] * up[0], -up[0] * up[1], -up[0] * up[2]  # the x axis less its part along up
    length = max(math.sqrt(x * x + y * y + z * z), 1e-9)
    ahead, above = (x / length, y / length, z / length), _vector(up, 0)
    left = _cross(above, ahead)
    turn = np.empty((3, 3))
    for axis in range(3):
        turn[0, axis], turn[1, axis], turn[2, axis] = ahead[axis], left[axis], above[axis]
    return turn


@njit(ROWS(FLOATS, ROWS, FLOATS, FLOATS, ROWS), cache=True, nogil=True, error_model="numpy")
def level_stance(
    joint_angles: np.ndarray,
    hips: np.ndarray,
    side_offsets: np.ndarray,
    links: np.ndarray,
    base_to_level: np.ndarray,
) -> np.ndarray:
    """Feet and shanks in a frame without pitch and roll.

    Args:
        joint_angles, hips, side_offsets, links: as in `forward_legs`.
        base_to_level: (3, 3) rotation.

    Returns:
        (4, 4) float64: x, y, z of each foot, metres, and the pitch of its shank, radians.
    """
    feet, stance = forward_legs(joint_angles, hips, side_offsets, links), np.empty((4, 4))
    turn = base_to_level.ravel()
    pitch = math.atan2(-base_to_level[2, 0], base_to_level[0, 0])
    for leg in range(4):
        foot = _turned(turn, _vector(feet[leg], 0))
        for axis in range(3):
            stance[leg, axis] = foot[axis]
        stance[leg, 3] = pitch + joint_angles[3 * leg + 1] + joint_angles[3 * leg + 2]
    return stance


@njit(FLOATS(ROWS, ROWS, FLAGS, FLAGS, float64, float64), cache=True, nogil=True, error_model="numpy")
def displacement(
    before: np.ndarray,
    after: np.ndarray,
    touched: np.ndarray,
    touching: np.ndarray,
    yaw_change: float,
    foot_radius: float,
) -> np.ndarray:
    """How the trunk moved while feet stood still.

    Args:
        before, after: (4, 4) as `level_stance` returns them.
        touched, touching: (4,) bool, which feet were on the ground then and now.
        yaw_change: heading change in between, radians.
        foot_radius: metres; a round foot's centre travels that far per radian that its shank turns.

    Returns:
        (3,) float64, metres in the level frame of `after`: the median over the feet that stood; NaN if none did.
    """
    cos, sin = math.cos(yaw_change), math.sin(yaw_change)
    moved = np.empty((3, 4))
    count = 0
    for leg in range(4):
        if touched[leg] and touching[leg]:
            rolled = foot_radius * (after[leg, 3] - before[leg, 3])
            moved[0, count] = cos * before[leg, 0] + sin * before[leg, 1] - after[leg, 0] + rolled
            moved[1, count] = cos * before[leg, 1] - sin * before[leg, 0] - after[leg, 1]
            moved[2, count] = before[leg, 2] - after[leg, 2]
            count += 1
    median = np.full(3, np.nan)
    for axis in range(3):
        if count > 0:
            ordered = np.sort(moved[axis, :count])
            median[axis] = (ordered[(count - 1) // 2] + ordered[count // 2]) / 2
    return median


@njit(ROWS(ROWS, ROWS, FLOATS), cache=True, nogil=True, error_model="numpy")
def trace_trunk(readings: np.ndarray, inertial_to_base: np.ndarray, origin_in_base: np.ndarray) -> np.ndarray:
    """Motion of the base frame from that of Bullet's inertial frame.

    Args:
        readings: (k, 13) position and quaternion (x, y, z, w) of the inertial frame, metres, and its linear and angular
            velocity, m/s and rad/s, all in the world frame.
        inertial_to_base: (3, 3) rotation; inertial_to_world times this is base_to_world.
        origin_in_base: (3,) base's origin from the centre of mass, base axes, metres.

    Returns:
        (k, 18) float64, the track: position, rotation base_to_world, linear velocity of the origin, angular velocity.
    """
    track = np.empty((len(readings), TRACK_WIDTH))
    origin = _vector(origin_in_base, 0)
    for k in range(len(readings)):
        reading, row = readings[k], track[k]
        rotation = row[ROTATION:VELOCITY]
        _write_rotation(reading[3:7], inertial_to_base, rotation)
        offset, spin = _turned(rotation, origin), _vector(reading, 10)
        sweep = _cross(spin, offset)
        for axis in range(3):
            row[POSITION + axis] = reading[axis] + offset[axis]
            row[VELOCITY + axis] = reading[7 + axis] + sweep[axis]
            row[ANGULAR_VELOCITY + axis] = spin[axis]
    return track


@njit(ROWS(FLOATS, ROWS, FLOATS, FLOATS, float64, float64), cache=True, nogil=True, error_model="numpy")
def feel(
    start: np.ndarray, track: np.ndarray, lever: np.ndarray, sensor_to_base: np.ndarray, rate_hz: float, gravity: float
) -> np.ndarray:
    """What ideal inertial sensors fixed to the trunk undergo along its track.

    Args:
        start: (18,) row of the track before its first.
        track: (k, 18) as `trace_trunk` returns it.
        lever: (3,) sensor in the base frame, metres.
        sensor_to_base: (9,) rotation, row by row.
        rate_hz: rows per second.
        gravity: m/s².

    Returns:
        (k, 6) float64: specific force, m/s², and angular velocity, rad/s, in the sensor's axes.
    """
    felt = np.empty((len(track), 6))
    arm = _vector(lever, 0)
    last = _point_velocity(start, arm)
    for k in range(len(track)):
        row = track[k]
        now = _point_velocity(row, arm)
        push = (
            (now[0] - last[0]) * rate_hz,
            (now[1] - last[1]) * rate_hz,
            (now[2] - last[2]) * rate_hz + gravity,
        )
        rotation = row[ROTATION:VELOCITY]
        force = _turned_back(sensor_to_base, _turned_back(rotation, push))
        spin = _turned_back(sensor_to_base, _turned_back(rotation, _vector(row, ANGULAR_VELOCITY)))
        for axis in range(3):
            felt[k, axis], felt[k, 3 + axis] = force[axis], spin[axis]
        last = now
    return felt


@njit(void(ROWS, FLOATS, FLOATS), cache=True, nogil=True, error_model="numpy")
def digitise(values: np.ndarray, quantum: np.ndarray, limit: np.ndarray) -> None:
    """Round (k, n) values, in place, to whole steps of quantum (n,), 0 for none, and keep them within ±limit (n,)."""
    for k in range(values.shape[0]):
        for i in range(values.shape[1]):
            value = values[k, i]
            if quantum[i] > 0.0:
                value = np.rint(value * (1.0 / quantum[i])) * quantum[i]
            values[k, i] = max(min(value, limit[i]), -limit[i])


@njit(float64[::1](FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, float64), cache=True, nogil=True)
def pd_torques(
    targets: np.ndarray,
    rates: np.ndarray,
    positions: np.ndarray,
    velocities: np.ndarray,
    kp: np.ndarray,
    kd: np.ndarray,
    max_torque: np.ndarray,
    max_speed: np.ndarray,
    corner: float,
) -> np.ndarray:
    """Torques of motors under PD control, limited by torque and speed; all (n,).

    Args:
        targets, positions: radians.
        rates, velocities: of the targets and of the joints, rad/s.
        kp, kd: N·m/rad, N·m·s/rad.
        max_torque: N·m.
        max_speed: at which nothing is left of it in the direction of motion, rad/s.
        corner: share of max_speed up to which all of it is there.
    """
    torques = np.empty_like(positions)
    for joint in range(len(torques)):
        velocity = velocities[joint]
        wanted = kp[joint] * (targets[joint] - positions[joint]) + kd[joint] * (rates[joint] - velocity)
        limit = max_torque[joint]
        left = (1.0 - abs(velocity) / max_speed[joint]) / (1.0 - corner)
        forward = limit * min(max(left, 0.0), 1.0)  # in the direction of motion
        highest, lowest = (forward, limit) if velocity >= 0.0 else (limit, forward)
        torques[joint] = min(max(wanted, -lowest), highest)
    return torques
