"""What faces say of the pitch, and when they are not asked."""

from __future__ import annotations

import math

import numpy as np

from perception.geometry.strips import strip_planes
from perception.geometry.strips.strip_labels import RISER, TREAD


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
