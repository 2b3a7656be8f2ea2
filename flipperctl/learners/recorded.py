"""The recorded episodes that a training learns from, and what must be equal in both.

In: a training's configuration and a file of recorded episodes. Out: transitions in the replay; an
error if the episodes have another meaning in the training; notes on the conditions that differ and
on what has no effect.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

from flipperctl.agent.frames import stacked
from flipperctl.agent.replay import Replay
from flipperctl.api import MAX_HISTORY, ObservationLayout, Robot
from flipperctl.checkpoint import former, recording
from flipperctl.checkpoint.recording import PartialEnvironment, Recording
from flipperctl.config import TrainConfig, to_dict
from flipperctl.config.identity import ABSENT, differences
from flipperctl.errors import ConfigError
from flipperctl.learners.settings import D3qnSettings

_SECTIONS = ("sim", "perception", "episode", "randomise")
"""Sections of an environment that may differ: the student can learn from other conditions."""


def check_fit(config: TrainConfig, episodes: Recording) -> None:
    """Check that recorded episodes mean the same in a training.

    The observation layout and the robot must be the training's: the robot determines the turn of
    each action and the duration of a decision. So must the rewards, if the training uses them.
    """
    perception, teacher = config.perception, config.teacher
    # Without weight on temporal differences a recording teaches by its labels alone.
    if not (teacher.td_weight or teacher.controller is not None) and not any(
        episode.labels.any() for episode in episodes.episodes
    ):
        raise ConfigError(
            f"teacher.episodes: {episodes.path} holds no labels, so that nothing is learnt with "
            "teacher.td_weight=0; record it in a training with a teacher, or set teacher.td_weight "
            "to learn from its rewards"
        )
    # Every environment of the recording must give the numbers the meaning that they have here.
    for environment in episodes.document.environments:
        recorded = environment.perception
        if perception.layout != recorded.layout:
            raise ConfigError(
                f"teacher.episodes: {episodes.path} holds observations of {recorded.layout.words}; "
                f"perception asks for {perception.layout.words}"
            )
        _check_robot(config.robot, episodes.path, environment)
        # Rewards matter only where temporal differences learn from them.
        rewards = {name: term.model_dump(mode="json") for name, term in environment.rewards.items()}
        if teacher.td_weight and rewards != to_dict(config.environment())["rewards"]:
            raise ConfigError(
                f"teacher.episodes: {episodes.path} was recorded with other rewards "
                f"({', '.join(rewards) or 'none'}); record it with those of the training, or learn "
                "from its labels alone with teacher.td_weight=0"
            )


def notes(config: TrainConfig, episodes: Recording) -> Iterator[str]:
    """Yield what the user of a training should know about its recorded episodes, a line each."""
    if text := differing_conditions(config, episodes):
        yield text
    agent = _settings(config)
    if agent.cut_at_random and agent.n_step > 1 and config.teacher.td_weight:
        yield (
            f"teacher.episodes: {episodes.path} does not say which actions were random: sums of "
            "rewards over its decisions are not cut, whatever agent.cut_at_random"
        )


def differing_conditions(config: TrainConfig, episodes: Recording) -> str:
    """Return a sentence with the differing settings of simulation, sensing and episodes.

    It is empty if none differ.
    """
    conditions = to_dict(config.environment())
    # Settings without effect are no news; the layout is an error of its own (check_fit).
    left_out: dict[str, Collection[str]] = {
        "sim": config.sim.without_effect,
        "perception": ObservationLayout.model_fields.keys(),
    }
    # Several environments may differ alike; a dict keeps each text once, in order.
    texts = dict.fromkeys(
        text
        for environment in episodes.document.environments
        for section in _SECTIONS
        for text in _differing(
            section,
            {k: v for k, v in conditions[section].items() if k not in left_out.get(section, ())},
            former.with_paths(environment.model_dump(mode="json")).get(section, {}),
        )
    )
    if not texts:
        return ""
    return (
        f"teacher.episodes: {episodes.path} was recorded under other conditions: {', '.join(texts)}"
    )


def _check_robot(robot: Robot, path: Path, environment: PartialEnvironment) -> None:
    configured = to_dict(robot)
    recorded: Mapping[str, Any] = environment.robot
    texts = list(_differing("robot", configured, recorded))
    if not texts:
        return
    # The duration of a decision follows from several settings: say it as well.
    period = recorded["control_period"] or recorded["angle_step"] / recorded["flipper_speed"]
    if period != (expected := robot.decision_period):
        texts.append(f"a decision period of {period:.6g} s (here {expected:.6g})")
    settings = [f"{path}={there}" for path, _, there in differences(configured, recorded, "robot")]
    raise ConfigError(
        f"teacher.episodes: {path} was recorded with another robot: {', '.join(texts)}; record it "
        f"again with the robot of the training, or train with {' '.join(settings)}"
    )


def _differing(
    section: str, settings: Mapping[str, Any], recorded: Mapping[str, Any]
) -> Iterator[str]:
    """Yield each setting of a section whose value differs, with both values.

    Another engine or sensor is named without its own settings.
    """

    def text(value: object) -> str:
        plain = None if value is ABSENT else value
        return plain if isinstance(plain, str) else json.dumps(plain, separators=(",", ":"))

    # Settings of different engines have no counterparts: the two names say enough.
    if recorded.get("name") != settings.get("name"):
        yield f"{section}={recorded.get('name')} (here {settings.get('name')})"
        return
    for path, here, there in differences(settings, recorded, section):
        if section == "randomise" or ABSENT not in (here, there):  # it omits what it does not do
            yield f"{path}={text(there)} (here {text(here)})"


def _settings(config: TrainConfig) -> D3qnSettings:
    assert isinstance(config.agent, D3qnSettings)  # the learner that takes recorded episodes
    return config.agent


def read_teacher(config: TrainConfig) -> Recording | None:
    """Return the recorded episodes that a training learns from, or None without any."""
    name = config.teacher.episodes
    if name is None:
        return None
    episodes = recording.read(Path(name))
    check_fit(config, episodes)
    # At least one row must stay free for what the training adds.
    size = _settings(config).replay_size
    if episodes.decisions >= size:
        raise ConfigError(
            f"agent.replay_size: {size:,} transitions leave no room besides "
            f"the {episodes.decisions:,} recorded ones of teacher.episodes={name}; raise it"
        )
    return episodes


def add_recorded(replay: Replay, config: TrainConfig, report: Callable[[str], None]) -> None:
    """Put the recorded episodes of the teacher, if there are any, into the replay of a new run."""
    if (episodes := read_teacher(config)) is not None:
        for text in notes(config, episodes):
            report(text)
        fill(replay, episodes, config)


def fill(replay: Replay, episodes: Recording, config: TrainConfig) -> None:
    """Put all recorded decisions into an empty replay, which never overwrites them."""
    frames, bootstrapped = config.network.frames, _settings(config).bootstrap_outcomes
    # An episode has one observation more than it has actions.
    for episode in episodes.episodes:
        seen = list(episode.observations)
        # Input rows reach back within the episode only, as they do while it is driven.
        rows = [stacked(seen[: t + 1][-MAX_HISTORY:], frames) for t in range(len(seen))]
        last = len(episode.actions) - 1
        for t, action in enumerate(episode.actions):
            replay.add(
                rows[t],
                int(action),
                float(episode.rewards[t]),
                rows[t + 1],
                over=t == last,
                bootstrap=t == last and episode.outcome in bootstrapped,
                label=episode.labels[t],
            )
    replay.keep()
