"""What can be swapped in an environment, and what such parts see: one place to import it from.

| argument of `gym.make` | a name or plain value | an object |
|---|---|---|
| `robot` | name in `ROBOTS` | `RobotSpec` |
| `actuation` | "gait", "joint", or fields | `JointActuation` |
| `actuator` | "position", "pd", or fields | `PdActuator`, an `Actuator`, or what makes one for a `RobotSpec` |
| `gait` | "trot" | `GaitConfig`, a `GaitPlanner`, or what makes one for a `RobotSpec` |
| `stair_source` | "oracle", "noisy", "blind", "shuffled", "external" | `StairSource` |
| `rewards` | {default or optional term: weight, or None for off} | {name: `RewardTerm`} |
| `terminations` | {name: None for off} | {name: function of a `StepState`} |
| `observations` | "stairs", "height_scan", "proprio"; {part: None for left out} | {name: `ObservationTerm`} |
| `command` | forward speed, or fields | `CommandConfig` |
| `sampler` | None | `StairSampler`, for example `SceneSampler` |
| `randomization`, `curriculum` | True, None or their fields | `Randomization` |

Objects travel to worker processes by cloudpickle: functions and classes are importable there, or are defined in the
script that is run. Each environment works with a copy of its own.
"""

from __future__ import annotations

from stair_env.observation import NO_STAIRS, StairBlock
from stair_env.onboard.gait import Gait, GaitConfig, TrotStyle
from stair_env.onboard.planner import GaitPlanner, JointActuation
from stair_env.physics.motors import Actuator, MotorBody, PdActuator
from stair_env.robots import ROBOTS, CameraMount, RobotSpec
from stair_env.sampling import SceneSampler, SceneSpec
from stair_env.stairs import StairSpec
from stair_env.task.observation_terms import ObservationTerm
from stair_env.task.randomization import Randomization
from stair_env.task.rewards import DEFAULT_REWARDS, RewardTerm
from stair_env.task.sources import HipPose, StairSource
from stair_env.task.stair_ranges import StairSampler
from stair_env.task.step_state import Command, Episode, StepState
from stair_env.task.termination import DEFAULT_TERMINATIONS
from stair_env.task.terms.commands import CommandConfig
from stair_env.task.terms.height_scan import HeightScan, HeightScanConfig, height_scan_space
from stair_env.task.terms.legged_rewards import OPTIONAL_REWARDS

__all__ = [
    "DEFAULT_REWARDS",
    "DEFAULT_TERMINATIONS",
    "NO_STAIRS",
    "OPTIONAL_REWARDS",
    "ROBOTS",
    "Actuator",
    "CameraMount",
    "Command",
    "CommandConfig",
    "Episode",
    "Gait",
    "GaitConfig",
    "GaitPlanner",
    "HeightScan",
    "HeightScanConfig",
    "HipPose",
    "JointActuation",
    "MotorBody",
    "ObservationTerm",
    "PdActuator",
    "Randomization",
    "RewardTerm",
    "RobotSpec",
    "SceneSampler",
    "SceneSpec",
    "StairBlock",
    "StairSampler",
    "StairSource",
    "StairSpec",
    "StepState",
    "TrotStyle",
    "height_scan_space",
]
