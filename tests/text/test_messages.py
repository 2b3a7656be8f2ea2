"""Close matches: typical slips find the word that was meant, other words find nothing."""

import re
from pathlib import Path

import pytest

from flipperctl.api import registry
from flipperctl.api.plugin import Plugin
from flipperctl.errors import MissingExtraError, missing_package
from flipperctl.plugging.guard import naming
from flipperctl.text.elsewhere import called_here
from flipperctl.text.messages import close_match, closest, explain_unknown_key, spans
from tests.cli.call import COMMANDS

PLUGINS = sorted(name for _, name in registry)
SETTINGS = ["gamma", "learning_rate", "batch_size", "epsilon_decisions", "friction", "substep"]
OPTIONS = ["checkpoint", "controller", "baseline", "episodes", "seed", "jobs", "output", "multirun"]
WORDS = [*PLUGINS, *SETTINGS, *OPTIONS, *COMMANDS]


def test_a_slip_finds_the_word_and_another_word_finds_nothing() -> None:
    slips = {"stiar": "stair", "Stair": "stair", "pich": "pitch", "paper-step": "paper_step"}
    slips |= {"batchsize": "batch_size", "controler": "controller", "evaluate": "eval"}
    for typed, meant in slips.items():
        assert closest(typed, WORDS) == meant
        assert close_match(typed, WORDS) == f" (did you mean {meant!r}?)"
    for typed in ("none", "resume", "x", "lr", "config", "123", "model", "verbose", ""):
        assert closest(typed, WORDS) is None
        assert close_match(typed, WORDS) == ""


@pytest.mark.parametrize(
    ("module", "package"),
    [("PIL.Image", "pillow"), ("numba", "numba"), ("small_gicp", "'flipperctl[lidar]'")],
)
def test_a_missing_package_is_named_with_how_to_install_it(module: str, package: str) -> None:
    """Also where a plugin imports it, such as an engine."""
    error = ModuleNotFoundError(f"No module named {module!r}", name=module)
    text = f"the package {module.partition('.')[0]} is missing: pip install {package}"
    assert missing_package(error) == text
    assert missing_package(ImportError("broken")) == ""
    named = naming(Plug(), "place")
    with pytest.raises(MissingExtraError, match=re.escape(f"robot 'x': {text}")), named:
        raise error


class Plug(Plugin):
    """A plugin that is not registered."""

    kind = "robot"
    plugin_name = "x"


@pytest.mark.parametrize(
    ("typed", "hint"),
    [
        ("lr", " (here it is agent.learning_rate)"),
        ("--env-id", " (here it is terrain=NAME)"),
        ("λ1", " (here it is rewards.flipper.lambda_1)"),
        ("PPO", " (here it is agent=policy_gradient, or agent=sb3 agent.algorithm=ppo)"),
        ("gamma", ""),
    ],
)
def test_words_of_other_tools_lead_to_ours(typed: str, hint: str) -> None:
    assert called_here(typed) == hint


def test_a_plugin_in_the_current_folder_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("calm.py").touch()
    text = explain_unknown_key("rewards.calm", {"rewards": {"end": {}}})
    assert "(calm.py is here: add --plugins calm.py)" in text


def test_three_numbers_in_a_row_are_a_span() -> None:
    assert spans([0]) == "0"
    assert spans([0, 1, 3, 4, 5]) == "0, 1, 3 to 5"
