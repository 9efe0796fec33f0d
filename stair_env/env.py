"""The environment: it sequences the other modules and decides nothing itself."""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from stair_env.common.constants import GRAVITY_M_S2, LIGHTING_CHOICES
from stair_env.common.pickling import PicklesByArguments
from stair_env.common.validation import SpecError, check_choice, read_action
from stair_env.observation import PRIVILEGED_KEY, StairBlock, pack_proprio, proprio_space, stair_space
from stair_env.onboard.attitude import AttitudeFilter, base_to_level
from stair_env.onboard.gait import ACTION_SIZE, Gait
from stair_env.onboard.kinematics import LegKinematics
from stair_env.onboard.leg_odometry import LegOdometry
from stair_env.physics.simulation import CONTROL_DT, CONTROL_RATE_HZ, PHYSICS_RATE_HZ, SUBSTEPS, Simulation
from stair_env.physics.trunk_motion import MotionRecorder
from stair_env.robots import NUM_JOINTS, get_robot
from stair_env.scene.shapes import Shape, build_stair_shapes
from stair_env.sensors.camera.third_person_bullet import Onlooker
from stair_env.sensors.imu import Imu, ImuConfig
from stair_env.stairs import StairSpec
from stair_env.task.curriculum import read_curriculum
from stair_env.task.privileged import Truth, pack_privileged, privileged_space
from stair_env.task.randomization import read_randomization
from stair_env.task.rewards import REWARD_TERMS, StepOutcome, read_weights, reward_terms, riser_hits
from stair_env.task.sources import ExternalSource, HipPose, make_source, true_block
from stair_env.task.spawn import SPAWNS, Spawn, draw_spawn, read_reset_options, standing_at
from stair_env.task.stair_ranges import StairRanges
from stair_env.task.termination import FAILURES, Judge

ACTUATIONS = ("gait", "joint")
JOINT_ACTION_RAD = 0.5  # actuation="joint": an action of ±1 moves a joint this far from standing
SETTLE_STEPS = 12  # control steps to stand still before the episode begins
RENDER_MODES = ("human", "rgb_array", "depth_array")


class StairClimbEnv(gym.Env[dict[str, np.ndarray], np.ndarray], PicklesByArguments):
    """A legged robot climbs a staircase that it knows from the stair block of its observation.

    Observation: Dict of `proprio` (`stair_env.observation.PROPRIO_FIELDS`) and `stair` (`STAIR_FIELDS`), with
    privileged=True also `privileged` (`stair_env.task.privileged.PRIVILEGED_FIELDS`).
    Action: Box [-1, 1]: modulation of the gait and foot residuals (`stair_env.onboard.gait.GaitAction`), or with
    actuation="joint" twelve joint offsets from standing.

    Args:
        robot: name in `stair_env.robots.ROBOTS`.
        direction: "up", "down" or "both".
        riser_height, tread_depth: a number or [low, high], metres (paper: step height and width).
        num_steps: a number or [low, high].
        lighting: "day", "night" or "random"; matters to cameras.
        camera: renderer and sensor options; matters to the RGBD environment.
        actuation: "gait" or "joint".
        stair_source: what fills the stair block (`stair_env.task.sources`).
        render_mode: "human", "rgb_array", "depth_array" or None.
        curriculum: None, True or fields of `CurriculumConfig`.
        randomization: None, True or fields of `Randomization`.
        spawn: "floor", or "anywhere" to start some episodes on the flight.
        uneven: largest deviation of single risers and treads, metres.
        flight_width: metres.
        reward_weights: fields of `RewardWeights` to change.
        privileged: add what only the simulator knows to the observation, for a critic or a teacher.

    Raises:
        SpecError: (a ValueError) an argument is wrong; the message names it, its value and the choices.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": round(CONTROL_RATE_HZ)}  # noqa: RUF012 (Gymnasium's)
    observation_space: spaces.Dict  # type: ignore[assignment]

    def __init__(
        self,
        robot: str = "aliengo",
        direction: str = "up",
        riser_height: Any = (0.10, 0.17),
        tread_depth: Any = (0.26, 0.34),
        num_steps: Any = (4, 7),
        lighting: str = "day",
        camera: dict[str, Any] | None = None,
        actuation: str = "gait",
        stair_source: str = "oracle",
        render_mode: str | None = None,
        curriculum: Any = None,
        randomization: Any = None,
        spawn: str = "floor",
        uneven: float = 0.0,
        flight_width: float = 1.2,
        reward_weights: dict[str, float] | None = None,
        privileged: bool = False,
    ) -> None:
        self.robot = get_robot(robot)
        self.ranges = StairRanges(direction, riser_height, tread_depth, num_steps, flight_width, uneven)
        check_choice("lighting", lighting, LIGHTING_CHOICES)
        check_choice("actuation", actuation, ACTUATIONS)
        check_choice("spawn", spawn, SPAWNS)
        if not isinstance(privileged, bool):
            raise SpecError(f"privileged={privileged!r} must be True or False")
        if render_mode is not None:
            check_choice("render_mode", render_mode, RENDER_MODES)
        self.lighting, self.actuation, self.spawn = lighting, actuation, spawn
        if camera is not None:  # of no matter here, but a wrong option is one on every id
            from stair_env.sensors.camera.sensor import CameraConfig

            CameraConfig.from_dict(camera)
        self.render_mode = render_mode
        self.randomization = read_randomization(randomization)
        self.curriculum = read_curriculum(curriculum, self.ranges.riser_height[1])
        self.source = make_source(stair_source)
        self.weights = read_weights(reward_weights)
        self.action_size = ACTION_SIZE if actuation == "gait" else NUM_JOINTS
        self.action_space = spaces.Box(-1.0, 1.0, (self.action_size,), np.float32)
        self.privileged = privileged
        parts: dict[str, spaces.Space[Any]] = {"proprio": proprio_space(self.action_size), "stair": stair_space()}
        self.observation_space = spaces.Dict({**parts, PRIVILEGED_KEY: privileged_space()} if privileged else parts)
        self._unreported = False  # whether an episode is under way that the curriculum has not heard of
        self._sim: Simulation | None = None
        self._onlooker: Onlooker | None = None
        self._gait = Gait(self.robot)
        self._kinematics = LegKinematics(self.robot)
        self._odometry = LegOdometry(self.robot)
        self._attitude = AttitudeFilter(PHYSICS_RATE_HZ)
        self._standing_joints = self._kinematics.joint_angles(self.robot.nominal_feet)

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
        drawn = self.ranges.draw(self.np_random, self.curriculum)
        self.stairs = drawn if given is None else given
        self.profile = self.stairs.profile()
        spawn = draw_spawn(self.stairs, self.robot, self.spawn, self.np_random)
        if start:
            drawn_start = {"x": float(spawn.position[0]), "y": float(spawn.position[1]), "yaw": spawn.yaw}
            spawn = standing_at(self.stairs, self.robot, **(drawn_start | start))
        self._body = self.randomization.draw(self.np_random)
        # Separate generators keep episodes of one seed alike across ids, whatever the sensors draw.
        seeds = self.np_random.integers(0, 2**63, size=4)
        source_rng, imu_rng, self._body_rng, camera_rng = (np.random.default_rng(s) for s in seeds)
        shapes = self._world_shapes(self.stairs, camera_rng)
        self._start(spawn, shapes, imu_rng)
        self.source.reset(self.stairs, source_rng)
        self._begin_sensors(camera_rng)
        self._observe_stairs()
        self._judge = Judge(self.stairs, self.profile, self.robot, float(spawn.position[0]))
        self._steps_climbed = self._judge.steps_behind(float(self._state.position[0]))
        self._unreported = False
        return self._observation(), self._info(dict.fromkeys(REWARD_TERMS, 0.0), "")

    def _start(self, spawn: Spawn, shapes: tuple[Shape, ...], imu_rng: np.random.Generator) -> None:
        """Stand the robot up and let it settle, so that the first accelerometer reading is one at rest."""
        if self._sim is None:
            self._sim = self._open_simulation()
        sim = self._sim
        sim.build(shapes, self._body.friction)
        sim.set_payload(self._body.payload_kg)
        joints = self._kinematics.joint_angles(spawn.feet_in_base)
        sim.place_robot(spawn.position, spawn.yaw, joints, spawn.pitch)
        for _ in range(SETTLE_STEPS * SUBSTEPS):
            sim.command_joints(joints)
            sim.step_physics()
        self.time_s = 0.0
        self._imu = Imu(ImuConfig(), imu_rng)
        self._imu.reset(imu_rng, 1.0 / PHYSICS_RATE_HZ)
        self._state = sim.base_state()
        self._motion = MotionRecorder(self._state)
        self._attitude.reset(self._state.rotation[2] * GRAVITY_M_S2)
        self._targets = joints
        self._last_action = np.zeros(self.action_size)
        self._odometry.reset()
        self._odometry_velocity, self._yaw_rate = np.zeros(3), 0.0
        self._gyro = np.zeros(3)
        self._read_body()
        feet = self._kinematics.foot_positions(self._joints) @ base_to_level(self._attitude.up).T
        self._gait.reset(feet[:, 2] - feet[0, 2], phase=float(self._body_rng.random()), pitch=spawn.pitch)
        self._next_push_s = self._draw_push_time()
        self._energy = 0.0

    def _open_simulation(self, visible: bool = False) -> Simulation:
        """Hook for environments whose camera draws with Bullet's renderers (visible) or must load one first."""
        return Simulation(self.robot, self.render_mode == "human", visible or self.render_mode is not None)

    def _world_shapes(self, stairs: StairSpec, rng: np.random.Generator) -> tuple[Shape, ...]:
        """Hook for environments with cameras, whose worlds have surroundings."""
        return build_stair_shapes(stairs)

    def _begin_sensors(self, rng: np.random.Generator) -> None:
        """Hook for environments with cameras: called once the robot stands."""

    def _advance_sensors(self) -> None:
        """Hook for environments with cameras: called after each control step."""

    # ------------------------------------------------------------------ step

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """One control step of 1/48 s."""
        if self._sim is None:
            raise gym.error.ResetNeeded("call reset() before step()")
        action = np.minimum(np.maximum(read_action(action, (self.action_size,)), -1.0), 1.0)
        before = self._state
        self._unreported = True
        self._move(action)
        self._advance_sensors()
        self._read_body()
        self._observe_stairs()
        steps_climbed = max(self._steps_climbed, self._judge.steps_behind(float(self._state.position[0])))
        new_steps, self._steps_climbed = steps_climbed - self._steps_climbed, steps_climbed
        feet = self._feet.tolist()
        termination = self._judge.termination(self._state, feet)
        outcome = StepOutcome(
            before=before,
            after=self._state,
            feet=feet,
            contacts=self._contacts,
            riser_hits=self._riser_hits,
            action=action,
            last_action=self._last_action,
            new_steps=new_steps,
            slope_rad=self._judge.local_slope(feet),
            success=termination == "success",
            fell=termination in FAILURES,
            dt=CONTROL_DT,
        )
        terms = reward_terms(outcome, self.profile, self.weights)
        self._last_action = action
        if termination and self.curriculum is not None:
            self.curriculum.report(termination == "success")
            self._unreported = False
        info = self._info(terms, termination)
        if self.render_mode == "human":
            self.render()
        return self._observation(), float(sum(terms.values())), bool(termination), False, info

    def _move(self, action: np.ndarray) -> None:
        sim = self._sim
        assert sim is not None
        if self.actuation == "gait":
            targets = self._gait.joint_targets(action, self._block, self._odometry_velocity, CONTROL_DT)
        else:
            targets = self._standing_joints + JOINT_ACTION_RAD * action
        late = self.randomization.command_latency
        command = self._targets if late and self._body_rng.random() < late else targets
        sim.command_joints(command, self._body.motor_strength)
        self._targets = targets
        if self.randomization.push_interval_s and self.time_s >= self._next_push_s:
            sim.push(np.append(self._body_rng.uniform(-1, 1, 2) * self.randomization.push_speed, 0.0))
            self._next_push_s = self._draw_push_time()
        self._motion.record(sim.step_and_track(SUBSTEPS))
        self._state = self._motion.last
        self.time_s += CONTROL_DT
        samples = self._imu.sample(self._motion.at_base())
        yaw_before = self._attitude.yaw
        self._attitude.update(samples[:, :3], samples[:, 3:])
        turn = self._attitude.yaw - yaw_before
        self._yaw_rate = ((turn + math.pi) % (2 * math.pi) - math.pi) / CONTROL_DT
        self._gyro = samples[-1, 3:]
        self._specific_force = samples[:, :3].mean(axis=0)

    def _draw_push_time(self) -> float:
        interval = self.randomization.push_interval_s
        return self.time_s + float(self._body_rng.exponential(interval)) if interval else np.inf

    def _read_body(self) -> None:
        sim = self._sim
        assert sim is not None
        self._joints, self._joint_rates, torques = sim.joint_states()
        self._contacts = sim.foot_contacts()
        self._feet = sim.foot_positions()
        self._riser_hits = sum(riser_hits(self._contacts))
        level = base_to_level(self._attitude.up)
        if self.time_s > 0:
            touching, turn = self._contacts.touching, self._yaw_rate * CONTROL_DT
            self._odometry_velocity = self._odometry.update(
                self._joints, touching, self._specific_force, level, turn, CONTROL_DT
            )
            self._energy += float(np.dot(np.abs(torques), np.abs(self._joint_rates))) * CONTROL_DT

    # ------------------------------------------------------------------ what comes out

    def _hip_pose(self) -> HipPose:
        yaw = self._state.yaw
        reach = self.robot.hip_x[0] * math.hypot(self._state.rotation[0, 0], self._state.rotation[1, 0])
        return HipPose(float(self._state.position[0]) + reach * math.cos(yaw), yaw, self.time_s)

    def _observe_stairs(self) -> None:
        hips = self._hip_pose()
        self._truth = true_block(self.stairs, self.profile, hips)
        self._block = self.source.read(hips, self._truth)

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
        phase = 2 * np.pi * self._gait.phase
        return pack_proprio(
            {
                "gravity": -self._attitude.up,
                "angular_velocity": self._gyro,
                "velocity": self._odometry_velocity,
                "yaw_rate": [self._yaw_rate],
                "joint_position": self._joints,
                "joint_velocity": self._joint_rates,
                "joint_error": self._targets - self._joints,
                "contact": self._contacts.touching,
                "foothold_height": self._gait.foothold_heights,
                "phase": [math.sin(phase), math.cos(phase)],
                "last_action": self._last_action,
            }
        )

    def _observation(self) -> dict[str, np.ndarray]:
        return {"proprio": self._proprio(), "stair": self._block.as_array(), **self._privileged()}

    def _privileged(self) -> dict[str, np.ndarray]:
        """The privileged part of the observation, empty unless asked for."""
        if not self.privileged:
            return {}
        radius = self.robot.foot_radius
        truth = Truth(self._truth, self.profile, self._state, self._contacts, self._feet, radius, self._body)
        return {PRIVILEGED_KEY: pack_privileged(truth)}

    def _info(self, terms: dict[str, float], termination: str) -> dict[str, Any]:
        """What is told beside the observation: the same keys and types at reset and at every step."""
        info: dict[str, Any] = {
            "is_success": termination == "success",
            "steps_climbed": self._steps_climbed,
            "reward_terms": terms,
            "termination": termination,
            "truth": {
                **self._truth._asdict(),
                "riser_height": float(self.stairs.riser_height),
                "tread_depth": float(self.stairs.tread_depth),
                "num_steps": len(self.profile.edge_x),
                "position": self._state.position.copy(),
                "velocity": self._state.velocity.copy(),
                "yaw": self._state.yaw,
                "riser_hits": self._riser_hits,
                "energy_j": self._energy,
            },
        }
        if self.curriculum is not None:
            info["curriculum_level"] = self.curriculum.level
        return info

    # ------------------------------------------------------------------ looks

    def render(self) -> np.ndarray | None:
        """Third-person picture: uint8 (H, W, 3), or float32 (H, W) metres for "depth_array"."""
        if self.render_mode is None:
            gym.logger.warn('render() needs render_mode="rgb_array", "depth_array" or "human"')
            return None
        if self._sim is None:
            raise gym.error.ResetNeeded("call reset() before render()")
        if self.render_mode == "human":
            self._sim.follow_with_camera(self._state.position)
            return None
        if self._onlooker is None:
            self._onlooker = Onlooker()
        colour, depth = self._onlooker.look(self._sim.client, self._state.position)
        return colour if self.render_mode == "rgb_array" else depth

    def close(self) -> None:
        """Release the physics; safe to call twice."""
        if self._sim is not None:
            self._sim.close()
            self._sim = None
