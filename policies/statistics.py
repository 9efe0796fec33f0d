"""Intervals and errors: pure functions."""

from __future__ import annotations

import math

Z_95 = 1.959963984540054  # two-sided 95 % quantile of the normal distribution


def wilson_interval(successes: int, trials: int, z: float = Z_95) -> tuple[float, float]:
    """Wilson's score interval of a success probability; unlike the usual one it is sound at 0 and 100 %.

    Args:
        successes: 0 <= successes <= trials.
        trials: number of episodes; none gives (0, 1), nothing known.
        z: quantile, 1.96 for 95 %.

    Returns:
        (low, high) in [0, 1].

    Raises:
        ValueError: successes do not fit trials.
    """
    if not 0 <= successes <= trials:
        raise ValueError(f"successes={successes!r} must lie in [0, trials={trials!r}]")
    if trials == 0:
        return (0.0, 1.0)
    share, z2 = successes / trials, z * z
    middle = (share + z2 / (2 * trials)) / (1 + z2 / trials)
    half = z / (1 + z2 / trials) * math.sqrt(share * (1 - share) / trials + z2 / (4 * trials * trials))
    return (max(0.0, min(middle - half, share)), min(1.0, max(middle + half, share)))  # exact at 0 and 1


def sign_test(gained: int, lost: int) -> float:
    """Two-sided p-value of the sign test: that pairs which differ fall to either side by the toss of a coin.

    Args:
        gained, lost: pairs that differ, by side (McNemar's discordant pairs).
    """
    tosses, fewer = gained + lost, min(gained, lost)
    tail = sum(math.comb(tosses, count) for count in range(fewer + 1)) / 2**tosses
    return min(1.0, 2.0 * tail)


def root_mean_square(sum_of_squares: float, count: float) -> float | None:
    """Root of the mean square; None when nothing was counted."""
    return math.sqrt(sum_of_squares / count) if count else None
