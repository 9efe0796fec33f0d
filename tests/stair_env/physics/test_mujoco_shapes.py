import numpy as np
import pytest

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'stair-env[mujoco]'")

from stair_env.onboard.kinematics import LegKinematics
from stair_env.physics.mujoco_simulation import MujocoSimulation
from stair_env.physics.simulation import Simulation
from stair_env.robots import ROBOTS
from stair_env.scene.shapes import build_stair_shapes
from stair_env.stairs import StairSpec

UNITREE = ("aliengo", "a1")


def placed(robot, engine=MujocoSimulation, height=0.0):
    sim = engine(robot)
    sim.build(build_stair_shapes(StairSpec()), 0.8)
    place = np.array([-1.0, 0.0, robot.stand_height + robot.foot_radius + height])
    sim.place_robot(place, 0.0, standing_angles(robot))
    return sim


def standing_angles(robot):
    return LegKinematics(robot).joint_angles(robot.nominal_feet)


@pytest.mark.parametrize("name", UNITREE)
def test_the_ray_caster_sees_what_it_sees_in_bullet(name):
    bullet, ours = placed(ROBOTS[name], Simulation), placed(ROBOTS[name])
    seen, expected = ours.solids().shapes(), bullet.solids().shapes()
    assert len(seen) == len(expected)
    for shape in seen:
        near = min(expected, key=lambda other: np.linalg.norm(np.subtract(shape.position, other.position)))
        assert shape.position == pytest.approx(near.position, abs=1e-4) and shape.kind in (near.kind, "cylinder")
        if shape.kind == near.kind:
            assert sorted(shape.size) == pytest.approx(sorted(near.size), abs=1e-3)
            assert abs(np.dot(shape.orientation, near.orientation)) == pytest.approx(1.0, abs=1e-4) or (
                shape.kind != "box"
            )
    bullet.close(), ours.close()


@pytest.mark.parametrize("name", ["laikago", "mini_cheetah"])
def test_meshes_become_solids_around_them(name):
    """A box or cylinder for each mesh, none farther from the trunk than a leg, and four round feet."""
    sim = placed(ROBOTS[name])
    shapes, base = sim.solids().shapes(), sim.base_state().position
    feet = [shape for shape in shapes if shape.kind == "sphere"]
    assert np.array([foot.position for foot in feet]) == pytest.approx(sim.foot_positions(), abs=1e-6) or len(feet) == 4
    assert len(shapes) == 17
    assert max(np.linalg.norm(np.subtract(shape.position, base)) for shape in shapes) < 0.7
    sim.close()
