"""The page of ``flipperctl watch``: policies drive in 3-D, with controls, gauges and plots.

In: entrants. Out: a viser server on this machine. Simulation and drawing run in one thread; a
decision is simulated whole and then shown at the chosen speed, so that pausing costs nothing.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flipperctl.api import ACTIONS, RobotState
from flipperctl.errors import FlipperctlError
from flipperctl.live.gate import Gate
from flipperctl.live.lanes import PERIOD, Entrant, Lane, Moment
from flipperctl.live.scene import WIDTH, LiveScene
from flipperctl.sim.outline import CHASSIS, FRONT, REAR

_BETWEEN = 0.35
"""Distance between the grounds of two lanes [m]."""
_AFTER = 1.5
"""Pause after an episode before the next one begins [s]."""
_MOST = 4
"""Largest number of policies at once [-]."""
_BODY = "#46505C"
_TERMS = (CHASSIS, FRONT, REAR, "#AA4499", "#DDAA33", "#56B4E9", _BODY)
Line = tuple[str, str]
"""Label and colour of a curve."""
_LONGEST = 12
"""Decisions of a plan that are listed [-]."""
_TURN = {-1: "↓", 0: "·", 1: "↑"}


class _NextEpisodeError(FlipperctlError):
    """Ends the running episode, or the search before it; no plugin's fault."""


@dataclass
class Wish:
    """What the page asked for; the loop reads it between states."""

    paused: bool = False
    steps: int = 0
    """Decisions to show while paused."""
    episode: int | None = None
    """Episode to go to now."""
    changed: bool = False
    """Whether the policies were changed."""


class Gauges:
    """Numbers, plots and values of one lane in the panel."""

    def __init__(self, gui: Any, label: str) -> None:
        self._gui = gui
        self._folder = gui.add_folder(label)
        with self._folder:
            self._numbers = gui.add_markdown("")
            self._angles = self._plot(
                "angles [°]",
                (("pitch", CHASSIS), ("front", FRONT), ("rear", REAR), ("roll", _BODY)),
            )
            self._risk = self._plot("risk of a failure", (("risk", FRONT),), visible=False)
            self._values = gui.add_html("")
            self._plan = gui.add_markdown("", visible=False)
        self._terms: list[str] = []
        self._rewards: Any = None

    def _plot(self, title: str, lines: Sequence[Line], *, visible: bool = True) -> Any:
        from viser import uplot

        series = [uplot.Series(label=name, stroke=colour, width=2) for name, colour in lines]
        return self._gui.add_uplot(
            (np.zeros(1),) * (len(lines) + 1), (uplot.Series(label="time [s]"), *series),
            title=title, height=160, visible=visible, scales={"x": uplot.Scale(time=False)},
        )  # fmt: skip

    def appear(self, visible: bool) -> None:
        """Show or hide the panel; the browser would report late updates of a removed one."""
        self._folder.visible = visible

    def search(self, fraction: float) -> None:
        """Show how much of a search before an episode is done."""
        self._numbers.content = f"searching for a plan: **{fraction:.0%}**"

    def show(self, lane: Lane, moment: Moment) -> None:
        """Show a moment and the history up to it."""
        state = moment.states[-1]
        history, decision = lane.history, moment.decision
        # Numbers in words
        degrees = [math.degrees(a) for a in (state.pitch, state.front, state.rear)]
        outcome = "" if lane.outcome is None else f" · **{lane.outcome.value}**"
        action = "start"
        if decision is not None:
            front, rear = ACTIONS[decision.action]
            action = f"front {_TURN[front]} rear {_TURN[rear]}"
            if decision.rates is not None:
                action = "front {:+.2f} rear {:+.2f}".format(*decision.rates)
        self._numbers.content = (
            f"time **{state.time:.1f} s** · x **{state.position[0]:.2f} m** · "
            f"pitch variation **{history.variation:.2f} rad**{outcome}\n\n"
            f"pitch {degrees[0]:+.0f}° · front {degrees[1]:+.0f}° · rear {degrees[2]:+.0f}° · "
            f"action {action}"
        )
        # Curves of the angles
        if history.angle_times:
            self._angles.data = (
                np.array(history.angle_times),
                *np.degrees(np.array(history.angles)).T.copy(),
            )
        # The plot of rewards waits for the names of their terms.
        if history.rewards and self._terms != list(history.rewards):
            self._terms = list(history.rewards)
            if self._rewards is not None:
                self._rewards.remove()
            colours = [_TERMS[i % len(_TERMS)] for i in range(len(self._terms))]
            with self._folder:
                lines = list(zip(self._terms, colours, strict=True))
                self._rewards = self._plot("reward of each decision", lines) if lines else None
        if self._rewards is not None and history.times:
            columns = [np.array(history.rewards[name]) for name in self._terms]
            self._rewards.data = (np.array(history.times), *columns)
        # Risk, plan and values, for policies that have them
        if history.risks:
            self._risk.visible = True
            self._risk.data = (
                np.array(history.times[-len(history.risks) :]),
                np.array(history.risks),
            )
        self._plan.visible = moment.planned is not None
        if moment.planned is not None:
            self._plan.content = f"plan (front rear): {plan_text(moment.planned.actions)}"
        if moment.values is not None and decision is not None:
            self._values.content = value_table(moment.values.tolist(), decision.action)


def plan_text(actions: Sequence[int]) -> str:
    """Return the first turns of a plan, front and rear of each decision."""
    turns = [f"{_TURN[front]}{_TURN[rear]}" for front, rear in (ACTIONS[a] for a in actions)]
    more = f" and {len(turns) - _LONGEST} more" if len(turns) > _LONGEST else ""
    return " ".join(turns[:_LONGEST]) + more


def value_table(values: Sequence[float], action: int) -> str:
    """Return the Q-values as an HTML table of front (columns) and rear (rows) turns."""
    low, high = min(values), max(values)
    rows = []
    # A cell is the darker the larger its value; an outline marks the action that was taken.
    for rear in (1, 0, -1):
        cells = []
        for front in (-1, 0, 1):
            index = ACTIONS.index((front, rear))
            share = (values[index] - low) / (high - low) if high > low else 0.0
            edge = "outline:2px solid #D55E00;" if index == action else ""
            cells.append(
                f"<td style='padding:2px 8px;text-align:right;{edge}"
                f"background:rgba(0,114,178,{0.05 + 0.4 * share:.2f})'>{values[index]:.2f}</td>"
            )
        rows.append(f"<tr><th>rear {_TURN[rear]}</th>{''.join(cells)}</tr>")
    heads = "".join(f"<th>front {_TURN[front]}</th>" for front in (-1, 0, 1))
    return (
        "<div style='font-size:12px;padding:4px 8px'>Q-values, the chosen action outlined"
        f"<table><tr><th></th>{heads}</tr>{''.join(rows)}</table></div>"
    )


class WatchPage:
    """Controls and lanes; ``run`` plays until it is stopped."""

    def __init__(
        self,
        server: Any,
        entrants: Sequence[Entrant],
        *,
        speed: float = 1.0,
        episode: int = 0,
        find: Callable[[str], Entrant] | None = None,
    ) -> None:
        """``server``: a ``viser.ViserServer``; the first entrants drive at once.

        ``find`` returns the entrant of a policy's name, to add it; it may raise FlipperctlError.
        """
        self._server, self._entrants, self._find = server, list(entrants), find
        self._wish, self._episode, self._stopped = Wish(), episode, False
        self._lanes: list[tuple[Lane, LiveScene, Gauges]] = []
        self._gauges: dict[int, Gauges] = {}
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.main_panel.dock_right()
        server.scene.set_up_direction("+z")
        server.scene.world_axes.visible = False
        server.initial_camera.position = (0.2, -3.4, 1.1)
        server.initial_camera.look_at = (0.2, 0.2, 0.05)
        self._world = server.scene.add_frame("/drive", show_axes=False)
        self._build_controls(server.gui, speed)

    def _build_controls(self, gui: Any, speed: float) -> None:
        wish = self._wish
        # Controls of the episode
        with gui.add_folder("Episode"):
            self._title = gui.add_markdown("")
            self._pause = gui.add_button("Pause", icon="player-pause")
            buttons = gui.add_button_group("Go", ("Step", "Restart", "Previous", "Next"))
            self._number = gui.add_number("Episode", self._episode, min=0, step=1)
            self._seed = gui.add_number(
                "Seed", 0, min=0, step=1, hint="draw by this seed; 0: that of the episode"
            )
            self._speed = gui.add_slider("Speed", 0.1, 10.0, 0.1, speed)
            self._difficulty = gui.add_slider("Difficulty", 0.0, 1.0, 0.05, 1.0)
            self._follow = gui.add_checkbox("Follow the robot", initial_value=True)
            self._seen = gui.add_checkbox("Show what is perceived", initial_value=True)
        # Policies that drive, and a field to add others
        self._policies, self._shown = gui.add_folder("Policies"), list[Any]()
        for number, entrant in enumerate(self._entrants):
            self._offer(entrant, shown=number < _MOST)
        if self._find is not None:
            with self._policies:
                name = gui.add_text(
                    "Another one", "", hint="a controller, run, file or shipped name"
                )
                gui.add_button("Add").on_click(lambda event: self._add(name, event))

        # What buttons and keys do: they leave wishes, which the loop reads between two states.
        def pause(_: Any = None) -> None:
            wish.paused = not wish.paused
            self._pause.label = "Play" if wish.paused else "Pause"
            self._pause.icon = "player-play" if wish.paused else "player-pause"

        def go(event: Any) -> None:
            move(event.target.value)

        def move(word: str) -> None:
            if word == "Step":
                if not wish.paused:
                    pause()
                wish.steps += 1
            else:
                wish.episode = max(0, self._episode + {"Next": 1, "Previous": -1}.get(word, 0))

        def jump(_: Any) -> None:
            if self._number.value != self._episode:
                wish.episode = int(self._number.value)

        # Buttons, fields and hotkeys
        self._pause.on_click(pause)
        buttons.on_click(go)
        self._number.on_update(jump)
        for field in (self._difficulty, self._seed):
            field.on_update(lambda _: setattr(wish, "episode", self._episode))
        for key, label, call in (
            ("p", "Pause or play", pause),
            ("s", "Step one decision", lambda _: move("Step")),
            ("n", "Next episode", lambda _: move("Next")),
            ("b", "Previous episode", lambda _: move("Previous")),
            ("r", "Restart the episode", lambda _: move("Restart")),
        ):
            gui.add_command(label, hotkey=key).on_trigger(call)

    def _offer(self, entrant: Entrant, *, shown: bool) -> None:
        """Add a box that shows or hides an entrant."""

        def change(_: Any = None) -> None:
            self._wish.changed, self._wish.episode = True, self._episode

        with self._policies:
            box = self._server.gui.add_checkbox(entrant.label, initial_value=shown)
        box.on_update(change)
        self._shown.append(box)

    def _add(self, name: Any, event: Any) -> None:
        """Add the policy of a name, which drives the same episodes at once."""
        assert self._find is not None  # the button exists
        try:
            entrant = self._find(name.value.strip())
            entrant.episode(self._episode)  # errors now, not in the loop, which they would end
        except FlipperctlError as error:
            event.client.add_notification("No policy was added", str(error), color="red")
            return
        self._entrants.append(entrant)
        self._offer(entrant, shown=True)
        name.value = ""
        self._wish.changed, self._wish.episode = True, self._episode

    def stop(self) -> None:
        """End ``run`` soon; it may be called from any thread."""
        self._stopped = True

    def run(self, episodes: int | None = None) -> None:
        """Play one episode after the other until ``stop``; ``episodes``: at most this many."""
        self._set_lanes()
        played = 0
        while not self._stopped and (episodes is None or played < episodes):
            try:
                self._play()
                played += 1
                self._wait(_AFTER)
                self._episode += 1
            except _NextEpisodeError:
                if self._wish.episode is not None:
                    self._episode, self._wish.episode = self._wish.episode, None
                if self._wish.changed:
                    self._wish.changed = False
                    self._set_lanes()

    def _set_lanes(self) -> None:
        # Panels are hidden rather than removed, since the browser would report their late updates.
        for _, scene, gauges in self._lanes:
            scene.remove()
            gauges.appear(False)
        # The newest among the ticked policies, as many as are shown at once
        pairs = list(zip(self._entrants, self._shown, strict=False))  # a box may be missing yet
        shown = [entrant for entrant, box in pairs if box.value][-_MOST:] or self._entrants[:1]
        apart = WIDTH + _BETWEEN
        self._lanes = []
        # Lanes beside each other, each with the panel of its policy
        for i, entrant in enumerate(shown):
            scene = LiveScene(self._server.scene, f"/drive/{i}", i * apart)
            if (number := self._entrants.index(entrant)) not in self._gauges:
                self._gauges[number] = Gauges(self._server.gui, entrant.label)
            gauges = self._gauges[number]
            gauges.appear(True)

            def report(fraction: float, gauges: Gauges = gauges) -> None:
                gauges.search(fraction)
                self._wait(0.0)  # a search is left like an episode

            self._lanes.append((Lane(entrant, report), scene, gauges))

    def _play(self) -> None:
        self._number.value = self._episode
        # All lanes begin the same episode.
        for lane, scene, gauges in self._lanes:
            difficulty, seed = float(self._difficulty.value), int(self._seed.value)
            first = lane.begin(self._episode, difficulty, seed or None)
            label = lane.entrant.label
            scene.begin(lane.env.profile, lane.env.robot, lane.env.scene.finish, label)
            scene.show(first.states[0])
            gauges.show(lane, first)
            self._centre(first.states)
        drawn = f"seed {self._seed.value}" if self._seed.value else f"episode {self._episode}"
        self._title.content = f"**{self._lanes[0][0].title}**, {drawn}"
        running = list(self._lanes)
        # Simulate a decision in every lane, then show them together.
        while running and not self._stopped:
            self._wait_while_paused()
            shown = []
            for lane, scene, gauges in running:
                # What a policy perceived belongs to the state before its decision.
                before, mapped = lane.env.state, lane.env.map_points()
                scene.perceived.visible = self._seen.value
                if (moment := lane.step()) is not None:
                    shown.append((scene, moment))
                    if self._seen.value and moment.decision is not None:
                        scene.perceive(moment.decision.perception, before, mapped)
                        if moment.planned is not None:
                            scene.plan(moment.planned.path, before)
                    gauges.show(lane, moment)
            self._animate(shown)
            running = [parts for parts in running if parts[0].outcome is None]

    def _animate(self, shown: Sequence[tuple[LiveScene, Moment]]) -> None:
        longest = max((len(moment.states) for _, moment in shown), default=0)
        for index in range(longest):
            begun = time.perf_counter()
            with self._server.atomic():
                states = [m.states[min(index, len(m.states) - 1)] for _, m in shown]
                for (scene, _), state in zip(shown, states, strict=True):
                    scene.show(state)
                self._centre(states)
            spent = time.perf_counter() - begun
            self._wait(PERIOD / max(0.1, float(self._speed.value)) - spent)

    def _centre(self, states: Sequence[RobotState]) -> None:
        """Keep the foremost robot in view."""
        if self._follow.value:
            ahead = max(float(state.position[0]) for state in states)
            self._world.position = (-ahead, 0.0, 0.0)

    def _wait_while_paused(self) -> None:
        while self._wish.paused and not self._stopped:
            if self._wish.steps:
                self._wish.steps -= 1
                return
            self._wait(0.02)

    def _wait(self, seconds: float) -> None:
        until = time.perf_counter() + seconds
        while True:
            if self._wish.episode is not None or self._wish.changed:
                raise _NextEpisodeError
            left = until - time.perf_counter()
            if left <= 0 or self._stopped:
                return
            time.sleep(min(left, 0.02))


def watch(
    entrants: Sequence[Entrant],
    *,
    port: int,
    speed: float,
    span: tuple[int, int | None] = (0, None),
    find: Callable[[str], Entrant] | None = None,
    ready: Callable[[str], None],
) -> None:
    """Serve the page until Ctrl-C; ``ready`` is called with its address.

    ``span``: the first episode, and how many are shown; None: one after the other. ``find``: see
    ``WatchPage``.
    """
    with Gate(port, what="watching without --terminal") as gate:
        page = WatchPage(gate.server, entrants, speed=speed, episode=span[0], find=find)
        ready(gate.address)
        page.run(span[1])
