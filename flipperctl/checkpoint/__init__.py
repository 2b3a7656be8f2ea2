"""Checkpoint files: safetensors files that describe themselves and never execute code.

A file holds tensors and one JSON document, sealed by a checksum (see ``document``).
"""

from __future__ import annotations

import contextlib
import difflib
import json
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from flipperctl import __version__
from flipperctl.api import Plugin, registry
from flipperctl.checkpoint import document as documents
from flipperctl.checkpoint import former, hub
from flipperctl.checkpoint.document import Document, PluginReference, State, serialize
from flipperctl.config import TrainConfig, parse, resolver, to_dict
from flipperctl.config.models import with_stand_ins
from flipperctl.core.targets import actions_of
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.plugging import plugins
from flipperctl.sim.versions import engine_versions
from flipperctl.text.files import at_home, write_bytes
from flipperctl.text.messages import close_match, missing_name, missing_plugin, suggestion

if TYPE_CHECKING:
    import torch

PLUGINS = Path("plugins")
"""Folder of a run with copies of its plugin files, and their SHA-256 in ``SHA256SUMS``."""
TRUST = "FLIPPERCTL_TRUST"
"""Environment variable: folders below which runs load their copies of plugin files unasked."""
BEST, LAST = Path("checkpoints/best.safetensors"), Path("checkpoints/last.safetensors")
KEPT = "checkpoints/at_{}.safetensors"
"""The policy of a validation after so many decisions, of a run with ``train.keep_policies``."""

_REPLACED = frozenset(("terrain", "reward", "controller", "logger", "agent"))
"""Kinds of plugins without which a policy can drive."""


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint that was read and checked."""

    path: Path
    document: Document
    tensors: dict[str, torch.Tensor]
    """Tensors by name; the name up to the first dot is a part of the checkpoint."""
    _configs: dict[Collection[object], TrainConfig] = field(
        default_factory=dict, compare=False, repr=False
    )
    """Results of ``policy_config``, by the plugins that were registered then."""

    def config(self) -> TrainConfig:
        """Return the full training configuration."""
        self._load_trusted()
        self._require_plugins()
        return self._parse(self.document.config.model_dump(mode="json"))

    def policy_config(self, *, on_its_terrain: bool = False) -> TrainConfig:
        """Return the training configuration as far as the policy needs it.

        Stand-ins replace a terrain, reward terms and a learner whose plugins are missing; a teacher
        and loggers whose plugins are missing are left out. A policy with a risk needs the learner,
        which states how the risk is used. ``on_its_terrain``: the terrain is needed, too.
        """
        self._load_trusted()
        needed = {kind for kind in ("terrain",) if on_its_terrain}
        needed |= {kind for kind in ("agent",) if self.part("risk")}
        # Plugins that were loaded in between change the result: remember it by what is registered.
        known = frozenset(registry.items()) | needed
        if known not in self._configs:
            self._require_plugins(optional=_REPLACED - needed)
            files = {(p.kind, p.name): self._file(p.file) for p in self.document.plugins if p.file}
            settings = self.document.config.model_dump(mode="json")
            self._configs[known] = self._parse(with_stand_ins(settings, files))
        return self._configs[known]

    def _require_plugins(self, optional: Collection[str] = ()) -> None:
        """Check that all plugins are available, except for the ``optional`` kinds."""
        for plugin in self.document.plugins:
            if plugin.kind not in optional and (plugin.kind, plugin.name) not in registry:
                file = self._file(plugin.file) if plugin.file else None
                text = missing_plugin(plugin.kind, plugin.name, file)
                raise CheckpointError(f"{self.path}: {text}")

    def _file(self, name: str) -> str | Path:
        """Return the path of the run's own copy of a plugin file; its name if there is none."""
        copies = sorted((self.path.parent.parent / PLUGINS).rglob(name))
        return copies[0] if copies else name

    def _load_trusted(self) -> None:
        """Load the run's copies of missing plugins, if it lies in a folder that is trusted."""
        trusted = filter(None, at_home(os.environ.get(TRUST, "")).split(os.pathsep))
        if not any(self.path.resolve().is_relative_to(Path(f).resolve()) for f in trusted):
            return
        # Only what is missing is loaded; a plugin that is registered already stays.
        missing = [p.file for p in self.document.plugins if (p.kind, p.name) not in registry]
        copies = {file for name in missing if name and isinstance(file := self._file(name), Path)}
        if copies:
            plugins.load(sorted(copies))

    def _parse(self, settings: Mapping[str, Any]) -> TrainConfig:
        try:
            return parse(TrainConfig, former.current(settings))
        except ConfigError as error:
            raise CheckpointError(
                f"{self.path}: its configuration is not valid: {error}"
            ) from error

    def part(self, prefix: str) -> dict[str, torch.Tensor]:
        """Return the tensors whose names begin with ``prefix.``, without that prefix."""
        start = f"{prefix}."
        named = self.tensors.items()
        return {name.removeprefix(start): t for name, t in named if name.startswith(start)}

    @property
    def content(self) -> str:
        """SHA-256 of configuration, results, state and tensors.

        Versions, plugins and loggers, which do not change a training, are left out.
        """
        plain = self.document.plain()
        plain["config"] = {k: v for k, v in plain["config"].items() if k != "logger"}
        content = {k: v for k, v in plain.items() if k not in ("format", "versions", "plugins")}
        return documents.digest(json.dumps(content, sort_keys=True), self.tensors)

    def to_dict(self) -> dict[str, Any]:
        """Return the contents as plain data, with the run's state but without its generators."""
        document = self.document.plain()
        for hidden in ("generators", "recent"):
            document.get("state", {}).pop(hidden, None)
        prefixes = dict.fromkeys(name.partition(".")[0] for name in self.tensors)
        return {
            "path": str(self.path),
            "bytes": self.path.stat().st_size,
            "content_sha256": self.content,
            "numbers": {p: sum(t.numel() for t in self.part(p).values()) for p in prefixes},
            **document,
        }


def describe(
    config: TrainConfig,
    kind: Literal["best", "last"],
    *,
    decision: int | None = None,
    validation: Mapping[str, Any] | None = None,
    state: State | None = None,
) -> Document:
    """Return the document of a checkpoint; ``Document`` defines which fields each kind has."""
    import gymnasium
    import numpy as np
    import torch

    return Document(
        format=documents.FORMAT,
        kind=kind,
        config=documents.PartialConfig.model_validate(to_dict(config)),
        # Engines and learners name the libraries that their results depend on.
        versions={
            "flipperctl": __version__,
            "torch": torch.__version__,
            "numpy": np.__version__,
            "gymnasium": gymnasium.__version__,
            **engine_versions(config.sim),
            **{name: version(name) for name in config.agent.packages},
        },
        plugins=plugin_references(config),
        actions=documents.Actions(
            joints=config.robot.joints,
            steps=actions_of(len(config.robot.joints)) if config.actions == "turns" else (),
        ),
        decision=decision,
        validation=None if validation is None else documents.Validation(**validation),
        state=state,
    )


def plugged(config: TrainConfig) -> list[Plugin]:
    """Return the plugins of a configuration, without plugins nested in their settings."""
    parts = [config.terrain, config.network, config.agent, config.sim, config.perception]
    named = [*config.rewards.values(), *config.logger.values()]
    teacher = config.teacher.controller
    return [*parts, *named, *([] if teacher is None else [teacher])]


def plugin_references(config: TrainConfig) -> tuple[PluginReference, ...]:
    """Return references to the plugins that a configuration uses, nested ones included.

    Each has the name of its file, unless the plugin is installed.
    """
    return tuple(
        PluginReference(
            kind=part.kind,
            name=part.plugin_name,
            module=type(part).__module__,
            file=plugins.file_name(type(part)),
        )
        for plugin in plugged(config)
        for part in resolver.nested_plugins(plugin)
    )


def join(parts: Mapping[str, Mapping[str, torch.Tensor]]) -> dict[str, torch.Tensor]:
    """Return the tensors of all parts, named ``part.name``."""
    return {f"{part}.{name}": t for part, state in parts.items() for name, t in state.items()}


def write(path: Path, document: Document, tensors: Mapping[str, torch.Tensor]) -> None:
    """Write a checkpoint, completely or not at all."""
    write_bytes(path, serialize(document.text(), tensors))


def read(path: Path) -> Checkpoint:
    """Read and check a checkpoint; nothing in the file is executed."""
    text, tensors = documents.read(path, "checkpoint")
    with documents.naming_document(path):
        document = documents.parse(text)
        _check_names(document, tensors)
    return Checkpoint(path, document, tensors)


_SMALL = 2**23
"""Largest file that ``read_policy`` remembers [bytes]."""


def read_policy(path: Path) -> Checkpoint:
    """Return what ``read`` does, and the same object again while a small file is unchanged.

    An evaluation asks for one file several times for each scene. The tensors must not be changed.
    """
    try:
        status = path.stat()
    except OSError:
        return read(path)  # which says why
    if status.st_size > _SMALL:
        return read(path)
    # Inode, time and size tell a replaced file from the one that was read.
    return _read_once(path.absolute(), path, status.st_ino, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=4)
def _read_once(place: Path, path: Path, *stamp: int) -> Checkpoint:
    """Read a file; its absolute ``place`` and its ``stamp`` tell it from others."""
    return read(path)


def _check_names(document: Document, tensors: Mapping[str, torch.Tensor]) -> None:
    """Check that every tensor belongs to a part that a checkpoint of this kind has."""
    parts = {"policy", "risk"}
    if state := document.state:
        if not state.parts:  # of a run before learners were plugins
            return
        # Outstanding requests hold the weights with which their episodes are played.
        parts = {*state.parts, *(f"weights{request.version}" for request in state.orders)}
    for name in tensors:
        part = name.partition(".")[0]
        if part not in parts:
            raise ValueError(
                f"a tensor is named {name!r:.60}; its part must be one of {sorted(parts)}"
            )


def find(run_or_file: Path, prefer: Path = BEST, controllers: Sequence[str] = ()) -> Path:
    """Return the checkpoint file of a run, a file, a shipped policy or ``hf:user/name``.

    ``prefer``: the file of a run directory that is returned if it exists. ``controllers``: further
    names that are allowed where the path comes from, for the error.
    """
    # In this order: the Hub, a file, a shipped policy, the folder of a run.
    if str(run_or_file).startswith(hub.PREFIX):
        return hub.download(str(run_or_file))
    if os.path.isfile(run_or_file):  # noqa: PTH113  # false for any text, however long
        return run_or_file
    if not os.path.exists(run_or_file):  # noqa: PTH110  # as above
        if file := shipped_policies().get(str(run_or_file)):
            return file
        # Nothing has that name: suggest what comes close.
        known = sorted([*shipped_policies(), *controllers])
        also = ", shipped policy or controller" if controllers else " or shipped policy"
        hint = _run_beside(run_or_file) or (
            missing_name(str(run_or_file), known)
            if controllers
            else close_match(str(run_or_file), known)
        )
        raise CheckpointError(
            f"{run_or_file}: there is no such run, file{also}{hint}; names: {', '.join(known)}"
        )
    # In the folder of a run the preferred file comes first, then its best, then its last.
    for name in dict.fromkeys((prefer, BEST, LAST)):
        if (run_or_file / name).is_file():
            return run_or_file / name
    inner = runs_in(run_or_file)
    hint = f"give one of its runs, such as {inner[0]}" if inner else "is it a run directory?"
    raise CheckpointError(f"{run_or_file} holds neither {BEST} nor {LAST}; {hint}")


def holds(folder: Path) -> bool:
    """Return whether a folder is that of a run with a checkpoint."""
    return any((folder / name).is_file() for name in (BEST, LAST))


def runs_in(folder: Path) -> list[Path]:
    """Return the runs with a checkpoint in a folder, as that of a sweep, in the order of jobs."""
    return sorted(filter(holds, folder.iterdir()), key=job_order)


def job_order(run: Path) -> tuple[int, str]:
    """Return the key that sorts runs of a sweep by the numbers with which their names begin."""
    first = run.name.partition("_")[0]
    return (int(first) if first.isdigit() else 2**31, run.name)


def _run_beside(missing: Path) -> str:
    """Return `` (did you mean 'x'?)`` for the closest run beside a path; empty without one."""
    with contextlib.suppress(OSError):  # no suggestion from an unreadable folder
        runs = [run.name for run in runs_in(missing.parent)]
        near = difflib.get_close_matches(missing.name, runs, n=1)
        return suggestion(*(str(missing.parent / name) for name in near))
    return ""


def shipped_policies() -> dict[str, Path]:
    """Return the files of the policies that come with the package, by name."""
    folder = Path(__file__).parents[1] / "policies"
    return {file.stem: file for file in sorted(folder.glob("*.safetensors"))}
