"""Model cards of shipped policies: what they were trained on, how it went, and how well they climb."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from policies.report.figures import draw_curves, draw_imitation
from policies.train.checkpoints import read_state
from policies.train.curves import CURVE_FILE, add_rates, read_curve
from policies.train.described import described
from policies.train.training import CARD_FILE, CONFIG_FILE, load_config
from stair_env.common.files import atomic_path, read_json_object
from stair_env.common.markdown import format_value, markdown_table

PROVENANCE = ("seed", "commit", "date", "machine")
PAGE_FILE = "README.md"
CURVE_PICTURE = "curve.png"
EVALUATED = ("episodes", "successes", "success_rate", "ci95", "steps_climbed_fraction", "rmse_mm")


def run_card(folder: Path) -> tuple[dict[str, Any], Path | None]:
    """The card of a policy of a run, and the run's learning curve.

    Args:
        folder: `RUN/final`, which holds a card, or `RUN/checkpoints/step_N`, whose card is put together from what the
            run wrote; any other folder has an empty card.

    Returns:
        JSON-able card, and the path of `curve.csv` or None.
    """
    for run in (folder.parent, folder.parent.parent):
        if (run / CONFIG_FILE).is_file():
            break
    else:
        return _read(folder / CARD_FILE), None
    curve = run / CURVE_FILE
    card = _read(folder / CARD_FILE)
    if not card:
        config = load_config(run)
        steps = read_state(folder)["num_timesteps"]
        rows = [row for row in read_curve(curve) if row["timesteps"] <= steps]
        card = {
            "algorithm": config.algorithm,
            "env_id": config.env_id,
            "env_kwargs": described(config.resolved_env_kwargs()),
            "hyperparams": config.resolved_hyperparams(),
            "timesteps": steps,
            "training": rows[-1] if rows else {},
            **{name: value for name, value in _read(run / CONFIG_FILE).items() if name in PROVENANCE},
        }
    return card, curve if curve.is_file() else None


def _read(path: Path) -> dict[str, Any]:
    """A JSON object; empty where there is no file."""
    return read_json_object(path) if path.is_file() else {}


def write_card(
    folder: Path, name: str, card: Mapping[str, Any], curve_file: Path | None, evaluations: Sequence[Path] = ()
) -> Path:
    """Write a policy's README.md, with its learning curve as a picture.

    Args:
        folder: of the policy.
        name: it is shipped under.
        card: as training wrote it.
        curve_file: `curve.csv` of the run, or None.
        evaluations: JSON files of `stair-env evaluate` for this policy.

    Raises:
        ValueError: an evaluation is no result of `stair-env evaluate`.
    """
    parts = [f"# {name}\n", _training(card)]
    rows = read_curve(curve_file) if curve_file else []
    if rows:
        if "alone_episodes" in rows[0]:
            draw_imitation({name: add_rates(rows)}, folder / CURVE_PICTURE)
        else:
            draw_curves({name: rows}, folder / CURVE_PICTURE)
        parts.append(f"![Learning curve]({CURVE_PICTURE})\n")
    parts.extend(_evaluation(path) for path in evaluations)
    target = folder / PAGE_FILE
    with atomic_path(target) as temporary:
        temporary.write_text("\n".join(parts), encoding="utf-8")
    return target


def _training(card: Mapping[str, Any]) -> str:
    training = card.get("training", {})
    facts = {
        "algorithm": card.get("algorithm"),
        "method": card.get("method"),
        "acts": "both ways: the mean over what it sees and the mirror image of it" if card.get("symmetric") else None,
        "environment": card.get("env_id"),
        "arguments": json.dumps(card.get("env_kwargs", {})),
        "hyperparameters": json.dumps(card.get("hyperparams", {})),
        "environment steps": card.get("timesteps"),
        "wall time, s": training.get("wall_s"),
        "success rate of the flights alone in the last round"
        if "alone_episodes" in training
        else "success rate of the last 100 training episodes": training.get("success_rate"),
        "curriculum level at the end, mean over environments": training.get("level_mean"),
        "seed": card.get("seed"),
        "commit": card.get("commit"),
        "date": card.get("date"),
    }
    lines = [f"- {label}: {format_value(value)}" for label, value in facts.items() if value not in (None, "")]
    return "## Training\n\n" + "\n".join(lines) + "\n"


def _evaluation(path: Path) -> str:
    content = read_json_object(path)
    if "overall" not in content:
        raise ValueError(f"{path} is no result of `stair-env evaluate`: it has no 'overall'")
    rows = [
        {"source": source, **{key: values[key] for key in EVALUATED if key in values}}
        for source, values in content["overall"].items()
    ]
    setting = f"robot {content.get('robot')}, stairs {content.get('stairs')}, {content.get('lighting')}"
    return f"## Evaluation: {setting}\n\n{markdown_table(rows)}"
