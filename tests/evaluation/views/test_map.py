"""Maps of capability: which points are played, what lies between, and interruptions."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from flipperctl.config import EvalConfig
from flipperctl.evaluation.plan import Entry
from flipperctl.evaluation.play import EpisodeRunner, Player
from flipperctl.evaluation.rows import Episodes
from flipperctl.evaluation.store import EpisodeStore, FolderStore
from flipperctl.evaluation.views.axes import Axis, grid_config, parse_axes
from flipperctl.evaluation.views.map import (
    CapabilityMap,
    GridPoint,
    Index,
    Play,
    _sample,
    boundary,
    capability_map,
    figure,
)
from flipperctl.policies.source import load_policy
from tests.evaluation.samples import episodes, sample

OKADA = load_policy("okada", "here")
UPLIFT = EvalConfig(terrain="uplift", eval={"episodes": 2, "seed": 3})


def player(reaches: Callable[[Index], bool], played: list[Index]) -> Play:
    """Return a stand-in for episodes, of which all or none of a point reach the finish."""

    def play(points: Sequence[Index], label: str) -> Iterator[tuple[Index, Episodes]]:
        for point in points:
            played.append(point)
            outcome = "reached" if reaches(point) else "stuck"
            yield point, episodes([sample(s, outcome, (1.0 + point[0]) / 2) for s in range(2)])

    return play


def mapped(
    axes: tuple[Axis, Axis],
    stop: Callable[[], bool] = lambda: False,
    store: EpisodeStore | None = None,
) -> CapabilityMap:
    with Player(store, stop=stop) as found:
        return capability_map(Entry(UPLIFT, OKADA), axes, found)


def test_points_near_the_boundary_are_played_and_the_others_interpolated() -> None:
    played: list[Index] = []
    points, complete = _sample((20, 20), player(lambda c: c[0] + c[1] < 15, played))
    assert complete
    assert len(points) == 400
    assert len(played) == len(set(played)) < 200
    for (i, j), point in points.items():
        assert point.success == float(i + j < 15)
        if abs(i + j - 15) <= 1:
            assert point.episodes == 2
        if i + j < 15:
            assert point.pitch_variation == pytest.approx(1.0 + i)
        else:
            assert point.pitch_variation is None


def test_an_island_that_only_a_neighbour_sees_is_followed_into_every_block() -> None:
    # A failure at one corner of the coarse grid, and a row of failures that meets its block.
    fails = {(0, 4), *((i, 2) for i in range(17))}
    points, _ = _sample((17, 17), player(lambda c: c not in fails, []))
    assert all(points[i, 2].success == 0.0 for i in range(17))
    assert points[8, 1].success == points[8, 3].success == 1.0


def test_a_negative_tolerance_plays_every_point() -> None:
    played: list[Index] = []
    _sample((9, 5), player(lambda c: True, played), tolerance=-1.0)
    assert len(played) == 45


def test_a_point_is_an_evaluation_with_the_values_as_overrides() -> None:
    axes = parse_axes("terrain.height=0.2:0.5:2,sim.friction=0.5:1.0:2", UPLIFT)
    found = mapped(axes)
    runner = EpisodeRunner(grid_config(UPLIFT, axes, (1, 0)), OKADA, 3)
    assert found.points[1, 0] == GridPoint.of(episodes([runner.play(0), runner.play(1)]))
    assert found.points[0, 1].success == 1.0
    assert found.points[1, 1].success == 0.0
    assert [row["terrain.height"] for row in found.rows()] == [0.2, 0.5, 0.2, 0.5]


def test_a_map_is_played_once_and_goes_on_from_its_store(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    axes = parse_axes("terrain.height=0.1:0.2:2,sim.friction=0.9:1.0:2", UPLIFT)
    first = mapped(axes, store=FolderStore(tmp_path))
    monkeypatch.setattr(EpisodeRunner, "play", lambda self, index: 1 / 0)
    assert mapped(axes, store=FolderStore(tmp_path)) == first


def test_an_interrupted_map_has_the_finished_points() -> None:
    axes = parse_axes("terrain.height=0.1:0.2:2,sim.friction=0.9:1.0:2", UPLIFT)
    calls: list[bool] = []

    def stop() -> bool:  # it is asked before each request and before each of its two episodes
        calls.append(len(calls) > 2)
        return calls[-1]

    found = mapped(axes, stop)
    assert found.interrupted
    assert list(found.points) == [(0, 0)]
    drawn = figure(found)
    assert "interrupted: 1 of 4 points" in drawn.get_suptitle()
    labels = [text.get_text() for text in drawn.legends[0].get_texts()]
    assert labels == ["2 episodes played", "none reached, or not played"]


def test_the_boundary_lies_halfway_between_success_and_failure() -> None:
    axes = parse_axes("terrain.height=0.1:0.3:3,sim.friction=0.5:1.0:2", UPLIFT)
    (line,) = boundary(axes, np.array([[1.0, 1.0, 0.0], [1.0, 0.0, 0.0]]))
    assert sorted(map(tuple, line.round(6).tolist())) == [(0.15, 1.0), (0.2, 0.75), (0.25, 0.5)]
    assert boundary(axes, np.ones((2, 3))) == []


def test_a_map_as_plain_data() -> None:
    axes = parse_axes("terrain.height=0.1:0.2:2,sim.friction=0.9:1.0:2", UPLIFT)
    points, _ = _sample((2, 2), player(lambda c: c == (0, 0), []))
    found = CapabilityMap(Entry(UPLIFT, OKADA), axes, points)
    document = found.to_dict()
    assert document["cells_played"] == 4
    assert document["cells"][0] == {
        "terrain.height": 0.1,
        "sim.friction": 0.9,
        "episodes": 2,
        "success_rate": 1.0,
        "pitch_variation_100hz": 1.0,
        "reached": 2,
        "stuck": 0,
    }
