"""Evaluations whose results are kept in ``docs/results/`` and shown in tables of the documentation.

``python -m benchmarks.results NAME`` plays one of them anew and replaces its file; then
``python -m benchmarks.tables`` rewrites the tables. ``--jobs 2`` uses two processes. ``cells_…``
has one policy on each scene of a suite, beside rules: a row for each scene and engine, with
differences over the episodes that both reached. ``shipped`` plays everything that ships on the
suites ``paper``, ``families`` and ``held_out``, with the trainings in ``--runs``, one sweep of
training seeds each, and goes on where an earlier call ended: for each suite a row for each method
and scene, and one for each method over all scenes.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks import tables
from flipperctl import __version__
from flipperctl.cli.main import main as flipperctl
from flipperctl.errors import FlipperctlError, RequestError
from flipperctl.evaluation.plan import is_best_known
from flipperctl.evaluation.seeds import PRICE, SeedSamples
from flipperctl.evaluation.statistics import interval
from flipperctl.process import entry
from flipperctl.text.files import write_bytes
from flipperctl.views.card import rows_of
from flipperctl.views.compare import difference, method_row

_NOISE = "perception.noise=0.01 perception.angle_noise=0.01 episode.start_angle_noise=0.05"
_TEN = "step,stair,building_stair,ramp,uplift,gap,wave,rubble,pallet,plum"
_PASSABLE = "--passable generalist,okada,level,planner"
COMMANDS: Mapping[str, str] = {
    "generalist": "flipperctl eval generalist --episodes 50 --seed 61170 "
    f"--baseline okada,level,random conditions=wide terrain={_TEN} {_PASSABLE}",
    "paper_scenes": "flipperctl eval generalist --episodes 50 "
    f"--baseline okada,level,random terrain=paper_step,paper_stair {_NOISE}",
    "cells_planar": "flipperctl eval generalist suite=generalist sim=planar "
    f"--episodes 30 --seed 61171 --baseline okada,level {_PASSABLE}",
    "cells_mujoco": "flipperctl eval generalist suite=generalist sim=mujoco "
    f"--episodes 30 --seed 61172 --baseline okada,level {_PASSABLE}",
    "cells_3d": "flipperctl eval generalist suite=generalist_3d "
    f"--episodes 30 --seed 61173 --baseline okada,level {_PASSABLE}",
}
"""The command of each file; those whose names begin with ``cells_`` are of a suite's scenes."""
SHIPPED = "shipped"
"""Name of the results of everything that ships, with a file for each suite."""
NAMES = (*COMMANDS, SHIPPED)
"""What can be played."""


SUITES = ("paper", "families", "held_out")
_SEEDS = "seed=1,2,3 hydra.sweep.dir=runs/shipped"
TRAININGS: Mapping[str, str] = {
    "plain": f"flipperctl train -m experiment=paper terrain=all_kinds {_SEEDS}/plain",
    "precise": f"flipperctl train -m terrain=all_kinds train.decisions=60000 {_SEEDS}/precise",
    "searched": "flipperctl train -m experiment=mpc_value train.decisions=2500 "
    f"randomise.sim.friction=null randomise.robot.track_speed=null {_SEEDS}/searched",
}
"""Commands of the trainings: AT-D3QN as it is, with precise values, and with a search.

The results state the settings with which the trainings in the given folder were made.
"""
RULES = "okada,level"
"""Controllers that take milliseconds a decision; the policies above and the generalist do, too."""
SEARCHES = ("mpc", "planner")
"""Controllers that take seconds an episode, and so play fewer."""
FAST, SLOW = 30, 5
"""Episodes a scene: of rules and learned policies, where ``paper`` has its own numbers, 5 and 100;
and of ``SEARCHES``."""
AGAINST = "level"
"""The method whose score is subtracted in the rows over all scenes."""
_SCORE, _DECISIONS, _TIME = "pitch_variation_100hz", "pitch_variation_decisions", "t_cost"
_ENERGY = "flipper_energy"
_ROCKED = 5.0
"""θ̂_R above which a failed episode counts as one that rocked [rad]."""


def play(name: str, output: Path, jobs: int) -> None:
    """Run the command of a file and keep its results.

    ``output``: folder for the episodes of a suite, which goes on where an earlier call ended.
    """
    words = [*shlex.split(COMMANDS[name])[1:], "--jobs", str(jobs)]
    if name.startswith(tables.CELLS):
        _run([*words, "--output", str(output / name)])
        rows = cells(output / name)
    else:
        rows = list(rows_of(json.loads(_run([*words, "--json"]))))
    _keep(name, {"command": COMMANDS[name], "version": __version__}, {"rows": rows})


def play_shipped(runs: Path, output: Path, jobs: int, fast: int, slow: int) -> None:
    """Play everything that ships and keep a file of results for each suite."""
    command = f"python -m benchmarks.results {SHIPPED} --fast {fast} --slow {slow}"
    trained = [name for name in TRAININGS if (runs / name).is_dir()]
    if not trained:
        known = "; ".join(TRAININGS.values())
        raise RequestError(f"{runs}: none of {', '.join(TRAININGS)} is a folder there; run {known}")
    policies = [*(str(runs / name) for name in trained), "generalist"]
    checkpoints = [word for path in policies for word in ("--checkpoint", path)]
    for suite in SUITES:
        head = ["eval", f"suite={suite}", "--baseline", "none", "--jobs", str(jobs), "eval.cell=5"]
        few = [] if suite == "paper" else ["--episodes", str(fast)]
        calls = {"fast": [*checkpoints, "--controller", RULES, *few]}
        calls |= {name: ["--controller", name, "--episodes", str(slow)] for name in SEARCHES}
        for name, words in calls.items():
            _run([*head, *words, "--output", str(output / suite / name)])
        found = shipped_rows([output / suite / name for name in calls], runs)
        rows = {"trainings": trainings(runs), **found}
        about = {"command": command, "version": __version__, "price": PRICE}
        _keep(f"{SHIPPED}_{suite}", about, rows)


def _run(words: Sequence[str]) -> str:
    """Run a command of flipperctl and return what it printed."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        try:
            flipperctl(list(words))
        except SystemExit as ended:
            if ended.code:
                text = f"flipperctl {shlex.join(words)}: exit code {ended.code}"
                raise FlipperctlError(text) from ended
    return out.getvalue()


def _keep(name: str, head: Mapping[str, Any], rows: Mapping[str, list[dict[str, Any]]]) -> None:
    """Write a file of results with a row on each line, for readable changes."""
    tables.FOLDER.mkdir(exist_ok=True)
    parts = [json.dumps(head)[1:-1]]
    for key, each in rows.items():
        lines = ",\n".join(json.dumps(row) for row in each)
        parts.append(f'"{key}": [\n{lines}\n]')
    write_bytes(tables.FOLDER / f"{name}.json", f"{{{', '.join(parts)}}}\n".encode())


def trainings(runs: Path) -> list[dict[str, str]]:
    """Return the overrides of each training in ``runs``, with those of several seeds together."""
    found: dict[tuple[str, str], list[str]] = {}
    for name in TRAININGS:
        for file in sorted((runs / name).glob("*/.hydra/overrides.yaml")):
            words = [str(word) for word in yaml.safe_load(file.read_text(encoding="utf-8"))]
            seeds = [word.removeprefix("seed=") for word in words if word.startswith("seed=")]
            rest = shlex.join(word for word in words if not word.startswith("seed="))
            found.setdefault((name, rest), []).extend(seeds)
    return [
        {"method": name, "overrides": f"{rest} seed={','.join(seeds)}".strip()}
        for (name, rest), seeds in found.items()
    ]


def shipped_rows(folders: Sequence[Path], runs: Path) -> dict[str, list[dict[str, Any]]]:
    """Return the rows ``overview`` and ``scenes`` from folders of ``eval --output``.

    All policies in a folder below ``runs`` are training seeds of one method.
    """
    scenes = [scene for folder in folders for scene in _scenes(folder, runs)]
    methods = list(dict.fromkeys(scene.method for scene in scenes))
    whole: dict[str, list[_Scene]] = {}
    for name in methods:  # of equal conditions the scene with the most episodes
        largest: dict[str, _Scene] = {}
        for scene in scenes:
            known = largest.get(scene.hash)
            if scene.method == name and (known is None or scene.episodes > known.episodes):
                largest[scene.hash] = scene
        whole[name] = list(largest.values())
    against = whole.get(AGAINST)
    overview = [_overview(name, found, against) for name, found in whole.items()]
    return {"overview": overview, "scenes": [scene.row() for scene in scenes]}


@dataclass(frozen=True)
class _Scene:
    """The episodes of one method on one scene, (S, E) by measure, for S training seeds."""

    case: str
    terrain: str
    hash: str
    engine: str
    method: str
    reached: np.ndarray[tuple[int, int], np.dtype[np.bool_]]
    values: Mapping[str, np.ndarray[tuple[int, int], np.dtype[np.float64]]]

    @property
    def episodes(self) -> int:
        """Number of episodes of a training seed."""
        return int(self.reached.shape[1])

    def row(self) -> dict[str, Any]:
        """Return plain data; means are over the episodes that were reached."""
        scores = method_row(_method([self]), PRICE)
        reached = {name: self.values[name][self.reached] for name in (_SCORE, _DECISIONS, _TIME)}
        return {
            **{name: getattr(self, name) for name in ("case", "terrain", "hash", "engine")},
            "method": self.method,
            "seeds": len(self.reached),
            "episodes": self.episodes,
            "success": _ends(scores["success"]),
            "score": _ends(scores["score"]),
            **{n: _rounded(float(v.mean()) if v.size else None) for n, v in reached.items()},
        }


Line = Mapping[str, str]
"""A line of ``episodes.csv``."""


def _read(folder: Path) -> tuple[list[dict[str, Any]], dict[tuple[str, str], dict[int, Line]]]:
    """Return a folder's scenes, and the lines of controller and conditions by episode."""
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    played: dict[tuple[str, str], dict[int, Line]] = {}
    with (folder / "episodes.csv").open(newline="", encoding="utf-8") as file:
        for line in csv.DictReader(file):
            key = line["controller"], line["conditions_hash"]
            played.setdefault(key, {})[int(line["episode"])] = line
    return summary["scenes"], played


def _name(method: str, runs: Path) -> str:
    """Return the folder below ``runs`` in which the policies of a method lie, or its last name."""
    path = Path(method)
    inside = [place.name for place in (path, *path.parents) if place.parent == runs]
    return inside[0] if inside else path.name


def _scenes(folder: Path, runs: Path) -> Iterator[_Scene]:
    """Yield the scenes of a folder, without those that repeat the episodes of another one."""
    scenes, played = _read(folder)
    groups: dict[tuple[str, str, int, str], list[dict[str, Any]]] = {}
    for scene in scenes:
        name = _name(scene["method"], runs)
        key = scene["suite_scene"], scene["conditions"]["hash"], scene["episodes"], name
        groups.setdefault(key, []).append(scene)
    seen: set[tuple[str, int, str]] = set()
    for (case, digest, count, method), seeds in groups.items():
        if (digest, count, method) in seen:
            continue
        seen.add((digest, count, method))
        each = [[played[one["controller"], digest][i] for i in range(count)] for one in seeds]
        yield _Scene(
            case,
            seeds[0]["terrain"],
            digest,
            seeds[0]["conditions"]["sim"]["name"],
            method,
            np.array([[line["outcome"] == "reached" for line in one] for one in each]),
            {
                name: np.array([[float(line[name]) for line in one] for one in each])
                for name in (_SCORE, _DECISIONS, _TIME)
            },
        )


def cells(folder: Path) -> list[dict[str, Any]]:
    """Return a row for each scene and engine; the first method of the call is the policy.

    ``passable`` counts the episodes that a method reached, or a reference of ``--passable``.
    """
    scenes, played = _read(folder)
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for scene in scenes:
        digest = scene["conditions"]["hash"]
        key = scene["suite_scene"], digest
        if key not in rows:  # each method has an entry
            methods = {
                who: lines
                for (who, conditions), lines in played.items()
                if conditions == digest and not is_best_known(who)
            }
            rows[key] = {
                "scene": scene["suite_scene"],
                "terrain": scene["terrain"],
                "engine": scene["conditions"]["sim"]["name"],
                "hash": digest,
                **_compared(methods),
            }
    return list(rows.values())


def _compared(methods: Mapping[str, Mapping[int, Line]]) -> dict[str, Any]:
    good = {
        name: {i: line for i, line in lines.items() if line["outcome"] == "reached"}
        for name, lines in methods.items()
    }
    swings = {name: {i: float(r[_SCORE]) for i, r in rows.items()} for name, rows in good.items()}
    policy, *others = swings
    crossed = (i for i, line in methods[policy].items() if line.get("crossed_by"))
    ours = swings[policy]
    failed = [line for line in methods[policy].values() if line["outcome"] != "reached"]
    return {
        "episodes": len(methods[policy]),
        "passable": len(set(crossed).union(*swings.values())),
        "reached": {name: len(each) for name, each in swings.items()},
        "swing": {name: _interval(list(each.values())) for name, each in swings.items()},
        "difference": {
            other: _interval(
                [swing - swings[other][i] for i, swing in ours.items() if i in swings[other]]
            )
            for other in others
        },
        "energy": {
            name: _interval([float(line[_ENERGY]) for line in rows.values()])
            for name, rows in good.items()
        },
        "rocked": sum(float(line[_SCORE]) > _ROCKED for line in failed),
        "overturned": {
            name: sum(line["outcome"] == "overturned" for line in lines.values())
            for name, lines in methods.items()
        },
    }


def _interval(values: Sequence[float]) -> list[float | None] | None:
    if not values:
        return None
    found = interval(values)
    ends = found.mean, found.low, found.high
    return [None if end is None else round(end, 6) for end in ends]


def _method(scenes: Sequence[_Scene], like: Sequence[_Scene] = ()) -> SeedSamples:
    """Return a method; with ``like`` only its first episodes, as many as those have."""
    sizes = {scene.hash: scene.episodes for scene in like}
    cut = {scene.hash: slice(sizes.get(scene.hash)) for scene in scenes}
    return SeedSamples(
        scenes[0].method,
        {scene.hash: scene.values[_SCORE][:, cut[scene.hash]] for scene in scenes},
        {scene.hash: scene.reached[:, cut[scene.hash]] for scene in scenes},
    )


def _overview(
    name: str,
    scenes: Sequence[_Scene],
    against: Sequence[_Scene] | None,
) -> dict[str, Any]:
    """Return the row of a method over all scenes, with its difference on common episodes."""
    found = method_row(_method(scenes), PRICE)
    row: dict[str, Any] = {
        "method": name,
        "seeds": found["seeds"],
        "scenes": len(scenes),
        "episodes": sorted({scene.episodes for scene in scenes}),
        "success": _ends(found["success"]),
        "score": _ends(found["score"]),
        "iqm": _ends(found["iqm"]),
        _SCORE: _rounded(_reached_mean(scenes)),
        "difference": None,
    }
    if against is not None and name != AGAINST:
        other, ours = _method(against, scenes), _method(scenes, against)
        row["difference"] = _ends(difference(ours, other, PRICE)["score"])
    return row


def _reached_mean(scenes: Sequence[_Scene]) -> float | None:
    """Return the mean over all episodes that a seed reached."""
    values = np.concatenate([scene.values[_SCORE][scene.reached] for scene in scenes])
    return float(values.mean()) if values.size else None


def _ends(found: Mapping[str, float | None]) -> list[float | None]:
    return [_rounded(found[end]) for end in ("mean", "low", "high")]


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.6g}")


def main() -> int:
    """Play the named evaluations; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.results", description=__doc__)
    parser.add_argument("names", nargs="+", choices=NAMES, metavar="NAME", help=", ".join(NAMES))
    for option, kind, default, text in (
        ("--jobs", int, 1, "processes"),
        ("--runs", Path, Path("runs/shipped"), f"{SHIPPED}: folder of the trainings"),
        ("--output", Path, Path("judged"), f"{SHIPPED}, {tables.CELLS}…: folder of the episodes"),
        ("--fast", int, FAST, f"{SHIPPED}: episodes a scene of rules and learned policies"),
        ("--slow", int, SLOW, f"{SHIPPED}: episodes a scene of mpc and planner"),
    ):
        parser.add_argument(option, type=kind, default=default, help=f"{text} [{default}]")
    asked = parser.parse_args()
    for name in asked.names:
        if name == SHIPPED:
            play_shipped(asked.runs, asked.output, asked.jobs, asked.fast, asked.slow)
        else:
            play(name, asked.output, asked.jobs)
    return 0


if __name__ == "__main__":
    entry.run(main)
