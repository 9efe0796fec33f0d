"""Change the reward and the end of an episode by functions of a `StepState`.

python examples/own_reward.py
"""

import gymnasium as gym
import numpy as np

import stair_env  # noqa: F401  (registers the environment ids)
from stair_env.parts import RewardTerm, StepState


# --- the part: from here to the next line of dashes
def energy(state: StepState) -> float:
    """Minus the joints' mechanical work in this step, joules."""
    return -state.joint_power_w * state.dt_s


def foot_slip(state: StepState) -> float:
    """Minus how far feet that touch the ground slide in this step, metres."""
    slid = np.linalg.norm(state.foot_velocities[:, :2], axis=1) * state.dt_s
    return -float(slid[state.contacts.touching].sum())


def knelt(state: StepState) -> bool:
    return state.contacts.body_touches and state.time_s > 1.0


rewards = {"energy": RewardTerm(energy, 0.002), "foot_slip": RewardTerm(foot_slip, 1.0), "nosing": None}
ENV_KWARGS = {"rewards": rewards, "terminations": {"knelt": knelt}, "riser_height": 0.08}
# --- end of the part


def main() -> None:
    env = gym.make("stair_env/StairClimb-v0", **ENV_KWARGS)
    env.reset(seed=0)
    totals: dict[str, float] = {}
    done = False
    while not done:  # zero action: the gait alone
        *_, terminated, truncated, info = env.step(np.zeros(env.action_space.shape, np.float32))
        for name, value in info["reward_terms"].items():
            totals[name] = totals.get(name, 0.0) + value
        done = terminated or truncated
    env.close()
    for name, value in sorted(totals.items(), key=lambda item: item[1]):
        print(f"{name:<14}{value:>10.2f}")


if __name__ == "__main__":
    main()
