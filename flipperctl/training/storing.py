"""The replay of a run, and how the steps of its episodes enter it."""

from __future__ import annotations

from flipperctl.agent.frames import input_size
from flipperctl.agent.replay import Replay
from flipperctl.api import ACTIONS, ObservationLayout, Outcome
from flipperctl.config import TrainConfig
from flipperctl.rollout.values import Step


def new_replay(config: TrainConfig, layout: ObservationLayout, privileged: int) -> Replay:
    """Return an empty replay; ``privileged`` is the length of a privileged state, 0 without them.

    Raises:
        ConfigError: there is not enough memory.
    """
    agent = config.agent
    return Replay(
        *(agent.replay_size, input_size(config.network, layout), agent.n_step, agent.gamma),
        labels=len(ACTIONS) if config.keeps_distributions else 0,
        privileged=privileged,
        risk_horizon=agent.risk_horizon if agent.risk else 0,
        newest=layout.size,
        cut_at_random=agent.cut_at_random,
    )


def store(replay: Replay, step: Step, config: TrainConfig) -> None:
    """Put a step into the replay."""
    ending, bootstrapped = step.ending, config.agent.bootstrap_outcomes
    replay.add(
        step.observation,
        step.action,
        step.reward,
        step.next_observation,
        over=ending is not None,
        bootstrap=ending is not None and ending["outcome"] in bootstrapped,
        explored=step.explored,
        failed=ending is not None and ending["outcome"] != Outcome.REACHED,
        label=step.label,
        privileged=step.privileged,
        next_privileged=step.next_privileged,
    )
