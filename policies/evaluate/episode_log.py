"""Episodes on disk as they are flown, so that a long evaluation goes on where it was cut off."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from policies.rollout import Episode

SUFFIX = ".episodes.jsonl"
Key = tuple[str, str | None, int, int]  # source, policy, index of the cell, seed


def log_path(results: Path | str) -> Path:
    """Where the episodes behind a results file are kept."""
    return Path(results).with_suffix(SUFFIX)


class EpisodeLog:
    """Lines of JSON: the settings first, then an episode each, written as soon as it is over.

    Args:
        path: of the file.
        settings: all that an episode depends on beside its source, policy, cell and seed; JSON-able.
        resume: keep what is there; else begin anew.

    Attributes:
        episodes: what is known, by source, policy, index of the cell and seed.

    Raises:
        ValueError: resume, and the file has other settings or is no such log.
    """

    def __init__(self, path: Path | str, settings: Mapping[str, Any], *, resume: bool = False) -> None:
        self.path = Path(path)
        self.episodes: dict[Key, Episode] = {}
        settings = json.loads(json.dumps(dict(settings)))
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if resume and self.path.is_file() and self.path.stat().st_size:
            self._read(settings)
        else:
            self._begin(settings)

    def _begin(self, settings: Mapping[str, Any]) -> None:
        self.path.write_text(json.dumps({"settings": settings}) + "\n", encoding="utf-8")

    def _read(self, settings: Mapping[str, Any]) -> None:
        whole, _, cut = self.path.read_bytes().rpartition(b"\n")
        if not whole:  # a kill broke the very first line off
            self._begin(settings)
            return
        try:
            first, *rest = (json.loads(line) for line in whole.splitlines())
            found = first["settings"]
            for row in rest:
                episode = Episode(**row["episode"])
                self.episodes[row["source"], row["policy"], row["cell"], episode.seed] = episode
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{self.path} is no log of episodes: {error}") from error
        changed = [name for name in {**found, **settings} if found.get(name) != settings.get(name)]
        if changed:
            differences = ", ".join(f"{name}={found.get(name)!r}, now {settings.get(name)!r}" for name in changed)
            raise ValueError(f"{self.path} was written with {differences}; begin anew, or write elsewhere")
        if cut:  # a line that a kill broke off
            os.truncate(self.path, len(whole) + 1)

    def add(self, source: str, policy: str | None, cell_index: int, episodes: Iterable[Episode]) -> None:
        """Write episodes down."""
        lines = []
        for episode in episodes:
            self.episodes[source, policy, cell_index, episode.seed] = episode
            row = {"source": source, "policy": policy, "cell": cell_index, "episode": dataclasses.asdict(episode)}
            lines.append(json.dumps(row, default=float) + "\n")
        with self.path.open("a", encoding="utf-8") as file:
            file.writelines(lines)
