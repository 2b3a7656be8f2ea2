"""``benchmark``: equal files from any number of processes, and files that are verified."""

import json
from pathlib import Path

import pytest

from flipperctl.evaluation.benchmark import read_result
from tests.cli.call import call, refused

TINY = """\
about: Two scenes for a test.
tracks:
  plane:
    episodes: 5
    scenes:
      steps: {words: terrain=step, strongest: okada, price: 7}
      lips: {words: terrain=lip sim.friction=0.8, strongest: level, price: 9}
"""
PLUGIN = """\
from flipperctl.api import Profile, Terrain, terrain

@terrain("mine")
class Mine(Terrain):
    def generate(self, rng):
        return Profile([(0.0, 0.0)])
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("benchmark")
    (path / "benchmark").mkdir()
    (path / "benchmark" / "tiny.yaml").write_text(TINY)
    (path / "mine.py").write_text(PLUGIN)
    done = call(*PLAY, "level", "okada", "--json", "--output", "out", cwd=path)
    assert done.code == 0, done.err
    (path / "printed.json").write_text(done.out)
    return path


PLAY = ("benchmark", "--version", "tiny", "--plugins", "mine.py")


def test_a_rule_scores_one_where_it_is_the_strongest(folder: Path) -> None:
    level, okada = json.loads((folder / "printed.json").read_text())["methods"]
    ratios = okada["tracks"]["plane"]["scenes"]
    assert ratios["steps"]["ratio"]["mean"] == 1.0
    assert level["tracks"]["plane"]["scenes"]["lips"]["ratio"]["mean"] == 1.0
    assert okada["tracks"]["plane"]["ratio"]["mean"] == pytest.approx(
        (1.0 + ratios["lips"]["ratio"]["mean"]) / 2
    )


def test_two_processes_and_no_other_method_give_an_equal_file(folder: Path) -> None:
    done = call(*PLAY, "okada", "--jobs", "2", "--output", "again", cwd=folder)
    assert done.code == 0, done.err
    assert (folder / "again/okada.json").read_bytes() == (folder / "out/okada.json").read_bytes()


def test_another_edition_has_other_episodes_and_is_verified_by_its_word_alone(
    folder: Path,
) -> None:
    done = call(*PLAY, "okada", "--edition", "kept", "--output", "kept", cwd=folder)
    assert done.code == 0, done.err
    kept, public = (read_result(folder / name / "okada.json") for name in ("kept", "out"))
    assert "kept" not in (folder / "kept/okada.json").read_text()
    assert not {*kept.scenes[0].rule.digests} & {*public.scenes[0].rule.digests}
    assert "another edition" in refused(*PLAY, "--verify", "kept/okada.json", cwd=folder)
    verified = call(*PLAY, "--verify", "kept/okada.json", "--edition", "kept", cwd=folder)
    assert (verified.code, "4 episodes are equal" in verified.err) == (0, True)


def test_a_changed_episode_is_noticed(folder: Path) -> None:
    result = read_result(folder / "out/okada.json")
    first = result.scenes[0]
    better = first.policies[0].model_copy(
        update={"pitch_variation_100hz": (0.1, *first.policies[0].pitch_variation_100hz[1:])}
    )
    scenes = (first.model_copy(update={"policies": (better,)}), *result.scenes[1:])
    changed = result.model_copy(update={"scenes": scenes})
    (folder / "changed.json").write_text(changed.model_dump_json())
    (folder / "sealed.json").write_text(changed.sealed().model_dump_json())
    assert "was changed" in refused(*PLAY, "--verify", "changed.json", cwd=folder)
    # Its hash made anew, playing tells: of all episodes, or of a sample that has it.
    found = call(*PLAY, "--verify", "sealed.json", "--share", "1", cwd=folder)
    assert found.code == 1
    assert "plane: steps, okada, episode 0 differs: pitch_variation_100hz 0.1" in found.err


def test_a_file_without_what_went_badly_is_refused(folder: Path) -> None:
    result = read_result(folder / "out/okada.json")
    first, *rest = result.scenes
    (okada,) = first.policies
    shorter = okada.model_copy(
        update={name: getattr(okada, name)[1:] for name in type(okada).model_fields}
    )
    for scenes in (
        tuple(rest),
        (first.model_copy(update={"policies": (shorter,)}), *rest),
        (first.model_copy(update={"policies": ()}), *rest),
    ):
        part = result.model_copy(update={"scenes": scenes}).sealed()
        (folder / "part.json").write_text(part.model_dump_json())
        assert "lacks some" in refused(*PLAY, "--verify", "part.json", cwd=folder)


def test_a_policy_of_another_content_is_not_what_was_played(folder: Path) -> None:
    done = call(*PLAY, "level", "--verify", "out/okada.json", cwd=folder)
    assert (done.code, "not among those of this content" in done.err) == (2, True)


def test_scenes_are_fixed(folder: Path) -> None:
    assert "fixed" in refused(*PLAY, "okada", "sim.friction=0.3", cwd=folder)
    assert "no track 'plan'" in refused(*PLAY, "okada", "--track", "plan", cwd=folder)
    assert "no version 'tin'" in refused("benchmark", "okada", "--version", "tin", cwd=folder)
