"""The plan of an evaluation: which policies play which scenes, and how they are called.

In: a configuration and a policy's source for each entry. Out: a ``Plan``, which ``evaluate`` plays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from flipperctl.config import EvalConfig
from flipperctl.evaluation.conditions import Conditions
from flipperctl.policies.source import PolicySource

BEST_KNOWN = "best known"
"""How a row of the best stored policy is called, before its label in brackets."""


def is_best_known(label: str) -> bool:
    """Return whether a row's label is that of the best stored policy."""
    return label.startswith(f"{BEST_KNOWN} (")


@dataclass(frozen=True)
class Entry:
    """One policy on one scene."""

    config: EvalConfig
    """``config.eval`` holds the number of episodes and the seed."""
    source: PolicySource
    scene: str = ""
    """Name of the scene within its suite."""
    method: str = ""
    """Name of the method, whose policies differ in their training seeds; empty for one policy."""
    training_seed: int | None = None
    """Seed of the policy's training; None for a controller, or if there is one seed alone."""
    is_baseline: bool = False
    """Whether the policy plays for comparison alone."""
    comparison: int | None = None
    """Number of the comparison of engines of which the entry is a step; None for none."""
    stored: str = ""
    """Label of the policy whose stored episodes of an earlier evaluation these are, else empty."""

    @property
    def terrain(self) -> str:
        """Name of the terrain plugin."""
        return self.config.terrain.plugin_name

    @property
    def sim(self) -> str:
        """Name of the engine."""
        return self.config.sim.plugin_name

    @property
    def label(self) -> str:
        """Label of the policy: a shipped policy's or a controller's name, else a path."""
        return self.stored or self.source.label()

    @property
    def row_label(self) -> str:
        """Label of the policy in files; a row of stored episodes says so."""
        return self.named if self.stored else self.label

    @property
    def named(self) -> str:
        """Name of the policy for tables: its method with the training seed, else its label."""
        seed = "" if self.training_seed is None else f", seed {self.training_seed}"
        return f"{self.method}{seed}" if self.method else self.label

    @cached_property
    def conditions(self) -> Conditions:
        """The settings that determine how the episodes are sampled and simulated."""
        return Conditions.of(self.config)

    @property
    def ground(self) -> tuple[str, str, int, int]:
        """What is equal for the entries that play equal episodes."""
        numbers = self.config.eval
        return self.scene, self.conditions.hash, numbers.seed, numbers.episodes

    @property
    def names(self) -> dict[str, Any]:
        """Names beyond those of the terrain and of the policy's file, as far as there are any."""
        names = {"suite_scene": self.scene or None, "method": self.method or None}
        every = {**names, "training_seed": self.training_seed}
        return {name: value for name, value in every.items() if value is not None}


@dataclass(frozen=True)
class Plan:
    """The entries of an evaluation, in the order in which they are played and shown."""

    entries: tuple[Entry, ...]
    title: str = ""
    """What is evaluated, as the user called it."""
    with_best_known: bool = False
    """Whether a row of the best stored policy stands beside them, where it is better than all."""

    @classmethod
    def of_one(
        cls, entries: Sequence[Entry], baselines: Sequence[PolicySource] = (), title: str = ""
    ) -> Plan:
        """Return the plan of one policy, whose other baselines play each scene after it."""
        found: list[Entry] = []
        for entry in entries:
            found.append(entry)
            for other in baselines:
                beside = Entry(entry.config, other, is_baseline=True)
                if other != entry.source and beside not in found:
                    found.append(beside)
        return cls(tuple(found), title)

    @property
    def engines(self) -> bool:
        """Whether engines are compared."""
        return any(entry.comparison is not None for entry in self.entries)

    @property
    def has_methods(self) -> bool:
        """Whether it is a plan of several methods, or of a suite, whose baselines have rows."""
        return any(entry.method for entry in self.entries)

    @property
    def rows(self) -> list[Entry]:
        """The entries that are scenes of the result; baselines are so beside several methods."""
        return [e for e in self.entries if self.has_methods or not e.is_baseline]
