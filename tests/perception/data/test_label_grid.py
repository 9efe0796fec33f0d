import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.data.label_grid import (
    CELL_HEIGHT_PX,
    CELL_WIDTH_PX,
    LabelError,
    decode_grid,
    encode_grid,
    format_labels,
    order_left_first,
    read_label_file,
)

inside = st.floats(1.0, 511.0)


def distance_to_line(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    start, along = line[:2], line[2:] - line[:2]
    offset = points - start
    return np.abs(along[0] * offset[:, 1] - along[1] * offset[:, 0]) / np.hypot(*along)


@settings(max_examples=80, deadline=None)
@given(st.tuples(inside, inside, inside, inside).filter(lambda p: np.hypot(p[2] - p[0], p[3] - p[1]) > 80))
def test_line_to_grid_to_line(points):
    line = order_left_first(np.array([points]))[0]
    grid = encode_grid(line[None])
    pieces = decode_grid(grid.cls, grid.loc)
    assert (pieces[:, 0] == pieces[:, 1]).all()  # one line: both sets of locations are the same
    ends = pieces[:, 0].reshape(-1, 2)
    assert distance_to_line(ends, line).max() < 1e-2
    assert (pieces[:, 0, 0] <= pieces[:, 0, 2] + 1e-4).all()  # left end first
    length = np.hypot(*(pieces[:, 0, 2:] - pieces[:, 0, :2]).T).sum()
    # What is missing are slivers, each shorter than an eighth of a cell, in cells that got no line of their own.
    extent = np.abs(line[2:] - line[:2])
    crossed = extent[0] / CELL_WIDTH_PX + extent[1] / CELL_HEIGHT_PX + 3
    sliver = np.hypot(CELL_WIDTH_PX, CELL_HEIGHT_PX) / 8
    assert length == pytest.approx(np.hypot(*extent), abs=sliver * max(crossed - len(pieces), 1))


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(inside, inside, inside, inside), max_size=8))
def test_grid_is_always_well_formed(lines):
    grid = encode_grid(np.array(lines).reshape(-1, 4))
    assert set(np.unique(grid.cls)) <= {0.0, 1.0}
    assert ((grid.loc >= 0) & (grid.loc <= 1)).all()
    assert (grid.loc[grid.cls == 0] == 0).all()
    assert (np.abs(grid.loc[grid.cls == 1]).sum(-1) > 0).all()


def test_two_lines_in_a_cell_are_kept_upper_first():
    upper, lower = [0.0, 100.0, 512.0, 100.0], [0.0, 106.0, 512.0, 106.0]  # both in row 6: 96 to 112
    grid = encode_grid(np.array([lower, upper]))
    assert grid.cls.sum() == 16
    np.testing.assert_allclose(grid.loc[6, :, [1, 3]], 4 / 16, atol=1e-6)
    np.testing.assert_allclose(grid.loc[6, :, [5, 7]], 10 / 16, atol=1e-6)


def test_of_three_lines_in_a_cell_the_two_longest_stay():
    lines = np.array([[0.0, 100.0, 32.0, 100.0], [0.0, 104.0, 8.0, 104.0], [0.0, 108.0, 32.0, 108.0]])
    grid = encode_grid(lines)
    np.testing.assert_allclose(grid.loc[6, 0, [1, 5]], [4 / 16, 12 / 16])


def test_parts_outside_the_image_are_cut_off():
    grid = encode_grid(np.array([[-100.0, 200.0, 700.0, 200.0], [10.0, -50.0, 60.0, -10.0]]))
    assert grid.cls.sum() == 16
    np.testing.assert_allclose(grid.loc[12, :, 0], 0.0)
    np.testing.assert_allclose(grid.loc[12, :, 2], 1.0)


@pytest.mark.parametrize("line", [[5.0, 5.0, 5.0, 5.0], [np.nan, 0.0, 10.0, 10.0]])
def test_lines_without_length_or_number_claim_no_cell(line):
    assert encode_grid(np.array([line])).cls.sum() == 0


def test_smaller_grid_keeps_the_cell_size():
    grid = encode_grid(np.array([[0.0, 40.0, 256.0, 40.0]]), rows=16, columns=8)
    assert grid.cls.shape == (16, 8)
    assert grid.cls[2].sum() == 8


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 1), inside, inside, inside, inside), max_size=6))
def test_label_file_round_trip(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("labels") / "a.txt"
    kinds, lines = np.array([r[0] for r in rows]), np.array([r[1:] for r in rows]).reshape(-1, 4)
    path.write_text(format_labels(kinds, lines))
    kinds_back, lines_back = read_label_file(path)
    np.testing.assert_array_equal(kinds_back, kinds)
    assert (lines_back[:, 0] <= lines_back[:, 2]).all()
    rounded = order_left_first(np.round(order_left_first(lines), 2))
    np.testing.assert_allclose(lines_back, rounded, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("0 1 2 3", "4 values"),
        ("2 1 2 3 4", "class 2"),
        ("0 1 2 x 4", "no number"),
        ("0 1 2 900 4", "must lie in"),
        ("1 1 nan 9 4", "must lie in"),
    ],
)
def test_malformed_label_names_file_and_line(tmp_path, text, reason):
    path = tmp_path / "frame.txt"
    path.write_text(f"0 10 10 50 12\n\n{text}\n")
    with pytest.raises(LabelError, match=r"frame\.txt:3: ") as caught:
        read_label_file(path)
    assert reason in str(caught.value)


def test_missing_label_file_is_named(tmp_path):
    with pytest.raises(LabelError, match=r"nothing\.txt"):
        read_label_file(tmp_path / "nothing.txt")
