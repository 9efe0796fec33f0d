"""MuJoCo beside Bullet: what must be the same, and what a simulation must do whatever its engine."""

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'stair-env[mujoco]'")

from stair_env.env import StairClimbEnv
from stair_env.onboard.kinematics import LegKinematics
from stair_env.physics.motors import MotorBody, make_motors
from stair_env.physics.mujoco_simulation import STEPS, MujocoSimulation
from stair_env.physics.simulation import SUBSTEPS, Simulation
from stair_env.robots import ROBOTS
from stair_env.scene.shapes import Shape, build_stair_shapes
from stair_env.stairs import StairSpec

FLOOR = build_stair_shapes(StairSpec())
UNITREE = ("aliengo", "a1")


def standing_angles(robot):
    return LegKinematics(robot).joint_angles(robot.nominal_feet)


def placed(robot, engine=MujocoSimulation, height=0.0, friction=0.8):
    sim = engine(robot)
    sim.build(FLOOR, friction)
    place = np.array([-1.0, 0.0, robot.stand_height + robot.foot_radius + height])
    sim.place_robot(place, 0.0, standing_angles(robot))
    return sim


@pytest.fixture(params=sorted(ROBOTS))
def robot(request):
    return ROBOTS[request.param]


def test_robots_weigh_what_they_weigh_in_bullet(robot):
    bullet = placed(robot, Simulation)
    links = range(-1, bullet.client.getNumJoints(bullet.body))
    weight = sum(bullet.client.getDynamicsInfo(bullet.body, link)[0] for link in links)
    bullet.close()
    sim = placed(robot)
    assert sim.model.body_mass.sum() == pytest.approx(weight, rel=1e-6)
    sim.set_payload(2.5)
    assert sim.model.body_mass.sum() == pytest.approx(weight + 2.5, rel=1e-6)
    sim.close()


def test_a_teleported_robot_is_where_bullet_puts_it(robot):
    joints = np.tile([0.1, 0.8, -1.5], 4) + np.linspace(-0.1, 0.1, 12)
    found = []
    for engine in (Simulation, MujocoSimulation):
        sim = engine(robot)
        sim.build((), 0.9)
        sim.set_payload(1.0)
        sim.place_robot(np.array([0.3, -0.2, 1.0]), yaw=0.7, joint_angles=joints, pitch=-0.2)
        state = sim.base_state()
        found.append((state.position, state.rotation, sim.foot_positions(), sim.joint_states()[0]))
        sim.close()
    for ours, theirs in zip(*found):
        assert ours == pytest.approx(theirs, abs=1e-6)


@pytest.mark.parametrize("actuator", ["position", "pd"])
def test_robots_stand_as_high_as_in_bullet(robot, actuator):
    joints, found = standing_angles(robot), []
    for engine in (Simulation, MujocoSimulation):
        sim, motors = placed(robot, engine), make_motors(actuator, robot, "position")
        motors.reset(sim, MotorBody(), joints)
        motors.hold(joints, 240)
        reading, base = sim.read_robot(), sim.base_state()
        sim.close()
        assert base.rotation[2, 2] > 0.98 and reading.contacts.touching.all() and not reading.contacts.body_touches
        assert reading.contacts.force[:, 2].sum() == pytest.approx(9.81 * robot.mass, rel=0.03)
        found.append(base.position[2])
    assert found[1] == pytest.approx(found[0], abs=0.006)


def test_joints_reach_their_targets_without_rushing(robot):
    """As in Bullet: within a control step the joints move evenly, since the velocity is fed forward."""
    sim, joints = placed(robot, height=2.0), standing_angles(robot)
    sim.model.opt.gravity[:] = 0.0
    wave, rates = np.tile([0.0, 0.3, -0.3], 4), []
    for k in range(1, 25):
        sim.command_joints(joints + wave * np.sin(0.1 * k))
        for _ in range(SUBSTEPS):
            sim.step_and_track(1)
            rates.append(sim.joint_states()[1][1])
    rates = np.array(rates[10:]).reshape(-1, SUBSTEPS)
    assert np.ptp(rates, axis=1).max() < 0.35 * np.abs(rates).max()
    assert np.abs(sim.joint_states()[0] - (joints + wave * np.sin(2.4))).max() < 0.05
    sim.close()


def test_torques_are_held_and_told(robot):
    sim = placed(robot, height=2.0)
    sim.release_joints()
    torques = np.linspace(-1.0, 1.0, 12)
    track = sim.step_under_torques(lambda angles, rates: torques, 3)
    assert len(track.rows) == 3 and sim.data.time == pytest.approx(3 * STEPS * sim.model.opt.timestep)
    assert sim.joint_states()[2] == pytest.approx(torques)
    sim.close()


def test_rotors_make_joints_slower_to_speed_up():
    speeds = []
    for inertia in (0.0, 0.02):
        sim = placed(ROBOTS["aliengo"], height=2.0)
        before = sim.base_state().position
        sim.release_joints()
        sim.add_rotor_inertia(np.full(12, inertia))
        assert sim.base_state().position == pytest.approx(before)
        sim.step_under_torques(lambda angles, rates: np.tile([0.0, 0.0, 1.0], 4), 1)
        speeds.append(sim.joint_states()[1][2])
        sim.close()
    assert speeds[0] > 1.5 * speeds[1] > 0.0


def test_a_foot_that_slides_is_held_by_the_friction_coefficient():
    """As with Bullet's product of coefficients, but round: 0.8 in every direction."""
    robot = ROBOTS["aliengo"]
    sim, joints = placed(robot), standing_angles(robot)
    for _ in range(24):
        sim.command_joints(joints)
        sim.step_and_track(SUBSTEPS)
    ratios = []
    for _ in range(12):
        sim.push(np.array([0.0, 0.4, 0.0]))
        sim.command_joints(joints)
        sim.step_and_track(1)
        force = sim.foot_contacts().force
        loaded = force[:, 2] > 5.0
        ratios += (np.hypot(force[loaded, 0], force[loaded, 1]) / force[loaded, 2]).tolist()
    sim.close()
    assert 0.6 < max(ratios) <= 0.8 * 1.01


def test_a_push_changes_the_trunks_velocity():
    sim = placed(ROBOTS["a1"], height=1.0)
    sim.push(np.array([0.3, -0.2, 0.1]))
    assert sim.base_state().velocity == pytest.approx([0.3, -0.2, 0.1])
    sim.close()


def test_the_track_goes_on_where_it_was_and_turns_as_the_robot_does():
    sim = placed(ROBOTS["laikago"], height=1.0)
    sim.data.qvel[3:6] = [0.0, 3.0, 0.0]  # the root link's y axis is the base's z
    first = sim.begin_track().last
    track = sim.step_and_track(4)
    assert track.start[:3] == pytest.approx(first.position) and len(track.rows) == 4
    turned = first.rotation.T @ track.last.angular_velocity
    assert np.abs(turned).argmax() == 2
    change = track.last.yaw - first.yaw
    assert change == pytest.approx(track.last.angular_velocity[2] * 4 / 240, rel=0.2)
    sim.close()


def test_solids_of_all_kinds_hold_a_foot():
    """The robot is set down on a box, a lying cylinder, a capsule and a sphere, all of one height."""
    robot = ROBOTS["aliengo"]
    for kind, size in (
        ("box", (0.6, 0.6, 0.1)),
        ("sphere", (3.0, 0.0, 0.0)),
        ("cylinder", (0.6, 0.1, 0.0)),
        ("capsule", (3.0, 0.5, 0.0)),
    ):
        lies = (0.0, 0.7071068, 0.0, 0.7071068) if kind == "capsule" else (0.0, 0.0, 0.0, 1.0)
        top = size[0] if kind in ("sphere", "capsule") else 0.1
        thin = Shape("box", (0.0, 0.0, 2.0), (2.0, 2.0, 0.1), collides=False)
        sim = MujocoSimulation(robot)
        sim.build((Shape(kind, (0.0, 0.0, -top), size, lies), thin), 1.0)
        joints = standing_angles(robot)
        sim.place_robot(np.array([0.0, 0.0, robot.stand_height + robot.foot_radius + 0.01]), 0.0, joints)
        for _ in range(24):
            sim.command_joints(joints)
            sim.step_and_track(SUBSTEPS)
        assert sim.foot_contacts().touching.any() and sim.base_state().position[2] > 0.8 * robot.stand_height, kind
        sim.close()


def test_a_world_can_be_built_again_and_closed_twice():
    sim, tracks = MujocoSimulation(ROBOTS["a1"]), []
    for _ in range(2):
        sim.build(FLOOR, 0.8)
        sim.set_payload(1.0)
        joints = standing_angles(ROBOTS["a1"])
        sim.place_robot(np.array([-1.0, 0.0, 0.32]), 0.2, joints)
        sim.command_joints(joints + 0.02, strength=0.9)
        tracks.append(sim.step_and_track(60).rows)
    sim.close()
    sim.close()
    np.testing.assert_array_equal(*tracks)


def test_an_episode_is_the_same_again_whatever_was_before():
    """Everything that disturbs: drawn bodies, pushes, late commands, under both kinds of motors."""
    for kwargs in ({}, {"actuation": "joint"}):
        randomization = {"push_speed": 0.5, "push_interval_s": 0.2, "command_latency": 0.3}
        env = StairClimbEnv(engine="mujoco", direction="both", randomization=randomization, **kwargs)

        def roll(env=env):
            observation, _ = env.reset(seed=11)
            rng, found = np.random.default_rng(1), []
            for _ in range(30):
                observation, reward, *_ = env.step(rng.uniform(-0.3, 0.3, env.action_space.shape))
                found.append((observation["proprio"].tobytes(), observation["stair"].tobytes(), reward))
            return found

        first = roll()
        env.reset(seed=3)
        env.step(np.zeros(env.action_space.shape))
        assert roll() == first
        env.close()


@pytest.mark.parametrize("name", UNITREE)
def test_the_bare_gait_climbs_low_stairs(name):
    env = gym.make("stair_env/StairClimb-v0", engine="mujoco", robot=name, riser_height=0.06, num_steps=3)
    successes = 0
    for seed in range(3):
        env.reset(seed=seed)
        for _ in range(1200):
            _, _, terminated, truncated, info = env.step(np.zeros(16))
            if terminated or truncated:
                break
        successes += info["is_success"]
    env.close()
    assert successes >= 2


def test_worker_processes_step_it_too():
    vector = gym.make_vec("stair_env/StairClimb-v0", num_envs=2, engine="mujoco")
    single = gym.make("stair_env/StairClimb-v0", engine="mujoco")
    batch, _ = vector.reset(seed=5)
    alone, _ = single.reset(seed=6)
    assert batch["proprio"][1] == pytest.approx(alone["proprio"], abs=0.0)
    vector.step(np.zeros((2, 16), np.float32))
    assert vector.get_attr("engine") == ("mujoco", "mujoco")
    vector.close(), single.close()
