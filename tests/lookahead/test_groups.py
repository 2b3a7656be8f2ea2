"""Groups of valued states: their shapes, what hides the ground ahead, and the flippers' stops."""

import numpy as np
import pytest

from flipperctl.api import (
    ACTIONS,
    ObservationLayout,
    RewardTerm,
    StateGroups,
    action_index,
)
from flipperctl.config import resolver
from flipperctl.lookahead.graph import Graph
from flipperctl.lookahead.value_iteration_policy import SIZE, sample_groups, with_stops
from tests.lookahead.scenes import STEP, graph_of

LAYOUT = ObservationLayout()
COUNT = 80


@pytest.fixture(scope="module")
def graph() -> Graph:
    found = resolver.create("reward", "end", "rewards")
    assert isinstance(found, RewardTerm)
    return graph_of(STEP, {"end": found})


def sampled(graph: Graph, seed: int = 0, off_path: float = 0.4, unseen: float = 0.0) -> StateGroups:
    return sample_groups(
        graph,
        STEP.extended(3.0, 3.0),
        LAYOUT,
        np.random.default_rng(seed),
        count=COUNT,
        off_path=off_path,
        unseen=unseen,
        way=0.12,
    )


def test_groups_are_finite_and_repeat_themselves(graph: Graph) -> None:
    groups, again, other = sampled(graph), sampled(graph), sampled(graph, seed=1)
    assert groups.observations.shape == (COUNT, SIZE, LAYOUT.size)
    assert groups.values.shape == (COUNT, SIZE, len(ACTIONS))
    assert groups.observations.dtype == groups.values.dtype == np.float32
    assert np.isfinite(groups.observations).all()
    assert np.isfinite(groups.values).all()
    assert np.array_equal(groups.values, again.values)
    assert not np.array_equal(groups.values, other.values)


def test_values_are_those_of_represented_states(graph: Graph) -> None:
    known = {row.tobytes() for row in with_stops(graph.values).astype(np.float32)}
    rows = sampled(graph).values.reshape(-1, len(ACTIONS))
    assert all(row.tobytes() in known for row in rows)
    assert len(np.unique(rows, axis=0)) > 100


def test_the_states_of_a_group_share_what_they_see(graph: Graph) -> None:
    """They lie within 0.3 m: the face of 0.2 m is at most two bins away from another's."""
    heights = sampled(graph).observations[:, :, : LAYOUT.bins]
    edge = np.abs(np.diff(heights, axis=2)).argmax(axis=2)
    seen = np.abs(np.diff(heights, axis=2)).max(axis=2).min(axis=1) > 0.08
    assert seen.sum() > 10
    assert np.ptp(edge[seen], axis=1).max() <= 2


def test_off_path_states_are_worse_than_those_of_the_best_way(graph: Graph) -> None:
    near, anywhere = (sampled(graph, off_path=p).values.max(axis=2).mean() for p in (0.0, 1.0))
    assert near > anywhere


def test_what_is_unseen_is_level_ground_ahead_alone(graph: Graph) -> None:
    seen, hidden = sampled(graph), sampled(graph, unseen=1.0)
    middle, bins = LAYOUT.bins // 2, LAYOUT.bins
    assert np.array_equal(hidden.values, seen.values)
    here = slice(0, middle + 1)
    assert np.array_equal(hidden.observations[:, :, here], seen.observations[:, :, here])
    assert np.array_equal(hidden.observations[:, :, bins:], seen.observations[:, :, bins:])
    changed = hidden.observations[:, :, :bins] != seen.observations[:, :, :bins]
    assert 0.1 < changed.any(axis=(1, 2)).mean() < 1.0
    for group, same in zip(hidden.observations, ~changed.any(axis=1), strict=True):
        first = int(np.flatnonzero(~same)[0]) if not same.all() else bins
        assert (group[:, first:bins] == group[:, first - 1 : first]).all()
    part = sampled(graph, unseen=0.5).observations
    untouched = (part == seen.observations).all(axis=(1, 2)).mean()
    assert untouched > (hidden.observations == seen.observations).all(axis=(1, 2)).mean()


def test_a_turn_beyond_a_stop_has_the_value_of_not_making_it() -> None:
    """Both pairs at their upper stops: (1, ·) is (0, ·), (·, 1) is (·, 0), (1, 1) is (0, 0)."""
    values = np.array([[float(10 * i + j) for i, j in ACTIONS]])
    values[0, [action_index(i, j) for i, j in ACTIONS if 1 in (i, j)]] = -np.inf
    found = with_stops(values)[0]
    for i, j in ACTIONS:
        assert found[action_index(i, j)] == 10 * min(i, 0) + min(j, 0)
    assert np.isneginf(values).sum() == 5  # the argument is left alone


@pytest.mark.parametrize("stop", [-1, 1])
@pytest.mark.parametrize("pair", ["front", "rear"])
def test_only_the_pair_at_its_stop_stays(pair: str, stop: int) -> None:
    values = np.array([[float(10 * i + j) for i, j in ACTIONS]])
    at_stop = [a for a in ACTIONS if a[0 if pair == "front" else 1] == stop]
    values[0, [action_index(*a) for a in at_stop]] = -np.inf
    found = with_stops(values)[0]
    for i, j in at_stop:
        stays = (0, j) if pair == "front" else (i, 0)
        assert found[action_index(i, j)] == 10 * stays[0] + stays[1]


def test_a_stop_of_one_pair_leaves_the_other_s_turn() -> None:
    values = np.arange(9.0)[None]
    values[0, [action_index(-1, j) for j in (-1, 0, 1)]] = -np.inf  # the front is at its stop
    found = with_stops(values)[0]
    for j in (-1, 0, 1):
        assert found[action_index(-1, j)] == found[action_index(0, j)]
