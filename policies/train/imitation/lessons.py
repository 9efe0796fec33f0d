"""What rounds teach: features of every observation with the teacher's advice, and how a student is fitted to them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from policies.joint_level.mirror import begun, mirror_joints, mirror_observation
from policies.joint_level.teaching import TEACHER_KEY
from policies.train.imitation.run_folder import Samples
from stair_env.onboard.memory import MEMORY_KEY

if TYPE_CHECKING:
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    from policies.train.imitation.dagger import ImitationConfig

OUTLIER = 0.1  # of the action: advice farther off counts in proportion, not squared; mostly it comes too late
TWIN_ROWS = 20_000  # by which inputs are held to be equal

Lesson = tuple["torch.Tensor", "torch.Tensor"]  # features (n, features_dim) and advice (n, action size)


def fit(model: PPO, lessons: list[Lesson], updates: int, config: ImitationConfig, rng: np.random.Generator) -> float:
    """Fit the student's mean action to the advice.

    Args:
        model: the student.
        lessons: of all rounds.
        updates: gradient steps.
        config: of the run.
        rng: draws the batches.

    Returns:
        Root of the mean squared difference, with outliers' capped, over the last tenth of the batches, in units of the
        action.
    """
    import torch

    policy: Any = model.policy
    features, advice = (torch.cat(parts) for parts in zip(*lessons))
    learning = [*policy.mlp_extractor.policy_net.parameters(), *policy.action_net.parameters()]
    optimiser = torch.optim.Adam(learning, lr=config.learning_rate, fused=True)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, updates, config.learning_rate / 20)
    losses = []
    for _ in range(updates):
        rows = torch.as_tensor(rng.integers(0, len(advice), config.batch_size))
        mean = policy.action_net(policy.mlp_extractor.forward_actor(features[rows]))
        loss = torch.nn.functional.smooth_l1_loss(mean, advice[rows], beta=OUTLIER)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        losses.append(float(loss.detach()) * 2 * OUTLIER)
    return float(np.sqrt(np.mean(losses[-max(updates // 10, 1) :])))


def drop_idle_inputs(model: PPO, lessons: list[Lesson]) -> None:
    """Take inputs out of the first layers that never varied in the lessons, or that always were another's twin.

    On the oracle's block the age is always 0 and the confidence always that there is a block; what a network does with
    other values of them is chance, or half of what it makes of its twin, and a camera's block has other values. Of a
    constant its share goes into the bias, of a twin its weights go to the other: on the lessons nothing changes.

    Args:
        model: the student.
        lessons: of all rounds.
    """
    import torch

    policy: Any = model.policy
    features = torch.cat([lesson[0] for lesson in lessons])
    some = features[:: max(len(features) // TWIN_ROWS, 1)].numpy()
    varied = (features.amax(dim=0) > features.amin(dim=0)).numpy()
    _, first, twins = np.unique(some, axis=1, return_index=True, return_inverse=True)
    with torch.no_grad():
        for network in (policy.mlp_extractor.policy_net, policy.mlp_extractor.value_net):
            weight, bias = network[0].weight, network[0].bias
            for column, group in enumerate(twins.ravel().tolist()):
                if not varied[column]:
                    bias += weight[:, column] * features[0, column]
                elif first[group] != column:
                    weight[:, first[group]] += weight[:, column]
                else:
                    continue
                weight[:, column] = 0.0


def read_lesson(model: PPO, samples: Samples) -> Lesson:
    """What the actor's network reads of each observation, and the advice; and the same on the mirror images.

    Nothing between the observation and the network learns, so that this is worked out once for all updates, and after
    the statistics are final.
    """
    import torch

    policy: Any = model.policy
    seen = {key: samples[key] for key in samples if key != TEACHER_KEY}
    turned = begun(seen[MEMORY_KEY])
    mirrored = mirror_observation({key: value[turned] for key, value in seen.items()})
    both = {key: np.concatenate([value, mirrored[key]]) for key, value in seen.items()}
    advice = np.concatenate([samples[TEACHER_KEY], mirror_joints(samples[TEACHER_KEY][turned])])
    shown: Any = normalisation_of(model).normalize_obs(both)
    observation = {key: torch.as_tensor(value, dtype=torch.float32) for key, value in shown.items()}
    with torch.no_grad():
        features = policy.extract_features(observation, policy.pi_features_extractor)
    return features, torch.as_tensor(advice)


def normalisation_of(model: PPO) -> VecNormalize:
    """What normalises a student's observations."""
    venv = model.get_vec_normalize_env()
    assert venv is not None
    return venv
