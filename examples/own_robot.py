"""A robot of one's own is a RobotSpec and a URDF: here an A1 with longer legs and a camera that looks further down.

python examples/own_robot.py
"""

import dataclasses
import tempfile
from pathlib import Path

import gymnasium as gym
import numpy as np
import pybullet_data

import stair_env  # noqa: F401  (registers the environment ids)
from stair_env.parts import ROBOTS, CameraMount


def write_urdf(folder: Path) -> Path:
    """Your robot comes with a URDF; this one is A1's with thighs and shanks that are 2 cm longer."""
    a1 = Path(pybullet_data.getDataPath()) / "a1"
    text = (a1 / "a1.urdf").read_text().replace('filename="meshes/', f'filename="{a1}/meshes/')
    path = folder / "a1_long.urdf"
    path.write_text(text.replace('<origin rpy="0 0 0" xyz="0 0 -0.2"/>', '<origin rpy="0 0 0" xyz="0 0 -0.22"/>'))
    return path


def make_kwargs(urdf: Path) -> dict:
    # --- the part: from here to the next line of dashes
    robot = dataclasses.replace(
        ROBOTS["a1"],  # or every field of RobotSpec: joint and toe names, link lengths, torque, mass
        name="a1_long",
        urdf=str(urdf),
        upper_length=0.22,
        lower_length=0.22,
        stand_height=0.31,
        camera=CameraMount(position=(0.27, 0.0, 0.05), pitch_down_rad=0.55),
    )
    return {"robot": robot, "riser_height": 0.06, "num_steps": 4}
    # --- end of the part


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        env = gym.make("stair_env/StairClimb-v0", **make_kwargs(write_urdf(Path(folder))))
        for seed in range(3):
            env.reset(seed=seed)
            done = False
            while not done:  # zero action: the gait alone
                *_, terminated, truncated, info = env.step(np.zeros(env.action_space.shape, np.float32))
                done = terminated or truncated
            print(f"seed {seed}: {info.get('termination', 'time is up')}, {info['steps_climbed']} steps climbed")
        env.close()


if __name__ == "__main__":
    main()
