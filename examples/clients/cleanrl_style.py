"""PPO in one file, as CleanRL writes it: no library but PyTorch, over Gymnasium's vector interface."""

import gymnasium as gym
import numpy as np
import torch
from gymnasium.spaces import flatten_space
from torch import nn

import stair_env  # noqa: F401

NUM_ENVS, STEPS, UPDATES, GAMMA, LAMBDA, CLIP = 2, 64, 2, 0.99, 0.95, 0.2


def network(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, outputs))


def flat(observation: dict[str, np.ndarray]) -> torch.Tensor:
    return torch.as_tensor(np.concatenate([observation[key] for key in sorted(observation)], axis=1))


def main() -> None:
    torch.manual_seed(0)
    envs = gym.make_vec("stair_env/StairClimb-v0", num_envs=NUM_ENVS)
    size, actions = flatten_space(envs.single_observation_space).shape[0], envs.single_action_space.shape[0]
    actor, critic = network(size, actions), network(size, 1)
    log_std = nn.Parameter(torch.full((actions,), -2.8))  # with more noise the gait falls before it learns
    optimiser = torch.optim.Adam([*actor.parameters(), *critic.parameters(), log_std], lr=3e-4)
    seen, _ = envs.reset(seed=0)
    ended = np.zeros(NUM_ENVS, bool)
    for update in range(UPDATES):
        rows: dict[str, list[torch.Tensor]] = {name: [] for name in ("x", "a", "logp", "v", "r", "going", "mine")}
        for _ in range(STEPS):
            with torch.no_grad():
                x = flat(seen)
                chosen = torch.distributions.Normal(actor(x), log_std.exp())
                a = chosen.sample()
                values = {"x": x, "a": a, "logp": chosen.log_prob(a).sum(1), "v": critic(x)[:, 0]}
            mine = ~ended  # the step after an end is a reset, of which nothing can be learned
            seen, reward, terminated, truncated, _ = envs.step(a.clamp(-1, 1).numpy())
            ended = terminated | truncated
            values |= {"r": torch.as_tensor(reward, dtype=torch.float32), "going": torch.as_tensor(~ended).float()}
            for name, value in {**values, "mine": torch.as_tensor(mine)}.items():
                rows[name].append(value)
        batch = {name: torch.stack(values) for name, values in rows.items()}
        with torch.no_grad():
            following = torch.cat([batch["v"][1:], critic(flat(seen))[:, 0][None]])
        advantage, last = torch.zeros_like(batch["r"]), torch.zeros(NUM_ENVS)
        for t in reversed(range(STEPS)):
            error = batch["r"][t] + GAMMA * following[t] * batch["going"][t] - batch["v"][t]
            last = error + GAMMA * LAMBDA * batch["going"][t] * last
            advantage[t] = last
        target, keep = advantage + batch["v"], batch["mine"]
        for _ in range(4):
            chosen = torch.distributions.Normal(actor(batch["x"]), log_std.exp())
            ratio = (chosen.log_prob(batch["a"]).sum(2) - batch["logp"]).exp()
            gain = torch.min(ratio * advantage, ratio.clamp(1 - CLIP, 1 + CLIP) * advantage)
            loss = (0.5 * (critic(batch["x"])[..., 0] - target) ** 2 - gain)[keep].mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        print(f"update {update}: mean reward {batch['r'][keep].mean():.3f}, loss {loss.item():.3f}")
    envs.close()


if __name__ == "__main__":
    main()
