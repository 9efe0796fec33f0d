"""The environment: it sequences the other modules and decides nothing itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from stair_env.common import constants
from stair_env.common.constants import CONTROL_DT, CONTROL_RATE_HZ, GRAVITY_M_S2, PHYSICS_RATE_HZ, SUBSTEPS
from stair_env.common.pickling import PicklesByArguments
from stair_env.common.validation import check_choice, read_action
from stair_env.observation import StairBlock, proprio_space, stair_space
from stair_env.onboard.gait import GaitConfig
from stair_env.onboard.kinematics import LegKinematics
from stair_env.onboard.planner import GaitPlanner, JointActuation, make_planner
from stair_env.onboard.proprioception import Proprioception
from stair_env.physics.engines import check_engine, open_engine
from stair_env.physics.interface import Physics
from stair_env.physics.motors import Actuator, MotorBody, PdActuator, make_motors
from stair_env.robots import RobotSpec, get_robot
from stair_env.scene.shapes import Shape, build_stair_shapes
from stair_env.scene.spec import Scene, SceneSpec
from stair_env.sensors.camera.onlooker import Onlooker
from stair_env.sensors.imu import ImuConfig, MountedImu
from stair_env.stairs import StairSpec
from stair_env.task.curriculum import read_curriculum
from stair_env.task.disturbances import CommandLatency, Pushes
from stair_env.task.observation_terms import read_observations
from stair_env.task.randomization import read_randomization
from stair_env.task.rewards import RewardTerm, read_rewards
from stair_env.task.sources import ExternalSource, StairSource, make_source, observe_stairs
from stair_env.task.spawn import SPAWNS, Spawn, draw_spawn, read_reset_options, standing_at
from stair_env.task.stair_ranges import StairRanges, StairSampler, draw_sampled, read_sampler
from stair_env.task.step_state import Episode, StepRecorder, StepState
from stair_env.task.termination import TerminationFunction, read_terminations
from stair_env.task.terms.commands import read_command

SETTLE_STEPS = 12  # control steps to stand still before the episode begins
RENDER_MODES = ("human", "rgb_array", "depth_array")


class StairClimbEnv(gym.Env[dict[str, np.ndarray], np.ndarray], PicklesByArguments):
    """A legged robot climbs a staircase that it knows from the stair block of its observation.

    Observation: Dict of `proprio` (`stair_env.observation.PROPRIO_FIELDS`) and `stair` (`STAIR_FIELDS`), with
    privileged=True also `privileged` (`stair_env.task.privileged.PRIVILEGED_FIELDS`).
    Action: Box [-1, 1]: modulation of the gait and foot residuals (`stair_env.onboard.gait.GaitAction`), or with
    actuation="joint" twelve joint offsets from standing (`stair_env.onboard.planner.JointActuation`).

    Parts are taken by name, which keeps `spec.to_json()` possible, or as objects (`stair_env.parts`). Objects travel to
    worker processes by cloudpickle, and each environment works with a copy of its own.

    Args:
        robot: name in `stair_env.robots.ROBOTS`, or a RobotSpec.
        direction: "up", "down" or "both".
        riser_height, tread_depth: a number or [low, high], metres (paper: step height and width).
        num_steps: a number or [low, high].
        lighting: "day", "night" or "random"; matters to cameras.
        camera: renderer and sensor options; matters to the RGBD environment.
        actuation: "gait", or "joint", a JointActuation or its fields for no gait.
        actuator: "position" (Bullet's motors), "pd" (torques at the physics rate), a PdActuator or its fields, or an
            Actuator (`stair_env.physics.motors`). None takes "pd" without a gait, else "position".
        command: velocity to follow, a part of the observation that the gait does not read: forward m/s, a number or
            [low, high]; or fields of `stair_env.task.terms.commands.CommandConfig`.
        gait: "trot", a GaitConfig, a GaitPlanner, or what makes one for a RobotSpec.
        stair_source: what fills the stair block (`stair_env.task.sources`): a name, or a StairSource.
        render_mode: "human", "rgb_array", "depth_array" or None.
        curriculum: None, True or fields of `CurriculumConfig`.
        randomization: None, True, fields of `Randomization`, or one.
        spawn: "floor", or "anywhere" to start some episodes on the flight.
        uneven: largest deviation of single risers and treads, metres.
        flight_width: metres.
        reward_weights: fields of `RewardWeights` to change.
        rewards: by name: a RewardTerm adds or replaces a term, a number is a default or an optional term's weight
            (`stair_env.task.terms.legged_rewards`), None switches a default term off.
        terminations: by name: a function of a StepState adds or replaces a way to end, None switches a default one off.
        observations: "stairs"; "height_scan" or "proprio" for a scan or nothing in the block's place; or by name: an
            ObservationTerm adds a part of the observation, None leaves one out.
        sampler: draws staircases or scenes in place of direction, riser_height, tread_depth, num_steps, flight_width
            and uneven: an object with sample(rng), for example a `stair_env.sampling.SceneSampler`.
        privileged: add what only the simulator knows to the observation, for a critic or a teacher.
        engine: of the physics: "bullet", or "mujoco" (`stair-env[mujoco]`; docs/sim_to_sim.md says how they differ).

    Attributes:
        state: the StepState of the last control step or reset.

    Raises:
        SpecError: (a ValueError) an argument is wrong; the message names it, its value and the choices.
        MissingExtraError: the engine is not installed.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": round(CONTROL_RATE_HZ)}  # noqa: RUF012 (Gymnasium's)
    observation_space: spaces.Dict  # type: ignore[assignment]
    state: StepState

    def __init__(
        self,
        robot: str | RobotSpec = "aliengo",
        direction: str = "up",
        riser_height: Any = (0.10, 0.17),
        tread_depth: Any = (0.26, 0.34),
        num_steps: Any = (4, 7),
        lighting: str = "day",
        camera: dict[str, Any] | None = None,
        actuation: str | Mapping[str, Any] | JointActuation = "gait",
        stair_source: str | StairSource = "oracle",
        render_mode: str | None = None,
        curriculum: Any = None,
        randomization: Any = None,
        spawn: str = "floor",
        uneven: float = 0.0,
        flight_width: float = 1.2,
        reward_weights: dict[str, float] | None = None,
        privileged: bool = False,
        gait: str | GaitConfig | GaitPlanner | Callable[[RobotSpec], GaitPlanner] = "trot",
        rewards: Mapping[str, RewardTerm | float | None] | None = None,
        terminations: Mapping[str, TerminationFunction | None] | None = None,
        observations: str | Mapping[str, Any] | None = None,
        sampler: StairSampler | None = None,
        command: Any = None,
        actuator: str | Mapping[str, Any] | PdActuator | Actuator | Callable[[RobotSpec], Actuator] | None = None,
        engine: str = "bullet",
    ) -> None:
        self.robot, self.engine = get_robot(robot), check_engine(engine)
        self.ranges = StairRanges(direction, riser_height, tread_depth, num_steps, flight_width, uneven)
        check_choice("lighting", lighting, constants.LIGHTING_CHOICES)
        check_choice("spawn", spawn, SPAWNS)
        if render_mode is not None:
            check_choice("render_mode", render_mode, RENDER_MODES)
        self.lighting, self.actuation, self.spawn, self.render_mode = lighting, actuation, spawn, render_mode
        if camera is not None:  # of no matter here, but a wrong option is one on every id
            from stair_env.sensors.camera.sensor import CameraConfig

            CameraConfig.from_dict(camera)
        self.randomization = read_randomization(randomization)
        self.curriculum = read_curriculum(curriculum, self.ranges.riser_height[1])
        self.sampler = read_sampler(sampler, self.curriculum)
        self.source = make_source(stair_source)
        self.gait = make_planner(gait, actuation, self.robot)
        self._motors = make_motors(actuator, self.robot, "position" if actuation == "gait" else "pd")
        self.rewards = read_rewards(rewards, reward_weights)
        self.terminations = read_terminations(terminations)
        self.action_size, self.privileged = self.gait.action_size, privileged
        self.action_space = spaces.Box(-1.0, 1.0, (self.action_size,), np.float32)
        self._commands = read_command(command)
        commanded = self._commands.config is not None
        self._observations = read_observations(observations, privileged, self._sensed_spaces(), commanded)
        self.observation_space = self._observations.space
        self._unreported = False  # whether an episode is under way that the curriculum has not heard of
        self._sim: Physics | None = None
        self._onlooker: Onlooker | None = None
        self._kinematics = LegKinematics(self.robot)
        self._proprioception = Proprioception(self.robot, PHYSICS_RATE_HZ)
        self._latency = CommandLatency(self.randomization.command_latency)
        self._pushes = Pushes(self.randomization.push_speed, self.randomization.push_interval_s)

    # ------------------------------------------------------------------ episode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: reseeds `np_random`.
            options: "stairs": a StairSpec or its dict, to climb this very staircase;
                "x", "y", "yaw": where the base starts.
        """
        given, start = read_reset_options(options)
        super().reset(seed=seed)
        if self.curriculum is not None and self._unreported:
            self.curriculum.report(False)  # it ran out of time
        self.stairs, self._given_scene = self._draw_stairs(given)
        self.profile = self.stairs.profile()
        spawn = draw_spawn(self.stairs, self.robot, self.spawn, self.np_random)
        if start:
            drawn = {"x": float(spawn.position[0]), "y": float(spawn.position[1]), "yaw": spawn.yaw}
            spawn = standing_at(self.stairs, self.robot, **(drawn | start))
        body = self.randomization.draw(self.np_random)
        # Separate generators keep episodes of one seed alike across ids, whatever the sensors draw.
        seeds = self.np_random.integers(0, 2**63, size=4)
        source_rng, imu_rng, body_rng, camera_rng = (np.random.default_rng(s) for s in seeds)
        motor_rng, command_rng = body_rng.spawn(2)
        episode = Episode(self.stairs, self.profile, self.robot, body, float(spawn.position[0]), int(seeds[2]))
        self._build(episode, self._world_shapes(self.stairs, camera_rng))
        targets = self._stand(spawn, self.randomization.draw_motors(body.motor_strength, motor_rng))
        self._begin_walk(targets, spawn, imu_rng, body_rng)
        self.source.reset(self.stairs, source_rng)
        self._begin_sensors(camera_rng)
        self._observe_stairs()
        self._recorder = StepRecorder(episode, self.action_size)
        command = self._commands.reset(command_rng)
        begun = self._base, self._reading, targets, self._truth, self._block, CONTROL_DT, command
        self.state = self._recorder.begin(*begun)
        self._unreported = False
        return self._observation(), self._info(dict.fromkeys(self.rewards.terms, 0.0), "")

    def _draw_stairs(self, given: StairSpec | None) -> tuple[StairSpec, SceneSpec | None]:
        """The staircase, and the scene around it if it was drawn with one."""
        if self.sampler is None:
            drawn: tuple[StairSpec, SceneSpec | None] = self.ranges.draw(self.np_random, self.curriculum), None
        else:
            drawn = draw_sampled(self.sampler, self.np_random)
        return drawn if given is None else (given, None)

    def _build(self, episode: Episode, shapes: tuple[Shape, ...]) -> None:
        if self._sim is None:
            self._sim = self._open_simulation()
        self._episode, self._onlooker = episode, None
        self._sim.build(shapes, episode.body.friction)
        self._sim.set_payload(episode.body.payload_kg)

    def _stand(self, spawn: Spawn, body: MotorBody) -> np.ndarray:
        """Stand the robot up and let it settle, so that the first accelerometer reading is one at rest.

        Returns:
            (12,) joint angles that the motors hold, radians.
        """
        sim = self._sim
        assert sim is not None
        joints = self._kinematics.joint_angles(spawn.feet_in_base)
        sim.place_robot(spawn.position, spawn.yaw, joints, spawn.pitch)
        self._motors.reset(sim, body, joints)
        self._motors.hold(joints, SETTLE_STEPS * SUBSTEPS)
        self.time_s, self._energy = 0.0, 0.0
        self._track, self._reading = sim.begin_track(), sim.read_robot()
        self._base = self._track.last
        return joints

    def _begin_walk(
        self, targets: np.ndarray, spawn: Spawn, imu_rng: np.random.Generator, body_rng: np.random.Generator
    ) -> None:
        """Reset what runs on the robot and what disturbs it."""
        self._imu = MountedImu(ImuConfig(), np.zeros(3), np.eye(3), PHYSICS_RATE_HZ, imu_rng)
        self._proprioception.reset(self._base.rotation[2] * GRAVITY_M_S2)
        feet = self._proprioception.foot_heights(self._reading.joint_positions)
        self.gait.reset(feet, phase=float(body_rng.random()), pitch=spawn.pitch)
        self._latency.reset(targets, body_rng)
        self._pushes.reset(body_rng)

    def _sensed_spaces(self) -> dict[str, spaces.Space[Any]]:
        """Hook for environments with cameras: spaces of what the sensors give."""
        return {"proprio": proprio_space(self.action_size), "stair": stair_space()}

    def _open_simulation(self, visible: bool = False) -> Physics:
        """Hook for environments whose camera draws with Bullet's renderers (visible) or must load one first."""
        visible = visible or self.render_mode is not None
        return open_engine(self.engine, self.robot, self.render_mode == "human", visible)

    def _world_shapes(self, stairs: StairSpec, rng: np.random.Generator) -> tuple[Shape, ...]:
        """Hook for environments with cameras, whose worlds have surroundings."""
        return build_stair_shapes(stairs) if self._given_scene is None else Scene(self._given_scene).shapes

    def _surroundings(self) -> Scene:
        """Hook for environments with cameras: what stands around the robot, to be drawn."""
        return Scene(self._given_scene or SceneSpec(self.stairs))

    def _begin_sensors(self, rng: np.random.Generator) -> None:
        """Hook for environments with cameras: called once the robot stands."""

    def _advance_sensors(self) -> None:
        """Hook for environments with cameras: called after each control step."""

    def _sense(self) -> dict[str, np.ndarray]:
        """Hook for environments with cameras: what the sensors give, by name."""
        return {"proprio": self._proprio(), "stair": self._block.as_array()}

    # ------------------------------------------------------------------ step

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """One control step of 1/48 s."""
        if self._sim is None:
            raise gym.error.ResetNeeded("call reset() before step()")
        action = np.minimum(np.maximum(read_action(action, (self.action_size,)), -1.0), 1.0)
        self._unreported = True
        targets = self.gait.joint_targets(action, self._block, self._proprioception.velocity, CONTROL_DT)
        self._move(targets)
        self._advance_sensors()
        self._reading = self._sim.read_robot()
        joints, touching = self._reading.joint_positions, self._reading.contacts.touching
        self._proprioception.update(self._imu.read(self._track), joints, touching, CONTROL_DT)
        self._observe_stairs()
        done = self._base, self._reading, targets, action, self._truth, self._block, CONTROL_DT
        state = self._recorder.record(self.time_s, *done, self._commands.at(self.time_s))
        termination = self.terminations.reason(state)
        self.state = state if not termination else state._replace(termination=termination)
        terms = self.rewards.weighted(self.state)
        self._energy += state.joint_power_w * CONTROL_DT
        if termination and self.curriculum is not None:
            self.curriculum.report(termination == "success")
            self._unreported = False
        info = self._info(terms, termination)
        if self.render_mode == "human":
            self.render()
        return self._observation(), float(sum(terms.values())), bool(termination), False, info

    def _move(self, targets: np.ndarray) -> None:
        """Bring planned joint targets to the motors and let time pass."""
        sim = self._sim
        assert sim is not None
        self._motors.command(self._latency.deliver(targets))
        push = self._pushes.due(self.time_s)
        if push is not None:
            sim.push(push)
        self._track = self._motors.advance(SUBSTEPS)
        self._base = self._track.last
        self.time_s += CONTROL_DT

    # ------------------------------------------------------------------ what comes out

    def _observe_stairs(self) -> None:
        self._truth, self._block = observe_stairs(self.source, self._episode, self._base, self.time_s)

    def end_curriculum(self) -> None:
        """From the next episode on draw from the whole range of stairs, as an evaluation should."""
        self.curriculum = None

    def provide_stair(self, block: StairBlock | np.ndarray) -> None:
        """Give the stair block that the gait reads at the next step (stair_source="external").

        Raises:
            RuntimeError: this environment fills the block itself.
            ValueError: block is not (8,) finite numbers.
        """
        if not isinstance(self.source, ExternalSource):
            raise RuntimeError('provide_stair() needs stair_source="external"')
        block = block if isinstance(block, StairBlock) else StairBlock.from_array(block)
        self.source.provide(block)
        self._block = block

    def _proprio(self) -> np.ndarray:
        state = self.state
        return self._proprioception.block(
            state.joint_positions,
            state.joint_velocities,
            state.joint_targets,
            state.contacts.touching,
            self.gait,
            state.action,
        )

    def _observation(self) -> dict[str, np.ndarray]:
        sensed = self._sense()
        return self._observations.select(sensed, self.state) if self._observations.changes else sensed

    def _info(self, terms: dict[str, float], termination: str) -> dict[str, Any]:
        """What is told beside the observation: the same keys and types at reset and at every step."""
        base = self.state.after
        info: dict[str, Any] = {
            "is_success": termination == "success",
            "steps_climbed": self.state.steps_climbed,
            "reward_terms": terms,
            "termination": termination,
            "truth": {
                **self._truth._asdict(),
                "riser_height": float(self.stairs.riser_height),
                "tread_depth": float(self.stairs.tread_depth),
                "num_steps": len(self.profile.edge_x),
                "position": base.position.copy(),
                "velocity": base.velocity.copy(),
                "yaw": base.yaw,
                "riser_hits": self.state.riser_hits,
                "energy_j": self._energy,
            },
        }
        if self.curriculum is not None:
            info["curriculum_level"] = self.curriculum.level
        return info

    # ------------------------------------------------------------------ looks

    @property
    def simulation(self) -> Physics | None:
        """The physics, for viewers and tools: policies learn nothing from it. None before the first reset."""
        return self._sim

    def render(self) -> np.ndarray | None:
        """Third-person picture: uint8 (H, W, 3), or float32 (H, W) metres for "depth_array"."""
        if self.render_mode is None:
            gym.logger.warn('render() needs render_mode="rgb_array", "depth_array" or "human"')
            return None
        if self._sim is None:
            raise gym.error.ResetNeeded("call reset() before render()")
        if self.render_mode == "human":
            self._sim.follow_with_camera(self.state.after.position)
            return None
        if self._onlooker is None:
            self._onlooker = Onlooker(self._sim, self._surroundings)
        colour, depth = self._onlooker.look(self.state.after.position)
        return colour if self.render_mode == "rgb_array" else depth

    def close(self) -> None:
        """Release the physics; safe to call twice."""
        if self._sim is not None:
            self._sim.close()
            self._sim = None
