"""The order of the faces decides which strip is a tread and which a riser."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from perception.geometry.strips.strip_kernels import cheapest_sequence


@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_sequence_is_the_cheapest_of_all(count: int) -> None:
    rng = np.random.default_rng(count)
    for _ in range(20):
        unary, pair = rng.uniform(0, 5, (count, 3)), rng.uniform(0, 5, (count - 1, 3, 3))
        unary[rng.random((count, 3)) < 0.2] = np.inf
        unary[:, 0] = 4.0  # what is unknown always has a price
        kinds = np.empty(count, np.int64)
        cheapest_sequence(unary, pair, kinds)

        def cost(sequence: tuple[int, ...], unary: np.ndarray = unary, pair: np.ndarray = pair) -> float:
            links = sum(pair[i, a, b] for i, (a, b) in enumerate(itertools.pairwise(sequence)))
            return float(sum(unary[i, kind] for i, kind in enumerate(sequence)) + links)

        best = min(itertools.product(range(3), repeat=count), key=cost)
        assert cost(tuple(kinds.tolist())) == pytest.approx(cost(best))
