"""A measure given with --plugins appears in rows, files, JSON, tables, comparisons, validations."""

import csv
import json
from collections.abc import Sequence
from pathlib import Path

import pytest
from pydantic import Field

from flipperctl import plugins
from flipperctl.api import Measure, Transition, measure
from flipperctl.config import resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import NonFiniteError, PluginError, PluginFailedError
from flipperctl.rollout.episode import play
from tests.cli.call import call

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
        ("odd", "1 / 0", PluginFailedError, "measure 'odd': __call__ raised ZeroDivisionError"),
        ("odd", "float('nan')", NonFiniteError, "measure 'odd': __call__ returned nan"),
        ("odd", "'much'", PluginFailedError, "measure 'odd': __call__ returned 'much'"),
        ("friction", "1.0", PluginError, "files have another column or key 'friction'"),
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
