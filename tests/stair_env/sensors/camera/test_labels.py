from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stair_env.common.transforms import look_at
from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env.sampling import Scene, SceneSampler, sample_camera_pose
from stair_env.scene.shapes import Shape, box_between, build_stair_shapes
from stair_env.sensors.camera.labels import LineLabel, clip_to_view, gap_px, visible_edges
from stair_env.sensors.camera.renderers import make_renderer
from stair_env.stairs import StairSpec

INTRINSICS = D435I_COLOR_MODES["640x480"].letterboxed(512)


def scene_of(*extra: Shape, **spec):
    stairs = StairSpec(**spec)
    return SimpleNamespace(shapes=(*build_stair_shapes(stairs), *extra), edges=stairs.edges(), stairs=stairs)


def labels_of(scene, pose, moving=(), intrinsics=INTRINSICS):
    frame = make_renderer("raycast", scene, threads=1).render(intrinsics, pose, moving=moving)
    return visible_edges(scene.edges, intrinsics, pose, frame)


def kinds_of(labels):
    return {label.kind for label in labels}


@settings(max_examples=12, deadline=None)
@given(
    riser=st.floats(0.08, 0.2),
    tread=st.floats(0.24, 0.36),
    distance=st.floats(0.7, 1.6),
    height=st.floats(0.35, 0.6),
    yaw=st.floats(-0.3, 0.3),
    roll=st.floats(-0.15, 0.15),
)
def test_going_up_the_nearest_nosing_and_inner_edge_are_seen_where_they_project(
    riser, tread, distance, height, yaw, roll
):
    scene = scene_of(riser_height=riser, tread_depth=tread)
    eye = np.array([-distance, 0.0, height])
    pose = look_at(eye, eye + np.array([np.cos(yaw), np.sin(yaw), -0.55]), roll)
    labels = labels_of(scene, pose)
    assert kinds_of(labels) == {"convex", "concave"}
    for label in labels:
        edge = next(edge for edge in scene.edges if (edge.kind, edge.step) == (label.kind, label.step))
        ends = INTRINSICS.project(clip_to_view((edge.endpoints - pose[:3, 3]) @ pose[:3, :3], INTRINSICS))
        along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        for point in ([label.x1, label.y1], [label.x2, label.y2]):
            relative = np.array(point) - ends[0]
            assert abs(relative[0] * along[1] - relative[1] * along[0]) < 1e-6  # on the projected edge
    assert next(label for label in labels if label.kind == "convex" and label.step == 0).length > 150


@settings(max_examples=12, deadline=None)
@given(
    riser=st.floats(0.08, 0.2),
    tread=st.floats(0.24, 0.36),
    distance=st.floats(0.4, 1.2),
    height=st.floats(0.35, 0.6),
    yaw=st.floats(-0.3, 0.3),
)
def test_going_down_inner_edges_stay_hidden(riser, tread, distance, height, yaw):
    scene = scene_of(direction="down", riser_height=riser, tread_depth=tread, side_walls="both")
    eye = np.array([-distance, 0.0, scene.stairs.total_height + height])
    labels = labels_of(scene, look_at(eye, eye + np.array([np.cos(yaw), np.sin(yaw), -0.55])))
    assert kinds_of(labels) == {"convex"}


def test_a_box_in_front_hides_everything_behind_it():
    pose = look_at((-1.0, 0.0, 0.5), (0.5, 0.0, 0.2))
    blind = box_between((-0.7, -2.0, 0.0), (-0.6, 2.0, 2.0), "wall")
    assert labels_of(scene_of(), pose)
    assert labels_of(scene_of(blind), pose) == []


def test_the_longer_visible_part_is_kept():
    pose = look_at((-1.0, 0.0, 0.5), (0.5, 0.0, 0.2))
    plank = box_between((-0.5, -0.2, 0.0), (-0.45, 0.0, 2.0), "wall")  # right of the middle, y is left
    before = {(label.kind, label.step): label for label in labels_of(scene_of(), pose)}
    after = labels_of(scene_of(plank), pose)
    label = next(label for label in after if label.kind == "convex" and label.step == 0)
    assert label.x1 == pytest.approx(before["convex", 0].x1)
    assert label.x2 < 262  # the plank's left side is at the middle of the image


def test_a_thin_post_does_not_cut_a_line():
    pose = look_at((-1.0, 0.0, 0.5), (0.5, 0.0, 0.2))
    post = Shape("cylinder", (-0.2, 0.05, 0.5), (0.015, 0.5, 0.0), surface="rail")
    before = {(label.kind, label.step): label.length for label in labels_of(scene_of(), pose)}
    after = {(label.kind, label.step): label.length for label in labels_of(scene_of(post), pose)}
    assert before["convex", 0] == pytest.approx(after["convex", 0])


def test_moving_shapes_hide_edges_too():
    pose = look_at((-1.0, 0.0, 0.5), (0.5, 0.0, 0.2))
    wall = Shape("box", (-0.6, 0.0, 1.0), (0.05, 3.0, 1.0), surface="robot")
    assert labels_of(scene_of(), pose, moving=(wall,)) == []


def test_edges_behind_the_camera_have_no_label():
    assert labels_of(scene_of(), look_at((-1.0, 0.0, 0.5), (-3.0, 0.0, 0.4))) == []


def test_standing_on_the_flight_edges_that_pass_the_image_plane_are_clipped():
    scene = scene_of(num_steps=8)
    labels = labels_of(scene, look_at((0.65, 0.0, 0.45 + 0.5), (1.2, 1.0, 0.6)))  # askew: edges run past the camera
    assert labels
    for label in labels:
        assert 0 <= label.x1 <= label.x2 <= INTRINSICS.width
        assert 0 <= min(label.y1, label.y2) <= max(label.y1, label.y2) <= INTRINSICS.height


def test_far_stairs_have_no_lines_to_tell_apart():
    scene = scene_of(num_steps=12, riser_height=0.05)
    assert labels_of(scene, look_at((-40.0, 0.0, 2.0), (0.0, 0.0, 0.3))) == []


def test_kept_nosings_are_apart():
    scene = scene_of(num_steps=12, riser_height=0.08)
    labels = labels_of(scene, look_at((-2.0, 0.3, 1.0), (0.6, 0.0, 0.3)))
    nosings = [label for label in labels if label.kind == "convex"]
    assert len(nosings) > 4
    assert min(gap_px(a, b) for a in nosings for b in nosings if a is not b) >= 3.0


def test_in_line_with_all_nosings_only_the_nearest_is_told():
    scene = scene_of(direction="down", num_steps=6, riser_height=0.125, tread_depth=0.25)
    eye = (-1.0, 0.0, scene.stairs.total_height + 0.5)  # on the line through the nosings
    labels = labels_of(scene, look_at(eye, (0.25, 0.0, scene.stairs.total_height - 0.125)))
    assert [(label.kind, label.step) for label in labels] == [("convex", 0)]


def test_gap_of_parallel_lines_and_of_lines_side_by_side():
    base = LineLabel("convex", 0.0, 10.0, 100.0, 10.0)
    assert gap_px(base, LineLabel("convex", 50.0, 14.0, 90.0, 14.0)) == pytest.approx(4.0)
    assert gap_px(base, LineLabel("convex", 110.0, 10.0, 150.0, 10.0)) == np.inf


def test_labels_are_validated():
    with pytest.raises(ValueError, match="kind"):
        LineLabel("flat", 0, 0, 1, 1)
    with pytest.raises(ValueError, match="x1"):
        LineLabel("convex", 2, 0, 1, 1)
    assert LineLabel("concave", 0, 0, 3, 4).class_id == 1
    assert LineLabel("concave", 0, 0, 3, 4).length == 5


def test_a_frame_of_another_size_is_refused():
    scene, pose = scene_of(), look_at((-1.0, 0.0, 0.5), (0.5, 0.0, 0.2))
    frame = make_renderer("raycast", scene).render(INTRINSICS.scaled(256, 256), pose)
    with pytest.raises(ValueError, match="512"):
        visible_edges(scene.edges, INTRINSICS, pose, frame)


@pytest.mark.parametrize("seed", range(6))
def test_labels_agree_with_rods_laid_along_the_edges(seed):
    # Independent of the labels' own reasoning: a thin rod on every edge is drawn, and counted.
    rng = np.random.default_rng(seed)
    spec = SceneSampler(lighting="day").sample(rng)
    scene = Scene(spec)
    pose = sample_camera_pose(spec, rng)
    renderer = make_renderer("raycast", scene, threads=1, shadows=False, antialias=False)
    frame = renderer.render(INTRINSICS, pose)
    kept = {(label.kind, label.step): label for label in visible_edges(scene.edges, INTRINSICS, pose, frame)}
    crowded = visible_edges(scene.edges, INTRINSICS, pose, frame, min_gap_px=0.0)
    found = {(label.kind, label.step) for label in crowded}
    rods = [rod_along(edge) for edge in scene.edges]
    rod_numbers = renderer.render(INTRINSICS, pose, moving=rods).segmentation - len(scene.shapes)
    for index, edge in enumerate(scene.edges):
        name = (edge.kind, edge.step)
        pixels = np.argwhere(rod_numbers == index)
        seen_px = max((len(np.unique(axis)) for axis in pixels.T), default=0)
        if name in kept:
            assert seen_px > 0.3 * max(kept[name].x2 - kept[name].x1, abs(kept[name].y2 - kept[name].y1))
        elif name not in found:
            assert seen_px < 40


def rod_along(edge):
    across = (0.5**0.5, 0.0, 0.0, 0.5**0.5)  # turns z to y
    middle = (edge.x, (edge.y_left + edge.y_right) / 2, edge.z)
    return Shape("cylinder", middle, (0.004, (edge.y_left - edge.y_right) / 2, 0.0), across, surface="rail")
