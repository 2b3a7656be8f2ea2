"""A Ray cluster of one node for a long check, in a process of its own, with CPUs that are taken.

Its process, and not that of the check, connects to Ray, whose threads no fork may inherit.
``python -m tests.long.ray_cluster CPUS TAKEN`` prints the address, gives the taken CPUs free at the
first line of its input, and ends with its input.
"""

import os
import subprocess
import sys
import warnings
from pathlib import Path
from types import TracebackType
from typing import Any, Self

_ADDRESS = "address "
_ROOT = Path(__file__).parents[2]
_END = 60.0
"""Longest time in which the cluster has to end [s]."""
LOOPBACK = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}
"""Environment variable that lets Ray use the address 127.0.0.1, as it does on those systems."""


class RayCluster:
    """A cluster with ``cpus`` CPUs, of which another job has taken ``taken``."""

    def __init__(self, cpus: int, taken: int, folder: Path) -> None:
        """Start the cluster; its files lie in ``folder``, whose path must be short (sockets)."""
        folder.mkdir()
        with (folder / "log").open("w") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.long.ray_cluster", str(cpus), str(taken)],
                cwd=_ROOT,
                env={**os.environ, **LOOPBACK, "RAY_TMPDIR": str(folder)},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                start_new_session=True,
            )
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith(_ADDRESS):
                self.address = line.removeprefix(_ADDRESS).strip()
                return
        raise SystemExit(f"no Ray cluster has started: {(folder / 'log').read_text()}")

    def give_free(self) -> None:
        """End the other job, whose CPUs become free."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print("free", file=self._process.stdin, flush=True)
        self._process.stdout.readline()

    def __enter__(self) -> Self:
        """Return the cluster."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Shut the cluster down and wait for its end."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        try:
            self._process.wait(_END)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()


def main() -> None:
    """Start a cluster and keep it until the input ends."""
    import ray
    from ray.cluster_utils import Cluster
    from ray.util.placement_group import placement_group, remove_placement_group

    cpus, taken = (int(word) for word in sys.argv[1:])
    node: dict[str, Any] = {"num_cpus": cpus, "object_store_memory": 80 * 2**20}
    node |= {"include_dashboard": False, "include_log_monitor": False, "no_monitor": True}
    cluster = Cluster(initialize_head=True, head_node_args=node)
    ray.init(address=cluster.address, log_to_driver=False, logging_level="ERROR")
    group = placement_group([{"CPU": taken}]) if taken else None
    if group and not group.wait(30):
        raise SystemExit("the CPUs could not be taken")
    print(f"{_ADDRESS}{cluster.address}", flush=True)
    for _ in sys.stdin:
        if group:
            remove_placement_group(group)
        group = None
        print("free", flush=True)
    ray.shutdown()
    cluster.shutdown()


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Ray's own
        main()
