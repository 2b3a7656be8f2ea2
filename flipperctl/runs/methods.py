"""The methods of one evaluation: controllers, and policies that differ in their training seeds.

In: names of controllers, and runs, files or folders of sweeps. Out: methods in the order in which
they were given, each with its policies.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flipperctl import checkpoint as checkpoints
from flipperctl.api import registry
from flipperctl.api.plugin import registered_names
from flipperctl.config import resolver
from flipperctl.config.words import check_different
from flipperctl.errors import ConfigError, FlipperctlError, RequestError
from flipperctl.messages import missing_name
from flipperctl.policies.exported import ExportedPolicy, is_exported
from flipperctl.policies.identity import method_settings, without_sources
from flipperctl.results import unfinished
from flipperctl.runs.named_policies import refuse_file

STANDING = ("level", "okada")
"""Controllers that stand in a table of several methods unless others are named."""


@dataclass(frozen=True)
class Entrant:
    """A policy of an evaluation of several."""

    method: str
    """Name of the method; policies of equal methods differ in their training seeds."""
    run: Path | None = None
    """A run, a file or a shipped policy; None for a controller."""
    training_seed: int | None = None
    """Seed of the training; None for a controller."""


def entrants(names: Sequence[str], tell: Callable[[str], None]) -> list[Entrant]:
    """Return the policies of all methods, each once.

    A name is that of a controller or a shipped policy, or the path of a run, a checkpoint or an
    exported file; names of controllers may be joined by commas. A folder with the runs of a sweep
    stands for them all: for one method, if they differ in their seeds alone. ``tell`` is called
    with a line for each run that has no checkpoint, repeats another one, or is not finished.

    Raises:
        RequestError: a name is empty, or a folder has no run with a checkpoint.
        ConfigError: there is no such policy.
        CheckpointError: a checkpoint is missing or damaged.
    """
    found: dict[Entrant, None] = {}
    for name in (part for text in names for part in _split(text)):
        if ("controller", name) in registry and not _exists(name):
            found[Entrant(name)] = None
        else:
            found |= dict.fromkeys(_of_path(find_path(name), tell))
    return list(found)


def _split(text: str) -> list[str]:
    """Return the names that commas join; a path may have commas of its own."""
    if _exists(text) or "," not in text:
        return [text]
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise RequestError(f"names between commas are allowed, as in okada,level; got {text!r}")
    return names


def find_path(name: str) -> Path:
    """Return the path of a policy's run or file, or the name of a shipped policy.

    Raises:
        ConfigError: there is no policy of this name.
        CheckpointError: it can only be a path, and nothing is there.
    """
    path = Path(name)
    if _exists(name) or name in checkpoints.shipped_policies():
        return path
    if path.suffix or len(path.parts) > 1:
        checkpoints.find(path)  # raises the error that names a close match
    known = [*checkpoints.shipped_policies(), *registered_names("controller")]
    hint = missing_name("controller", name, known)
    raise ConfigError(
        f"there is no run, file, shipped policy or controller {name!r}{hint}; "
        f"shipped policies and controllers: {', '.join(sorted(known))}"
    )


def split_policies(words: Sequence[str] | None) -> tuple[list[str], list[str]]:
    """Return the policies among the words of a command, and the overrides."""
    policies: list[str] = []
    overrides: list[str] = []
    for word in words or ():
        plain = "=" not in word and not word.startswith(("~", "+"))
        (policies if plain or _exists(word) else overrides).append(word)
    return policies, overrides


def _exists(name: str) -> bool:
    return os.path.exists(name)  # noqa: PTH110  # false for any text, however long


def standing(baseline: str | None, present: Sequence[Entrant]) -> list[Entrant]:
    """Return the controllers that stand beside the methods; ``baseline`` names others, or none.

    Raises:
        RequestError: a name is empty, or that of a file.
        ConfigError: there is no such controller.
    """
    if baseline == "none":
        return []
    names = [n.strip() for n in (STANDING if baseline is None else baseline.split(","))]
    if not all(names):
        text = f"names between commas, or none, are allowed; got {baseline!r}"
        raise RequestError(f"--baseline: {text}")
    check_different("--baseline", names)
    for name in names:
        refuse_file(name, "--baseline")
        resolver.get("controller", name, "--baseline")
    return [e for e in map(Entrant, names) if e not in present]


def runs_below(folder: Path) -> list[Path]:
    """Return the runs in a folder of a sweep; none for a run, a file or any other folder."""
    if not folder.is_dir() or checkpoints.holds(folder):
        return []
    if not checkpoints.runs_in(folder):
        return []
    return sorted((f for f in folder.iterdir() if f.is_dir()), key=checkpoints.job_order)


def _of_path(path: Path, tell: Callable[[str], None]) -> Iterator[Entrant]:
    runs = runs_below(path)
    if not runs:
        file = checkpoints.find(path)
        yield Entrant(str(path), path, _trained(file)[0])
        return
    trained: list[tuple[Path, int | None, dict[str, Any]]] = []
    for run in runs:
        if not (run / "config.yaml").exists() and not checkpoints.holds(run):
            continue  # no run at all
        try:
            seed, settings = _trained(checkpoints.find(run))
        except FlipperctlError as error:
            tell(f"{run} is left out: {error}")
            continue
        equal = [other for other, *theirs in trained if theirs == [seed, settings]]
        if equal:
            tell(f"{run} is left out: {equal[0]} has its seed and what it learns by")
            continue
        if unfinished(run):
            tell(f"{run} is not trained to its end; it counts like the others")
        trained.append((run, seed, settings))
    groups = _grouped(trained)
    if not groups:
        raise RequestError(f"{path}: no run of this sweep has a checkpoint that can be read")
    swept = [_swept(members[0][0]) for members in groups]
    for members, values in zip(groups, swept, strict=True):
        telling = values and swept.count(values) == 1
        name = f"{path}/{values}" if telling else str(members[0][0])
        for run, seed in members:
            yield Entrant(str(path) if len(groups) == 1 else name, run, seed)


def _grouped(
    trained: Sequence[tuple[Path, int | None, dict[str, Any]]],
) -> list[list[tuple[Path, int | None]]]:
    """Return the runs of each method, and their seeds.

    Seeds that each went on from a run of their own are one method; runs of one seed that went on
    from several runs are several.
    """
    groups: dict[str, list[tuple[Path, int | None]]] = {}
    alike = [repr(without_sources(settings)) for _, _, settings in trained]
    seeds = [(key, seed) for key, (_, seed, _) in zip(alike, trained, strict=True)]
    for key, (run, seed, settings) in zip(alike, trained, strict=True):
        swept = any(seeds.count((key, other)) > 1 for other in {s for k, s in seeds if k == key})
        groups.setdefault(repr(settings) if swept else key, []).append((run, seed))
    return list(groups.values())


def _swept(run: Path) -> str:
    """Return the swept values in the name of a run but for its seed, as in ``network=conv``."""
    values: list[str] = []
    for part in run.name.partition("_")[2].split(","):
        if "=" in part or not values:
            values.append(part)
        else:  # of a list, as in network.hidden=_64,32_
            values[-1] += f",{part}"
    return ",".join(one for one in values if "=" in one and not one.startswith("seed="))


def _trained(file: Path) -> tuple[int | None, dict[str, Any]]:
    """Return the seed of a training, and the settings that name its method."""
    if is_exported(file):
        return ExportedPolicy(file).interface.seed, {"file": str(file)}
    config = checkpoints.read_policy(file).policy_config()
    return config.seed, method_settings(config)
