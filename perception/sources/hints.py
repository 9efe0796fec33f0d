"""What looks wrong about a frame, in words: mistakes that would otherwise only show as "no stairs measured".

A hint never changes a result. Each begins with a word that programs can look for.
"""

from __future__ import annotations

import math

import numpy as np

from stair_env.intrinsics import Intrinsics

USUAL_DEPTH_M = (0.12, 12.0)  # the median of an RGB-D frame: a D435i reads from 0.17 m to some 10 m
FLIPPED_RAD = math.radians(115.0)  # between gravity and a level camera's: no camera looks at stairs upside down
USUAL_GRAVITY_M_S2 = (7.0, 13.0)
USUAL_FIELD_RAD = (math.radians(28.0), math.radians(120.0))  # across, of cameras that look at stairs
MAX_FOCAL_RATIO = 1.08  # of fx and fy: pixels are square
MAX_OFF_CENTRE = 0.15  # of the image's side
LEAST_VALID = 0.02  # share of pixels with depth

ASSUMED_D435I = "intrinsics: none given; those of a D435i's colour camera at this size are assumed"
GREY_DEPTH = "depth-8-bit: depth has 256 levels, and how far one is, is stated nowhere; --grey-level METRES says it"
COLOURISED = (
    "depth-colourised: the depth image has three different channels, a colourised picture and no depth; it is left out"
)
SAME_FILE = "same-file: colour and depth are one and the same picture; depth is left out"
SWAPPED = "swapped: the colour image is 16-bit and grey, the depth image has colours; give RGB first, then DEPTH"
NO_DEPTH_FILE = (COLOURISED, SAME_FILE, SWAPPED)  # what was given as depth is none
NO_DEPTH_ADVICE = "save depth as 16-bit png in millimetres (Z16)"


def frame_hints(depth_m: np.ndarray | None, intrinsics: Intrinsics, gravity: np.ndarray | None) -> tuple[str, ...]:
    """Look at one frame.

    Args:
        depth_m: (H, W) metres, 0 = no reading; None without depth.
        intrinsics: of the images.
        gravity: (3,) that is used; None when none is known.

    Returns:
        Hints, none when nothing looks wrong.
    """
    found = [_focal_hint(intrinsics)]
    if depth_m is not None:
        found.append(_unit_hint(depth_m))
    if gravity is not None:
        found.append(_gravity_hint(np.asarray(gravity, np.float64)))
    return tuple(hint for hint in found if hint)


def _unit_hint(depth_m: np.ndarray) -> str:
    valid = depth_m[(depth_m > 0.0) & np.isfinite(depth_m)]
    if valid.size < LEAST_VALID * depth_m.size:
        return f"depth-empty: only {100.0 * valid.size / depth_m.size:.1f} % of the pixels have depth"
    median = float(np.median(valid))
    if USUAL_DEPTH_M[0] <= median <= USUAL_DEPTH_M[1]:
        return ""
    side = "far" if median > USUAL_DEPTH_M[1] else "near"
    return (
        f"depth-unit: the median of the depth is {median:.3g} m, too {side} for stairs; "
        "check the unit (--depth-scale METRES_A_UNIT: 0.001 for millimetres, 0.0002 for TUM)"
    )


def _gravity_hint(gravity: np.ndarray) -> str:
    length = float(np.linalg.norm(gravity))
    if not length > 0.0:
        return ""
    level = -float(gravity[1]) / length
    shown = ", ".join(f"{value:.2f}" for value in gravity)
    if math.acos(min(max(level, -1.0), 1.0)) > FLIPPED_RAD:
        return (
            f"gravity-flipped: ({shown}) is a camera held upside down; an accelerometer at rest reads "
            "against the pull, "
            "(0, -9.8, 0) when level (x right, y down, z forward): change the sign"
        )
    if not USUAL_GRAVITY_M_S2[0] < length < USUAL_GRAVITY_M_S2[1]:
        return f"gravity-unit: ({shown}) is {length:.2f} long, must be some 9.8 m/s^2; only its direction is used"
    return ""


def _focal_hint(intrinsics: Intrinsics) -> str:
    model = intrinsics
    field = model.horizontal_fov_rad
    if not USUAL_FIELD_RAD[0] < field < USUAL_FIELD_RAD[1]:
        return (
            f"focal-length: fx={model.fx:.0f} px sees {math.degrees(field):.0f} degrees across {model.width} px; "
            "is it that of another resolution?"
        )
    ratio = max(model.fx, model.fy) / min(model.fx, model.fy)
    if ratio > MAX_FOCAL_RATIO:
        differ = f"{100 * (ratio - 1):.0f} %"
        return f"focal-length: fx={model.fx:.0f} and fy={model.fy:.0f} px differ by {differ}, but pixels are square"
    off = max(abs(model.cx / model.width - 0.5), abs(model.cy / model.height - 0.5))
    if off > MAX_OFF_CENTRE:
        return (
            f"focal-length: the principal point ({model.cx:.0f}, {model.cy:.0f}) is far from the middle of a "
            f"{model.width}x{model.height} image; are these the intrinsics of another resolution?"
        )
    return ""
