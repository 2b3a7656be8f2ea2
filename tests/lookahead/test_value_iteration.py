"""Values of every reachable state of a short course, and groups of states with their values."""

import numpy as np
import pytest

from flipperctl.api import (
    ACTIONS,
    FloatArray,
    ObservationLayout,
    Outcome,
    RewardTerm,
    Robot,
    StateGroups,
    action_index,
)
from flipperctl.config import resolver
from flipperctl.config.reward_sum import RewardSum
from flipperctl.lookahead import value_iteration as graphs
from flipperctl.lookahead.model import TARGETS, TURNS, Model, Nodes, transitions
from flipperctl.lookahead.value_iteration import SIZE, Course, Graph, sample_groups, with_stops
from tests.lookahead.scenes import (
    FINISH,
    FLAT,
    GAMMA,
    PATIENCE,
    ROBOT,
    START,
    STEP,
    WALL,
    graph_of,
    model_of,
    standing,
)

R = 10.0
"""Settlement of the term ``end`` [-]."""


def terms(**weights: float) -> dict[str, RewardTerm]:
    """Return ``end`` and the terms of these names and weights."""
    made = {"end": resolver.create("reward", "end", "rewards")}
    for name, weight in weights.items():
        made[name] = resolver.create("reward", {"name": name, "weight": weight}, "rewards")
    return made


@pytest.fixture(scope="module")
def step() -> Graph:
    return graph_of(STEP, terms(swing=4.0))


def at_the_start(graph: Graph) -> int:
    """Return the state at the start whose flippers are level."""
    x, targets = graph.nodes.places[:, 0], graph.nodes.states[:, TARGETS:]
    away = np.abs(x - START) + np.abs(targets).sum(axis=1)
    return int(away.argmin())


def test_values_are_those_of_a_chain_by_hand() -> None:
    """Two states, then the end; the third is not explored any further."""
    none = -np.inf
    reward = np.array([[1.0, 3.0, none], [5.0, none, 2.0], [none, none, none]])
    kept = np.array([[0.5, 0.25, 0.0], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
    child = np.array([[1, 2, -1], [-1, -1, 0], [-1, -1, -1]])
    values = graphs._iterated(reward, kept, child)
    # The closed state has the lowest reward, 1. V1 = max(5, 2 + V0 / 2), V0 = max(1 + V1 / 2,
    # 3 + 1 / 4): V0 = 3.5 with V1 = 5.
    assert values[0] == pytest.approx([3.5, 3.25, none])
    assert values[1] == pytest.approx([5.0, none, 2.0 + 3.5 / 2])
    assert values[2].max() == 1.0


def test_the_values_solve_their_own_equation(step: Graph) -> None:
    """Q = r + kept · max Q(child) for the decisions from every 7th state."""
    rows = np.arange(0, len(step.nodes), 7)
    edges = step._decide(step.nodes.take(rows))
    found = step.values[rows[edges.parent], edges.action]
    expected = edges.reward + edges.factor * np.where(edges.child < 0, 0.0, step.best[edges.child])
    assert found == pytest.approx(expected, abs=2e-3)
    assert np.array_equal(edges.child, step.child[rows[edges.parent], edges.action])
    assert (edges.factor[edges.child >= 0] <= GAMMA).all()


def test_turns_beyond_a_stop_have_no_value(step: Graph) -> None:
    targets = step.nodes.states[:, None, TARGETS:] + TURNS * ROBOT.angle_step
    beyond = (np.abs(targets) > ROBOT.angle_limit + 0.01) & (TURNS != 0)
    assert np.array_equal(np.isneginf(step.values), beyond.any(axis=2))
    assert 0.05 < beyond.any(axis=2).mean() < 0.6


def test_the_best_actions_lead_over_the_step_and_earn_their_value(step: Graph) -> None:
    """The walk is simulated without cells; each action is that of the nearest represented state."""
    model, rewards = model_of(STEP), RewardSum(terms(swing=4.0))
    node = step.nodes.take(np.array([at_the_start(step)]))
    value, earned, outcome, discount = float(step.best[at_the_start(step)]), 0.0, None, 1.0
    for _ in range(40):
        row = step.lookup(node)[0]
        assert row >= 0
        action = step.values[row].argmax(keepdims=True)
        targets = node.states[:, TARGETS:] + TURNS[action] * ROBOT.angle_step
        branch = model.expand(node.states, targets, ROBOT.decision_period, poses=True)
        after = node.after(branch, action, ROBOT.decision_period)
        ts = transitions(node, after, branch, STEP, ROBOT)
        earned += discount * float(rewards.array(ts)[0])
        discount, node, outcome = discount * GAMMA, after, ts[0].outcome
        if outcome is not None:
            break
    assert outcome is Outcome.REACHED
    assert node.places[0, 0] >= FINISH
    assert earned == pytest.approx(value, abs=0.2)


def test_before_a_wall_all_that_is_left_is_to_stand() -> None:
    """The episode ends as stuck with probability 1/20 at each decision.

    The friction is too low for the tracks to climb the wall until the robot overturns.
    """
    graph = graph_of(WALL, terms(), friction=0.3)
    hazard = 1 / PATIENCE
    stands = -hazard * R / (1 - (1 - hazard) * GAMMA)  # V = -R/20 + 19/20 γ V, -8.4
    start = graph.best[at_the_start(graph)]
    assert stands < start < -R / 2  # rocking against the wall delays the end, but not for ever
    assert graph.best.max() < -R / 3
    assert graph.best.min() >= -R - 2e-3


def test_a_state_without_a_cell_of_its_own_has_that_of_its_neighbours(step: Graph) -> None:
    own = np.arange(len(step.nodes))
    assert np.array_equal(step.lookup(step.nodes), own)
    higher = step.nodes.moved_to(shifted(step.nodes, 0.0, 0.1), own)
    found = step.lookup(higher)
    keys = np.array(step._keys(step.nodes))
    asked = np.array(step._keys(higher))
    beside = [row for row in own if tuple(asked[row]) not in step._cells and found[row] >= 0]
    assert len(beside) > 100
    off = np.abs(keys[found[beside]] - asked[beside])
    assert off.max() == 1
    assert (off[:, 3:] == 0).all()  # the flippers' targets are the same
    assert (off.sum(axis=1) == 1).mean() > 0.5


def test_a_state_far_from_all_represented_ones_is_unknown(step: Graph) -> None:
    assert step.lookup(shifted(step.nodes.take(np.arange(5)), 0.0, 2.0)).tolist() == [-1] * 5
    assert step.lookup(standing(model_of(STEP), FINISH + 5.0, 0.3)).tolist() == [-1]


def shifted(nodes: Nodes, x: float, z: float) -> Nodes:
    """Return the nodes moved by x and z [m]."""
    by: FloatArray = np.array([x, z])
    states = nodes.states.copy()
    states[:, :2] += by
    fields = {**vars(nodes), "states": states, "places": nodes.places + by}
    return Nodes(**fields)


def test_ground_with_more_states_than_are_explored_says_so(
    step: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert step.unexplored == 0.0
    monkeypatch.setattr(graphs, "_MOST", 200)
    assert 0.0 < graph_of(STEP, terms(swing=4.0)).unexplored < 1.0


def test_long_flippers_begin_above_the_ground() -> None:
    robot = Robot(flipper_length=1.2)
    found = Graph.__new__(Graph)
    found._course, found._robot = Course(FLAT, start=-1.0, finish=1.0, patience=9), robot
    found._model = Model(FLAT.points, robot)
    roots = found._roots()
    lowest = roots.places[:, 1].max()  # with both pairs down by their limit
    assert lowest == pytest.approx(0.1 + robot.flipper_axle * np.sin(robot.angle_limit), abs=0.02)


# Groups of valued states

LAYOUT = ObservationLayout()
COUNT = 80


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


def test_groups_repeat_themselves_and_share_what_they_see(step: Graph) -> None:
    """They lie within 0.3 m: the face of 0.2 m is at most two bins away from another's."""
    groups, again, other = sampled(step), sampled(step), sampled(step, seed=1)
    assert groups.observations.shape == (COUNT, SIZE, LAYOUT.size)
    assert groups.observations.dtype == groups.values.dtype == np.float32
    assert np.isfinite(groups.observations).all()
    assert np.array_equal(groups.values, again.values)
    assert not np.array_equal(groups.values, other.values)
    known = {row.tobytes() for row in with_stops(step.values).astype(np.float32)}
    rows = groups.values.reshape(-1, len(ACTIONS))
    assert all(row.tobytes() in known for row in rows)
    assert len(np.unique(rows, axis=0)) > 100
    steps = np.abs(np.diff(groups.observations[:, :, : LAYOUT.bins], axis=2))
    seen = steps.max(axis=2).min(axis=1) > 0.08
    assert seen.sum() > 10
    assert np.ptp(steps.argmax(axis=2)[seen], axis=1).max() <= 2


def test_off_path_states_are_worse_than_those_of_the_best_way(step: Graph) -> None:
    near, anywhere = (sampled(step, off_path=p).values.max(axis=2).mean() for p in (0.0, 1.0))
    assert near > anywhere


def test_what_is_unseen_is_level_ground_ahead_alone(step: Graph) -> None:
    seen, hidden = sampled(step), sampled(step, unseen=1.0)
    bins, count = LAYOUT.bins, LAYOUT.heights
    assert np.array_equal(hidden.values, seen.values)
    assert np.array_equal(hidden.observations[:, :, count:], seen.observations[:, :, count:])
    level, true = (  # mean and highest point of each bin, (G, K, 2, N)
        found.observations[:, :, :count].reshape(*found.observations.shape[:2], 2, bins)
        for found in (hidden, seen)
    )
    here = slice(0, bins // 2 + 1)
    assert np.array_equal(level[..., here], true[..., here])
    changed = (level != true).any(axis=2)
    assert 0.1 < changed.any(axis=(1, 2)).mean() < 1.0
    for group, same in zip(level, ~changed.any(axis=1), strict=True):
        first = int(np.flatnonzero(~same)[0]) if not same.all() else bins
        assert (group[..., first:] == group[:, :1, first - 1 : first]).all()
    part = sampled(step, unseen=0.5).observations
    untouched = (part == seen.observations).all(axis=(1, 2)).mean()
    assert untouched > (hidden.observations == seen.observations).all(axis=(1, 2)).mean()


@pytest.mark.parametrize("front", [None, -1, 1])
@pytest.mark.parametrize("rear", [None, -1, 1])
def test_a_turn_beyond_a_stop_has_the_value_of_not_making_it(
    front: int | None, rear: int | None
) -> None:
    """The pairs are at their stops in these directions, or free."""
    values = np.array([[float(10 * i + j) for i, j in ACTIONS]])
    beyond = [(i, j) for i, j in ACTIONS if i == front or j == rear]
    values[0, [action_index(*a) for a in beyond]] = -np.inf
    found = with_stops(values)[0]
    for i, j in ACTIONS:
        assert found[action_index(i, j)] == 10 * (0 if i == front else i) + (0 if j == rear else j)
    assert np.isneginf(values).sum() == len(beyond)  # the argument is left alone
