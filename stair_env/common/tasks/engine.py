"""Where tasks run."""

from __future__ import annotations

from dataclasses import dataclass

from stair_env.common.validation import check_choice

ENGINES = ("local", "ray")


class EngineError(OSError):
    """Tasks cannot be run where they were asked to; the message says why."""


@dataclass(frozen=True)
class Engine:
    """Where tasks run.

    Args:
        kind: "local" (processes of this machine) or "ray".
        workers: processes; with Ray the cores of the cluster that it starts here, without meaning at an address.
        address: of a running Ray cluster, as `ray start` prints it ("auto" finds one on this machine); None starts one
            here that ends with the work.

    Raises:
        ValueError: a wrong value, or an address without Ray.
    """

    kind: str = "local"
    workers: int = 1
    address: str | None = None

    def __post_init__(self) -> None:
        check_choice("engine", self.kind, ENGINES)
        if self.workers < 1:
            raise ValueError(f"workers={self.workers!r} must be >= 1")
        if self.address is not None and self.kind != "ray":
            raise ValueError(f"ray_address={self.address!r} is for engine='ray', not {self.kind!r}")

    @property
    def in_this_process(self) -> bool:
        """Whether tasks run one after the other here, without any worker."""
        return self.kind == "local" and self.workers == 1


LOCAL = Engine()
