"""Seeds of episodes: which episodes are the same draw, and which are never."""

from pathlib import Path
from typing import Any

import pytest
from flipperctl_plugins.terrains.stairs import Stair

from flipperctl.api import Profile, Terrain
from flipperctl.config import EnvConfig, identity
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.evaluation.rows import sampled
from flipperctl.policies.source import PolicySource
from flipperctl.requests.plan import scenes
from flipperctl.requests.text import from_words
from flipperctl.rollout.episode import EvaluationSeeds, training_seed, validation_seed
from tests.played import play_episodes

FAMILIES = "step,ramp,gap"
KERB = "x,z\n0,0\n0,0.1\n0.5,0.1\n"


def seeds_of(terrain: Any, seed: int = 0) -> EvaluationSeeds:
    return EvaluationSeeds.of(seed, EnvConfig(terrain=terrain).terrain)


def recorded(path: str) -> dict[str, str]:
    return {"name": "profile_file", "path": path}


def test_episodes_of_several_families_sample_frictions_of_their_own() -> None:
    frictions = set()
    for config, _ in scenes(from_words([f"terrain={FAMILIES}", "conditions=wide"]), None, "level"):
        env = FlipperEnv(config=config.environment())
        for seed in EvaluationSeeds.of(0, config.terrain).first(5):
            env.reset(seed=seed)
            frictions.add(env._sampled_values["sim.friction"])
    assert len(frictions) == 15


def test_two_policies_meet_the_same_ground_start_and_physics() -> None:
    ((config, _),) = scenes(from_words(["terrain=step", "conditions=wide"]), None, "level")
    ours, theirs = (
        play_episodes(config, PolicySource(settings={"name": name}), episodes=2, seed=3)
        for name in ("level", "okada")
    )
    assert [e["seed"] for e in ours] == [e["seed"] for e in theirs]
    assert [sampled(e) for e in ours] == [sampled(e) for e in theirs]
    assert sampled(ours[0]) != sampled(ours[1])


def test_the_ground_is_the_same_under_all_conditions_and_in_all_engines() -> None:
    chosen = (["conditions=nominal"], ["conditions=varied"], ["conditions=wide"], ["sim=mujoco"])
    grounds = []
    for overrides in (*chosen, ["sim.friction=0.7"]):
        ((config, _),) = scenes(from_words(["terrain=ramp", *overrides]), None, "level")
        env = FlipperEnv(config=config.environment())
        env.reset(seed=EvaluationSeeds.of(5, config.terrain)(7))
        grounds.append(env.profile.points.tolist())
    assert grounds == [grounds[0]] * 5


def test_the_ranges_of_the_streams_do_not_overlap() -> None:
    episodes = [0, 1, 499, 10**6, 2**32 - 1]
    for seed in (0, 1, 2**31, 2**63 - 1):
        training = [training_seed(seed, i) for i in episodes]
        validation = [validation_seed(seed, i) for i in episodes]
        evaluation = [seeds_of("stair", seed)(i) for i in episodes]
        assert all(0 <= s < 2**32 for s in training)
        assert all(2 * 2**50 <= s < 3 * 2**50 for s in validation)
        assert all(3 * 2**50 <= s < 4 * 2**50 < 2**53 for s in evaluation)
        assert len({*training, *validation, *evaluation}) == 3 * len(episodes)


def test_trainings_of_0_2_repeat() -> None:
    """The first numbers of version 0.2."""
    assert [training_seed(1, i) for i in range(3)] == [3290936230, 2737152525, 1158480471]


def test_the_seeds_depend_on_the_terrain_and_its_settings() -> None:
    stair = seeds_of("stair")(0)
    assert stair == seeds_of(Stair())(0)
    assert stair == seeds_of({"name": "stair", "rise": Stair().rise})(0)
    other = {"name": "stair", "platform": 2.0}
    found = [stair, seeds_of("step")(0), seeds_of(other)(0), seeds_of("mix")(0)]
    found += [seeds_of({"name": "mix", "parts": parts})(0) for parts in (["step"], [other])]
    found += [seeds_of("stair", seed=1)(0), seeds_of("stair")(1)]
    assert len(set(found)) == len(found)


def test_recorded_ground_is_known_by_its_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "far").mkdir()
    for name, text in (("kerb.csv", KERB), ("far/moved.csv", KERB), ("other.csv", KERB + "1,0\n")):
        (tmp_path / name).write_text(text)
    kerb = seeds_of(recorded("kerb.csv"))(0)
    same = [str(tmp_path / "kerb.csv"), "far/../kerb.csv", "far/moved.csv"]
    assert [seeds_of(recorded(path))(0) for path in same] == [kerb] * 3
    assert seeds_of(recorded("other.csv"))(0) != kerb
    assert seeds_of(recorded("kerb.csv") | {"unit": "cm"})(0) != kerb
    inside = [seeds_of({"name": "mix", "parts": [recorded(p)]})(0) for p in ("kerb.csv", same[0])]
    assert inside[0] == inside[1] != kerb


def test_several_paths_in_one_setting_and_a_file_that_is_missing(tmp_path: Path) -> None:
    class Two(Terrain):
        """Ground of two files."""

        plugin_name = "two"
        paths: tuple[Path, ...] = ()
        note: str = ""

        def generate(self, rng: Any) -> Profile:
            raise NotImplementedError

    (tmp_path / "one.csv").write_text(KERB)
    found = identity(Two(paths=(tmp_path / "one.csv", tmp_path / "none.csv"), note="n"))
    (digest, missing) = found.pop("files")
    assert len(digest) == 64
    assert missing is None
    assert found == {"name": "two", "settings": {"note": "n"}}
