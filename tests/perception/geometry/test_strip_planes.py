"""What faces say of the pitch, and when they are not asked."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from perception.geometry.strips import strip_planes
from perception.geometry.strips.strip_labels import RISER, TREAD
from perception.geometry.strips.strip_planes import Strips


class TestFacesThatDisagree:
    """Treads say what is level; a floor that falls off or a riser that leans says only where it lies."""

    KIND = np.array([TREAD, RISER, TREAD, RISER, TREAD, TREAD])

    def equations(self, turns_rad: list[float]) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrices and gradients of faces that each want the pitch turned by an angle, known to 0.3 degrees."""
        known = 1.0 / math.radians(0.3) ** 2
        normal = np.zeros((len(turns_rad), 3, 3))
        normal[:, range(3), range(3)] = known
        return normal, -known * np.array([[0.0, turn, 0.0] for turn in turns_rad])

    def pitch(self, turns_rad: list[float], kind: np.ndarray) -> float:
        normal, gradient = self.equations(turns_rad)
        strip_planes._free_odd_faces(normal, gradient, kind)
        return float(-np.linalg.solve(normal.sum(axis=0), gradient.sum(axis=0))[1])

    def test_those_that_agree_all_count(self) -> None:
        normal, gradient = self.equations([0.01, 0.012, 0.009, 0.01, 0.011, 0.01])
        before = normal.copy(), gradient.copy()
        strip_planes._free_odd_faces(normal, gradient, self.KIND)
        assert np.array_equal(normal, before[0]) and np.array_equal(gradient, before[1])

    def test_a_floor_and_risers_that_slope_turn_nothing(self) -> None:
        turns = [-0.08, 0.07, 0.01, 0.07, 0.011, 0.009]
        assert abs(self.pitch(turns, self.KIND) - 0.01) < 0.002
        assert abs(np.mean(turns) - 0.01) > 0.004  # what all of them say together

    def test_two_treads_have_no_majority(self) -> None:
        turns = [-0.08, 0.07, 0.01, 0.07, 0.0, 0.0]
        kind = np.array([TREAD, RISER, TREAD, RISER, 0, 0])
        normal, gradient = self.equations(turns)
        strip_planes._free_odd_faces(normal, gradient, kind)
        assert np.array_equal(normal, self.equations(turns)[0])


def level_strips(noise: float, rng: np.random.Generator, heights_m: tuple[float, ...] = (-0.7, -0.9, -1.1)) -> Strips:
    """Treads seen from above, their depth off by so many times a D435i's best."""
    forward = np.linspace(0.6, 1.6, 27 * 8).reshape(27, 8)[:, ::-1]
    rays = np.ones((len(heights_m), forward.size, 3))
    rays[..., 0] = np.linspace(-0.3, 0.3, forward.size)
    for row, height in enumerate(heights_m):
        rays[row, :, 1] = -height / forward.ravel()
    depth = np.tile(forward.ravel(), (len(heights_m), 1))
    depth = depth + noise * strip_planes.DEPTH_SIGMA_PER_M2 * depth**2 * rng.normal(size=depth.shape)
    return Strips(rays, depth, np.ones(depth.shape, bool), np.full(len(heights_m), 4.0))


CAMERA_TO_STAIR = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def test_a_noisier_frame_is_found_to_be_noisier() -> None:
    """Not in proportion: the unevenness of real treads counts, too, whatever the camera."""
    found = [strip_planes._noise(level_strips(noise, np.random.default_rng(1)), CAMERA_TO_STAIR) for noise in (1, 2, 3)]
    assert found[0] < 1.1 < found[1] < found[2] < strip_planes.MAX_NOISE


def test_noise_is_never_taken_for_less_than_a_good_cameras_nor_for_anything() -> None:
    rng = np.random.default_rng(2)
    assert strip_planes._noise(level_strips(0.0, rng), CAMERA_TO_STAIR) == 1.0
    assert strip_planes._noise(level_strips(20.0, rng), CAMERA_TO_STAIR) == strip_planes.MAX_NOISE
    nothing = replace(level_strips(1.0, rng), ok=np.zeros((3, 216), bool))
    assert strip_planes._noise(nothing, CAMERA_TO_STAIR) == 1.0
