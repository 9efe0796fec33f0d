"""A short memory of nosings along the walking direction: a one-dimensional Kalman filter with a moving origin.

The state is how far ahead of the base each nosing lies, and by which factor odometry is off (feet slip, and do so
steadily). Walking moves all nosings together, so that drift is one error that all share; a frame moves each of them
and, through the covariance, also those that it did not show, and teaches the factor.
Riser and tread are kept for every nosing by itself: uneven steps stay uneven.
"""

from __future__ import annotations

import math

import numpy as np

from perception.geometry.results import Nosing

MAX_NOSINGS = 24
GATE_TREADS = 0.45  # a measured nosing belongs to a remembered one that is nearer than this share of a tread
DEFAULT_TREAD_M = 0.30
FRAME_STD_M = 0.006  # error that all nosings of one frame share: attitude, mount, time stamp
NOSING_STD_FLOOR_M = 0.003
LENGTH_STD_FLOOR_M = 0.003  # of a riser or tread within one frame
LENGTH_WALK_M = 0.0005  # per frame, so that the filter never stops listening
# Measured on a trotting AlienGo: odometry reads 3 % too far up and 11 % down, and slips in bursts beyond that. A
# factor that follows the bursts (0.15 and a limit of 0.45 did) misleads the last half metre, which no frame shows.
ODOMETRY_SCALE_STD = 0.06  # of the factor by which odometry is off, before any frame
ODOMETRY_SCALE_WALK = 0.06  # of that factor, per square root of a metre walked
ODOMETRY_NOISE = 0.03  # of the distance walked, beyond that factor
ODOMETRY_SCALE_LIMIT = 0.12
UNSEEN_STD_M = 0.02  # of a nosing that is only inferred
UNSEEN_PATIENCE = 30  # more misses before it is given up: it may stay below the camera's view
MAX_MISSES = 3  # more misses than hits beyond this, and a nosing was never there


class Lengths:
    """Riser or tread of every nosing, each a scalar Kalman filter; variance infinite while unseen."""

    def __init__(self) -> None:
        self.value = np.zeros(0)
        self.variance = np.zeros(0)

    def insert(self, index: int) -> None:
        """Make room for a nosing."""
        self.value = np.insert(self.value, index, 0.0)
        self.variance = np.insert(self.variance, index, math.inf)

    def keep(self, mask: np.ndarray) -> None:
        """Drop the nosings where mask (n,) is false."""
        self.value, self.variance = self.value[mask], self.variance[mask]

    def update(self, index: int, measured: float, std: float) -> None:
        """Take a measurement in; one far from what was believed counts little, but counts."""
        noise = std**2 + LENGTH_STD_FLOOR_M**2
        prior = self.variance[index] + LENGTH_WALK_M**2
        if not math.isfinite(prior):
            self.value[index], self.variance[index] = measured, noise
            return
        innovation = measured - self.value[index]
        excess = innovation**2 / (9.0 * (prior + noise))
        if excess > 1.0:  # beyond three standard deviations: doubt both
            noise *= excess
            prior *= min(excess, 4.0)
        gain = prior / (prior + noise)
        self.value[index] += gain * innovation
        self.variance[index] = (1.0 - gain) * prior

    def forget(self, index: np.ndarray) -> None:
        """Count the nosings of (k,) indices as unseen."""
        self.variance[index] = math.inf

    def at(self, index: int, fallback: float) -> float:
        """The length at a nosing; where it was never seen, that of the nearest one before it, or after it."""
        known = np.isfinite(self.variance)
        if known[index]:
            return float(self.value[index])
        if not known.any():
            return fallback
        places = np.nonzero(known)[0]
        before = places[places < index]
        return float(self.value[before[-1] if len(before) else places[0]])

    def std_at(self, index: int) -> float:
        """Standard deviation, metres; infinite where never seen."""
        return math.sqrt(self.variance[index])


class NosingMap:
    """Nosings ahead of and behind the base, sorted from behind to ahead."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self.ahead = np.zeros(0)  # (n,) distance along the walking direction from the base, metres
        self.odometry_scale = 0.0  # relative error of the odometry
        self._covariance = np.array([[ODOMETRY_SCALE_STD**2]])  # (1 + n, 1 + n): of the scale, then of the nosings
        self.hits = np.zeros(0, dtype=int)
        self.misses = np.zeros(0, dtype=int)
        self.riser, self.tread = Lengths(), Lengths()

    def __len__(self) -> int:
        return len(self.ahead)

    def advance(self, distance_m: float) -> None:
        """The base walked this far along the stairs."""
        self.ahead = self.ahead - (1.0 + self.odometry_scale) * distance_m
        with_scale = self._covariance[0] * distance_m
        self._covariance[1:] -= with_scale
        self._covariance[:, 1:] -= self._covariance[:, :1] * distance_m
        self._covariance[1:, 1:] += (ODOMETRY_NOISE * distance_m) ** 2
        self._covariance[0, 0] += ODOMETRY_SCALE_WALK**2 * abs(distance_m)

    def std_at(self, index: int) -> float:
        """Standard deviation of a nosing's distance, metres."""
        return math.sqrt(max(float(self._covariance[index + 1, index + 1]), 0.0))

    def forget_behind(self, limit_m: float) -> None:
        """Drop nosings farther behind the base than this."""
        self._keep(self.ahead > -limit_m)

    def gate(self) -> float:
        """Distance within which a measured nosing belongs to a remembered one, metres."""
        known = self.tread.value[np.isfinite(self.tread.variance)]
        return GATE_TREADS * (float(np.median(known)) if len(known) else DEFAULT_TREAD_M)

    def match(self, measured: np.ndarray) -> tuple[np.ndarray, float]:
        """Which remembered nosing each measured one is.

        Args:
            measured: (k,) distances from the base, sorted.

        Returns:
            (k,) indices, -1 where none is near; and the share of measured nosings within the remembered range that
            found one (1 when none lies in it).
        """
        if len(self) == 0 or len(measured) == 0:
            return np.full(len(measured), -1), 1.0
        distance = np.abs(measured[:, None] - self.ahead[None, :])
        gate = self.gate()
        best = np.argmin(distance, axis=1)
        mutual = np.argmin(distance, axis=0)[best] == np.arange(len(measured))
        index = np.where(mutual & (distance[np.arange(len(measured)), best] < gate), best, -1)
        inside = (measured > self.ahead[0] - gate) & (measured < self.ahead[-1] + gate)
        share = float((index[inside] >= 0).mean()) if inside.any() else 1.0
        return index, share

    def update(self, nosings: tuple[Nosing, ...], offset_m: float, clear_m: float = 0.0) -> None:
        """Take a frame in.

        Args:
            nosings: nearest first.
            offset_m: from the base to the camera along the walking direction, metres, at the time of the frame but
                seen from where the base is now.
            clear_m: distance from the camera up to which every nosing beyond those measured would have been seen.
        """
        measured = np.array([nosing.distance_m for nosing in nosings]) + offset_m
        std = np.array([math.hypot(nosing.distance_std_m, NOSING_STD_FLOOR_M) for nosing in nosings])
        index, _ = self.match(measured)
        matched = np.nonzero(index >= 0)[0]
        if len(matched):
            self._correct(index[matched], measured[matched], std[matched])
        self._count(index, measured, offset_m + clear_m)
        for place in np.nonzero(index < 0)[0]:
            self._insert(float(measured[place]), float(std[place]))
        self._measure_lengths(nosings, measured)
        self._give_up(self.misses > self.hits + MAX_MISSES)

    def extend_behind(self, count: int, riser_m: float, riser_std_m: float) -> None:
        """Add nosings nearer than all known ones, a tread apart, that nobody has seen.

        Args:
            count: how many.
            riser_m, riser_std_m: of each, metres.
        """
        for _ in range(count):
            tread, known = self.tread.at(0, fallback=DEFAULT_TREAD_M), len(self)
            self._insert(float(self.ahead[0]) - tread, UNSEEN_STD_M)
            if len(self) > known:
                self.misses[0] = -UNSEEN_PATIENCE
                self.riser.update(0, riser_m, riser_std_m)

    def _correct(self, index: np.ndarray, measured: np.ndarray, std: np.ndarray) -> None:
        seen = index + 1
        noise = np.diag(std**2) + FRAME_STD_M**2
        cross = self._covariance[seen]
        gain = np.linalg.solve(cross[:, seen] + noise, cross).T
        correction = gain @ (measured - self.ahead[index])
        self.ahead = self.ahead + correction[1:]
        scale = self.odometry_scale + float(correction[0])
        self.odometry_scale = min(max(scale, -ODOMETRY_SCALE_LIMIT), ODOMETRY_SCALE_LIMIT)
        covariance = self._covariance - gain @ cross
        self._covariance = (covariance + covariance.T) / 2.0

    def _count(self, index: np.ndarray, measured: np.ndarray, clear: float) -> None:
        seen = index[index >= 0]
        self.hits[seen] += 1
        should = (self.ahead > measured.min() - 0.02) & (self.ahead < max(measured.max() + 0.02, clear))
        should[seen] = False
        self.misses[should] += 1

    def _insert(self, ahead: float, std: float) -> None:
        if len(self) >= MAX_NOSINGS:
            return
        place = int(np.searchsorted(self.ahead, ahead))
        near = [self.ahead[i] for i in (place - 1, place) if 0 <= i < len(self)]
        if near and min(abs(ahead - value) for value in near) < self.gate():
            return  # between two others: one of them, mismeasured
        # It was measured from the same base as the others, whose place is uncertain; its own error comes on top.
        row = self._covariance[:, 1:].min(axis=1) if len(self) else np.zeros(1)
        own = (max(float(row[1:].min()), 0.0) if len(self) else 0.0) + std**2 + FRAME_STD_M**2
        grown = np.insert(np.insert(self._covariance, place + 1, row, axis=0), place + 1, 0.0, axis=1)
        grown[:, place + 1] = np.insert(row, place + 1, own)
        self._covariance = grown
        self.ahead = np.insert(self.ahead, place, ahead)
        self.hits, self.misses = np.insert(self.hits, place, 1), np.insert(self.misses, place, 0)
        self.riser.insert(place)
        self.tread.insert(place)

    def _measure_lengths(self, nosings: tuple[Nosing, ...], measured: np.ndarray) -> None:
        index, _ = self.match(measured)
        for place, nosing in zip(index, nosings):
            if place < 0:
                continue
            if nosing.riser_m is not None and nosing.riser_std_m is not None:
                self.riser.update(int(place), nosing.riser_m, nosing.riser_std_m)
            if nosing.tread_m is not None and nosing.tread_std_m is not None:
                self.tread.update(int(place), nosing.tread_m, nosing.tread_std_m)

    def _give_up(self, mask: np.ndarray) -> None:
        """Drop nosings (n,) that were never there, and the length of each tread that ended at one of them."""
        if mask.any():
            self.tread.forget(np.nonzero(mask[1:])[0])
            self._keep(~mask)

    def _keep(self, mask: np.ndarray) -> None:
        if mask.all():
            return
        with_scale = np.insert(mask, 0, True)
        self.ahead, self._covariance = self.ahead[mask], self._covariance[np.ix_(with_scale, with_scale)]
        self.hits, self.misses = self.hits[mask], self.misses[mask]
        self.riser.keep(mask)
        self.tread.keep(mask)
