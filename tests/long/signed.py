"""Checkpoints and exported policies to damage, also with valid checksums, and their contents."""

import contextlib
import hashlib
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch

from flipperctl import checkpoint
from flipperctl.agent.risk import weights_of
from flipperctl.cli.inspect import print_checkpoint as show
from flipperctl.config import with_overrides
from flipperctl.export.policy import export
from flipperctl.policies.source import exported_config
from flipperctl.policies.trained import policy_module
from flipperctl.rollout.episode import RolloutRequest
from flipperctl.runtime import OnnxPolicy
from flipperctl.runtime.interface import CHECKSUM, PLACEHOLDER, add_checksum
from flipperctl.training.trainer import Trainer
from tests.long.mutations import Rng, document
from tests.short import short_config, trainer

INPUTS = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 18)).astype(np.float32)


def files(folder: Path) -> dict[str, bytes]:
    """Return ``best`` and ``last`` of a tiny run with a pending request, and ``onnx``."""
    run = folder / "run"
    small = {"network": {"name": "at_d3qn", "terrain": [8], "fused": 8, "head": 8}}
    budget = {"train.decisions": 150, "train.validate_every": 100, "train.validation_episodes": 1}
    config = with_overrides(short_config(**budget), small)
    learner = trainer(config, run)
    learner.run()
    weights = weights_of(learner.learning.driving)
    now = learner.progress
    request = RolloutRequest(now.started, 5, now.decision, now.updates, weights, 1.0)
    learner.progress.started += 1
    learner.save([request])
    saved = checkpoint.read(run / checkpoint.BEST)
    export(saved, folder / "step.onnx")
    whole = (folder / "step.onnx").read_bytes()
    return {
        "best": (run / checkpoint.BEST).read_bytes(),
        "last": (run / checkpoint.LAST).read_bytes(),
        "onnx": whole,
    }


def _model(data: bytes) -> tuple[Any, dict[str, str]]:
    model = onnx.load_from_string(data)
    return model, {p.key: p.value for p in model.metadata_props}


def read_checkpoint(path: Path) -> str:
    """Read a checkpoint as the commands do before they run it; return a hash of its contents."""
    saved = checkpoint.read(checkpoint.find(path))
    found = saved.to_dict()
    with contextlib.redirect_stdout(io.StringIO()):
        print(json.dumps(found))
        show(found, saved)
    config = saved.config()
    module = policy_module(saved)
    with torch.inference_mode():
        values = module(torch.zeros(4, config.network.frames * config.perception.size)).numpy()
    known = [saved.document.text(), saved.content, values.tobytes().hex()]
    if saved.document.kind == "last":
        learner = Trainer(config, path.parents[1])
        learner.restore(saved)
        counted = (learner.progress.decision, learner.learning.counters())
        known += map(str, counted)
    return _hash(known)


def read_onnx(path: Path) -> str:
    """Read an exported file as ``eval`` and a robot do; return a hash of its contents."""
    policy = OnnxPolicy(path)
    config = exported_config(path)
    size = policy.interface.inputs
    values = policy.q_values(np.resize(INPUTS, (50, size)))
    policy.act(np.zeros(policy.interface.size))
    interface = policy.interface
    return _hash(
        [
            repr(interface),
            str(interface.actions.tolist()),
            config.model_dump_json(),
            values.tobytes().hex(),
        ]
    )


def _hash(known: list[str]) -> str:
    return hashlib.sha256("\n".join(known).encode(errors="surrogatepass")).hexdigest()


def resigned(data: bytes, folder: Path, rng: Rng) -> bytes:
    """Return a checkpoint with a changed document and a valid checksum."""
    saved = _saved(data, folder)
    text = document(saved.document.plain(), rng)
    return checkpoint.serialize(text.encode(errors="replace").decode(), saved.tensors)


def resigned_tensors(data: bytes, folder: Path, rng: Rng) -> bytes:
    """Return a checkpoint with a changed tensor and a valid checksum."""
    saved = _saved(data, folder)
    tensors = dict(saved.tensors)
    name = list(tensors)[int(rng.integers(len(tensors)))]
    old = tensors.pop(name)
    changes: list[Callable[[], torch.Tensor | None]] = [
        lambda: None,
        lambda: old.reshape(-1)[:-1],
        lambda: old.unsqueeze(0),
        lambda: old.to(torch.float64),
        lambda: old.to(torch.complex64),
        lambda: old.to(torch.float8_e4m3fn),
        lambda: old.bool(),
        lambda: torch.full_like(old, -7),
        lambda: torch.full_like(old, torch.nan) if old.is_floating_point() else old * 0 + 2**40,
        lambda: torch.zeros(0),
        lambda: torch.tensor(1.0),
    ]
    new = changes[int(rng.integers(len(changes)))]()
    if new is not None:
        tensors[f"more.{name}" if rng.random() < 0.1 else name] = new
    return checkpoint.serialize(saved.document.text(), tensors)


def _saved(data: bytes, folder: Path) -> checkpoint.Checkpoint:
    whole = folder / "whole.safetensors"
    whole.write_bytes(data)
    return checkpoint.read(whole)


def resealed(data: bytes, rng: Rng) -> bytes:
    """Return an exported policy with changed metadata and a valid checksum."""
    model, metadata = _model(data)
    names = sorted(name for name in metadata if name != CHECKSUM)
    for _ in range(int(rng.integers(1, 3))):
        name = names[int(rng.integers(len(names)))]
        value = metadata[name]
        try:
            text = document(json.loads(value), rng)
        except (ValueError, RecursionError):  # no JSON, or changed before
            text = str(rng.choice(["", "x", "mix", "1", "é\n", "null"]))
        metadata[name] = text.encode(errors="replace").decode()
    if rng.random() < 0.1:
        del metadata[names[int(rng.integers(len(names)))]]
    del model.metadata_props[:]
    onnx.helper.set_model_props(model, {**metadata, CHECKSUM: PLACEHOLDER})
    return add_checksum(model.SerializeToString())
