"""The stairs of the paper's table 7 come out of the geometry as they went in."""

from __future__ import annotations

import numpy as np
import pytest

from stair_env.common.validation import SpecError
from stair_env.scene.paper_stairs import PAPER_STAIRS, PaperStair


@pytest.mark.parametrize("stair", PAPER_STAIRS, ids=lambda stair: stair.name)
def test_measured_steps_are_built_to_the_millimetre(stair: PaperStair) -> None:
    profile = stair.spec("up", 6).profile()
    widths, heights = np.array(stair.steps_mm).T
    assert np.allclose(np.diff(profile.edge_x)[:3] * 1000, widths)
    assert np.allclose(profile.rises[:3] * 1000, heights)
    down = stair.spec("down", 6).profile()
    assert np.allclose(-down.rises[::-1], profile.rises) or np.allclose(-down.rises, profile.rises)


def test_too_few_steps_are_refused() -> None:
    with pytest.raises(SpecError, match="num_steps=2"):
        PAPER_STAIRS[0].spec("up", 2)
