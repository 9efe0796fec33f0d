"""A control step in the middle of a flight, to change as a test needs."""

import numpy as np
import pytest

from stair_env.observation import NO_STAIRS
from stair_env.physics.simulation import BaseState, FootContacts, RobotReading
from stair_env.robots import get_robot
from stair_env.stairs import StairSpec
from stair_env.task.randomization import Body
from stair_env.task.step_state import Episode, StepRecorder

DT = 1 / 48
STAIRS = StairSpec(direction="up", riser_height=0.15, tread_depth=0.3, num_steps=4)
EPISODE = Episode(STAIRS, STAIRS.profile(), get_robot("aliengo"), Body(0.9, 0.0, 1.0), -0.8)


def base(x, y=0.0, above=0.38, tilt=0.0):
    """A base at x, so far above the ground, nose down by a tilt."""
    cos, sin = np.cos(tilt), np.sin(tilt)
    rotation = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    height = float(EPISODE.profile.height_at(x)) + above
    return BaseState(np.array([x, y, height]), rotation, np.zeros(3), np.zeros(3))


def feet_under(x):
    """(4, 3) feet under a base at x, each on the ground."""
    places = np.array([x + dx for dx in (0.24, 0.24, -0.24, -0.24)])
    return np.column_stack([places, np.zeros(4), EPISODE.profile.height_at(places)])


@pytest.fixture
def make_state():
    """Builds a StepState: a base that moved from x - travel to x, on feet that carry it; fields may be replaced."""

    def make(x=-0.5, travel=0.0, feet=None, force=(0.0, 0.0, 50.0), action=None, episode=EPISODE, **changes):
        places = {name: changes.pop(name) for name in ("y", "above", "tilt") if name in changes}
        contacts = FootContacts(np.ones(4, bool), np.tile(force, (4, 1)), False)
        feet = feet_under(x) if feet is None else np.array(feet)
        still = RobotReading(np.zeros(12), np.zeros(12), np.zeros(12), contacts, feet_under(x))
        moved = RobotReading(np.zeros(12), np.ones(12), np.full(12, -2.0), contacts, feet)
        recorder = StepRecorder(episode, 16)
        recorder.begin(base(x - travel), still, np.zeros(12), NO_STAIRS, NO_STAIRS, DT)
        action = np.zeros(16) if action is None else np.array(action)
        state = recorder.record(DT, base(x, **places), moved, np.zeros(12), action, NO_STAIRS, NO_STAIRS, DT)
        return state._replace(**changes)

    return make
