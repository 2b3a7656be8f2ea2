"""Tables at any width: no number is cut, and no line is longer than the console."""

import io
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.cells import cell_len

from flipperctl import bench, show
from flipperctl.cli import inspect
from flipperctl.cli.hydra.sweeps import print_comparison
from flipperctl.evaluation.views import evaluation
from flipperctl.show import Column, PlainConsole, Table, console, print_table
from flipperctl.terminal import tables
from flipperctl.terminal.progress import pitch_variation_text
from flipperctl.training.sweep import SweepRun
from tests.cli.call import call

SCENE = ["terrain=flat", "--episodes", "1"]
COMMANDS = {
    "eval": ["eval", "okada", "terrain=flat", "conditions=nominal,varied", "--episodes", "3",
             "--baseline", "level", "--passable", "level", "--columns", "all",
             "--by", "start_shift"],
    "several": ["eval", "okada", "level", *SCENE],
    "engines": ["eval", "level", *SCENE, "sim=planar,mujoco"],
    "map": ["map", "level", "terrain=uplift", "--episodes", "1",
            "--over", "terrain.height=0.1:0.3:2,sim.friction=0.4:1.0:2"],
    "ranking": ["inspect", "reward", "--compare", "okada,level", *SCENE, "rewards=paper,tuned"],
    "regret": ["inspect", "reward", "--regret", "--controller", "okada", "--against", "level",
               *SCENE],
    "audit": ["inspect", "reward", *SCENE, "conditions=varied"],
    "terrain": ["inspect", "terrain", "stair", "--draws", "3"],
    "plugins": ["inspect", "plugins", "planar"],
    "checks": ["inspect", "plugins", "swing", "--check"],
    "conventions": ["inspect", "checkpoint", "generalist", "--check", "sim=planar"],
    "config": ["inspect", "config", "--describe"],
    "compare": ["compare", "judged"],
}  # fmt: skip
TIMES = {"p50": 12.3, "p99": 45.6}
SENSED = {
    "source": "bag", "seconds": 12.34, "topics": {"lidar": "/points", "imu": "/imu/data"},
    "scans": 120, "refused": {"late": {"count": 3, "reason": "it is older than the newest one"}},
    "decisions": 20, "held": {"no ground": 2}, "coverage": {"mean": 0.91, "least": 0.52},
    "filled": 0.08, "deviation": 0.0123, "estimate_ms": TIMES, "scan_ms": TIMES, "pose": "matched",
    "drift": {"share": 0.012, "way": 5.43, "horizontal": 0.065, "height": -0.02, "heading": 0.01},
    "remarks": ["a remark"],
}  # fmt: skip
FAULTS = {"stale": {"count": 2, "seconds": 1.2, "reason": "no cloud is newer than 0.5 s"}}
SHADOW = SENSED | {"policy": "p.onnx", "states": {"ready": 11.1}, "faults": FAULTS, "output": "log"}
RATE = {"median": 1234.5, "low": 1200.25, "high": 1300.75, "unit": "1/s"}
RATIO = {"ratio": 1.234, "low": 1.111, "high": 1.345}
BENCH = {
    "about": "how long a decision takes on this machine, and how long the simulation of it takes",
    "quantities": {"a decision of the policy in the simulation": RATE}, "ratios": {"both": RATIO},
}  # fmt: skip
BEST = {"decision": 7, "success_rate": 0.9, "pitch_variation_100hz": 1.234,
        "pitch_variation": 1.111, "t_cost": 21.5}  # fmt: skip
RUN = {"run": "runs/stair", "running": False, "summary": None, "validations": [
    BEST | {"mean_return": 12.34, "return": 10.0}
]}  # fmt: skip
OURS = {"terrain": "paper_stair", "policy": "generalist", "success": "93.3 % [85.1, 97.1]",
        "time": 41.21, "variation": 4.53, "range": 2.6}  # fmt: skip
SWEPT = {"agent.learning_rate": "0.0003", "network": "convolutional", "seed": "12"}
SUMMARY = {"best": BEST, "decisions": 60000, "seconds": 1234.5, "finished": True}
DOCUMENTS: dict[str, Callable[[], None]] = {
    "check": lambda: tables.print_perception(SENSED, None),
    "shadow": lambda: tables.print_shadow(SHADOW),
    "bench": lambda: print_table(bench.table("latency", BENCH), console()),
    "run": lambda: inspect._print(RUN, None),
    "published": lambda: print_table(Table(evaluation._PUBLISHED, [OURS], "Published"), console()),
    "sweep": lambda: print_comparison(
        Path("sweep"), [SweepRun(0, SWEPT, Path("sweep/0_all_of_these_settings"), None, SUMMARY)]
    ),
}
"""What commands print that need a recording, minutes or several trainings."""
MADE_BY = {
    *(
        "cli/hydra/sweeps.py",
        "cli/inspect.py",
        "terminal/tables.py",
        "testing/conventions.py",
        "bench.py",
    ),
    *(f"evaluation/views/{view}.py" for view in ("audit", "compare", "engines", "evaluation")),
    *(f"evaluation/views/{view}.py" for view in ("ranking", "regret", "strata")),
}
"""The files whose tables are covered here; ``card.py`` has its tables in Markdown alone."""


def printed(table: Table, width: int) -> list[str]:
    stream = io.StringIO()
    print_table(table, PlainConsole(file=stream, width=width))
    return stream.getvalue().splitlines()


def rates() -> Table:
    columns = [
        Column("terrain", "terrain", named=True),
        Column("success", "success"),
        Column("outcomes", "outcomes", wrapped=True),
        Column("time", "time of the reached [s]", 1),
    ]
    interval = {"mean": 12.04, "low": 9.1, "high": 14.9}
    rows = [
        {"terrain": "stair", "success": "83 %", "outcomes": "reached 5 stuck 10", "time": interval},
        {"terrain": "  gap", "success": "100 %", "outcomes": "reached 3", "time": None},
    ]
    return Table(columns, rows, "okada", ["a note of several words"])


def test_a_wide_console_shows_a_line_for_each_row() -> None:
    assert printed(rates(), 80) == [
        "okada",
        "terrain  success  outcomes            time of the reached [s]",
        "stair    83 %     reached 5 stuck 10  12.0 [9.1, 14.9]",
        "  gap    100 %    reached 3           –",
        "a note of several words",
    ]


def test_headings_and_sentences_are_broken_before_columns_continue_below() -> None:
    assert printed(rates(), 50)[1:5] == [
        "terrain  success  outcomes        time of the",
        "                                  reached [s]",
        "stair    83 %     reached 5       12.0 [9.1, 14.9]",
        "                  stuck 10",
    ]
    assert printed(rates(), 34)[1:] == [
        "terrain  success  outcomes",
        "stair    83 %     reached 5",
        "                  stuck 10",
        "  gap    100 %    reached 3",
        "terrain  time of the",
        "         reached [s]",
        "stair    12.0 [9.1, 14.9]",
        "  gap    –",
        "a note of several words",
    ]


names = st.text("aθ̂é[.…", min_size=1, max_size=12)
sentences = st.lists(names, min_size=1, max_size=5).map(" ".join)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(names, names, names, sentences), min_size=1, max_size=3), st.data())
def test_every_word_is_printed_whole_at_every_width(
    rows: list[tuple[str, ...]], data: st.DataObject
) -> None:
    width = data.draw(st.integers(40, 120))
    columns = [Column(str(at), "two words", named=at == 0, wrapped=at == 3) for at in range(4)]
    table = Table(columns, [dict(zip("0123", row, strict=True)) for row in rows])
    lines = printed(table, width)
    assert {word for row in rows for cell in row for word in cell.split()} <= {
        word for line in lines for word in line.split()
    }
    assert max(map(cell_len, lines)) <= width


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which ``judged`` has results of several methods."""
    found = tmp_path_factory.mktemp("tables")
    words = ["terrain=flat,step", "--episodes", "2", "--output", "judged"]
    done = call("eval", "okada", "level", "random", *words, cwd=found)
    assert done.code == 0, done.err
    return found


@pytest.mark.parametrize("name", [*COMMANDS, *DOCUMENTS])
def test_no_table_breaks_a_line_or_cuts_a_number(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made: list[Table] = []
    lines = show.lines
    monkeypatch.setattr(show, "lines", lambda table, to: made.append(table) or lines(table, to))
    monkeypatch.setenv("COLUMNS", "80")
    if name in COMMANDS:
        done = call(*COMMANDS[name], cwd=folder)
        assert done.code == 0, done.err
        text = done.out
    else:
        DOCUMENTS[name]()
        text = capsys.readouterr().out
    assert made or name == "map"
    long = [line for line in text.splitlines() if cell_len(line) > 80]
    assert [line for line in long if "/" not in line] == []  # paths are not broken
    monkeypatch.undo()
    for table in made:
        texts = [printed(table, width) for width in (80, 100, 1000)]
        assert max(map(cell_len, texts[0])) <= 80
        assert max(map(cell_len, texts[1])) <= 100
        narrow, middle, wide = (set(re.findall(r"\d+\.\d+", "\n".join(text))) for text in texts)
        assert narrow == middle == wide


def test_every_file_that_makes_a_table_is_covered() -> None:
    package = Path(show.__file__).parent
    found = {
        file.relative_to(package).as_posix()
        for file in package.rglob("*.py")
        if re.search(r"\bTable\(", file.read_text()) and file.name not in ("show.py", "card.py")
    }
    assert found == MADE_BY


def test_pitch_variation_at_100_hz_comes_first_and_that_of_decisions_beside_it() -> None:
    both = {"pitch_variation": 1.125, "pitch_variation_100hz": 1.375}
    assert pitch_variation_text(both, 3) == "θ̂_R 1.375 rad (1.125 at decisions)"


def test_a_setting_that_the_training_left_open_is_null(capsys: pytest.CaptureFixture[str]) -> None:
    found = {
        **{"bytes": 1, "observations": 1, "largest_q_value": 1.0, "largest_difference": 0.0},
        **{"allowed_difference": 1e-4, "action_agreement": 1.0},
        "robot_changes": {
            "payload": {"training": None, "file": 5.0},
            "track_speed": {"training": 0.2, "file": 0.3},
        },
    }
    tables.print_export(Path("a.onnx"), Path("run"), found)
    text = capsys.readouterr().out
    assert "robot.payload 5 kg (training null)" in text
    assert "robot.track_speed 0.3 m/s (training 0.2)" in text
