"""Tasks on Ray: the same results, also where a node dies under them."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stair_env.common.tasks import Engine, EngineError, run_tasks
from stair_env.common.tasks import ray_pool as pool

ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'stair-env[ray]', or make test-ray")

NODES, STORE_BYTES = 3, 80_000_000
LARGE = 200_000  # bytes: results above 100 kB stay on the node that made them until they are fetched


@pytest.fixture()
def cluster() -> Iterator[Any]:
    """Three nodes of one core each, on this machine."""
    from ray.cluster_utils import Cluster

    os.environ.setdefault(pool.NICENESS, "0")
    node = {"num_cpus": 1, "object_store_memory": STORE_BYTES}
    made = Cluster(initialize_head=True, head_node_args=dict(node))
    for _ in range(NODES - 1):
        made.add_node(**node)
    made.wait_for_nodes()
    yield made
    ray.shutdown()
    made.shutdown()


def draw(seed: int, offset: float) -> bytes:
    time.sleep(0.1)
    return np.random.default_rng(seed).bytes(LARGE) + str(offset).encode()


def fail(item: int, shared: None) -> int:
    if item == 3:
        raise ValueError(f"item={item}")
    return item


def die(item: int, shared: None) -> None:
    os._exit(1)


def kill_after(cluster: Any, results: Iterator[Any], count: int) -> Iterator[Any]:
    """Hand results on; after some of them one node is gone without a word."""
    for index, result in enumerate(results):
        if index == count:
            cluster.remove_node(cluster.list_all_nodes()[-1], allow_graceful=False)
        yield result


def test_a_killed_node_changes_no_result(cluster: Any) -> None:
    wanted = dict(run_tasks(draw, range(60), shared=1.0))
    engine = Engine("ray", address=cluster.address)
    found = list(kill_after(cluster, run_tasks(draw, range(60), engine, shared=1.0), 15))
    assert len(found) == 60 and dict(found) == wanted
    assert len(cluster.list_all_nodes()) == NODES - 1


def test_a_cluster_of_its_own_ends_with_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    engine = Engine("ray", workers=2)
    assert dict(run_tasks(fail, [0, 1, 2], engine)) == {0: 0, 1: 1, 2: 2}
    assert not ray.is_initialized()
    with pytest.raises(ValueError, match=r"^item=3$"):
        list(run_tasks(fail, range(6), engine))
    monkeypatch.setattr(pool, "RETRIES", 1)
    with pytest.raises(EngineError, match="lost its worker 2 times"):
        list(run_tasks(die, [0], engine))
    assert not ray.is_initialized()


def test_no_cluster_at_an_address_is_told() -> None:
    with pytest.raises(EngineError, match=r"ray_address='127\.0\.0\.1:1'"):
        list(run_tasks(fail, [0], Engine("ray", address="127.0.0.1:1")))


def evaluation(**engine: Any) -> Any:
    """48 flights of the gait and of a policy, up and down."""
    from policies.evaluate.evaluation import EvaluationConfig

    common = {"policy": "aliengo", "sources": ("oracle", "gait"), "stairs": "random", "episodes": 12, "seed": 5}
    return EvaluationConfig(**common, **engine)


@pytest.mark.slow
def test_flights_are_those_of_one_machine(cluster: Any) -> None:
    from policies.evaluate.evaluation import run_all

    wanted, done = run_all(evaluation(workers=2)), []

    def count(episodes: int) -> None:
        done.append(episodes)
        if sum(done) == 10:
            cluster.remove_node(cluster.list_all_nodes()[-1], allow_graceful=False)

    assert run_all(evaluation(engine="ray", ray_address=cluster.address)) == wanted
    assert run_all(evaluation(engine="ray", ray_address=cluster.address), count) == wanted
    assert sum(done) == sum(map(len, wanted.values())) == 48 and len(cluster.list_all_nodes()) == NODES - 1


@pytest.mark.slow
def test_perceived_flights_share_a_network_and_stay_the_same() -> None:
    from policies.evaluate.evaluation import EvaluationConfig, run_all

    config = {"policy": "aliengo", "sources": ("stairnet",), "stairs": "random", "episodes": 2, "directions": ("up",)}
    config |= {"env_kwargs": {"max_episode_steps": 30}}
    wanted = run_all(EvaluationConfig(**config, workers=2))
    on_ray = {**config, "workers": 2, "engine": "ray"}
    assert run_all(EvaluationConfig(**on_ray)) == wanted
    shared = run_all(EvaluationConfig(**on_ray, network_server=True))
    assert shared == wanted  # on the CPU; a graphics card rounds differently
    assert sum(episode.measured for episode in wanted["stairnet", 0]) > 0


def contents(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}


@pytest.mark.slow
def test_a_data_set_is_that_of_one_machine(cluster: Any, tmp_path: Path) -> None:
    from perception.data.writer import DatasetPlan, complete, write_missing

    plans = {name: DatasetPlan(tmp_path / name, {"train": 160, "val": 20, "test": 20}, seed=5) for name in "abc"}
    engine = Engine("ray", address=cluster.address)
    list(write_missing(plans["a"], Engine(workers=2)))
    list(write_missing(plans["b"], engine))
    list(kill_after(cluster, write_missing(plans["c"], engine), 40))
    for plan in plans.values():
        assert complete(plan)["images"] == 400
    wanted = contents(tmp_path / "a")
    assert contents(tmp_path / "b") == wanted and contents(tmp_path / "c") == wanted
    assert len(cluster.list_all_nodes()) == NODES - 1
