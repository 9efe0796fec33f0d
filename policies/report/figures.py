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


def draw_curves(curves: Mapping[str, Sequence[Mapping[str, Any]]], path: Path | str) -> None:
    """Learning curves: success rate and curriculum level over environment steps.

    Args:
        curves: rows of `policies.train.callbacks.read_curve` by the run's name.
        path: PNG to write.

    Raises:
        ValueError: there is no row to draw.
    """
    if not any(curves.values()):
        raise ValueError("no learning curve holds a row")
    figure, axes = _panels(1, 2)
    for name, rows in curves.items():
        for axis, field in zip(axes[0], ("success_rate", "level_mean")):
            points = [(row["timesteps"] / 1e6, row[field]) for row in rows if row[field] != ""]
            if points:
                axis.plot(*np.array(points).T, label=name, linewidth=1.2)
    for axis, label in zip(axes[0], ("success rate, last 100 episodes", "curriculum level")):
        axis.set_xlabel("million environment steps")
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[0, 0].set_ylim(0.0, 1.02)
    axes[0, 0].legend(fontsize=8)
    _save(figure, path)


def _panels(rows: int, columns: int) -> tuple[Figure, np.ndarray]:
    """A figure without a display, and its axes as a 2-D array."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(PANEL_INCHES[0] * columns + 1.2, PANEL_INCHES[1] * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes: np.ndarray = figure.subplots(rows, columns, squeeze=False)
    return figure, axes


def _save(figure: Figure, path: Path | str) -> None:
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=RESOLUTION_DPI, format="png")
