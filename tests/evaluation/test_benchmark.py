"""Scores of the benchmark, and what its files promise."""

import numpy as np
import pytest

from flipperctl.api import Outcome, Robot
from flipperctl.config.presets import presets
from flipperctl.errors import RequestError
from flipperctl.evaluation import benchmark as frozen


def _played(costs: list[float], failed: list[bool]) -> frozen.PlayedEpisodes:
    outcomes = tuple(Outcome.STUCK if lost else Outcome.REACHED for lost in failed)
    return frozen.PlayedEpisodes(
        outcomes=outcomes, pitch_variation_100hz=tuple(costs), digests=("0",) * len(costs)
    )


def test_every_scene_of_every_edition_has_episodes_of_its_own() -> None:
    for name in presets("benchmark"):
        version = frozen.find_benchmark(name)
        sections = [*version.sections([]), *version.sections([], "a judge's word")]
        assert len({section.words[-2] for section in sections}) == len(sections)


def test_a_track_keeps_its_hash_while_another_track_or_a_price_changes() -> None:
    scene = frozen.Scene(words="terrain=step", strongest="okada", price=7.0)

    def hashes(**changes: object) -> list[str]:
        scenes = {"steps": scene.model_copy(update=changes)}
        tracks = {
            "near": frozen.Track(episodes=5, scenes={"steps": scene}),
            "far": frozen.Track(episodes=5, scenes=scenes),
        }
        version = frozen.Benchmark(about="", tracks=tracks)
        return [version.digest(chosen) for chosen in (["near"], ["far"], ["near", "far"])]

    assert hashes() == hashes(price=8.0)
    for changes in ({"words": "terrain=ramp"}, {"strongest": "level"}):
        equal = [a == b for a, b in zip(hashes(), hashes(**changes), strict=True)]
        assert equal == [True, False, False]


def test_a_failure_costs_the_scenes_price_and_a_rule_against_itself_is_exactly_one() -> None:
    rule = _played([1.0, 2.0, 3.0, 0.5, 1.5], [False, False, True, False, False])
    np.testing.assert_array_equal(rule.costs(7.0), [1.0, 2.0, 7.0, 0.5, 1.5])
    scene = frozen.SceneResult(track="t", scene="s", policies=(rule,), rule=rule)
    np.testing.assert_allclose(scene.ratios(7.0), 1.0)


@pytest.mark.parametrize("seeds", [1, 5])
def test_the_interval_of_a_score_holds_the_truth_where_few_episodes_fail(seeds: int) -> None:
    # Costs of equal ground go together; 3 % of the episodes cost a price far beyond them.
    rng, price, size, scenes = np.random.default_rng(5), 7.0, 30, 8
    effects = (
        rng.normal(0, 0.1, 400 * seeds).reshape(400, seeds) if seeds > 1 else np.zeros((400, 1))
    )
    truth = (0.97 * 0.7 * np.exp(0.125) + 0.03 * price) / (0.97 * np.exp(0.125) + 0.03 * price)
    held = 0
    for effect in effects:
        ratios = {}
        for scene in range(scenes):
            ground = rng.lognormal(0.0, 0.5, size)
            own = [ground * 0.7 * (1 + e) for e in effect]
            lost = rng.random((seeds, size)) < 0.03
            policies = tuple(
                _played(c.tolist(), f.tolist()) for c, f in zip(own, lost, strict=True)
            )
            rule = _played(ground.tolist(), (rng.random(size) < 0.03).tolist())
            part = frozen.SceneResult(track="t", scene=str(scene), policies=policies, rule=rule)
            ratios[part.scene] = part.ratios(price)
        interval = frozen.mean_interval(ratios)
        assert interval.low is not None
        assert interval.high is not None
        held += interval.low <= truth <= interval.high
    assert held / len(effects) >= 0.93


def test_a_policy_plays_the_tracks_of_its_flippers() -> None:
    version = frozen.find_benchmark("1")
    assert version.tracks_for([Robot()]) == ["plane", "3-D"]
    assert version.tracks_for([Robot(flippers="four"), None]) == ["four"]
    assert version.tracks_for([None]) == [*version.tracks]
    with pytest.raises(RequestError, match="no track in common"):
        version.tracks_for([Robot(), Robot(flippers="four")])


def test_a_crossing_costs_its_roll_where_a_track_says_so() -> None:
    pitched = _played([1.0, 2.0], [False, True])
    rolled = pitched.model_copy(update={"roll_variation_100hz": (0.5, None)})
    np.testing.assert_array_equal(rolled.costs(7.0), [1.5, 7.0])
    assert rolled.sizes(rolls=True) == {2}
    assert pitched.sizes(rolls=True) == {0, 2}  # a file that leaves it out lacks episodes
    # Hashes of the other tracks' files are those of before.
    assert "roll_variation_100hz" not in pitched.model_dump(mode="json")
