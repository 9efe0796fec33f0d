"""Independent pieces of work over processes of this machine or over a Ray cluster, with the same results."""

from stair_env.common.tasks.engine import ENGINES, LOCAL, Engine, EngineError
from stair_env.common.tasks.running import run_tasks

__all__ = ["ENGINES", "LOCAL", "Engine", "EngineError", "run_tasks"]
