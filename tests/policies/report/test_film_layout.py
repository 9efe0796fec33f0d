"""Frames of the demo's video."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from policies.report.film_layout import BACKGROUND, BAD, GOOD, compose, fit, measurement_words

TRUTH = {"valid": 1.0, "step_width": 0.3, "step_height": 0.15, "edge_distance": 0.5}


def picture(height: int, width: int) -> np.ndarray:
    return np.full((height, width, 3), 200, np.uint8)


@pytest.mark.parametrize("shape", [(480, 640), (720, 1280), (512, 512), (100, 700)])
def test_pictures_are_fitted_without_distortion(shape: tuple[int, int]) -> None:
    out = fit(picture(*shape), (640, 480))
    assert out.shape == (480, 640, 3)
    rows, columns = np.nonzero((out != BACKGROUND).any(axis=2))
    inner = (np.ptp(rows) + 1) / (np.ptp(columns) + 1)
    assert inner == pytest.approx(shape[0] / shape[1], rel=0.01)
    assert np.ptp(rows) == 479 or np.ptp(columns) == 639


def test_both_panels_and_the_caption_are_there() -> None:
    blank = compose(picture(480, 640), picture(512, 512), [])
    assert blank.shape == (544, 1280, 3) and blank.shape[0] % 16 == 0
    written = compose(picture(480, 640), picture(512, 512), [[("flight 1", (255, 255, 255))], [("up", GOOD)]])
    assert not np.array_equal(blank[480:], written[480:]) and np.array_equal(blank[:480], written[:480])


def colours(words: list[Any]) -> dict[str, Any]:
    return dict(words)


def test_measurements_are_written_beside_the_truth() -> None:
    words = colours(measurement_words(np.array([1, 1, 0.305, 0.19, 0.5, 0, 0, 1]), TRUTH))
    assert words["305"] == GOOD and words["190"] == BAD
    assert "(true 300) mm" in words and "(true 150) mm" in words


def test_missing_measurements_say_why() -> None:
    nothing = np.zeros(8)
    assert measurement_words(nothing, TRUTH)[0][0] == "stairs not seen"
    assert measurement_words(nothing, {**TRUTH, "valid": 0.0})[0][0] == "no stairs ahead"
