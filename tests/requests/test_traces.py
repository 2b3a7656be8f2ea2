"""Traces of chosen episodes: the file, and what an evaluation plays once more for it."""

import json
import signal
from pathlib import Path

import numpy as np
import pytest

from flipperctl.errors import RequestError
from flipperctl.evaluation.play import EpisodeRunner
from flipperctl.rollout.trace import FILE as TRACES
from flipperctl.rollout.trace import Trace, read, write
from tests.cli.call import call
from tests.figures.test_figures import trace

HIGH = ("terrain=step", "terrain.height=0.4", "--episodes", "4")


def test_a_trace_is_read_as_it_was_written_and_unseen_heights_stay_unknown(tmp_path: Path) -> None:
    unseen = np.array([[0.25, np.nan]])
    maps = (np.array([[0.5, 0.25], [1.0, 0.0]]),)
    given = [trace(heights=unseen, maps=maps, policy="<b>&", risk=np.array([0.5])), trace(2.0, 3)]
    write(tmp_path / "one.npz", given)
    write(tmp_path / "two.npz", given)
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
    first, second = read(tmp_path / "one.npz")
    assert (first.policy, first.robot, first.bin_width) == ("<b>&", given[0].robot, 0.15)
    assert np.array_equal(first.heights, unseen, equal_nan=True)
    assert np.array_equal(first.maps[0], maps[0])
    assert (second.time.tolist(), second.maps) == ([0, 5, 10], ())
    assert second.state(2).position == pytest.approx([2.0, 0.1])


def damaged(folder: Path) -> dict[str, bytes]:
    """Files that are no traces, by name."""
    write(folder / "good.npz", [trace()])
    good = (folder / "good.npz").read_bytes()
    write(folder / "odd.npz", [trace(pitch=np.zeros(3))])
    np.savez(folder / "object.npz", header=np.array([{}]))
    header = json.dumps({"format": 2, "traces": []}).encode()
    np.savez(folder / "later.npz", header=np.frombuffer(header, np.uint8))
    names = ("odd.npz", "object.npz", "later.npz")
    return {"cut": good[: len(good) // 2], "text": b"no traces", "empty": b""} | {
        name: (folder / name).read_bytes() for name in names
    }


def test_damaged_files_are_refused_with_their_name(tmp_path: Path) -> None:
    for name, content in damaged(tmp_path).items():
        (tmp_path / "traces.npz").write_bytes(content)
        with pytest.raises(RequestError, match=r"traces\.npz: it") as error:
            read(tmp_path / "traces.npz")
        refused = "its format is 2, of another version of flipperctl; this one reads 1"
        assert (refused in str(error.value)) == (name == "later.npz")
    with pytest.raises(RequestError, match="there is no such file"):
        read(tmp_path / "none.npz")


@pytest.fixture
def again(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The indices of the episodes that are played once more."""
    played: list[int] = []
    transitions = EpisodeRunner.transitions

    def counted(self: EpisodeRunner, index: int) -> object:
        played.append(index)
        return transitions(self, index)

    monkeypatch.setattr(EpisodeRunner, "transitions", counted)
    return played


def test_eval_traces_first_and_telling_episodes_and_two_failures_and_plays_them_once(
    tmp_path: Path, again: list[int]
) -> None:
    words = ("eval", "level", *HIGH, "--baseline", "okada", "--output", "out")
    done = call(*words, cwd=tmp_path)
    assert done.code == 0, done.err
    found = read(tmp_path / "out" / TRACES)
    named = [(one.policy, one.scene, one.episode) for one in found]
    # okada crosses all; in episode 1 the pitch varies most, and level fails in both.
    assert named == [(who, "step", index) for index in (0, 1) for who in ("level", "okada")]
    assert again == [0, 1, 0, 1]
    rows = json.loads((tmp_path / "out" / "summary.json").read_text())["scenes"][0]
    assert found[2].outcome == "stuck"
    assert rows["outcomes"]["stuck"] == 4
    assert found[0].time[:3] == pytest.approx([0, 0.05, 0.1])
    assert found[0].heights.shape == (len(found[0].decided), 15)
    first, picture = found[0], (tmp_path / "out" / "step.png").read_bytes()

    again.clear()
    call(*words, cwd=tmp_path)
    assert again == []
    assert (tmp_path / "out" / "step.png").read_bytes() == picture
    (tmp_path / "out" / TRACES).write_bytes(b"damaged")
    done = call(*words[:-4], "--baseline", "none", *words[-2:], cwd=tmp_path)
    assert "traces.npz: it is damaged" in done.err
    assert again == [0, 1]
    assert same(read(tmp_path / "out" / TRACES)[0], first)


def same(one: Trace, other: Trace) -> bool:
    return np.array_equal(one.position, other.position) and one.digest == other.digest


def test_ctrl_c_keeps_the_traces_that_are_there_and_the_next_command_plays_the_rest(
    tmp_path: Path, again: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    transitions = EpisodeRunner.transitions

    def interrupted(self: EpisodeRunner, index: int) -> object:
        signal.raise_signal(signal.SIGINT)
        return transitions(self, index)

    words = ("eval", "level", *HIGH, "--baseline", "none", "--output", "out")
    with monkeypatch.context() as patched:
        patched.setattr(EpisodeRunner, "transitions", interrupted)
        done = call(*words, cwd=tmp_path)
    assert done.code == 130
    assert "interrupted: out/traces.npz lacks 1 of 2 episodes" in done.err
    assert [one.episode for one in read(tmp_path / "out" / TRACES)] == [0]
    again.clear()
    assert call(*words, cwd=tmp_path).code == 0
    assert again == [1]
    assert [one.episode for one in read(tmp_path / "out" / TRACES)] == [0, 1]
