"""Read what ``eval --output`` wrote for several methods and training seeds.

In: folders with ``episodes.csv``, or folders of such folders, one for each training seed. Out: the
methods with the episodes that all of them played.
"""

from __future__ import annotations

import csv
from collections.abc import Collection, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flipperctl.api import Outcome
from flipperctl.api.plugin import registered_names
from flipperctl.errors import RequestError
from flipperctl.evaluation.best_known import is_best_known
from flipperctl.evaluation.scores import Method
from flipperctl.evaluation.store import FOLDER, PlayedPolicy, played_policies
from flipperctl.messages import close_match

FILE = "episodes.csv"
_KEYS = ("scene", "controller", "conditions_hash", "seed", "outcome")

Episodes = Mapping[str, Mapping[str, tuple[float, bool]]]
"""Of one policy: measure and whether the finish was reached, by scene and the episode's seed."""


@dataclass(frozen=True)
class _Run:
    """The episodes of one policy of a folder."""

    episodes: Episodes
    digests: frozenset[str]
    """Digests of its weights or settings, by its cells; empty without these."""

    def is_of(self, other: _Run) -> bool:
        """Return whether another run is of the same policy; without cells, by its episodes."""
        if self.digests and other.digests:
            return not self.digests.isdisjoint(other.digests)
        return self.episodes == other.episodes

    def joined(self, other: _Run) -> _Run:
        """Return the episodes of both runs of the same policy."""
        scenes = dict.fromkeys([*self.episodes, *other.episodes])
        episodes = {s: {**self.episodes.get(s, {}), **other.episodes.get(s, {})} for s in scenes}
        return _Run(episodes, self.digests | other.digests)


@dataclass(frozen=True)
class Evaluated:
    """Methods on the episodes that all of their training seeds played."""

    methods: tuple[Method, ...]
    episodes: Mapping[str, int]
    """Number of shared episodes by scene."""
    notices: tuple[str, ...]
    """What was left out, in sentences."""


def read(words: Sequence[str], measure: str) -> Evaluated:
    """Read the methods of ``DIR`` or ``METHOD=DIR``; ``measure`` is the column of the score.

    A folder with ``episodes.csv`` is one training seed of a method, which has the name of its
    policy unless ``METHOD`` is given; a folder whose subfolders have such a file is one method with
    a training seed in each. Baselines are methods by their own name. A policy that was evaluated
    several times counts once, with the episodes of all its folders.

    Raises:
        RequestError: a folder has no results, a file is damaged or lacks the measure, or no episode
            was played by all.
    """
    runs: dict[str, list[_Run]] = {}
    rules: set[str] = set()
    notices: list[str] = []
    seen: set[Path] = set()
    rulers = registered_names("controller")  # they have no training seeds
    for word in words:
        name, folder = _named(word)
        folders = list(_folders(folder))
        if len(folders) > 1 or folders[0] != folder:
            name = name or folder.resolve().name
        for one in folders:
            if (place := one.resolve()) in seen:
                notices.append(f"{one} is named twice and counts once")
                continue
            seen.add(place)
            played = _played(one)
            for index, (label, episodes) in enumerate(_policies(one / FILE, measure).items()):
                run = _Run(episodes, frozenset(p.digest for p in played.get(label, ())))
                known = runs.setdefault((name if index == 0 else None) or label, [])
                same = [at for at, other in enumerate(known) if run.is_of(other)]
                is_rule = label in rulers or _untrained(label, played.get(label, ()))
                if index or is_rule:
                    rules.add(label)
                against = known if is_rule else [known[at] for at in same]
                if any(_contradict(episodes, other.episodes) for other in against):
                    raise RequestError(
                        f"{one}: {label} has other results there than in another folder, as with "
                        "other settings; METHOD=DIR gives each a name of its own"
                    )
                if not same:
                    known.append(run)
                    continue
                known[same[0]] = known[same[0]].joined(run)
                if index == 0:
                    notices.append(f"{one} has a policy of another folder, which counts once")
    return _shared(
        {method: [run.episodes for run in known] for method, known in runs.items()}, rules, notices
    )


def _played(folder: Path) -> dict[str, set[PlayedPolicy]]:
    """Return the policies whose cells lie beside the episodes of a folder, by label."""
    found: dict[str, set[PlayedPolicy]] = {}
    for (label, _), policies in played_policies(folder / FOLDER).items():
        found.setdefault(label, set()).update(policies)
    return found


def _untrained(label: str, played: Collection[PlayedPolicy]) -> bool:
    """Return whether cells are of a rule, perhaps one of a plugin; files have no seed either."""
    return bool(played) and not Path(label).suffix and all(p.training_seed is None for p in played)


def _contradict(one: Episodes, other: Episodes) -> bool:
    """Return whether two results of one policy differ on an episode that both played."""
    return any(
        other[scene].get(seed, result) != result
        for scene, played in one.items()
        if scene in other
        for seed, result in played.items()
    )


def _named(word: str) -> tuple[str | None, Path]:
    name, equals, path = word.partition("=")
    if not equals or Path(word).exists():
        return None, Path(word)
    if not name or not path:
        raise RequestError(f"{word}: METHOD=DIR or DIR is allowed")
    return name, Path(path)


def _folders(folder: Path) -> Iterator[Path]:
    if (folder / FILE).is_file():
        yield folder
        return
    inner = sorted(file.parent for file in folder.glob(f"*/{FILE}"))
    if not inner:
        raise RequestError(
            f"{folder}: there is no {FILE}, nor one in a folder below it; a folder of "
            "flipperctl eval --output is allowed"
        )
    yield from inner


def _policies(path: Path, measure: str) -> dict[str, Episodes]:
    """Return the episodes of each policy of a file, the evaluated one before its baselines."""
    found: dict[str, dict[str, dict[str, tuple[float, bool]]]] = {}
    try:
        with path.open(newline="") as file:
            reader = csv.DictReader(file)
            columns = reader.fieldnames or ()
            for key in (*_KEYS, measure):
                if key not in columns:
                    raise RequestError(
                        f"{path}: there is no column {key!r}{close_match(key, columns)}"
                    )
            for row in reader:
                if is_best_known(row["controller"]):
                    continue  # it stands only where it beats all others
                scene = f"{row['scene']} {row['conditions_hash']}"
                value = float(row[measure])
                if not np.isfinite(value):
                    raise ValueError(f"{measure} {row[measure]!r}")
                played = found.setdefault(row["controller"], {}).setdefault(scene, {})
                found_here = value, row["outcome"] == Outcome.REACHED
                if played.setdefault(row["seed"], found_here) != found_here:
                    raise RequestError(
                        f"{path}: {row['controller']} has several results on {scene}, seed "
                        f"{row['seed']}, as with several of its settings; a folder of "
                        "eval --output for each of them, named as in METHOD=DIR, is allowed"
                    )
    except (OSError, UnicodeDecodeError, csv.Error, ValueError, TypeError) as error:
        raise RequestError(f"{path}: cannot be read: {error}") from error
    if not found:
        raise RequestError(f"{path}: there is no episode in it")
    return dict(found)


def _shared(
    runs: Mapping[str, Sequence[Episodes]], rules: Container[str], notices: list[str]
) -> Evaluated:
    """Return the methods on the scenes and episodes that every run has.

    ``rules``: those with no training seed, which count once if these episodes are equal.
    """
    every = [run for known in runs.values() for run in known]
    shared: dict[str, list[str]] = {}
    for scene in dict.fromkeys(scene for run in every for scene in run):
        played = [set(run.get(scene, ())) for run in every]
        common = set.intersection(*played)
        if common:
            shared[scene] = [seed for seed in every[0][scene] if seed in common]
        if (most := max(map(len, played))) > len(common):
            notices.append(f"{scene}: {len(common)} of up to {most} episodes were played by all")
    if not shared:
        scenes = "; ".join(f"{name}: {', '.join(known[0])}" for name, known in runs.items())
        raise RequestError(f"no episode was played by all methods and seeds ({scenes})")
    names = _short(list(shared))
    methods = []
    for method, known in runs.items():
        reduced = [
            {names[scene]: [run[scene][seed] for seed in seeds] for scene, seeds in shared.items()}
            for run in known
        ]
        if method in rules:
            reduced = [one for at, one in enumerate(reduced) if one not in reduced[:at]]
        pairs = {name: [run[name] for run in reduced] for name in reduced[0]}
        values = {k: np.array([[v for v, _ in row] for row in rows]) for k, rows in pairs.items()}
        reached = {k: np.array([[r for _, r in row] for row in rows]) for k, rows in pairs.items()}
        methods.append(Method(method, values, reached))
    episodes = {names[scene]: len(seeds) for scene, seeds in shared.items()}
    return Evaluated(tuple(methods), episodes, tuple(notices))


def _short(scenes: Sequence[str]) -> dict[str, str]:
    """Return the name of each scene: its terrain, and the hash too if a terrain has several."""
    terrains = [scene.rpartition(" ")[0] for scene in scenes]
    return {
        scene: terrain if terrains.count(terrain) == 1 else scene
        for scene, terrain in zip(scenes, terrains, strict=True)
    }
