"""Maps of capability: which cells are played, what lies between, and interruptions."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pytest

from flipperctl.config import EvalConfig
from flipperctl.evaluation.axes import cell_config, parse_axes
from flipperctl.evaluation.capability import CapabilityMap, Cell, Index, PlayCells, sample_cells
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.episodes import play_episodes
from flipperctl.evaluation.map_cells import capability_map
from flipperctl.policies.source import PolicySource
from flipperctl.report.capability import boundary, capability_figure
from tests.evaluation.samples import sample

OKADA = PolicySource.of_plugin("okada", "here")
UPLIFT = EvalConfig(terrain="uplift", eval={"episodes": 2, "seed": 3})


def player(reaches: Callable[[Index], bool], played: list[Index]) -> PlayCells:
    """Return a stand-in for episodes, of which all or none of a cell reach the finish."""

    def play(cells: Sequence[Index], label: str) -> Iterator[tuple[Index, Sequence[EpisodeResult]]]:
        for cell in cells:
            played.append(cell)
            outcome = "reached" if reaches(cell) else "stuck"
            yield cell, [sample(seed, outcome, (1.0 + cell[0]) / 2) for seed in range(2)]

    return play


def test_cells_near_the_boundary_are_played_and_the_others_interpolated() -> None:
    played: list[Index] = []
    cells, complete = sample_cells((20, 20), player(lambda c: c[0] + c[1] < 15, played))
    assert complete
    assert len(cells) == 400
    assert len(played) == len(set(played)) < 200
    for (i, j), cell in cells.items():
        assert cell.success == float(i + j < 15)
        if abs(i + j - 15) <= 1:
            assert cell.episodes == 2
        if i + j < 15:
            assert cell.pitch_variation == pytest.approx(1.0 + i)
        else:
            assert cell.pitch_variation is None


def test_an_island_that_only_a_neighbour_sees_is_followed_into_every_block() -> None:
    # A failure at one corner of the coarse grid, and a row of failures that meets its block.
    fails = {(0, 4), *((i, 2) for i in range(17))}
    cells, _ = sample_cells((17, 17), player(lambda c: c not in fails, []))
    assert all(cells[i, 2].success == 0.0 for i in range(17))
    assert cells[8, 1].success == cells[8, 3].success == 1.0


def test_a_negative_tolerance_plays_every_cell() -> None:
    played: list[Index] = []
    sample_cells((9, 5), player(lambda c: True, played), tolerance=-1.0)
    assert len(played) == 45


def test_a_cell_is_an_evaluation_with_the_values_as_overrides() -> None:
    axes = parse_axes("terrain.height=0.2:0.5:2,sim.friction=0.5:1.0:2", UPLIFT)
    found = capability_map(UPLIFT, OKADA, axes)
    alone = play_episodes(cell_config(UPLIFT, axes, (1, 0)), OKADA, episodes=2, seed=3)
    assert found.cells[1, 0] == Cell.of(list(alone))
    assert found.cells[0, 1].success == 1.0
    assert found.cells[1, 1].success == 0.0
    assert [row["terrain.height"] for row in found.rows()] == [0.2, 0.5, 0.2, 0.5]


def test_an_interrupted_map_has_the_finished_cells() -> None:
    axes = parse_axes("terrain.height=0.1:0.2:2,sim.friction=0.9:1.0:2", UPLIFT)
    calls: list[bool] = []

    def stop() -> bool:
        calls.append(len(calls) > 0)
        return calls[-1]

    found = capability_map(UPLIFT, OKADA, axes, stop=stop)
    assert found.interrupted
    assert list(found.cells) == [(0, 0)]
    figure = capability_figure(found)
    assert "interrupted: 1 of 4 cells" in figure.get_suptitle()
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["2 episodes played", "none reached, or not played"]


def test_the_boundary_lies_halfway_between_success_and_failure() -> None:
    axes = parse_axes("terrain.height=0.1:0.3:3,sim.friction=0.5:1.0:2", UPLIFT)
    (line,) = boundary(axes, np.array([[1.0, 1.0, 0.0], [1.0, 0.0, 0.0]]))
    assert sorted(map(tuple, line.round(6).tolist())) == [(0.15, 1.0), (0.2, 0.75), (0.25, 0.5)]
    assert boundary(axes, np.ones((2, 3))) == []


def test_a_map_as_plain_data() -> None:
    axes = parse_axes("terrain.height=0.1:0.2:2,sim.friction=0.9:1.0:2", UPLIFT)
    cells, _ = sample_cells((2, 2), player(lambda c: c == (0, 0), []))
    found = CapabilityMap("okada", "uplift", axes, cells, 2, 3, Conditions.of(UPLIFT))
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
