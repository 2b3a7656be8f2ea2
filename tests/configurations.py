"""Random training configurations, drawn with Hypothesis from the types and bounds of all settings.

``overrides()`` draws dotted overrides of a short training; ``attempt`` trains with them. A setting
of any type but those of ``drawn_settings`` keeps its default; ``left_out`` lists these.
"""

import contextlib
import io
import re
import signal
import traceback
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from hypothesis import strategies as st

from flipperctl.api import registry
from flipperctl.api.plugin import registered_names
from flipperctl.config import TrainConfig, with_overrides
from flipperctl.config.randomise import PATH_SECTIONS, SECTION_OF
from flipperctl.errors import RequestError
from flipperctl.training.run import start
from tests.drawn_settings import (
    GROUPS,
    NOT_DRAWN,
    SECTIONS,
    Setting,
    plugin_names,
    plugin_settings,
    section_settings,
)

DECISIONS = 60
LIMIT = 60.0
"""Longest computing time of a training [s]."""
FIXED = {
    "train.mode": "exact",
    "train.decisions": DECISIONS,
    "train.validation_episodes": 1,
    "train.regret_episodes": 0,
    "agent.learning_starts": 16,
    "agent.batch_size": 8,
    "episode.run_out": 0.2,
    "episode.slack": 2.0,
    "terrain.length": 0.5,
}
"""What makes the base short, beside searches of little depth; all but the first two are drawn."""
Overrides = dict[str, Any]
PATHS = tuple(f"{section}." for section in PATH_SECTIONS)
"""Sections whose settings are sampled by path."""


@st.composite
def overrides(draw: st.DrawFn) -> Overrides:
    """Draw up to 14 settings over all sections, with the plugins of each group."""
    found: Overrides = {}
    plugins = {name: draw(plugin_names(name)) for name in GROUPS}
    pool = [*section_settings()]
    for section, name in plugins.items():
        pool += plugin_settings(section, GROUPS[section], name)
    terms = draw(st.lists(st.sampled_from(registered_names("reward")), unique=True, max_size=4))
    for term in terms:
        pool += plugin_settings(f"rewards.{term}", "reward", term)
    teacher = draw(st.sampled_from([None] * 12 + registered_names("controller")))
    if teacher is not None:
        pool += plugin_settings("teacher.controller", "controller", teacher)
    known = {setting.path: values for setting in pool if (values := setting.values()) is not None}
    names = draw(st.lists(st.sampled_from(sorted(known)), unique=True, max_size=14))
    for section, name in plugins.items():
        found[section] = {"name": name}
        if name == "flat" and "terrain.length" not in names:
            found["terrain"]["length"] = FIXED["terrain.length"]
        if name == "lidar" and "perception.azimuths" not in names:
            found["perception"]["azimuths"] = 8  # of a slow robot's decision, hundreds of scans
    for term in terms:
        found[f"rewards.{term}"] = {"name": term}
    for term in draw(st.sets(st.sampled_from(["flipper", "pitch", "end"]), max_size=3)):
        found.setdefault(f"rewards.{term}", None)
    if teacher is not None:
        found["teacher.controller"] = {"name": teacher}
        for name in ("horizon", "beam"):  # a search predicts each decision, however long it is
            path = f"teacher.controller.{name}"
            if path in known and path not in names:
                found["teacher.controller"][name] = 2
    for name in names:
        found[name] = draw(known[name])
    for name, section in sorted(SECTION_OF.items()):
        if draw(st.integers(0, 40)) == 40:
            cls = registry.get((section, plugins.get(section, "")))
            model = cls or TrainConfig.model_fields[section].annotation
            if (info := model.model_fields.get(name)) is not None:
                values = Setting(f"{section}.{name}", info).values()
                found[f"randomise.{name}"] = sorted(draw(st.tuples(values, values)))
    paths = [s for s in pool if s.path.startswith(PATHS) and s.info.annotation in (int, float)]
    for setting in draw(st.lists(st.sampled_from(paths), max_size=1)):
        values = setting.values()
        found[f"randomise.{setting.path}"] = sorted(draw(st.tuples(values, values)))
    if draw(st.integers(0, 9)) == 9:
        wrong = draw(st.sampled_from([s for s in pool if s.path not in NOT_DRAWN]))
        found[wrong.path] = draw(st.sampled_from(wrong.wrong()))
    return found


def left_out() -> list[str]:
    """Return the settings whose type is not drawn."""
    settings = list(section_settings())
    for section, kind in GROUPS.items():
        for name in registered_names(kind):
            settings += plugin_settings(section, kind, name)
    return sorted({s.path for s in settings if s.values() is None} - set(NOT_DRAWN))


def command(drawn: Overrides) -> str:
    """Return the drawn overrides as the words of a command."""
    words = [f"{key}={value}" for key, value in FIXED.items() if key not in drawn]
    words = [word for word in words if not word.startswith("terrain.")]  # it has its mapping
    for key, value in drawn.items():
        if isinstance(value, Mapping):
            group = {"rewards": f"+reward@{key}", "teacher": "teacher"}.get(key.split(".")[0], key)
            words.append(f"{group}={value['name']}")
            words += [f"{key}.{n}={v}" for n, v in value.items() if n != "name"]
        elif value is None and key.startswith("rewards."):
            words.append(f"~{key}")
        else:
            word = "null" if value is None else value
            words.append(f"{key}={list(word) if isinstance(word, tuple) else word}")
    return "flipperctl train " + " ".join(f"'{w}'" if "[" in w else w for w in words)


@dataclass(frozen=True)
class Attempt:
    """What came of a training."""

    kind: Literal["trained", "refused", "unnamed", "fault", "too long"]
    section: str = ""
    """Section that a refusal names."""
    text: str = ""
    """Words of the refusal or the fault."""


def attempt(drawn: Overrides, folder: Path) -> Attempt:
    """Train 60 decisions with the drawn overrides in an empty folder."""
    try:
        with _limited(), _strict(), contextlib.redirect_stderr(io.StringIO()):
            base = TrainConfig(terrain="flat", network="at_d3qn")
            config = with_overrides(base, {**FIXED, "terrain": {"name": "flat"}, **drawn})
            start(config, folder)
    except RequestError as error:
        section = _named(str(error), drawn)
        return Attempt("refused" if section else "unnamed", section, str(error))
    except _OutOfTimeError:
        return Attempt("too long")
    except Exception as error:  # noqa: BLE001  # any other error is a fault
        frame = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(frame.filename).name}:{frame.lineno}"
        return Attempt("fault", "", f"{type(error).__name__} at {place}: {str(error)[:300]}")
    return Attempt("trained")


def _named(text: str, drawn: Overrides) -> str:
    """Return the section that the text of a refusal names, or nothing."""
    for section in (*SECTIONS, *GROUPS, "rewards", "randomise"):
        if re.search(rf"\b{section}\b|\breward '", text.replace("flipperctl train", "")):
            return section
    return ""


@contextlib.contextmanager
def _strict() -> Iterator[None]:
    """Raise numpy's warnings of overflows and of numbers that are not finite."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # such as what libraries say once, at their import
        warnings.simplefilter("error", RuntimeWarning)
        yield


class _OutOfTimeError(KeyboardInterrupt):
    """A training computed for longer than ``LIMIT``; no plugin's fault, like an interrupt."""


@contextlib.contextmanager
def _limited() -> Iterator[None]:
    """Raise ``_OutOfTimeError`` in this block after ``LIMIT``."""

    def stop(*_: object) -> None:
        raise _OutOfTimeError

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, LIMIT)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
