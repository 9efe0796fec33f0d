"""Gravity on a body that shakes as a trotting robot does."""

from __future__ import annotations

import math

import numpy as np
import pytest

from perception.tracking.camera_gravity import CameraAttitude

RATE_HZ = 240.0
G = 9.81


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return math.degrees(math.acos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1.0, 1.0)))


class Trot:
    """A camera that pitches and rolls at the stride's rate, hit by the feet twice a stride."""

    def __init__(self, seed: int, seconds: float = 10.0, gyro_bias: float = 0.0025, impact: float = 15.0) -> None:
        rng = np.random.default_rng(seed)
        t = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
        stride = 2 * np.pi * 2.4
        pitch = -0.4 + 0.05 * np.sin(stride * t + rng.uniform(0, 6)) + 0.1 * np.sin(0.5 * t)
        roll = 0.06 * np.sin(stride * t + rng.uniform(0, 6))
        up = np.stack([-np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch), np.sin(pitch)], axis=1)
        self.up = up
        # up is fixed in the world, so seen from the body it turns by -w: w = up x d(up)/dt plus a part along up.
        rate = np.cross(np.gradient(up, 1 / RATE_HZ, axis=0), up)
        bounce = impact * np.sign(np.sin(2 * stride * t)) * np.exp(-((2 * stride * t) % np.pi))
        shake = 4.0 * np.sin(stride * t)[:, None] * rng.normal(0, 1, 3) / 1.7
        self.force = G * up + bounce[:, None] * up + shake + rng.uniform(-0.05, 0.05, 3) + rng.normal(0, 0.03, up.shape)
        self.gyro = rate + rng.uniform(-gyro_bias, gyro_bias, 3) + rng.normal(0, 0.004, up.shape)
        self.force[: int(0.1 * RATE_HZ)] = G * up[: int(0.1 * RATE_HZ)]  # stands still when switched on

    def samples(self) -> np.ndarray:
        return np.concatenate([self.force, self.gyro], axis=1)


@pytest.mark.parametrize("seed", range(4))
def test_fusion_is_right_where_the_accelerometer_fails(seed: int) -> None:
    trot = Trot(seed)
    attitude = CameraAttitude(RATE_HZ)
    fused, bare = [], []
    samples = trot.samples()
    for start in range(0, len(samples) - 5, 5):
        gravity = attitude.update(samples[start : start + 5])
        fused.append(angle_deg(gravity, trot.up[start + 4]))
        bare.append(angle_deg(samples[start + 4, :3], trot.up[start + 4]))
    assert np.sqrt(np.mean(np.square(fused))) < 0.7
    assert np.sqrt(np.mean(np.square(bare))) > 5.0


def test_at_rest_it_reads_the_accelerometer() -> None:
    up = np.array([0.1, -0.9, 0.3])
    up /= np.linalg.norm(up)
    attitude = CameraAttitude(RATE_HZ)
    for _ in range(50):
        gravity = attitude.update(np.tile(np.concatenate([G * up, np.zeros(3)]), (5, 1)))
    assert angle_deg(gravity, up) < 0.1
    assert np.linalg.norm(gravity) == pytest.approx(9.8)


def test_level_before_the_first_sample_and_after_reset() -> None:
    attitude = CameraAttitude()
    assert attitude.gravity == pytest.approx([0.0, -9.8, 0.0])
    attitude.update(np.array([[9.8, 0.0, 0.0, 0.0, 0.0, 0.0]]))
    attitude.reset()
    assert attitude.gravity == pytest.approx([0.0, -9.8, 0.0])


def test_broken_samples_are_skipped() -> None:
    attitude = CameraAttitude()
    good = np.array([[0.0, -9.8, 0.0, 0.0, 0.0, 0.0]])
    attitude.update(good)
    gravity = attitude.update(np.array([[np.nan] * 6, [np.inf, 0, 0, 0, 0, 0]]))
    assert gravity == pytest.approx([0.0, -9.8, 0.0], abs=1e-4)


def test_wrong_shape_is_named() -> None:
    with pytest.raises(ValueError, match=r"\(k, 6\)"):
        CameraAttitude().update(np.zeros((5, 3)))
