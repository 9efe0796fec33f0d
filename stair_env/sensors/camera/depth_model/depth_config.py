"""Settings of the fast depth model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from stair_env.common.validation import JsonSpec, SpecError, check_flags, check_limits
from stair_env.sensors.camera.depth_model.depth_noise import check_window


@dataclass(frozen=True)
class DepthErrorConfig(JsonSpec):
    """What is wrong with the depth; the defaults are a D435i at 848x480, aligned to colour.

    Args:
        focal_px: focal length of the depth imagers, pixels (data sheet: 87 degrees over 848 pixels).
        baseline_m: between the infrared imagers, metres (data sheet).
        disparity_noise_px: RMS error of the disparity; depth is off by Z^2 s / (f B) (Intel's tuning guide: 0.08 for a
            well-textured target).
        disparity_quantum_px: step of the disparity (1/32: the D4 processor's subpixel resolution), 0 for none.
        depth_unit_m: step of the reported depth (16-bit millimetres), 0 for none.
        scale_bias: relative depth error of this unit before `reset`; 0.01 reads one per cent too far.
        scale_bias_range: `reset` draws the unit's bias evenly within plus and minus this (up to 0.02 uncalibrated).
        occlusion_shadow: lose what the right imager cannot see.
        colour_parallax: lose what the left imager cannot see from 15 mm beside the colour imager.
        flying_share: share of pixels on depth edges that report a mixture of both sides.
        fattened_share: share of those that report the near side.
        edge_jitter_px: standard deviation of an edge's position, pixels of the depth imager.
        window_px: side of the stereo matcher's window, pixels of the depth imager.
        crease_window_px: side of the window that rounds creases, pixels of the depth imager; [low, high], drawn by
            `reset`. (1, 1) keeps them sharp.
        structured_px: standard deviation of an error that varies over a tenth of the image and stays with the unit,
            pixels of disparity.
        still_share: share of the noise's variance that stays from frame to frame before a standing camera.
        single_holes: share of pixels lost one by one.
        lost_treads: probability that a band along the rows is lost where a surface bends and has no texture; `reset`
            draws a factor of 0 to 2 on it.
        false_patches: share of pixels in patches that report too near a distance; lost bands hold more of them.
        focal_error_range: `reset` draws by how much the depth image is too large, relative, plus and minus this.
        misalignment_px: `reset` draws a shift against colour within plus and minus this, pixels of the depth imager.
        filters: the SDK's post-processing is on: less noise, no single holes, rounder creases.
        speckle: share of pixels lost in small blobs everywhere.
        textureless_dropout: probability of a hole where there is neither texture nor pattern.
        dark_dropout: additional probability on far surfaces much darker than the scene, less on near ones.
        specular_dropout: additional probability on saturated highlights.
        projector_range_m: distance up to which the infrared pattern alone suffices; 0 turns the projector off.
        min_range_m, max_range_m: readings outside are dropped (data sheet: 0.18 m at 848x480, about 10 m).

    Raises:
        SpecError: a field is out of range (a ValueError).
    """

    ARGUMENT = "depth_error"

    focal_px: float = 447.0
    baseline_m: float = 0.050
    disparity_noise_px: float = 0.08
    disparity_quantum_px: float = 1.0 / 32.0
    depth_unit_m: float = 0.001
    scale_bias: float = 0.0
    scale_bias_range: float = 0.005
    occlusion_shadow: bool = True
    colour_parallax: bool = True
    flying_share: float = 0.25
    edge_jitter_px: float = 0.7
    fattened_share: float = 0.2
    window_px: float = 5.0
    crease_window_px: tuple[float, float] = (9.0, 21.0)
    structured_px: float = 0.08
    still_share: float = 0.6
    single_holes: float = 0.003
    lost_treads: float = 0.4
    false_patches: float = 0.002
    focal_error_range: float = 0.003
    misalignment_px: float = 1.5
    filters: bool = False
    speckle: float = 0.004
    textureless_dropout: float = 0.9
    dark_dropout: float = 0.35
    specular_dropout: float = 0.6
    projector_range_m: float = 3.5
    min_range_m: float = 0.18
    max_range_m: float = 10.0

    def __post_init__(self) -> None:
        check_limits(self, _LIMITS)
        check_flags(self, "occlusion_shadow", "colour_parallax", "filters")
        if self.min_range_m >= self.max_range_m:
            raise SpecError(f"min_range_m={self.min_range_m!r} must be below max_range_m={self.max_range_m!r}")
        object.__setattr__(self, "crease_window_px", check_window("crease_window_px", self.crease_window_px))

    @classmethod
    def ideal(cls) -> DepthErrorConfig:
        """Nothing is wrong: depth passes through unchanged."""
        off: dict[str, Any] = dict.fromkeys(_ERROR_FIELDS, 0.0)
        return cls(occlusion_shadow=False, colour_parallax=False, crease_window_px=(1.0, 1.0), max_range_m=1e6, **off)


_ERROR_FIELDS = (
    "disparity_noise_px",
    "disparity_quantum_px",
    "depth_unit_m",
    "scale_bias",
    "scale_bias_range",
    "flying_share",
    "fattened_share",
    "edge_jitter_px",
    "structured_px",
    "single_holes",
    "lost_treads",
    "false_patches",
    "focal_error_range",
    "misalignment_px",
    "speckle",
    "textureless_dropout",
    "dark_dropout",
    "specular_dropout",
    "min_range_m",
)
_LIMITS: dict[str, tuple[float, float]] = {
    "focal_px": (50.0, 2000.0),
    "baseline_m": (0.01, 0.5),
    "disparity_noise_px": (0.0, 2.0),
    "disparity_quantum_px": (0.0, 1.0),
    "depth_unit_m": (0.0, 0.01),
    "scale_bias": (-0.1, 0.1),
    "scale_bias_range": (0.0, 0.1),
    "flying_share": (0.0, 1.0),
    "edge_jitter_px": (0.0, 5.0),
    "window_px": (1.0, 31.0),
    "fattened_share": (0.0, 1.0),
    "structured_px": (0.0, 2.0),
    "still_share": (0.0, 1.0),
    "single_holes": (0.0, 0.5),
    "lost_treads": (0.0, 1.0),
    "false_patches": (0.0, 0.5),
    "focal_error_range": (0.0, 0.05),
    "misalignment_px": (0.0, 10.0),
    "speckle": (0.0, 0.5),
    "textureless_dropout": (0.0, 1.0),
    "dark_dropout": (0.0, 1.0),
    "specular_dropout": (0.0, 1.0),
    "projector_range_m": (0.0, 20.0),
    "min_range_m": (0.0, 2.0),
    "max_range_m": (0.5, 1e6),
}
