"""Checks of what decides: networks (shapes, gradients, repeatability, export) and controllers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import TYPE_CHECKING

import numpy as np

from flipperctl.api import ACTIONS, Controller, Network, ObservationLayout, Perception, Simulator
from flipperctl.core.targets import Action, allowed, as_action
from flipperctl.errors import (
    ConformanceError,
    ExportError,
    FlipperctlError,
    MissingExtraError,
)
from flipperctl.rollout.episode import decisions
from flipperctl.testing.check import NotChecked, of, require
from flipperctl.testing.recorded import SCENES, SHORT, Ground, NoReward, Scene
from flipperctl.text.files import make_folder

if TYPE_CHECKING:
    import torch

LAYOUTS = (ObservationLayout(bins=3), ObservationLayout())
_BATCH = 64
"""Batch size at which no working unit stays inactive on the whole batch [-]."""
DECISIONS = 20
"""Largest number of a controller's decisions on each scene; an episode may end earlier [-]."""
_TRAINING = {
    "train": {"mode": "exact", "decisions": 24, "validation_episodes": 1},
    "agent": {"learning_starts": 8, "batch_size": 8, "update_every": 1},
}
"""A training of a few updates."""
ENOUGH = 0.1
"""Computing time on a scene, or at one variant of the settings, after which it is left [s]."""


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


@of("network", "shape")
@one_thread()
def shape(network: Network) -> None:
    """Check that observations (B, n) give finite float32 Q-values (B, 9), for any N."""
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


@of("network", "gradient")
@one_thread()
def gradient(network: Network) -> None:
    """Check that what learns has a gradient and every input number affects the Q-values.

    A weight with ``requires_grad`` False is frozen and has none.
    """
    # Squares, since the sum of the Q-values has no gradient of a duelling network's advantages.
    module = _built(network)
    observations = _observations(network).requires_grad_()
    module(observations).square().sum().backward()
    for name, parameter in module.named_parameters():
        if not parameter.requires_grad:
            continue
        slope = parameter.grad
        finite = slope is not None and bool(slope.isfinite().all())
        fault = "missing" if slope is None else "0 everywhere" if finite else "not finite"
        require(
            slope is not None and finite and bool(slope.any()),
            f"the gradient of parameter {name!r} is {fault}; it must be finite and not 0",
        )

    # Each number that a sensor gives should matter.
    slope = observations.grad
    used = slope.any(dim=0).tolist() if slope is not None else [False]
    unused = [i for i, effect in enumerate(used) if not effect]
    require(
        not unused,
        f"the Q-values ignore these numbers of the observation, counted from 0: {unused}; "
        "each must have an effect",
    )


@of("network", "repeats", everywhere=False)
def repeats(network: Network) -> None:
    """Check that equal seeds build equal networks, and what their Q-values depend on.

    It is the input and the weights alone, in training the loss's random numbers too; see
    ``agent.contract``, which every training checks as well.
    """
    import torch

    from flipperctl.agent.contract import check_contract

    rows = _observations(network)
    first, other = (_built(network).eval() for _ in range(2))
    try:
        check_contract(network, LAYOUTS[-1])
    except FlipperctlError as error:
        raise ConformanceError(str(error)) from error
    with torch.no_grad():
        require(
            bool((first(rows) == other(rows)).all()),
            "two networks built after torch.manual_seed(0) differ; "
            "draw the weights from torch's own generator",
        )


@of("network", "trains", everywhere=False)
@one_thread()
def trains(network: Network) -> None:
    """Check that a training learns, saves, resumes and loads the network, with equal weights.

    It stops after its first update and is resumed, beside one that goes on.
    """
    import torch

    from flipperctl import checkpoint
    from flipperctl.config import TrainConfig, parse
    from flipperctl.policies.trained import policy_module
    from flipperctl.training.trainer import Trainer

    # Values of a whole training, of its file, and of the same two after an interruption
    scene = {"terrain": Ground(points=SHORT.points), "rewards": {"none": NoReward()}}
    config = parse(TrainConfig, {**scene, "network": network, **SHORT.settings, **_TRAINING})
    rows, values = _observations(network), []
    for interrupted in (False, True):
        with TemporaryDirectory() as name:
            folder = Path(name)
            last = make_folder(folder / checkpoint.LAST.parent) / checkpoint.LAST.name
            trainer = Trainer(config, folder)
            if interrupted:
                trainer.run(stop=partial(getattr, trainer.progress, "updates"))
                trainer = Trainer(config, folder)
                trainer.restore(checkpoint.read(last))
            trainer.run()
            for policy in (trainer.learning.policy, policy_module(checkpoint.read(last))):
                with torch.no_grad():
                    values.append(policy.eval()(rows))
    require(
        all(torch.equal(array, values[0]) for array in values),
        "Q-values differ between a training and its file, or one that was stopped and resumed",
    )


@of("network", "onnx", everywhere=False)
def onnx(network: Network) -> None:
    """Check that the network exports to ONNX with the same Q-values on an episode's observations.

    ``NotChecked`` if a package that the export needs is not installed.
    """
    from flipperctl.config import TrainConfig
    from flipperctl.export.policy import compare_onnx

    scene = SCENES[0]
    observations = [
        d.perception.observation for d in decisions(scene.environment(), scene.policy, 0)
    ]
    config = TrainConfig(terrain=Ground(), rewards={"none": NoReward()}, network=network)
    module = _built(network).eval().requires_grad_(False)
    try:
        compare_onnx(module, config, np.tile(np.stack(observations), (1, network.frames)))
    except MissingExtraError as error:
        raise NotChecked(str(error)) from error
    except ExportError as error:
        raise ConformanceError(str(error)) from error


def _built(network: Network, layout: ObservationLayout = LAYOUTS[-1]) -> torch.nn.Module:
    import torch

    from flipperctl.agent.networks import Noise, build_policy

    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        module = build_policy(network, layout)
    Noise(module).draw(np.random.default_rng(0))  # without noise, its weights have no gradient
    return module


def untrained_values(network: Network) -> list[list[float]]:
    """Return the Q-values, (B, 9), of a network that was built with seed 0."""
    import torch

    with torch.no_grad():
        values: list[list[float]] = _built(network).eval()(_observations(network)).tolist()
    return values


def _observations(network: Network, layout: ObservationLayout = LAYOUTS[-1]) -> torch.Tensor:
    """Return random numbers of the magnitude of observations, (B, frames · n)."""
    from flipperctl.agent.contract import observations

    return observations(network, layout, _BATCH)


@of("controller", "actions")
def actions(controller: Controller) -> None:
    """Check that every action is an index into ``ACTIONS``, or rates.

    A slow controller plays fewer scenes at its outermost settings; ``same_again`` plays all.
    """
    begun = process_time()
    for index in range(len(_scenes(controller))):
        _Player(controller, index).play()
        if process_time() - begun > ENOUGH:
            break


@of("controller", "repeats", everywhere=False)
def same_again(controller: Controller) -> None:
    """Check that equal episodes give equal actions, with random numbers from ``p.rng`` only.

    That holds for another policy of the controller, and for one that has played before.
    """
    for index in range(len(_scenes(controller))):
        # A new policy, then the first one again, which must not remember
        first, other = (_Player(controller, index) for _ in range(2))
        actions, _ = first.play()
        for player, text in (
            (other, "they may depend only on what it perceives and on random numbers from p.rng"),
            (first, "the second one by the same policy, whose reset must forget the first"),
        ):
            again, _ = player.play()
            require(
                all(a == b for a, b in zip(actions, again, strict=False)),  # one may be slower
                f"equal episodes on scene {index} get unequal actions; {text}",
            )
            if controller.searches_first:
                break  # its search is long, and each reset begins it anew


@of("controller", "in time", everywhere=False)
def in_time(controller: Controller) -> None:
    """Check that the median decision takes at most one period, without the search before it."""
    period = SCENES[0].environment().robot.decision_period
    scenes = range(len(_scenes(controller)))
    times = [t for index in scenes for t in _Player(controller, index).play()[1]]
    require(
        median(times) <= period,
        f"its median decision takes {median(times):.2f} s; the next one is due after {period:g} s",
    )


def first_actions(controller: Controller) -> Sequence[Action]:
    """Return the actions of a controller's first decisions on the first scene."""
    actions, _ = _Player(controller, 0).play()
    return actions


def _scenes(controller: Controller) -> Sequence[Scene]:
    return (SHORT,) if controller.searches_first else SCENES


class _Player:
    """A policy of a controller on one scene, whose actions are checked, timed and recorded."""

    def __init__(self, controller: Controller, scene: int) -> None:
        from flipperctl.policies.source import with_files

        self._env = _scenes(controller)[scene].environment()
        self._policy, self._scene = with_files(controller, self._env.config).build(), scene
        self._actions: list[Action] = []
        self._times: list[float] = []  # [s]

    def play(self) -> tuple[list[Action], list[float]]:
        """Play the scene; return the actions and the computing time of each [s].

        The episode is left once these times exceed ``ENOUGH``, since planners are slow at their
        outermost settings.
        """
        self._actions, self._times = [], []
        for _ in islice(decisions(self._env, self, self._scene), DECISIONS):
            if sum(self._times) > ENOUGH:
                break
        return self._actions, self._times

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode of the controller's policy."""
        self._policy.reset(simulator)

    def act(self, p: Perception) -> Action:
        """Return the action of the controller's policy."""
        begun = perf_counter()
        action = self._policy.act(p)
        self._times.append(perf_counter() - begun)
        require(
            as_action(action) is not None,
            f"act returned {action!r} at decision {len(self._actions)} of scene {self._scene}; "
            f"{allowed()}",
        )
        self._actions.append(action)
        return action
