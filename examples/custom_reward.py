"""Change the reward: weights of the named terms by keyword, a term of one's own by wrapper.

python examples/custom_reward.py
"""

import gymnasium as gym

import stair_env  # noqa: F401  (registers the environment ids)


class EnergyPenalty(gym.Wrapper):
    """Charges for the joints' mechanical work; the term shows up in `info["reward_terms"]` like the others."""

    def __init__(self, env: gym.Env, per_joule: float = 0.002) -> None:
        super().__init__(env)
        self._per_joule = per_joule
        self._energy_j = 0.0

    def reset(self, **kwargs):
        observation, info = self.env.reset(**kwargs)
        self._energy_j = info["truth"]["energy_j"]
        return observation, info

    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action)
        used, self._energy_j = info["truth"]["energy_j"] - self._energy_j, info["truth"]["energy_j"]
        penalty = -self._per_joule * used
        info["reward_terms"]["energy"] = penalty
        return observation, float(reward) + penalty, terminated, truncated, info


def main() -> None:
    plain = gym.make("stair_env/StairClimb-v0", riser_height=0.08, reward_weights={"riser_hit": 0.5, "nosing": 0.0})
    env = EnergyPenalty(plain)
    env.reset(seed=0)
    totals: dict[str, float] = {}
    done = False
    while not done:
        _, _, terminated, truncated, info = env.step(env.action_space.sample() * 0.0)
        for name, value in info["reward_terms"].items():
            totals[name] = totals.get(name, 0.0) + value
        done = terminated or truncated
    env.close()
    for name, value in sorted(totals.items(), key=lambda item: item[1]):
        print(f"{name:<14}{value:>10.2f}")


if __name__ == "__main__":
    main()
