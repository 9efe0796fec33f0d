"""Where a stereo camera finds no depth, or a false one: probabilities by cells of the image."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from stair_env.sensors.camera.depth_error import DepthErrorConfig
    from stair_env.sensors.camera.depth_model.depth_unit import DepthUnit

DARK_FRAME_LEVEL = 12.0  # mean of 0-255 up to which brightness says nothing about reflectance
LIT_FRAME_LEVEL = 80.0  # and from which it is taken at its word
DARK_SURFACE_SHARE = 0.25  # of the frame's mean level, under which a surface returns less of the pattern
FULL_TEXTURE_LEVEL = 6.0  # contrast of 0-255 from which matching needs no pattern
MAX_DROP_PROBABILITY = 0.97
SHARP_BEND_PX = 0.5  # second difference of disparity over cells from which a crease costs matches in full
TEXTURE_HELPS = 0.7  # share of those losses that full texture saves


def hole_corners(config: DepthErrorConfig, unit: DepthUnit, statistics: np.ndarray) -> np.ndarray:
    """Probabilities of a hole and of a band lost along the rows, at the corners of the cells.

    Args:
        config: what is wrong with the depth.
        unit: of the camera, in its light.
        statistics: (4, h, w) float32 of the cells, see `scene_kernels.see_rows`.

    Returns:
        (2, h + 1, w + 1) float32: holes, bands.
    """
    level, texture, glare, mean = statistics
    config_sum = config.speckle + config.textureless_dropout + config.dark_dropout + config.specular_dropout
    if config_sum + config.lost_treads == 0.0:
        rows, columns = level.shape
        return np.zeros((2, rows + 1, columns + 1), np.float32)
    focal_baseline = np.float32(config.focal_px * config.baseline_m)
    corners = np.empty((2, level.shape[0] + 1, level.shape[1] + 1), np.float32)
    _corner_means(hole_probability(config, level, texture, glare, mean / focal_baseline, unit.reach), corners[0])
    _corner_means(lost_probability(config, unit.severity, texture, mean), corners[1])
    return corners


def lost_probability(
    config: DepthErrorConfig, severity: float, texture: np.ndarray, disparity: np.ndarray
) -> np.ndarray:
    """How likely a band along the rows is lost.

    Rows are matched with rows. Where a surface bends across them, as at a nosing or an inner edge, a window holds two
    slants and no disparity fits it; what tells positions along the row apart must come from texture or pattern.

    Args:
        config: its `lost_treads` is the probability at a sharp bend without texture.
        severity: factor on it.
        texture: (h, w) horizontal contrast of the cells, 0-255.
        disparity: (h, w) their mean, depth-imager pixels.

    Returns:
        (h, w) float32, at most MAX_DROP_PROBABILITY.
    """
    bend = np.zeros_like(disparity)
    bend[1:-1] = np.abs(disparity[:-2] + disparity[2:] - 2.0 * disparity[1:-1])
    plain = 1.0 - TEXTURE_HELPS * np.minimum(texture / FULL_TEXTURE_LEVEL, 1.0)
    lost = config.lost_treads * severity * np.minimum(bend / SHARP_BEND_PX, 1.0) * plain
    return np.minimum(lost, MAX_DROP_PROBABILITY).astype(np.float32)


def hole_probability(
    config: DepthErrorConfig,
    level: np.ndarray,
    texture: np.ndarray,
    glare: np.ndarray,
    inverse_depth: np.ndarray,
    reach_factor: float = 1.0,
) -> np.ndarray:
    """How likely matching fails.

    Texture of the surface and the projected pattern each suffice on their own; the pattern fades with the square of
    the distance and on dark surfaces, which is why near ones keep their depth by night. The form and its constants are
    choices of this project, made by eye: nobody has published them.

    Args:
        config: the probabilities and the projector's range.
        level: brightness, 0-255, any shape.
        texture: horizontal contrast, 0-255.
        glare: share of saturated pixels.
        inverse_depth: 1 / metres, 0 for nothing there.
        reach_factor: on the projector's range, below 1 where other light washes the pattern out.

    Returns:
        Probabilities of the same shape, float32, at most MAX_DROP_PROBABILITY.
    """
    reflectance = _reflectance(level)
    reach = np.minimum(
        reach_factor * config.projector_range_m * inverse_depth, 1e3
    )  # the bound keeps its square finite
    pattern = np.minimum(reflectance * reach**2, 1.0)
    own = np.minimum(texture / FULL_TEXTURE_LEVEL, 1.0)
    unmatched = (1.0 - own) * (1.0 - pattern)
    probability = (
        config.speckle
        + config.textureless_dropout * unmatched**2
        + config.dark_dropout * (1.0 - reflectance) / np.maximum(reach, 1.0)
        + config.specular_dropout * glare
    )
    return np.minimum(probability, MAX_DROP_PROBABILITY).astype(np.float32)


def _reflectance(level: np.ndarray) -> np.ndarray:
    """Share of the pattern that a surface returns, guessed from its brightness (0-255) among the frame's, 0..1.

    The darker the frame, the more a dark surface is one without light rather than one without reflectance.
    """
    frame_level = max(float(level.mean()), 1e-6)
    trust = min(max((frame_level - DARK_FRAME_LEVEL) / (LIT_FRAME_LEVEL - DARK_FRAME_LEVEL), 0.0), 1.0)
    return 1.0 - trust * (1.0 - np.minimum(level / (DARK_SURFACE_SHARE * frame_level), 1.0))


def _corner_means(cells: np.ndarray, out: np.ndarray) -> None:
    """Fill out (h + 1, w + 1) with the means of the cells (h, w) around each corner."""
    height, width = cells.shape
    padded = np.empty((height + 2, width + 2), np.float32)  # by hand: np.pad takes as long as all the rest
    padded[1:-1, 1:-1] = cells
    padded[0, 1:-1], padded[-1, 1:-1] = cells[0], cells[-1]
    padded[:, 0], padded[:, -1] = padded[:, 1], padded[:, -2]
    np.add(padded[:-1, :-1], padded[1:, :-1], out=out)
    out += padded[:-1, 1:]
    out += padded[1:, 1:]
    out *= np.float32(0.25)
