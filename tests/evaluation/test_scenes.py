"""A policy on scenes, beside a baseline and references that try what it fails."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from flipperctl.config import EvalConfig
from flipperctl.errors import InterruptedRunError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.episodes import play_episodes
from flipperctl.evaluation.estimates import PairedDifference
from flipperctl.evaluation.intervals import holm, paired_success, proportion
from flipperctl.evaluation.results import Outcomes, Passable
from flipperctl.evaluation.scenes import evaluate
from flipperctl.evaluation.workers import EpisodeWorkers
from flipperctl.policies.source import PolicySource

LEVEL, OKADA, RANDOM = (
    PolicySource.of_plugin(name, "here") for name in ("level", "okada", "random")
)
TWO = {"episodes": 2, "seed": 4}
STEP = EvalConfig(terrain={"name": "step", "low": 0.4, "high": 0.4}, eval=TWO)
"""Flippers held level stop at it, okada climbs it, random ones overturn the robot."""
FLAT = EvalConfig(terrain="flat", eval=TWO)
"""On it okada holds its flippers level too."""


def test_a_baseline_and_references_play_the_episodes_of_each_scene() -> None:
    found = evaluate(
        [(STEP, LEVEL), (FLAT, LEVEL)], baselines=[OKADA, RANDOM], references=[RANDOM, OKADA]
    )
    assert found.controller == "level"
    step, flat = found.scenes
    assert (step.terrain, flat.terrain) == ("step", "flat")
    assert step.seed == flat.seed == 4
    assert step.conditions == Conditions.of(STEP)
    assert step.episodes[0].seed != flat.episodes[0].seed

    assert step.summary.outcomes == Outcomes(reached=0, overturned=0, stuck=2, timeout=0)
    assert [e.crossed_by for e in step.episodes] == ["okada", "okada"]
    assert step.summary.passable == Passable(2, 0.0, proportion(0, 2), 0)
    step_okada, step_random = step.baselines
    assert step_random.controller == "random"
    assert step_okada.controller == "okada"
    assert step_okada.summary.success_rate == 1.0
    assert step_okada.difference.t_cost is None
    played = play_episodes(STEP, OKADA, episodes=2, seed=4)
    assert step_okada.episodes == tuple(played)

    assert [e.crossed_by for e in flat.episodes] == ["random", "random"]
    assert flat.summary.passable == Passable(2, 1.0, proportion(2, 2), 0)
    flat_okada, flat_random = flat.baselines
    assert flat_random.controller == "random"
    assert flat_okada.difference.t_cost == PairedDifference(0.0, None, None, 2)
    assert [e.crossed_by for e in flat_okada.episodes] == [None, None]


def test_which_draws_are_passable_does_not_depend_on_the_policy() -> None:
    for references in ([RANDOM], [RANDOM, OKADA], [LEVEL]):
        judged = [
            evaluate([(STEP, source)], references=references).scenes[0]
            for source in (LEVEL, OKADA, RANDOM)
        ]
        found = [[e.crossed_by for e in scene.episodes] for scene in judged]
        assert found == [found[0]] * 3
        # okada crosses both draws, whether or not a reference does.
        okada = judged[1].summary.passable
        assert okada is not None
        assert okada.episodes + okada.beyond == 2


def test_each_scene_has_its_own_policy_and_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    jobs: list[int] = []
    monkeypatch.setattr(EpisodeWorkers, "use", lambda self, count: jobs.append(count))
    two = STEP.model_copy(update={"eval": STEP.eval.model_copy(update={"jobs": 2})})
    found = evaluate([(two, LEVEL), (FLAT, OKADA)], baselines=[RANDOM])
    assert jobs == [2, 2, 1, 1]
    assert [scene.controller for scene in found.scenes] == ["level", "okada"]
    assert found.controller == "level, okada"
    alone = [evaluate([one]).scenes[0] for one in ((STEP, LEVEL), (FLAT, OKADA))]
    assert [s.episodes for s in found.scenes] == [s.episodes for s in alone]


def test_the_tests_of_all_scenes_are_corrected_together() -> None:
    found = evaluate([(STEP, LEVEL), (FLAT, LEVEL)], baselines=[OKADA, RANDOM])
    gaps = [b.difference.success for scene in found.scenes for b in scene.baselines]
    assert gaps[0].p == paired_success(0, 2, 2).p == 0.5
    assert [gap.p_holm for gap in gaps] == holm([gap.p for gap in gaps])
    assert gaps[0].p_holm == 1.0


def test_progress_names_who_plays_what_and_counts_to_the_end() -> None:
    opened: list[tuple[str, int]] = []
    reported: list[list[float]] = []

    @contextmanager
    def progress(label: str, episodes: int) -> Iterator[Callable[[float], None]]:
        opened.append((label, episodes))
        done: list[float] = []
        reported.append(done)
        yield done.append

    evaluate([(STEP, LEVEL)], baselines=[OKADA], references=[RANDOM, OKADA], progress=progress)
    evaluate([(FLAT, LEVEL)], references=[LEVEL, OKADA], progress=progress)
    assert opened == [
        ("step", 2),
        ("step, okada", 2),
        ("step, random on episodes not crossed yet", 2),
        ("flat", 2),
        ("flat, okada on episodes not crossed yet", 0),
    ]
    assert [done for done in reported if done] == [[1, 2]] * 4


def test_without_references_no_episode_says_who_crossed_it() -> None:
    (found,) = evaluate([(FLAT, LEVEL)]).scenes
    assert found.baselines == ()
    assert found.summary.passable is None
    assert "crossed_by" not in found.episodes[0].row()


def test_an_evaluation_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one scene"):
        evaluate([])


def test_an_evaluation_that_is_stopped_before_its_first_episode_says_so() -> None:
    with pytest.raises(InterruptedRunError, match="interrupted: none of 4 episodes is finished"):
        evaluate([(FLAT, LEVEL)], baselines=[OKADA], stop=lambda: True)
