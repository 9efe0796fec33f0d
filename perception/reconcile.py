"""Frames whose faces do not add up: creases are round, gravity is wrong or unknown, or both.

Faces that are read one by one (`perception.geometry`) are the more exact where depth is sharp; the cross-section as a
whole (`perception.rounded_geometry`) bears round creases and says how gravity lies. Here it is decided which counts.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from perception.faces import LineViews
from perception.reading import MIN_CORRECTION_RAD, Frame, Geometry, Reading, angle_between, camera_yaw, with_gravity
from perception.rounded_geometry import RoundedStairs, measure_rounded
from perception.section import steps_of

MAX_CORRECTION_RAD = math.radians(6.0)  # of gravity; beyond, one of the two is broken
MAX_TOLD_STD_RAD = math.radians(1.2)  # of the pitch that depth alone must tell
NO_GRAVITY_STD_RAD = math.radians(15.0)
GRAVITY_DOUBT_STD_RAD = math.radians(0.5)  # as on a walking robot, with long tails
MAX_MISFIT = 0.0022  # 1/m; faces of sharp depth under the right gravity stay below 0.0018 in 95 of 100 frames
SHARP_CREASE_PX, SHARP_NOISE = 3.0, 0.0025  # px, 1/m; up to here faces are straight between the lines
ENOUGH_STEPS = 3  # the paper evaluates as many; with fewer it is asked whether more can be seen

ReadFaces = Callable[[Frame, np.ndarray], Reading]


def is_sound(reading: Reading) -> bool:
    """Whether faces that were read one by one need no second opinion."""
    return reading.misfit < MAX_MISFIT and len(reading.geometry.steps) >= ENOUGH_STEPS


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
        frame.chosen, views, frame.depth_m, frame.intrinsics, guess, GRAVITY_DOUBT_STD_RAD, frame.omega_m
    )
    if whole is None:
        return with_gravity(reading, up)
    correction = angle_between(whole.camera_to_stair[2], up)
    if correction > MAX_CORRECTION_RAD:
        reason = f"gravity is {math.degrees(correction):.0f} degrees off what depth shows"
        return replace(frame.nothing(reason), up=up, gravity_correction_rad=correction)
    if correction > MIN_CORRECTION_RAD:
        reading = _better(reading, read_faces(frame, whole.camera_to_stair))
    return _choose(frame, reading, whole, up)


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
        told = whole is not None and whole.fit.turn_std_rad < MAX_TOLD_STD_RAD
        if told and (best is None or whole.fit.cost < best.fit.cost):
            best = whole
    if best is None:
        return replace(frame.nothing("gravity is unknown, and depth does not tell it"), gravity_source="depth")
    return _choose(frame, read_faces(frame, best.camera_to_stair), best, None)


def _choose(frame: Frame, reading: Reading, whole: RoundedStairs, up: np.ndarray | None) -> Geometry:
    """The faces, where they predict what is seen and show as many steps; else the whole."""
    steps = len(reading.geometry.steps)
    faces_fit = reading.misfit < MAX_MISFIT and steps > 0
    sharp = whole.fit.crease_px < SHARP_CREASE_PX and whole.fit.noise < SHARP_NOISE
    if faces_fit and (sharp or steps >= min(len(steps_of(whole.nosings)), ENOUGH_STEPS)):
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
    """The reading that predicts more of what is seen."""
    return other if other.misfit < one.misfit else one
