"""Training on a real Ray cluster of two nodes on this machine."""

import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from flipperctl.config import with_overrides
from flipperctl.errors import ConfigError, FlipperctlError
from flipperctl.learners.d3qn_run import DoubleQLearning
from flipperctl.rollout import cluster as ray_cluster
from flipperctl.training.run import resume
from tests.rollout.notes import Notes
from tests.short import short_config, trainer
from tests.training.test_searched import tiny

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore"),  # Ray's own
]

ray = pytest.importorskip("ray")


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Yield a head node and another, with one CPU each."""
    from ray.cluster_utils import Cluster

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        memory = {"object_store_memory": 80 * 2**20}
        node = {"num_cpus": 1, "include_log_monitor": False, **memory}
        head = {"include_dashboard": False, "no_monitor": True, **node}
        found = Cluster(initialize_head=True, head_node_args=head)
        found.add_node(**node)
        found.wait_for_nodes()
        yield found
        ray.shutdown()
        found.shutdown()


class NodeKiller(Notes):
    """A listener that removes a node after an episode."""

    def __init__(self, cluster: Any, episode: int) -> None:
        super().__init__()
        self._cluster, self._at = cluster, episode
        self.lags: list[int] = []

    def episode(self, row: dict) -> None:
        self.lags.append(row["lag"])
        if row["episode"] == self._at:
            node = next(n for n in self._cluster.list_all_nodes() if not n.head)
            self._cluster.remove_node(node, allow_graceful=False)


@pytest.mark.long
def test_a_run_goes_on_with_the_workers_that_have_a_cpu(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four workers want the two CPUs; the validations ask those that have one, and a stop ends."""
    monkeypatch.setattr(ray_cluster, "_REPORT_AFTER", 1.0)
    collector = {"name": "ray", "address": cluster.address, "workers": 4}
    settings = {"train.mode": "fast", "collector": collector, "train.decisions": 10**6}
    learner = trainer(short_config(**settings, **{"train.validate_every": 200}), tmp_path)
    listener = Notes()
    learner.listeners.append(listener)
    expected = "2 of 4 Ray workers (collector.workers) have no CPU"
    summary = learner.run(
        lambda: expected in str(listener.notes) and len(learner.validator.history) > 1
    )
    assert summary["finished"] is False
    assert summary["lost_episodes"] == 0
    assert "The run continues with 2; others join when a CPU is free" in listener.notes[-1]
    more = learner.progress.decision + 20
    changes = {"collector": "local", "train.decisions": more, "train.validate_every": more}
    resumed = resume(tmp_path, changes)  # without the cluster
    assert (resumed.summary["decisions"], resumed.summary["lost_episodes"]) == (more, 0)


@pytest.mark.long
def test_searched_values_come_with_the_episodes(cluster: Any, tmp_path: Path) -> None:
    collector = {"name": "ray", "address": cluster.address, "workers": 1}
    run = trainer(with_overrides(tiny(12, "fast"), {"collector": collector}), tmp_path)
    assert run.run()["finished"] is True
    assert run.learning._valued.memory.added == 6 * run.progress.episode > 0


@pytest.mark.long
def test_without_a_free_cpu_a_run_stops_at_once_when_asked_and_fails_in_time(
    cluster: Any, tmp_path: Path
) -> None:
    ray.init(address=cluster.address, log_to_driver=False, logging_level="ERROR")
    try:
        held = [ray.remote(Notes).options(num_cpus=1).remote() for _ in range(2)]
        ray.get([actor.__ray_ready__.remote() for actor in held])
        collector = {"name": "ray", "workers": 1, "patience": 1.0}
        config = short_config(**{"train.mode": "fast", "collector": collector})
        begun = time.monotonic()
        stopped = trainer(config, tmp_path / "stopped")
        assert stopped.run(lambda: time.monotonic() > begun + 0.5)["finished"] is False
        with pytest.raises(FlipperctlError, match=r"no Ray worker got a CPU.* 1 s \(collector"):
            trainer(config, tmp_path / "failed").run()
        assert time.monotonic() - begun < 30
    finally:
        ray.shutdown()


@pytest.mark.long
def test_a_run_on_two_nodes_finishes_though_one_is_killed(cluster: Any, tmp_path: Path) -> None:
    collector = {"name": "ray", "address": cluster.address, "workers": 2}
    settings = {"train.mode": "fast", "collector": collector, "train.decisions": 1500}
    config = short_config(**settings, **{"teacher.controller": {"name": "okada"}})
    learner = trainer(config, tmp_path)
    killer = NodeKiller(cluster, episode=10)
    learner.listeners.append(killer)
    summary = learner.run()
    assert summary["finished"] is True
    assert summary["decisions"] == 1500
    assert len(cluster.list_all_nodes()) == 1
    lost = [note for note in killer.notes if "a worker died" in note]  # one may wait for a CPU, too
    assert summary["lost_episodes"] == len(lost) >= 1
    assert max(killer.lags) > 0
    assert isinstance(learner.learning, DoubleQLearning)
    labels = learner.learning.replay.filled()["label"]  # they come with the rollouts that arrived
    assert (labels.sum(axis=1) == 1).all()


def test_exact_and_ray_exclude_each_other() -> None:
    with pytest.raises(ConfigError, match=r"^train\.mode: exact.*collector=ray needs .*=fast$"):
        short_config(**{"collector": {"name": "ray"}})
