"""Physics engines by name."""

from __future__ import annotations

import importlib.util

from stair_env.common.constants import PHYSICS_ENGINES
from stair_env.common.importing.extras import MissingExtraError
from stair_env.common.validation import SpecError, check_choice
from stair_env.physics.interface import Physics
from stair_env.robots import RobotSpec


def check_engine(engine: str) -> str:
    """Return the name of an engine that is there.

    Raises:
        SpecError: there is none of this name; the message lists the choices.
        MissingExtraError: MuJoCo is not installed; the message says how to get it.
    """
    check_choice("engine", engine, PHYSICS_ENGINES)
    if engine == "mujoco" and importlib.util.find_spec("mujoco") is None:
        raise MissingExtraError("engine='mujoco' needs MuJoCo: pip install 'stair-env[mujoco]'", name="mujoco")
    return engine


def check_renderer(engine: str, renderer: str) -> None:
    """Refuse a camera that draws with another engine than the one that moves the robot.

    Raises:
        SpecError: naming the renderer and the one that works with every engine.
    """
    if engine != "bullet" and renderer != "raycast":
        raise SpecError(f"camera renderer={renderer!r} draws Bullet's bodies; engine={engine!r} needs 'raycast'")


def open_engine(engine: str, robot: RobotSpec, gui: bool = False, visible: bool = True) -> Physics:
    """Open a world.

    Args:
        engine: a name in PHYSICS_ENGINES.
        robot: which robot.
        gui: open the engine's window instead of running headless.
        visible: load what the engine's own renderers draw.

    Raises:
        SpecError: no such engine, or it cannot read the robot's URDF.
        MissingExtraError: the engine is not installed.
    """
    if check_engine(engine) == "mujoco":
        from stair_env.physics.mujoco_simulation import MujocoSimulation

        return MujocoSimulation(robot, gui)
    from stair_env.physics.simulation import Simulation

    return Simulation(robot, gui, visible)
