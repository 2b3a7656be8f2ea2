"""Networks of the agent: built from a plugin, their outputs, their greedy decision, their noise.

In: a network plugin and the observation layout. Out: a torch module that was tested on a batch and
on one observation, in ``train()`` and in ``eval()`` mode, and the actions that it decides on.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol, runtime_checkable
from weakref import WeakKeyDictionary

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.frames import input_size
from flipperctl.agent.losses import double_q_target, double_quantile_target, huber, quantile_huber
from flipperctl.agent.plain import Weights, best
from flipperctl.agent.replay import Batch
from flipperctl.api import MAX_HISTORY, Network, ObservationLayout
from flipperctl.core.targets import ActionKind
from flipperctl.errors import ConfigError, NonFiniteError, PluginFailedError
from flipperctl.plugging.guard import definition, naming, plugin_label, refusal, short_repr


@runtime_checkable
class Distributional(Protocol):
    """A network that estimates quantiles of each action's return."""

    def quantiles(self, observation: torch.Tensor, /) -> torch.Tensor:
        """Return K equally likely values of each action's return, (B, A, K)."""


def difference_targets(
    reward: torch.Tensor, batch: Batch, online: torch.nn.Module, target: torch.nn.Module
) -> torch.Tensor:
    """Return the double Q-learning targets of a batch with the scaled rewards ``reward``, (B,).

    A network with quantiles has K equally likely targets for each transition, (B, K).
    """
    values = online(batch.next_observation)
    if isinstance(target, Distributional):
        quantiles = target.quantiles(batch.next_observation)
        return double_quantile_target(reward, batch.discount, values, quantiles)
    return double_q_target(reward, batch.discount, values, target(batch.next_observation))


def difference_loss(
    online: torch.nn.Module, batch: Batch, targets: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the Huber loss between the outputs for the batch's actions and their targets.

    Quantiles learn by quantile regression (Dabney et al. 2018). The second result are the sizes of
    the temporal-difference errors, (B,), of means where there are quantiles.
    """
    if isinstance(online, Distributional):
        rows = torch.arange(len(batch.action), device=batch.action.device)
        quantiles = online.quantiles(batch.observation)[rows, batch.action]
        errors = (quantiles.mean(dim=1) - targets.mean(dim=1)).detach().abs()
        return quantile_huber(quantiles, targets, batch.weight), errors
    values = online(batch.observation).gather(1, batch.action.unsqueeze(1)).squeeze(1)
    return huber(values, targets, batch.weight), (values - targets).detach().abs()


_plugins: WeakKeyDictionary[torch.nn.Module, Network] = WeakKeyDictionary()


_BUFFERS = {torch.bool, torch.uint8, torch.int8, torch.int16, torch.int32, torch.int64}
_BUFFERS |= {torch.float16, torch.float32, torch.float64}
"""Types of a buffer that a checkpoint can hold."""


def build_network(network: Network, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
    """Build a network and check it."""
    with naming(network, "build", ConfigError):
        frames: object = network.frames
        module: Any = network.build(layout, n_actions)
    if not isinstance(frames, int) or not 1 <= frames <= MAX_HISTORY:
        text = f"is {short_repr(frames)}; 1 to {MAX_HISTORY} is allowed"
        raise refusal(network, "frames", text, ConfigError)
    if not isinstance(module, torch.nn.Module):
        text = f"must return a torch module; got {type(module).__name__}"
        raise refusal(network, "build", text, ConfigError)
    record_plugin(module, network)
    _check_state(network, module)
    _separate_memory(network, module)
    with torch.random.fork_rng(devices=[]), torch.no_grad(), _restored_afterwards(module):
        _try(network, module, torch.zeros(2, input_size(network, layout)), n_actions)
    return module


def _check_state(network: Network, module: torch.nn.Module) -> None:
    """Refuse a state that cannot be trained and saved.

    Raises:
        ConfigError: a parameter is not of float32, or an entry is no tensor of real numbers.
    """
    parameters = dict(module.named_parameters())
    for name, value in module.state_dict().items():
        allowed = {torch.float32} if name in parameters else _BUFFERS
        if not isinstance(value, torch.Tensor) or value.dtype not in allowed:
            what = value.dtype if isinstance(value, torch.Tensor) else type(value).__name__
            kinds = "float32" if name in parameters else "a tensor of real numbers, as numpy has"
            text = f"gives {name!r} as {what}; {kinds} is allowed"
            raise refusal(network, "build", text, ConfigError)


def _separate_memory(network: Network, module: torch.nn.Module) -> None:
    """Refuse two tensors of one memory, and write expanded tensors out in full.

    Training and loading would write one over the other. A tensor may have several names.
    """
    owners: dict[int, str] = {}
    for name, tensor in (*module.named_parameters(), *module.named_buffers()):
        if torch.nn.parameter.is_lazy(tensor):
            continue
        with naming(network, "build", ConfigError):  # a sparse tensor has no such memory
            place = tensor.untyped_storage().data_ptr()
            tensor.data = tensor.data.contiguous()
        if place and (other := owners.setdefault(place, name)) != name:
            text = (
                f"gives {other!r} and {name!r} the same memory; to tie weights, assign the "
                "parameter itself, or else give one of them a clone()"
            )
            raise refusal(network, "build", text, ConfigError)


def outputs(kind: ActionKind, joints: int = 2) -> int:
    """Return the number of outputs of a policy's network: Q-values of actions, or rates."""
    return 3**joints if kind == "turns" else joints


def build_policy(
    network: Network, layout: ObservationLayout, kind: ActionKind = "turns"
) -> torch.nn.Module:
    """Build a policy's network, from (B, frames · n) to Q-values (B, 3^J) or rates (B, J).

    The hyperbolic tangent of what the plugin's network returns makes rates from -1 to 1 of it. The
    Q-values of pairs are what it returns, those of four flippers are made of nine for each side.
    """
    joints = len(layout.joints)
    if kind == "turns" and joints == 2:
        return build_network(network, layout, outputs(kind))
    built = build_network(network, layout, joints if kind == "rates" else 9 * (joints // 2))
    module: torch.nn.Module = torch.nn.Sequential(built, torch.nn.Tanh())
    if kind == "turns":
        distributional = isinstance(built, Distributional)
        module = (QuantileBranches if distributional else Branches)(built)
    record_plugin(module, network)
    return module


class Branches(torch.nn.Module):
    """Q-values of all actions of four flippers by a branch of nine values for each side.

    A branch has the turns of its side's front and rear flipper, and a Q-value is the mean of both
    branches'. With dueling heads, these have one V in common and an advantage for each pair of
    turns: Q(s, a) = V + mean over sides of A_s(a_s) - mean A_s (Tavakoli et al. 2018, "Action
    branching architectures", Eq. 1, who have a branch for each joint). The best action has the best
    turns of each side, and its value is the mean of the branches' values, as in their target
    (Eq. 6). Both learn from one error, that of the mean (Seyde et al. 2023, "Solving continuous
    control via Q-learning"). What one flipper shall do depends much on the other of its side, and
    little on those of the other side.
    """

    def __init__(self, branches: torch.nn.Module) -> None:
        """``branches`` maps (B, …) to (B, 18): nine of the left side, nine of the right one."""
        super().__init__()
        self.branches = branches

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Map (B, …) to Q-values (B, 81) in the order of ``actions_of``."""
        return self._joined(self.branches(observation))

    @staticmethod
    def _joined(values: torch.Tensor) -> torch.Tensor:
        """Return the means of all combinations of both branches' values, (B, 18, …)."""
        # Turns of front and rear: of the left side, then of the right one
        sides = values.reshape(-1, 2, 3, 3, *values.shape[2:])
        left, right = sides[:, 0], sides[:, 1]
        total: torch.Tensor = left[:, :, None, :, None] + right[:, None, :, None, :]
        return total.flatten(1, 4) / 2


class QuantileBranches(Branches):
    """The same of a network with quantiles, whose means are combined as well."""

    def quantiles(self, observation: torch.Tensor) -> torch.Tensor:
        """Return the quantiles of each action's return, (B, 3^J, K)."""
        branches: Any = self.branches
        return self._joined(branches.quantiles(observation))


def record_plugin(module: torch.nn.Module, network: Network) -> None:
    """Record the plugin that built a module, so that errors of the module name the plugin."""
    _plugins[module] = network


def describe_fault(module: torch.nn.Module, method: str, text: str) -> str:
    """Return an error text about a module's output, with the name and place of its plugin."""
    network = _plugins.get(module)
    if network is None:
        return f"a {type(module).__name__}: {method} {text}"
    return f"{plugin_label(network)}: {method} {text} ({definition(network, 'build')})"


def _try(network: Network, module: torch.nn.Module, probe: torch.Tensor, n_actions: int) -> None:
    """Raise ConfigError unless the module returns Q-values in every mode that is used later."""
    # Training episodes decide on one observation, the loss and the check of an export on several.
    for mode, rows in (("train", 2), ("train", 1), ("eval", 1), ("eval", 2)):
        module.train(mode == "train")
        shape = rows, probe.shape[1]
        output = _call(network, module, probe[:rows], f" fails on {shape} in {mode}() mode")
        fits = isinstance(output, torch.Tensor) and output.shape == (rows, n_actions)
        if not (fits and output.dtype == torch.float32 and bool(output.isfinite().all())):
            raise _unfit(
                network,
                f"observations {shape} in {mode}() mode must give Q-values ({rows}, {n_actions}), "
                f"finite numbers of float32; the output is {_described(output)}",
            )
    if isinstance(module, Distributional):
        output = _call(network, module, probe, "", "quantiles")
        shape = tuple(getattr(output, "shape", ()))
        if len(shape) != 3 or shape[:2] != (2, n_actions) or not shape[2]:
            raise _unfit(
                network,
                f"observations {tuple(probe.shape)} must give quantiles (2, {n_actions}, K); they "
                f"are {_described(output)}",
            )


def _described(output: object) -> str:
    """Return shape and type of an output, and an example of its numbers."""
    if not isinstance(output, torch.Tensor):
        return f"a {type(output).__name__}"
    example = f", such as {output.flatten()[0]}" if output.numel() else ""
    return f"{tuple(output.shape)} of {output.dtype}{example}"


def _unfit(network: Network, text: str) -> ConfigError:
    where = definition(network, "build")
    return ConfigError(f"{plugin_label(network)}: forward: {text} ({where})")


def _call(
    network: Network, module: Any, probe: torch.Tensor, use: str, method: str = "forward"
) -> Any:
    with naming(network, method, ConfigError, while_=use):
        return module(probe) if method == "forward" else getattr(module, method)(probe)


@contextmanager
def _restored_afterwards(module: torch.nn.Module) -> Iterator[None]:
    """Restore the modes and the buffers, such as running statistics, after a trial."""
    # A trial in train() mode moves running statistics; lazy buffers have no values yet.
    modes = {part: part.training for part in module.modules()}
    lazy = torch.nn.parameter.is_lazy
    buffers = {name: b.clone() for name, b in module.named_buffers() if not lazy(b)}
    yield
    for part, training in modes.items():
        part.training = training
    for name, buffer in module.named_buffers():
        if name in buffers and buffer.shape == buffers[name].shape:
            buffer.copy_(buffers[name])


_CPU = torch.device("cpu")


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread, without gradients; give torch its threads back afterwards.

    That suits networks of this size. On a busy machine, where threads wait for each other, a
    decision took fifteen times as long with two threads, and values of 100 states hundreds of
    times. On a quiet one, a second thread saves half of the time of 600 states. Setting the number
    takes a tenth of a microsecond.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.inference_mode():
            yield
    finally:
        torch.set_num_threads(threads)


def greedy(
    module: torch.nn.Module, observation: NDArray[np.float32], device: torch.device = _CPU
) -> int:
    """Return the action with the largest Q-value, the first one of equals; see ``q_values``."""
    return best(q_values(module, observation, device))


NOT_FINITE = "returned Q-values that are not finite"


def q_values(
    module: torch.nn.Module,
    observation: NDArray[np.float32],
    device: torch.device = _CPU,
    kind: ActionKind = "turns",
    joints: int = 2,
) -> list[float]:
    """Return the Q-values of one observation, (3^J,), or its rates, (J,), by the ``kind``.

    ``module`` is on ``device``. ``observation``: input row of the network, (frames · n,) in
    SI units.
    """
    with one_thread():
        output = module(torch.from_numpy(observation).to(device).unsqueeze(0))
    (values,) = output.tolist()
    total = float(sum(values))
    if len(values) != (needed := outputs(kind, joints)):
        text = f"returned {len(values)} numbers for an observation; {needed} are needed"
        raise PluginFailedError(describe_fault(module, "forward", text))
    if not math.isfinite(total):
        text = f"{NOT_FINITE}: their sum is {total}"
        raise NonFiniteError(describe_fault(module, "forward", text))
    result: list[float] = values
    return result


@runtime_checkable
class Noisy(Protocol):
    """A submodule with exploration noise, in ``train()`` mode only (Fortunato et al. 2018)."""

    def draw_noise(self, rng: np.random.Generator, /) -> None:
        """Draw new noise from ``rng``."""


class Noise:
    """All noisy submodules of a network; there may be none."""

    def __init__(self, module: torch.nn.Module) -> None:
        self._module = module
        self.parts = [part for part in module.modules() if isinstance(part, Noisy)]

    def draw(self, rng: np.random.Generator) -> None:
        """Draw new noise for every noisy submodule; without one, ``rng`` is not used."""
        for part in self.parts:
            part.draw_noise(rng)

    def acts(self) -> None:
        """Put the network into the mode of decisions and targets: ``eval()``, but with its noise.

        What ``train()`` mode does besides, such as dropping units, is for the loss alone.
        """
        self._module.eval()
        for part in self.parts:
            part.train()


def load_arrays(module: torch.nn.Module, weights: Weights) -> None:
    """Give a network the weights of another process."""
    module.load_state_dict({name: torch.from_numpy(array) for name, array in weights.items()})


class TorchNetwork:
    """The outputs of a torch module, see ``agent.plain.Outputs``."""

    def __init__(
        self, module: torch.nn.Module, kind: ActionKind = "turns", joints: int = 2
    ) -> None:
        self._module, self._kind, self._joints = module, kind, joints
        self._noise = Noise(module)
        self._device = next(module.parameters(), torch.empty(0)).device
        self.draw_noise = self._noise.draw

    def load(self, weights: Weights) -> None:
        """Take the weights of another process."""
        load_arrays(self._module, weights)

    def begin(self, noise: bool) -> None:
        """Enter ``eval()`` mode, with the network's noise if it may."""
        (self._noise.acts if noise else self._module.eval)()

    def outputs(self, row: NDArray[np.float32]) -> list[float]:
        """Return the outputs (A,) of an input row, (frames · n,)."""
        return q_values(self._module, row, self._device, self._kind, self._joints)


@contextmanager
def seeded(device: torch.device, *key: int) -> Iterator[None]:
    """Let torch's global generators draw what ``key`` determines; restore them afterwards.

    Layers of torch, such as its dropout, draw from them.
    """
    on = [device] if device.type == "cuda" else []
    with torch.random.fork_rng(devices=on):
        # One word of 64 bits seeds the generators of the CPU and of the GPU.
        (seed,) = np.random.SeedSequence(key).generate_state(1, np.uint64).tolist()
        torch.default_generator.manual_seed(seed)
        if on:
            torch.cuda.manual_seed(seed)
        yield
