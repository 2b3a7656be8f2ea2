"""Rows for the files in ``docs/results/`` from folders that ``flipperctl eval`` wrote.

Everything that ships, on the suites ``paper``, ``families`` and ``held_out``, with a folder of the
trainings of ``TRAININGS``, one sweep of training seeds each: for each suite a row for each method
and scene, and one for each method over all scenes. One policy on each scene of a suite, beside
rules (``cells``): a row for each scene and engine, with differences over the episodes that both
reached.
"""

from __future__ import annotations

import csv
import json
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from flipperctl.errors import RequestError
from flipperctl.evaluation.plan import is_best_known
from flipperctl.evaluation.seeds import PRICE, Method
from flipperctl.evaluation.statistics import interval
from flipperctl.evaluation.views.compare import difference, method_row

SUITES = ("paper", "families", "held_out")
_SEEDS = "seed=1,2,3 hydra.sweep.dir=runs/shipped"
TRAININGS: Mapping[str, str] = {
    "plain": f"flipperctl train -m terrain=all_kinds {_SEEDS}/plain",
    "precise": "flipperctl train -m experiment=precise terrain=all_kinds rewards=smooth "
    f"{_SEEDS}/precise",
    "searched": "flipperctl train -m experiment=mpc_value train.decisions=2500 "
    f"randomise.friction=null randomise.track_speed=null {_SEEDS}/searched",
}
"""Commands of the trainings: AT-D3QN as it is, with precise values, and with a search.

The results state the settings with which the trainings in the given folder were made.
"""
RULES = "okada,level"
"""Controllers that take milliseconds a decision; the policies above and the generalist do, too."""
SEARCHES = ("mpc", "planner")
"""Controllers that take seconds an episode, and so play fewer."""
AGAINST = "level"
"""The method whose score is subtracted in the rows over all scenes."""
_SCORE, _DECISIONS, _TIME = "pitch_variation_100hz", "pitch_variation", "t_cost"
_ROCKED = 5.0
"""θ̂_R above which a failed episode counts as one that rocked [rad]."""


@dataclass(frozen=True)
class Numbers:
    """How many episodes a scene has."""

    fast: int = 30
    """Of rules and learned policies; ``paper`` has its own numbers, 5 and 100."""
    slow: int = 5
    """Of ``SEARCHES``."""


def calls(runs: Path, output: Path, jobs: int, numbers: Numbers) -> Iterator[tuple[str, str]]:
    """Yield each suite and the words of a call of ``flipperctl``.

    Raises:
        RequestError: no training of ``TRAININGS`` lies in ``runs``.
    """
    trained = [name for name in TRAININGS if (runs / name).is_dir()]
    if not trained:
        known = "; ".join(TRAININGS.values())
        raise RequestError(f"{runs}: none of {', '.join(TRAININGS)} is a folder there; run {known}")
    policies = [*(str(runs / name) for name in trained), "generalist"]
    checkpoints = shlex.join(word for path in policies for word in ("--checkpoint", path))
    common = f"--baseline none --jobs {jobs} eval.cell=5"
    for suite in SUITES:
        few = "" if suite == "paper" else f" --episodes {numbers.fast}"
        folder = shlex.quote(str(output / suite))
        head = f"eval suite={suite} {common}"
        yield suite, f"{head} {checkpoints} --controller {RULES}{few} --output {folder}/fast"
        for name in SEARCHES:
            own = f"--controller {name} --episodes {numbers.slow}"
            yield suite, f"{head} {own} --output {folder}/{name}"


def play(
    run: Callable[[Sequence[str]], object], runs: Path, output: Path, jobs: int, numbers: Numbers
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Make all calls with ``run``; yield each suite with its results.

    What ``output`` holds already is not played again.
    """
    made: dict[str, list[str]] = {}
    for suite, words in calls(runs, output, jobs, numbers):
        made.setdefault(suite, []).append(words)
    for suite, found in made.items():
        for words in found:
            run(shlex.split(words))
        folders = [output / suite / name for name in ("fast", *SEARCHES)]
        yield suite, {"price": PRICE, "trainings": trainings(runs), **results(folders, runs)}


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


def results(folders: Sequence[Path], runs: Path) -> dict[str, Any]:
    """Return the rows of ``scenes`` and ``overview`` from folders of ``eval --output``.

    All policies in a folder below ``runs`` are training seeds of one method.
    """
    scenes = [scene for folder in folders for scene in _scenes(folder, runs)]
    methods = list(dict.fromkeys(scene.method for scene in scenes))
    whole = {name: _largest([s for s in scenes if s.method == name]) for name in methods}
    overview = [_overview(name, found, whole.get(AGAINST)) for name, found in whole.items()]
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

    ``passable`` counts the episodes that any method reached.
    """
    scenes, played = _read(folder)
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for scene in scenes:
        digest = scene["conditions"]["hash"]
        key = scene["suite_scene"], digest
        if key not in rows:  # each method has an entry
            methods = {who: lines for (who, hash_), lines in played.items() if hash_ == digest}
            rows[key] = {
                "scene": scene["suite_scene"],
                "terrain": scene["terrain"],
                "engine": scene["conditions"]["sim"]["name"],
                "hash": digest,
                **_compared({n: m for n, m in methods.items() if not is_best_known(n)}),
            }
    return list(rows.values())


def _compared(methods: Mapping[str, Mapping[int, Line]]) -> dict[str, Any]:
    swings = {
        name: {i: float(line[_SCORE]) for i, line in lines.items() if line["outcome"] == "reached"}
        for name, lines in methods.items()
    }
    policy, *others = swings
    ours = swings[policy]
    failed = [line for line in methods[policy].values() if line["outcome"] != "reached"]
    return {
        "episodes": len(methods[policy]),
        "passable": len(set().union(*swings.values())),
        "reached": {name: len(each) for name, each in swings.items()},
        "swing": {name: _interval(list(each.values())) for name, each in swings.items()},
        "difference": {
            other: _interval(
                [swing - swings[other][i] for i, swing in ours.items() if i in swings[other]]
            )
            for other in others
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
    ends = asdict(interval(values))
    return [None if (end := ends[n]) is None else round(end, 6) for n in ("mean", "low", "high")]


def _largest(scenes: Sequence[_Scene]) -> list[_Scene]:
    """Return a method's scenes, of equal conditions the one with the most episodes."""
    largest: dict[str, _Scene] = {}
    for scene in scenes:
        if scene.hash not in largest or scene.episodes > largest[scene.hash].episodes:
            largest[scene.hash] = scene
    return list(largest.values())


def _method(scenes: Sequence[_Scene], like: Sequence[_Scene] = ()) -> Method:
    """Return a method; with ``like`` only its first episodes, as many as those have."""
    sizes = {scene.hash: scene.episodes for scene in like}
    cut = {scene.hash: slice(sizes.get(scene.hash)) for scene in scenes}
    return Method(
        scenes[0].method,
        {scene.hash: scene.values[_SCORE][:, cut[scene.hash]] for scene in scenes},
        {scene.hash: scene.reached[:, cut[scene.hash]] for scene in scenes},
    )


def _overview(
    name: str, scenes: Sequence[_Scene], against: Sequence[_Scene] | None
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
        _SCORE: _rounded(found["reached_mean"]),
        "difference": None,
    }
    if against is not None and name != AGAINST:
        other, ours = _method(against, scenes), _method(scenes, against)
        row["difference"] = _ends(difference(ours, other, PRICE)["score"])
    return row


def _ends(found: Mapping[str, float | None]) -> list[float | None]:
    return [_rounded(found[end]) for end in ("mean", "low", "high")]


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.6g}")
