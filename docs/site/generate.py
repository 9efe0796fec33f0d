"""Writes the pages that come from the code: one an environment id, the tables of results/, and the API reference."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import gymnasium as gym
import mkdocs_gen_files

import stair_env  # noqa: F401  (registers the ids)
from stair_env import observation
from stair_env.env import StairClimbEnv
from stair_env.onboard import gait
from stair_env.task import rewards, termination
from stair_env.task.privileged import PRIVILEGED_FIELDS

ROOT = Path(__file__).resolve().parents[2]
API = {
    "environments": (
        "Environments",
        ["stair_env.env", "stair_env.rgbd", "stair_env.vector", "stair_env.parts", "stair_env.observation"],
    ),
    "world": (
        "Stairs, robots, sensors",
        ["stair_env.stairs", "stair_env.robots", "stair_env.sampling", "stair_env.intrinsics"],
    ),
    "perception": (
        "Perception",
        ["perception.estimator", "perception.wrapper", "perception.vector_wrapper", "perception.network"],
    ),
    "policies": (
        "Policies",
        ["policies.pretrained", "policies.portable", "policies.export_actor", "policies.features"],
    ),
}
SUMMARIES = {
    "StairClimb-v0": "A legged robot climbs a staircase whose geometry its observation tells (`stair_source`).",
    "StairClimbRGBD-v0": "The same robot with a simulated RealSense D435i: raw colour, depth and IMU.",
    "StairClimbPerception-v0": "The same robot; StairNetV2 and geometry measure the stairs in the camera's frames.",
}


def table(head: tuple[str, ...], rows: Iterable[tuple[object, ...]]) -> str:
    """A Markdown table."""
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in row) + " |" for row in lines) + "\n"


def comments(module: object) -> dict[str, str]:
    """What the source says behind each quoted name of a table."""
    return dict(re.findall(r'^\s*"(\w+)"[^#\n]*#\s*(.+)$', inspect.getsource(module), re.MULTILINE))  # type: ignore[arg-type]


def section(docstring: str, name: str) -> list[tuple[str, str]]:
    """(names, text) of the entries of a Google-style section."""
    body = re.search(rf"^{name}:\n((?:    .*\n|\n)+)", inspect.cleandoc(docstring) + "\n", re.MULTILINE)
    assert body is not None, f"no section {name}"
    entries = re.split(r"^    (?=\w)", body.group(1), flags=re.MULTILINE)[1:]
    pairs = (re.sub(r"\s+", " ", entry).strip().split(": ", 1) for entry in entries)
    return [(names, text) for names, text in pairs]


def proprio_rows() -> Iterable[tuple[object, ...]]:
    """Fields of the proprioceptive block."""
    told = comments(observation)
    for name, (length, bound) in observation.PROPRIO_FIELDS.items():
        first = observation.PROPRIO_SLICES[name].start
        yield f"{first}–{first + length - 1}", f"`{name}`", length, f"±{bound:g}", told.get(name, "")


def stair_rows() -> Iterable[tuple[object, ...]]:
    """Fields of the stair block."""
    told = comments(observation)
    for index, name in enumerate(observation.STAIR_FIELDS):
        low, high = observation.STAIR_LOW[index], observation.STAIR_HIGH[index]
        yield index, f"`{name}`", f"{low:.3g} to {high:.3g}", told[name]


def environment_page(name: str) -> str:
    """A page in the form of Gymnasium's environment pages."""
    env = gym.make(f"stair_env/{name}")
    spec = env.spec
    assert spec is not None
    keys = list(env.observation_space.spaces)  # type: ignore[attr-defined]
    parts = [f"# {name}\n", SUMMARIES[name] + "\n", f'```python\nenv = gym.make("stair_env/{name}")\n```\n']
    spaces = [("Action space", f"`{env.action_space}`")]
    spaces += [(f"Observation `{key}`", f"`{brief(env.observation_space[key])}`") for key in keys]  # type: ignore[index]
    parts += [table(("", ""), spaces), "## Action\n"]
    config = gait.GaitConfig()
    scales = {
        "feet": f"±{config.residual_m:g} m", "speed": f"±{100 * config.speed_range:g} %",
        "clearance": f"±{config.clearance_range:g} m", "frequency": f"±{100 * config.frequency_range:g} %",
        "pitch": f"±{config.pitch_range:g} rad",
    }  # fmt: skip
    numbers = {"feet": "0–11", "speed": 12, "clearance": 13, "frequency": 14, "pitch": 15}
    told = section(gait.GaitAction.__doc__ or "", "Attributes")
    parts.append(
        "Sixteen numbers in [-1, 1] modulate a trot that plans its footholds from the stair block; zeros are the gait "
        'alone. With `actuation="joint"` twelve numbers are joint offsets from standing instead.\n'
    )
    parts.append(
        table(("number", "modulates", "at ±1"), [(numbers[n], f"`{n}`: {text}", scales[n]) for n, text in told])
    )
    parts.append("## Observation\n")
    parts += ["`proprio`, float32:\n", table(("index", "field", "length", "bound", ""), proprio_rows())]
    if "stair" in keys:
        parts += ["`stair`, float32; all zero while no stairs are known:\n"]
        parts += [table(("index", "field", "range", ""), stair_rows())]
    if "rgb" in keys:
        parts.append(
            "`rgb` uint8 (H, W, 3) and `depth` float32 (H, W), metres, 0 = no reading, aligned to each other; `imu` the "
            "camera's accelerometer and gyro since the last control step ([sensors](../sensors.md)).\n"
        )
    parts.append(f"With `privileged=True` also `privileged`: {', '.join(f'`{f}`' for f in PRIVILEGED_FIELDS)}.\n")
    parts.append("## Reward\n\nThe weighted sum of these terms; `rewards=` changes them ([parts](../parts.md)).\n")
    weights = rewards.RewardWeights()
    parts.append(
        table(
            ("term", "weight", ""),
            [
                (f"`{n}`", f"{getattr(weights, n):g}", first_line(getattr(rewards, n, None)))
                for n in rewards.REWARD_TERMS
            ],
        )
    )
    parts.append(
        '## Starting state\n\nThe robot stands before the first step (`spawn="anywhere"`: some episodes start '
    )
    parts.append("on the flight), turned by a few degrees; staircase, body and sensors are drawn from `seed`.\n")
    parts.append("## Episode end\n\nTerminated:\n")
    ends = termination.DEFAULT_TERMINATIONS.items()
    parts.append(table(("termination", ""), [(f"`{n}`", first_line(fn)) for n, fn in ends]))
    parts.append(f"Truncated after {spec.max_episode_steps} control steps of 1/48 s (`max_episode_steps`).\n")
    parts.append("## Arguments\n")
    arguments = section(StairClimbEnv.__doc__ or "", "Args")
    given = inspect.signature(StairClimbEnv).parameters
    parts.append(
        table(("argument", "default", ""), [argument_row(names.split(", "), text, given) for names, text in arguments])
    )
    parts.append("## Version history\n\n- v0: first version.\n")
    env.close()
    return "\n".join(parts)


def argument_row(names: list[str], text: str, given: Mapping[str, inspect.Parameter]) -> tuple[str, str, str]:
    """Names, defaults and meaning of arguments that are told of together."""
    quoted = ", ".join(f"`{name}`" for name in names)
    return quoted, ", ".join(f"`{given[name].default!r}`" for name in names), text


def first_line(fn: object) -> str:
    """First line of a docstring."""
    return (inspect.getdoc(fn) or "").split("\n")[0] if fn is not None else ""


def brief(space: gym.Space) -> str:  # type: ignore[type-arg]
    """A Box without its bounds, which have a table of their own."""
    return f"Box({space.shape}, {space.dtype})"


def write(path: str, text: str) -> None:
    """A page of the site."""
    with mkdocs_gen_files.open(path, "w") as page:
        page.write(text)


for env_name in SUMMARIES:
    write(f"environments/{env_name}.md", environment_page(env_name))
for key, (title, modules) in API.items():
    write(f"api/{key}.md", f"# {title}\n\n" + "\n".join(f"::: {module}\n" for module in modules))
for source in sorted((ROOT / "results").iterdir()):
    if source.suffix == ".md":
        write(f"results/{source.name}", source.read_text(encoding="utf-8"))
    elif source.suffix in (".png", ".json"):
        with mkdocs_gen_files.open(f"results/{source.name}", "wb") as copy:
            copy.write(source.read_bytes())
