"""What can be swapped in an environment, and what such parts see: one place to import it from.

| argument of `gym.make` | a name or plain value | an object |
|---|---|---|
| `robot` | name in `ROBOTS` | `RobotSpec` |
| `gait` | "trot" | `GaitConfig`, a `GaitPlanner`, or what makes one for a `RobotSpec` |
| `stair_source` | "oracle", "noisy", "blind", "shuffled", "external" | `StairSource` |
| `rewards` | {term: weight, or None for off} | {name: `RewardTerm`} |
| `terminations` | {name: None for off} | {name: function of a `StepState`} |
| `observations` | {part: None for left out} | {name: `ObservationTerm`} |
| `sampler` | None | `StairSampler`, for example `SceneSampler` |
| `randomization`, `curriculum` | True, None or their fields | `Randomization` |

Objects travel to worker processes by cloudpickle: functions and classes are importable there, or are defined in the
script that is run. Each environment works with a copy of its own.
"""

from __future__ import annotations

from stair_env.observation import NO_STAIRS, StairBlock
from stair_env.onboard.gait import Gait, GaitConfig, TrotStyle
from stair_env.onboard.planner import GaitPlanner
from stair_env.robots import ROBOTS, CameraMount, RobotSpec
from stair_env.sampling import SceneSampler, SceneSpec
from stair_env.stairs import StairSpec
from stair_env.task.observation_terms import ObservationTerm
from stair_env.task.randomization import Randomization
from stair_env.task.rewards import DEFAULT_REWARDS, RewardTerm
from stair_env.task.sources import HipPose, StairSource
from stair_env.task.stair_ranges import StairSampler
from stair_env.task.step_state import Episode, StepState
from stair_env.task.termination import DEFAULT_TERMINATIONS

__all__ = [
    "DEFAULT_REWARDS",
    "DEFAULT_TERMINATIONS",
    "NO_STAIRS",
    "ROBOTS",
    "CameraMount",
    "Episode",
    "Gait",
    "GaitConfig",
    "GaitPlanner",
    "HipPose",
    "ObservationTerm",
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
]
