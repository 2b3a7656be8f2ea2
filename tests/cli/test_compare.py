"""``compare``: methods over their training seeds, from files of evaluations."""

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.cli.call import call, refused

HEAD = ("scene", "controller", "conditions_hash", "seed", "outcome", "pitch_variation_100hz")
MORE = ("policy_hash", "training_seed", "training_hash", "method")


def write(
    folder: Path,
    policies: Mapping[str, float],
    more: Mapping[str, tuple[object, ...]] | None = None,
    *,
    failed: int = -1,
    count: int = 8,
) -> None:
    """Write episodes whose θ̂_R is the policy's value and a tenth of the episode's seed.

    ``more``: columns ``MORE`` of each policy; a table of before version 0.3 has none.
    """
    folder.mkdir(parents=True)
    with (folder / "episodes.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(HEAD if more is None else (*HEAD, *MORE))
        for name, value in policies.items():
            for seed in range(count):
                outcome = "stuck" if seed == failed and name != "level" else "reached"
                cells = ("stair", name, "abcd", seed, outcome, value + seed / 10)
                writer.writerow((*cells, *(more or {}).get(name, ())))


def compared(*arguments: str, cwd: Path) -> dict[str, Any]:
    """Return the row of each method."""
    done = call("compare", *arguments, "--json", cwd=cwd)
    assert done.code == 0, done.err
    return {row["method"]: row for row in json.loads(done.out)["methods"]}


def seeds_of(*arguments: str, cwd: Path) -> dict[str, int]:
    return {name: row["seeds"] for name, row in compared(*arguments, cwd=cwd).items()}


@pytest.fixture
def seeds(tmp_path: Path) -> Path:
    for seed in range(3):
        write(tmp_path / "plain" / f"{seed}", {f"runs/{seed}/best": 1 + seed / 10, "level": 2.0})
    return tmp_path


def test_a_folder_of_folders_is_a_method_with_a_training_seed_in_each(seeds: Path) -> None:
    write(seeds / "other", {"runs/9/best": 1.5, "level": 2.0}, failed=0)
    arguments = ("plain", "searched=other", "--against", "level", "--price", "5")
    rows = compared(*arguments, cwd=seeds)
    assert {name: row["seeds"] for name, row in rows.items()} == {
        "plain": 3,
        "level": 1,  # the same in each file
        "searched": 1,
    }
    assert rows["plain"]["score"]["mean"] == pytest.approx(1.1 + 0.35)
    # One of eight episodes costs 5 in place of 1.5: the mean rises by 3.5 / 8.
    assert rows["searched"]["score"]["mean"] == pytest.approx(1.5 + 0.35 + 3.5 / 8)
    assert rows["searched"]["reached_mean"] == pytest.approx(1.5 + 0.4)
    assert rows["plain"]["reached_by_scene"] == {"stair": pytest.approx(1.1 + 0.35)}
    assert rows["plain"]["comparison"]["score"]["mean"] == pytest.approx(-0.9)
    assert rows["plain"]["comparison"]["improvement"] == 1.0
    assert rows["searched"]["comparison"]["success"]["lost"] == 1
    assert rows["level"]["comparison"] is None
    assert compared(*arguments[:2], cwd=seeds)["plain"]["comparison"]["against"] == "level"


def test_tables_on_the_terminal_and_in_latex(seeds: Path) -> None:
    write(seeds / "other", {"runs/9/best": 1.5, "level": 2.0}, failed=0, count=9)
    arguments = ("plain", "searched=other", "--against", "all")
    done = call("compare", *arguments, "--output", "table.tex", cwd=seeds)
    assert done.code == 0, done.err
    assert "8 of up to 9 episodes were played by all; plain/0 has 8" in done.err
    pairs = [line.split()[:2] for line in done.out.split("against")[1].splitlines()[1:4]]
    assert pairs == [["level", "plain"], ["searched", "plain"], ["searched", "level"]]
    assert "One training seed: searched. The interval is over episodes alone" in done.out
    assert "Few training seeds: plain 3; report 5 or more." in done.out
    cheap = call("compare", *arguments, "--price", "1", cwd=seeds).out
    assert "a failed episode counts 1, and a crossing at most that." in cheap
    assert r"Method & $n$ & Success [\%] & Score [rad] \\" in latex_of(seeds)  # IQMs are the means
    named = ("plain", "searched=other", "--name", "AT-D3QN=plain", "--against", "AT-D3QN")
    assert call("compare", *named, "--output", "table.tex", cwd=seeds).code == 0
    assert r"& $\Delta$ to AT-D3QN [rad] \\" in latex_of(seeds)
    assert r"AT-D3QN & 3 & 100 [67.6, 100] & 1.45 [1.13, 3.05] &  \\" in latex_of(seeds)
    row = r"level & 1 & 100 [67.6, 100] & 2.35 [2.15, 3.64] & 0.90 [0.65, 1.15] \\"
    assert row in latex_of(seeds)


def latex_of(folder: Path) -> str:
    return (folder / "table.tex").read_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("missing",), "missing: there is no episodes.csv"),
        (("plain", "--against", "leve"), "did you mean 'level'?"),
        (("plain", "--output", "a.png"), "a .tex file; the suffix is '.png'"),
        (("plain", "--measure", "t_cost"), "--price: t_cost has no default"),
        (("plain", "--measure", "t_cost", "--price", "60"), "there is no column 't_cost'"),
        (("plain", "elsewhere"), "no episode was played by all"),
    ],
)
def test_a_wrong_request_says_what_is_allowed(
    arguments: tuple[str, ...], words: str, seeds: Path
) -> None:
    write(seeds / "elsewhere", {"okada": 1.0})
    path = seeds / "elsewhere" / "episodes.csv"
    path.write_text(path.read_text().replace("stair", "gap"))
    error = refused("compare", *arguments, cwd=seeds)
    assert words in error
    assert error.count("\n") == 1


def test_settings_of_a_controller_are_no_training_seeds(tmp_path: Path) -> None:
    for name, value in (("near", 2.0), ("far", 1.0)):
        write(tmp_path / name, {"okada": value, "level": 3.0})
    assert "far: okada has other results there than in another folder" in refused(
        "compare", "near", "far", cwd=tmp_path
    )
    assert seeds_of("close=near", "far", cwd=tmp_path) == {"close": 1, "okada": 1, "level": 1}
    file = tmp_path / "far" / "episodes.csv"
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines, lines[-1]]) + "\n")  # the same episode, as a baseline
    assert call("compare", "far", cwd=tmp_path).code == 0
    file.write_text("\n".join([*lines, lines[-1].replace("reached", "stuck")]) + "\n")
    assert "level has several results on stair abcd, seed 7, as with several of its" in refused(
        "compare", "far", cwd=tmp_path
    )


def test_the_best_known_stands_beside_and_is_no_method(tmp_path: Path) -> None:
    write(tmp_path / "judged", {"random": 3.0, "level": 2.0, "best known (mpc)": 1.0}, count=4)
    file = tmp_path / "judged" / "episodes.csv"
    lines = file.read_text().splitlines()
    others = [line.replace("stair", "step") for line in lines if "best known" not in line]
    file.write_text("\n".join([*lines, *others[1:]]) + "\n")
    rows = compared("judged", cwd=tmp_path)
    assert {name: row["seeds"] for name, row in rows.items()} == {"random": 1, "level": 1}
    assert set(rows["random"]["by_scene"]) == {"stair", "step"}
    assert "were played by all" not in call("compare", "judged", cwd=tmp_path).err


def test_a_policy_is_known_by_its_digest(tmp_path: Path) -> None:
    """Not by its episodes: trainings may fail alike, and one policy may be evaluated twice."""
    for name, digest, count in (("a", "d1", 8), ("b", "d1", 6), ("c", "d2", 8)):
        write(tmp_path / name, {"best": 1.0}, {"best": (digest, 3, "t", "")}, count=count)
    assert seeds_of("a", "b", cwd=tmp_path) == {"best": 1}
    assert seeds_of("a", "c", cwd=tmp_path) == {"best": 2}
    write(tmp_path / "e", {"best": 1.5}, {"best": ("d1", 3, "t", "")})
    assert "best has other results there than in another folder" in refused(
        "compare", "a", "e", cwd=tmp_path
    )


def test_a_rule_among_the_seeds_of_a_method_is_refused(tmp_path: Path) -> None:
    for number, rule in ((1, "level"), (2, "rule_of_a_plugin")):
        for seed in (1, 2):
            label = rule if seed == number else f"{seed}/best"
            more = {label: ("d0", "", "", "") if label == rule else (f"d{seed}", seed, "t", "")}
            write(tmp_path / f"m{number}" / f"{seed}", {label: 1.0 + seed}, more)
        assert "a rule is no training seed" in refused("compare", f"m{number}", cwd=tmp_path)


def test_what_trainings_of_a_method_differ_in_beside_their_seeds_is_told(tmp_path: Path) -> None:
    """Equal seeds are those of one training at two decisions, or of two networks."""
    for number, (seed, training) in enumerate(((0, "t1"), (1, "t1"), (1, "t2"))):
        label = f"{number}/best"
        more = {label: (f"d{number}", seed, training, ""), "level": ("d", "", "", "")}
        write(tmp_path / "m" / f"{number}", {label: 1.0 + number, "level": 2.5}, more)
    done = call("compare", "m", cwd=tmp_path)
    assert done.code == 0
    assert "m: its policies were trained with different settings, as the column" in done.err
    assert "m: 3 policies, but training seed 1 counts 2 times" in done.err
    done = call("compare", "m/0", "m/1", "two=m/2", cwd=tmp_path)
    assert "different settings" not in done.err


def test_what_hinders_a_comparison_is_named(tmp_path: Path) -> None:
    write(tmp_path / "a", {"a/best": 1.0})
    write(tmp_path / "b", {"b/best": 1.0})
    file = tmp_path / "b" / "episodes.csv"
    rows = file.read_text()
    file.write_text(rows.replace("abcd,", "abcd,1"))
    assert "their conditions are equal, but not their episodes, as with another --seed" in refused(
        "compare", "a", "b", cwd=tmp_path
    )
    file.write_text(rows.replace("abcd", "ffff"))
    assert "a: stair abcd; b: stair ffff" in refused("compare", "a", "b", cwd=tmp_path)


def test_an_evaluation_of_a_sweep_has_the_seeds_of_its_methods(tmp_path: Path) -> None:
    values = {"s/0": 1.0, "s/1": 1.5, "s/2": 3.0, "s/3": 3.5, "level": 2.0}
    methods = dict(zip(values, ("s/a", "s/a", "s/b", "s/b", "level"), strict=True))
    more = {label: (f"d{label}", "", "t", method) for label, method in methods.items()}
    write(tmp_path / "judged", values, more)
    assert seeds_of("judged", cwd=tmp_path) == {"s/a": 2, "s/b": 2, "level": 1}
    assert seeds_of("mine=judged", cwd=tmp_path) == {"mine": 2, "s/b": 2, "level": 1}


def test_methods_of_one_name_are_one_if_they_were_trained_alike(tmp_path: Path) -> None:
    """The name is that of the screen, such as what one sweep calls its network."""
    for folder, training, seeds in (("a", "t1", (1, 2)), ("b", "t1", (3, 4)), ("c", "t2", (1, 2))):
        more = {f"{folder}/{n}": (f"d{folder}{n}", n, training, "mlp") for n in seeds}
        write(tmp_path / folder, dict.fromkeys(more, 1.0), more)
    assert seeds_of("a", "b", "c", cwd=tmp_path) == {"mlp": 4, "c/mlp": 2}


def test_an_interquartile_mean_that_is_the_mean_is_left_out(seeds: Path) -> None:
    assert "IQM" not in call("compare", "plain", cwd=seeds).out
    write(seeds / "plain" / "3", {"runs/3/best": 2.0, "level": 2.0})
    assert "IQM" in call("compare", "plain", cwd=seeds).out
    words = "plain", "--against", "all", "--output", "table.tex"
    assert call("compare", *words, cwd=seeds).code == 0
    assert "IQM" in latex_of(seeds)
