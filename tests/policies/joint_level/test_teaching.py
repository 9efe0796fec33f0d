"""The teacher: who follows it climbs, whatever the student's stair block says, and it keeps step with who does not."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np
import pytest

from policies.joint_level.teaching import TEACHER_KEY
from policies.make_env import CLIMB_ID, make_env
from stair_env.common.constants import CONTROL_DT
from stair_env.observation import PROPRIO_SLICES

KWARGS = {"actuation": "joint", "actuator": "position", "teacher": "gait", "riser_height": 0.14, "num_steps": 4}


STANCE = {"teacher": "stance", "riser_height": 0.19}
CLOCK = {**STANCE, "actuation": {"clock_hz": 4.0}}


@pytest.mark.parametrize("lesson", [{}, STANCE, CLOCK])
@pytest.mark.parametrize("direction", ["up", "down"])
def test_who_follows_climbs_even_blind(direction: str, lesson: dict[str, Any]) -> None:
    env = make_env(CLIMB_ID, {**KWARGS, "direction": direction, "stair_source": "blind", **lesson}, monitor=False)
    _, info = env.reset(seed=3)
    done = False
    while not done:
        assert env.action_space.contains(info[TEACHER_KEY])
        _, _, terminated, truncated, info = env.step(info[TEACHER_KEY])
        done = terminated or truncated
    assert info["is_success"]
    env.close()


def test_the_teacher_waits_for_a_late_student() -> None:
    """A student that acts three control steps late: the teacher's cycle turns more slowly than its own."""
    env = make_env(CLIMB_ID, KWARGS, monitor=False)
    gait: Any = env.get_wrapper_attr("_gait")
    turned = []
    for lag in (0, 3):
        _, info = env.reset(seed=3)
        late: deque[np.ndarray] = deque([info[TEACHER_KEY]] * (lag + 1), maxlen=lag + 1)
        phase, before = 0.0, gait.phase
        for _ in range(40):
            late.append(info[TEACHER_KEY])
            _, _, _, _, info = env.step(late[0])
            phase, before = phase + (gait.phase - before) % 1.0, gait.phase
        turned.append(phase)
    assert turned[1] < 0.95 * turned[0]
    env.close()


def test_a_clocked_student_is_taught_to_stride_with_its_clock() -> None:
    env = make_env(CLIMB_ID, {**KWARGS, **CLOCK}, monitor=False)
    gait: Any = env.get_wrapper_attr("_gait")
    observation, info = env.reset(seed=3)
    for _ in range(20):
        observation, _, _, _, info = env.step(info[TEACHER_KEY])
        sine, cosine = observation["proprio"][PROPRIO_SLICES["phase"]].tolist()
        ahead = (gait.phase - math.atan2(sine, cosine) / (2 * math.pi)) % 1.0
        assert ahead == pytest.approx(4.0 * CONTROL_DT, abs=1e-3)  # the advice is for the end of the coming step
    env.close()


def test_wrong_teachers_are_named() -> None:
    with pytest.raises(ValueError, match="'trainer' must be one of gait, stance"):
        make_env(CLIMB_ID, {**KWARGS, "teacher": "trainer"})
    with pytest.raises(ValueError, match="no stances are known for robot 'laikago'"):
        make_env(CLIMB_ID, {**KWARGS, "teacher": "stance", "robot": "laikago"})
