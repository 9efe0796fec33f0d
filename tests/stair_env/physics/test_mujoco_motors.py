"""MuJoCo's constraints as motors, through the simulation that steps them."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'stair-env[mujoco]'")

from stair_env.onboard.kinematics import LegKinematics
from stair_env.physics.mujoco_simulation import MujocoSimulation
from stair_env.physics.simulation import SUBSTEPS, Simulation
from stair_env.robots import ROBOTS
from stair_env.scene.shapes import build_stair_shapes
from stair_env.stairs import StairSpec


def placed(robot, engine=MujocoSimulation, height=0.0):
    sim = engine(robot)
    sim.build(build_stair_shapes(StairSpec()), 0.8)
    place = np.array([-1.0, 0.0, robot.stand_height + robot.foot_radius + height])
    sim.place_robot(place, 0.0, standing_angles(robot))
    return sim


def standing_angles(robot):
    return LegKinematics(robot).joint_angles(robot.nominal_feet)


@pytest.mark.parametrize("engine", [Simulation, MujocoSimulation])
def test_a_joint_follows_a_step_as_bullets_does(engine):
    """A free robot whose knees are told to bend: the angle on its way agrees between the engines."""
    robot = ROBOTS["aliengo"]
    sim, joints = placed(robot, engine, height=2.0), standing_angles(robot)
    sim.command_joints(joints)
    target = joints + np.tile([0.0, 0.0, -0.1], 4)
    sim.command_joints(target)
    sim.step_and_track(SUBSTEPS)
    sim.command_joints(target)
    sim.step_and_track(SUBSTEPS)
    left = np.abs(sim.joint_states()[0] - target)
    sim.close()
    assert left[2::3].max() < 0.02 and left.max() < 0.03


@pytest.mark.parametrize("strength", [0.3, 1.0])
def test_motors_never_exceed_their_torque(strength):
    robot = ROBOTS["a1"]
    sim, joints = placed(robot), standing_angles(robot)
    rng, largest = np.random.default_rng(0), 0.0
    for _ in range(24):
        sim.command_joints(joints + rng.uniform(-0.5, 0.5, 12), strength)
        sim.step_and_track(SUBSTEPS)
        largest = max(largest, np.abs(sim.joint_states()[2]).max())
    sim.close()
    assert largest == pytest.approx(strength * robot.max_torque, rel=1e-9)


def test_motors_that_are_too_weak_let_the_robot_down():
    robot = ROBOTS["aliengo"]
    sim, joints = placed(robot), standing_angles(robot)
    for _ in range(48):
        sim.command_joints(joints, strength=0.05)
        sim.step_and_track(SUBSTEPS)
    assert sim.base_state().position[2] < 0.7 * robot.stand_height and sim.foot_contacts().body_touches
    sim.close()
