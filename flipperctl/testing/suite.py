"""The checks of each kind of plugin, and the class that passes them to pytest."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from flipperctl import plugins as loader
from flipperctl.api import Logger, Plugin
from flipperctl.testing import check as common
from flipperctl.testing.check import Check, run_on_variants
from flipperctl.testing.variants import Variant, variants

Test = Callable[[Any], None]


def checks(*plugins: type[Plugin], pictures: Path | None = None) -> list[Check]:
    """Return all checks of the plugins; ``pictures`` is a folder for pictures of the terrains."""
    loader.load()  # a plugin may contain others
    return [check for cls in plugins for check in _checks(cls, pictures)]


class Conformance:
    """Base class of a test class that names the ``plugin`` to check."""

    plugin: ClassVar[type[Plugin]]
    pictures: ClassVar[Path | None] = None
    """Folder for pictures of the terrain at its defaults and at each bound, if any."""

    def pytest_generate_tests(self, metafunc: Any) -> None:
        """Make one test of each check."""
        if "check" in metafunc.fixturenames:
            found = checks(self.plugin, pictures=self.pictures)
            metafunc.parametrize("check", found, ids=str)

    def test_keeps_the_contract(self, check: Check) -> None:
        """Fail with the plugin, the value and the allowed values."""
        check()


class _Cases:
    """Variants of a plugin, created when the first check needs them."""

    def __init__(self, cls: type[Plugin]) -> None:
        self._cls = cls

    @cached_property
    def all(self) -> list[Variant]:
        return variants(self._cls)


def _checks(cls: type[Plugin], pictures: Path | None) -> Iterator[Check]:
    cases = _Cases(cls)

    def at_all(name: str, test: Test) -> Check:
        return Check(cls, name, lambda: run_on_variants(cases.all, test))

    def at_defaults(name: str, test: Test) -> Check:
        return Check(cls, name, lambda: run_on_variants(cases.all[:1], test))

    yield Check(cls, "registered", lambda: common.registered(cls))
    yield Check(cls, "documented", lambda: common.documented(cls))
    yield at_all("checkpoint", common.survives_a_checkpoint)
    match cls.kind:
        case "terrain":
            from flipperctl.testing import terrain

            yield at_all("draws", terrain.draws)
            yield at_all("repeats", terrain.repeats)
            yield at_all("global randomness", terrain.leaves_global_randomness)
            yield at_all("extent", terrain.extent)
            yield at_all("difficulty", terrain.graded)
            yield at_all("start", terrain.starts)
            yield Check(cls, "picture", lambda: _check_pictures(cases.all, pictures))
        case "reward":
            from flipperctl.testing import reward

            yield at_all("finite", reward.finite)
            yield at_all("bounded", reward.bounded)
            yield at_all("pure", reward.pure)
            yield at_all("arrays", reward.same_in_arrays)
        case "measure":
            from flipperctl.testing import measure

            yield at_defaults("named", measure.named)
            yield at_defaults("finite", measure.finite)
            yield at_defaults("pure", measure.pure)
        case "network":
            from flipperctl.testing import network

            yield at_all("shape", network.one_thread()(network.shape))
            yield at_all("gradient", network.one_thread()(network.gradient))
            yield at_defaults("repeats", network.repeats)
            yield at_defaults("onnx", network.exportable)
        case "controller":
            from flipperctl.testing import controller

            # A search at its largest settings may take hours.
            at_some = at_defaults if controller.looks_ahead(cls) else at_all
            yield at_some("actions", controller.actions)
            yield at_defaults("repeats", controller.repeats)
            yield at_defaults("in time", controller.in_time)
        case "sim":
            from flipperctl.testing import conventions, engine

            yield at_defaults("drives", engine.drives)
            yield at_defaults("stops", engine.stops)
            yield at_defaults("end stops", engine.end_stops)
            yield at_all("samples", engine.samples)
            yield at_all("repeats", engine.repeats)
            yield at_all("returns", engine.returns)
            yield at_defaults("rays", engine.rays)
            yield at_defaults("conventions", conventions.engine_conventions)
        case "perception":
            from flipperctl.testing import conventions, sensor

            yield at_all("senses", sensor.senses)
            yield at_all("samples", sensor.samples)
            yield at_all("repeats", sensor.repeats)
            yield at_all("returns", sensor.returns)
            yield at_defaults("portable", sensor.portable)
            yield at_defaults("conventions", conventions.sensor_conventions)
        case "logger":
            from flipperctl.testing import logger

            if issubclass(cls, Logger) and not cls.remote:
                yield at_defaults("records", logger.records)


def _check_pictures(cases: list[Variant], folder: Path | None) -> None:
    from flipperctl.testing import terrain

    run_on_variants(cases[:1], terrain.shows_ground_and_robot)
    if folder is not None:
        terrain.write_pictures(cases, folder)
