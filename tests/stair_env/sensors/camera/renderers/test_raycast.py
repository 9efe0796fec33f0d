import os
import pickle
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stair_env.common.compiling import CACHE_VARIABLE, KernelCache
from stair_env.common.transforms import look_at
from stair_env.common.validation import SpecError
from stair_env.intrinsics import D435I_COLOR_MODES, Intrinsics
from stair_env.scene.shapes import Shape, box_between, build_stair_shapes
from stair_env.sensors.camera.renderers import make_renderer, shading, visibility
from stair_env.stairs import StairSpec

INTRINSICS = Intrinsics(100, 70, 90.0, 95.0, 47.0, 36.0)  # neither square nor a multiple of the tiles
FLOOR = box_between((-8.0, -8.0, -0.5), (8.0, 8.0, 0.0), "floor")

directions = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)


def draw(*shapes, pose, intrinsics=INTRINSICS, moving=(), **options):
    scene = SimpleNamespace(shapes=shapes, edges=())
    return make_renderer("raycast", scene, threads=1, **options).render(intrinsics, pose, moving=moving)


def rays_of(pose, intrinsics=INTRINSICS):
    """World origin and directions per unit of depth, float64."""
    return pose[:3, 3], intrinsics.rays() @ pose[:3, :3].T


def to_local(shape, pose):
    rotation = Rotation.from_quat(shape.orientation).as_matrix()
    origin, rays = rays_of(pose)
    return (origin - np.array(shape.position)) @ rotation, rays @ rotation


def quadratic(a, b, c):
    """Smaller root of a t^2 + 2 b t + c, NaN where there is none."""
    with np.errstate(invalid="ignore"):
        return (-b - np.sqrt(b * b - a * c)) / a


def assert_depth(frame, expected, silhouette_m=0.0):
    """Equal where both hit; the two agree on what they hit but for a few pixels on the outline."""
    hit, should = frame.depth_m > 0, np.isfinite(expected)
    assert (hit != should).mean() < 0.004
    both = hit & should
    assert both.any()
    error = np.abs(frame.depth_m - expected)[both]
    assert np.quantile(error, 0.99) < 1e-4 + silhouette_m
    assert np.median(error) < 1e-5


@settings(max_examples=20, deadline=None)
@given(st.floats(-0.9, 0.9), st.floats(0.3, 2.0), st.floats(-1.0, 1.0))
def test_depth_of_a_plane_is_exact(pitch, height, roll):
    pose = look_at((0, 0, height), (1, 0.2, height + pitch), roll)
    origin, rays = rays_of(pose)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = -origin[2] / rays[..., 2]
        point = origin + depth[..., None] * rays
        inside = (depth > 0) & (np.abs(point[..., :2]) < 8).all(axis=-1)
    frame = draw(FLOOR, pose=pose)
    assert np.abs(frame.depth_m - depth)[inside].max(initial=0.0) < 2e-4
    assert (frame.segmentation[inside] == 0).all()


@settings(max_examples=25, deadline=None)
@given(directions, st.tuples(*[st.floats(0.05, 0.5)] * 3))
def test_depth_of_a_box_is_exact(quaternion, half):
    shape = Shape("box", (1.5, 0.1, 0.0), half, tuple(np.array(quaternion) / np.linalg.norm(quaternion)))
    pose = look_at((0, 0, 0.1), (1.5, 0, 0))
    origin, rays = to_local(shape, pose)
    with np.errstate(divide="ignore"):
        first, second = (-np.array(half) - origin) / rays, (np.array(half) - origin) / rays
    enter, leave = np.minimum(first, second).max(axis=-1), np.maximum(first, second).min(axis=-1)
    assert_depth(draw(shape, pose=pose), np.where((enter <= leave) & (enter > 0), enter, np.nan))


@settings(max_examples=15, deadline=None)
@given(st.floats(0.03, 0.5), st.floats(-0.3, 0.3))
def test_depth_of_a_sphere_is_exact(radius, y):
    shape = Shape("sphere", (1.5, y, 0.0), (radius, 0.0, 0.0))
    pose = look_at((0, 0, 0.1), (1.5, 0, 0))
    origin, rays = to_local(shape, pose)
    expected = quadratic((rays * rays).sum(-1), rays @ origin, origin @ origin - radius**2)
    # On the outline the square root turns a rounding error into a longer one.
    assert_depth(draw(shape, pose=pose), expected, silhouette_m=1e-3)


@settings(max_examples=25, deadline=None)
@given(directions, st.floats(0.02, 0.3), st.floats(0.02, 0.5))
def test_depth_of_a_cylinder_is_exact(quaternion, radius, half):
    shape = Shape(
        "cylinder", (1.5, 0.0, 0.0), (radius, half, 0.0), tuple(np.array(quaternion) / np.linalg.norm(quaternion))
    )
    pose = look_at((0, 0, 0.1), (1.5, 0, 0))
    origin, rays = to_local(shape, pose)
    a, b = (rays[..., :2] ** 2).sum(-1), rays[..., :2] @ origin[:2]
    side_enter = quadratic(a, b, origin[:2] @ origin[:2] - radius**2)
    side_leave = -2 * b / a - side_enter
    with np.errstate(divide="ignore"):
        ends = np.sort(np.stack([(-half - origin[2]) / rays[..., 2], (half - origin[2]) / rays[..., 2]]), axis=0)
    enter, leave = np.maximum(side_enter, ends[0]), np.minimum(side_leave, ends[1])
    assert_depth(draw(shape, pose=pose), np.where(enter <= leave, enter, np.nan), silhouette_m=1e-3)


@settings(max_examples=25, deadline=None)
@given(directions, st.floats(0.03, 0.3), st.floats(0.0, 0.5))
def test_depth_of_a_capsule_is_that_of_the_balls_it_is_made_of(quaternion, radius, half):
    shape = Shape(
        "capsule", (1.5, 0.0, 0.0), (radius, half, 0.0), tuple(np.array(quaternion) / np.linalg.norm(quaternion))
    )
    pose = look_at((0, 0, 0.1), (1.5, 0, 0))
    origin, rays = to_local(shape, pose)
    expected = np.full(rays.shape[:2], np.inf)
    for z in np.linspace(-half, half, 400):  # a capsule is what a ball sweeps
        centre = origin - [0, 0, z]
        expected = np.fmin(expected, quadratic((rays * rays).sum(-1), rays @ centre, centre @ centre - radius**2))
    frame = draw(shape, pose=pose)
    both = (frame.depth_m > 0) & np.isfinite(expected)
    assert ((frame.depth_m > 0) != np.isfinite(expected)).mean() < 0.004
    assert np.median(np.abs(frame.depth_m - expected)[both]) < 1e-4  # the sweep's own steps are 2.5 mm


def test_roll_turns_the_image_about_its_centre():
    square = Intrinsics(65, 65, 80.0, 80.0, 32.5, 32.5)
    shapes = (box_between((1.0, -0.1, -0.4), (1.2, 0.5, 0.3), "wall"), Shape("sphere", (1, -0.3, 0.2), (0.2, 0, 0)))
    level = draw(*shapes, pose=look_at((0, 0, 0), (1, 0, 0)), intrinsics=square)
    turned = draw(*shapes, pose=look_at((0, 0, 0), (1, 0, 0), roll_rad=np.pi / 2), intrinsics=square)
    # A camera turned clockwise sees the world turned anticlockwise.
    assert (turned.segmentation == np.rot90(level.segmentation)).mean() > 0.99
    assert not (turned.segmentation == level.segmentation).all()


def test_segmentation_counts_scene_shapes_then_moving_ones():
    near = Shape("sphere", (0.8, -0.3, 0.3), (0.1, 0, 0), surface="robot")
    wall = box_between((2.0, -3.0, 0.0), (2.1, 3.0, 3.0), "wall")
    pose = look_at((0, 0, 0.4), (1, 0, 0.3))
    frame = draw(FLOOR, wall, pose=pose, moving=(near,))
    assert set(np.unique(frame.segmentation)) == {0, 1, 2}
    alone = draw(FLOOR, wall, pose=pose)
    elsewhere = frame.segmentation != 2
    assert (frame.depth_m[elsewhere] == alone.depth_m[elsewhere]).all()
    assert (frame.depth_m[~elsewhere] < alone.depth_m[~elsewhere]).all()


def test_nothing_hit_is_minus_one_and_zero():
    frame = draw(FLOOR, pose=look_at((0, 0, 1), (1, 0, 3)))
    assert (frame.segmentation == -1).all()
    assert (frame.depth_m == 0).all()


def test_a_solid_around_the_camera_is_not_seen():
    head = Shape("box", (0.0, 0.0, 0.5), (0.1, 0.1, 0.1), surface="robot")
    pose = look_at((0, 0, 0.5), (1, 0, 0.2))
    assert (draw(FLOOR, pose=pose, moving=(head,)).segmentation <= 0).all()


def test_tiles_hide_nothing():
    # A pixel drawn alone sees what it sees as a part of the image.
    stairs = build_stair_shapes(StairSpec(num_steps=8, handrails=True, stringers=True, nosing_overhang=0.02))
    pose = look_at((-1.0, 0.4, 0.6), (0.6, 0, 0.4), 0.2)
    frame = draw(*stairs, pose=pose)
    rng = np.random.default_rng(1)
    for u, v in zip(rng.integers(0, 100, 200).tolist(), rng.integers(0, 70, 200).tolist()):
        alone = Intrinsics(1, 1, INTRINSICS.fx, INTRINSICS.fy, INTRINSICS.cx - u, INTRINSICS.cy - v)
        single = draw(*stairs, pose=pose, intrinsics=alone)
        assert single.segmentation[0, 0] == frame.segmentation[v, u]
        assert single.depth_m[0, 0] == pytest.approx(frame.depth_m[v, u], abs=1e-5)


def test_frames_have_the_declared_types():
    frame = draw(FLOOR, pose=look_at((0, 0, 1), (1, 0, 0)))
    assert (frame.rgb.dtype, frame.rgb.shape) == (np.uint8, (70, 100, 3))
    assert (frame.depth_m.dtype, frame.depth_m.shape) == (np.float32, (70, 100))
    assert (frame.segmentation.dtype, frame.segmentation.shape) == (np.int32, (70, 100))


def test_threads_do_not_change_the_picture():
    stairs = SimpleNamespace(shapes=build_stair_shapes(StairSpec(handrails=True)), edges=())
    pose, intrinsics = look_at((-1.0, 0.4, 0.6), (0.6, 0, 0.4)), D435I_COLOR_MODES["640x480"]
    one, three = (make_renderer("raycast", stairs, threads=n).render(intrinsics, pose) for n in (1, 3))
    for name in ("rgb", "depth_m", "segmentation"):
        assert np.array_equal(getattr(one, name), getattr(three, name))


def test_the_same_call_gives_the_same_bits_in_a_fresh_process():
    code = (
        "import pickle, sys, types; from stair_env.scene.shapes import build_stair_shapes; "
        "from stair_env.stairs import StairSpec; from stair_env.intrinsics import Intrinsics; "
        "from stair_env.sensors.camera.renderers import make_renderer; "
        "from stair_env.common.transforms import look_at; "
        "scene = types.SimpleNamespace(shapes=build_stair_shapes(StairSpec()), edges=()); "
        "frame = make_renderer('raycast', scene).render("
        "Intrinsics(100, 70, 90.0, 95.0, 47.0, 36.0), look_at((-1, 0.4, 0.6), (0.6, 0, 0.4))); "
        "sys.stdout.buffer.write(pickle.dumps((frame.rgb, frame.depth_m)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    rgb, depth = pickle.loads(done.stdout)
    here = draw(*build_stair_shapes(StairSpec()), pose=look_at((-1, 0.4, 0.6), (0.6, 0, 0.4)))
    assert np.array_equal(rgb, here.rgb)
    assert np.array_equal(depth, here.depth_m)


def test_under_fast_math_only_what_python_calls_has_a_cache():
    """See `visibility.part`: code that depended on what was cached before could round differently."""
    modules = (visibility, shading)
    kernels = {name: value for module in modules for name, value in vars(module).items() if hasattr(value, "py_func")}
    called = {name for value in kernels.values() for name in value.py_func.__code__.co_names}
    fast = {name for name, value in kernels.items() if value.targetoptions.get("fastmath")}
    cached = {name for name, value in kernels.items() if isinstance(value._cache, KernelCache)}
    assert fast == set(kernels) and cached == set(kernels) - called == {
        "trace_rows",
        "tile_spans",
        "to_camera",
        "shade_rows",
    }


DRAW_SCENES = """
import hashlib
import numpy as np
from stair_env.common.transforms import look_at
from stair_env.intrinsics import Intrinsics
from stair_env.sampling import Scene, SceneSampler
from stair_env.sensors.camera.renderers import make_renderer
rng = np.random.default_rng(5)
sampler, digest = SceneSampler(), hashlib.sha256()
for _ in range(12):
    renderer = make_renderer("raycast", Scene(sampler.sample(rng)), threads=1)
    pose = look_at((rng.uniform(-1.5, -0.5), rng.uniform(-0.3, 0.3), 0.7), (1.0, 0.0, 0.1))
    frame = renderer.render(Intrinsics(200, 150, 190.0, 190.0, 100.0, 75.0), pose)
    digest.update(frame.rgb.tobytes() + frame.depth_m.tobytes())
print(digest.hexdigest())
"""


@pytest.mark.slow
def test_what_was_compiled_before_does_not_change_a_bit(tmp_path):
    """Cold cache, warm cache, and one of which single kernels are gone."""
    cache = tmp_path / "kernels"
    environment = {**os.environ, CACHE_VARIABLE: str(cache)}

    def drawn():
        done = subprocess.run([sys.executable, "-c", DRAW_SCENES], env=environment, capture_output=True, check=True)
        return done.stdout

    cold, warm = drawn(), drawn()
    assert cold == warm
    for name in ("trace_rows", "shade_rows"):
        for file in list(cache.rglob(f"*{name}*")):
            file.unlink()
        assert drawn() == cold, name


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_child_can_draw_after_its_parent_has():
    code = (
        "import os, types; from stair_env.scene.shapes import build_stair_shapes; "
        "from stair_env.stairs import StairSpec; "
        "from stair_env.intrinsics import D435I_COLOR_MODES; "
        "from stair_env.sensors.camera.renderers import make_renderer; "
        "from stair_env.common.transforms import look_at; "
        "scene = types.SimpleNamespace(shapes=build_stair_shapes(StairSpec()), edges=()); "
        "renderer = make_renderer('raycast', scene, threads=3); "
        "draw = lambda: renderer.render(D435I_COLOR_MODES['640x480'], look_at((-1, 0.4, 0.6), (0.6, 0, 0.4))); "
        "draw(); child = os.fork(); draw(); "
        "os._exit(0) if child == 0 else None; "
        "assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_wrong_arguments_are_named():
    scene = SimpleNamespace(shapes=(FLOOR,), edges=())
    with pytest.raises(SpecError, match="'raycast', 'tiny', 'egl'"):
        make_renderer("opengl", scene)
    with pytest.raises(ValueError, match="threads"):
        make_renderer("raycast", scene, threads=0)
    with pytest.raises(ValueError, match="client"):
        make_renderer("tiny", scene)
    with pytest.raises(SpecError, match="kind"):
        draw(Shape("cone", (0, 0, 0), (1, 1, 1)), pose=np.eye(4))
    with pytest.raises(SpecError, match="surface"):
        draw(box_between((0, 0, 0), (1, 1, 1), "cheese"), pose=np.eye(4))


def test_closing_twice_is_fine():
    renderer = make_renderer("raycast", SimpleNamespace(shapes=(FLOOR,), edges=()))
    renderer.close()
    renderer.close()


def test_the_package_is_importable_without_pybullet_and_loads_no_numba():
    code = (
        "import sys; sys.modules['pybullet'] = None; import stair_env.sensors.camera.renderers; "
        "import stair_env.sensors.camera.labels; import stair_env.sensors.camera.renderers.bullet; "
        "assert 'numba' not in sys.modules; "
        "import stair_env.sensors.camera.renderers.raycast"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
