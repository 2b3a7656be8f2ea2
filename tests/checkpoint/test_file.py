"""Checkpoint files: damaged, foreign and dangerous files are refused with one clear error."""

import json
import os
import pickle
import resource
import shutil
import signal
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import save_file

from flipperctl import checkpoint
from flipperctl.api import registry
from flipperctl.config.models import AbsentTerrain
from flipperctl.errors import CheckpointError, WriteError
from flipperctl.policies.trained import policy_module


@pytest.fixture
def best(short_run: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(short_run / checkpoint.BEST, tmp_path / "best.safetensors"))


def resign(path: Path, changes: dict[str, object]) -> None:
    """Change the document (``"state.orders.0.seed": 3``; ``...`` deletes) and its checksum."""
    saved = checkpoint.read(path)
    document = saved.document.plain()
    for key, value in changes.items():
        *parents, leaf = (int(part) if part.isdecimal() else part for part in key.split("."))
        node: Any = document
        for parent in parents:
            node = node[parent]
        if value is ...:
            del node[leaf]
        else:
            node[leaf] = value
    path.write_bytes(checkpoint.serialize(json.dumps(document), saved.tensors))


def test_a_checkpoint_describes_itself(best: Path) -> None:
    saved = checkpoint.read(best)
    assert saved.document.format == 2
    assert saved.document.config.terrain.name == "step"
    assert saved.document.versions["torch"] == torch.__version__
    (network,) = [p for p in saved.document.plugins if p.kind == "network"]
    assert (network.name, network.module) == ("at_d3qn", "flipperctl_plugins.networks.d3qn")
    assert saved.config().seed == 7


@pytest.mark.usefixtures("registry")
def test_a_policy_is_read_again_when_its_file_or_the_plugins_change(best: Path) -> None:
    first = checkpoint.read_policy(best)
    assert checkpoint.read_policy(best) is first
    config = first.policy_config()
    assert first.policy_config() is config
    del registry["terrain", "step"]
    assert isinstance(first.policy_config().terrain, AbsentTerrain)
    resign(best, {"config.seed": 8})
    assert checkpoint.read_policy(best).document.config.seed == 8
    best.unlink()
    with pytest.raises(CheckpointError, match="there is no such checkpoint"):
        checkpoint.read_policy(best)


def test_every_flipped_bit_is_found(best: Path) -> None:
    data = best.read_bytes()
    # Some in the header, in the document, in the digest, in the weights.
    for at in (0, 9, 100, 2000, len(data) // 2, len(data) - 1):
        best.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        with pytest.raises(CheckpointError, match=r"damaged|no checkpoint"):
            checkpoint.read(best)


@pytest.mark.parametrize("size", [0, 500, -1])
def test_a_truncated_file_is_damaged(best: Path, size: int) -> None:
    best.write_bytes(best.read_bytes()[:size])
    with pytest.raises(CheckpointError, match="damaged"):
        checkpoint.read(best)


def test_a_foreign_safetensors_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.safetensors"
    save_file({"weight": torch.zeros(2)}, path)
    with pytest.raises(CheckpointError, match="not a checkpoint of flipperctl"):
        checkpoint.read(path)


class Mine:
    """Creates a folder if it is ever unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.mkdir, (str(self.trace),)


@pytest.mark.parametrize("how", ["pickle", "torch"])
def test_a_pickle_is_refused_and_never_executed(tmp_path: Path, how: str) -> None:
    path, trace = tmp_path / "best.safetensors", tmp_path / "executed"
    if how == "pickle":
        path.write_bytes(pickle.dumps(Mine(trace)))
    else:
        torch.save(Mine(trace), path)
    with pytest.raises(CheckpointError, match="never loads"):
        checkpoint.read(path)
    assert not trace.exists()
    pickle.loads(pickle.dumps(Mine(trace)))  # the trap does work
    assert trace.exists()


def test_a_header_whose_length_looks_like_a_pickle_is_read(best: Path) -> None:
    for padding in range(256):  # until the length's lowest byte is a pickle's first, 0x80
        resign(best, {"versions.padding": "x" * padding})
        if best.read_bytes()[:1] == b"\x80":
            break
    assert best.read_bytes()[:1] == b"\x80"
    assert checkpoint.read(best).document.versions["padding"] == "x" * padding


def test_weights_of_another_shape_are_refused(best: Path) -> None:
    resign(best, {"config.network.head": 32})
    with pytest.raises(CheckpointError, match="do not fit network 'at_d3qn'"):
        policy_module(checkpoint.read(best))


def test_equal_contents_are_equal_files(best: Path) -> None:
    saved = checkpoint.read(best)
    # safetensors itself gives the two entries of the metadata in one of two orders, by chance.
    files = {checkpoint.serialize(saved.document.text(), saved.tensors) for _ in range(12)}
    assert files == {best.read_bytes()}


def test_the_content_hash_covers_results_and_weights(best: Path) -> None:
    content = checkpoint.read(best).content
    resign(best, {"versions.torch": "9.9", "config.logger": {}})
    assert checkpoint.read(best).content == content
    resign(best, {"validation.t_cost": 1.0})
    assert checkpoint.read(best).content != content


def test_a_run_directory_stands_for_its_checkpoint(short_run: Path, tmp_path: Path) -> None:
    assert checkpoint.find(short_run) == short_run / checkpoint.BEST
    assert checkpoint.find(short_run, checkpoint.LAST) == short_run / checkpoint.LAST
    with pytest.raises(CheckpointError, match="is it a run directory"):
        checkpoint.find(tmp_path)
    with pytest.raises(CheckpointError, match="no such run"):
        checkpoint.find(tmp_path / "missing")
    last = tmp_path / "0_seed=1" / checkpoint.LAST
    last.parent.mkdir(parents=True)
    last.touch()
    with pytest.raises(CheckpointError, match=r"one of its runs, such as .*0_seed=1"):
        checkpoint.find(tmp_path)


def test_a_misspelt_run_suggests_the_run_beside_it(short_run: Path, tmp_path: Path) -> None:
    (tmp_path / "first").symlink_to(short_run)
    (tmp_path / "frost").mkdir()  # no run
    with pytest.raises(CheckpointError, match=r"did you mean '.*/first'\?"):
        checkpoint.find(tmp_path / "frist")
    with pytest.raises(CheckpointError, match="did you mean 'generalist'"):
        checkpoint.find(Path("generalsit"))


def test_a_disk_that_fills_up_while_writing_keeps_the_old_checkpoint(best: Path) -> None:
    before, saved = best.read_bytes(), checkpoint.read(best)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))  # full after 4 KiB
    try:
        with pytest.raises(WriteError, match="writing failed half way"):
            checkpoint.write(best, saved.document, saved.tensors)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, ignored)
    assert best.read_bytes() == before
    assert list(best.parent.iterdir()) == [best]
