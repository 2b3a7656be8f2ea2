"""No energy from nowhere: episodes of ``python -m tests.long.energy``, the worst included."""

import math
from pathlib import Path

import numpy as np
import pytest

from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.sim.planar import joints
from flipperctl.sim.planar import joints as energy
from tests.long.energy import Balance, measure, read_log, run, table, violations

START = {"start_noise": 0.1, "start_angle_noise": 0.1}


def balance(terrain: str, seed: int, actions: int) -> Balance:
    return measure(FlipperEnv(terrain, episode=START), seed, actions)


# The first three were thrown away from between two faces before the bounds were introduced: they
# gained 2,146, 1,696 and 171 J in 10 ms.
@pytest.mark.parametrize(
    ("terrain", "seed", "actions"),
    [("plum", 100441, 100441), ("rail", 100466, 100467), ("pallet", 100479, 100479), ("gap", 3, 3)],
)
def test_no_sample_gains_more_energy_than_the_drives_give(
    terrain: str, seed: int, actions: int
) -> None:
    found = balance(terrain, seed, actions)
    assert violations([found]) == []
    assert found.excess <= energy.TOLERANCE + 1e-6
    assert found.gain < 5.5  # servos 1.75, belts at most 2.65, tolerance 1


def test_without_bounds_a_wedged_robot_is_thrown_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(joints, "_IMPULSE_SPEED", math.inf)
    monkeypatch.setattr(joints, "_CLOSING_SPEED", math.inf)
    monkeypatch.setattr(energy, "TOLERANCE", math.inf)
    found = balance("plum", 100441, 100441)
    assert found.gain > 1000.0
    assert violations([found]) == [found]


def test_energies_by_hand() -> None:
    # 2 kg at 3 m with (3, 4) m/s and 5 rad/s of 0.4 kg m²: 25 + 5 J, and 2 · 10 · 3 = 60 J.
    states, inertia = np.array([0.0, 3.0, 0.1, 3.0, 4.0, 5.0]), np.array([[2.0, 0.4]])
    assert energy.kinetic_energy(states, inertia) == pytest.approx(30.0)
    assert energy.potential_energy(states, inertia, 10.0) == pytest.approx(60.0)
    factor = energy.slowdown(30.0, 22.5)  # a quarter is left
    assert factor == pytest.approx(0.5)
    states[3:] *= factor
    assert energy.kinetic_energy(states, inertia) == pytest.approx(7.5)
    assert energy.slowdown(30.0, 40.0) == 0.0


@pytest.mark.parametrize("engine", ["plain", "compiled"])
def test_a_gain_that_no_drive_gave_is_taken_from_the_velocities(
    engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(energy, "TOLERANCE", -1e6)  # as if all of it came from nowhere
    env = FlipperEnv("flat", sim={"engine": engine})
    env.reset(seed=0)
    world = env.drive.world
    world.advance(20)
    assert world.state().velocity == pytest.approx([0.0, 0.0])
    assert world.state().pitch_rate == 0.0


def test_a_run_of_the_long_check_is_resumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "log.csv"
    assert run(1, ["step"], 1, log) == 0
    first = read_log(log)
    assert list(first) == [("step", 100000)]
    assert run(2, ["step"], 1, log) == 0
    later = read_log(log)
    assert list(later) == [("step", 100000), ("step", 100001)]
    assert later["step", 100000] == first["step", 100000]
    shown = capsys.readouterr()
    assert "1 of 1, step, 0 s left" in shown.err
    assert "2 episodes, 0 violations" in shown.out
    assert "100001" in table(list(later.values()))
