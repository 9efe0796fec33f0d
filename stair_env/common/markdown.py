"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

HIDDEN_COLUMNS = ("terminations", "num_steps", "outcomes")


def markdown_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as a Markdown table; columns in the order in which they first appear."""
    columns = [name for name in dict.fromkeys(key for row in rows for key in row) if name not in HIDDEN_COLUMNS]
    lines = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    lines.extend("| " + " | ".join(format_value(row.get(name, "")) for name in columns) + " |" for row in rows)
    return "\n".join(lines) + "\n"


def format_value(value: Any) -> str:
    """A cell: numbers at four significant digits, sequences and objects in words."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, dict):
        return ", ".join(f"{name} {format_value(item)}" for name, item in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(format_value(item) for item in value)
    return str(value).replace("|", "\\|")
