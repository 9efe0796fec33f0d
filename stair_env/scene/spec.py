"""A whole scene as data, and the solids that it stands for."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from stair_env.common.field_kinds import naming_fields
from stair_env.common.validation import JsonSpec, SpecError, from_fields
from stair_env.scene.appearance import AppearanceSpec, NosingStrip
from stair_env.scene.objects.distractors import DistractorSpec
from stair_env.scene.objects.fittings import FittingsSpec, build_fittings
from stair_env.scene.shapes import Shape, box_between, build_stair_shapes
from stair_env.scene.surroundings import SurroundingsSpec, build_surroundings
from stair_env.stairs import StairEdge, StairSpec

if TYPE_CHECKING:
    from typing_extensions import Self

STRIP_THICKNESS_M = 0.001  # by which a strip stands out: enough to be drawn, far below what a depth camera resolves
STRIP_PIECES = 5  # into which a strip breaks that has come off in places


@dataclass(frozen=True)
class SceneSpec(JsonSpec):
    """Stairs or none, how they look, what stands around them; JSON-able, and enough to rebuild the scene.

    Args:
        stairs: the staircase, or None for a scene without one.
        appearance: materials and light.
        distractors: things that look like stairs and are not.
        surroundings: walls and floors around, or None for nothing beyond the stairs' own ground. A scene without
            stairs always has surroundings, since they hold its floor.
        fittings: balustrades, skirting and the like, or None.

    Raises:
        SpecError: a field is of the wrong type.
    """

    stairs: StairSpec | None
    appearance: AppearanceSpec = field(default_factory=AppearanceSpec)
    distractors: tuple[DistractorSpec, ...] = ()
    surroundings: SurroundingsSpec | None = None
    fittings: FittingsSpec | None = None

    @naming_fields
    def __post_init__(self) -> None:
        object.__setattr__(self, "distractors", tuple(self.distractors))
        if self.stairs is None and self.surroundings is None:
            object.__setattr__(self, "surroundings", SurroundingsSpec())
        kinds = (StairSpec, AppearanceSpec, SurroundingsSpec, FittingsSpec)
        for name, kind in zip(("stairs", "appearance", "surroundings", "fittings"), kinds):
            value = getattr(self, name)
            if not isinstance(value, kind) and (value is not None or name == "appearance"):
                raise SpecError(f"{name}={value!r} must be a {kind.__name__}")
        for distractor in self.distractors:
            if not isinstance(distractor, DistractorSpec):
                raise SpecError(f"distractors hold {distractor!r}, must be DistractorSpec")

    @property
    def is_negative(self) -> bool:
        """Whether no staircase is there to be seen."""
        return self.stairs is None

    @classmethod
    def from_dict(cls, values: Any) -> Self:
        """Rebuild a spec from `dataclasses.asdict` output.

        Raises:
            SpecError: values is no dict or holds an unknown field.
        """
        if isinstance(values, dict):
            values = dict(values)
            if values.get("stairs") is not None:
                values["stairs"] = StairSpec.from_dict(values["stairs"])
            if "appearance" in values:
                values["appearance"] = AppearanceSpec.from_dict(values["appearance"])
            if values.get("surroundings") is not None:
                values["surroundings"] = from_fields(SurroundingsSpec, values["surroundings"])
            if values.get("fittings") is not None:
                values["fittings"] = from_fields(FittingsSpec, values["fittings"])
            values["distractors"] = tuple(
                from_fields(DistractorSpec, distractor) for distractor in values.get("distractors", ())
            )
        built: Self = from_fields(cls, values)
        return built


class Scene:
    """The solids and the stair lines of a SceneSpec, built once.

    Args:
        spec: what to build.
    """

    def __init__(self, spec: SceneSpec) -> None:
        self.spec = spec

    @functools.cached_property
    def shapes(self) -> tuple[Shape, ...]:
        """Every solid: the stairs, their nosing strips and fittings, the surroundings, then the distractors."""
        spec = self.spec
        shapes: list[Shape] = []
        if spec.stairs is not None:
            shapes.extend(build_stair_shapes(spec.stairs))
            if spec.appearance.nosing_strip is not None:
                shapes.extend(build_nosing_strips(spec.stairs, spec.appearance.nosing_strip))
            if spec.fittings is not None:
                shapes.extend(build_fittings(spec.fittings, spec.stairs))
        if spec.surroundings is not None:
            shapes.extend(build_surroundings(spec.surroundings, spec.stairs))
        for distractor in spec.distractors:
            shapes.extend(distractor.shapes)
        return tuple(shapes)

    @functools.cached_property
    def edges(self) -> tuple[StairEdge, ...]:
        """Every stair line; none in a scene without stairs."""
        return self.spec.stairs.edges() if self.spec.stairs is not None else ()


def build_nosing_strips(stairs: StairSpec, strip: NosingStrip) -> tuple[Shape, ...]:
    """Thin painted boxes along the nosings, in the stair frame."""
    rng = np.random.default_rng(strip.seed)
    half = stairs.flight_width / 2
    reach = half - min(strip.inset_m, 0.3 * half)
    shapes = []
    for edge in _with_strip(stairs, strip):
        back = 1.0 if stairs.profile().rises[edge.step] > 0 else -1.0  # from the nosing over its tread
        pieces = [(-reach, reach)] if strip.missing == 0.0 else _what_is_left(rng, reach, strip.missing)
        for near, far, drop in _lines(strip):
            low_x, high_x = sorted((edge.x + back * near, edge.x + back * far))
            for right, left in pieces:
                low, high = (low_x, right, edge.z - drop), (high_x, left, edge.z + STRIP_THICKNESS_M)
                shapes.append(dataclasses.replace(box_between(low, high, "nosing"), collides=False))
    return tuple(shapes)


def _with_strip(stairs: StairSpec, strip: NosingStrip) -> list[StairEdge]:
    """The nosings that have a strip."""
    ends = {0, stairs.num_steps - 1, stairs.num_steps, 2 * stairs.num_steps - 1}
    return [edge for edge in stairs.edges() if edge.kind == "convex" and (not strip.ends_only or edge.step in ends)]


def _lines(strip: NosingStrip) -> list[tuple[float, float, float]]:
    """(start, end, reach downwards) of each line of a strip, metres back from the nosing."""
    on_edge = strip.setback_m == 0.0
    start, drop = (-STRIP_THICKNESS_M, strip.drop_m) if on_edge else (strip.setback_m, STRIP_THICKNESS_M)
    if strip.lines == 1:
        return [(start, start + strip.width_m, drop)]
    narrow = strip.width_m / 3
    second = start + 2 * narrow
    return [(start, start + narrow, drop), (second, second + narrow, STRIP_THICKNESS_M)]


def _what_is_left(rng: np.random.Generator, reach: float, missing: float) -> list[tuple[float, float]]:
    """Pieces (right, left) of a strip of which some have come off, neighbours joined."""
    inner = np.sort(rng.uniform(-reach, reach, STRIP_PIECES - 1)).tolist()
    ends = [-reach, *inner, reach]
    left: list[tuple[float, float]] = []
    for k, gone in enumerate((rng.random(STRIP_PIECES) < missing).tolist()):
        if gone or ends[k + 1] - ends[k] < 1e-3:
            continue
        if left and left[-1][1] == ends[k]:
            left[-1] = (left[-1][0], ends[k + 1])
        else:
            left.append((ends[k], ends[k + 1]))
    return left
