"""An engine and a sensor of a user's file work in evaluation and training."""

from pathlib import Path

import pytest

from flipperctl.api import registry
from flipperctl.plugging import plugins
from flipperctl.testing import checks
from tests.cli.call import RUN, call

EXAMPLES = Path(__file__).parents[2] / "examples"
KINEMATIC, RULER = EXAMPLES / "kinematic.py", EXAMPLES / "ruler.py"
SENSORS = EXAMPLES / "inertial.py", EXAMPLES / "scanner.py"
LOADED = ["--plugins", str(KINEMATIC), "--plugins", str(RULER)]
CHOSEN = ["sim=kinematic", "perception=ruler", *LOADED]


@pytest.mark.long
def test_a_policy_is_trained_and_resumed_in_another_engine(tmp_path: Path) -> None:
    settings = [f"{key}={value}" for key, value in RUN.items()]
    done = call("train", "terrain=step", "hydra.run.dir=run", *settings, *CHOSEN, cwd=tmp_path)
    assert done.code == 0, done.err
    evaluate = ["eval", "--checkpoint", "run", "--episodes", "1", "--json"]
    missing = call(*evaluate, cwd=tmp_path)
    assert missing.code == 2
    assert "kinematic" in missing.err
    assert call(*evaluate, *LOADED, cwd=tmp_path).code == 0


def test_any_setting_of_the_engine_is_sampled_and_no_other(tmp_path: Path) -> None:
    asked = ["eval", "--controller", "level", "randomise.sim.friction=[0.8,1.2]", "--episodes", "1"]
    done = call(*asked, *CHOSEN, cwd=tmp_path)
    assert done.code == 2
    assert "randomise.sim.friction: sim=kinematic has no setting 'friction'" in done.err
    drawn = ["eval", "--controller", "level", "randomise.sim.slowdown=[0.2,0.3]", "--episodes", "1"]
    done = call(*drawn, "--output", "out", *CHOSEN, cwd=tmp_path)
    assert "randomised sim.slowdown 0.2 to 0.3" in done.out
    header = (tmp_path / "out" / "episodes.csv").read_text().splitlines()[0]
    assert "sim.slowdown" in header.split(",")


@pytest.mark.long
@pytest.mark.usefixtures("registry")
def test_engine_and_sensors_keep_the_contract() -> None:
    plugins.load([KINEMATIC, RULER, *SENSORS])
    sensors = (registry["perception", name] for name in ("ruler", "inertial", "scanner"))
    for check in checks(registry["sim", "kinematic"], *sensors):
        check()


@pytest.mark.usefixtures("registry")
def test_an_engine_without_end_stops_breaks_the_contract(tmp_path: Path) -> None:
    text = KINEMATIC.read_text()
    free = text.replace("limit = self._robot.angle_limit", "limit = math.pi")
    assert free != text
    (tmp_path / "free.py").write_text(free)
    plugins.load([tmp_path / "free.py"])
    (check,) = (c for c in checks(registry["sim", "kinematic"]) if c.name == "end stops")
    with pytest.raises(AssertionError, match=r"turns the flippers to 1\.35 rad .* limit is ±1\.05"):
        check()
