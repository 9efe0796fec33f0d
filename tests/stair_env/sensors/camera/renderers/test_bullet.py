import importlib.util
from types import SimpleNamespace

import cv2
import numpy as np
import pybullet
import pytest
from pybullet_utils.bullet_client import BulletClient

from stair_env.common.transforms import look_at
from stair_env.intrinsics import D435I_COLOR_MODES, Intrinsics
from stair_env.physics.simulation import Simulation
from stair_env.robots import ROBOTS
from stair_env.sampling import Scene, SceneSampler, sample_camera_pose
from stair_env.scene.shapes import box_between
from stair_env.sensors.camera.renderers import bullet, make_renderer
from stair_env.sensors.camera.renderers.bullet_shapes import shapes_of_body

INTRINSICS = D435I_COLOR_MODES["640x480"].letterboxed(256)
MEDIAN_M, PERCENTILE_99_M = 1e-3, 5e-3
MAX_DEPTH_M = 10.0  # of a D435i


@pytest.fixture
def client():
    client = BulletClient(pybullet.DIRECT)
    yield client
    client.disconnect()


def floor_in(client):
    floor = box_between((-2, -3, -0.5), (4, 3, 0), "floor")
    visual = client.createVisualShape(pybullet.GEOM_BOX, halfExtents=floor.size)
    body = client.createMultiBody(0, -1, visual, floor.position)
    return SimpleNamespace(shapes=(floor,), edges=()), body


def depth_errors(exact, other, shapes):
    """Differences on boxes of the scene away from silhouettes, metres; Bullet draws round solids as prisms."""
    kernel = np.ones((5, 5), np.uint8)
    jump = cv2.dilate(exact.depth_m, kernel) - cv2.erode(exact.depth_m, kernel) > 0.05 + 0.05 * exact.depth_m
    is_box = np.array([shape.kind == "box" for shape in shapes] + [False])  # the last for moving shapes
    same = (exact.segmentation == other.segmentation) & (exact.depth_m > 0) & (exact.depth_m < MAX_DEPTH_M)
    same &= is_box[np.minimum(exact.segmentation, len(shapes))]
    return np.abs(exact.depth_m - other.depth_m)[same & ~jump]


@pytest.mark.parametrize("roll", [0.0, 0.4, -1.3])
def test_tiny_depth_of_a_plane_is_exact_with_any_principal_point_and_roll(client, roll):
    scene, _ = floor_in(client)
    intrinsics = Intrinsics(160, 120, 150.0, 158.0, 71.0, 66.0)
    pose = look_at((-1, 0.2, 0.8), (1, 0.5, 0), roll)
    frame = make_renderer("tiny", scene, client).render(intrinsics, pose)
    expected = -pose[2, 3] / (intrinsics.rays() @ pose[2, :3])
    seen = (frame.depth_m > 0) & (frame.depth_m < 4)
    assert seen.mean() > 0.2
    assert np.quantile(np.abs(frame.depth_m - expected)[seen], 0.99) < 5e-4
    assert (frame.segmentation[seen] == 0).all()
    assert (frame.segmentation[frame.depth_m == 0] == -1).all()


def agreement(seeds, robot="aliengo"):
    """Yields depth differences of raycast and tiny over random scenes with a robot in view."""
    sampler = SceneSampler(lighting="day")
    simulation = Simulation(ROBOTS[robot])
    try:
        for seed in seeds:
            rng = np.random.default_rng(seed)
            spec = sampler.sample(rng)
            scene = Scene(spec)
            pose = sample_camera_pose(spec, rng)
            simulation.build(scene.shapes, 1.0)
            ahead = pose[:3, 3] + 1.2 * pose[:3, 2]
            simulation.client.resetBasePositionAndOrientation(simulation.body, ahead, [0, 0, 0, 1])
            moving = shapes_of_body(simulation.client, simulation.body)
            exact = make_renderer("raycast", scene, threads=1).render(INTRINSICS, pose, moving=moving)
            tiny = make_renderer("tiny", scene, simulation.client, bodies=simulation.ground)
            frame = tiny.render(INTRINSICS, pose)
            yield depth_errors(exact, frame, scene.shapes), exact, frame, len(scene.shapes)
    finally:
        simulation.close()


def check_agreement(seeds):
    for errors, exact, frame, num_shapes in agreement(seeds):
        if errors.size < 500:
            continue  # nothing but far floor or sky in view
        assert np.median(errors) <= MEDIAN_M
        assert np.quantile(errors, 0.99) <= PERCENTILE_99_M
        # The robot's pictures are its meshes, its shapes are what collides: only the scene is compared.
        scene = np.maximum(exact.segmentation, frame.segmentation) < num_shapes
        assert ((exact.depth_m > 0) == (frame.depth_m > 0))[scene].mean() > 0.995
        flush = np.abs(exact.depth_m - frame.depth_m) < MEDIAN_M  # of two walls in one plane either may be named
        assert ((exact.segmentation == frame.segmentation) | flush)[scene].mean() > 0.97


def test_raycast_and_tiny_agree_in_a_handful_of_scenes():
    check_agreement(range(4))


@pytest.mark.slow
def test_raycast_and_tiny_agree_in_200_scenes():
    check_agreement(range(100, 300))


def egl_client(client):
    try:
        bullet.load_egl(client)
    except RuntimeError as error:
        pytest.skip(str(error))
    return client


def test_egl_depth_of_a_plane(client):
    scene, _ = floor_in(egl_client(client))
    pose = look_at((-1, 0.2, 0.8), (1, 0.5, 0), 0.3)
    frame = make_renderer("egl", scene, client).render(INTRINSICS, pose)
    expected = -pose[2, 3] / (INTRINSICS.rays() @ pose[2, :3])
    seen = (frame.depth_m > 0) & (frame.depth_m < 4)
    assert seen.mean() > 0.2
    error = np.abs(frame.depth_m - expected)[seen]
    assert np.median(error) < MEDIAN_M
    assert np.quantile(error, 0.99) < PERCENTILE_99_M


def test_egl_refuses_bodies_it_cannot_draw(client):
    scene, _ = floor_in(client)
    with pytest.raises(RuntimeError, match="load_egl"):
        make_renderer("egl", scene, client)


def test_tiny_refuses_a_client_that_egl_took_over(client):
    scene, _ = floor_in(egl_client(client))
    with pytest.raises(RuntimeError, match="tiny"):
        make_renderer("tiny", scene, client)


def test_missing_egl_names_what_to_install(client, monkeypatch):
    scene = SimpleNamespace(shapes=(), edges=())

    def missing(name):
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(bullet.ctypes, "CDLL", missing)
    with pytest.raises(RuntimeError, match=r"libegl1 and libgl1-mesa-dri"):
        make_renderer("egl", scene, client)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(RuntimeError, match="eglRenderer"):
        make_renderer("egl", scene, client)


def test_bodies_give_segmentation_its_numbers(client):
    first, _ = floor_in(client)
    ball = client.createMultiBody(0, -1, client.createVisualShape(pybullet.GEOM_SPHERE, radius=0.2), [0.3, 0, 0.3])
    pose = look_at((-1, 0, 0.6), (0.3, 0, 0.3))
    frame = make_renderer("tiny", first, client).render(INTRINSICS, pose)
    assert frame.segmentation[128, 128] == 1  # a body that is no shape of the scene
    assert frame.segmentation[250, 128] == 0
    scene = SimpleNamespace(shapes=first.shapes * 2, edges=())
    frame = make_renderer("tiny", scene, client, bodies=[ball, 0]).render(INTRINSICS, pose)
    assert frame.segmentation[128, 128] == 0
    assert frame.segmentation[250, 128] == 1
    with pytest.raises(ValueError, match="bodies"):
        make_renderer("tiny", scene, client, bodies=[ball])


def test_linear_depth_inverts_the_projection():
    near, far = 0.05, 60.0
    depth = np.array([0.06, 0.5, 3.0, 40.0])
    z = -depth  # OpenGL's
    column = np.array(bullet.projection_matrix(INTRINSICS, near, far)).reshape(4, 4).T
    clip = column @ np.stack([np.zeros(4), np.zeros(4), z, np.ones(4)])
    buffer = (clip[2] / clip[3] + 1) / 2
    assert np.allclose(bullet.linear_depth(buffer, near, far), depth, rtol=1e-5)
    assert bullet.linear_depth(np.array([1.0]), near, far) == 0.0
