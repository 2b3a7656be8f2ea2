"""Cells played on a Ray cluster: one task a cell.

In: the scenes of an evaluation and its store. Out: the cells that the store lacked, as far as the
cluster could play them. What it could not play, the evaluation then plays itself.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from flipperctl import plugins
from flipperctl.config import EnvConfig, EvalConfig, parse, to_dict
from flipperctl.errors import FlipperctlError
from flipperctl.evaluation.cells import Series
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.judging import Judge, require_unchanged
from flipperctl.evaluation.runner import EpisodeRunner
from flipperctl.policies.source import PolicySource
from flipperctl.rollout import ray_cluster
from flipperctl.rollout.values import POLL

LOCAL = "local"
"""Address that stands for a cluster of this machine, started for the evaluation alone."""


def play_over_ray(
    judge: Judge,
    scenes: Sequence[tuple[EvalConfig, PolicySource]],
    stop: Callable[[], bool],
) -> None:
    """Let the cluster ``eval.ray`` play every cell that the store lacks, in any order.

    Raises:
        MissingExtraError: Ray is not installed.
        ConfigError: no cluster answers at the address.
        OutputError, WriteError: a cell cannot be written.
    """
    settings = scenes[0][0].eval
    wanted = list(_cells(judge, scenes))
    if not wanted or settings.ray is None:
        return
    ray = ray_cluster.import_ray()
    joined = ray.is_initialized()
    if not joined and settings.ray == LOCAL:
        ray_cluster.start_local(settings.jobs)
    elif not joined:
        ray_cluster.join(settings.ray, "eval.ray", **ray_cluster.QUIET)
    try:
        task = ray.remote(play_cell)
        cwd, paths = str(Path.cwd()), plugins.configured_paths()
        running: dict[Any, tuple[Series, int]] = {}
        for series, config, source, cell in wanted:
            document = to_dict(config.environment())
            reference = task.remote(
                *(series.key, series.policy.digest, document, source, config.eval.seed, cell),
                cwd=cwd,
                paths=paths,
            )
            running[reference] = series, len(cell)
        with judge.progress("cells over Ray", sum(size for _, size in running.values())) as report:
            _collect(ray, judge, running, stop, report)
        for reference in running:
            ray.cancel(reference)
    finally:
        if not joined:
            ray_cluster.shut_down()


def _collect(
    ray: Any,
    judge: Judge,
    running: dict[Any, tuple[Series, int]],
    stop: Callable[[], bool],
    report: Callable[[float], None],
) -> None:
    """Store each cell as it comes, until none is left or ``stop`` returns True."""
    done = 0
    while running and not stop():
        ready, _ = ray.wait(list(running), timeout=POLL)
        for reference in ready:
            series, size = running.pop(reference)
            try:
                judge.store.add(series, ray.get(reference))
            except ray.exceptions.RayError:  # the evaluation plays it, and names its error
                continue
            done += size
            report(done)


def _cells(
    judge: Judge, scenes: Sequence[tuple[EvalConfig, PolicySource]]
) -> Iterator[tuple[Series, EvalConfig, PolicySource, list[int]]]:
    """Yield the cells that the store lacks, each once."""
    seen: set[tuple[str, int]] = set()
    for config, source in scenes:
        try:
            series, cells = judge.series(config, source), judge.missing(config, source)
        except FlipperctlError:  # the evaluation names it
            continue
        for cell in cells:
            if (series.key, cell[0]) not in seen:
                seen.add((series.key, cell[0]))
                yield series, config, source, cell


_runner: tuple[str, EpisodeRunner] | None = None  # the newest series' in a process of Ray


def play_cell(
    key: str,
    digest: str,
    config: dict[str, Any],
    source: PolicySource,
    seed: int,
    cell: Sequence[int],
    *,
    cwd: str,
    paths: Sequence[str],
) -> list[EpisodeResult]:
    """Play the episodes of a cell in a process of the cluster.

    ``key``: that of the series. ``digest``: that of its policy, which its machine must have, too.
    ``cwd``: working directory of the evaluation, if the machine has it. ``paths``: its plugins.

    Raises:
        CheckpointError: the policy is missing or another one there.
    """
    global _runner
    if Path(cwd).is_dir():
        os.chdir(cwd)
    if _runner is None or _runner[0] != key:
        import torch

        torch.set_num_threads(1)
        plugins.load(paths)
        runner = EpisodeRunner(parse(EnvConfig, config), source, seed)
        require_unchanged(source, digest)
        _runner = key, runner
    return [_runner[1].play(index) for index in cell]
