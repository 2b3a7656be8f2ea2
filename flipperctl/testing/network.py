"""Checks of a network: shapes, gradients, repeatability and export."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from flipperctl.api import ACTIONS, Network, ObservationLayout
from flipperctl.errors import (
    ConformanceError,
    ExportError,
    FlipperctlError,
    MissingExtraError,
)
from flipperctl.rollout.episode import decisions
from flipperctl.testing.check import NotChecked, require
from flipperctl.testing.recorded import SCENES, Ground, NoReward

if TYPE_CHECKING:
    import torch

LAYOUTS = (ObservationLayout(bins=3), ObservationLayout())
_BATCH = 64
"""Batch size at which no working unit stays inactive on the whole batch [-]."""
_ALONE = 1e-3
"""Tolerance of Q-values whose sums are in another order, relative and absolute [-]."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch on one thread; at these sizes, several threads slow each other down."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def shape(network: Network) -> None:
    """Check that observations (B, N + 3) give finite float32 Q-values (B, 9), for any N."""
    from flipperctl.agent.building import build_network

    for layout in LAYOUTS:
        _seed()
        try:
            module = build_network(network, layout, len(ACTIONS))
        except FlipperctlError as error:
            raise ConformanceError(f"with perception.bins={layout.bins}: {error}") from error
        q = module(_observations(network, layout))
        require(bool(q.isfinite().all()), f"with perception.bins={layout.bins}: Q is not finite")
        require(
            tuple(q.shape) == (_BATCH, len(ACTIONS)), f"Q of a batch has shape {tuple(q.shape)}"
        )


def gradient(network: Network) -> None:
    """Check that every parameter has a gradient and every input number affects the Q-values."""
    module = _built(network)
    observations = _observations(network, LAYOUTS[-1]).requires_grad_()
    module(observations).square().sum().backward()
    for name, parameter in module.named_parameters():
        slope = parameter.grad
        require(
            slope is not None and bool(slope.isfinite().all()) and bool(slope.any()),
            f"the gradient of parameter {name!r} is {_describe(slope)}; "
            "it must be finite and not 0",
        )
    slope = observations.grad
    used = slope.any(dim=0).tolist() if slope is not None else [False]
    unused = [i for i, effect in enumerate(used) if not effect]
    require(
        not unused,
        f"the Q-values ignore these numbers of the observation, counted from 0: {unused}; "
        "each must have an effect",
    )


def repeats(network: Network) -> None:
    """Check that equal seeds build equal networks, and that eval mode is deterministic.

    An observation has the same Q-values alone as in a batch: policies act on one at a time.
    """
    import torch

    observations = _observations(network, LAYOUTS[-1])
    one, other = (_built(network).eval() for _ in range(2))
    with torch.inference_mode():
        first, again, second = one(observations), one(observations), other(observations)
        alone = torch.cat([one(row[None]) for row in observations])
    require(bool((first == again).all()), "in eval mode, equal observations give unequal Q-values")
    require(
        bool((first == second).all()),
        "two networks built after torch.manual_seed(0) differ; "
        "draw the weights from torch's own generator",
    )
    require(
        torch.allclose(first, alone, rtol=_ALONE, atol=_ALONE),
        "an observation has other Q-values alone than in a batch; a mean over the batch, such as "
        ".mean() without dim=1, mixes them",
    )


def exportable(network: Network) -> None:
    """Check that the network exports to ONNX with the same Q-values.

    Raises:
        NotChecked: a package that the export needs is not installed.
    """
    from flipperctl.config import TrainConfig
    from flipperctl.export.onnx import compare_onnx

    config = TrainConfig(terrain=Ground(), rewards={"none": NoReward()}, network=network)
    module = _built(network).eval().requires_grad_(False)
    try:
        compare_onnx(module, config, _recorded(network))
    except MissingExtraError as error:
        raise NotChecked(str(error)) from error
    except ExportError as error:
        raise ConformanceError(str(error)) from error


def _built(network: Network) -> torch.nn.Module:
    _seed()
    module = network.build(LAYOUTS[-1], len(ACTIONS))
    for part in module.modules():
        draw: Any = getattr(part, "draw_noise", None)
        if draw is not None:  # without noise, its weights have no gradient
            draw(np.random.default_rng(0))
    return module


def _seed() -> None:
    import torch

    torch.manual_seed(0)


def _frames(network: Network) -> int:
    """Return the number of successive observations that the network takes as input [-]."""
    return int(getattr(network, "frames", 1))


def _observations(network: Network, layout: ObservationLayout) -> torch.Tensor:
    """Return random numbers of the magnitude of observations, (B, frames · (N + 3))."""
    import torch

    scale = torch.tensor(np.tile(layout.scale, _frames(network)), dtype=torch.float32)
    generator = torch.Generator().manual_seed(0)
    return torch.randn(_BATCH, len(scale), generator=generator) * scale


def _recorded(network: Network) -> Any:
    """Return the observations of an episode on the first scene, (M, frames · (N + 3))."""
    scene = SCENES[0]
    found = [d.perception.observation for d in decisions(scene.environment(), scene.policy, 0)]
    return np.tile(np.stack(found), (1, _frames(network)))


def _describe(slope: torch.Tensor | None) -> str:
    if slope is None:
        return "missing"
    return "0 everywhere" if bool(slope.isfinite().all()) else "not finite"
