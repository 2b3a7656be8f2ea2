"""The page of ``flipperctl watch``: policies drive in 3-D, with controls, gauges and plots.

In: entrants, and messages of ``watch.html``. Out: a scene of viser, and messages with what is
played and the gauges of each policy. Simulation and drawing run in one thread; a decision is
simulated whole and then shown at the chosen speed, so that pausing costs nothing.
"""

from __future__ import annotations

import json
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from flipperctl.api import ACTIONS
from flipperctl.errors import FlipperctlError
from flipperctl.live.gate import Gate, page_file
from flipperctl.live.lanes import PERIOD, Entrant, Lane, Moment, action_text
from flipperctl.live.scene import Laid, LiveScene, Stage

_AFTER = 1.5
"""Pause after an episode before the next one begins [s]."""
_MOST = 4
"""Largest number of policies at once [-]."""
_LONGEST = 12
"""Decisions of a plan that are listed [-]."""
_POINTS = 300
"""Largest number of points of a curve that is sent [-]."""
_TURN = {-1: "↓", 0: "–", 1: "↑"}


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class _Do(_Message):
    """A button or a key."""

    kind: Literal["do"]
    what: Literal["pause", "step", "restart", "previous", "next"]


class _Number(_Message):
    """A field of a number."""

    kind: Literal["set"]
    name: Literal["speed", "difficulty", "episode", "seed"]
    value: Annotated[float, Field(ge=0, le=2**32 - 1)]


class _Tick(_Message):
    """A box, or whether the browser is dark."""

    kind: Literal["set"]
    name: Literal["follow", "marks", "dark"]
    value: bool


class _Show(_Message):
    """The box of a policy."""

    kind: Literal["show"]
    number: Annotated[int, Field(ge=0)]
    on: bool


class _Add(_Message):
    """The name of a policy to add."""

    kind: Literal["add"]
    name: Annotated[str, Field(max_length=300)]


_MESSAGES: TypeAdapter[_Do | _Number | _Tick | _Show | _Add] = TypeAdapter(
    _Do | _Number | _Tick | _Show | _Add
)


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
    names: deque[str] = field(default_factory=deque)
    """Policies to add."""
    dark: bool | None = None
    """Whether the scene becomes dark; None: it stays as it is."""


def gauges(number: int, lane: Lane, moment: Moment) -> dict[str, Any]:
    """Return the numbers, curves and values of a lane after a moment, as the page shows them.

    Angles are in degrees; the first column of a curve is time [s].
    """
    state, history, decision = moment.states[-1], lane.history, moment.decision
    values = moment.values
    joints = lane.env.robot.joints
    return {
        "kind": "lane",
        "lane": number,
        "label": lane.label,
        "search": None,
        "outcome": None if lane.outcome is None else lane.outcome.value,
        "time": state.time,
        "x": float(state.position[0]),
        "variation": history.variation,
        **{name: math.degrees(getattr(state, name)) for name in ("pitch", "front", "rear")},
        "action": None if decision is None else action_text(decision),
        "plan": None if moment.planned is None else plan_text(moment.planned.actions),
        "joints": [name.replace("_", " ") for name in joints],
        "angles": _curve(history.angle_times, np.degrees(history.angles)),
        "terms": list(history.rewards),
        "rewards": _curve(history.times, np.array(list(history.rewards.values())).T),
        "risks": _curve(history.times[-len(history.risks) :], np.reshape(history.risks, (-1, 1))),
        # Those of four flippers would be a table of 81.
        "values": None if values is None or len(joints) > 2 else np.round(values, 4).tolist(),
        "taken": None if decision is None else decision.action,
    }


def _curve(times: Sequence[float], columns: ArrayLike) -> list[list[float]]:
    """Return rows of a time [s] and the values at it, thinned out, the newest among them."""
    values = np.asarray(columns)
    if not len(times) or not values.size:
        return []
    every = -(-len(times) // _POINTS)
    rows = np.column_stack([times, values])[::-1][::every][::-1]
    return [[float(f"{value:.4g}") for value in row] for row in rows]


def plan_text(actions: Sequence[int]) -> str:
    """Return the first turns of a plan, front and rear of each decision."""
    turns = [f"{_TURN[front]}{_TURN[rear]}" for front, rear in (ACTIONS[a] for a in actions)]
    more = f" and {len(turns) - _LONGEST} more" if len(turns) > _LONGEST else ""
    return " ".join(turns[:_LONGEST]) + more


class WatchPage:
    """What the page asks for, and lanes; ``run`` plays until it is stopped.

    It implements ``gate.Control``.
    """

    def __init__(
        self,
        entrants: Sequence[Entrant],
        *,
        speed: float = 1.0,
        episode: int = 0,
        marks: bool = True,
        find: Callable[[str], Entrant] | None = None,
    ) -> None:
        """Show ``entrants``, the first of which drive at once.

        ``marks``: whether what is perceived is shown at first. ``find`` returns the entrant of a
        policy's name, to add it; it may raise FlipperctlError.
        """
        self._entrants, self._find = list(entrants), find
        self._shown = [number < _MOST for number in range(len(self._entrants))]
        self._wish, self._episode, self._stopped = Wish(), episode, False
        self._fields: dict[str, Any] = {
            "speed": speed, "difficulty": 1.0, "seed": 0, "follow": True, "marks": marks,
        }  # fmt: skip
        self._title = "Loading the policies"
        self._lanes: list[tuple[Lane, LiveScene]] = []
        self._newest: dict[str, dict[str, Any]] = {}
        """Last message about each lane, for browsers that open the page later."""
        self._gate: Any = None
        self._stage: Any = None

    def opened(self, client: int) -> None:
        """Show a browser what is played."""
        for name, message in [("page", self._page()), *self._newest.items()]:
            self._post(name, message, client)

    def closed(self, client: int) -> None:
        """A browser that is gone changes nothing."""

    def received(self, client: int, message: str) -> None:
        """Leave a wish, which the loop reads; ``ValueError`` if the message is none."""
        parsed, wish = _MESSAGES.validate_json(message, strict=True), self._wish
        if isinstance(parsed, _Do):
            if parsed.what == "pause":
                wish.paused = not wish.paused
            elif parsed.what == "step":
                wish.paused = True
                wish.steps += 1
            else:
                move = {"next": 1, "previous": -1}.get(parsed.what, 0)
                wish.episode = max(0, self._episode + move)
        elif isinstance(parsed, _Add):
            wish.names.append(parsed.name)
        elif isinstance(parsed, _Show):
            if parsed.number < len(self._shown):
                self._shown[parsed.number] = parsed.on
                wish.changed, wish.episode = True, self._episode
        elif parsed.name == "dark":
            wish.dark = parsed.value
        elif parsed.name == "episode":
            wish.episode = int(parsed.value)
        else:
            whole = parsed.name == "seed"
            self._fields[parsed.name] = int(parsed.value) if whole else parsed.value
            if parsed.name in ("difficulty", "seed"):
                wish.episode = self._episode
        self._tell()

    def _page(self) -> dict[str, Any]:
        labels = [entrant.label for entrant in self._entrants]
        return {
            "kind": "page",
            "title": self._title,
            "paused": self._wish.paused,
            "policies": list(zip(labels, self._shown, strict=False)),
            "lanes": len(self._lanes),
            "addable": self._find is not None,
            "recorded": self._entrants[0].recorded,
            "episode": self._episode,
            **self._fields,
        }

    def _tell(self) -> None:
        self._post("page", self._page())

    def _show_gauges(self, number: int, message: dict[str, Any]) -> None:
        self._newest[f"lane {number}"] = message
        self._post(f"lane {number}", message)

    def _post(self, name: str, message: dict[str, Any], client: int | None = None) -> None:
        if self._gate is not None:
            self._gate.post(json.dumps(message), name, client)

    def _add(self, name: str) -> None:
        """Add the policy of a name, which drives the same episodes at once."""
        remark = ""
        try:
            if self._find is not None:
                entrant = self._find(name.strip())
                entrant.episode(self._episode)  # errors now, not in the loop, which they would end
                self._entrants.append(entrant)
                self._shown.append(True)
                self._wish.changed, self._wish.episode = True, self._episode
        except FlipperctlError as error:
            remark = f"No policy was added: {error}"
        self._post("remark", {"kind": "remark", "text": remark})

    def stop(self) -> None:
        """End ``run`` soon; it may be called from any thread."""
        self._stopped = True

    def run(self, gate: Any, episodes: int | None = None) -> None:
        """Play one episode after the other until ``stop``; ``episodes``: at most this many.

        ``gate``: the ``Gate`` to the browsers.
        """
        self._gate, self._stage = gate, Stage(gate.server)
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
        for _, scene in self._lanes:
            scene.remove()
        # The newest among the ticked policies, as many as are shown at once
        pairs = list(zip(self._entrants, self._shown, strict=True))
        shown = [entrant for entrant, box in pairs if box][-_MOST:] or self._entrants[:1]
        self._lanes, self._newest = [], {}
        for i, entrant in enumerate(shown):

            def report(fraction: float, number: int = i) -> None:
                message = self._newest.get(f"lane {number}")
                if message is not None:
                    self._show_gauges(number, {**message, "search": fraction})
                self._wait(0.0)  # a search is left like an episode

            self._lanes.append((Lane(entrant, report), LiveScene(self._gate.server.scene, i)))
        self._stage.look_at_lanes(len(shown))

    def _play(self) -> None:
        # All lanes begin the same episode.
        difficulty, seed = self._fields["difficulty"], self._fields["seed"]
        starts = [lane.begin(self._episode, difficulty, seed or None) for lane, _ in self._lanes]
        envs = [lane.env for lane, _ in self._lanes]
        grounds = [Laid.of(e.profile, e.drive.world.of_engine) for e in envs]
        floor = self._stage.begin(grounds)
        for number, ((lane, scene), start) in enumerate(zip(self._lanes, starts, strict=True)):
            # The page names the numbers: names have no place in the scene of a phone.
            env, label = envs[number], str(number + 1) if len(envs) > 1 else ""
            finish, ground = env.scene.finish, grounds[number]
            scene.begin(env.profile, env.robot, finish, floor, label, ground)
            scene.show(start.states[0])
            self._show_gauges(number, gauges(number, lane, start))
        scenes = [scene for _, scene in self._lanes]
        self._stage.follow([(s, start.states[0]) for s, start in zip(scenes, starts, strict=True)])
        self._title = self._lanes[0][0].title
        self._tell()
        running = list(enumerate(self._lanes))
        # Simulate a decision in every lane, then show them together.
        while running and not self._stopped:
            self._wait_while_paused()
            shown = []
            for number, (lane, scene) in running:
                # What a policy perceived belongs to the state before its decision.
                before, mapped = lane.env.state, lane.env.map_points()
                scene.perceived.visible = self._fields["marks"]
                if (moment := lane.step()) is not None:
                    shown.append((scene, moment))
                    if self._fields["marks"] and moment.decision is not None:
                        scene.perceive(moment.decision.perception, before, mapped)
                        if moment.planned is not None:
                            scene.plan(moment.planned.path, before)
                    self._show_gauges(number, gauges(number, lane, moment))
            self._animate(shown)
            running = [parts for parts in running if parts[1][0].outcome is None]

    def _animate(self, shown: Sequence[tuple[LiveScene, Moment]]) -> None:
        longest = max((len(moment.states) for _, moment in shown), default=0)
        for index in range(longest):
            begun = time.perf_counter()
            with self._gate.server.atomic():
                robots = [(s, m.states[min(index, len(m.states) - 1)]) for s, m in shown]
                for scene, state in robots:
                    scene.show(state)
                if self._fields["follow"]:
                    self._stage.follow(robots)
            spent = time.perf_counter() - begun
            self._wait(PERIOD / max(0.1, self._fields["speed"]) - spent)

    def _wait_while_paused(self) -> None:
        while self._wish.paused and not self._stopped:
            if self._wish.steps:
                self._wish.steps -= 1
                return
            self._wait(0.02)

    def _wait(self, seconds: float) -> None:
        until = time.perf_counter() + seconds
        while True:
            if self._wish.names:
                self._add(self._wish.names.popleft())
            if self._wish.dark is not None:
                self._stage.set_dark(self._wish.dark)
                self._wish.dark = None
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
    marks: bool = True,
    find: Callable[[str], Entrant] | None = None,
    ready: Callable[[str], None],
) -> None:
    """Serve the page until Ctrl-C; ``ready`` is called with its address.

    ``span``: the first episode, and how many are shown; None: one after the other. ``marks`` and
    ``find``: see ``WatchPage``.
    """
    page = WatchPage(entrants, speed=speed, episode=span[0], marks=marks, find=find)
    what = "watching without --terminal"
    with Gate(port, page=page_file("watch.html"), control=page, what=what) as gate:
        ready(gate.address)
        page.run(gate, span[1])
