import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stair_env.common.validation import SpecError
from stair_env.env import StairClimbEnv
from stair_env.onboard.kinematics import LegKinematics
from stair_env.physics.simulation import CONTROL_RATE_HZ, Simulation
from stair_env.robots import ROBOTS, get_robot

legs = st.lists(st.tuples(st.floats(-0.5, 0.5), st.floats(-0.3, 1.4), st.floats(-2.4, -0.7)), min_size=4, max_size=4)


@given(legs, st.sampled_from(sorted(ROBOTS)))
def test_inverse_undoes_forward(angles, name):
    kinematics = LegKinematics(ROBOTS[name])
    joints = np.array(angles).ravel()
    feet = kinematics.foot_positions(joints)
    assert kinematics.foot_positions(kinematics.joint_angles(feet)) == pytest.approx(feet, abs=1e-9)


@settings(max_examples=30)
@given(st.lists(st.floats(-3, 3), min_size=12, max_size=12))
def test_out_of_reach_is_finite(numbers):
    joints = LegKinematics(get_robot("aliengo")).joint_angles(np.array(numbers).reshape(4, 3))
    assert np.isfinite(joints).all()


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_agrees_with_the_physics(name):
    robot = ROBOTS[name]
    joints = np.tile([0.1, 0.8, -1.5], 4) + np.linspace(-0.1, 0.1, 12)
    sim = Simulation(robot)
    try:
        sim.build((), 0.9)
        sim.place_robot(np.array([0.3, -0.2, 1.0]), yaw=0.7, joint_angles=joints, pitch=-0.2)
        state = sim.base_state()
        world = state.position + LegKinematics(robot).foot_positions(joints) @ state.rotation.T
        assert state.position == pytest.approx([0.3, -0.2, 1.0], abs=1e-6)
        assert state.yaw == pytest.approx(0.7, abs=1e-6)
        assert sim.foot_positions() == pytest.approx(world, abs=2e-3)  # the URDFs round their link lengths
        assert sim.joint_states()[0] == pytest.approx(joints, abs=1e-9)
    finally:
        sim.close()


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_stands_before_the_stairs(name):
    robot = ROBOTS[name]
    env = StairClimbEnv(robot=name, actuation="joint")
    try:
        env.reset(seed=0, options={"x": -1.5, "y": 0.0, "yaw": 0.0})
        for _ in range(round(3 * CONTROL_RATE_HZ)):
            observation, _, terminated, _, info = env.step(np.zeros(12))
            assert not terminated
    finally:
        env.close()
    assert env.observation_space.contains(observation)
    down = observation["proprio"][:3]
    assert down == pytest.approx([0.0, 0.0, -1.0], abs=0.03)
    x, y, z = info["truth"]["position"]
    assert (x, y) == pytest.approx((-1.5, 0.0), abs=0.03)
    assert z == pytest.approx(robot.stand_height + robot.foot_radius, abs=0.025)


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_weighs_what_its_spec_says(name):
    sim = Simulation(ROBOTS[name])
    try:
        sim.build((), 0.9)
        links = range(-1, sim.client.getNumJoints(sim.body))
        weight = sum(sim.client.getDynamicsInfo(sim.body, link)[0] for link in links)
        assert weight == pytest.approx(ROBOTS[name].mass, rel=0.02)
    finally:
        sim.close()


def test_unknown_robot_names_the_choices():
    with pytest.raises(SpecError, match="aliengo"):
        get_robot("spot")
