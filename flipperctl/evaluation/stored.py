"""Read what ``eval --output`` wrote for several methods and training seeds.

In: folders with ``episodes.csv``, or folders of such folders, one for each training seed. Out: the
methods with the episodes that all of them played.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Collection, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.api import Outcome
from flipperctl.api.plugin import registered_names
from flipperctl.errors import RequestError
from flipperctl.evaluation.plan import BEST_KNOWN
from flipperctl.evaluation.seeds import Method
from flipperctl.evaluation.store import FOLDER, PlayedPolicy, played_policies
from flipperctl.messages import close_match
from flipperctl.policies.identity import unlike_trainings

FILE, SUMMARY = "episodes.csv", "summary.json"
_KEYS = ("scene", "controller", "conditions_hash", "seed", "outcome")

Episodes = Mapping[str, Mapping[str, tuple[float, bool]]]
"""Of one policy: measure and whether the finish was reached, by scene and the episode's seed."""


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
                if row["controller"].startswith(f"{BEST_KNOWN} ("):
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


def _played(folder: Path) -> dict[str, set[PlayedPolicy]]:
    """Return the policies whose cells lie beside the episodes of a folder, by label."""
    found: dict[str, set[PlayedPolicy]] = {}
    for (label, _), policies in played_policies(folder / FOLDER).items():
        found.setdefault(label, set()).update(policies)
    return found


def _methods(folder: Path) -> dict[str, str]:
    """Return the method of each policy, by label, where one evaluation had several of its seeds."""
    try:
        scenes = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))["scenes"]
        labels: dict[str, set[str]] = {}
        for scene in scenes:
            if method := scene.get("method"):
                labels.setdefault(method, set()).add(scene["controller"])
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return {}  # the episodes alone are needed
    return {label: name for name, found in labels.items() if len(found) > 1 for label in found}


@dataclass(frozen=True)
class _Run:
    """The episodes of one policy of a folder."""

    folder: Path
    """The first of its folders."""
    episodes: Episodes
    digests: frozenset[str]
    """Digests of its weights or settings, by its cells; empty without these."""
    training_seed: int | None
    """Seed of its training, by its cells; None without these, or of a rule."""
    training: Mapping[str, Any] | None
    """Settings of its training, by its cells; None without these, or if they have none."""

    def is_of(self, other: _Run) -> bool:
        """Return whether another run is of the same policy; without cells, by its episodes."""
        if self.digests and other.digests:
            return not self.digests.isdisjoint(other.digests)
        return self.episodes == other.episodes

    def joined(self, other: _Run) -> _Run:
        """Return the episodes of both runs of the same policy."""
        scenes = dict.fromkeys([*self.episodes, *other.episodes])
        episodes = {s: {**self.episodes.get(s, {}), **other.episodes.get(s, {})} for s in scenes}
        return replace(self, episodes=episodes, digests=self.digests | other.digests)


@dataclass(frozen=True)
class Stored:
    """Methods on the episodes that all of their training seeds played."""

    methods: tuple[Method, ...]
    episodes: Mapping[str, int]
    """Number of shared episodes by scene."""
    notices: tuple[str, ...]
    """What was left out, in sentences."""


def read(words: Sequence[str], measure: str) -> Stored:
    """Read the methods of ``DIR`` or ``METHOD=DIR``; ``measure`` is the column of the score.

    A folder with ``episodes.csv`` is one training seed of a method, which has the name of its
    policy unless ``METHOD`` is given; a folder whose subfolders have such a file is one method with
    a training seed in each. An evaluation of a sweep has all the seeds of its methods. Baselines
    are methods by their own name. A policy that was evaluated several times counts once, with the
    episodes of all its folders.

    Raises:
        RequestError: a folder has no results, a file is damaged or lacks the measure, two results
            of a policy contradict each other, a rule stands among training seeds, or no episode
            was played by all.
    """
    reader, seen = _Reader(measure), set[Path]()
    for word in words:
        name, folder = _named(word)
        folders = list(_folders(folder))
        below = len(folders) > 1 or folders[0] != folder
        if below:
            name = name or folder.resolve().name
        for one in folders:
            if (place := one.resolve()) in seen:
                reader.notices.append(f"{one} is named twice and counts once")
                continue
            seen.add(place)
            reader.read(one, name, is_seed=below)
    reader.tell_equal_seeds()
    reader.tell_other_settings()
    return _shared(reader.runs, reader.rules, reader.untrained, reader.notices)


class _Reader:
    """The policies of the folders that were read so far."""

    def __init__(self, measure: str) -> None:
        self._measure = measure
        self._rulers = registered_names("controller")  # they have no training seeds
        self.runs: dict[str, list[_Run]] = {}
        """By method."""
        self.rules: set[str] = set()
        """Methods that count once if their episodes are equal."""
        self.untrained: set[str] = set()
        """Methods without a training."""
        self.notices: list[str] = []

    def read(self, folder: Path, name: str | None, *, is_seed: bool) -> None:
        """Add the policies of a folder; ``name`` is the method of its first one, if it has one.

        ``is_seed``: whether the folder is one of those of a method's training seeds.
        """
        played, methods = _played(folder), _methods(folder)
        policies = _policies(folder / FILE, self._measure)
        first = next(iter(policies))
        for label, episodes in policies.items():
            of_sweep = label in methods
            leads = label == first or (of_sweep and methods[label] == methods.get(first))
            method = name if name and leads else methods.get(label, label)
            is_rule = label in self._rulers or _untrained(label, played.get(label, ()))
            if is_seed and label == first:
                self._check_kind(method, label, folder, is_rule=is_rule)
            if is_rule:
                self.untrained.add(method)
            if is_rule or not (leads or of_sweep):
                self.rules.add(method)
            known = self.runs.setdefault(method, [])
            run = _run(folder, episodes, played.get(label, ()))
            same = [at for at, other in enumerate(known) if run.is_of(other)]
            against = known if is_rule else [known[at] for at in same]
            if any(_contradict(episodes, other.episodes) for other in against):
                raise RequestError(
                    f"{folder}: {label} has other results there than in another folder, as with "
                    "other settings; METHOD=DIR gives each a name of its own"
                )
            if not same:
                known.append(run)
                continue
            known[same[0]] = known[same[0]].joined(run)
            if leads:
                self.notices.append(f"{folder} has a policy of another folder, which counts once")

    def _check_kind(self, method: str, label: str, folder: Path, *, is_rule: bool) -> None:
        """Refuse a rule among the training seeds of a method."""
        if method in self.runs and is_rule != (method in self.untrained):
            rule = label if is_rule else "of another folder"
            raise RequestError(
                f"{folder}: {method} has a rule, {rule}, beside trained policies; a rule is no "
                "training seed"
            )

    def tell_equal_seeds(self) -> None:
        """Add a notice on each method with two policies of one training seed."""
        for method, known in self.runs.items():
            seeds = [run.training_seed for run in known if run.training_seed is not None]
            again = next((seed for seed in seeds if seeds.count(seed) > 1), None)
            if again is not None:
                self.notices.append(
                    f"{method}: {len(seeds)} policies, but training seed {again} counts "
                    f"{seeds.count(again)} times; trainings of one method differ in their seeds"
                )

    def tell_other_settings(self) -> None:
        """Add a notice on each method whose policies were trained with different settings."""
        for method, known in self.runs.items():
            if told := unlike_trainings(
                [run.training for run in known if run.training is not None]
            ):
                self.notices.append(f"{method}: {told}")


def _run(folder: Path, episodes: Episodes, played: Collection[PlayedPolicy]) -> _Run:
    seeds = {one.training_seed for one in played}
    digests = frozenset(one.digest for one in played)
    training = next((one.training for one in played if one.training is not None), None)
    return _Run(folder, episodes, digests, seeds.pop() if len(seeds) == 1 else None, training)


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


def _shared(
    found: Mapping[str, Sequence[_Run]],
    rules: Container[str],
    untrained: Container[str],
    notices: list[str],
) -> Stored:
    """Return the methods on the scenes and episodes that every run has.

    ``rules``: those that count once if these episodes are equal; ``untrained``: those without a
    training.
    """
    runs = {method: [run.episodes for run in known] for method, known in found.items()}
    every = [run for known in runs.values() for run in known]
    folders = [run.folder for known in found.values() for run in known]
    shared: dict[str, list[str]] = {}
    for scene in dict.fromkeys(scene for run in every for scene in run):
        played = [set(run.get(scene, ())) for run in every]
        common = set.intersection(*played)
        if common:
            shared[scene] = [seed for seed in every[0][scene] if seed in common]
        counts = list(map(len, played))
        if (most := max(counts)) > len(common):
            fewest = folders[counts.index(min(counts))]
            notices.append(
                f"{scene}: {len(common)} of up to {most} episodes were played by all; "
                f"{fewest} has {min(counts)}"
            )
    if not shared:
        raise RequestError(f"no episode was played by all methods and seeds: {_unlike(found)}")
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
        methods.append(Method(method, values, reached, trained=method not in untrained))
    episodes = {names[scene]: len(seeds) for scene, seeds in shared.items()}
    return Stored(tuple(methods), episodes, tuple(notices))


def _unlike(found: Mapping[str, Sequence[_Run]]) -> str:
    """Return in which folders others were played."""
    scenes: dict[str, dict[str, None]] = {}
    for run in (run for known in found.values() for run in known):
        scenes.setdefault(", ".join(run.episodes), {})[str(run.folder)] = None
    if len(scenes) == 1:
        return "their conditions are equal, but not their episodes, as with another --seed"
    each = "; ".join(f"{', '.join(folders)}: {names}" for names, folders in scenes.items())
    return f"{each}; the same terrain=… and conditions=… for all are allowed"


def _short(scenes: Sequence[str]) -> dict[str, str]:
    """Return the name of each scene: its terrain, and the hash too if a terrain has several."""
    terrains = [scene.rpartition(" ")[0] for scene in scenes]
    return {
        scene: terrain if terrains.count(terrain) == 1 else scene
        for scene, terrain in zip(scenes, terrains, strict=True)
    }
