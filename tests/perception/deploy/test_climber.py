"""The robot's side walks as the environment does: equal joint targets over a whole flight; nothing heavy is loaded."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import stair_env  # noqa: F401
from perception.deploy.climber import PARTS, StairClimber
from perception.deploy.onnx_actor import ActorError, OnnxActor
from perception.deploy.readings import BodyReading, CameraReading
from policies.export_actor import export_actor
from policies.pretrained import PolicyError, load
from stair_env.physics.simulation import Simulation
from stair_env.sensors.imu import Imu

MAX_STEPS = 600
TOLERANCE_RAD = 1e-6


class Taps:
    """What goes over the wires between the simulated robot and its computer, picked up where it passes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.imu: list[np.ndarray] = []
        self.commands: list[np.ndarray] = []
        sample, command = Imu.sample, Simulation.command_joints

        def tapped_sample(imu: Imu, *args: Any, **kwargs: Any) -> np.ndarray:
            self.imu.append(sample(imu, *args, **kwargs))
            return self.imu[-1]

        def tapped_command(sim: Simulation, joints: np.ndarray, *args: Any, **kwargs: Any) -> Any:
            self.commands.append(np.array(joints))
            return command(sim, joints, *args, **kwargs)

        monkeypatch.setattr(Imu, "sample", tapped_sample)
        monkeypatch.setattr(Simulation, "command_joints", tapped_command)


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_actor(load("aliengo"), tmp_path_factory.mktemp("actor") / "aliengo")


def test_a_policy_that_is_more_than_its_network_is_not_exported(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="aliengo-joint"):
        export_actor(load("aliengo-joint"), tmp_path / "actor")
    assert not (tmp_path / "actor").exists()


def test_the_exported_actor_acts_like_the_policy(exported: Path) -> None:
    policy, actor = load("aliengo"), OnnxActor(exported)
    rng = np.random.default_rng(0)
    for _ in range(50):
        observation = {key: space.sample() for key, space in policy.observation_space.spaces.items()}
        observation["proprio"] = rng.normal(0, 1, observation["proprio"].shape).astype(np.float32)
        np.testing.assert_allclose(actor.act(observation), policy.predict(observation)[0], atol=2e-6)


@pytest.mark.parametrize("direction", ["up", "down"])
def test_joint_targets_equal_the_environments(direction: str, exported: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taps = Taps(monkeypatch)
    env = gym.make(
        "stair_env/StairClimbPerception-v0", robot="aliengo", direction=direction, riser_height=0.12, num_steps=3
    )
    base: Any = env.unwrapped
    policy = load("aliengo", env)
    observation, info = env.reset(seed=3)
    climber = StairClimber("aliengo", base.camera_intrinsics, OnnxActor(exported))
    rgbd: Any = base

    def readings(trunk_imu: np.ndarray) -> tuple[BodyReading, np.ndarray, CameraReading]:
        joints, rates, _ = rgbd._sim.joint_states()
        body = BodyReading(info["camera"]["time_s"], joints, rates, rgbd._sim.foot_contacts().touching, trunk_imu)
        camera = info["camera"]
        seen = CameraReading(
            camera["frame"], camera["captured_at_s"], rgbd._frame.rgb, np.clip(rgbd._frame.depth_m, 0, 20)
        )
        return body, rgbd._imu_samples, seen

    rest = rgbd.state.after.rotation[2] * 9.81
    start = {"rest": rest, "targets": taps.commands[-1], "phase": rgbd.gait.phase}
    wanted = climber.begin(*readings(np.tile([*rest, 0.0, 0.0, 0.0], (5, 1))), **start)
    worst, steps, done = 0.0, 0, False
    while not done and steps < MAX_STEPS:
        taps.imu.clear()
        action, _ = policy.predict(observation)
        observation, _, terminated, truncated, info = env.step(action)
        worst = max(worst, float(np.abs(taps.commands[-1] - wanted).max()))
        wanted = climber.step(*readings(taps.imu[-1]))
        steps, done = steps + 1, terminated or truncated
    env.close()
    assert info["is_success"], info.get("termination")
    assert worst < TOLERANCE_RAD, worst
    assert climber.block.valid == observation["stair"][0] or not climber.block.valid
    latency = climber.latency()
    assert tuple(latency) == PARTS
    assert latency["network"]["calls"] < steps / 2 and all(part["mean_ms"] > 0 for part in latency.values())


def test_nothing_heavy_is_needed(exported: Path) -> None:
    script = f"""
import sys
class Forbid:
    def find_spec(self, name, path=None, target=None):
        if name in ("torch", "pybullet", "gymnasium", "stable_baselines3", "matplotlib"):
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Forbid())
import numpy as np
from perception.deploy.climber import StairClimber
from perception.deploy.onnx_actor import OnnxActor
from perception.deploy.readings import BodyReading, CameraReading
from stair_env.intrinsics import D435I_COLOR_MODES
camera = D435I_COLOR_MODES["640x480"]
climber = StairClimber("aliengo", camera, OnnxActor({str(exported)!r}))
joints = np.tile([0.0, 0.8, -1.5], 4)
imu = np.tile([0.0, 0.0, 9.81, 0.0, 0.0, 0.0], (5, 1))
seen = CameraReading(0, 0.0, np.zeros((480, 640, 3), np.uint8), np.zeros((480, 640), np.float32))
still = np.tile([0.0, -9.8, 0.0, 0.0, 0.0, 0.0], (5, 1))
climber.begin(BodyReading(0.0, joints, 0 * joints, np.ones(4, bool), imu), still, seen)
targets = climber.step(BodyReading(0.02, joints, 0 * joints, np.ones(4, bool), imu), still)
assert targets.shape == (12,) and np.isfinite(targets).all()
print("walks")
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=Path(__file__).parents[3])
    assert done.stdout.strip() == "walks", done.stderr


def test_gymnasium_is_not_loaded_but_the_ids_are_there_once_it_is() -> None:
    script = (
        "import sys, perception.deploy.climber, stair_env\n"
        "assert not {'gymnasium', 'torch', 'pybullet'} & set(sys.modules), 'loaded'\n"
        "import gymnasium\n"
        "assert set(stair_env.ENV_IDS) <= set(gymnasium.registry)\n"
        "assert gymnasium.__spec__.loader.__class__.__module__.startswith(('_frozen', 'importlib'))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=Path(__file__).parents[3])
    assert done.returncode == 0, done.stderr


def test_wrong_readings_are_named(exported: Path) -> None:
    good = np.zeros(12)
    imu = np.tile([0.0, 0.0, 9.81, 0.0, 0.0, 0.0], (5, 1))
    with pytest.raises(ValueError, match="joint_position must be 12"):
        BodyReading(0.0, np.zeros(11), good, np.ones(4, bool), imu)
    with pytest.raises(ValueError, match="imu must be"):
        BodyReading(0.0, good, good, np.ones(4, bool), np.zeros((0, 6)))
    with pytest.raises(ValueError, match="contact must be 4"):
        BodyReading(0.0, good, good, np.full(4, np.nan), imu)
    with pytest.raises(ValueError, match="stair has shape"):
        OnnxActor(exported).act({"proprio": np.zeros(72, np.float32), "stair": np.zeros(7, np.float32)})


def test_a_folder_that_holds_no_policy_is_named(exported: Path, tmp_path: Path) -> None:
    with pytest.raises(ActorError, match=r"actor\.onnx.*export_actor"):
        OnnxActor(tmp_path)
    for name, text in (("actor.json", "{}"), ("normalisation.npz", "x"), ("actor.onnx", "x")):
        folder = tmp_path / name
        folder.mkdir()
        for path in exported.iterdir():
            (folder / path.name).write_bytes(path.read_bytes())
        (folder / name).write_text(text)
        with pytest.raises(ActorError, match=name.replace(".", r"\.")):
            OnnxActor(folder)
