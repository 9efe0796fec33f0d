"""Tables 2, 3 and 6: our rows beside the paper's, and in sentences whether they stand in the paper's order."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from perception.reproduction.table5_detection import Tally

LIGHTS = ("all", "day", "night")
MEASURES = ("accuracy", "recall", "iou")
CLOSE_POINTS = 1.0  # rows whose IOU differs by less need several seeds
SEEDS_TO_TELL = 3
UNTRAINED_ROW = "classical"  # has no seed

Scores = Mapping[str, Sequence[Mapping[str, Tally]]]  # row -> per training seed: split -> counts


@dataclass(frozen=True)
class PaperRow:
    """One row of a table of the paper, or of ours beside it: per cent, day and night together.

    Attributes:
        row: our key of it.
        model: our name of it.
        accuracy, recall, iou: per cent; None for rows that the paper does not have.
        width: channel width factor that the figures belong to; None for what has none.
        runtime_ms: with an R9 5950X and an RTX A4000; table 6 only.
    """

    row: str
    model: str
    accuracy: float | None = None
    recall: float | None = None
    iou: float | None = None
    width: float | None = None
    runtime_ms: float | None = None


# Rows from the lowest to the highest IOU in the paper; before them those that it does not have. Table 6 has StairNet
# and StairNetV2 in three widths; 0.25 here.
PAPER_TABLES: dict[int, tuple[PaperRow, ...]] = {
    2: (
        PaperRow("four_channels", "colour and depth as one image of four channels"),
        PaperRow("concatenation", "fusion by concatenation after the second down-sampling"),
        PaperRow("stairnetv2_fusion_4", "fusion after the fourth down-sampling", 90.35, 92.37, 84.08, 1.0),
        PaperRow("stairnetv2_fusion_3", "fusion after the third down-sampling", 91.52, 92.96, 85.59, 1.0),
        PaperRow("stairnetv2", "fusion after the second down-sampling", 91.99, 93.15, 86.16, 1.0),
    ),
    3: (
        PaperRow("stairnetv2_fixed_weights", "fixed loss weights", 91.79, 93.15, 85.98, 1.0),
        PaperRow("stairnetv2", "dynamic loss weights", 91.99, 93.15, 86.16, 1.0),
    ),
    6: (
        PaperRow("classical", "Gabor + Canny + Hough", 26.02, 25.20, 14.68, None, 7.42),
        PaperRow("roi_classical", "YOLOv5 + Gabor + Canny + Hough", 38.56, 30.65, 20.59, None, 25.17),
        PaperRow("stairnet", "StairNet", 83.68, 85.59, 73.35, 0.25, 3.71),
        PaperRow("stairnetv2", "StairNetV2", 89.85, 92.44, 83.70, 0.25, 3.06),
    ),
}


def table_rows(
    table: int, scores: Scores, widths: Mapping[str, float | None], cpu_ms: Mapping[str, float]
) -> list[dict[str, Any]]:
    """A table with the paper's figures beside ours.

    Args:
        table: 2, 3 or 6.
        scores: of the table's rows; rows without scores are left out.
        widths: of our rows.
        cpu_ms: milliseconds of processor time a frame.

    Returns:
        Three rows a model: all frames, day, night. Figures are means over the seeds, with the range of the IOU where
        there are several. The paper's figures stand with all frames; it has none by light for these tables.
    """
    rows = []
    for paper, split in itertools.product(PAPER_TABLES[table], LIGHTS):
        tallies = [tally[split] for tally in scores.get(paper.row, ()) if split in tally]
        if not tallies:
            continue
        row: dict[str, Any] = {"model": paper.model, "width": widths.get(paper.row), "split": split}
        row |= {name: round(_mean([getattr(tally.counts, name) for tally in tallies]), 2) for name in MEASURES}
        row |= {"frames": tallies[0].counts.frames, "seeds": len(tallies)}
        if len(tallies) > 1:
            ious = [tally.counts.iou for tally in tallies]
            row["iou_range"] = [round(min(ious), 2), round(max(ious), 2)]
        if split == "all":
            row["cpu_ms"] = round(cpu_ms[paper.row], 1)
            if paper.iou is not None:
                row |= {f"paper_{name}": getattr(paper, name) for name in MEASURES}
            if paper.runtime_ms is not None:
                row["paper_ms"] = paper.runtime_ms
        rows.append(row)
    return rows


def table_notes(table: int, scores: Scores) -> list[str]:
    """What a table says about the paper's claims, each sentence decided by the numbers."""
    missing = [paper.model for paper in PAPER_TABLES[table] if paper.row not in scores]
    notes = [order_note(table, scores), *spread_notes(table, scores)]
    if missing:
        notes.append(f"Not trained yet and left out: {', '.join(missing)}.")
    networks = [scores[row][0] for row in ("stairnet", "stairnetv2") if row in scores]
    if table == 6 and len(networks) == 2 and all(light in tallies for tallies in networks for light in LIGHTS):
        notes.append(night_note(scores))
    return notes


def order_note(table: int, scores: Scores) -> str:
    """Our order by IOU, and where it differs from the paper's."""
    names = {paper.row: paper.model for paper in PAPER_TABLES[table] if paper.row in scores}
    ious = {row: mean_iou(scores[row]) for row in names}
    ours = " < ".join(f"{names[row]} {ious[row]:.2f}" for row in sorted(ious, key=lambda row: ious[row]))
    in_paper = [paper.row for paper in PAPER_TABLES[table] if paper.row in names and paper.iou is not None]
    swapped = [
        f"{names[high]} should lead {names[low]} and is {ious[low] - ious[high]:.2f} points behind"
        + (", less than their seeds differ" if _overlap(scores[low], scores[high]) else "")
        for low, high in itertools.combinations(in_paper, 2)
        if ious[low] > ious[high]
    ]
    if len(in_paper) < 2:
        return f"By IOU: {ours}."
    verdict = "the paper's order" if not swapped else f"not the paper's order: {'; '.join(swapped)}"
    return f"By IOU: {ours} — {verdict}."


def _overlap(low: Sequence[Mapping[str, Tally]], high: Sequence[Mapping[str, Tally]]) -> bool:
    """Whether a seed of the one stands above and another below a seed of the other; one seed each tells nothing."""
    a, b = ([tally["all"].counts.iou for tally in tallies] for tallies in (low, high))
    return max(len(a), len(b)) > 1 and min(a) < max(b) and min(b) < max(a)


def spread_notes(table: int, scores: Scores) -> list[str]:
    """How far several trainings of a row lie apart, or that close rows were trained but once."""
    papers = [paper for paper in PAPER_TABLES[table] if paper.row in scores]
    notes = []
    for paper in papers:
        ious = [tally["all"].counts.iou for tally in scores[paper.row]]
        if len(ious) > 1:
            notes.append(f"{paper.model}: {len(ious)} seeds, IOU {min(ious):.2f} to {max(ious):.2f}.")
    close = [
        f"{a.model} and {b.model}"
        for a, b in _close_pairs(table, scores)
        if any(len(scores[paper.row]) < SEEDS_TO_TELL for paper in (a, b) if paper.row != UNTRAINED_ROW)
    ]
    if close:
        notes.append(
            f"Less than {CLOSE_POINTS:g} point apart and trained with fewer than three seeds, so not told apart here: "
            f"{'; '.join(close)}."
        )
    return notes


def close_rows(scores: Scores) -> list[str]:
    """Rows with training that lie less than a point of IOU from another of their table: these need several seeds."""
    pairs = itertools.chain.from_iterable(_close_pairs(table, scores) for table in PAPER_TABLES)
    return list(dict.fromkeys(paper.row for pair in pairs for paper in pair if paper.row != UNTRAINED_ROW))


def _close_pairs(table: int, scores: Scores) -> list[tuple[PaperRow, PaperRow]]:
    papers = [paper for paper in PAPER_TABLES[table] if paper.row in scores]
    return [
        (a, b)
        for a, b in itertools.combinations(papers, 2)
        if abs(mean_iou(scores[a.row]) - mean_iou(scores[b.row])) < CLOSE_POINTS
    ]


def night_note(scores: Scores) -> str:
    """Whether StairNetV2's lead over StairNet is larger at night, as the paper says of depth."""
    by_day, at_night = (mean_iou(scores["stairnetv2"], x) - mean_iou(scores["stairnet"], x) for x in ("day", "night"))
    verdict = "larger at night, as in the paper" if at_night > by_day else "not larger at night, unlike the paper"
    return f"StairNetV2's lead over StairNet in IOU: {by_day:.2f} points by day, {at_night:.2f} at night — {verdict}."


def mean_iou(tallies: Sequence[Mapping[str, Tally]], split: str = "all") -> float:
    """IOU of a split, per cent, mean over seeds; nan when no frame belongs to it."""
    return _mean([tally[split].counts.iou for tally in tallies if split in tally])


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")
