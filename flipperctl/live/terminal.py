"""Watch one policy in a terminal: the robot from the side in characters, and its gauges.

In: an entrant. Out: text that rich redraws in place; a line per decision where the output is no
terminal.
"""

from __future__ import annotations

import math
import time
from typing import TextIO

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.live import Live
from rich.text import Text

from flipperctl.api import FloatArray, Profile, RobotGeometry, RobotState
from flipperctl.core.targets import angles_of
from flipperctl.live.lanes import PERIOD, Entrant, Lane, Moment, action_text, by_ends
from flipperctl.sim.outline import axles

_ROWS = 14
"""Rows of the picture; one has four dots [-]."""
_COLUMNS = 76
"""Columns of the picture; one has two dots [-]."""
_AHEAD = 0.55
"""Share of the picture's width that lies ahead of the robot [-]."""
_SCALE = 0.02
"""Side of a dot [m]."""
_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
"""Bits of the dots of a braille character, (row, column)."""


def picture(profile: Profile, robot: RobotGeometry, state: RobotState) -> str:
    """Return the ground and the robot from the side in braille characters."""
    wide, tall = 2 * _COLUMNS, 4 * _ROWS
    x, z = state.position.tolist()
    left, low = x - (1 - _AHEAD) * wide * _SCALE, z - 0.5 * tall * _SCALE
    dots = np.zeros((tall, wide), np.bool_)
    # The ground as a line without gaps where it is steep
    at = left + (np.arange(wide) + 0.5) * _SCALE
    rows = np.floor((profile.heights(at) - low) / _SCALE).astype(int)
    for column, row in enumerate(rows.tolist()):
        before = rows[column - 1] if column else row
        for filled in range(max(0, min(row, before)), min(tall, max(row, before) + 1)):
            dots[filled, column] = True
    # The robot: round ends and straight sides of its three capsules
    for rear, front in axles(state, robot):
        for share in np.linspace(0.0, 1.0, 40):
            centre = rear + share * (front - rear)
            for turn in np.linspace(0.0, 2 * math.pi, 24) if share in (0.0, 1.0) else ():
                _set(dots, centre + robot.track_radius * _unit(turn), left, low)
            along = (front - rear) / max(1e-9, float(np.hypot(*(front - rear))))
            for sign in (-1, 1):
                _set(
                    dots,
                    centre + sign * robot.track_radius * np.array([-along[1], along[0]]),
                    left,
                    low,
                )
    # A braille character holds four rows of two dots.
    cells = dots[::-1].reshape(_ROWS, 4, _COLUMNS, 2).transpose(0, 2, 1, 3)
    codes = 0x2800 + (cells * _DOTS).sum(axis=(2, 3))
    return "\n".join("".join(map(chr, line)) for line in codes.tolist())


def _unit(angle: float) -> FloatArray:
    return np.array([math.cos(angle), math.sin(angle)])


def _set(dots: NDArray[np.bool_], point: FloatArray, left: float, low: float) -> None:
    column, row = math.floor((point[0] - left) / _SCALE), math.floor((point[1] - low) / _SCALE)
    if 0 <= row < dots.shape[0] and 0 <= column < dots.shape[1]:
        dots[row, column] = True


def gauges(lane: Lane, moment: Moment, state: RobotState) -> str:
    """Return a line of numbers."""
    front, rear = by_ends([f"{round(math.degrees(a)):+3d}°" for a in angles_of(state)])
    pitch, doing = round(math.degrees(state.pitch)), "start"
    if moment.decision is not None:
        doing = "front {}, rear {}".format(*action_text(moment.decision))
    end = "" if lane.outcome is None else f"  {lane.outcome.value}"
    risk = "" if moment.risk is None else f"  risk {moment.risk:.2f}"
    return (
        f"{state.time:5.1f} s {state.position[0]:6.2f} m  pitch {pitch:+3d}°, "
        f"variation {lane.history.variation:.2f} rad  front {front}  rear {rear}  {doing}"
        f"{risk}{end}"
    )


def watch(
    entrant: Entrant, out: TextIO, *, speed: float, first: int = 0, episodes: int | None = None
) -> None:
    """Show episodes one after the other until Ctrl-C; ``episodes``: at most this many."""
    console, lane, index = Console(file=out, highlight=False), Lane(entrant), first
    while episodes is None or index - first < episodes:
        start = lane.begin(index)
        console.print(f"{lane.label} on {lane.title}", markup=False)
        if console.is_terminal:
            _animate(console, lane, start, speed)
        else:
            while (moment := lane.step()) is not None:
                console.print(gauges(lane, moment, moment.states[-1]), markup=False)
        index += 1


def _animate(console: Console, lane: Lane, start: Moment, speed: float) -> None:
    robot, profile = lane.env.robot, lane.env.profile
    with Live(console=console, refresh_per_second=25, auto_refresh=False) as live:
        moment: Moment | None = start
        while moment is not None:
            for state in moment.states:
                begun = time.perf_counter()
                shown = picture(profile, robot, state) + "\n" + gauges(lane, moment, state)
                live.update(Text(shown), refresh=True)
                time.sleep(max(0.0, PERIOD / speed - (time.perf_counter() - begun)))
            moment = lane.step()
