"""A policy's files as one value, so that it can fly on machines that lack them."""

from __future__ import annotations

import hashlib
import tempfile
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym

from policies import pretrained


@dataclass(frozen=True)
class PackedPolicy:
    """What `pretrained.load` reads.

    Attributes:
        name: as it was asked for.
        files: contents by name.
        digest: SHA-256 of name and files.
    """

    name: str
    files: dict[str, bytes]
    digest: str


def pack(policy: str | Path) -> PackedPolicy:
    """Read a policy's files without building it.

    Args:
        policy: as in `pretrained.load`.

    Raises:
        PolicyError: no such policy, or a shipped file was changed.
    """
    files = pretrained.read_files(policy)
    card = pretrained.locate(policy) / pretrained.CARD_FILE
    if card.is_file():
        files[pretrained.CARD_FILE] = card.read_bytes()
    digest = hashlib.sha256(str(policy).encode())
    for name in sorted(files):
        digest.update(name.encode() + files[name])
    return PackedPolicy(str(policy), files, digest.hexdigest())


def unpack(packed: PackedPolicy, env: gym.Env) -> pretrained.Policy:
    """The policy that `pretrained.load` gives where the files are; its errors."""
    with tempfile.TemporaryDirectory() as folder:
        for name, content in packed.files.items():
            (Path(folder) / name).write_bytes(content)
        policy = pretrained.load(folder)
    policy.name = packed.name
    policy.check_spaces(env)
    return policy
