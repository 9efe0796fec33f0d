"""From a clean image to what the D435i's colour imager reports.

Exposure and white balance that are never quite right, light lost towards the corners, blur by defocus and motion, and
noise that grows with the gain an automatic exposure needs in the dark. docs/sensors.md lists every number with its
source.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from stair_env.common.validation import JsonSpec, SpecError, check_flags, check_limits
from stair_env.sensors.camera.noise_tiles import TILE_SIDE_PX, gaussian_tile

MAX_SMEAR_PX = 40.0  # longer trails are cut; at 15 frames a second they mean a fall
_MAX_SMEAR_TAPS = 12
_OFFSETS = 2
_STANDING = np.zeros((1, 2), np.int64)


@dataclass(frozen=True)
class ColourErrorConfig(JsonSpec):
    """What is wrong with the colour image; the defaults are a D435i on a walking robot.

    Args:
        shot_variance: variance of the noise per grey level at gain 1, grey levels (a 1.4 um pixel holds about 6000
            electrons, 24 per grey level of 8 bits, hence 1 / 24).
        read_noise: standard deviation of the noise without light at gain 1, grey levels.
        full_gain_level, unit_gain_level: mean grey levels at which automatic exposure has run out of gain, and from
            which it needs none.
        max_gain: gain in the dark (16 to 128 in RealSense's units: 1 to 8).
        exposure_s, max_exposure_s: shutter time in the light and in the dark, seconds (automatic exposure of a 30
            frames a second stream reaches 33 ms).
        exposure_jitter: standard deviation of the logarithm of a frame's brightness.
        white_balance_jitter: standard deviation of the logarithm of the red and blue gain; drawn at `reset`.
        vignetting: share of light lost in the corners; drawn at `reset` evenly between 0 and this.
        defocus_px: standard deviation of the lens blur, pixels of a 480-row image.
        motion_blur: whether `pixel_motion` smears the image.

    Raises:
        SpecError: a field is out of range (a ValueError).
    """

    ARGUMENT = "colour_error"

    shot_variance: float = 1.0 / 24.0
    read_noise: float = 0.8
    full_gain_level: float = 12.0
    unit_gain_level: float = 80.0
    max_gain: float = 8.0
    exposure_s: float = 0.008
    max_exposure_s: float = 0.033
    exposure_jitter: float = 0.06
    white_balance_jitter: float = 0.04
    vignetting: float = 0.25
    defocus_px: float = 0.5
    motion_blur: bool = True

    def __post_init__(self) -> None:
        check_limits(self, _LIMITS)
        check_flags(self, "motion_blur")
        for low_name, high_name in (("full_gain_level", "unit_gain_level"), ("exposure_s", "max_exposure_s")):
            if getattr(self, low_name) > getattr(self, high_name):
                raise SpecError(f"{low_name}={getattr(self, low_name)!r} must not exceed {high_name}")

    @classmethod
    def ideal(cls) -> ColourErrorConfig:
        """Nothing is wrong: the image passes through unchanged."""
        return cls(
            shot_variance=0.0,
            read_noise=0.0,
            exposure_jitter=0.0,
            white_balance_jitter=0.0,
            vignetting=0.0,
            defocus_px=0.0,
            motion_blur=False,
        )


_LIMITS: dict[str, tuple[float, float]] = {
    "shot_variance": (0.0, 5.0),
    "read_noise": (0.0, 20.0),
    "full_gain_level": (0.0, 255.0),
    "unit_gain_level": (0.0, 255.0),
    "max_gain": (1.0, 64.0),
    "exposure_s": (0.0, 0.2),
    "max_exposure_s": (0.0, 0.2),
    "exposure_jitter": (0.0, 0.5),
    "white_balance_jitter": (0.0, 0.3),
    "vignetting": (0.0, 0.9),
    "defocus_px": (0.0, 5.0),
}


class ColourErrorModel:
    """Applies a `ColourErrorConfig` to frames.

    The white balance and the vignetting of the present unit are the only state: `reset` draws them, and until then
    there is neither. Two calls of `apply` with generators in equal states give equal frames.

    Args:
        config: what is wrong with the image.
    """

    def __init__(self, config: ColourErrorConfig | None = None) -> None:
        self.config = config if config is not None else ColourErrorConfig()
        self._white_balance = np.ones(3)
        self._vignetting = 0.0

    def reset(self, rng: np.random.Generator) -> None:
        """Take another unit and another light: draw white balance and vignetting."""
        red, blue = np.exp(rng.normal(0.0, 1.0, 2) * self.config.white_balance_jitter)
        self._white_balance = np.array([red, 1.0, blue])
        self._vignetting = float(rng.uniform(0.0, 1.0)) * self.config.vignetting

    def darkness(self, rgb: np.ndarray) -> float:
        """How much automatic exposure has to strain for this image: 0 in good light, 1 in the dark."""
        config = self.config
        level = float(rgb[::8, ::8, 1].mean())
        span = config.unit_gain_level - config.full_gain_level
        if span <= 0.0:
            return float(level < config.unit_gain_level)
        return min(max((config.unit_gain_level - level) / span, 0.0), 1.0)

    def exposure_s(self, rgb: np.ndarray) -> float:
        """Shutter time that automatic exposure chooses for this image, seconds."""
        config = self.config
        return config.exposure_s + self.darkness(rgb) * (config.max_exposure_s - config.exposure_s)

    def apply(
        self, rgb: np.ndarray, rng: np.random.Generator, pixel_motion: Sequence[float] | np.ndarray | None = None
    ) -> np.ndarray:
        """Corrupt one frame.

        Args:
            rgb: uint8 (H, W, 3), clean.
            rng: draws the frame's exposure and noise, a fixed amount per frame.
            pixel_motion: (2,) how far (right, down) the image moves while the shutter is open, pixels.

        Returns:
            uint8 (H, W, 3), a new array.

        Raises:
            ValueError: an argument has a wrong shape or dtype.
        """
        return self.begin(rgb, rng, pixel_motion)()

    def begin(
        self, rgb: np.ndarray, rng: np.random.Generator, pixel_motion: Sequence[float] | np.ndarray | None = None
    ) -> Callable[[], np.ndarray]:
        """Draw all that `apply` draws; the function that is returned does the rest, in any thread."""
        _check_frame(rgb, rng)
        motion = _check_motion(pixel_motion)
        config = self.config
        exposure = math.exp(config.exposure_jitter * float(rng.standard_normal()))
        offset_v, offset_u = rng.integers(0, TILE_SIDE_PX, size=_OFFSETS)
        gain = config.max_gain ** self.darkness(rgb)

        def work() -> np.ndarray:
            image = self._blurred(np.ascontiguousarray(rgb), motion)
            return self._exposed(image, exposure, gain, int(offset_v), int(offset_u))

        return work

    def _blurred(self, rgb: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """Lens blur, then the trail that motion leaves."""
        from stair_env.sensors.camera import colour_kernels as kernels

        height, width, _ = rgb.shape
        rows = rgb.reshape(height, 3 * width)
        weights = blur_weights(self.config.defocus_px * height / 480.0)
        if len(weights) > 1:
            soft, scratch = np.empty_like(rows), np.empty(3 * (width + 2 * len(weights)), np.float32)
            kernels.soften(rows, weights, scratch, np.empty(3 * width, np.float32), soft)
            rows = soft
        shifts = trail(motion) if self.config.motion_blur else _STANDING
        if len(shifts) > 1:
            smeared = np.empty_like(rows)
            kernels.smear(rows, shifts, np.empty(3 * width, np.uint16), smeared)
            rows = smeared
        return rows.reshape(height, width, 3)

    def _exposed(self, rgb: np.ndarray, exposure: float, gain: float, offset_v: int, offset_u: int) -> np.ndarray:
        """Brightness, colour, vignetting and noise."""
        from stair_env.sensors.camera import colour_kernels as kernels

        height, width, _ = rgb.shape
        gains = np.tile((exposure * self._white_balance).astype(np.float32), width)
        # Demosaicking spreads part of each photosite's noise over its neighbours.
        noise = gaussian_tile((0.0, 0.8), (0.6, 0.4), width, 2, channels=3)
        out = np.empty((height, 3 * width), np.uint8)
        kernels.expose(
            rgb.reshape(height, 3 * width),
            gains,
            _column_radius_2(height, width),
            np.float32(self._vignetting),
            np.float32(self.config.shot_variance * gain),
            np.float32((self.config.read_noise * gain) ** 2),
            noise,
            offset_v,
            offset_u,
            out,
        )
        return out.reshape(height, width, 3)


@lru_cache(maxsize=8)
def _column_radius_2(height: int, width: int) -> np.ndarray:
    """(3 W,) float32 squared horizontal distance of each channel's pixel from the centre; 1 is a corner's distance."""
    x = np.repeat((2.0 * np.arange(width) + 1.0) / width - 1.0, 3)
    return (x * x / (1.0 + (height / width) ** 2)).astype(np.float32)


@lru_cache(maxsize=32)
def blur_weights(sigma_px: float) -> np.ndarray:
    """Middle and one side of a Gaussian kernel of sum 1, (r + 1,) float32; (1,) when it would not change 8 bits."""
    if sigma_px < 0.15:
        return np.ones(1, np.float32)
    side = np.exp(-0.5 * (np.arange(math.ceil(2.5 * sigma_px) + 1) / sigma_px) ** 2)
    side = side[side > 0.002]
    return (side / (2.0 * side.sum() - side[0])).astype(np.float32)


def trail(motion: np.ndarray) -> np.ndarray:
    """Whole-pixel displacements that sample a straight trail of the given length, centred.

    Args:
        motion: (2,) pixels (right, down).

    Returns:
        (k, 2) int64, k from 1 (less than a pixel) to _MAX_SMEAR_TAPS.
    """
    length = float(np.hypot(*motion))
    if length < 0.75:
        return _STANDING
    scale = min(1.0, MAX_SMEAR_PX / length)
    count = min(int(length * scale) + 1, _MAX_SMEAR_TAPS)
    steps = np.linspace(-0.5, 0.5, max(count, 2))[:, None] * (scale * motion)
    return np.rint(steps).astype(np.int64)


def _check_frame(rgb: np.ndarray, rng: np.random.Generator) -> None:
    if not isinstance(rgb, np.ndarray) or rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8:
        found = f"{rgb.dtype} {rgb.shape}" if isinstance(rgb, np.ndarray) else type(rgb).__name__
        raise ValueError(f"rgb must be uint8 (H, W, 3), got {found}")
    if not isinstance(rng, np.random.Generator):
        raise ValueError(f"rng must be a numpy.random.Generator, got {type(rng).__name__}")


def _check_motion(pixel_motion: Sequence[float] | np.ndarray | None) -> np.ndarray:
    motion = np.zeros(2) if pixel_motion is None else np.asarray(pixel_motion, dtype=np.float64)
    if motion.shape != (2,) or not np.isfinite(motion).all():
        raise ValueError(f"pixel_motion={pixel_motion!r} must be two finite numbers (right, down), pixels")
    return motion
