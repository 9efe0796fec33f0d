"""Gravity from two sensors at rates of their own."""

from __future__ import annotations

import numpy as np
import pytest

from perception.sources.imu_gravity import ImuGravity
from perception.sources.preparation import Preparation, prepared
from perception.sources.source import ImuSamples, MissingImuError, RawFrame, no_samples
from tests.perception.sources.conftest import ListSource, drawn


def samples(start_s: float, seconds: float, tilt_rate: float = 0.0) -> ImuSamples:
    """A camera that nods at a steady rate, rad/s, from level at time zero."""
    force_t, rate_t = np.arange(start_s, start_s + seconds, 1 / 250), np.arange(start_s, start_s + seconds, 1 / 400)
    angle = tilt_rate * force_t
    force = np.column_stack([force_t, 0 * angle, -9.81 * np.cos(angle), -9.81 * np.sin(angle)])
    rate = np.column_stack([rate_t, np.full_like(rate_t, -tilt_rate), 0 * rate_t, 0 * rate_t])
    return ImuSamples(force, rate)


def angle_deg(gravity: np.ndarray, tilt: float) -> float:
    true = np.array([0.0, -np.cos(tilt), -np.sin(tilt)])
    return float(np.degrees(np.arccos(np.clip(gravity @ true / np.linalg.norm(gravity), -1, 1))))


@pytest.mark.parametrize("rate", [0.0, 0.3, -0.3])
def test_a_nodding_camera_is_followed(rate: float) -> None:
    imu = ImuGravity()
    for k in range(60):
        gravity = imu.update(samples(k / 30, 1 / 30, rate))
    assert gravity is not None and angle_deg(gravity, rate * 2.0) < 1.0


def test_gravity_is_that_of_the_capture_not_of_the_arrival() -> None:
    """Frames come 0.1 s late, with all samples up to then: a camera that nods at 0.5 rad/s would be 3 degrees off."""
    imu = ImuGravity()
    for k in range(60):
        gravity = imu.update(samples(k / 30, 1 / 30, 0.5), until_s=(k + 1) / 30 - 0.1)
        if k > 10:
            assert gravity is not None and angle_deg(gravity, 0.5 * ((k + 1) / 30 - 0.1)) < 1.0
    other = ImuGravity()
    for k in range(5):  # a frame clock that has nothing to do with the IMU's
        gravity = other.update(samples(k / 30, 1 / 30), until_s=1e9 + k / 30)
    assert gravity is not None and angle_deg(gravity, 0.0) < 0.5


def test_only_the_first_moment_is_taken_to_be_at_rest() -> None:
    """A robot stands, and walks on within the first chunk: what it feels then is no gravity."""
    walking = samples(0.0, 0.3)
    walking.acceleration[15:, 1:] += [6.0, 0.0, 4.0]
    gravity = ImuGravity().update(walking)
    assert gravity is not None and angle_deg(gravity, 0.0) < 4.0


def test_an_accelerometer_alone_is_averaged() -> None:
    imu, rng = ImuGravity(), np.random.default_rng(0)
    for k in range(30):
        force = samples(k / 30, 1 / 30).acceleration
        force[:, 1:] += rng.normal(0.0, 0.3, (len(force), 3))
        gravity = imu.update(ImuSamples(force, no_samples()))
    assert gravity is not None and angle_deg(gravity, 0.0) < 1.0


def test_nothing_heard_is_nothing_said_and_nonsense_is_skipped() -> None:
    imu = ImuGravity()
    assert imu.update(ImuSamples()) is None
    assert imu.update(ImuSamples(np.full((3, 4), np.nan), no_samples())) is None
    good = samples(0.0, 0.1)
    good.acceleration[3, 2] = np.nan
    gravity = imu.update(good)
    assert gravity is not None and angle_deg(gravity, 0.0) < 0.2


def test_a_long_silence_starts_anew() -> None:
    imu = ImuGravity()
    imu.update(samples(0.0, 0.2))
    gravity = imu.update(samples(60.0, 0.2, 0.01))
    assert gravity is not None and angle_deg(gravity, 0.601) < 1.0


def test_a_source_without_imu_is_refused_when_asked() -> None:
    raw = drawn(1)[0]
    silent = tuple(RawFrame(raw.name, k / 30, raw.rgb, raw.depth_m, raw.lens) for k in range(40))
    with pytest.raises(MissingImuError, match="no IMU samples"):
        list(prepared(ListSource(silent), Preparation(imu="required")))
    assert {f.gravity_source for f in prepared(ListSource(silent))} == {"none"}
    assert {f.gravity_source for f in prepared(ListSource(drawn()), Preparation(imu="off"))} == {"none"}
