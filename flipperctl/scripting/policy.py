"""A policy to call from Python, whatever file or name it comes from.

Policies of files act on observations alone. Controllers may need points of the ground or a
simulator, so they act on the perceptions of an environment.
"""

from __future__ import annotations

import operator
import os
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, SupportsIndex, cast
from uuid import uuid4

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from flipperctl.api import (
    MAX_HISTORY,
    NAME_RULE,
    Controller,
    ObservationLayout,
    Perception,
    Policy,
    Robot,
    controller,
    is_plugin_name,
    registry,
)
from flipperctl.config import EnvConfig
from flipperctl.config.policy_file import is_policy_file
from flipperctl.core.targets import Action
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import NonFiniteError, PolicyError, RequestError
from flipperctl.evaluation.conditions import read_config
from flipperctl.policies.source import FilePolicy, PolicySource, load_policy
from flipperctl.requests.compose import with_preset
from flipperctl.scripting.settings import Paths, begin, deciding, public
from flipperctl.terminal.streams import print_note

if TYPE_CHECKING:
    from torch import nn


@public
def load(policy: str | os.PathLike[str], *, plugins: Paths = (), **fields: object) -> LoadedPolicy:
    """Load a policy to call.

    ``policy``: a run, a checkpoint, an exported ``.onnx`` file, the name of a shipped policy or of
    a controller, or a file of ``flipperctl tune``; ``fields`` are settings of a controller.
    ``plugins``: files or folders of plugins.

    Raises:
        CheckpointError: the run or checkpoint is missing or damaged, or lacks a plugin.
        ConfigError: there is no such policy, or a field of the controller is wrong.
        PluginError: a plugin cannot be loaded.
        PolicyError: the exported file is damaged.
        RequestError: fields are given for a file, whose settings are fixed.
    """
    begin(plugins)
    if ("controller", str(policy)) in registry or is_policy_file(str(policy)):
        controller = with_preset({"name": str(policy), **fields}, "controller")
        return LoadedPolicy(load_policy(policy, "controller", fields=controller), None, fields)
    source = load_policy(policy, "policy", tell=print_note)
    if fields:
        raise RequestError(
            f"{policy}: {', '.join(fields)}: settings are those of a controller; a file has its own"
        )
    return LoadedPolicy(source, read_config(source, (), print_note))


Function = Callable[[NDArray[np.float32]], SupportsIndex | Sequence[float]]
"""From an observation, (n,) in SI units, to an index into ``ACTIONS``, or to two rates."""


class _FunctionController(Controller):
    """Acts by a function of this process."""

    function: ClassVar[Function]

    @public
    def act(self, p: Perception) -> Any:
        """Return what the function returns for the observation."""
        returned = type(self).function(p.observation)
        try:
            return operator.index(cast("SupportsIndex", returned))
        except TypeError:  # rates, or nothing that is an action
            return returned


def function_policy(function: Function) -> str:
    """Register a function from an observation to an action as a controller; return its name.

    The controller has the name of the function. It replaces one of an earlier function, whose
    stored episodes are not taken for its own: what a function computes may have changed.

    Raises:
        RequestError: the function has no name, or one that a controller cannot have or has.
    """
    name = getattr(function, "__name__", type(function).__name__).strip("<>").lower()
    if not is_plugin_name(name):
        raise RequestError(f"policy: a function cannot be called {name!r} here: {NAME_RULE}")
    earlier = registry.get((Controller.kind, name))
    if earlier is not None:
        if not issubclass(earlier, _FunctionController):
            raise RequestError(
                f"policy: there is a controller {name!r}; give the function another name"
            )
        del registry[Controller.kind, name]
    # Worker processes do not have it, as they lack what a notebook defines.
    members: dict[str, object] = {"__module__": "__main__", "function": staticmethod(function)}
    members |= {"__doc__": function.__doc__ or "A function.", "revision": uuid4().hex}
    controller(name)(type(name, (_FunctionController,), members))
    return name


@public
def save(
    network: nn.Module,
    env: gymnasium.Env[Any, Any],
    output: str | os.PathLike[str],
    *,
    seed: int = 0,
) -> LoadedPolicy:
    """Write a network of any origin as an exported policy, an ``.onnx`` file; load the policy.

    The file is evaluated, compared and run on a robot like that of a run. ``network``: a module of
    torch from observations (B, n) in SI units to (B, 9), whose largest number is the action, such
    as Q-values or logits; with ``actions="rates"`` to two rates from -1 to 1, (B, 2). ``env``: the
    environment of its training, which names layout and robot. ``seed``: that of the training, which
    tells the training seeds of one method apart.

    Raises:
        ExportError: torch cannot export the network; nothing is written.
        OutputError: the file cannot be written, or is no exported policy.
        RequestError: the network takes or returns other numbers, or ``env`` is none of flipperctl.
    """
    from flipperctl.export.policy import save_network

    task = _task(env)
    save_network(network, task.config, Path(output), seed, task.actions)
    return load(output)


def _task(env: gymnasium.Env[Any, Any]) -> FlipperEnv:
    task = getattr(env, "unwrapped", None)
    if not isinstance(task, FlipperEnv):
        raise RequestError(f"{env}: an environment of flipperctl is allowed (Flipper-v0)")
    return task


class LoadedPolicy:
    """A policy to call; ``flipperctl.load`` returns it."""

    def __init__(
        self,
        source: PolicySource,
        trained: EnvConfig | None = None,
        fields: Mapping[str, object] = {},
    ) -> None:
        """``trained``: the environment that a file describes; ``fields``: of a controller."""
        self.source = source
        self.fields = dict(fields)
        self._policy: Policy | None = None
        self._config: EnvConfig | None = None
        self._recent: deque[NDArray[np.float32]] = deque(maxlen=MAX_HISTORY)
        if trained is not None:
            self._build(trained)

    def __repr__(self) -> str:
        return f"LoadedPolicy({self.name!r})"

    @property
    def name(self) -> str:
        """Name of the shipped policy or controller, else the path of the file."""
        return self.source.label()

    @property
    def layout(self) -> ObservationLayout | None:
        """Layout of the observations; None of a controller before its first ``reset``."""
        return None if self._config is None else self._config.perception.layout

    @property
    def robot(self) -> Robot | None:
        """Robot that the policy drives; None of a controller before its first ``reset``."""
        return None if self._config is None else self._config.robot

    @public
    def reset(self, env: gymnasium.Env[Any, Any] | None = None) -> None:
        """Begin an episode.

        ``env``: the environment, after its own ``reset``. A policy of a file needs none; with one,
        its layout and its robot are checked. A controller needs one.

        Raises:
            CheckpointError: the environment has another observation layout.
            ConfigError: its robot contradicts what an exported file applies itself.
            RequestError: it is no environment of flipperctl, or no episode of it runs.
        """
        self._recent.clear()
        if env is None:
            self._observing("reset()").reset()
            return
        task = _task(env)
        if not task.running:
            raise RequestError("reset(env) begins the policy's episode after env.reset()")
        if task.config is not self._config or self._policy is None:
            self._build(task.config)
        assert self._policy is not None
        self._policy.reset(task.simulator())

    @deciding
    def __call__(self, observation: ArrayLike) -> Action:
        """Return the action, an index into ``flipperctl.api.ACTIONS`` or rates, for an observation.

        ``observation``: (n,) in SI units, in the order of ``layout``. Earlier observations
        since ``reset`` are remembered for networks that take several.

        Raises:
            NonFiniteError: a number of the observation is NaN or infinite.
            PolicyError: the observation has another shape.
            RequestError: the policy is a controller, which acts on perceptions.
        """
        policy = self._observing("an observation")
        try:
            array = np.array(observation, dtype=np.float32)
        except (TypeError, ValueError) as error:
            raise PolicyError(f"{self.name}: the observation is not numbers: {error}") from error
        assert self.layout is not None  # as of every policy that acts on observations
        if array.shape != (self.layout.size,):
            raise PolicyError(
                f"{self.name}: the observation has shape {array.shape}; ({self.layout.size},) is "
                f"allowed: {self.layout.heights} terrain heights and "
                f"{self.layout.size - self.layout.heights} angles"
            )
        if not np.isfinite(array).all():
            raise NonFiniteError(f"{self.name}: the observation is not finite: {array}")
        self._recent.append(array)
        return policy.act_on(tuple(self._recent))

    @public
    def act(self, perception: Perception) -> Action:
        """Return the action, an index into ``flipperctl.api.ACTIONS`` or rates, for a perception.

        ``perception``: ``env.unwrapped.perception``, which holds the earlier observations as well.

        Raises:
            PluginFailedError: the controller returned what is no action.
            RequestError: a controller's episode was not begun by ``reset(env)``.
        """
        if self._policy is None:
            raise RequestError(f"{self.name}: reset(env) must begin the episode of a controller")
        return self._policy.act(perception)

    def _build(self, config: EnvConfig) -> None:
        for note in self.source.notes(config):
            print_note(note)
        self._policy, self._config = self.source.build(config), config

    def _observing(self, inputs: str) -> FilePolicy:
        if self.source.checkpoint is not None:
            return cast("FilePolicy", self._policy)
        raise RequestError(
            f"{self.name} is a controller, which may need more than {inputs}: points of the ground "
            "or a simulator. Begin its episodes with reset(env), and call "
            "act(env.unwrapped.perception)"
        )
