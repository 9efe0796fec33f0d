"""A whole scene as data, and the solids that it stands for."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from stair_env.common.validation import JsonSpec, SpecError, from_fields
from stair_env.scene.appearance import AppearanceSpec, NosingStrip
from stair_env.scene.distractors import DistractorSpec
from stair_env.scene.shapes import Shape, box_between, build_stair_shapes
from stair_env.scene.surroundings import SurroundingsSpec, build_surroundings
from stair_env.stairs import StairEdge, StairSpec

if TYPE_CHECKING:
    from typing_extensions import Self

STRIP_THICKNESS_M = 0.001  # by which a strip stands out: enough to be drawn, far below what a depth camera resolves
STRIP_DROP_M = 0.012  # how far a strip without setback reaches down over the nosing


@dataclass(frozen=True)
class SceneSpec(JsonSpec):
    """Stairs or none, how they look, what stands around them; JSON-able, and enough to rebuild the scene.

    Args:
        stairs: the staircase, or None for a scene without one.
        appearance: materials and light.
        distractors: things that look like stairs and are not.
        surroundings: walls and floors around, or None for nothing beyond the stairs' own ground. A scene without
            stairs always has surroundings, since they hold its floor.

    Raises:
        SpecError: a field is of the wrong type.
    """

    stairs: StairSpec | None
    appearance: AppearanceSpec = field(default_factory=AppearanceSpec)
    distractors: tuple[DistractorSpec, ...] = ()
    surroundings: SurroundingsSpec | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "distractors", tuple(self.distractors))
        if self.stairs is None and self.surroundings is None:
            object.__setattr__(self, "surroundings", SurroundingsSpec())
        for name, kind in (("stairs", StairSpec), ("appearance", AppearanceSpec), ("surroundings", SurroundingsSpec)):
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
        """Every solid: the stairs, their nosing strips, the surroundings, then the distractors."""
        spec = self.spec
        shapes: list[Shape] = []
        if spec.stairs is not None:
            shapes.extend(build_stair_shapes(spec.stairs))
            if spec.appearance.nosing_strip is not None:
                shapes.extend(build_nosing_strips(spec.stairs, spec.appearance.nosing_strip))
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
    """One thin painted box along every nosing, in the stair frame."""
    half = stairs.flight_width / 2
    shapes = []
    for edge in stairs.edges():
        if edge.kind != "convex":
            continue
        back = 1.0 if stairs.profile().rises[edge.step] > 0 else -1.0  # from the nosing over its tread
        near = -back * STRIP_THICKNESS_M if strip.setback_m == 0.0 else back * strip.setback_m
        far = near + back * strip.width_m
        low_x, high_x = sorted((edge.x + near, edge.x + far))
        drop = STRIP_DROP_M if strip.setback_m == 0.0 else STRIP_THICKNESS_M
        box = box_between((low_x, -half, edge.z - drop), (high_x, half, edge.z + STRIP_THICKNESS_M), "nosing")
        shapes.append(dataclasses.replace(box, collides=False))
    return tuple(shapes)
