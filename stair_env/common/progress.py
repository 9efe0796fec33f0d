"""Progress bars: on stderr, lively on a terminal and terse in a log file."""

from __future__ import annotations

import sys
from typing import Any

TERMINAL_INTERVAL_S = 0.2
LOG_INTERVAL_S = 15.0


def progress_bar(total: int | None, description: str = "", *, initial: int = 0, unit: str = "it") -> Any:
    """A tqdm bar; the caller updates and closes it (or uses it in a `with`)."""
    from tqdm import tqdm

    return tqdm(
        total=total,
        desc=description or None,
        initial=initial,
        unit=unit,
        file=sys.stderr,
        dynamic_ncols=True,
        mininterval=TERMINAL_INTERVAL_S if sys.stderr.isatty() else LOG_INTERVAL_S,
    )
