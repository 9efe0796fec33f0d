"""Another terrain: a sampler draws what no keyword names, here worn flights up and down again over a landing.

python examples/own_terrain.py
"""

import gymnasium as gym
import numpy as np

import stair_env  # noqa: F401  (registers the environment ids)
from stair_env.parts import ObservationTerm, StairSpec, StepState


# --- the part: from here to the next line of dashes
class WornStairs:
    """Risers and treads that differ from step to step. Returning a SceneSpec also sets walls, things and light."""

    def sample(self, rng: np.random.Generator) -> StairSpec:
        count = int(rng.integers(2, 5))
        risers, treads = (tuple(rng.uniform(-0.012, 0.012, count)) for _ in range(2))
        return StairSpec("up_down", 0.06, 0.34, count, landing_depth=1.2, riser_offsets=risers, tread_offsets=treads)


def ground_below(state: StepState) -> np.ndarray:
    """(4,) height of the ground under each foot below the base, metres: a part of the observation for a teacher."""
    return state.after.position[2] - np.array(state.ground_under_feet)


heights = ObservationTerm(ground_below, gym.spaces.Box(-2.0, 2.0, (4,), np.float32))
ENV_KWARGS = {"sampler": WornStairs(), "observations": {"ground_below": heights}}
# --- end of the part


def main() -> None:
    env = gym.make("stair_env/StairClimb-v0", **ENV_KWARGS)
    for seed in range(3):
        observation, info = env.reset(seed=seed)
        edges, done = info["truth"]["num_steps"], False
        while not done:  # zero action: the gait alone
            observation, _, terminated, truncated, info = env.step(np.zeros(env.action_space.shape, np.float32))
            done = terminated or truncated
        ending = info.get("termination", "time is up")
        print(f"seed {seed}: {ending}, {info['steps_climbed']} of {edges} edges, ground {observation['ground_below']}")
    env.close()


if __name__ == "__main__":
    main()
