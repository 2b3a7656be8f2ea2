"""Maps of capability: which points are played, what lies between, and interruptions."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pytest

from flipperctl.config import EvalConfig
from flipperctl.evaluation.map import (
    Axis,
    CapabilityMap,
    GridPoint,
    Index,
    Play,
    _sample,
    capability_map,
    grid_config,
    parse_axes,
)
from flipperctl.evaluation.plan import Entry
from flipperctl.evaluation.play import EpisodeRunner, Player
from flipperctl.evaluation.rows import Episodes
from flipperctl.evaluation.store import EpisodeStore
from flipperctl.figures.map import boundary, map_figure
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


@pytest.mark.parametrize(("failed", "count"), [(0, 25), (2, 25), (3, 81), (17, 81), (18, 25)])
def test_a_block_is_played_where_success_differs_by_a_tenth(failed: int, count: int) -> None:
    played: list[Index] = []

    def play(points: Sequence[Index], label: str) -> Iterator[tuple[Index, Episodes]]:
        for point in points:
            played.append(point)
            outcomes = ["stuck"] * failed + ["reached"] * (20 - failed)
            yield point, episodes([sample(seed, each, 0.5) for seed, each in enumerate(outcomes)])

    _sample((9, 9), play)
    assert len(played) == count


def test_an_island_that_only_a_neighbour_sees_is_followed_into_every_block() -> None:
    # A failure at one corner of the coarse grid, and a row of failures that meets its block.
    fails = {(0, 4), *((i, 2) for i in range(17))}
    points, _ = _sample((17, 17), player(lambda c: c not in fails, []))
    assert all(points[i, 2].success == 0.0 for i in range(17))
    assert points[8, 1].success == points[8, 3].success == 1.0


def test_a_point_is_an_evaluation_with_the_values_as_overrides() -> None:
    axes = parse_axes("terrain.height=0.2:0.5:2,sim.friction=0.5:1.0:2", UPLIFT)
    found = mapped(axes)
    runner = EpisodeRunner(grid_config(UPLIFT, axes, (1, 0)), OKADA, 3)
    assert found.points[1, 0] == GridPoint.of(episodes([runner.play(0), runner.play(1)]))
    assert found.points[0, 1].success == 1.0
    assert found.points[1, 1].success == 0.0
    assert [row["terrain.height"] for row in found.rows()] == [0.2, 0.5, 0.2, 0.5]


def test_an_interrupted_map_has_the_finished_points() -> None:
    axes = parse_axes("terrain.height=0.1:0.2:2,sim.friction=0.9:1.0:2", UPLIFT)
    calls: list[bool] = []

    def stop() -> bool:  # it is asked before each request and before each of its two episodes
        calls.append(len(calls) > 2)
        return calls[-1]

    found = mapped(axes, stop)
    assert found.interrupted
    assert list(found.points) == [(0, 0)]
    drawn = map_figure(found.to_dict())
    (legend,) = drawn.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "none reached, or not played (1 of 4 points are)"
    ]


def test_the_boundary_runs_between_points_of_success_and_failure() -> None:
    first, second = [0.1, 0.2, 0.4], [0.5, 1.0]
    edges = boundary(first, second, np.array([[1.0, 0.5, 0.4], [1.0, 0.0, np.nan]]))
    assert edges.round(6).tolist() == [
        [[0.3, 0.25], [0.3, 0.75]], [[0.15, 0.75], [0.15, 1.25]], [[0.15, 0.75], [0.3, 0.75]],
    ]  # fmt: skip
    assert len(boundary(first, second, np.ones((2, 3)))) == 0


def test_a_range_and_its_number_of_values() -> None:
    first, second = parse_axes("terrain.height=0.1:0.6:6,sim.friction=0.4:1.0:3", UPLIFT)
    assert first.keys == ("terrain.height",)
    assert first.values == (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    assert (first.label, second.label) == ("terrain.height [m]", "sim.friction")
    config = grid_config(UPLIFT, (first, second), (1, 2))
    assert config.terrain.height == (0.2, 0.2)
    assert config.sim.friction == 1.0


def test_settings_joined_by_a_plus_have_one_value_and_integers_stay_integers() -> None:
    config = EvalConfig(terrain="stair")
    axes = parse_axes("terrain.steps=2:6,terrain.tread_down+terrain.tread", config)
    assert axes[0].values == (2, 3, 4, 5, 6)
    terrain = grid_config(config, axes, (4, 0)).terrain
    assert terrain.steps == (6, 6)
    assert terrain.tread == terrain.tread_down == 0.15


def test_default_ranges_surround_the_value_within_the_bounds() -> None:
    friction, noise = parse_axes("sim.friction,perception.noise", UPLIFT)
    assert (friction.values[0], friction.values[-1], len(friction.values)) == (0.5, 1.5, 20)
    assert (noise.values[0], noise.values[-1]) == (0.0, 0.2)
    below, horizon = parse_axes("perception.dropout,perception.horizon", UPLIFT)
    assert below.values[-1] == 0.95  # 1 itself is not allowed
    assert (horizon.values[0], horizon.values[-1]) == (5.0, 10.0)
