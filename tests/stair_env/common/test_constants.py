"""Sets that are written down once agree with what is built by their names."""

from __future__ import annotations

import subprocess
import sys
from typing import get_args

import pytest

from perception.geometry import line_kernels
from perception.learning.presets import PRESETS, Precision
from policies.evaluate.demo_flights import DemoConfig
from policies.evaluate.evaluation import SOURCE_SETUPS
from stair_env.common import constants
from stair_env.intrinsics import D435I_COLOR_MODES
from stair_env.sampling import DIRECTION_CHOICES
from stair_env.scene.appearance import Lighting
from stair_env.scene.paper_stairs import PAPER_STAIRS
from stair_env.stairs import Direction, WalkingDirection
from stair_env.task.sources import make_source


def test_importing_them_loads_nothing_heavy() -> None:
    code = "import sys, stair_env.common.constants; assert not {'torch', 'numba', 'cv2', 'scipy'} & set(sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@pytest.mark.parametrize(
    ("names", "built"),
    [
        (constants.CAMERA_MODES, D435I_COLOR_MODES),
        (constants.EVALUATION_SOURCES, SOURCE_SETUPS),
        (constants.PAPER_STAIR_NAMES, tuple(stair.name for stair in PAPER_STAIRS)),
        (constants.SCENE_DIRECTIONS, DIRECTION_CHOICES),
        (constants.SCENE_LIGHTINGS, get_args(Lighting)),
        (constants.STAIRCASE_DIRECTIONS, get_args(Direction)),
        (constants.TRAINING_PRECISIONS, get_args(Precision)),
        (constants.TRAINING_PRESETS, PRESETS),
        (constants.WALKING_DIRECTIONS, get_args(WalkingDirection)),
    ],
)
def test_names_and_what_they_name_agree(names: tuple[str, ...], built: object) -> None:
    assert set(names) == set(built) and len(set(names)) == len(names)  # type: ignore[call-overload]


def test_every_source_of_the_block_can_be_made() -> None:
    for name in constants.BLOCK_SOURCES:
        make_source(name)


def test_every_demo_can_be_asked_for() -> None:
    for lighting in constants.DEMO_LIGHTINGS:
        for direction in constants.EPISODE_DIRECTIONS:
            assert DemoConfig(lighting=lighting, direction=direction).flight(0)


def test_kernels_hold_the_same_grid() -> None:
    assert line_kernels.COLUMNS == constants.GRID_COLUMNS
    assert line_kernels.COLUMN_WIDTH_PX == constants.CELL_WIDTH_PX
    assert line_kernels.MIDDLE_PX == constants.IMAGE_SIZE / 2


def test_gravities_differ_by_less_than_measurements_do() -> None:
    values = (constants.GRAVITY_M_S2, constants.STANDARD_GRAVITY_M_S2, constants.NOMINAL_GRAVITY_M_S2)
    assert max(values) - min(values) <= 0.011
