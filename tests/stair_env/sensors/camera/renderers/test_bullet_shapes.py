import numpy as np
import pybullet
import pybullet_data
import pytest
from pybullet_utils.bullet_client import BulletClient
from scipy.spatial.transform import Rotation

from stair_env.robots import ROBOTS
from stair_env.sensors.camera.renderers.bullet_shapes import BodyShapes, fit_solid, shapes_of_body


@pytest.fixture
def client():
    client = BulletClient(pybullet.DIRECT)
    client.setAdditionalSearchPath(pybullet_data.getDataPath())
    yield client
    client.disconnect()


QUATERNION = tuple(Rotation.from_rotvec([0.3, -0.4, 0.8]).as_quat().tolist())
MADE = [
    ("box", pybullet.GEOM_BOX, {"halfExtents": [0.1, 0.2, 0.3]}, (0.1, 0.2, 0.3)),
    ("sphere", pybullet.GEOM_SPHERE, {"radius": 0.15}, (0.15, 0.0, 0.0)),
    ("cylinder", pybullet.GEOM_CYLINDER, {"radius": 0.1, "height": 0.6}, (0.1, 0.3, 0.0)),
    ("capsule", pybullet.GEOM_CAPSULE, {"radius": 0.1, "height": 0.6}, (0.1, 0.3, 0.0)),
]


@pytest.mark.parametrize(("kind", "geometry", "arguments", "size"), MADE, ids=[made[0] for made in MADE])
def test_a_primitive_comes_back_as_it_was_made(client, kind, geometry, arguments, size):
    collision = client.createCollisionShape(geometry, **arguments)
    body = client.createMultiBody(1.0, collision, -1, [1, 2, 3], QUATERNION)
    (shape,) = shapes_of_body(client, body, surface="distractor:ball:0")
    assert (shape.kind, shape.surface) == (kind, "distractor:ball:0")
    assert shape.size == pytest.approx(size)
    assert shape.position == pytest.approx((1, 2, 3))
    assert abs(np.dot(shape.orientation, QUATERNION)) == pytest.approx(1.0)


def rays_hit(client, body, shapes, rng):
    """Distances at which Bullet's own ray test and the shapes are hit from random directions, both (n,)."""
    centre = np.array(client.getBasePositionAndOrientation(body)[0])
    theirs, ours = [], []
    for _ in range(200):
        direction = rng.normal(size=3)
        start = centre + 1.5 * direction / np.linalg.norm(direction)
        target = centre + rng.uniform(-0.2, 0.2, 3)
        hit = client.rayTest(start.tolist(), target.tolist())[0]
        theirs.append(hit[2] if hit[0] == body else np.nan)
        ours.append(min((distance_to(shape, start, target) for shape in shapes), default=np.nan))
    return np.array(theirs), np.array(ours)


def distance_to(shape, start, target):
    """First fraction of the way start -> target inside a shape, by small steps; infinite when there is none."""
    way = start + np.linspace(0, 1, 3000)[:, None] * (target - start)
    local = Rotation.from_quat(shape.orientation).inv().apply(way - np.array(shape.position))
    if shape.kind == "box":
        inside = (np.abs(local) <= shape.size).all(axis=1)
    elif shape.kind == "sphere":
        inside = np.linalg.norm(local, axis=1) <= shape.size[0]
    else:
        inside = (np.hypot(local[:, 0], local[:, 1]) <= shape.size[0]) & (np.abs(local[:, 2]) <= shape.size[1])
    return np.argmax(inside) / 2999 if inside.any() else np.inf


@pytest.mark.parametrize("name", ["aliengo", "a1"])
def test_robot_shapes_are_where_bullet_collides(client, name):
    rng = np.random.default_rng(0)
    body = client.loadURDF(ROBOTS[name].urdf, [0.3, -0.2, 1.0], QUATERNION)
    for joint in range(client.getNumJoints(body)):
        client.resetJointState(body, joint, rng.uniform(-0.6, 0.6))
    client.performCollisionDetection()
    shapes = shapes_of_body(client, body)
    assert {shape.surface for shape in shapes} == {"robot"}
    theirs, ours = rays_hit(client, body, shapes, rng)
    hit = np.isfinite(theirs)
    assert hit.sum() > 25
    assert (hit == np.isfinite(ours)).mean() > 0.97
    both = hit & np.isfinite(ours)
    assert np.median(np.abs(theirs - ours)[both]) < 2e-3
    assert (np.abs(theirs - ours)[both] < 0.01).mean() > 0.95


def test_shapes_follow_the_body(client):
    body = client.loadURDF(ROBOTS["a1"].urdf, [0, 0, 1])
    tracked = BodyShapes(client, body)
    before = np.array([shape.position for shape in tracked.shapes()])
    client.resetBasePositionAndOrientation(body, [0.5, 0.25, 2.0], [0, 0, 0, 1])
    moved = tracked.shapes()
    assert np.allclose([shape.position for shape in moved], [shape.position for shape in shapes_of_body(client, body)])
    shift = np.array([shape.position for shape in moved]) - before
    assert np.allclose(shift, shift[0])
    assert shift[0] == pytest.approx([0.5, 0.25, 1.0], abs=0.02)


def test_a_prism_of_many_sides_is_a_cylinder_and_other_points_get_a_box():
    angle = np.arange(32) * 2 * np.pi / 32
    ring = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), np.zeros(32)], axis=1)
    turn = Rotation.from_rotvec([0.5, 0.2, -0.9])
    up = np.array([0, 0, 0.3])
    prism = turn.apply(np.concatenate([ring - up, ring + up])) + np.array([1, 2, 3])
    kind, size, centre, rotation = fit_solid(prism)
    assert kind == "cylinder"
    assert size == pytest.approx((0.1, 0.3, 0.0), rel=0.01)
    assert centre == pytest.approx((1, 2, 3))
    assert abs(rotation.apply([0, 0, 1]) @ turn.apply([0, 0, 1])) == pytest.approx(1.0, abs=1e-4)
    corners = np.array(np.meshgrid([-0.1, 0.1], [-0.2, 0.2], [-0.5, 0.5])).reshape(3, -1).T
    kind, size, _, rotation = fit_solid(turn.apply(corners))
    assert kind == "box"
    assert sorted(size) == pytest.approx([0.1, 0.2, 0.5])
    assert np.linalg.det(rotation.as_matrix()) == pytest.approx(1.0)
