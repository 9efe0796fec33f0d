"""Facts that several packages use, each written down once; importing this loads nothing else.

Compiled kernels keep copies of what they need, since numba compiles values in and watches only the kernel's own file;
`tests/stair_env/common/test_constants.py` compares them.
"""

from __future__ import annotations

from typing import Literal

# Gravity. Three numbers on purpose: they agree to 0.1 % and enter results in different places.
GRAVITY_M_S2 = 9.81  # what physics pulls with, and so what an accelerometer at rest reads
STANDARD_GRAVITY_M_S2 = 9.80665  # one g: the unit of an accelerometer's range, and of the attitude filter's input
NOMINAL_GRAVITY_M_S2 = 9.8  # length of gravity vectors of which only the direction counts, as in the paper
LEVEL_CAMERA_GRAVITY = (0.0, -NOMINAL_GRAVITY_M_S2, 0.0)  # accelerometer at rest in a level camera's axes

# Time: physics runs in steps, of which several make a control step.
PHYSICS_RATE_HZ = 240
SUBSTEPS = 5
CONTROL_DT = SUBSTEPS / PHYSICS_RATE_HZ  # 48 Hz
CONTROL_RATE_HZ = PHYSICS_RATE_HZ / SUBSTEPS
PHYSICS_ENGINES = ("bullet", "mujoco")  # of physics

# Staircases.
RISER_RANGE_M = (0.02, 0.25)  # buildable; real stairs are 0.08-0.20, a curriculum starts lower
TREAD_RANGE_M = (0.15, 0.60)
STEP_COUNT_RANGE = (1, 24)
MEASURABLE_RISER_M = 0.25  # perception takes anything larger for no step
MEASURABLE_TREAD_M = 0.50
PAPER_STAIR_NAMES = ("Stair1", "Stair2", "Stair3", "Stair4", "Stair5", "Stair6")
STAIR_SETS = ("paper", "grid", "random", "ladder")  # from which policies are evaluated

# Directions: of a flight that is walked, of a staircase that is built, and two ways to leave the choice to chance.
WALKING_DIRECTIONS: tuple[Literal["up", "down"], ...] = ("up", "down")
STAIRCASE_DIRECTIONS = ("up", "down", "up_down")  # the last goes up, across a landing, and down
EPISODE_DIRECTIONS = (*WALKING_DIRECTIONS, "both")
SCENE_DIRECTIONS = (*STAIRCASE_DIRECTIONS, "both", "any")  # "both": up or down; "any": all three

# Light: of a scene, and with the choice left to chance or to a film of both.
SCENE_LIGHTINGS = ("day", "night")
LIGHTING_CHOICES = (*SCENE_LIGHTINGS, "random")
DEMO_LIGHTINGS = (*SCENE_LIGHTINGS, "both")

# Where the stair block comes from: in the environment, and in an evaluation.
BLOCK_SOURCES = ("oracle", "noisy", "blind", "shuffled", "external")
EVALUATION_SOURCES = ("oracle", "stairnet", "blind", "shuffled", "gait", "noisy")

# Who walks in a page that is watched: a trained policy, the gait alone, or chance.
WATCHED_AGENTS = ("policy", "zero", "random")

# The camera.
DEPTH_SOURCES = ("model", "stereo")  # exact depth with modelled errors, or matched from a rendered infrared pair
CAMERA_MODES = ("640x480", "848x480", "1280x720")  # of the D435i's colour imager

# StairNetV2.
IMAGE_SIZE = 512  # pixels, side of the input (paper, table 1)
GRID_ROWS = 32  # of the output (paper, table 1)
GRID_COLUMNS = 16
CELL_HEIGHT_PX = IMAGE_SIZE // GRID_ROWS
CELL_WIDTH_PX = IMAGE_SIZE // GRID_COLUMNS
NETWORK_WIDTHS = (1.0, 0.5, 0.25)  # channel width factors of the three published versions (paper, table 4)
FUSION_STAGES = (2, 3, 4)  # down-samplings before colour and depth are fused (paper, table 2)
TRAINING_PRESETS = ("fast", "paper", "robust")
TRAINING_PRECISIONS = ("32-true", "bf16-mixed")  # Lightning's names of float32 and bfloat16
BACKENDS = ("onnx", "torch", "openvino", "onnx-cuda", "onnx-tensorrt", "torch-cuda")
EXPORTED_BACKENDS = ("onnx", "openvino", "onnx-cuda", "onnx-tensorrt")  # those that read .onnx files
GPU_BACKENDS = ("onnx-cuda", "onnx-tensorrt", "torch-cuda")  # those that need a graphics card

# Measuring stairs.
GEOMETRY_METHODS = ("planes", "paper")
MEASURED_DETECTORS = ("stairnet", "ideal")  # "ideal": true lines, the floor of the geometry
WALK_DRIVERS = ("tracked", "true")  # what the gait of a measured walk reads

# Policies.
ALGORITHMS = ("ppo", "sac")
VEC_KINDS = ("auto", "subproc", "dummy", "workers")
