"""The conditions of an evaluation, their hash, and what a policy's file brings to them.

In: an evaluation's configuration. Out: plain data for files, a line of text, and a hash of eight
digits that is equal for comparable evaluations. In: a run, a checkpoint or an exported file. Out:
sections as plain data, from which an evaluation is composed, and lines on missing or different
settings.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flipperctl.api import ObservationLayout, Settings, registry
from flipperctl.config import DEFAULT_ENGINE, EnvConfig, EvalConfig, Randomise, TrainConfig, to_dict
from flipperctl.config.identity import ABSENT, all_files_read, content_digest, differences
from flipperctl.config.models import AbsentReward, AbsentTerrain
from flipperctl.config.presets import presets
from flipperctl.errors import CheckpointError
from flipperctl.policies.source import PolicySource
from flipperctl.text.messages import unit

NOMINAL, TRAINED = "nominal", "trained"  # the default conditions, and as in a policy's training
_SECTIONS = ("robot", "sim", "perception", "episode", "randomise")
_CHOSEN = ("sim", "perception", "episode", "randomise")  # the sections that ``conditions=`` chooses
_START = ("start_noise", "start_angle_noise")
_DIGITS = 8
_SHOWN = 3  # largest number of settings that a line names


@dataclass(frozen=True)
class Conditions:
    """The settings that determine how an evaluation's episodes are sampled and simulated."""

    name: str
    """Name of the conditions to which overrides were applied."""
    settings: Mapping[str, Any]
    """``terrain`` with all its fields, ``robot``, ``sim``, ``perception``, ``episode`` and
    ``randomise``, without settings that have no influence; and, if plugins read files, the SHA-256
    of each as ``files``."""
    defaults: Mapping[str, Settings]
    """Each section at its defaults, for the chosen engine and sensor."""

    @classmethod
    def of(cls, config: EvalConfig) -> Conditions:
        """Return the conditions of an evaluation."""
        whole = to_dict(config.environment())
        # Settings that change nothing would give equal episodes different hashes.
        left_out = {
            "robot": _added(config.robot),
            "sim": _without_effect(config, "sim") | _added(config.sim),
            # The layout is set by the policy.
            "perception": {*ObservationLayout.model_fields, *_without_effect(config, "perception")},
        }
        derived = ("robot", "episode")  # a null is derived from other settings
        sections = {
            section: {
                name: value
                for name, value in whole[section].items()
                if name not in left_out.get(section, ())
                if value is not None or section not in derived
            }
            for section in _SECTIONS
        }
        defaults = {section: type(getattr(config, section))() for section in _SECTIONS}
        settings = {"terrain": whole["terrain"], **sections}
        plugins = (config.terrain, config.sim, config.perception)
        # Recorded ground counts by its content, wherever its file lies.
        if files := [content_digest(file) for file in all_files_read(plugins)]:
            settings["files"] = files
        return cls(config.conditions, settings, defaults)

    @property
    def label(self) -> str:
        """Name and hash, for rows and titles."""
        return f"{self.name} {self.hash}"

    @property
    def hash(self) -> str:
        """Eight hexadecimal digits, the first of the SHA-256 of the settings as canonical JSON.

        Keys are sorted, there is no white space, and non-ASCII characters are escaped. Equal hashes
        mean episodes of the same distribution. With equal seeds as well, each episode has the same
        ground, start and physics for every policy.
        """
        text = json.dumps(self.settings, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data: ``name``, ``hash`` and the settings that were hashed."""
        return {"name": self.name, "hash": self.hash, **self.settings}

    def line(self, varied: Collection[str] = ()) -> str:
        """Return one line of text: the randomised settings, and settings that are no defaults.

        It is empty if there are none. The terrain is left out, since the tables name it.
        ``varied``: keys of settings that have several values, such as the axes of a map.
        """
        randomised = list(self._randomised())
        more = f" and {len(randomised) - _SHOWN} more" if len(randomised) > _SHOWN else ""
        parts = {"randomised": ", ".join(randomised[:_SHOWN]) + more}
        # Settings of the start are apart from the other ones of the episode.
        episode = list(self._differences("episode", varied))
        parts["start"] = ", ".join(text for name, text in episode if name in _START)
        for title, section in (("sensing", "perception"), ("physics", "sim"), ("robot", "robot")):
            parts[title] = ", ".join(text for _, text in self._differences(section, varied))
        parts["episode"] = ", ".join(text for name, text in episode if name not in _START)
        return "; ".join(f"{title} {text}" for title, text in parts.items() if text)

    def _randomised(self) -> Iterator[str]:
        """Yield each sampled setting with its range, and the spread of all."""
        for name, value in self.settings["randomise"].items():
            if isinstance(value, Mapping):
                model = type(self.defaults[name])
                for field, item in value.items():
                    yield f"{name}.{_format_setting(model, field, item)}"
            elif value is not None:  # the spread
                yield _format_setting(Randomise, name, value)

    def _differences(self, section: str, varied: Collection[str]) -> Iterator[tuple[str, str]]:
        """Yield the name and the text of each setting that differs from its default, or varies."""
        default, values = self.defaults[section], self.settings[section]
        plain = {"name": values.get("name"), **to_dict(default)}
        several = [key.partition(".")[2] for key in varied if key.startswith(f"{section}.")]
        if (engine := values.get("name", DEFAULT_ENGINE)) != DEFAULT_ENGINE:
            yield "name", engine
        for name, value in values.items():
            if value != plain[name] and name not in several:
                yield name, _format_setting(type(default), name, value)
        yield from ((name, f"{name} varied") for name in several)


def scene_names(scenes: Sequence[tuple[str, Conditions]]) -> list[str]:
    """Return a name for each scene: its terrain, and its conditions if a terrain has several.

    Scenes that are equal in both, such as with several ``controller.width``, are numbered.
    """
    terrains = [terrain for terrain, _ in scenes]
    names = [
        terrain if terrains.count(terrain) == 1 else f"{terrain}, {conditions.label}"
        for terrain, conditions in scenes
    ]
    return numbered(names)


def numbered(names: Sequence[str]) -> list[str]:
    """Number equal names, as in ``step (1)`` and ``step (2)``; return all names."""
    return [
        name if names.count(name) == 1 else f"{name} ({names[: at + 1].count(name)})"
        for at, name in enumerate(names)
    ]


def _added(configured: Settings) -> set[str]:
    """Return the settings that a later version added and that have their defaults."""
    default = type(configured)()
    return {n for n in configured.added if getattr(configured, n) == getattr(default, n)}


def _without_effect(config: EvalConfig, section: str) -> set[str]:
    """Return the settings of engine or sensor that change nothing in any episode.

    Sampled settings may give others an effect, as errors of a map do for the length of its errors.
    These are left out at their defaults nevertheless, so that hashes stay the same.
    """
    configured = getattr(config, section)
    sampled = {
        setting.field: max(setting.ends, key=abs)
        for setting in config.randomise.sampled()
        if setting.section == section
    }
    default, drawn = type(configured)(), configured.model_copy(update=sampled)
    return {
        name
        for name in configured.without_effect
        if name in drawn.without_effect or getattr(configured, name) == getattr(default, name)
    }


def _format_setting(model: type[Settings], name: str, value: Any) -> str:
    if isinstance(value, bool):
        return f"{name} {'on' if value else 'off'}"
    ends = value if isinstance(value, list | tuple) else [value]
    number = " to ".join(f"{end:.4g}" if isinstance(end, int | float) else str(end) for end in ends)
    symbol = unit(model, name)
    return f"{name} {number}{'' if symbol in ('', '-') else f' {symbol}'}"


@dataclass(frozen=True)
class Inherited:
    """The sections that a policy brings to its evaluation, as plain data."""

    chosen: dict[str, Any]
    """Terrain, robot and rewards, which overrides may replace as a whole."""
    kept: dict[str, Any]
    """Observation layout (of ``perception``) and evaluation settings, in all conditions."""
    nominal: dict[str, Any]
    """The other sections at their defaults."""
    trained: dict[str, Any] | None
    """Engine, sensor and the other sections as in the training; None if the file lacks them."""

    @classmethod
    def of(cls, config: TrainConfig | EvalConfig) -> Inherited:
        """Return the sections of a checkpoint, or of an exported file if it is an EvalConfig."""
        sections = to_dict(config.environment())
        sections["terrain"] = to_dict(config.terrain, brief=True)
        layout = {name: sections["perception"][name] for name in ObservationLayout.model_fields}
        # What overrides replace as a whole, and what stays in all conditions
        chosen = {name: sections.pop(name) for name in ("terrain", "robot", "rewards")}
        always = {"perception": layout, "eval": to_dict(config.eval)}
        default = to_dict(EvalConfig(terrain=config.terrain))
        nominal = {name: default[name] for name in sections if name not in ("sim", "perception")}
        return cls(chosen, always, nominal, sections if isinstance(config, TrainConfig) else None)


def read_config(
    source: PolicySource, terrains: Collection[str | None], tell: Callable[[str], None]
) -> TrainConfig | EvalConfig:
    """Return the configuration of a checkpoint, or the part of it that an exported file holds.

    ``terrains`` are those to be evaluated, None for the file's own. Reward terms whose plugins are
    missing are left out, and ``tell`` is called with a line for each.
    """
    file, config = source.file, source.config()
    absent = config.terrain
    if isinstance(absent, AbsentTerrain):
        name = absent.plugin_name
        named = ("terrain", name) in registry  # and only a terrain inside it is missing
        # Missing terrain matters only if it is to be evaluated.
        if any(terrain is None or (terrain == name and not named) for terrain in terrains):
            raise CheckpointError(
                f"{file}: {absent.missing}, or evaluate another one with terrain=NAME"
            )
    for name, term in config.rewards.items():
        if isinstance(term, AbsentReward):
            tell(f"{file}: the return lacks rewards.{name}: {term.missing}")
    present = {k: v for k, v in config.rewards.items() if not isinstance(v, AbsentReward)}
    return config.model_copy(update={"rewards": present})


def explain_missing_training(exported: bool) -> str:
    """Return the error text for ``conditions=trained`` without a training."""
    cause = (
        "an exported file does not hold those of its training; evaluate the checkpoint instead"
        if exported
        else "they are those of a checkpoint's training, and no checkpoint is evaluated"
    )
    known = ", ".join(presets("conditions"))
    return f"conditions: {TRAINED!r} is not known here: {cause}; known: {known}"


def policy_notes(
    path: Path,
    trained: TrainConfig | EvalConfig,
    configs: Iterable[EvalConfig],
    keys: Collection[str],
) -> Iterator[str]:
    """Yield a line on each change of the training's settings that the user did not choose.

    ``path`` names the file and ``trained`` is its own configuration; chosen are the overridden
    ``keys``, and all changes if ``conditions=`` names other conditions than the default ones.
    """
    if not isinstance(trained, TrainConfig):
        return
    training = EvalConfig(**{name: getattr(trained, name) for name in EnvConfig.model_fields})
    before, lines = Conditions.of(training).settings, dict[str, None]()
    for config in configs:
        # Conditions that the user named are no surprise.
        if config.conditions != NOMINAL:
            continue
        here = Conditions.of(config).settings
        texts = [
            f"{name}={_short(there)} ({_short(None if value is ABSENT else value)})"
            for section in _CHOSEN
            for name, there, value in differences(before[section], here[section], section)
            if there is not ABSENT and not {section, name} & set(keys)
        ]
        if len(texts) > _SHOWN:
            lines[
                f"{path}: nominal conditions; its training had others ({len(texts)} settings; "
                f"conditions={TRAINED} keeps them)"
            ] = None
        elif texts:
            lines[
                f"{path}: trained with {', '.join(texts)}, evaluated with the values in brackets "
                f"(conditions={TRAINED} keeps those of the training)"
            ] = None
    yield from lines


def _short(value: object) -> str:
    return json.dumps(value, separators=(",", ":")).strip('"')
