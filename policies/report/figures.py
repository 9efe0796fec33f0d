"""Figures of results: success over staircases, learning curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stair_env.common.files import atomic_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANEL_INCHES = (3.0, 2.8)
RESOLUTION_DPI = 130


def draw_success(cells: Sequence[Mapping[str, Any]], path: Path | str) -> None:
    """Success by riser and tread, a panel for each source (columns) and direction (rows).

    Args:
        cells: as `policies.evaluate.evaluation.evaluate` returns them, with one number for riser and tread.
        path: PNG to write.

    Raises:
        ValueError: no cell has one number for riser and tread (the stairs were random).
    """
    sized = [cell for cell in cells if not isinstance(cell["riser_height"], (list, tuple))]
    if not sized:
        raise ValueError("a figure needs stairs='grid' or 'paper': random stairs have no single riser and tread")
    sources = list(dict.fromkeys(cell["source"] for cell in sized))
    directions = list(dict.fromkeys(cell["direction"] for cell in sized))
    figure, axes = _panels(len(directions), len(sources))
    image: Any = None
    for row, direction in enumerate(directions):
        for column, source in enumerate(sources):
            part = [cell for cell in sized if cell["source"] == source and cell["direction"] == direction]
            image = _draw_panel(axes[row, column], part)
            axes[row, column].set_title(f"{source}, {direction}", fontsize=10)
    for axis in axes[-1]:
        axis.set_xlabel("tread depth, m")
    for axis in axes[:, 0]:
        axis.set_ylabel("riser height, m")
    figure.colorbar(image, ax=axes, label="success rate", shrink=0.8)
    _save(figure, path)


def _draw_panel(axis: Axes, cells: Sequence[Mapping[str, Any]]) -> Any:
    """One heat map; every cell carries its number."""
    if any("stair" in cell for cell in cells):  # the paper's stairs lie on no grid: one column, a row for each
        rows = [f"{cell['stair'][-1]}: {cell['riser_height']:.3f}" for cell in cells]
        values, columns = np.array([[cell["success_rate"]] for cell in cells]), ["mean of its own"]
    else:
        risers = sorted({cell["riser_height"] for cell in cells}, reverse=True)
        treads = sorted({cell["tread_depth"] for cell in cells})
        values = np.full((len(risers), len(treads)), np.nan)
        for cell in cells:
            values[risers.index(cell["riser_height"]), treads.index(cell["tread_depth"])] = cell["success_rate"]
        rows, columns = [f"{riser:.2f}" for riser in risers], [f"{tread:.2f}" for tread in treads]
    image = axis.imshow(values, vmin=0.0, vmax=1.0, cmap="RdYlGn", aspect="auto")
    axis.set_yticks(range(len(rows)), rows, fontsize=8)
    axis.set_xticks(range(len(columns)), columns, fontsize=8)
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            axis.text(column, row, f"{value:.0%}", ha="center", va="center", fontsize=9)
    return image


def draw_ladder(rows: Sequence[Mapping[str, Any]], path: Path | str) -> None:
    """Success over riser height, and by condition beside it: rows of panels are robots, columns directions.

    Args:
        rows: cells of an evaluation on the ladder with `policy` and `robot` (`policies.evaluate.leaderboard.rows_of`).
        path: PNG to write.

    Raises:
        ValueError: there is no row.
    """
    if not rows:
        raise ValueError("a figure of the ladder needs rows of an evaluation with stairs='ladder'")
    robots, directions = (list(dict.fromkeys(row[name] for row in rows)) for name in ("robot", "direction"))
    figure, axes = _panels(len(robots), len(directions), (5.2, 3.2))
    for line, robot in enumerate(robots):
        for column, direction in enumerate(directions):
            axis = axes[line, column]
            _draw_rungs(axis, [row for row in rows if row["robot"] == robot and row["direction"] == direction])
            axis.set_title(f"{robot}, {direction}", fontsize=10)
        axes[line, 0].set_ylabel("success, 95 % interval")
        axes[line, -1].legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    _save(figure, path)


def _draw_rungs(axis: Axes, rows: Sequence[Mapping[str, Any]]) -> None:
    """A line over the rungs and points over the conditions, for each policy and source."""
    risers = sorted({row["riser_height"] for row in rows if row["condition"] == "rung"})
    conditions = list(dict.fromkeys(row["condition"] for row in rows if row["condition"] != "rung"))
    step = 0.02  # metres of the axis from one condition to the next
    places = {name: (risers[-1] if risers else 0.0) + step * (index + 1) for index, name in enumerate(conditions)}
    lines: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        lines.setdefault((row["policy"], row["source"]), []).append(row)
    for index, ((policy, source), part) in enumerate(lines.items()):
        shift = 0.0012 * (index - (len(lines) - 1) / 2)
        colour, name = f"C{index}", f"{policy}, {source}"
        rungs = sorted((row for row in part if row["condition"] == "rung"), key=lambda row: row["riser_height"])
        for chosen, style in ((rungs, "o-"), ([row for row in part if row["condition"] != "rung"], "o")):
            x = np.array([places.get(row["condition"], row["riser_height"]) for row in chosen]) + shift
            y = np.array([row["success_rate"] for row in chosen])
            error = np.abs(np.array([row["ci95"] for row in chosen]).reshape(-1, 2).T - y)
            axis.errorbar(x, y, error, fmt=style, color=colour, label=name, markersize=3, linewidth=1.0, elinewidth=0.6)
            name = ""
    axis.set_xticks([*risers, *places.values()], [*(f"{riser:.2f}" for riser in risers), *conditions], rotation=40)
    axis.tick_params(axis="x", labelsize=8)
    if risers and conditions:
        axis.axvline(risers[-1] + step / 2, color="0.7", linewidth=0.8)
    axis.set_ylim(-0.03, 1.03)
    axis.grid(alpha=0.3)
    axis.set_xlabel("riser height, m | condition")


def draw_curves(curves: Mapping[str, Sequence[Mapping[str, Any]]], path: Path | str) -> None:
    """Learning curves over environment steps: success rate, and curriculum level or, where there is none, return.

    Args:
        curves: rows of `policies.train.callbacks.read_curve` by the run's name.
        path: PNG to write.

    Raises:
        ValueError: there is no row to draw.
    """
    if not any(curves.values()):
        raise ValueError("no learning curve holds a row")
    figure, axes = _panels(1, 2)
    levels = any(row["level_mean"] != "" for rows in curves.values() for row in rows)
    second = ("level_mean", "curriculum level") if levels else ("return_mean", "return, last 100 episodes")
    for name, rows in curves.items():
        for axis, field in zip(axes[0], ("success_rate", second[0])):
            points = [(row["timesteps"] / 1e6, row[field]) for row in rows if row[field] != ""]
            if points:
                axis.plot(*np.array(points).T, label=name, linewidth=1.2)
    for axis, label in zip(axes[0], ("success rate, last 100 episodes", second[1])):
        axis.set_xlabel("million environment steps")
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[0, 0].set_ylim(0.0, 1.02)
    axes[0, 0].legend(fontsize=8)
    _save(figure, path)


def draw_imitation(curves: Mapping[str, Sequence[Mapping[str, Any]]], path: Path | str) -> None:
    """Learning from a teacher: flights alone that arrive, over some rounds, with intervals, and the fit's error.

    Args:
        curves: of `policies.train.imitation.lesson_curves.read_runs`.
        path: PNG to write.
    """
    figure, axes = _panels(1, 2)
    for name, rows in curves.items():
        steps = [row["timesteps"] / 1e3 for row in rows]
        flown = [(row["timesteps"] / 1e3, row["alone_rate"], *row["alone_ci95"]) for row in rows if row["alone_ci95"]]
        (line,) = axes[0, 1].plot(steps, [row["loss"] for row in rows], label=name, linewidth=1.2)
        if flown:
            at, rate, low, high = np.array(flown).T
            axes[0, 0].plot(at, rate, label=name, linewidth=1.2, color=line.get_color())
            axes[0, 0].fill_between(at, low, high, color=line.get_color(), alpha=0.1, linewidth=0)
    for axis, label in zip(axes[0], ("flights alone that arrive", "error of the fit, in actions")):
        axis.set_xlabel("thousand control steps")
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[0, 0].set_ylim(0.0, 1.02)
    axes[0, 1].legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    _save(figure, path)


def _panels(rows: int, columns: int, inches: tuple[float, float] = PANEL_INCHES) -> tuple[Figure, np.ndarray]:
    """A figure without a display, and its axes as a 2-D array."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(inches[0] * columns + 1.2, inches[1] * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes: np.ndarray = figure.subplots(rows, columns, squeeze=False)
    return figure, axes


def _save(figure: Figure, path: Path | str) -> None:
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=RESOLUTION_DPI, format="png")
