"""Errors of a plugin's code name the plugin, whatever it raises or returns."""

import pickle
import re
from pathlib import Path

import numpy as np
import pytest
from pydantic import Field

from flipperctl import errors
from flipperctl.agent.networks import Noise, build_network, greedy
from flipperctl.api import (
    AnyTerrain,
    Controller,
    Engine,
    ObservationLayout,
    Profile,
    Terrain,
    controller,
    engine,
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
from tests.cli.call import RUN, call
from tests.long.misbehaving import unnamed
from tests.long.odd_plugins import BEFORE, RAISED, RETURNED, SPOTS, Misbehaviour
from tests.played import play_episodes

pytestmark = pytest.mark.usefixtures("registry")

FLAT = {"episode.run_out": 0.2}


def use(what: Misbehaviour, file: Path) -> None:
    """Use the plugin as the commands do, until its code has run."""
    plugins.load([file])
    defaults = resolver.defaults(resolver.get(what.kind, "odd", what.kind))
    if what.kind == "controller":
        config = with_overrides(EnvConfig(terrain="flat"), FLAT)
        source = PolicySource(settings=defaults)
    else:
        config = with_overrides(EnvConfig(terrain="flat"), FLAT)
        source = PolicySource(settings={"name": "level"})
    if what.kind == "terrain":
        config = EnvConfig(terrain="odd")
        resolver.to_dict(config.terrain)
        ground.first_difficulty(config.terrain)
        ground.next_difficulty(config.terrain, 1.0, True)
    if what.kind == "reward":
        config = with_overrides(EnvConfig(terrain="flat"), {"rewards.odd": "odd", **FLAT})
        resolver.to_dict(config.rewards["odd"])
    if what.kind == "network":
        layout = ObservationLayout()
        network = resolver.create("network", "odd", "network")
        resolver.to_dict(network)
        module = build_network(network, layout, 9).train()
        for _ in range(what.call):
            greedy(module, np.zeros(layout.size, np.float32))
        Noise(module).draw(np.random.default_rng(0))
        return
    if what.kind in ("sim", "perception"):
        config = with_overrides(config, {what.kind: "odd"})
        resolver.to_dict(config)
        Conditions.of(EvalConfig(**dict(config)))
        engine_versions(config.sim)
        look_ahead(config)
    play_episodes(config, source, episodes=1, seed=0)


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


def cases() -> list[Misbehaviour]:
    """Return each value in its place, some exceptions in each place, each exception once."""
    found = [
        Misbehaviour(kind, spot, f"return {value}", 1)
        for (kind, spot), values in RETURNED.items()
        for value in values
    ]
    spots = [(kind, spot) for kind in SPOTS for spot in (*BEFORE, *SPOTS[kind])]
    for index, statement in enumerate(RAISED):
        for offset in (0, 14):
            kind, spot = spots[(4 * index + offset) % len(spots)]
            found.append(Misbehaviour(kind, spot, statement, 1))
    return list(dict.fromkeys(found))


@pytest.mark.parametrize("what", cases(), ids=str)
def test_a_plugin_that_misbehaves_is_named(what: Misbehaviour, tmp_path: Path) -> None:
    file, marker = tmp_path / "odd_plugin.py", tmp_path / "marker"
    file.write_text(what.source(marker))
    with pytest.raises(FlipperctlError) as error, naming_plugins():
        use(what, file)
    text = str(error.value)
    assert marker.exists()
    assert "\n" not in text
    assert len(text) < 1200
    assert unnamed(what, text, file) == [], text


def test_an_interrupt_stays_one(tmp_path: Path) -> None:
    what = Misbehaviour("terrain", "generate", "raise KeyboardInterrupt", 1)
    file = tmp_path / "odd_plugin.py"
    file.write_text(what.source(tmp_path / "marker"))
    with pytest.raises(KeyboardInterrupt):
        use(what, file)
    assert call("inspect", "terrain", "odd", "--plugins", str(file), cwd=tmp_path).code == 130


def test_the_plugin_inside_another_takes_the_blame(tmp_path: Path) -> None:
    what = Misbehaviour("terrain", "generate", "raise IndexError('seven')", 1)
    file = tmp_path / "odd_plugin.py"
    file.write_text(what.source(tmp_path / "marker"))
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


@pytest.mark.parametrize(
    ("kind", "spot", "arguments"),
    [
        ("controller", "act", ["eval", "--controller", "odd", "terrain=flat", "--jobs", "2"]),
        pytest.param(
            *("network", "forward", ["train", "network=odd", "terrain=flat"]),
            marks=pytest.mark.long,
        ),
    ],
)
def test_a_worker_that_would_leave_says_why(
    kind: str, spot: str, arguments: list[str], tmp_path: Path
) -> None:
    # The network answers before the training, too, in the checks of its contract.
    file = tmp_path / "odd_plugin.py"
    what = Misbehaviour(kind, spot, "sys.exit(0)", 60 if kind == "network" else 3)
    file.write_text(what.source(tmp_path / "marker"))
    short = [f"{key}={value}" for key, value in RUN.items()] if arguments[0] == "train" else []
    more = ["--episodes", "4"] if arguments[0] == "eval" else short
    done = call(*arguments, *more, "--plugins", str(file), cwd=tmp_path)
    assert done.code == 1
    assert re.search(rf"{kind} 'odd'.*{spot} raised SystemExit: 0 \({file}:\d+\)", done.err)
    assert len(done.err.partition("error: ")[2].strip().splitlines()) == 1


def test_debug_shows_where_it_was_raised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "odd_plugin.py"
    file.write_text(Misbehaviour("terrain", "generate", "{}['key']", 1).source(tmp_path / "m"))
    monkeypatch.setenv("FLIPPERCTL_DEBUG", "1")
    with pytest.raises(PluginFailedError) as error:
        call("inspect", "terrain", "odd", "--plugins", str(file), cwd=tmp_path)
    assert isinstance(error.value.__cause__, KeyError)
