"""The conditions of an evaluation: what decides its draws and its physics, and a short hash of it.

In: an evaluation's configuration. Out: plain data for files, a line for people, and eight digits
that are equal where two evaluations are comparable.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from flipperctl.api import ObservationLayout, Settings
from flipperctl.config import (
    Episode,
    EvalConfig,
    PerceptionSettings,
    Randomise,
    Robot,
    Sim,
    container,
)
from flipperctl.messages import unit

_SECTIONS: Mapping[str, type[Settings]] = {
    "robot": Robot,
    "sim": Sim,
    "perception": PerceptionSettings,
    "episode": Episode,
    "randomise": Randomise,
}
_LEFT_OUT = {
    "sim": {"engine"},  # both engines give the same numbers
    "perception": set(ObservationLayout.model_fields),  # how a policy sees belongs to the policy
}
_START = ("start_noise", "start_angle_noise")
_DIGITS = 8


@dataclass(frozen=True)
class Conditions:
    """Under what an evaluation's episodes are drawn and driven."""

    name: str
    """The named conditions that overrides were laid over."""
    settings: Mapping[str, Any]
    """``terrain`` with all its fields, ``robot``, ``sim``, ``perception``, ``episode`` and
    ``randomise``, without what has no influence."""

    @classmethod
    def of(cls, config: EvalConfig) -> Conditions:
        """The conditions of an evaluation."""
        whole = container(config.environment())
        sections = {
            section: {k: v for k, v in whole[section].items() if k not in _left_out(section)}
            for section in _SECTIONS
        }
        return cls(config.conditions, {"terrain": whole["terrain"], **sections})

    @property
    def hash(self) -> str:
        """The first eight hexadecimal digits of the SHA-256 of the settings as canonical JSON.

        Keys are sorted, nothing is between the tokens, characters beyond ASCII are escaped. Equal
        hashes: episodes of the same distribution. Equal seeds beside it: the same draws, one by
        one, whoever drives.
        """
        text = json.dumps(self.settings, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]

    def container(self) -> dict[str, Any]:
        """As plain data: ``name``, ``hash`` and what was hashed."""
        return {"name": self.name, "hash": self.hash, **self.settings}

    def line(self) -> str:
        """What is randomised and where the settings differ from the defaults, in one line.

        The terrain, which tables name, is not in it.
        """
        drawn = [
            _shown(Randomise, name, value)
            for name, value in self.settings["randomise"].items()
            if value is not None
        ]
        shift, turn = (self.settings["episode"][name] for name in _START)
        sections = {
            "sensing": self._differences("perception"),
            "physics": self._differences("sim"),
            "robot": self._differences("robot"),
            "episode": self._differences("episode", *_START),
        }
        default = [name for name, said in sections.items() if not said]
        parts = [
            f"randomised {', '.join(drawn)}" if drawn else "nothing randomised",
            f"start ±{shift:g} m" + (f", flippers ±{turn:g} rad" if turn else ""),
            *(f"{name} {said}" for name, said in sections.items() if said),
            *([f"default {', '.join(default)}"] if default else []),
        ]
        return "; ".join(parts)

    def _differences(self, section: str, *apart: str) -> str:
        model, values = _SECTIONS[section], self.settings[section]
        defaults = container(model())
        changed = [k for k, v in values.items() if v != defaults[k] and k not in apart]
        return ", ".join(_shown(model, name, values[name]) for name in changed)


def _left_out(section: str) -> set[str]:
    return _LEFT_OUT.get(section, set())


def _shown(model: type[Settings], name: str, value: Any) -> str:
    ends = value if isinstance(value, list | tuple) else [value]
    number = " to ".join(f"{end:.4g}" if isinstance(end, int | float) else str(end) for end in ends)
    of = unit(model, name)
    return f"{name} {number}{'' if of in ('', '-') else f' {of}'}"
