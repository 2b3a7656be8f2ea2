"""The overrides of a command, parsed once: their keys, values, choices and combinations.

In: the words as the user typed them. Out: one ``Overrides`` for all later steps.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import OverrideParseException

from flipperctl.config.defaults import CHOICES
from flipperctl.config.words import check_different, check_words, expand_files, key_of, unreadable
from flipperctl.errors import ConfigError
from flipperctl.text.files import at_home
from flipperctl.training.search import Interval

SEARCH_PATH = "hydra.searchpath"
"""Key of the folders with further configuration files."""


@dataclass(frozen=True)
class Overrides:
    """Overrides as Hydra parses them, in their order."""

    parsed: tuple[Override, ...] = ()

    @classmethod
    def parse(cls, words: Iterable[str], *, check: bool = True) -> Overrides:
        """Parse the words.

        With ``check``, words that are not overrides are explained, for instance a typing mistake,
        and ``robot=FILE`` becomes the settings of the file.

        Raises:
            ConfigError: a word is not an override, Hydra cannot read it, or a key is given twice.
        """
        words = list(map(at_home, words))
        if check:
            check_words(words)
            words = expand_files(words)
        try:
            return cls(tuple(OverridesParser.create().parse_overrides(words)))
        except OverrideParseException as error:
            raise unreadable(str(error.override)) from error
        except ValueError as error:  # Python reads integers of up to 4300 digits
            key = key_of(max(words, key=len))
            raise ConfigError(f"{key}: its number has too many digits") from error

    @property
    def words(self) -> list[str]:
        """The overrides as they were typed."""
        return [str(override.input_line) for override in self.parsed]

    @property
    def typed(self) -> dict[str, str]:
        """The word that overrides each key or group; a mapping overrides all keys in it."""
        found: dict[str, str] = {}
        for o in self.parsed:
            value = None if o.is_delete() or o.is_sweep_override() else o.value()
            found |= dict.fromkeys(_keys(o.key_or_group, value), str(o.input_line))
        return found

    @property
    def swept(self) -> list[str]:
        """Keys with several values, or with an interval."""
        return [o.get_key_element() for o in self.parsed if o.is_sweep_override()]

    def where(self, chosen: Callable[[str], bool]) -> Overrides:
        """Return the overrides whose key or group ``chosen`` accepts."""
        return Overrides(tuple(o for o in self.parsed if chosen(o.key_or_group)))

    def choice(self, group: str) -> str | None:
        """Return the name that was chosen last for a group; None if there is none."""
        found = [o for o in self.parsed if o.key_or_group == group]
        value = found[-1].value() if found and not found[-1].is_delete() else None
        return str(value) if value else None

    def values(self) -> dict[str, Any]:
        """Return the value of each key, for overrides that are applied without Hydra."""
        for o in self.parsed:
            plain = not (o.is_delete() or o.is_add() or o.is_force_add())
            if not plain or o.is_sweep_override():
                raise ConfigError(f"{o.input_line}: one value is allowed here, as in key=value")
        return {o.key_or_group: o.value() for o in self.parsed}

    def check_training(self, *, several: bool) -> None:
        """Refuse lists without ``several`` runs, empty folders, and what ``check`` refuses."""
        for override in self.parsed:
            key, typed = override.get_key_element(), str(override.input_line)
            if override.is_sweep_override() and not several:
                name, _, value = typed.partition("=")
                raise ConfigError(
                    f"{typed}: several values make several runs; add -m for them, or brackets if "
                    f"the setting is a list: {name}=[{value}]"
                )
            # An empty name would mix runs with the user's own files.
            if key in ("hydra.run.dir", "hydra.sweep.dir") and override.value() in ("", None):
                raise ConfigError(
                    f"{key}: the name of a folder is allowed, or . for the working directory; "
                    f"the value is {override.value()!r}"
                )
        self.check()

    def check(self) -> None:
        """Refuse words that Hydra would apply without the effect that they state."""
        dropped = {o.key_or_group: o.input_line for o in self.parsed if o.is_delete()}
        for override in self.parsed:
            key, value, typed = override.get_key_element(), override.value(), override.input_line
            deletes = override.is_delete()
            word = dropped.get(str(override.package))
            if word and not deletes:  # ~rewards.pitch beside reward@rewards.pitch=…
                raise ConfigError(
                    f"{word} is applied last and also drops what {typed} brings; "
                    f"to replace the entry, write {str(typed).lstrip('+')} alone"
                )
            if value == {} and not deletes:
                drop = "~rewards drops every term" if key == "rewards" else f"~{key} drops it"
                raise ConfigError(
                    f"{typed}: a mapping is merged into the existing one, so that "
                    f"an empty mapping changes nothing; {drop}"
                )
            names = value if isinstance(value, list) else [value]
            words = all(isinstance(name, str) for name in names)
            if key == SEARCH_PATH and not (isinstance(value, list) and words):
                raise ConfigError(
                    f"{SEARCH_PATH}: a list of folders is allowed, as in [my,pkg://package]; the "
                    f"value is {value!r}"
                )
            name = override.key_or_group
            is_choice = name in CHOICES or "/" in name or override.package is not None
            if not is_choice or override.is_sweep_override() or isinstance(value, dict):
                continue
            if value is None and not deletes:
                raise ConfigError(f"{typed}: null is not allowed here; give a name")
            if value is not None and not words:
                raise ConfigError(f"{key}: a name is allowed; the value is {value!r}")

    def sampled(self) -> tuple[dict[str, Interval | Sequence[str]], list[str]]:
        """Return the intervals and lists that a search samples, by key, and the other words."""
        found: dict[str, Interval | Sequence[str]] = {
            override.get_key_element(): _interval(override)
            if override.is_interval_sweep()
            else _swept_values(override)
            for override in self.parsed
            if override.is_sweep_override()
        }
        return found, [str(o.input_line) for o in self.parsed if not o.is_sweep_override()]

    def combinations(self) -> Iterator[Overrides]:
        """Yield every combination of the values in lists, without intervals.

        Sweepers sample the intervals, and the jobs check the sampled values.
        """
        self.check()
        parts: list[Sequence[Override]] = []
        for override in self.parsed:
            if override.is_sweep_override() and not override.is_interval_sweep():
                key = override.get_key_element()
                words = [f"{key}={value}" for value in _swept_values(override)]
                parts.append(Overrides.parse(words, check=False).parsed)
                check_different(str(override.input_line), [o.value() for o in parts[-1]])
            elif not override.is_sweep_override():
                parts.append([override])
        for combination in map(Overrides, itertools.product(*parts)):
            combination.check()
            yield combination

    def interval_probes(self) -> Iterator[Overrides]:
        """Yield the overrides with each interval at its ends, and at a value between them."""
        for index, override in enumerate(self.parsed):
            if override.is_interval_sweep():
                key = override.get_key_element()
                probes = [f"{key}={number}" for number in _interval(override).probes()]
                for probe in Overrides.parse(probes, check=False).parsed:
                    yield Overrides((*self.parsed[:index], probe, *self.parsed[index + 1 :]))


def _keys(key: str, value: object) -> Iterator[str]:
    """Yield a key, and those in a mapping that is its value."""
    yield key
    for name, item in value.items() if isinstance(value, Mapping) else ():
        yield from _keys(f"{key}.{name}", item)


def _swept_values(override: Override) -> list[str]:
    """Return the values of a list, or the names of a group that a ``glob(…)`` chooses."""
    hydra = GlobalHydra.instance()
    override.config_loader = hydra.config_loader() if hydra.is_initialized() else None
    found = list(override.sweep_string_iterator())
    if not found:
        raise ConfigError(
            f"{override.input_line}: no name fits; glob(…) chooses among the names of a group, as "
            "in terrain=glob(st*)"
        )
    return found


def _interval(override: Override) -> Interval:
    sweep: Any = override.value()
    return Interval(sweep.start, sweep.end, "log" in sweep.tags, str(override.input_line))
