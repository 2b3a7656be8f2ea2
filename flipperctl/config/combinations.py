"""Checks for settings of several sections that are impossible together.

In: the sections of a configuration. Out: an error that names the setting, its value and what is
allowed with the others.
"""

from __future__ import annotations

from flipperctl.api import SAMPLE_PERIOD, Robot, Sensor
from flipperctl.config.randomise import Randomise
from flipperctl.config.sections import Episode
from flipperctl.errors import ConfigError


def check_decisions(robot: Robot, sensor: Sensor, randomise: Randomise) -> None:
    """Check that a decision lasts at least one sample period and that no delay exceeds it.

    Raises:
        ConfigError: the decision is too short, or a delay too long.
    """
    period = robot.decision_period
    if period < SAMPLE_PERIOD:
        given = robot.control_period is not None
        cause = "control_period:" if given else "angle_step: angle_step / flipper_speed,"
        raise ConfigError(
            f"robot.{cause} a decision would take {period:.3g} s; at least "
            f"{SAMPLE_PERIOD:g} s, the sampling time of the pitch, is allowed"
        )
    delays = (
        ("robot", "actuator_delay", robot.actuator_delay),
        ("perception", "delay", sensor.delay),
    )
    for section, name, own in delays:
        sampled = randomise.find(section, name)
        longest, key = (sampled.ends[1], sampled.key) if sampled else (own, f"{section}.{name}")
        if longest > period:
            raise ConfigError(f"{key}: {longest:g} s is longer than a decision, {period:g} s")


def check_episode(robot: Robot, episode: Episode, randomise: Randomise) -> None:
    """Check that the flippers reach their start angle and that a moving robot is not stuck.

    Raises:
        ConfigError: the angle is beyond the limit, or every robot would be stuck.
    """
    if abs(episode.start_angle) > robot.angle_limit:
        raise ConfigError(
            f"episode.start_angle: {episode.start_angle:g} rad is beyond robot.angle_limit, "
            f"{robot.angle_limit:g} rad"
        )
    sampled = randomise.find("robot", "track_speed")
    slowest = sampled.ends[0] if sampled else robot.track_speed
    window = episode.stuck_decisions(robot.decision_period)
    farthest = slowest * window * robot.decision_period
    if episode.stuck_progress > farthest:
        raise ConfigError(
            f"episode.stuck_progress: {episode.stuck_progress:g} m in {window} "
            f"decisions is more than a robot of {slowest:g} m/s drives on level ground; at most "
            f"{farthest:.3g} m is allowed, or every robot is stuck"
        )
