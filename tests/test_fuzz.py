"""Whatever is passed or read: a named error or a right answer."""

from __future__ import annotations

import dataclasses
import inspect
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from perception.data.frame_files import FrameOptions, read_frame
from perception.data.label_grid import read_label_file
from perception.data.stair_dataset import read_depth, read_side_car
from perception.inference.weights import WEIGHTS_DIR, load_network
from perception.lens.calibration_files import read_extrinsics, read_lens
from perception.sources.depth_files import read_depth_file
from policies.evaluate.evaluation import EvaluationConfig
from policies.hyperparams import load_hyperparams
from policies.train.training import TrainingConfig
from stair_env.common.images import write_image
from stair_env.env import StairClimbEnv
from stair_env.intrinsics import Intrinsics
from stair_env.robots import get_robot
from stair_env.sampling import SceneSpec
from stair_env.sensors.camera.sensor import CameraConfig
from stair_env.stairs import StairSpec

NUMBERS = st.one_of(st.integers(-(10**20), 10**20), st.floats(), st.sampled_from([0, 1, -1, 0.1, 0.17, 0.3, 5]))
SIMPLE = st.one_of(st.none(), st.booleans(), NUMBERS, st.text(max_size=4), st.binary(max_size=3))
VALUES = st.recursive(
    SIMPLE,
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=6), inner, max_size=2)),
    max_leaves=6,
)
JSON = st.recursive(
    st.one_of(st.none(), st.booleans(), NUMBERS, st.text(max_size=4)),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=6), inner, max_size=2)),
    max_leaves=6,
)
CLIMB = tuple(inspect.signature(StairClimbEnv).parameters)
CAMERA = tuple(field.name for field in dataclasses.fields(CameraConfig))
STAIRS = ("direction", "riser_height", "tread_depth", "num_steps", "flight_width", "landing_depth", "riser_offsets")
TOLD = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def some_of(names: tuple[str, ...] | list[str]) -> st.SearchStrategy[dict[str, Any]]:
    return st.dictionaries(st.sampled_from(list(names)), VALUES, max_size=3)


@TOLD
@given(some_of(CLIMB))
def test_arguments_of_an_environment(arguments: dict[str, Any]) -> None:
    try:
        env = StairClimbEnv(**arguments)
    except ValueError as error:
        assert any(name in str(error) for name in (*arguments, "field")), error
    else:
        env.close()


@TOLD
@given(some_of(CAMERA))
def test_options_of_a_camera(options: dict[str, Any]) -> None:
    try:
        config = CameraConfig.from_dict(options)
    except ValueError as error:
        assert str(error)
    else:
        assert CameraConfig.from_dict(config.to_dict()) == config


@TOLD
@given(some_of(STAIRS))
def test_stairs_from_a_dict(fields: dict[str, Any]) -> None:
    try:
        spec = StairSpec.from_dict(fields)
    except ValueError as error:
        assert str(error)
    else:
        assert StairSpec.from_json(spec.to_json()) == spec and np.isfinite(spec.profile().edge_x).all()


@TOLD
@given(JSON)
def test_scenes_from_json(value: Any) -> None:
    with pytest.raises(ValueError):
        SceneSpec.from_json(json.dumps(value))


@TOLD
@given(st.lists(VALUES, min_size=6, max_size=6))
def test_intrinsics(values: list[Any]) -> None:
    try:
        assert Intrinsics(*values).fx > 0
    except ValueError as error:
        assert str(error)


@TOLD
@given(VALUES)
def test_names(value: Any) -> None:
    for call in (
        get_robot,
        lambda name: EvaluationConfig(sources=("gait",), robot="" if name is None else name),  # None: the policy's
        lambda name: TrainingConfig(name),
    ):
        with pytest.raises(ValueError):
            call(value)


@TOLD
@given(st.dictionaries(st.sampled_from(["stairs", "x", "y", "yaw", "z", ""]), VALUES, min_size=1, max_size=3))
def test_options_of_a_reset(options: dict[str, Any]) -> None:
    from stair_env.task.spawn import read_reset_options

    try:
        _, start = read_reset_options(options)
    except ValueError as error:
        assert str(error)
    else:
        assert np.isfinite(list(start.values())).all()


@TOLD
@given(st.one_of(st.binary(max_size=60), JSON.map(lambda value: json.dumps(value).encode())))
def test_files_of_text(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "file.txt"
    path.write_bytes(content)
    for read in (read_label_file, read_side_car, lambda file: load_hyperparams("ppo", "stair_env/StairClimb-v0", file)):
        try:
            read(path)
        except ValueError as error:
            assert "file.txt" in str(error)


@TOLD
@given(st.dictionaries(st.sampled_from(["fx", "fy", "cx", "cy", "gravity", "depth_scale"]), JSON, max_size=6))
def test_side_cars_of_a_frame(tmp_path: Path, values: dict[str, Any]) -> None:
    colour, depth = tmp_path / "frame.png", tmp_path / "depth.png"
    if not colour.exists():
        write_image(colour, np.zeros((12, 16, 3), np.uint8))
        write_image(depth, np.zeros((12, 16), np.uint16))
    (tmp_path / "frame.json").write_text(json.dumps(values))
    try:
        frame = read_frame(colour, depth, FrameOptions())
    except ValueError as error:
        assert "frame" in str(error)
    else:
        assert np.isfinite(frame.depth_m).all() and np.isfinite(frame.gravity).all()


@pytest.mark.parametrize("tenth", range(10))
def test_weights_that_are_cut_are_told(tenth: int, tmp_path: Path) -> None:
    for suffix in ("safetensors", "json"):
        content = (WEIGHTS_DIR / f"stairnetv2_025.{suffix}").read_bytes()
        cut = content[: len(content) * tenth // 10] if suffix == "safetensors" else content
        (tmp_path / f"stairnetv2_025.{suffix}").write_bytes(cut)
    with pytest.raises(ValueError, match=r"stairnetv2_025"):
        load_network(0.25, tmp_path)


def test_a_colourised_picture_is_no_depth(tmp_path: Path) -> None:
    depth = np.tile(np.linspace(0, 255, 64).astype(np.uint8), (48, 1))
    for name, image in (("grey", cv2.cvtColor(depth, cv2.COLOR_GRAY2BGR)), ("colour", cv2.applyColorMap(depth, 4))):
        write_image(tmp_path / f"{name}.png", image)
    assert read_depth(tmp_path / "grey.png").shape == depth.shape
    with pytest.raises(ValueError, match=r"colour.png: three different channels"):
        read_depth(tmp_path / "colour.png")


@pytest.mark.parametrize("ending", ["png", "jpg", "tiff", "pgm", "npy"])
def test_depth_files_that_are_cut_or_written_over_are_told_or_read(ending: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    path, depth = tmp_path / f"depth.{ending}", rng.integers(500, 3000, (40, 60)).astype(np.uint16)
    if ending == "npy":
        np.save(path, depth)
    else:
        write_image(path, (depth // 16).astype(np.uint8) if ending == "jpg" else depth)
    content = path.read_bytes()
    cut = [content[: len(content) * tenth // 10] for tenth in range(10)]
    spots = rng.integers(len(content), size=10)
    for broken in (*cut, *(content[:at] + rng.bytes(9) + content[at + 9 :] for at in spots)):
        path.write_bytes(broken)
        try:
            read = read_depth_file(path)
        except ValueError as error:
            assert path.name in str(error)
        else:
            assert read.depth_m is None or np.isfinite(read.depth_m).all()


@pytest.mark.parametrize("ending", ["json", "yaml"])
@TOLD
@given(content=st.one_of(st.binary(max_size=60), JSON.map(lambda value: json.dumps(value).encode())))
def test_files_of_a_camera(ending: str, tmp_path: Path, content: bytes) -> None:
    path = tmp_path / f"camera.{ending}"
    path.write_bytes(content)
    for read in (lambda file: read_lens(file, 640, 480), read_extrinsics):
        try:
            read(path)
        except ValueError as error:
            assert path.name in str(error)


@TOLD
@given(
    st.dictionaries(
        st.sampled_from(["K", "k", "camera_matrix", "fx", "fy", "cx", "cy", "ppx", "coeffs", "model", "width", "D"]),
        JSON,
    )
)
def test_lenses_from_any_values(tmp_path: Path, values: dict[str, Any]) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(values))
    try:
        assert read_lens(path, 640, 480).intrinsics.fx > 0
    except ValueError as error:
        assert "camera.json" in str(error)
