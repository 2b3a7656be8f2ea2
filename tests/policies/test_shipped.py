"""The policies that come with the package are complete, described and up to date."""

import re
import shlex
from pathlib import Path

import pytest

from flipperctl import checkpoint
from flipperctl.cli.hydra import compose, config_store
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.config import TrainConfig, to_dict
from flipperctl.errors import CheckpointError
from flipperctl.evaluation.rows import reached
from flipperctl.policies.source import PolicySource
from tests.played import play_episodes

SHIPPED = sorted(checkpoint.shipped_policies().items())


def test_there_is_a_generalist() -> None:
    assert "generalist" in dict(SHIPPED)


def command(path: Path, config: TrainConfig) -> list[str]:
    """Return the overrides of the last training that the card names, with its own start."""
    found = re.findall(r"`flipperctl train ([^`]+)`", path.with_suffix(".md").read_text())
    return shlex.split(found[-1].replace("=RUN", f"={config.agent.start_from}"))


@pytest.mark.parametrize(("name", "path"), SHIPPED)
def test_a_shipped_policy_has_the_configuration_of_its_command_and_reaches_the_finish(
    name: str, path: Path
) -> None:
    saved = checkpoint.read(checkpoint.find(Path(name)))
    assert saved.path == path
    config_store.register_defaults()
    (experiment,) = compose.compose_train(Overrides.parse(command(path, saved.config())))
    trained, wanted = to_dict(saved.config()), to_dict(experiment)
    for terrain in (trained["terrain"], wanted["terrain"]):
        del terrain["name"]  # all_kinds was a mix with these parts when mpc_value was trained
    for train in (trained["train"], wanted["train"]):
        del train["best_by"]  # newer than the policies; the weights of mpc_value are the last ones
    assert trained == wanted
    config = saved.config().environment()
    rows = play_episodes(config, PolicySource(checkpoint=path), episodes=5, seed=0)
    assert sum(reached(row) for row in rows) >= 4


@pytest.mark.parametrize(("name", "path"), SHIPPED)
def test_a_shipped_policy_has_its_card(name: str, path: Path) -> None:
    card = path.with_suffix(".md").read_text()
    for heading in ("## What it is for", "## How it was trained", "## How it was evaluated"):
        assert heading in card
    assert f"experiment={name}" in card


def test_the_error_for_an_unknown_policy_names_a_close_match(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="did you mean 'generalist'"):
        checkpoint.find(Path("generalst"))
