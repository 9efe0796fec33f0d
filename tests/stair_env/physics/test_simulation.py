import numpy as np
import pytest

from stair_env.onboard.kinematics import LegKinematics
from stair_env.physics.simulation import FOOT_FRICTION, SUBSTEPS, Simulation
from stair_env.robots import ROBOTS
from stair_env.scene.shapes import build_stair_shapes
from stair_env.sensors.camera.renderers.bullet_shapes import shapes_of_body
from stair_env.stairs import StairSpec


@pytest.fixture(params=sorted(ROBOTS))
def standing(request):
    robot = ROBOTS[request.param]
    sim = Simulation(robot)
    sim.build(build_stair_shapes(StairSpec()), friction=0.8)
    joints = LegKinematics(robot).joint_angles(robot.nominal_feet)
    sim.place_robot(np.array([-1.0, 0.0, robot.stand_height + robot.foot_radius]), 0.0, joints)
    yield sim, joints
    sim.close()


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_what_is_only_drawn_changes_nothing(name):
    """With and without visual shapes: the same motion bit by bit, and the same shapes for the ray-caster."""
    robot, tracks, shapes = ROBOTS[name], [], []
    for visible in (True, False):
        sim = Simulation(robot, visible=visible)
        sim.build(build_stair_shapes(StairSpec()), friction=0.8)
        joints = LegKinematics(robot).joint_angles(robot.nominal_feet)
        sim.place_robot(np.array([-0.5, 0.0, robot.stand_height + 0.1]), 0.3, joints)
        sim.command_joints(joints + 0.05)
        tracks.append(sim.step_and_track(60).rows)
        shapes.append(shapes_of_body(sim.client, sim.body))
        sim.close()
    np.testing.assert_array_equal(*tracks)
    assert shapes[0] == shapes[1]


def test_feet_have_their_friction_and_the_trunk_has_not(standing):
    sim, _ = standing
    friction = [sim.client.getDynamicsInfo(sim.body, link)[1] for link in (*sim._toes, -1)]
    assert friction == [FOOT_FRICTION] * 4 + [0.5]
    assert [sim.client.getDynamicsInfo(body, -1)[1] for body in sim.ground] == [0.8] * len(sim.ground)


def test_a_foot_that_slides_is_held_by_the_friction_coefficient(standing):
    """The ratio of tangential to normal force saturates at the product of both coefficients."""
    sim, joints = standing
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
    assert max(ratios) == pytest.approx(0.8, rel=0.45)  # each of two friction directions is limited by itself
    assert max(ratios) > 0.6


def test_motors_follow_a_moving_target_without_rushing(standing):
    """Within a control step the joints move evenly: the velocity to the next target is fed forward."""
    sim, joints = standing
    sim.client.setGravity(0, 0, 0)
    sim.place_robot(np.array([-1.0, 0.0, 3.0]), 0.0, joints)  # nothing in reach
    wave = np.tile([0.0, 0.3, -0.3], 4)
    rates = []
    for k in range(1, 25):
        sim.command_joints(joints + wave * np.sin(0.1 * k))
        for _ in range(SUBSTEPS):
            sim.step_and_track(1)
            rates.append(sim.joint_states()[1][1])
    rates = np.array(rates[10:]).reshape(-1, SUBSTEPS)
    assert np.ptp(rates, axis=1).max() < 0.35 * np.abs(rates).max()
    angles, _, _ = sim.joint_states()
    assert np.abs(angles - (joints + wave * np.sin(2.4))).max() < 0.05
