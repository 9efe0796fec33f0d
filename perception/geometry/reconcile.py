"""Frames whose faces do not add up: creases are round, gravity is wrong or unknown, or both.

Faces that are read one by one (`perception.geometry`) are the more exact where depth is sharp; the cross-section as a
whole (`perception.geometry.rounded_geometry`) bears round creases and says how gravity lies. Here it is decided which
counts.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from perception.geometry.profile.depth_profile import pitch_from_cut
from perception.geometry.reading import (
    MIN_CORRECTION_RAD,
    Frame,
    Geometry,
    Reading,
    angle_between,
    camera_yaw,
    with_gravity,
)
from perception.geometry.results import steps_of
from perception.geometry.rounded_geometry import RoundedStairs, measure_rounded
from perception.geometry.strips.levelling import level_sideways, turn_pitch
from perception.geometry.strips.strip_planes import LineViews, sample_strips

CUT_MISFIT = 0.003  # 1/m; of faces under another gravity, for that to be believed
ROLL_DOUBT_STD_RAD = math.radians(2.0)
MAX_CORRECTION_RAD = math.radians(6.0)  # of gravity; beyond, one of the two is broken
MAX_TOLD_STD_RAD = math.radians(1.2)  # of the pitch that depth alone must tell
NO_GRAVITY_STD_RAD = math.radians(15.0)
LOOSE_STD_RAD = math.radians(2.0)  # of an orientation that gravity no longer holds
GRAVITY_DOUBT_STD_RAD = math.radians(0.5)  # as on a walking robot, with long tails
MAX_MISFIT = 0.0022  # 1/m; faces of sharp depth under the right gravity stay below 0.0018 in 95 of 100 frames
SHARP_CREASE_PX, SHARP_NOISE = 3.0, 0.0025  # px, 1/m; up to here faces are straight between the lines
MIN_WHOLE_STEPS = 2  # one alone has nothing to be like
ENOUGH_STEPS = 3  # the paper evaluates as many; with fewer it is asked whether more can be seen

ReadFaces = Callable[..., Reading]  # (frame, camera to (f, l, h), gravity_std_rad=...)


def is_sound(reading: Reading, up: np.ndarray) -> bool:
    """Whether faces that were read one by one, with gravity against `up` (3,), need no second opinion.

    Their own fit corrects gravity by what it may be wrong on a walking robot; if it wants more, it wants yet more.
    """
    enough = reading.misfit < MAX_MISFIT and len(reading.geometry.steps) >= ENOUGH_STEPS
    return enough and angle_between(reading.camera_to_stair[2], up) < MIN_CORRECTION_RAD


def reconcile(
    frame: Frame, reading: Reading, views: LineViews, guess: np.ndarray, up: np.ndarray, read_faces: ReadFaces
) -> Geometry:
    """The answer that counts.

    Args:
        frame: what is measured.
        reading: of the faces one by one, with gravity as it was given.
        views: of the frame's chosen lines.
        guess: (3, 3) camera to (f, l, h), from gravity and the lines.
        up: (3,) against gravity as it was given, camera frame.
        read_faces: reads the faces again under another orientation.
    """
    whole = measure_rounded(
        frame.chosen, views, frame.depth_m, frame.intrinsics, guess, GRAVITY_DOUBT_STD_RAD, frame.omega_m, reading.scan
    )
    if whole is None:
        return _by_cut(frame, reading, views, guess, up, read_faces)
    correction = angle_between(whole.camera_to_stair[2], up)
    if correction > MAX_CORRECTION_RAD:
        return _disagreement(frame, correction, up)
    if correction > MIN_CORRECTION_RAD:
        reading = _better(reading, read_faces(frame, whole.camera_to_stair, gravity_std_rad=LOOSE_STD_RAD))
    return _choose(frame, reading, whole, up)


def _by_cut(
    frame: Frame, reading: Reading, views: LineViews, guess: np.ndarray, up: np.ndarray, read_faces: ReadFaces
) -> Geometry:
    """The faces, under the pitch that depth alone shows best and the roll in which the lines agree.

    The lines are too few to explain all of the depth, but that is sharp and may show the rest.
    """
    turn = pitch_from_cut(reading.scan) if reading.scan is not None else 0.0
    if abs(turn) > MIN_CORRECTION_RAD:
        strips = sample_strips(frame.chosen, frame.depth_m, frame.intrinsics)
        nothing_known = np.zeros(len(frame.used) + 1, dtype=np.int64)
        turned = turn_pitch(turn) @ guess
        levelled, _ = level_sideways(strips, nothing_known, turned, views, ROLL_DOUBT_STD_RAD)
        again = read_faces(frame, levelled, gravity_std_rad=LOOSE_STD_RAD)
        if len(again.geometry.steps) > len(reading.geometry.steps) and again.misfit < CUT_MISFIT:
            correction = angle_between(again.camera_to_stair[2], up)
            return with_gravity(again, up) if correction < MAX_CORRECTION_RAD else _disagreement(frame, correction, up)
    return with_gravity(reading, up)


def _disagreement(frame: Frame, correction_rad: float, up: np.ndarray) -> Geometry:
    reason = f"gravity is {math.degrees(correction_rad):.0f} degrees off what depth shows"
    return replace(frame.nothing(reason), up=up, gravity_correction_rad=correction_rad)


def without_gravity(frame: Frame, views: LineViews, guesses: list[np.ndarray], read_faces: ReadFaces) -> Geometry:
    """The answer when nothing is known of gravity: what stands and lies in the picture tells it.

    Args:
        frame: what is measured.
        views: of the frame's chosen lines.
        guesses: (3, 3) camera to (f, l, h) of several pitches that the camera may have.
        read_faces: as in `reconcile`.
    """
    best: RoundedStairs | None = None
    for guess in guesses:
        whole = measure_rounded(
            frame.chosen, views, frame.depth_m, frame.intrinsics, guess, NO_GRAVITY_STD_RAD, frame.omega_m
        )
        if whole is None or whole.fit.turn_std_rad >= MAX_TOLD_STD_RAD:
            continue
        if best is None or whole.fit.cost < best.fit.cost:
            best = whole
    if best is None:
        return replace(frame.nothing("gravity is unknown, and depth does not tell it"), gravity_source="depth")
    return _choose(frame, read_faces(frame, best.camera_to_stair, gravity_std_rad=LOOSE_STD_RAD), best, None)


def _choose(frame: Frame, reading: Reading, whole: RoundedStairs, up: np.ndarray | None) -> Geometry:
    """The faces, where they predict what is seen and show as many steps; else the whole."""
    steps = len(reading.geometry.steps)
    faces_fit = reading.misfit < MAX_MISFIT and steps > 0
    sharp = whole.fit.crease_px < SHARP_CREASE_PX and whole.fit.noise < SHARP_NOISE
    seen_whole = len(steps_of(whole.nosings))
    few = seen_whole < MIN_WHOLE_STEPS
    if few or (sharp and steps) or (faces_fit and steps >= min(seen_whole, ENOUGH_STEPS)):
        return with_gravity(reading, up)
    geometry = Geometry(
        whole.fit.direction,
        whole.nosings,
        steps_of(whole.nosings),
        camera_yaw(whole.camera_to_stair),
        whole.yaw_std_rad,
        frame.kinds(whole.kinds),
        "" if any(nosing.riser_m for nosing in whole.nosings) else "no complete riser in view",
        crease_px=whole.fit.crease_px,
    )
    return with_gravity(Reading(geometry, whole.camera_to_stair), up)


def _better(one: Reading, other: Reading) -> Reading:
    """The other reading, under better gravity, if it predicts what is seen."""
    return other if other.misfit < max(one.misfit, MAX_MISFIT) and other.geometry.steps else one
