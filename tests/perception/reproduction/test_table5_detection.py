"""Tables of scores."""

from __future__ import annotations

from perception.reproduction.table5_detection import beside_paper


def test_the_papers_figures_stand_in_the_rows_that_its_table_has() -> None:
    rows = [{"width": 0.5, "split": "night", "iou": 1.0}, {"width": 0.5, "split": "all", "iou": 2.0}]
    night, everything = beside_paper(rows)
    assert night["paper_iou"] == 83.53 and night["paper_accuracy"] == 89.22 and night["iou"] == 1.0
    assert everything == rows[1]
