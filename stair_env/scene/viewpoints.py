"""Where a camera that looks at stairs may stand: on a legged robot's head, or in a hand."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from stair_env.common.transforms import look_along
from stair_env.scene.objects.distractors import FLAT_KINDS
from stair_env.scene.shapes import Shape
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.stairs import StairProfile, StairSpec

ROBOT_SHARE = 0.6  # of the viewpoints; the rest are hand-held
ROBOT_CAMERA_HEIGHT_M = (0.33, 0.50)  # AlienGo: 0.38 m stance + 0.06 m mount; A1 lower
ROBOT_CAMERA_PITCH_RAD = (0.40, math.radians(3.0))  # mean (the mount) and spread (the gait)
ROBOT_CAMERA_FORWARD_M = 0.34  # of the trunk's middle
SLOPE_FOLLOWING = 0.8  # share of the flight's slope that the trunk's pitch follows
HAND_CAMERA_HEIGHT_M = (0.25, 1.7)
HAND_PITCH_RAD = (math.radians(-5.0), math.radians(50.0))
STANDING_SHARE = 0.3  # of the hand-held viewpoints: eye height, far enough for a long flight to fit in
STANDING_HEIGHT_M = (1.4, 1.75)
STANDING_DISTANCE_M = (1.0, 5.0)
STANDING_PITCH_RAD = {"up": (math.radians(-25.0), math.radians(20.0)), "down": (math.radians(10.0), math.radians(45.0))}
OVERLOOK_SHARE = 0.6  # of the hand-held viewpoints before a flight down: high enough to look over its first nosings
OVERLOOK_DISTANCE_M = (0.3, 2.0)
OVERLOOK_YAW_RAD = math.radians(25.0)
OVERLOOK_HEIGHT_M = (0.4, 2.0)
OVERLOOK_STEEPNESS = (1.1, 3.0)  # of the line of sight to the first nosing, in slopes of the flight
OVERLOOK_AIM = 0.7  # of the flight's length, from the first nosing on: where such a camera may point
OVERLOOK_PITCH_STD_RAD = math.radians(6.0)
BESIDE_SHARE = 0.15  # of the hand-held viewpoints: from beside the flight, across it
BESIDE_DISTANCE_M = (0.3, 1.8)
BESIDE_YAW_RAD = (math.radians(15.0), math.radians(72.0))  # beyond, lines run along the line of sight
YAW_LIMIT_RAD = math.radians(40.0)
ROLL_LIMIT_RAD = math.radians(10.0)
DISTANCE_M = (0.3, 4.0)  # before the first edge
CLEARANCE_M = 0.12  # between the lens and any solid
HALF_FOV = (math.tan(math.radians(69.0 / 2)), math.tan(math.radians(42.0 / 2)))  # D435i colour, data sheet
VIEW_RANGE_M = (0.2, 4.0)
VISIBLE_SHARE = 0.25  # of a line's samples that must be in view for it to count
LOOK_ALIKE_SHARE = 0.8  # of the viewpoints without stairs have a distractor in view, if there is one
WANTED_LINES = (0, 2, 4)  # that must be in view ...
WANTED_SHARES = (0.05, 0.4, 0.55)  # ... from these shares of the viewpoints
MAX_TRIES = 60


def sample_camera_pose(
    scene_spec: SceneSpec, rng: np.random.Generator, *, robot_share: float = ROBOT_SHARE, scene: Scene | None = None
) -> np.ndarray:
    """A viewpoint for a data set.

    Args:
        scene_spec: the scene to look at.
        rng: the source of all chance.
        robot_share: how often the camera sits on a robot's head, 0 to 1.
        scene: the built scene, if the caller has it already.

    Returns:
        (4, 4) float64 camera_to_world. The lens is outside every solid. If a staircase is there, mostly two or more of
        its lines are in view; when no such place is found, the best one.
    """
    built = scene if scene is not None else Scene(scene_spec)
    stairs = scene_spec.stairs
    if stairs is None:
        wanted = int(bool(scene_spec.distractors) and rng.random() < LOOK_ALIKE_SHARE)
    else:
        wanted = int(rng.choice(WANTED_LINES, p=WANTED_SHARES))
    style = "robot" if rng.random() < robot_share else _hand_held_style(scene_spec, rng)
    draw = {"beside": _from_beside, "overlook": _from_above}.get(style)
    best, best_count = None, -1
    for _ in range(MAX_TRIES):
        pose = _draw_pose(stairs, style, rng) if draw is None else draw(scene_spec, rng)
        if min_clearance(built.shapes, pose[:3, 3]) < CLEARANCE_M:
            continue
        if stairs is None:
            count = _distractors_in_view(scene_spec, pose)
        else:
            count = count_edges_in_view(stairs, pose, over_the_flight=style != "beside")
        if count > best_count:
            best, best_count = pose, count
        if best_count >= wanted:
            break
    return best if best is not None else look_along(np.array([-1.0, 0.0, _floor_height(scene_spec) + 0.45]), 0.0, 0.4)


def _hand_held_style(scene_spec: SceneSpec, rng: np.random.Generator) -> str:
    """ "hand" at any height, "standing" person, "overlook"ing a flight down, or "beside" one that has room there."""
    stairs = scene_spec.stairs
    if stairs is not None and stairs.direction == "down" and rng.random() < OVERLOOK_SHARE:
        return "overlook"
    chance = rng.random()
    if chance < STANDING_SHARE:
        return "standing"
    return "beside" if chance < STANDING_SHARE + BESIDE_SHARE and _open_sides(scene_spec) else "hand"


def _open_sides(scene_spec: SceneSpec) -> tuple[float, ...]:
    """+1 for left, -1 for right: where one can stand beside the flight and look across it."""
    stairs, around = scene_spec.stairs, scene_spec.surroundings
    if stairs is None:
        return ()
    least = BESIDE_DISTANCE_M[0] + 2 * CLEARANCE_M
    sides = []
    for side, name in ((1.0, "left"), (-1.0, "right")):
        gap = math.inf if around is None or around.kind == "plain" else getattr(around, f"{name}_gap")
        if stairs.side_walls not in (name, "both") and gap > least:
            sides.append(side)
    return tuple(sides)


def _from_beside(scene_spec: SceneSpec, rng: np.random.Generator) -> np.ndarray:
    """Beside the flight on the ground, turned towards a place on it."""
    stairs, sides = scene_spec.stairs, _open_sides(scene_spec)
    assert stairs is not None and sides
    side = sides[int(rng.integers(len(sides)))]
    profile, half = stairs.profile(), stairs.flight_width / 2
    target_x = float(rng.uniform(0.0, 1.0)) * float(profile.edge_x[-1])
    yaw = float(rng.uniform(*BESIDE_YAW_RAD))
    y = half + float(rng.uniform(*BESIDE_DISTANCE_M))
    x = target_x - y / math.tan(yaw)
    z = float(rng.uniform(*HAND_CAMERA_HEIGHT_M))
    target_z = float(profile.height_at(target_x))
    pitch = math.atan2(z - target_z, math.hypot(target_x - x, y)) + float(rng.normal(0.0, math.radians(6.0)))
    roll = _spread(rng, ROLL_LIMIT_RAD)
    return look_along(np.array([x, side * y, z]), -side * yaw, pitch, roll)


def _from_above(scene_spec: SceneSpec, rng: np.random.Generator) -> np.ndarray:
    """Before a flight down, so high that nosings do not hide each other."""
    stairs = scene_spec.stairs
    assert stairs is not None
    profile = stairs.profile()
    floor, distance = float(profile.level_z[0]), float(rng.uniform(*OVERLOOK_DISTANCE_M))
    steep = float(rng.uniform(*OVERLOOK_STEEPNESS)) * math.tan(stairs.slope_rad)
    height = float(np.clip(steep * distance, *OVERLOOK_HEIGHT_M))
    target_x = float(rng.uniform(0.0, OVERLOOK_AIM)) * float(profile.edge_x[-1])
    drop = height + floor - float(profile.height_at(target_x))
    pitch = math.atan2(drop, distance + target_x) + float(rng.normal(0.0, OVERLOOK_PITCH_STD_RAD))
    yaw = float(rng.uniform(-OVERLOOK_YAW_RAD, OVERLOOK_YAW_RAD))
    roll = _spread(rng, ROLL_LIMIT_RAD)
    y = float(rng.uniform(-0.5, 0.5)) * stairs.flight_width / 2 - math.tan(yaw) * (distance + target_x)
    return look_along(np.array([-distance, y, floor + height]), yaw, pitch, roll)


def _distractors_in_view(scene_spec: SceneSpec, camera_to_world: np.ndarray) -> int:
    """How many distractors have their middle in view."""
    if not scene_spec.distractors:
        return 0
    middles = np.array(
        [
            (x, y, z if thing.kind in FLAT_KINDS else z + 0.5 * thing.size[2])
            for thing in scene_spec.distractors
            for x, y, z in (thing.position,)
        ]
    )
    camera = (middles - camera_to_world[:3, 3]) @ camera_to_world[:3, :3]
    depth = np.maximum(camera[:, 2], 1e-6)
    inside = (camera[:, 2] > VIEW_RANGE_M[0]) & (np.abs(camera[:, :2]) < np.array(HALF_FOV) * depth[:, None]).all(
        axis=1
    )
    return int(inside.sum())


def _floor_height(scene_spec: SceneSpec) -> float:
    return 0.0 if scene_spec.stairs is None else float(scene_spec.stairs.profile().level_z[0])


def _draw_pose(stairs: StairSpec | None, style: str, rng: np.random.Generator) -> np.ndarray:
    """In the flight's direction, by a "robot", "hand" or "standing" person."""
    yaw = _spread(rng, YAW_LIMIT_RAD)
    roll = _spread(rng, ROLL_LIMIT_RAD)
    half = 0.6 if stairs is None else stairs.flight_width / 2
    y = float(np.clip(rng.normal(0.0, 0.35 * half), -half - 0.1, half + 0.1))
    x, surface, slope = _standing_place(stairs, rng, far=style == "standing")
    if style == "robot":
        mean, spread = ROBOT_CAMERA_PITCH_RAD
        body_pitch_up = SLOPE_FOLLOWING * slope
        pitch = mean - body_pitch_up + float(rng.normal(0.0, spread))
        z = surface + float(rng.uniform(*ROBOT_CAMERA_HEIGHT_M)) + ROBOT_CAMERA_FORWARD_M * math.sin(body_pitch_up)
        yaw *= 0.6
    elif style == "standing":
        way = "down" if stairs is not None and stairs.direction == "down" else "up"
        pitch = float(rng.uniform(*STANDING_PITCH_RAD[way]))
        z = surface + float(rng.uniform(*STANDING_HEIGHT_M))
        yaw *= 0.7
    else:
        pitch = float(rng.uniform(*HAND_PITCH_RAD))
        z = surface + float(rng.uniform(*HAND_CAMERA_HEIGHT_M))
    return look_along(np.array([x, y, z]), yaw, pitch, roll)


def _spread(rng: np.random.Generator, limit_rad: float) -> float:
    """An angle about zero, mostly within half of its limit."""
    return float(np.clip(rng.normal(0.0, limit_rad / 2), -limit_rad, limit_rad))


def _standing_place(
    stairs: StairSpec | None, rng: np.random.Generator, far: bool = False
) -> tuple[float, float, float]:
    """(x of the lens, height of the ground under the robot's middle, slope there in radians, positive upwards)."""
    if stairs is None:
        return -_distance(rng), 0.0, 0.0
    profile = stairs.profile()
    if far:
        x = -float(rng.uniform(*STANDING_DISTANCE_M)) if stairs.direction != "down" else -float(rng.uniform(0.0, 1.5))
    elif stairs.num_steps < 3 or rng.random() < 0.55:
        x = -_distance(rng)
    else:
        x = float(rng.uniform(0.0, 1.0)) * float(profile.edge_x[-2])
    feet = x - ROBOT_CAMERA_FORWARD_M + np.array([-0.25, 0.25])  # hind and fore feet of the robot that carries the lens
    heights = _slope_line(profile, feet)
    slope = math.atan2(float(heights[1] - heights[0]), 0.5)
    return x, float(heights.mean()), slope


def _distance(rng: np.random.Generator) -> float:
    """From the first edge back to the lens, metres, more often near than far."""
    near, far = DISTANCE_M
    return near + (far - near) * float(rng.beta(1.0, 2.2))


def _slope_line(profile: StairProfile, x: np.ndarray) -> np.ndarray:
    """Mean walking height within half a body around x, metres: what a trunk on several steps rests on."""
    offsets = np.linspace(-0.15, 0.15, 7)
    mean: np.ndarray = profile.height_at(x[..., None] + offsets).mean(axis=-1)
    return mean


def min_clearance(shapes: tuple[Shape, ...], point: np.ndarray) -> float:
    """Distance from a point to the nearest solid, metres; negative inside one. Rounded shapes count as their boxes."""
    centres = np.array([shape.position for shape in shapes])
    half = np.array([_half_extents(shape) for shape in shapes])
    turns = Rotation.from_quat(np.array([shape.orientation for shape in shapes]))
    outside = np.abs(turns.inv().apply(point - centres)) - half
    distance = np.linalg.norm(np.maximum(outside, 0.0), axis=1) + np.minimum(outside.max(axis=1), 0.0)
    return float(distance.min())


def _half_extents(shape: Shape) -> tuple[float, float, float]:
    if shape.kind == "box":
        return shape.size
    radius, half_length, _ = shape.size
    extra = radius if shape.kind in ("sphere", "capsule") else 0.0
    return (radius, radius, half_length + extra)


def count_edges_in_view(stairs: StairSpec, camera_to_world: np.ndarray, over_the_flight: bool = True) -> int:
    """How many stair lines a D435i sees from a pose.

    Args:
        stairs: the staircase.
        camera_to_world: (4, 4) pose.
        over_the_flight: whether the camera looks along the flight, so that the profile hides lines behind it. From
            beside only nosings count, and nothing hides them.
    """
    profile = stairs.profile()
    eye, rotation = camera_to_world[:3, 3], camera_to_world[:3, :3]
    share = np.linspace(0.02, 0.98, 15)
    along = np.linspace(0.02, 0.98, 24)
    count = 0
    for edge in stairs.edges():
        if not over_the_flight and edge.kind == "concave":
            continue
        points = np.stack(
            [np.full(15, edge.x), edge.y_right + share * (edge.y_left - edge.y_right), np.full(15, edge.z)], 1
        )
        camera = (points - eye) @ rotation
        depth = np.maximum(camera[:, 2], 1e-6)
        inside = (camera[:, 2] > VIEW_RANGE_M[0]) & (camera[:, 2] < VIEW_RANGE_M[1])
        inside &= (np.abs(camera[:, 0]) < HALF_FOV[0] * depth) & (np.abs(camera[:, 1]) < HALF_FOV[1] * depth)
        if inside.mean() < VISIBLE_SHARE:
            continue
        if not over_the_flight:
            count += 1
            continue
        ray_x = eye[0] + along * (edge.x - eye[0])
        ray_z = eye[2] + along * (edge.z - eye[2])
        count += bool(np.all(ray_z >= profile.height_at(ray_x) - 0.005))
    return count
