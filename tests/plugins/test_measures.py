"""Measures against numbers worked by hand.

A measure given with ``--plugins`` appears in rows, files, JSON, tables, comparisons, validations.
"""

import csv
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import Field

from flipperctl.api import Measure, Profile, Robot, RobotState, Transition, action_index, measure
from flipperctl.config import resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import NonFiniteError, PluginError, PluginFailedError
from flipperctl.evaluation.evaluate import evaluate
from flipperctl.evaluation.plan import Entry, Plan
from flipperctl.plugging import plugins
from flipperctl.requests.plan import scenes
from flipperctl.requests.text import from_words
from flipperctl.rollout.episode import play
from flipperctl.training.listeners import columns
from flipperctl.views.evaluation import csv_rows, document, tables
from tests.cli.call import call
from tests.evaluation.samples import result as made
from tests.evaluation.samples import sample

ROBOT = Robot()  # hinges at ±0.28 m, axles of 0.336 m, tracks of radius 0.1 m, 35 kg and 2 × 5 kg
FLAT = Profile([(0.0, 0.0)])
UP = math.pi / 3


def value(name: str, episode: Sequence[Transition]) -> float:
    made = resolver.create("measure", name, name)
    assert isinstance(made, Measure)
    return made(episode)


def state(x: float = 0.0, z: float = 0.1, pitch: float = 0.0, **more: Any) -> RobotState:
    fields = {"front": 0.0, "rear": 0.0, **more}
    fields |= {"velocity": np.array([0.2, 0.0]), "pitch_rate": 0.0, "time": 0.0}
    return RobotState(np.array([x, z]), pitch, **fields)


def decision(
    after: RobotState,
    before: RobotState | None = None,
    path: Any = ((0, 0, 0), (0, 0, 0)),
    robot: Robot = ROBOT,
) -> Transition:
    fields = {"profile": FLAT, "robot": robot, "action": (0, 0), "pitches": np.zeros(2)}
    return Transition(before or state(), after, path=np.array(path, float), **fields)


def test_the_energy_margin_is_the_rise_of_the_centre_of_mass_until_it_tips() -> None:
    # The track touches as long as its gap is at most 1 cm: up to √(0.11² − 0.1²) = 0.0458 m past
    # the hinge at 0.28 m, so the last point of the 2 cm grid is at 0.32 m. Both pairs raised by
    # 60° have their mass 0.168·sin 60° = 0.1455 m up, which lifts the centre by 10/45 of it.
    height = 0.1 + 10 / 45 * 0.168 * math.sin(UP)
    expected = math.hypot(0.32, height) - height
    standing = decision(state(front=UP, rear=UP))
    assert value("energy_margin_min", [standing]) == pytest.approx(expected, abs=1e-9)
    # In the air, and with the centre of mass ahead of every contact, nothing holds it.
    flying = decision(state(z=1.0))
    assert value("energy_margin_min", [standing, flying]) == 0.0
    assert value("energy_margin", [standing, flying]) == pytest.approx(expected / 2)
    on_its_nose = decision(state(z=0.1 + 0.28 * math.sin(1.2), pitch=-1.2, front=UP, rear=UP))
    assert value("energy_margin_min", [on_its_nose]) >= 0.0


def test_the_energy_margin_includes_the_load() -> None:
    # 60 kg of 105 kg, 0.3 m ahead and 0.4 m up: the centre moves by 4/7 of both, the raised pairs
    # lift it by 10/105 of theirs, and the front contact at 0.32 m (above) is the nearer.
    loaded = Robot(payload=60, payload_x=0.3, payload_z=0.4)
    height = 0.1 + 4 / 7 * 0.4 + 10 / 105 * 0.168 * math.sin(UP)
    expected = math.hypot(0.32 - 4 / 7 * 0.3, height) - height
    standing = decision(state(front=UP, rear=UP), robot=loaded)
    assert value("energy_margin", [standing]) == pytest.approx(expected, abs=1e-9)
    # Upright on the rear tip, which is 0.28 + 0.336 below the chassis and touches up to 0.04 m on
    # both sides: what is ahead in the robot is above, and what is above is behind.
    upright = state(z=0.1 + 0.28 + 0.336, pitch=math.pi / 2)
    height = 0.716 + 4 / 7 * 0.3
    expected = math.hypot(0.04 - 4 / 7 * 0.05, height) - height
    loaded = Robot(payload=60, payload_x=0.3, payload_z=0.05)
    assert value("energy_margin", [decision(upright, robot=loaded)]) == pytest.approx(expected)
    # Nose up by 0.3 rad on a slope: 1.9 m above the chassis moves the centre 4/7 · 0.561 = 0.321 m
    # behind it, past the rear contact at 0.326 cos 0.3 - 0.1 sin 0.3 = 0.282 m.
    slope = Profile([(-5.0, -5 * math.tan(0.3)), (5.0, 5 * math.tan(0.3))])
    lying = state(z=0.1 / math.cos(0.3), pitch=0.3, front=UP, rear=UP)
    for load, holds in ((-1.9, True), (1.9, False)):
        on_slope = decision(lying, robot=Robot(payload=60, payload_z=load))
        assert (value("energy_margin", [replace(on_slope, profile=slope)]) > 0) == holds


def test_an_impact_is_the_change_of_velocity_within_10_ms() -> None:
    # 0.2 m/s forward, then 0.1 m/s forward and 0.3 m/s down: √(0.1² + 0.3²), across decisions.
    first = decision(state(), path=[(0, 0, 0), (0.002, 0, 0), (0.004, 0, 0)])
    second = decision(state(), path=[(0.004, 0, 0), (0.005, -0.003, 0), (0.006, -0.006, 0)])
    assert value("largest_impact", [first, second]) == pytest.approx(math.hypot(0.1, 0.3))
    assert value("largest_impact", [first]) == pytest.approx(0.0, abs=1e-12)


def test_roll_counts_at_decisions() -> None:
    rolls = (0.1, -0.2, 0.05)
    episode = [decision(state(roll=after), state(roll=before)) for before, after in pairwise(rolls)]
    assert value("roll_variation_decisions", episode) == pytest.approx(0.3 + 0.25)
    assert value("max_roll", episode) == 0.2
    assert value("max_roll", [decision(state(roll=0.05), state(roll=-0.3))]) == 0.3


def test_standing_still_is_slower_than_a_tenth_of_the_belts() -> None:
    # Of 0.2 m/s: 0.2 mm in 10 ms. Two samples are slower, one is not.
    path = [(0, 0, 0), (0, 0.0001, 0), (0.00015, 0.0001, 0), (0.00045, 0.0001, 0)]
    assert value("standstill", [decision(state(), path=path)]) == pytest.approx(0.02)


def test_the_pitch_reserve_is_what_is_left_to_a_third_of_pi() -> None:
    path = [(0, 0, 0.1), (0, 0, -0.5), (0, 0, 0.2)]
    assert value("pitch_reserve", [decision(state(), path=path)]) == pytest.approx(UP - 0.5)


@pytest.mark.parametrize("sim", ["planar", "mujoco"])
def test_the_energy_of_the_flippers_is_torque_times_angle(sim: str) -> None:
    # The flippers lift the robot, while the belts carry part of it up their round ends and other
    # parts of the work are lost: the work is near m·g·Δz, of 74 J.
    env = FlipperEnv("flat", sim=sim, episode={"start_noise": 0})
    env.reset(seed=0)
    before = env.drive.world.position[1]
    episode = []
    for action in (action_index(-1, -1), action_index(-1, -1), action_index(0, 0)):
        env.step(action)
        assert env.transition is not None
        episode.append(env.transition)
    lifted = env.drive.world.position[1] - before
    assert lifted > 0.1  # both pairs turned by 30° below the chassis: 0.336·sin 30° = 0.168 m
    weight = 45 * 9.81
    found = value("flipper_energy", episode)
    assert weight * lifted < found < weight * lifted * 1.6
    # The last decision holds the flippers, which costs torque but hardly any work.
    assert episode[-1].flipper_work is not None
    assert episode[-1].flipper_work < 0.1 * found


MAPPING = {"map_error", "map_error_below", "drift", "unseen"}


def measured(sim: str = "planar", **perception: object) -> dict[str, float]:
    env = FlipperEnv({"name": "flat", "length": 0.5}, sim=sim, perception=perception)
    env.reset(seed=1)
    while True:
        *_, terminated, truncated, info = env.step(4)
        if terminated or truncated:
            found: dict[str, float] = info["metrics"]
            return found


def test_roll_variation_at_100_hz_is_of_engines_in_3_d_alone() -> None:
    swaying = [replace(decision(state()), roll_variation=change) for change in (0.3, 0.2)]
    assert value("roll_variation_100hz", swaying) == pytest.approx(0.5)
    assert "roll_variation_100hz" not in measured("planar")
    metrics = measured("mujoco")
    assert metrics["roll_variation_100hz"] >= metrics["roll_variation_decisions"]


def test_roll_variation_stands_beside_pitch_variation_where_the_engine_is_in_3_d() -> None:
    rolls = {"roll_variation_decisions": 0.5, "roll_variation_100hz": 0.8}
    ours = [sample(seed, "reached", 1.0, **rolls) for seed in range(3)]
    others = [
        sample(seed, "reached", 1.0, **rolls | {"roll_variation_100hz": 1.0}) for seed in range(3)
    ]
    table, *_ = tables(document(made(ours, {"level": others})), "mine")
    assert [column.heading for column in table.columns][-3:] == [
        *("pitch variation [rad]", "roll variation [rad]", "time [s]")
    ]
    (note,) = table.notes
    assert "pitch variation +0.00 rad, roll variation -0.20 rad" in note


def episode(bias: float) -> list[Transition]:
    """Decisions of a sensor whose heights are wrong by ``bias`` [m], as if it mapped the ground."""
    env = FlipperEnv("step", perception={"bias": bias})
    env.reset(seed=1)
    made = []
    for _ in range(3):
        env.step(4)
        perceived = env.transition.perception
        assert perceived is not None
        seen = np.arange(15) >= 3
        position = env.transition.before.position * 1.5
        mapped = replace(perceived, seen=seen, position=position)
        made.append(replace(env.transition, perception=mapped))
    return made


def test_a_constant_error_of_the_heights_is_the_map_error() -> None:
    made = episode(0.03)
    assert value("map_error", made) == pytest.approx(0.03, abs=1e-3)
    assert value("map_error_below", made) == pytest.approx(0.03, abs=1e-3)
    assert value("unseen", made) == pytest.approx(3 / 15)
    driven = made[-1].before.position - made[0].before.position
    assert value("drift", made) == pytest.approx(0.5 * np.hypot(*driven))


def test_only_evaluations_of_mapping_sensors_have_them() -> None:
    words = ["terrain=flat", "terrain.length=0.5", "eval.episodes=1"]
    chosen = scenes(from_words([*words, "perception=planar,lidar"]), None, "level")
    found = document(evaluate(Plan.of_one([Entry(*scene) for scene in chosen])))
    planar, lidar = found["scenes"]
    assert not MAPPING & planar.keys()
    assert lidar.keys() > MAPPING
    rows = list(csv_rows(found))
    assert ["map_error" not in row for row in rows] == [True, False]
    assert not MAPPING & {*columns()}
    assert measured(name="planar").keys() & MAPPING == set()


EXAMPLE = str(Path(__file__).parents[2] / "examples" / "highest.py")


def test_eval_shows_it_everywhere(tmp_path: Path) -> None:
    flat = ["eval", "--controller", "level", "terrain=flat", "--episodes", "5"]
    more = ["--baseline", "okada", "--output", "out", "--columns", "highest", "--plugins", EXAMPLE]
    done = call(*flat, *more, cwd=tmp_path)
    assert done.code == 0, done.err
    for text in ("highest [m]", "0.100 [0.100, 0.100]"):
        assert text in done.out
    out = tmp_path / "out"
    (scene,) = json.loads((out / "summary.json").read_text())["scenes"]
    # The chassis rests with its tracks' radius of 0.1 m above the ground.
    assert scene["highest"]["mean"] == pytest.approx(0.1, abs=1e-3)
    difference = {"mean": 0.0, "low": 0.0, "high": 0.0, "episodes": 5}
    assert scene["baseline"]["difference"]["highest"] == difference
    for name in ("episodes.csv", "table.csv"):
        with (out / name).open(newline="") as file:
            values = [float(row["highest"]) for row in csv.DictReader(file)]
        assert values == pytest.approx([0.1] * len(values), abs=1e-3)


@pytest.mark.parametrize(
    ("name", "value", "error", "words"),
    [
        ("odd", "float('nan')", NonFiniteError, "measure 'odd': __call__ returned nan"),
        ("odd", "'much'", PluginFailedError, "measure 'odd': __call__ returned 'much'"),
        ("controller", "1.0", PluginError, "files have another column or key 'controller'"),
    ],
)
def test_a_measure_that_fails_is_named(
    name: str, value: str, error: type[Exception], words: str, registry: dict, tmp_path: Path
) -> None:
    file = tmp_path / "odd.py"
    file.write_text(
        "from flipperctl.api import Measure, measure\n"
        f"@measure({name!r})\n"
        "class Odd(Measure):\n"
        '    """An odd measure."""\n'
        "    def __call__(self, episode):\n"
        f"        return {value}\n"
    )
    plugins.load([file])
    level = resolver.create("controller", "level", "controller").build()
    with pytest.raises(error, match=words) as caught:
        play(FlipperEnv("flat"), level, 0)
    assert "odd.py" in str(caught.value)


def test_a_measure_gets_the_whole_episode_as_it_was(registry: dict) -> None:
    @measure("kept")
    class Kept(Measure):
        """The number of transitions whose pitches end with their own [-]."""

        def __call__(self, episode: Sequence[Transition]) -> float:
            ends = [len(t.pitches) == k + 2 for k, t in enumerate(episode)]
            own = [t.pitches[-2:].tolist() == [t.before.pitch, t.after.pitch] for t in episode]
            return sum(ends) + sum(own)

    row = play(FlipperEnv("flat"), resolver.create("controller", "level", "controller").build(), 0)
    assert row["kept"] == 2 * row["decisions"]


def test_a_measure_takes_no_settings() -> None:
    class Tuned(Measure):
        """A measure with a setting."""

        above: float = Field(1.0, ge=0, le=2, description="height [m]")

    with pytest.raises(TypeError, match="has the settings above; every measure is computed"):
        measure("tuned")(Tuned)
