"""``plot``: figures of runs, results and maps, and what it refuses."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import flipperctl
from flipperctl.api import RobotGeometry
from flipperctl.errors import RequestError
from flipperctl.figures.figure import places
from flipperctl.requests.drawing import draw, length
from flipperctl.rollout.trace import Trace
from flipperctl.rollout.trace import write as write_traces
from flipperctl.views.plot import Request
from tests.cli.call import call, refused
from tests.cli.test_compare import write


@pytest.fixture
def here(tmp_path: Path) -> Path:
    """Return a folder with results of two methods, a run and a map."""
    for seed in range(3):
        label = f"runs/{seed}/best"
        write(tmp_path / "judged" / f"{seed}", {label: 1 + seed / 10, "level": 2.0}, failed=3)
    (tmp_path / "run").mkdir()
    rows = [f"episode,{10 * at},reached,,{at % 7},{at}" for at in range(1, 30)]
    rows += [f"validation,{100 * at},,1.0,{at},{at}" for at in range(1, 4)]
    text = "kind,decision,outcome,success_rate,pitch_variation_100hz,return\n" + "\n".join(rows)
    (tmp_path / "run/metrics.csv").write_text(text)
    (tmp_path / "found").mkdir()
    names = ("terrain.height", "sim.friction")
    axes = [
        {"name": name, "settings": [name], "unit": unit, "values": [0.2, 0.4]}
        for name, unit in zip(names, ("m", "-"), strict=True)
    ]
    cells = [
        {names[0]: x, names[1]: y, "success_rate": float(x < 0.3), "episodes": int(y < 0.3)}
        | {"pitch_variation_100hz": 1.0 if x < 0.3 else None}
        for x in (0.2, 0.4)
        for y in (0.2, 0.4)
    ]
    (tmp_path / "found/map.json").write_text(json.dumps({"axes": axes, "cells": cells}))
    return tmp_path


def drawn(here: Path, *sources: str, **options: object) -> Figure:
    paths = [name + str(here / path) for name, path in (split(one) for one in sources)]
    own = {name: options.pop(name) for name in ("kind", "style") if name in options}
    return draw(Request(paths, **options), **own).figure  # type: ignore[arg-type]


def split(source: str) -> tuple[str, str]:
    name, equals, path = source.rpartition("=")
    return name + equals, path


def xs(axes: Axes, line: int) -> list[float]:
    found: list[float] = np.asarray(axes.get_lines()[line].get_xdata()).tolist()
    return found


@pytest.mark.parametrize(
    ("source", "kind"),
    [
        ("run", "curves"),
        ("judged", "intervals"),
        ("judged", "heat"),
        ("judged", "differences"),
        ("judged", "profiles"),
        ("found", "map"),
    ],
)
def test_each_kind_is_a_pdf_that_publishers_take(
    source: str, kind: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Several publishers refuse Type 3 fonts, matplotlib's default."""
    chosen = ("--kind", kind) if kind not in ("curves", "intervals", "map") else ()
    monkeypatch.setattr("sys.argv", ["flipperctl", "plot", source, *chosen])
    done = call("plot", source, *chosen, cwd=here)
    assert done.code == 0, done.err
    assert (done.out, done.err.splitlines()[-1]) == ("", f"wrote {kind}.pdf")
    file = (here / f"{kind}.pdf").read_bytes()
    assert b"/Type3" not in file
    assert b"/TrueType" in file or b"/CIDFontType2" in file
    assert f"flipperctl plot {source}".encode() in file  # as metadata
    assert b"/MediaBox [ 0 0 252 " in file  # 3.5 in


def test_names_sizes_and_words(here: Path) -> None:
    figure = drawn(here, "AT-D3QN=judged", names=["still=level"], width=7.16)
    assert figure.get_figwidth() == 7.16
    success, variation = figure.axes
    assert [text.get_text() for text in success.get_yticklabels()] == ["AT-D3QN", "still"]
    assert success.get_xlabel() == "Success [%]"
    assert variation.get_xlabel().startswith("Pitch variation $")
    paper, slide = (drawn(here, "judged", style=style) for style in ("paper", "slides"))
    sizes = [one.axes[0].xaxis.label.get_fontsize() for one in (paper, slide)]
    assert sizes[1] > 2 * sizes[0]


def test_intervals_are_those_of_the_episodes_that_all_seeds_reached(here: Path) -> None:
    """Seeds have means 1.0, 1.1 and 1.2, and a tenth of the episode's number; the fourth failed."""
    figure = drawn(here, "judged")
    success, variation = (xs(axes, 1) for axes in figure.axes)
    assert variation == pytest.approx([1.1 + (28 - 3) / 7 / 10])
    assert success == pytest.approx([100 * 7 / 8])


def test_differences_are_to_level_and_show_failures_apart(here: Path) -> None:
    axes = drawn(here, "judged", kind="differences").axes[0]
    dots, level_alone, method_alone = (xs(axes, line) for line in range(3))
    assert dots == pytest.approx([-0.9] * 7)
    assert (len(level_alone), len(method_alone)) == (0, 1)
    assert method_alone[0] > max(dots)


def test_a_method_has_one_colour_whatever_is_left_out(here: Path) -> None:
    def colour(figure: Figure, line: int = -1) -> Any:
        return figure.axes[0].get_lines()[line].get_color()

    still = colour(drawn(here, "judged", only=["level"]))
    assert still == colour(drawn(here, "judged"))
    assert still == colour(drawn(here, "judged", kind="profiles", only=["level"]))
    # So has a curve.
    (here / "b").mkdir()
    (here / "b/metrics.csv").write_text((here / "run/metrics.csv").read_text())
    (here / "c").mkdir()
    (here / "c/metrics.csv").write_text((here / "run/metrics.csv").read_text())
    three = drawn(here, "A=run", "B=b", "C=c")
    assert colour(drawn(here, "A=run", "B=b", "C=c", only=["B", "C"])) == colour(three)
    # Rules have places of their own, from the end; trained policies take the others in order.
    rules = ["geometric", "greedy", "hfc", "level", "mpc", "ohno", "okada"]
    found = places(["mine", "level", "okada", "yours"], rules)
    assert found == {"level": 3, "okada": 0, "mine": 1, "yours": 2}
    assert places(["okada", "level", "yours"], rules)["level"] == found["level"]


def test_a_profile_ends_at_the_largest_value_and_at_the_success_rate(here: Path) -> None:
    axes = drawn(here, "judged", kind="profiles").axes[0]
    assert axes.get_xlim()[1] == pytest.approx(1.02 * 2.7)
    shares = np.asarray(axes.get_lines()[0].get_ydata())
    assert shares[-1] == pytest.approx(100 * 7 / 8)


def test_cells_of_a_heat_table_tell_the_success_below_all(here: Path) -> None:
    axes = drawn(here, "judged", kind="heat").axes[0]
    assert [text.get_text() for text in axes.texts] == ["1.46\n87.5 %", "2.35"]


def traced(policy: str, outcome: str = "reached", metres: float = 3.0) -> Trace:
    time = np.linspace(0.0, 10.0, 201)
    flat = np.zeros(201)
    return Trace(
        policy=policy, scene="step", outcome=outcome, robot=RobotGeometry(),
        ground=np.array([[0.0, 0.0], [0.0, 0.2], [2.0, 0.2]]), time=time,
        position=np.column_stack([np.linspace(-1, metres - 1, 201), flat + 0.1]),
        pitch=flat + 0.5, front=flat, rear=flat, decided=np.array([0.0]),
        actions=np.zeros((1, 2)), heights=np.zeros((1, 15)), bin_width=0.15,
    )  # fmt: skip


def test_policies_on_one_episode(here: Path) -> None:
    """Of a method with several seeds the first is drawn; a cross ends a failure."""
    policies = ("s/network=mlp, seed 1", "s/network=mlp, seed 2", "level")
    every = [traced(policies[0], "stuck"), *map(traced, policies[1:])]
    write_traces(here / "judged/traces.npz", every)
    series = drawn(here, "judged", kind="series", names=["MLP=s/network=mlp"])
    (legend,) = series.legends
    assert [text.get_text() for text in legend.get_texts()] == ["MLP", "level"]
    pitch = series.axes[0]
    assert [line.get_marker() for line in pitch.get_lines()] == ["None", "X", "None"]
    assert np.asarray(pitch.get_lines()[0].get_ydata())[0] == pytest.approx(28.6, abs=0.1)
    first, second = drawn(here, "judged", kind="poses", only=["level", "mlp"]).axes
    assert [axes.get_title("left") for axes in (first, second)] == ["level", "mlp: stuck"]
    assert [text.get_text() for text in first.texts] == [
        "0.0 s", "2.0 s", "4.0 s", "6.0 s", "8.0 s", "10.0 s",
    ]  # fmt: skip
    # A failure comes after an episode that both finish; of these, the pitch of 2 varies.
    shaken = replace(traced("level"), episode=2, pitch=np.sin(np.linspace(0, 9, 201)))
    other = [replace(trace, episode=index) for index in (1, 2) for trace in every[1:2]]
    lone = [replace(traced("level"), episode=index) for index in (1, 7)]
    write_traces(here / "judged/traces.npz", [*every, *other, shaken, *lone])
    first, second = drawn(here, "judged", kind="series").axes[0].get_lines()
    assert np.ptp(np.asarray(second.get_ydata())) > 90
    done = call("plot", "judged", "--kind", "poses", "--episode", "7", cwd=here)
    assert "step, episode 7: there is no trace of mlp, whose traces are of 0 to 2" in done.err
    for words, text in (
        (["--episode", "7", "--only", "mlp", "--only", "level"], "there is no trace of mlp, whose"),
        (["--scene", "stair"], "--scene: there is no trace of 'stair'; known: step"),
        (["--episode", "9"], "--episode: there is no trace of '9'; known: 0, 1, 2, 7"),
        (["--only", "lev"], "did you mean 'level'?"),
    ):
        assert text in refused("plot", "judged", "--kind", "poses", *words, cwd=here)


def test_from_python(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figure = flipperctl.plot(here / "judged", names={"still": "level"}, width="18cm")
    assert figure.get_figwidth() == pytest.approx(18 / 2.54)
    assert capsys.readouterr().out == ""
    with pytest.raises(RequestError, match="nothing is named to draw"):
        flipperctl.plot()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("none",), "none: there is no such folder; allowed: runs or the folder of a sweep"),
        (("empty",), "empty: there is nothing to draw in it"),
        (
            ("run", "--kind", "heat"),
            "drawn from a folder of flipperctl eval --output; of run: curves",
        ),
        (("judged", "run"), "--kind intervals: it is drawn from a folder of flipperctl eval"),
        (("judged", "--kind", "heat", "--metric", "success,t_cost"), "this kind shows one metric"),
        (("judged", "--name", "level=judged"), "would both be called level"),
        (("judged", "--against", "level"), "it has a meaning for --kind differences alone"),
        (("judged", "--kind", "differences", "--against", "lev"), "did you mean 'level'?"),
        (("run", "--width", "1in"), "--width 1in: 2in to 30in are allowed"),
        (("run", "--output", "a.jpg"), "a picture is a .pdf, .png or .svg file"),
    ],
)
def test_refusals(words: tuple[str, ...], text: str, here: Path) -> None:
    (here / "empty").mkdir()
    error = refused("plot", *words, cwd=here)
    assert text in error
    assert error.count("\n") == 1
    assert not list(here.glob("*.pdf"))


def test_lengths() -> None:
    assert [length(text) for text in ("3.5in", "252pt", "8.89cm", "88.9 mm")] == pytest.approx(
        [3.5] * 4
    )


def test_scenes_of_one_terrain_have_the_names_of_the_tables(here: Path) -> None:
    """They are told apart by their conditions, whose hashes stand in no figure."""
    for scene in ("dry", "wet"):
        write(here / scene, {"level": 2.0})
    first, second = ((here / scene / "episodes.csv").read_text() for scene in ("dry", "wet"))
    second = second.partition("\n")[2].replace("abcd", "ef01")
    (here / "dry/episodes.csv").write_text(first + second)
    scenes = [
        {"terrain": "stair", "controller": "level", "suite_scene": name}
        | {"conditions": {"name": "nominal", "hash": digest, "sim": same, "perception": same}}
        for name, digest, same in (("dry", "abcd", {"name": "a"}), ("wet", "ef01", {"name": "a"}))
    ]
    (here / "dry/summary.json").write_text(json.dumps({"scenes": scenes}))
    labels = [text.get_text() for text in drawn(here, "dry").axes[0].get_yticklabels()]
    assert labels == ["stair, dry", "stair, wet"]
