"""From a word to a policy: files, shipped policies, controllers, and what tells policies apart."""

import re
import shlex
from itertools import compress, islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from flipperctl import checkpoint
from flipperctl.api import Robot
from flipperctl.config import EnvConfig, TrainConfig, to_dict
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import CheckpointError, ConfigError, RequestError
from flipperctl.evaluation.rows import reached
from flipperctl.policies.controllers import PluginPolicy
from flipperctl.policies.identity import PolicyIdentity
from flipperctl.policies.source import (
    PolicySource,
    Takes,
    controller_policy,
    learned_value,
    load_policy,
)
from flipperctl.policies.trained import value_of
from flipperctl.requests import compose
from flipperctl.requests.text import from_words
from flipperctl.rollout.episode import decisions
from tests.played import play_episodes
from tests.short import short_config

CONFIG = EnvConfig(terrain="step", perception={"highest": False})  # as the shipped values have it
VALUE = "controller.value"
SHIPPED = sorted(checkpoint.shipped_policies().items())


def test_a_word_is_a_controller_a_file_or_a_shipped_policy_in_this_order(
    short_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("okada", "generalist"):
        Path(name).symlink_to(short_run)
    assert load_policy("okada").label() == "okada"
    assert load_policy("./okada").file == Path("okada") / checkpoint.BEST
    assert load_policy("okada", takes="file").file == Path("okada") / checkpoint.BEST
    assert load_policy("generalist").file == Path("generalist") / checkpoint.BEST
    assert load_policy("mpc_value").label() == "mpc_value"


@pytest.mark.parametrize(
    ("word", "takes", "error", "text"),
    [
        ("okado", "any", ConfigError, "^x: okado: there is no .* or controller .did you mean 'ok"),
        ("runs/okada", "any", CheckpointError, "^x: runs/okada: there is no such run, file, ship"),
        ("stair", "any", ConfigError, "^x: stair: there is no .* .did you mean terrain=stair.."),
        ("planar", "any", ConfigError, "did you mean sim=planar or perception=planar"),
        ("impact", "any", ConfigError, "did you mean rewards.impact=impact"),
        ("okada", "file", CheckpointError, "file or shipped policy; names: generalist"),
        ("a" * 5000, "any", ConfigError, "there is no such run"),
        ("generalist", "controller", RequestError, "^x: controllers are allowed, and generalist"),
        ("okado", "controller", ConfigError, "^x: there is no controller plugin 'okado'"),
        (3, "any", ConfigError, "^x: a path or a name is allowed; the value is 3"),
    ],
)
def test_a_wrong_word_says_what_is_allowed(
    word: str, takes: Takes, error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text):
        load_policy(word, "x", takes)


def test_a_run_is_found_from_the_working_directory(
    short_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(short_run.parent)
    whole = learned_value(str(short_run), VALUE)
    observations = np.zeros((2, whole.layout.size), np.float32)
    expected = whole.value(observations)
    assert expected.shape == (2,)
    for name in (short_run.name, f"{short_run.name}/checkpoints/best.safetensors"):
        assert learned_value(name, VALUE).value(observations) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("generalis", None, "there is no such run, file or .* .did you mean 'generalist'"),
        ("exported.onnx", "", "an exported file holds no training"),
        ("damaged.safetensors", "nothing", "is damaged or not a safetensors file"),
        ("generalist", None, "a network of one observation is allowed"),
    ],
)
def test_a_wrong_file_is_named_with_the_setting(
    name: str, content: str | None, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if content is not None:
        Path(name).write_text(content)
    source = PolicySource(settings={"name": "mpc", "value": name})
    with pytest.raises(CheckpointError, match=rf"^controller\.value[:=].*{name}.*{text}"):
        source.build(EnvConfig(terrain="step"))


def test_robots_of_sampled_sizes_are_those_of_the_training() -> None:
    config = short_config(**{"randomise.robot.size": [0.6, 1.4]})
    value = value_of(torch.nn.Identity(), config)
    for size, fits in ((0.62, True), (1.0, True), (1.38, True), (0.5, False), (1.6, False)):
        robot = config.robot.model_copy(
            update={name: size * getattr(config.robot, name) for name in Robot.factors["size"]}
        )
        assert (not list(value.misfits(robot, config.perception.layout))) is fits


def source(*names: str) -> PolicySource:
    first, *others = names
    return PolicySource(settings={"name": "greedy", "policy": first, "others": others})


def policy(*names: str) -> PluginPolicy:
    return controller_policy(source(*names).controller(), CONFIG)


def test_several_policies_drive_by_the_mean_of_their_values() -> None:
    first, second = policy("mpc_value"), policy("mpc_value_large")
    both, same = policy("mpc_value", "mpc_value_large"), policy("mpc_value", "mpc_value")
    for decision in islice(decisions(FlipperEnv(config=CONFIG), both, seed=2), 20):
        p = decision.perception
        mean = (first.costs(p) + second.costs(p)) / 2
        np.testing.assert_allclose(both.costs(p), mean, rtol=1e-6)
        np.testing.assert_allclose(same.costs(p), first.costs(p), rtol=1e-6)
        assert decision.action == mean.argmin()


def test_each_of_several_policies_is_part_of_the_identity(tmp_path: Path) -> None:
    copy = tmp_path / "copy.safetensors"
    copy.write_bytes(Path("flipperctl/policies/mpc_value.safetensors").read_bytes())
    digests = [
        PolicyIdentity.of(source(*names)).digest
        for names in (
            ("generalist",),
            ("generalist", "mpc_value"),
            ("generalist", str(copy)),
            ("mpc_value", "generalist"),
        )
    ]
    assert digests[1] == digests[2], "the content counts, not the place"
    assert len({digests[0], digests[1], digests[3]}) == 3


@pytest.mark.parametrize(
    ("names", "error", "text"),
    [
        (("mpc_value", "nowhere"), CheckpointError, r"^controller\.others\[0\]: nowhere: there"),
        (("",), ConfigError, "policy: '' is no policy of a file"),
    ],
)
def test_what_is_no_policy_is_refused(
    names: tuple[str, ...], error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text):
        source(*names).build(CONFIG)


def command(path: Path, config: TrainConfig) -> list[str]:
    """Return the overrides of the last training that the card names, with its own start."""
    found = re.findall(r"`flipperctl train ([^`]+)`", path.with_suffix(".md").read_text())
    return shlex.split(found[-1].replace("=RUN", f"={config.agent.start_from}"))


def without_newer(terrain: Any) -> Any:
    """Return a terrain without what its mixes have had since the shipped policies were trained."""
    if isinstance(terrain, list):
        return [without_newer(part) for part in terrain]
    if not isinstance(terrain, dict):
        return terrain
    kept = [p["name"] != "plates" and p.get("longest") != 8.0 for p in terrain.get("parts", [])]
    older = {key: list(compress(terrain[key], kept)) for key in ("parts", "weights") if kept}
    return {key: without_newer(value) for key, value in {**terrain, **older}.items()}


@pytest.mark.parametrize(("name", "path"), SHIPPED)
def test_a_shipped_policy_has_the_configuration_of_its_command_and_reaches_the_finish(
    name: str, path: Path
) -> None:
    card = path.with_suffix(".md").read_text()
    for heading in ("## What it is for", "## How it was trained", "## How it was evaluated"):
        assert heading in card
    assert f"experiment={name}" in card
    saved = checkpoint.read(load_policy(name).file)
    assert saved.path == path
    compose.register_defaults()
    (experiment,) = compose.compose_train(from_words(command(path, saved.config())))
    trained, wanted = to_dict(saved.config()), to_dict(experiment)
    if name != "generalist":
        wanted["terrain"] = without_newer(wanted["terrain"])
    for terrain in (trained["terrain"], wanted["terrain"]):
        del terrain["name"]  # all_kinds was a mix with these parts when mpc_value was trained
    for train in (trained["train"], wanted["train"]):
        del train["best_by"]  # newer than the policies; the weights of mpc_value are the last ones
    assert trained == wanted
    config = saved.config().environment()
    rows = play_episodes(config, PolicySource(checkpoint=path), episodes=3, seed=0)
    assert sum(reached(row) for row in rows) >= 2
