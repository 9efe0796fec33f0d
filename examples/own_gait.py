"""Another gait: other numbers for the planner that is there, or a planner of one's own.

python examples/own_gait.py
"""

import gymnasium as gym
import numpy as np

import stair_env  # noqa: F401  (registers the environment ids)
from stair_env.parts import Gait, GaitConfig, TrotStyle

# --- the part: from here to the next line of dashes
# A walk: one foot in the air at a time, three quarters of the cycle on the ground.
style = TrotStyle(frequency_hz=1.6, capture_forward=0.1, capture_lateral=0.2)
WALK = GaitConfig(level=style, down=style, swing_fraction=0.25, leg_offsets=(0.0, 0.5, 0.25, 0.75), flat_speed=0.15)


class CautiousTrot(Gait):
    """The trot, slower while the last look at the stairs is old. It reads nothing but what it is handed."""

    def joint_targets(self, action, block, odometry_velocity, dt):
        careful = np.array(action)
        if block.valid and block.age > 0.3:
            careful[12] = -1.0  # the action's factor on the walking speed
        return super().joint_targets(careful, block, odometry_velocity, dt)


GAITS = {"walk": WALK, "cautious trot": CautiousTrot}  # a class is called with the robot
# --- end of the part


def main() -> None:
    for name, gait in GAITS.items():
        env = gym.make("stair_env/StairClimb-v0", gait=gait, riser_height=0.05, num_steps=3)
        env.reset(seed=0)
        done = False
        while not done:
            *_, terminated, truncated, info = env.step(np.zeros(env.action_space.shape, np.float32))
            done = terminated or truncated
        env.close()
        print(f"{name}: {info.get('termination', 'time is up')}, {info['steps_climbed']} steps climbed")


if __name__ == "__main__":
    main()
