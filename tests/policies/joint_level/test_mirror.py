"""Mirror images: twice is once, and the mirrored robot is where the mirrored joints say."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from policies import pretrained
from policies.joint_level.mirror import act_both_ways, begun, check_mirrors, mirror_joints, mirror_observation
from policies.make_env import CLIMB_ID, make_env
from stair_env.observation import PROPRIO_SLICES
from stair_env.onboard.kinematics import LegKinematics
from stair_env.onboard.memory import LAGS, MEMORY_KEY
from stair_env.robots import ROBOTS

KWARGS = {"actuation": "joint", "actuator": "position", "memory": True}


def walk(**more: Any) -> dict[str, np.ndarray]:
    env = make_env(CLIMB_ID, {**KWARGS, **more})
    env.action_space.seed(0)
    seen = [env.reset(seed=0)[0]] + [env.step(0.1 * env.action_space.sample())[0] for _ in range(30)]
    env.close()
    return {key: np.stack([observation[key] for observation in seen]) for key in seen[0]}


@pytest.mark.parametrize("actuation", ["joint", {"clock_hz": 4.0}])
def test_twice_is_once(actuation: Any) -> None:
    seen = walk(actuation=actuation)
    mirrored = mirror_observation(seen)
    again = mirror_observation(mirrored)
    assert all(np.array_equal(again[key], seen[key]) for key in seen)
    assert all(not np.array_equal(mirrored[key], seen[key]) for key in seen)


def test_feet_are_mirrored() -> None:
    kinematics = LegKinematics(ROBOTS["aliengo"])
    joints = walk()["proprio"][-1, PROPRIO_SLICES["joint_position"]].astype(np.float64)
    feet, mirrored = kinematics.foot_positions(joints), kinematics.foot_positions(mirror_joints(joints))
    assert np.allclose(mirrored, feet[[1, 0, 3, 2]] * [1, -1, 1], atol=1e-6)


def test_the_mirrored_clock_is_half_a_cycle_away() -> None:
    phase = PROPRIO_SLICES["phase"]
    for actuation, sign in (("joint", 1.0), ({"clock_hz": 4.0}, -1.0)):
        seen = walk(actuation=actuation)
        assert np.array_equal(mirror_observation(seen)["proprio"][:, phase], sign * seen["proprio"][:, phase])


def test_an_episode_has_begun_when_its_longest_memory_has() -> None:
    known = begun(walk()[MEMORY_KEY])
    assert not known[: max(LAGS) + 1].any() and known[max(LAGS) + 1 :].all()


def test_acting_both_ways_on_the_mirror_image_is_the_mirror_image_of_the_action() -> None:
    seen = walk()
    weights = np.random.default_rng(1).normal(size=(sum(value.shape[1] for value in seen.values()), 12))

    def act(observation: dict[str, np.ndarray]) -> np.ndarray:
        return np.tanh(np.concatenate(list(observation.values()), axis=1) @ weights)

    late = {key: value[-8:] for key, value in seen.items()}
    assert begun(late[MEMORY_KEY]).all()
    action, other = act_both_ways(act, late), act_both_ways(act, mirror_observation(late))
    assert other == pytest.approx(mirror_joints(action), abs=1e-6)
    assert not np.allclose(action, act(late))


def test_before_the_memory_is_full_a_policy_acts_on_what_it_sees_alone() -> None:
    first = {key: value[:1] for key, value in walk().items()}
    assert not begun(first[MEMORY_KEY]).any()
    act = lambda observation: observation["proprio"][:, :12]  # noqa: E731
    assert np.array_equal(act_both_ways(act, first), act(first))


def test_what_has_no_mirror_image_is_named() -> None:
    joints, seen = gym.spaces.Box(-1, 1, (12,)), {"proprio": gym.spaces.Box(-1, 1, (53,))}
    check_mirrors(gym.spaces.Dict(seen), joints)
    with pytest.raises(ValueError, match="privileged"):
        check_mirrors(gym.spaces.Dict({**seen, "privileged": joints}), joints)
    with pytest.raises(ValueError, match="one vector"):
        check_mirrors(joints, joints)
    with pytest.raises(ValueError, match="16"):
        check_mirrors(gym.spaces.Dict(seen), gym.spaces.Box(-1, 1, (16,)))


def test_the_shipped_joint_policy_is_symmetric_one_by_one_and_in_batches() -> None:
    policy = pretrained.load("aliengo-joint")
    seen = walk()
    late = {key: value[-8:] for key, value in seen.items()}
    actions = policy.predict(late)[0]
    assert policy.predict(mirror_observation(late))[0] == pytest.approx(mirror_joints(actions), abs=1e-5)
    alone = [policy.predict({key: value[row] for key, value in late.items()})[0] for row in range(8)]
    assert np.stack(alone) == pytest.approx(actions, abs=1e-5)
