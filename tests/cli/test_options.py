"""Options and overrides: one value for each, and unknown options explained."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

from flipperctl.cli.main import app
from tests.cli.call import refused


def options() -> Iterator[tuple[str, ...]]:
    """Each subcommand's options that take one value, with the words of the subcommand."""

    def visit(command, path: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
        for name, inner in getattr(command, "commands", {}).items():
            yield from visit(inner, (*path, name))
        if path and not hasattr(command, "commands"):
            for parameter in command.params:
                flag = getattr(parameter, "is_flag", True)
                if parameter.param_type_name == "option" and not (flag or parameter.multiple):
                    yield (*path, parameter.opts[0])

    yield from visit(typer.main.get_command(app), ())


def test_the_options_of_all_subcommands_are_found() -> None:
    found = set(options())
    assert {("eval", "--controller"), ("train", "--resume"), ("inspect", "run", "--output")} < found
    assert all(words[-1] != "--plugins" for words in found)


@pytest.mark.parametrize("words", [*options()], ids=" ".join)
def test_an_option_given_twice_is_refused(words: tuple[str, ...], tmp_path: Path) -> None:
    *command, option = words
    error = refused(*command, option, "1", f"{option}=2", cwd=tmp_path)
    assert f"{option} is given twice: 1 and 2; one is allowed" in error


def test_several_names_are_one_option(tmp_path: Path) -> None:
    twice = ["--baseline", "okada", "--baseline", "level"]
    assert "--baseline okada,level" in refused("eval", "--controller", "mpc", *twice, cwd=tmp_path)


OKADA = ("--controller", "okada")


@pytest.mark.parametrize(
    ("arguments", "key", "values"),
    [
        (("eval", *OKADA, "--seed", "3", "eval.seed=4"), "eval.seed", "--seed 3 and eval.seed=4"),
        (("eval", *OKADA, "eval.jobs=2", "--jobs", "1"), "eval.jobs", "--jobs 1 and eval.jobs=2"),
        (
            ("map", *OKADA, "--over=seed,seed", "--episodes", "3", "++eval.episodes=4"),
            "eval.episodes",
            "--episodes 3 and ++eval.episodes=4",
        ),
        (
            ("inspect", "reward", "--episodes", "3", "eval.episodes=4"),
            "eval.episodes",
            "--episodes 3 and eval.episodes=4",
        ),
        (
            ("bench", "latency", "--repeats", "3", "bench.repeats=4"),
            "bench.repeats",
            "--repeats 3 and bench.repeats=4",
        ),
        (
            ("eval", *OKADA, "controller=level"),
            "controller",
            "controller=okada and controller=level",
        ),
        (
            ("inspect", "terrain", "stair", "terrain=step"),
            "terrain",
            "terrain=stair and terrain=step",
        ),
        (("inspect", "config", "seed=1", "seed=2"), "seed", "seed=1 and seed=2"),
        (
            ("train", "agent.gamma=0.9", "+agent.gamma=0.8"),
            "agent.gamma",
            "0.9 and +agent.gamma=0.8",
        ),
        (("train", "-m", "seed=1,2", "seed=3"), "seed", "seed=1,2 and seed=3"),
        (("train", "hydra.run.dir=a", "hydra.run.dir=b"), "hydra.run.dir", "a and hydra.run.dir=b"),
        (("train", "--info", "all", "seed=1", "seed=2"), "seed", "seed=1 and seed=2"),
        (("bench", "bench.calls=10", "bench.calls=20"), "bench.calls", "=10 and bench.calls=20"),
        (
            ("inspect", "reward", "--compare", "okada,level", "seed=1", "seed=1"),
            "seed",
            "seed=1 and seed=1",
        ),
    ],
    ids=lambda found: " ".join(found) if isinstance(found, tuple) else None,
)
def test_a_setting_given_twice_is_refused(
    arguments: tuple[str, ...], key: str, values: str, tmp_path: Path
) -> None:
    error = refused(*arguments, cwd=tmp_path)
    assert f"{key} is given twice: " in error
    assert f"{values}; one is allowed" in error


def test_a_resumed_training_takes_each_setting_once(short_run: Path, tmp_path: Path) -> None:
    twice = ["train.decisions=700", "train.decisions=800"]
    error = refused("train", "--resume", str(short_run), *twice, cwd=tmp_path)
    assert "train.decisions is given twice" in error


def test_a_view_without_episodes_names_its_own_seed(tmp_path: Path) -> None:
    error = refused("inspect", "terrain", "stair", "eval.seed=4", cwd=tmp_path)
    assert "eval.seed=4" in error
    assert "--seed" in error


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["train", "--terrain", "stair"], "--terrain; settings are written as terrain=stair"),
        (["train", "--seed", "4"], "--seed; settings are written as seed=4"),
        (["train", "--agent.gamma=0.9"], "; settings are written as agent.gamma=0.9"),
        (["train", "--gamma", "0.9"], "; settings are written as agent.gamma=0.9"),
        (["train", "--learning-rate=1e-3"], "; settings are written as agent.learning_rate=1e-3"),
        (["train", "--terrain", "terrain=stair"], "; settings are written as terrain=…"),
        (["train", "--out", "here"], "; did you mean '--output'?"),
        (
            ["inspect", "config", "--experiment", "quick"],
            "; settings are written as experiment=quick",
        ),
        (["inspect", "reward", "--seed", "3"], "; settings are written as eval.seed=3"),
        (["eval", *OKADA, "--friction", "0.6"], "; settings are written as sim.friction=0.6"),
        (["map", *OKADA, "--terrain", "a b"], "; settings are written as 'terrain=a b'"),
        (["eval", *OKADA, "--agent.gamma", "0.9"], "no such option: --agent.gamma\n"),
        (["eval", *OKADA, "--episode", "5"], "--episode; did you mean '--episodes'?"),
        (["inspect", "run", "x", "--seed", "3"], "no such option: --seed\n"),
        (["train", "--nonsense"], "no such option: --nonsense\n"),
        (["--terrain", "stair"], "--terrain; settings are written as terrain=stair\n"),
        (["--terrain=stair", "train"], "--terrain; settings are written as terrain=stair\n"),
        (["--seed", "train"], "--seed; settings are written as seed=…\n"),
        (["--seed=4", "eval"], "--seed; settings are written as eval.seed=4\n"),
        (["inspect", "--terrain", "stair"], "--terrain; settings are written as terrain=stair\n"),
        (["--versoin"], "--versoin; did you mean '--version'?\n"),
        (["--nonsense"], "no such option: --nonsense\n"),
    ],
    ids=lambda found: " ".join(found) if isinstance(found, list) else None,
)
def test_an_unknown_option_is_explained(arguments: list[str], words: str, tmp_path: Path) -> None:
    assert words in refused(*arguments, cwd=tmp_path)
