"""Settings of the stereo depth sensor: projector, imagers, matcher, post-processing."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stair_env.common.validation import JsonSpec, SpecError, check_choice, check_limits, check_range
from stair_env.intrinsics import D435I_DEPTH_MODES, Intrinsics

MATCHERS: tuple[str, ...] = ("sgbm", "bm")
HOLE_FILLINGS: tuple[str, ...] = ("none", "left", "far", "near")  # librealsense's three modes, and none


@dataclass(frozen=True)
class StereoConfig(JsonSpec):
    """An active infrared stereo camera; the defaults are a D435i at 848x480 with the SDK's filters off.

    Args:
        mode: size of the infrared images, one of `D435I_DEPTH_MODES`.
        baseline_m: between the infrared imagers, metres (data sheet).
        projector_power: infrared irradiance in the middle of a dot at 1 m; 0 turns the projector off.
        dots: of the projected pattern, over its whole field.
        dot_width_px: standard deviation of a dot, pixels of an imager of 447 px focal length.
        ambient_gain: infrared light of a white sheet, in units of the projector's, for a colour image whose linear
            brightness is 1; [low, high], drawn evenly in its logarithm at each `reset`. Lamps lie near 0.3, the sun
            near 20 and washes the pattern out.
        infrared_contrast: exponent on brightness between the colour image and the infrared one: dyes that differ to the
            eye hardly differ in near infrared, so that plain floors stay plain; 1 keeps the colours' contrast.
        exposure_limit: largest factor from light to image, before gain.
        gain_limit: largest gain after it.
        read_noise, shot_noise: standard deviation of the noise at no light, and its growth with the root of the light;
            full scale is 1.
        speckle: relative standard deviation of the laser's speckle, different for the two imagers.
        vignetting: loss of light in the corners, 0 to 1.
        fixed_pattern: relative standard deviation of the pixels' sensitivity, the same in every frame of a unit.
        lens_blur_px: standard deviation of the imagers' blur, pixels.
        rectification_error_px: standard deviation of the rows' misalignment that calibration leaves, pixels.
        disparity_error_px: standard deviation of the slowly varying disparity error that it leaves, pixels.
        matcher: "bm" (windows only) or "sgbm" (semi-global), OpenCV's. Windows leave what real frames leave: creases
            rounded over the window and bands missing along them. Semi-global matching with little smoothness leaves
            small holes everywhere; with much it fills them and is too good to be true.
        max_disparity_px: largest disparity searched, a multiple of 16; 128 at 848x480 reaches down to 0.17 m.
        block_px: side of the matching window, odd, pixels.
        smoothness: "sgbm"'s penalties for a change of disparity by one and by more, per pixel of the window.
        uniqueness: per cent by which the best match must beat the second.
        speckle_px, speckle_range_px: blobs smaller than so many pixels within which the disparity changes by no more
            than this are dropped; 0 keeps them.
        left_right_px: largest disagreement between matching left to right and back, pixels; -1 does not check.
        texture_threshold: mean horizontal contrast within the window, of 255, below which nothing is matched.
        decimation: side of the squares that are merged into one reading (SDK: 2 to 8), 1 for none.
        spatial_alpha: weight of the reading itself in the SDK's edge-preserving filter (SDK: 0.5); 1 turns it off.
        spatial_delta_px: step of disparity from which that filter, and the temporal one, sees an edge (SDK: 20/32).
        spatial_passes: how often it runs (SDK: 2).
        temporal_alpha: weight of the new frame in the temporal filter (SDK: 0.4); 1 turns it off.
        persistency: the temporal filter's rule for missing readings, 0 to 8 as the SDK numbers them: 0 leaves them
            missing, 3 (SDK's default) takes the last one if 2 of the last 4 frames had one, 8 always takes it.
        hole_filling: "none", "left" (reading to the left), "far" or "near" (farthest or nearest around).
        min_range_m, max_range_m: readings outside are dropped.

    Raises:
        SpecError: a field is out of range (a ValueError).
    """

    ARGUMENT = "stereo"

    mode: str = "848x480"
    baseline_m: float = 0.050
    projector_power: float = 1.0
    dots: int = 5000
    dot_width_px: float = 0.7
    ambient_gain: tuple[float, float] = (0.3, 8.0)
    infrared_contrast: float = 0.5
    exposure_limit: float = 8.0
    gain_limit: float = 8.0
    read_noise: float = 0.003
    shot_noise: float = 0.012
    speckle: float = 0.25
    vignetting: float = 0.4
    fixed_pattern: float = 0.008
    lens_blur_px: float = 0.6
    rectification_error_px: float = 0.06
    disparity_error_px: float = 0.05
    matcher: str = "bm"
    max_disparity_px: int = 128
    block_px: int = 19
    smoothness: tuple[float, float] = (1.0, 4.0)
    uniqueness: int = 7
    speckle_px: int = 40
    speckle_range_px: int = 1
    left_right_px: int = 1
    texture_threshold: float = 0.0
    decimation: int = 1
    spatial_alpha: float = 1.0
    spatial_delta_px: float = 0.6
    spatial_passes: int = 2
    temporal_alpha: float = 1.0
    persistency: int = 0
    hole_filling: str = "none"
    min_range_m: float = 0.17
    max_range_m: float = 10.0

    def __post_init__(self) -> None:
        check_choice("stereo mode", self.mode, tuple(D435I_DEPTH_MODES))
        check_choice("matcher", self.matcher, MATCHERS)
        check_choice("hole_filling", self.hole_filling, HOLE_FILLINGS)
        check_limits(self, _LIMITS)
        for name in ("dots", "max_disparity_px", "block_px", "uniqueness", "speckle_px", "speckle_range_px",
                     "left_right_px", "decimation", "spatial_passes", "persistency"):  # fmt: skip
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
                raise SpecError(f"{name}={value!r} must be a whole number")
        if self.block_px % 2 == 0 or self.max_disparity_px % 16:
            raise SpecError(
                f"block_px={self.block_px!r} must be odd, max_disparity_px={self.max_disparity_px!r} a multiple of 16"
            )
        for name in ("ambient_gain", "smoothness"):
            self._check_pair(name)
        if self.min_range_m >= self.max_range_m:
            raise SpecError(f"min_range_m={self.min_range_m!r} must be below max_range_m={self.max_range_m!r}")

    def _check_pair(self, name: str) -> None:
        values = getattr(self, name)
        if not isinstance(values, (tuple, list)) or len(values) != 2:
            raise SpecError(f"{name}={values!r} must be two numbers, low and high")
        low, high = values
        check_range(name, low, 1e-4, 1e4)
        check_range(name, high, low, 1e4)
        object.__setattr__(self, name, (float(low), float(high)))

    @property
    def intrinsics(self) -> Intrinsics:
        """Of both infrared images."""
        return D435I_DEPTH_MODES[self.mode]

    @classmethod
    def random(cls, rng: np.random.Generator) -> StereoConfig:
        """A camera, its light and its settings drawn at random: what a detector that meets any of them is trained on.

        The bounds are wide on purpose: units, firmware presets, users' filters and other makes of active stereo differ
        more than any one of them varies.
        """

        def log_uniform(low: float, high: float) -> float:
            return float(math.exp(rng.uniform(math.log(low), math.log(high))))

        matcher = "bm" if rng.random() < 0.5 else "sgbm"
        blocks = [11, 13, 15, 17, 19, 21, 25] if matcher == "bm" else [3, 5, 5, 7, 7, 9, 11]
        small = log_uniform(0.3, 10.0)
        return cls(
            mode=str(rng.choice(["848x480", "640x480", "1280x720"], p=[0.5, 0.42, 0.08])),
            projector_power=0.0 if rng.random() < 0.06 else log_uniform(0.4, 6.0),
            dots=int(log_uniform(3000, 120_000)),
            dot_width_px=log_uniform(0.5, 1.2),
            ambient_gain=(0.05, 15.0),
            infrared_contrast=float(rng.uniform(0.2, 1.0)),
            read_noise=log_uniform(0.001, 0.012),
            shot_noise=log_uniform(0.005, 0.04),
            speckle=float(rng.uniform(0.0, 0.5)),
            vignetting=float(rng.uniform(0.1, 0.6)),
            fixed_pattern=log_uniform(0.002, 0.02),
            lens_blur_px=log_uniform(0.4, 1.2),
            rectification_error_px=log_uniform(0.02, 0.4),
            disparity_error_px=log_uniform(0.02, 0.3),
            matcher=matcher,
            block_px=int(rng.choice(blocks)),
            smoothness=(small, small * log_uniform(2.0, 8.0)),
            uniqueness=int(rng.integers(2, 10) if matcher == "bm" else rng.integers(0, 18)),
            speckle_px=int(rng.choice([0, 15, 30, 60, 120, 200], p=[0.1, 0.2, 0.25, 0.2, 0.15, 0.1])),
            speckle_range_px=int(rng.choice([1, 2])),
            left_right_px=int(rng.choice([-1, 1, 2], p=[0.2, 0.6, 0.2])),
            texture_threshold=0.0 if rng.random() < 0.5 else log_uniform(0.5, 4.0),
            decimation=int(rng.choice([1, 2, 3], p=[0.75, 0.2, 0.05])),
            spatial_alpha=1.0 if rng.random() < 0.6 else float(rng.uniform(0.35, 0.8)),
            spatial_delta_px=log_uniform(0.25, 1.5),
            spatial_passes=int(rng.integers(1, 4)),
            hole_filling=str(rng.choice(list(HOLE_FILLINGS), p=[0.82, 0.06, 0.06, 0.06])),
        )


_LIMITS: dict[str, tuple[float, float]] = {
    "baseline_m": (0.01, 0.5),
    "projector_power": (0.0, 1e3),
    "dots": (1, 2_000_000),
    "dot_width_px": (0.2, 5.0),
    "infrared_contrast": (0.0, 2.0),
    "exposure_limit": (1e-3, 1e4),
    "gain_limit": (1.0, 1e3),
    "read_noise": (0.0, 1.0),
    "shot_noise": (0.0, 1.0),
    "speckle": (0.0, 1.0),
    "vignetting": (0.0, 1.0),
    "fixed_pattern": (0.0, 0.5),
    "lens_blur_px": (0.0, 10.0),
    "rectification_error_px": (0.0, 5.0),
    "disparity_error_px": (0.0, 5.0),
    "max_disparity_px": (16, 512),
    "block_px": (3, 51),
    "uniqueness": (0, 100),
    "speckle_px": (0, 10_000),
    "speckle_range_px": (1, 64),
    "left_right_px": (-1, 64),
    "texture_threshold": (0.0, 255.0),
    "decimation": (1, 8),
    "spatial_alpha": (0.05, 1.0),
    "spatial_delta_px": (0.01, 100.0),
    "spatial_passes": (1, 5),
    "temporal_alpha": (0.05, 1.0),
    "persistency": (0, 8),
    "min_range_m": (0.0, 5.0),
    "max_range_m": (0.1, 1e3),
}
