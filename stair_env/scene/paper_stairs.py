"""The six staircases that the StairNetV2 paper measures (its table 7), as they truly are."""

from __future__ import annotations

from dataclasses import dataclass

from stair_env.common.validation import SpecError
from stair_env.stairs import Direction, StairSpec


@dataclass(frozen=True)
class PaperStair:
    """One staircase of table 7.

    Attributes:
        name: as in the paper.
        steps_mm: ((width, height), ...) of the three measured steps, millimetres.
    """

    name: str
    steps_mm: tuple[tuple[float, float], ...]

    @property
    def tread_depth(self) -> float:
        """Mean step width, metres."""
        return sum(width for width, _ in self.steps_mm) / len(self.steps_mm) / 1000.0

    @property
    def riser_height(self) -> float:
        """Mean step height, metres."""
        return sum(height for _, height in self.steps_mm) / len(self.steps_mm) / 1000.0

    def spec(self, direction: Direction = "up", num_steps: int = 6) -> StairSpec:
        """A flight whose lowest steps are the measured ones and whose others are their mean.

        Args:
            direction: of walking.
            num_steps: at least as many as were measured.

        Raises:
            SpecError: too few steps.
        """
        measured = len(self.steps_mm)
        if num_steps < measured:
            raise SpecError(f"num_steps={num_steps!r} must be >= {measured}, the number of measured steps")
        rest = (0.0,) * (num_steps - measured)
        return StairSpec(
            direction=direction,
            riser_height=self.riser_height,
            tread_depth=self.tread_depth,
            num_steps=num_steps,
            riser_offsets=tuple(height / 1000.0 - self.riser_height for _, height in self.steps_mm) + rest,
            tread_offsets=tuple(width / 1000.0 - self.tread_depth for width, _ in self.steps_mm) + rest,
        )


PAPER_STAIRS: tuple[PaperStair, ...] = (
    PaperStair("Stair1", ((296, 160), (293, 150), (295, 150))),
    PaperStair("Stair2", ((288, 153), (289, 162), (289, 161))),
    PaperStair("Stair3", ((304, 153), (307, 145), (307, 145))),
    PaperStair("Stair4", ((341, 143), (340, 147), (342, 146))),
    PaperStair("Stair5", ((300, 163), (298, 154), (296, 154))),
    PaperStair("Stair6", ((321, 114), (322, 151), (322, 152))),
)
