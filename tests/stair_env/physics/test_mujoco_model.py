import dataclasses

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'stair-env[mujoco]'")

from stair_env.common.validation import SpecError
from stair_env.physics.mujoco_model import box_inertia, build_model, read_robot
from stair_env.robots import ROBOTS
from stair_env.scene.shapes import Shape

BLOCK = Shape("box", (0.5, 0.0, -0.1), (0.3, 0.2, 0.1))
PAINT = Shape("box", (0.5, 0.0, 0.0), (0.3, 0.2, 0.001), collides=False)


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_every_link_has_mass_and_inertia(name):
    robot = ROBOTS[name]
    model = build_model(read_robot(robot), robot.toe_names, (), 0.9)
    assert (model.body_mass[1:] > 0.0).all() and (model.body_inertia[1:] > 0.0).all()
    assert model.nv == 18 and model.neq == 12
    assert {model.joint(name).type[0] for name in robot.joint_names} == {3}  # hinges


def test_friction_is_the_product_of_both_coefficients():
    robot = ROBOTS["a1"]
    model = build_model(read_robot(robot), robot.toe_names, (BLOCK,), 0.6)
    for geom in range(model.ngeom):
        name = model.body(model.geom_bodyid[geom]).name
        if name == "world":
            assert model.geom_priority[geom] == 0
            continue
        assert model.geom_priority[geom] == 1
        assert model.geom_friction[geom, 0] == pytest.approx(0.6 if name in robot.toe_names else 0.3)


def test_robot_and_ground_meet_each_other_and_never_themselves():
    robot = ROBOTS["aliengo"]
    model = build_model(read_robot(robot), robot.toe_names, (BLOCK, BLOCK), 0.9)
    moves = model.geom_bodyid > 0
    for one in range(model.ngeom):
        for two in range(model.ngeom):
            meet = bool(
                model.geom_contype[one] & model.geom_conaffinity[two]
                or model.geom_contype[two] & model.geom_conaffinity[one]
            )
            assert meet == (moves[one] != moves[two])


def test_what_does_not_collide_is_left_out():
    robot = ROBOTS["a1"]
    alone, with_paint = (
        build_model(read_robot(robot), robot.toe_names, shapes, 0.9) for shapes in ((BLOCK,), (BLOCK, PAINT))
    )
    assert alone.ngeom == with_paint.ngeom


def test_a_robot_is_read_once_and_stays_as_it_is():
    robot = ROBOTS["a1"]
    spec = read_robot(robot)
    first = build_model(spec, robot.toe_names, (BLOCK,), 0.2)
    second = build_model(spec, robot.toe_names, (), 0.9)
    assert second.ngeom == first.ngeom - 1 and second.geom_friction[-1, 0] == pytest.approx(0.9)


def test_inertia_of_a_box_around_a_link():
    robot = ROBOTS["aliengo"]
    model = build_model(read_robot(robot), robot.toe_names, (), 0.9)
    x, y, z = 0.647, 0.15, 0.112  # of the trunk's box in the URDF
    expected = 9.041 / 12.0 * np.array([y**2 + z**2, x**2 + z**2, x**2 + y**2])
    assert box_inertia(model, "trunk", 9.041) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("joint_names", ("no_such_joint", *ROBOTS["a1"].joint_names[1:]), "no_such_joint.*FR_hip_joint"),
        ("toe_names", ("no_such_toe", *ROBOTS["a1"].toe_names[1:]), "no_such_toe.*FR_toe"),
    ],
)
def test_wrong_names_are_told_with_the_choices(field, value, words):
    with pytest.raises(SpecError, match=words):
        read_robot(dataclasses.replace(ROBOTS["a1"], **{field: value}))


@pytest.mark.parametrize(
    "text", ["<robot", "<robot name='r'/>", "<robot name='r'><link name='a'><collision/></link></robot>"]
)
def test_a_urdf_that_cannot_be_read_is_named(text, tmp_path):
    file = tmp_path / "own.urdf"
    file.write_text(text)
    with pytest.raises(SpecError, match=r"own\.urdf.*MuJoCo says"):
        read_robot(dataclasses.replace(ROBOTS["a1"], urdf=str(file)))
