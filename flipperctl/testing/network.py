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
    for layout in LAYOUTS:
        try:
            module = _built(network, layout)
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
    """Check that equal seeds build equal networks, and what their Q-values depend on.

    It is the input and the weights alone, in training the loss's random numbers too; see
    ``agent.contract``, which every training checks as well.
    """
    import torch

    from flipperctl.agent.contract import check_contract

    rows = _observations(network, LAYOUTS[-1])
    one, other = (_built(network).eval() for _ in range(2))
    try:
        check_contract(network, LAYOUTS[-1])
    except FlipperctlError as error:
        raise ConformanceError(str(error)) from error
    with torch.no_grad():
        require(
            bool((one(rows) == other(rows)).all()),
            "two networks built after torch.manual_seed(0) differ; "
            "draw the weights from torch's own generator",
        )


def exportable(network: Network) -> None:
    """Check that the network exports to ONNX with the same Q-values.

    Raises:
        NotChecked: a package that the export needs is not installed.
    """
    from flipperctl.config import TrainConfig
    from flipperctl.export.policy import compare_onnx

    config = TrainConfig(terrain=Ground(), rewards={"none": NoReward()}, network=network)
    module = _built(network).eval().requires_grad_(False)
    try:
        compare_onnx(module, config, _recorded(network))
    except MissingExtraError as error:
        raise NotChecked(str(error)) from error
    except ExportError as error:
        raise ConformanceError(str(error)) from error


def _built(network: Network, layout: ObservationLayout = LAYOUTS[-1]) -> torch.nn.Module:
    import torch

    from flipperctl.agent.networks import build_network
    from flipperctl.agent.noise import Noise

    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        module = build_network(network, layout, len(ACTIONS))
    Noise(module).draw(np.random.default_rng(0))  # without noise, its weights have no gradient
    return module


def _observations(network: Network, layout: ObservationLayout) -> torch.Tensor:
    """Return random numbers of the magnitude of observations, (B, frames · (N + 3))."""
    from flipperctl.agent.contract import observations

    return observations(network, layout, _BATCH)


def _recorded(network: Network) -> Any:
    """Return the observations of an episode on the first scene, (M, frames · (N + 3))."""
    scene = SCENES[0]
    found = [d.perception.observation for d in decisions(scene.environment(), scene.policy, 0)]
    return np.tile(np.stack(found), (1, network.frames))


def _describe(slope: torch.Tensor | None) -> str:
    if slope is None:
        return "missing"
    return "0 everywhere" if bool(slope.isfinite().all()) else "not finite"
