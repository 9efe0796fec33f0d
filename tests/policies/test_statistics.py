"""Wilson's interval, the sign test, root mean squares."""

from __future__ import annotations

import numpy as np
import pytest

from policies.statistics import root_mean_square, sign_test, wilson_interval


def test_known_value() -> None:
    # Brown, Cai and DasGupta (2001) discuss this interval; 9 of 10 gives 0.596 .. 0.982.
    assert wilson_interval(9, 10) == pytest.approx((0.596, 0.982), abs=1e-3)


def test_the_same_as_scipys() -> None:
    """SciPy's takes seconds to import and rounds the 17th digit otherwise, which recorded tables would show."""
    from scipy.stats import binomtest

    for trials in (1, 7, 48, 300):
        for successes in range(0, trials + 1, max(1, trials // 10)):
            theirs = binomtest(successes, trials).proportion_ci(0.95, "wilson")
            assert wilson_interval(successes, trials) == pytest.approx((theirs.low, theirs.high), abs=1e-15)


def test_sound_at_the_ends() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)
    assert wilson_interval(0, 50)[0] == 0.0 and 0.0 < wilson_interval(0, 50)[1] < 0.1
    assert wilson_interval(50, 50)[1] == pytest.approx(1.0) and wilson_interval(50, 50)[0] > 0.9


def test_holds_the_share_mirrors_and_narrows() -> None:
    for trials in (1, 10, 100):
        for successes in range(trials + 1):
            low, high = wilson_interval(successes, trials)
            assert 0.0 <= low <= successes / trials <= high <= 1.0 + 1e-12
            mirrored = wilson_interval(trials - successes, trials)
            assert (1 - mirrored[1], 1 - mirrored[0]) == pytest.approx((low, high), abs=1e-9)
    widths = [np.ptp(wilson_interval(n // 2, n)) for n in (10, 100, 1000)]
    assert widths == sorted(widths, reverse=True)


@pytest.mark.parametrize(("successes", "trials"), [(-1, 3), (4, 3)])
def test_nonsense_is_refused(successes: int, trials: int) -> None:
    with pytest.raises(ValueError, match=f"successes={successes}"):
        wilson_interval(successes, trials)


def test_root_mean_square_of_nothing_is_none() -> None:
    assert root_mean_square(0.0, 0) is None and root_mean_square(8.0, 2) == 2.0


def test_sign_test_is_the_exact_binomial_one() -> None:
    from scipy.stats import binomtest

    for gained, lost in ((0, 0), (1, 0), (5, 5), (9, 1), (3, 12), (40, 20)):
        expected = binomtest(gained, gained + lost).pvalue if gained + lost else 1.0
        assert sign_test(gained, lost) == pytest.approx(expected)
        assert sign_test(gained, lost) == sign_test(lost, gained)
