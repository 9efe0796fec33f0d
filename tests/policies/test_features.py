"""The network's view of the stair block."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
import torch

import policies.features as features_module
from policies.features import CLIP, STAIR_SCALE, StairActorCriticPolicy, StairFeatures, StairSacPolicy
from stair_env.observation import STAIR_FIELDS, STAIR_HIGH, STAIR_LOW, stair_space

SPACE = gym.spaces.Dict({"proprio": gym.spaces.Box(-1, 1, (4,)), "stair": stair_space()})


def features(stair: np.ndarray) -> np.ndarray:
    observation = {"proprio": torch.ones(len(stair), 4), "stair": torch.as_tensor(stair, dtype=torch.float32)}
    return StairFeatures(SPACE)(observation).numpy()


def test_every_field_has_a_scale() -> None:
    assert tuple(STAIR_SCALE) == STAIR_FIELDS


def test_valid_blocks_are_scaled_and_bounded() -> None:
    rng = np.random.default_rng(0)
    stair = rng.uniform(STAIR_LOW, STAIR_HIGH, (200, 8))
    stair[:, 0] = 1.0
    out = features(stair)
    assert out.shape == (200, 12) and np.array_equal(out[:, :4], np.ones((200, 4)))
    assert np.abs(out).max() <= CLIP
    middle = np.array([[1, 1, 0.30, 0.12, 0.15, 0, 0, 1]])
    assert np.allclose(features(middle)[0, 4:], [1, 1, 0, 0, 0, 0, 0, 1])


def test_an_invalid_block_is_all_zero() -> None:
    assert not features(np.zeros((3, 8)))[:, 4:].any()


def test_other_spaces_are_refused() -> None:
    with pytest.raises(ValueError, match="Dict"):
        StairFeatures(gym.spaces.Box(-1, 1, (3,)))  # type: ignore[arg-type]


def test_a_privileged_block_reaches_the_critic_and_not_the_actor() -> None:
    space = gym.spaces.Dict({**SPACE.spaces, "privileged": gym.spaces.Box(-1, 1, (3,))})
    policy = StairActorCriticPolicy(space, gym.spaces.Box(-1, 1, (2,)), lambda _: 1e-3)
    torch.manual_seed(0)
    batch = {key: torch.as_tensor(part.sample())[None] for key, part in space.spaces.items()}
    other = {**batch, "privileged": batch["privileged"] + 0.5}
    assert torch.equal(policy.get_distribution(batch).mode(), policy.get_distribution(other).mode())
    assert torch.equal(policy(batch, deterministic=True)[0], policy(other, deterministic=True)[0])
    assert not torch.equal(policy.predict_values(batch), policy.predict_values(other))


@pytest.mark.parametrize("name", ["StairSacPolicy", "StairTd3Policy", "StairTqcPolicy"])
def test_the_actors_of_off_policy_algorithms_do_not_see_the_privileged_block(name: str) -> None:
    if name == "StairTqcPolicy":
        pytest.importorskip("sb3_contrib")
    space = gym.spaces.Dict({**SPACE.spaces, "privileged": gym.spaces.Box(-1, 1, (3,))})
    policy = getattr(features_module, name)(space, gym.spaces.Box(-1, 1, (2,)), lambda _: 1e-3, net_arch=[8])
    policy.set_training_mode(False)
    batch = {key: torch.as_tensor(part.sample())[None] for key, part in space.spaces.items()}
    other = {**batch, "privileged": batch["privileged"] + 0.5}
    assert torch.equal(policy._predict(batch, True), policy._predict(other, True))
    action = torch.zeros(1, 2)
    values = [torch.cat([torch.as_tensor(v) for v in policy.critic(seen, action)], 1) for seen in (batch, other)]
    assert not torch.equal(*values)


@pytest.mark.parametrize(("policy", "expected"), [(StairActorCriticPolicy, -2.8), (StairSacPolicy, -2.0)])
def test_little_exploration_survives_a_search_that_replaces_the_arguments(policy: type, expected: float) -> None:
    made = policy(SPACE, gym.spaces.Box(-1, 1, (2,)), lambda _: 1e-3, net_arch=[8])
    found = made.log_std if hasattr(made, "log_std") else torch.tensor(made.actor.log_std_init)
    assert torch.allclose(found, torch.tensor(expected))
