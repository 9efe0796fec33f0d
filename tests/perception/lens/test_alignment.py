"""Depth moved into another camera is what that camera would have measured."""

from __future__ import annotations

import numpy as np

from perception.lens.alignment import align_depth
from stair_env.intrinsics import Intrinsics

DEPTH = Intrinsics(160, 120, 95.0, 95.0, 80.0, 60.0)
COLOUR = Intrinsics(160, 120, 150.0, 150.0, 80.0, 60.0)


def shifted(x: float, z: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, 0.0, z
    return pose


def test_the_same_camera_changes_nothing() -> None:
    depth = np.random.default_rng(0).uniform(0.5, 4.0, (120, 160)).astype(np.float32)
    depth[:10] = 0.0
    np.testing.assert_allclose(align_depth(depth, DEPTH, np.eye(4), DEPTH), depth, rtol=1e-6)


def test_a_slanted_plane_stays_one_and_has_no_holes() -> None:
    rays = DEPTH.rays()
    depth = (2.0 / (1.0 + 0.3 * rays[..., 1])).astype(np.float32)  # z + 0.3 y = 2
    aligned = align_depth(depth, DEPTH, shifted(0.015), COLOUR)
    true = 2.0 / (1.0 + 0.3 * COLOUR.rays()[..., 1])
    inside = aligned[5:-5, 8:-8]
    assert (inside > 0).all()
    np.testing.assert_allclose(inside, true[5:-5, 8:-8], atol=0.012)  # half a depth pixel of the slant


def test_the_nearer_surface_hides_the_farther() -> None:
    depth = np.full((120, 160), 3.0, np.float32)
    depth[40:80, 60:100] = 1.0
    aligned = align_depth(depth, DEPTH, shifted(0.05), DEPTH)
    assert set(np.round(np.unique(aligned), 4)) <= {0.0, 1.0, 3.0}
    assert abs((aligned == 1.0).sum() - 1600) < 120  # nothing of the near square was painted over


def test_what_lies_behind_the_camera_is_left_out() -> None:
    depth = np.full((120, 160), 0.5, np.float32)
    assert not align_depth(depth, DEPTH, shifted(0.0, -0.6), COLOUR).any()
