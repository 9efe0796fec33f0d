"""A training's curves on Weights & Biases, which watches what TensorBoard is given."""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stair_env.common.importing.extras import naming_extras

ID_FILE = "wandb_id"


@contextmanager
def wandb_run(project: str | None, folder: Path, config: Mapping[str, Any]) -> Iterator[None]:
    """Follow a training; a resumed one goes on in the same run.

    Args:
        project: of Weights & Biases; None follows nothing.
        folder: of the run, gets `wandb/`.
        config: shown beside the curves.

    Raises:
        MissingExtraError: wandb is not installed.
    """
    if project is None:
        yield
        return
    with naming_extras():
        import wandb
    known = folder / ID_FILE
    if not known.is_file():
        known.write_text(secrets.token_hex(4), encoding="utf-8")
    run = wandb.init(
        project=project,
        id=known.read_text(encoding="utf-8").strip(),
        resume="allow",
        name=folder.name,
        dir=str(folder),
        config=dict(config),
        sync_tensorboard=True,
    )
    try:
        yield
    finally:
        run.finish()
