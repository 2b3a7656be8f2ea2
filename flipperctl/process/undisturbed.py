"""Leaves the state of the caller's process as it is, and depends on none of it.

A script's global generators, and its settings of numpy and torch, are the same before and after
every public function, which computes with the same settings in every script.
"""

from __future__ import annotations

import contextlib
import random
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

_COMPUTING = ("cpu", "cuda", "mps", "xpu")
"""Kinds of devices that torch computes on."""


@contextlib.contextmanager
def undisturbed(*, draws_from_numpy: bool = True) -> Iterator[None]:
    """Compute in the body with settings of our own; put back what the caller has.

    That is: the states of the generators of Python, numpy and torch, and numpy's handling of
    errors. Of torch it is also the default type and device, automatic casts, gradients, number of
    threads, precision of matrix products and choice of deterministic algorithms. torch is not
    imported for this.
    ``draws_from_numpy``: whether the body may use numpy's generator, whose state takes 90 µs.
    """
    with contextlib.ExitStack() as caller:
        caller.callback(random.setstate, random.getstate())
        if draws_from_numpy:
            caller.callback(np.random.set_state, np.random.get_state())  # noqa: NPY002
        caller.enter_context(
            np.errstate(divide="warn", over="warn", under="ignore", invalid="warn")
        )
        if "torch" in sys.modules:
            _keep_torch(caller)
        yield


def _keep_torch(caller: contextlib.ExitStack) -> None:
    import torch

    # A seed of the caller's also holds for graphics cards that are first used in the body.
    cuda: Any = torch.cuda
    seed = torch.initial_seed()
    states = cuda.get_rng_state_all() if cuda.is_initialized() else None
    caller.callback(torch.set_rng_state, torch.get_rng_state())

    @caller.callback
    def put_back() -> None:
        if states is not None:
            cuda.set_rng_state_all(states)
        elif cuda.is_initialized():
            cuda.manual_seed_all(seed)

    caller.callback(torch.set_num_threads, torch.get_num_threads())
    torch.set_num_threads(1)
    caller.callback(torch.set_default_dtype, torch.get_default_dtype())
    torch.set_default_dtype(torch.float32)
    caller.callback(torch.set_float32_matmul_precision, torch.get_float32_matmul_precision())
    torch.set_float32_matmul_precision("highest")
    caller.enter_context(torch.inference_mode(False))
    caller.enter_context(torch.enable_grad())

    # These slow torch down, so that they are overridden only where the caller has them.
    if torch.are_deterministic_algorithms_enabled():
        warns = torch.is_deterministic_algorithms_warn_only_enabled()
        caller.callback(torch.use_deterministic_algorithms, True, warn_only=warns)
        torch.use_deterministic_algorithms(False)
    if torch.get_default_device().type != "cpu":
        caller.enter_context(torch.device("cpu"))
    for kind in _COMPUTING:
        if torch.amp.is_autocast_available(kind) and torch.is_autocast_enabled(kind):
            caller.enter_context(torch.autocast(kind, enabled=False))
