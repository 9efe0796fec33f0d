"""A policy that travels acts as one that is loaded where its files are."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from policies import pretrained
from policies.evaluate.flying import Luggage
from policies.evaluate.packed_policy import pack, unpack
from policies.make_env import CLIMB_ID, make_env


def test_a_packed_policy_acts_as_the_loaded_one() -> None:
    env = make_env(CLIMB_ID, pretrained.interface("aliengo"), monitor=False)
    observation, _ = env.reset(seed=1)
    travelled = unpack(pickle.loads(pickle.dumps(pack("aliengo"))), env)
    here = pretrained.load("aliengo", env)
    assert np.array_equal(travelled.predict(observation)[0], here.predict(observation)[0])
    assert travelled.name == "aliengo" and travelled.card == here.card
    env.close()


def test_it_is_refused_by_its_own_name() -> None:
    env = make_env(CLIMB_ID, {"actuation": "joint"}, monitor=False)
    with pytest.raises(pretrained.PolicyError, match="policy 'aliengo' does not fit"):
        unpack(pack("aliengo"), env)
    env.close()


def test_luggage_differs_when_a_file_does(tmp_path: Path) -> None:
    for name, content in pack("aliengo").files.items():
        (tmp_path / name).write_bytes(content)
    before = pack(tmp_path)
    (tmp_path / "card.json").write_bytes(before.files["card.json"] + b" ")
    first, second = (Luggage({"x": packed}) for packed in (before, pack(tmp_path)))
    assert first.digest != second.digest and first.digest == Luggage({"x": before}).digest
