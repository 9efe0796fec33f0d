"""The robot's latency budget has every part."""

from __future__ import annotations

from perception.deploy.climber import PARTS
from stair_env_cli.bench import deploy_rows


def test_every_part_has_a_row_with_time_in_it() -> None:
    assert deploy_rows.PARTS == PARTS
    rows = [row(1, "onnx") for row in deploy_rows.ROWS.values()]
    assert all(row.ours > 0.0 and row.theirs > 20.0 and row.unit == "ms" for row in rows)
    found = deploy_rows.latencies(1, "onnx")
    assert found["network"]["calls"] == 8.0 and found["gait"]["calls"] == 24.0
