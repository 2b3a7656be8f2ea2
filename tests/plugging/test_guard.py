"""Errors of a plugin's code name the plugin, whatever it raises or returns."""

import pickle
import re
from pathlib import Path
from textwrap import indent

import numpy as np
import pytest
from pydantic import Field

from flipperctl import errors
from flipperctl.api import (
    AnyTerrain,
    Controller,
    Engine,
    Profile,
    Terrain,
    controller,
    engine,
    registry,
    terrain,
)
from flipperctl.config import EnvConfig, EvalConfig, resolver, with_overrides
from flipperctl.env import ground
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.placed import PlacedWorld
from flipperctl.errors import ConfigError, FlipperctlError, PluginFailedError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.plugging import plugins
from flipperctl.plugging.guard import attributed, naming_plugins, raise_named
from flipperctl.policies.source import PolicySource
from flipperctl.sim.versions import engine_versions
from tests.cli.call import call
from tests.played import play_episodes

pytestmark = pytest.mark.usefixtures("registry")

FLAT = {"name": "flat", "length": 0.5}
BASES = {
    "terrain": "flat", "reward": "end", "controller": "level", "sim": "planar",
    "perception": "planar",
}  # fmt: skip
"""Kind → the plugin of which all but one method is kept."""
BUILDS = {"sim": "place", "perception": "over"}
"""Kind → the method that builds what has all methods that the plugin lacks."""
PLUGIN = """
import sys
import warnings
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
import numpy as np
from pydantic import Field, field_serializer, field_validator, model_validator
from flipperctl import errors
from flipperctl.api import *
from flipperctl.api import registry

class Mine(BaseException): ...
def deep(n): return deep(n + 1) + 1

@{decorator}("odd")
class Odd(registry[{kind!r}, {base!r}]):
    'Misbehaves in one place.'
{body}
"""
BUILT = """
def {build}(self, *given):
    built = super().{build}(*given)
    class Faulty(type(built)):
{method}
    built.__class__ = Faulty
    return built
"""
BODIES = {
    "import": "raise KeyError('seven')",
    "factory": "size: float = Field(default_factory=lambda: {}['seven'])",
    "validator": "@model_validator(mode='after')\ndef whole(self): raise KeyError('seven')",
    "field validator": "@field_validator('length')\n"
    "@classmethod\n"
    "def part(cls, value): raise KeyError('seven')",
    "serialiser": "@field_serializer('length')\ndef written(self, value): raise KeyError('seven')",
}
"""Place before any method of a terrain → the lines that fail there."""


def written(kind: str, spot: str, statement: str, folder: Path) -> Path:
    """Write a plugin whose method ``spot``, or that of what it builds, is one statement."""
    is_property = spot in ("first_difficulty", "bounds", "position", "pitch")
    method = f"{'@property' * is_property}\ndef {spot}(self, *given): {statement}"
    if kind in BUILDS and not hasattr(registry[kind, BASES[kind]], spot):
        method = BUILT.format(build=BUILDS[kind], method=indent(method, 8 * " "))
    file = folder / "odd_plugin.py"
    decorator = {"sim": "engine", "perception": "sensor"}.get(kind, kind)
    names = {"decorator": decorator, "kind": kind, "base": BASES[kind]}
    file.write_text(PLUGIN.format(**names, body=indent(BODIES.get(spot, method), 4 * " ")))
    return file


def use(kind: str, file: Path) -> None:
    """Use the plugin as the commands do, until its code has run."""
    plugins.load([file])
    changes = {"reward": {"rewards.odd": "odd"}, "sim": {"sim": "odd"}}
    changes |= {
        "perception": {"perception": "odd"},
        "terrain": {"terrain": {**FLAT, "name": "odd"}},
    }
    config = with_overrides(EnvConfig(terrain=FLAT), changes.get(kind, {}))
    resolver.to_dict(config)
    ground.first_difficulty(config.terrain)
    ground.next_difficulty(config.terrain, 1.0, True)
    Conditions.of(EvalConfig(**dict(config)))
    engine_versions(config.sim)
    look_ahead(config)
    driver = "odd" if kind == "controller" else "level"
    play_episodes(config, PolicySource(settings={"name": driver}), episodes=1, seed=0)


def look_ahead(config: EnvConfig) -> None:
    """Use a world as a controller that looks ahead, probes and pictures do."""
    env = FlipperEnv(config=config, render_mode="rgb_array")
    env.reset(seed=0)
    simulator = env.simulator()
    simulator.load(simulator.save())
    simulator.perceive_exactly()
    env.render()
    assert env.drive.world.position[0] == env.state.position[0]
    assert env.drive.world.pitch == env.state.pitch


def named(kind: str, spot: str, statement: str, folder: Path) -> str:
    """Return the one line of the error, which names place, plugin and method."""
    file = written(kind, spot, statement, folder)
    with pytest.raises(FlipperctlError) as error, naming_plugins():
        use(kind, file)
    text = str(error.value)
    assert "\n" not in text
    assert len(text) < 1200
    assert re.search(re.escape(str(file)) + r":\d+", text), text
    assert "odd" in text.replace(str(file), "") or spot == "import", text
    assert spot in text or spot in BODIES, text
    return text


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        ("raise ValueError", "(generate, "),  # by which a terrain refuses its settings
        ("raise Mine('seven')", "raised Mine: seven"),
        ("raise errors.ConfigError('seven')", "raised ConfigError: seven"),
        ("raise StopIteration('seven')", "raised StopIteration: seven"),
        ("raise GeneratorExit('seven')", "raised GeneratorExit: seven"),
        ("raise BrokenProcessPool('seven')", "raised BrokenProcessPool: seven"),
        ("raise RuntimeError('a\\nb\\tc\\x00d')", "raised RuntimeError: a b c?d"),
        ("raise ValueError('x' * 10**6)", "xxx...xxx"),
        ("sys.exit(0)", "raised SystemExit: 0"),
        ("deep(0)", "raised RecursionError: maximum recursion depth"),
        ("np.zeros(10**14)", "MemoryError: Unable to allocate"),
        ("Profile('x')", "a profile is (V, 2) points"),
        ("Odd(length=-1)", "Odd.length: Input should be greater than 0"),
    ],
)
def test_whatever_a_plugin_raises_is_named(statement: str, words: str, tmp_path: Path) -> None:
    assert words in named("terrain", "generate", statement, tmp_path)


@pytest.mark.parametrize(
    ("kind", "spot"),
    [
        *(("terrain", spot) for spot in BODIES),
        ("reward", "__call__"),
        ("reward", "bounds"),
        ("controller", "build"),
        ("controller", "act"),
        ("sim", "place"),
        ("sim", "command"),
        ("sim", "save"),
        ("perception", "sense"),
    ],
)
def test_it_is_named_wherever_it_fails(kind: str, spot: str, tmp_path: Path) -> None:
    assert "KeyError: 'seven'" in named(kind, spot, "raise KeyError('seven')", tmp_path)


RETURNED = {
    ("terrain", "generate"): (
        "Profile([])",
        "Profile([(-1e300, 0), (1e300, 0)])",
        "Profile([(0, 0), (5000, 0)])",
        "Profile([(0, 0), (1, 101)])",
        "Profile(np.stack([np.linspace(0, 900, 90_000), np.arange(90_000) % 2], 1))",
    ),
    ("terrain", "at"): ("None",),
    ("terrain", "first_difficulty"): ("1j", "2.0"),
    ("terrain", "next_difficulty"): ("None",),
    ("reward", "bounds"): ("None", "(1.0, 0.0)"),
    ("sim", "place"): ("None", "Odd"),
    ("sim", "position"): ("(1.0,)", "('a', 'b')", "(10**400, 0)"),
    ("sim", "pitch"): ("'1.0'", "float('nan')"),
    ("sim", "advance"): (
        "None",
        "np.empty((0, 5))",
        "np.zeros((given[0], 4))",
        "np.zeros((given[0] + 1, 5))",
        "np.full((given[0], 5), np.nan)",
    ),
    ("sim", "state"): (
        "RobotState",
        "replace(super().state(), time='x')",
        "replace(super().state(), position=np.zeros(3))",
        "replace(super().state(), velocity=np.array([np.inf, 0]))",
    ),
    ("sim", "penetration"): ("None",),
    ("sim", "versions"): ("{'a': 1}",),
    ("sim", "files_read"): ("('x',)",),
    ("perception", "over"): ("None",),
    ("perception", "exact"): ("Odd(bins=3)",),
    ("perception", "sense"): ("super().sense(*given)[:1]",),
    ("controller", "build"): ("None", "Controller"),
    ("controller", "act"): ("float('nan')",),
}
"""Kind and method → expressions that it must not return."""


@pytest.mark.parametrize(
    ("kind", "spot", "value"),
    [(*key, value) for key, values in RETURNED.items() for value in values],
)
def test_what_a_plugin_must_not_return_is_named(
    kind: str, spot: str, value: str, tmp_path: Path
) -> None:
    named(kind, spot, f"return {value}", tmp_path)


def test_an_interrupt_stays_one(tmp_path: Path) -> None:
    file = written("terrain", "generate", "raise KeyboardInterrupt", tmp_path)
    with pytest.raises(KeyboardInterrupt), naming_plugins():
        use("terrain", file)
    assert call("inspect", "terrain", "odd", "--plugins", str(file), cwd=tmp_path).code == 130


def test_the_plugin_inside_another_takes_the_blame(tmp_path: Path) -> None:
    file = written("terrain", "generate", "raise IndexError('seven')", tmp_path)
    plugins.load([file])
    config = EnvConfig(terrain={"name": "mirror", "terrain": {"name": "mix", "parts": ["odd"]}})
    line = 1 + next(i for i, t in enumerate(file.read_text().splitlines()) if "seven" in t)
    with pytest.raises(PluginFailedError) as error, naming_plugins():
        ground.generate_profile(config.terrain, np.random.default_rng(0), 1.0)
    assert str(error.value) == f"terrain 'odd': generate raised IndexError: seven ({file}:{line})"


def test_an_error_of_a_plugin_is_its_own() -> None:
    @terrain("moody")
    class Moody(Terrain):
        def generate(self, rng: np.random.Generator) -> Profile:
            rng.random()  # the seed is told of what depends on it
            raise KeyError("seven")

    @terrain("patient")
    class Patient(Terrain):
        inner: AnyTerrain = Field("moody", validate_default=True, description="terrain [-]")

        def generate(self, rng: np.random.Generator) -> Profile:
            with pytest.raises(KeyError, match="seven"):
                self.inner.labelled(rng)
            return Profile([(0.0, 0.0)])

    rng = np.random.default_rng(0)
    with pytest.raises(KeyError, match="seven"):
        FlipperEnv(terrain="moody").reset(seed=3)
    with pytest.raises(PluginFailedError) as error, naming_plugins():
        FlipperEnv(terrain="moody").reset(seed=3)
    place = rf"{re.escape(__file__)}:\d+"
    text = (
        rf"terrain 'moody': generate raised KeyError: 'seven' \({place}\); the episode's seed is 3"
    )
    assert re.fullmatch(text, str(error.value))
    patient = EnvConfig(terrain="patient").terrain
    assert ground.generate_profile(patient, rng, 1.0).label == "patient"


def test_what_a_plugin_built_is_named_by_the_plugins_beside_it() -> None:
    """The innermost call is named: that of a world, not of the planner that simulates in it."""

    class World:
        def command(self, *given: object) -> None: ...

        def advance(self, *given: object) -> None:
            raise IndexError("seven")

    @controller("thinking")
    class Thinking(Controller):
        def act(self, p: object) -> int:
            return PlacedWorld(None, World(), checked=False).advance(3)

    @engine("broken")
    class Broken(Engine):
        def place(self, profile: object, robot: object, start: object, rng: object) -> World:
            return World()

    Thinking.__module__ = "elsewhere"
    text = r"^sim 'broken': advance raised IndexError: seven"
    with pytest.raises(PluginFailedError, match=text), naming_plugins():
        Thinking().act(None)


def test_without_a_plugin_an_error_stays_as_it_is() -> None:
    with pytest.raises(ValueError, match="could not convert"), naming_plugins():
        float("x")
    assert attributed(KeyboardInterrupt()) is None


def test_an_error_of_the_core_passes_through_a_plugin() -> None:
    okada = resolver.create("controller", "okada", "controller")
    with pytest.raises(ConfigError) as raised:
        resolver.get("terrain", "no such", "terrain")
    with pytest.raises(ConfigError, match="there is no terrain plugin 'no such'"):
        raise_named(raised.value, okada, "begin")


@pytest.mark.parametrize(
    "cls",
    [c for c in vars(errors).values() if isinstance(c, type) and issubclass(c, FlipperctlError)],
    ids=lambda c: c.__name__,
)
def test_every_error_comes_back_whole_from_another_process(cls: type[FlipperctlError]) -> None:
    again = pickle.loads(pickle.dumps(cls("what, where")))
    assert type(again) is cls
    assert str(again) == "what, where"
    assert again.exit_code == cls.exit_code


def test_a_worker_that_would_leave_says_why(tmp_path: Path) -> None:
    file = written("controller", "act", "sys.exit(0)", tmp_path)
    words = ("eval", "--controller", "odd", "terrain=flat", "--jobs", "2", "--episodes", "4")
    done = call(*words, "--plugins", str(file), cwd=tmp_path)
    assert done.code == 1
    assert re.search(rf"controller 'odd'.*act raised SystemExit: 0 \({file}:\d+\)", done.err)
    assert len(done.err.partition("error: ")[2].strip().splitlines()) == 1


def test_debug_shows_where_it_was_raised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = written("terrain", "generate", "{}['key']", tmp_path)
    monkeypatch.setenv("FLIPPERCTL_DEBUG", "1")
    with pytest.raises(PluginFailedError) as error:
        call("inspect", "terrain", "odd", "--plugins", str(file), cwd=tmp_path)
    assert isinstance(error.value.__cause__, KeyError)
