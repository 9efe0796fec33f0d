import numpy as np
import pytest

from stair_env.common.validation import SpecError
from stair_env.env import StairClimbEnv
from stair_env.onboard.kinematics import LegKinematics
from stair_env.physics.motors import MotorBody, PdActuator, PdMotors, PositionMotors, TorqueMotors, make_motors
from stair_env.physics.simulation import Simulation
from stair_env.robots import ROBOTS
from stair_env.scene.shapes import build_stair_shapes
from stair_env.stairs import StairSpec

ROBOT = ROBOTS["aliengo"]
STANDING = LegKinematics(ROBOT).joint_angles(ROBOT.nominal_feet)
STILL = np.zeros(12)


def motors(**fields):
    made = PdMotors(PdActuator(**fields), ROBOT)
    made.reset(MotorBody(), STANDING)
    return made


def test_torque_is_a_spring_and_a_damper():
    pd = motors(kp=[10.0, 20.0, 30.0], kd=2.0)
    assert pd.torques(STANDING - 0.1, STILL) == pytest.approx([1.0, 2.0, 3.0] * 4)
    assert pd.torques(STANDING, np.full(12, 0.5)) == pytest.approx(np.full(12, -1.0))


def test_limits_of_torque_and_speed():
    pd = motors(kp=1000.0, kd=0.0, max_torque=30.0, max_speed=20.0, corner=0.5)
    pushed = [pd.torques(STANDING - 1.0, np.full(12, speed))[0] for speed in (-40.0, 0.0, 10.0, 15.0, 20.0, 40.0)]
    assert pushed == pytest.approx([30.0, 30.0, 30.0, 15.0, 0.0, 0.0])  # braking has all of it
    pulled = [pd.torques(STANDING + 1.0, np.full(12, -speed))[0] for speed in (-40.0, 0.0, 10.0, 15.0, 20.0, 40.0)]
    assert pulled == pytest.approx([-torque for torque in pushed])


def test_feed_forward_damps_only_what_differs_from_the_targets_own_motion():
    rate = 0.1 * 48
    for share in (0.0, 0.5, 1.0):
        pd = motors(kp=0.0, kd=2.0, feed_forward=share)
        pd.command(STANDING + 0.1)
        assert pd.torques(STANDING, np.full(12, rate)) == pytest.approx(np.full(12, 2.0 * (share - 1.0) * rate))


def test_what_was_drawn_scales_gains_and_limits():
    pd = motors(kp=10.0, kd=1.0, max_torque=5.0)
    pd.reset(MotorBody(strength=0.5, stiffness=2.0, damping=3.0), STANDING)
    assert pd.torques(STANDING - 0.1, STILL)[0] == pytest.approx(2.0)
    assert pd.torques(STANDING, np.full(12, 0.5))[0] == pytest.approx(-1.5)
    assert pd.torques(STANDING - 9.0, STILL)[0] == pytest.approx(2.5)


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_robots_stand_on_their_own_gains(name):
    """Twelve torques hold the robot up for a second, and are what the reading tells."""
    robot = ROBOTS[name]
    sim, made = Simulation(robot, visible=False), make_motors("pd", robot, "position")
    sim.build(build_stair_shapes(StairSpec()), friction=0.8)
    joints = LegKinematics(robot).joint_angles(robot.nominal_feet)
    sim.place_robot(np.array([-1.0, 0.0, robot.stand_height + robot.foot_radius]), 0.0, joints)
    made.reset(sim, MotorBody(), joints)
    made.hold(joints, 240)
    reading, base = sim.read_robot(), sim.base_state()
    sim.close()
    assert base.rotation[2, 2] > 0.98 and reading.contacts.touching.all()
    assert np.abs(reading.joint_positions - joints).max() < 0.2 and np.abs(reading.joint_velocities).max() < 0.5
    weight = robot.kp * (joints - reading.joint_positions) - robot.kd * reading.joint_velocities
    assert reading.joint_torques == pytest.approx(weight, abs=0.5)


def test_rotors_make_joints_slower_to_speed_up():
    """A free leg under one torque: with a rotor its knee gains speed as its inertia says."""
    speeds = []
    for inertia in (0.0, 0.02):
        sim = Simulation(ROBOT, visible=False)
        sim.build(build_stair_shapes(StairSpec()), friction=0.8)
        sim.place_robot(np.array([-1.0, 0.0, 3.0]), 0.0, STANDING)
        sim.release_joints()
        sim.add_rotor_inertia(np.full(12, inertia))
        sim.step_under_torques(lambda angles, velocities: np.tile([0.0, 0.0, 1.0], 4), 1)
        speeds.append(sim.joint_states()[1][2])
        sim.close()
    assert speeds[0] > 2.0 * speeds[1] > 0.0


def test_names_fields_objects_and_factories():
    own = motors()
    assert isinstance(make_motors("position", ROBOT, "pd"), PositionMotors)
    assert isinstance(make_motors(None, ROBOT, "position"), PositionMotors)
    for actuator in ("pd", {"kp": 90.0}, PdActuator(kp=90.0), own, lambda robot: PdMotors(PdActuator(), robot)):
        assert isinstance(make_motors(actuator, ROBOT, "position"), TorqueMotors)
    assert make_motors(own, ROBOT, "pd").actuator is not own


@pytest.mark.parametrize(
    ("actuator", "message"),
    [
        ("hydraulic", "actuator='hydraulic'.*position.*pd"),
        (3, "actuator=3.*torques"),
        (PdMotors, "PdMotors"),
        ({"ki": 1.0}, "actuator.*ki.*kp"),
        ({"kp": [1.0, 2.0]}, r"actuator\.kp.*three"),
        ({"kd": -1.0}, r"actuator\.kd"),
        ({"corner": 1.0}, r"actuator\.corner"),
        ({"feed_forward": 2.0}, r"actuator\.feed_forward"),
    ],
)
def test_wrong_actuators_are_named(actuator, message):
    with pytest.raises((SpecError, TypeError), match=message):
        StairClimbEnv(actuator=actuator)


def test_joint_actions_are_torque_driven_unless_told():
    assert isinstance(StairClimbEnv(actuation="joint")._motors, TorqueMotors)
    assert isinstance(StairClimbEnv(actuation="joint", actuator="position")._motors, PositionMotors)
    assert isinstance(StairClimbEnv()._motors, PositionMotors)


def test_an_episode_under_torques_can_be_repeated():
    env, found = StairClimbEnv(actuation="joint", randomization=True, command=[0.2, 0.6]), []
    for _ in range(2):
        observation, _ = env.reset(seed=3)
        rng = np.random.default_rng(0)
        for _ in range(15):
            observation, reward, *_ = env.step(rng.uniform(-0.2, 0.2, 12))
        found.append((observation["proprio"].tobytes(), observation["command"].tobytes(), reward))
    env.close()
    assert found[0] == found[1]
