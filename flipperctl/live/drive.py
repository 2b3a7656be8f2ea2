"""``flipperctl drive``: a person drives the simulated robot from a page, in real time.

In: an environment, a gate to browsers, and a policy that may help. Out: a policy of 20 commands a
second, which waits for the clock, shows the state of the robot, and asks ``hands`` what to do. The
simulation runs in the thread that plays the episode; browsers are heard in the gate's.
"""

from __future__ import annotations

import io
import json
import threading
import time
from collections import deque
from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from flipperctl.api import (
    CameraWorld,
    Command,
    FloatArray,
    Perception,
    Policy,
    RobotState,
    Simulator,
    View,
    World,
    action_index,
)
from flipperctl.core.targets import angles_of
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import FlipperctlError
from flipperctl.live.gate import Gate, page_file
from flipperctl.live.hands import Answers, Asked, Hands, Theme, parse
from flipperctl.live.scene import Laid, LiveScene, Stage

PERIOD = 0.05
"""Time between two commands [s]."""
_VIEWS: tuple[View, ...] = ("front", "rear")
_SIZE = 320, 240  # width and height of the cameras' pictures [px]
_QUALITY = 70  # of their JPEGs, of 100
_DRAWING = 0.6
"""Largest share of the time for the cameras' pictures [-]."""
_OLDEST = 1.0
"""Time after which a picture is drawn although the next tick then comes late [s]."""
_SCENE = 2
"""Ticks for each new state of the 3-D scene [-]."""
_WAITS = 2.0
"""Time for which a robot without a driver stands before its clock stops, too [s]."""
_GOODBYE = 0.5  # time for the last state to reach the browsers [s]
_SHOWN = 2.0  # time of which the rate is shown [s]
_MARGIN = 2.0  # length of the level ground that is drawn before and past the profile [m]


class AgainError(Exception):
    """The operator begins the episode anew."""


class DrivePage:
    """The page: one browser drives, the others watch. Implements ``gate.Control``."""

    def __init__(self, port: int, operator: str) -> None:
        """Serve on ``port``; ``operator``: name that the page shows."""
        self._operator = operator
        self._lock = threading.Lock()
        self._clients: list[int] = []
        self._driver: int | None = None
        self._wishes: deque[str] = deque(maxlen=10)
        self._answers: tuple[int, ...] | None = None
        self._about: dict[str, Any] = {}
        self._state: dict[str, Any] = {}
        self._theme: Theme | None = None
        self.hands: Hands | None = None
        """Hands of the running episode."""
        self.gate = Gate(port, page=page_file("drive.html"), control=self, what="driving")
        self.stage = Stage(self.gate.server)
        """What the page shows beside the robot and its ground."""

    def opened(self, client: int) -> None:
        """Show a browser the episode; the only one drives."""
        with self._lock:
            self._clients.append(client)
            if self._driver is None:
                self._driver = client
            about, state = self._about, self._state
        if about:
            self.gate.post(json.dumps(about), client=client)
            self._send(state, [client])

    def closed(self, client: int) -> None:
        """Hold everything if the browser that drove is gone."""
        with self._lock:
            if client in self._clients:
                self._clients.remove(client)
            if client == self._driver:
                self._leave(None)

    def _leave(self, driver: int | None) -> None:
        self._driver = driver
        if self.hands is not None:
            self.hands.leave()

    def received(self, client: int, message: str) -> None:
        """Take a message; ``ValueError`` if it is none, which closes the connection."""
        parsed = parse(message)
        with self._lock:
            # Any browser may take over; all other messages count from the driver alone.
            if isinstance(parsed, Theme):
                self._theme = parsed
            elif not isinstance(parsed, Asked | Answers) and parsed.what == "take":
                if client != self._driver:
                    self._leave(client)
            elif client != self._driver or self.hands is None:
                return
            elif isinstance(parsed, Asked):
                self.hands.hear(parsed)
            elif isinstance(parsed, Answers):
                self._answers = parsed.values
            elif parsed.what == "release":
                self.hands.release()
            else:
                self._wishes.append(parsed.what)

    def begin(self, hands: Hands, about: dict[str, Any], state: dict[str, Any]) -> None:
        """Show a new episode."""
        with self._lock:
            self.hands = hands
            self._wishes.clear()
            self._about = {"kind": "scene", "operator": self._operator, **about}
        self.gate.post(json.dumps(self._about))
        self.show(state)

    def show(self, state: dict[str, Any]) -> None:
        """Show the numbers of the gauges."""
        with self._lock:
            self._state = {"kind": "state", **state}
            clients = list(self._clients)
            theme, self._theme = self._theme, None
        if theme is not None:
            self.stage.set_dark(theme.dark)
            self.stage.set_shadows(not theme.software)
        self._send(self._state, clients)

    def _send(self, state: dict[str, Any], clients: Collection[int]) -> None:
        driver = self._driver
        rest = {"driver": driver is not None, "watchers": max(0, len(self._clients) - 1)}
        texts = [json.dumps({**state, **rest, "you": you}) for you in (False, True)]
        for client in clients:
            self.gate.post(texts[client == driver], "state", client)

    def picture(self, view: int, pixels: Any) -> None:
        """Show a camera's picture, (H, W, 3), of the front (0) or the rear (1)."""
        from PIL import Image

        data = io.BytesIO()
        Image.fromarray(pixels).save(data, "JPEG", quality=_QUALITY)
        self.gate.post(bytes([view]) + data.getvalue(), f"camera {view}")

    def wished(self) -> str | None:
        """Return and forget the oldest button that was pressed: begin, again or next."""
        with self._lock:
            return self._wishes.popleft() if self._wishes else None

    def wait(self, done: Callable[[str | None], bool]) -> str:
        """Show the last state until ``done`` is true of the button that was pressed, or None."""
        while not done(wish := self.wished()):
            self.show(self._state)
            time.sleep(PERIOD)
        return wish or ""

    def end(self, outcome: str, left: int) -> str:
        """Show how the episode ended; return ``next`` or ``again`` once it was pressed.

        ``left``: number of episodes that are still to be driven.
        """
        note = f"{left} to go" if left else "the last one"
        over = {"phase": "over", "outcome": outcome, "note": note, "last": not left}
        self.show({**self._state, **over})
        return self.wait(lambda wish: wish in ("next", "again", "begin")).replace("begin", "next")

    def finish(self) -> None:
        """Say that everything was driven, before the page is no longer served."""
        self.show({**self._state, "phase": "done", "note": ""})
        time.sleep(_GOODBYE)

    def ask(self) -> tuple[int, ...]:
        """Ask the questions of NASA-TLX; return the six answers, 0 to 100."""
        self._answers = None
        self.gate.post(json.dumps({"kind": "questions"}))
        self.wait(lambda wish: self._answers is not None)
        assert self._answers is not None  # waited for
        return self._answers


class Person:
    """The policy of one episode that a person drives; see ``flipperctl.api.Policy``."""

    command_period = PERIOD

    def __init__(
        self, page: DrivePage, env: FlipperEnv, helper: Policy | None, about: dict[str, Any]
    ) -> None:
        """Drive ``env``; ``helper`` commands the flippers that the person does not take.

        ``about``: title, episode and whether it is for practice, as the page shows them.
        """
        self._page, self._env, self._helper, self._about = page, env, helper, about
        self._hands = Hands(env.robot, PERIOD, helped=helper is not None)
        self._scene = LiveScene(page.gate.server.scene)
        self._still = (0,) * len(env.robot.joints)
        self._proposed: tuple[float, ...] = self._still
        self._pitch: float | None = None
        self._variation = 0.0
        self._heard: float | None = None
        self._ticks: deque[float] = deque()
        self._due = self._alone = 0.0
        self._drawing = self._drawn = 0.0
        """How long the last picture took, and when it was drawn [s]."""
        self._view = 0
        self._phase = "ready"
        self.late = self.count = 0
        """Ticks that came more than half a period late, and all."""

    def remove(self) -> None:
        """Remove the scene from the page."""
        self._scene.remove()

    def reset(self, simulator: Simulator) -> None:
        """Show the episode, and begin it once the person asks for it."""
        env, robot = self._env, self._env.robot
        if self._helper is not None:
            self._helper.reset(simulator)
        self._hands = Hands(robot, PERIOD, helped=self._helper is not None)
        env.drive.report_poses(self._moved)
        shown = env.scene
        world = env.drive.world
        ground = Laid.of(env.profile, world.of_engine)
        floor = self._page.stage.begin([ground])
        self._scene.begin(env.profile, robot, shown.finish, floor, ground=ground)
        self._scene.show(env.state)
        self._page.stage.follow([(self._scene, env.state)])
        self._cameras = isinstance(world.of_engine, CameraWorld)
        # What the page needs to draw the robot and its gauges
        about = {
            "robot": {
                "hinge": robot.hinge_offset,
                "flipper": robot.flipper_axle,
                "radius": robot.track_radius,
            },
            "ground": env.profile.extended(_MARGIN, _MARGIN).tolist(),
            "start": shown.start,
            "finish": shown.finish,
            "shared": self._helper is not None,
            "cameras": self._cameras,
            "joints": robot.joints,
            "step": robot.angle_step,
            "limit": robot.angle_limit,
            "flipper_speed": robot.flipper_speed,
            "track_speed": robot.track_speed,
        }
        self._page.begin(self._hands, {**self._about, **about}, self._gauges(env.state))
        self._draw(world)
        self._begin()

    def _begin(self) -> None:
        """Wait until the person begins, or goes on."""
        self._phase = "ready"
        self._page.show(self._gauges(self._env.state))
        self._page.wait(lambda wish: wish == "begin")
        self._hands.begin()
        self._phase = "driving"
        self._due = self._alone = time.monotonic()

    def _moved(self, time: float, poses: FloatArray) -> None:
        pitches = poses[:, 2] if self._pitch is None else np.append(self._pitch, poses[:, 2])
        self._variation += float(np.abs(np.diff(pitches)).sum())
        self._pitch = float(poses[-1, 2])

    def act(self, p: Perception) -> int:
        """Show what is perceived, and ask the helper; the action has no effect."""
        if self._helper is not None:
            action = self._helper.act(p)
            moves = self._env.drive.moves
            self._proposed = action if isinstance(action, tuple) else moves[action]
        self._scene.perceive(p, self._env.state, self._env.map_points())
        return action_index(*self._still)

    def command(self, world: World) -> Command:
        """Show the world, wait for the next tick, and return what the person commands."""
        page, state = self._page, world.state()
        # Gauges at every tick, the scene at every other one
        page.show(self._gauges(state))
        if self.count % _SCENE == 0:
            with page.gate.server.atomic():
                self._scene.show(state)
                page.stage.follow([(self._scene, state)])
        self._draw(world)
        self._wait()
        # What the person's hands do at the tick itself
        if page.wished() == "again":
            raise AgainError
        proposed, self._proposed = self._proposed, self._still  # a decision's turn counts once
        command, self._heard = self._hands.command(self._env.drive.targets, state, proposed)
        self._phase = "held" if self._heard is None else "driving"
        # Without a driver the robot holds still, and after a while its clock stops, too.
        now = time.monotonic()
        if self._heard is not None:
            self._alone = now
        elif now - self._alone > _WAITS:
            self._begin()  # the clock stands until somebody is back
        return command

    def _wait(self) -> None:
        now = time.monotonic()
        self.count += 1
        if (left := self._due - now) > 0:
            time.sleep(left)
        else:
            self.late += left < -PERIOD / 2
            if left < -PERIOD:
                self._due = now  # what is late stays late: the robot does not hurry
        self._due += PERIOD
        self._ticks.append(time.monotonic())
        while self._ticks[-1] - self._ticks[0] > _SHOWN:
            self._ticks.popleft()

    def _draw(self, world: Any) -> None:
        """Draw one of the cameras, if the time until the next tick is enough for it."""
        begun = time.monotonic()
        # A picture must be done before the next tick, unless the last one is old.
        soon, old = self._due - begun < self._drawing, begun - self._drawn > _OLDEST
        rested = begun - self._drawn > self._drawing / _DRAWING
        if not self._cameras or not (old or (rested and not soon)):
            return
        # The cameras take turns.
        self._view = 1 - self._view
        try:
            image = world.look(_VIEWS[self._view], *_SIZE)
        except FlipperctlError as error:
            self._cameras = False
            self._about["note"] = f"no cameras: {error}"
            return
        self._page.picture(self._view, image.pixels)
        self._drawn = time.monotonic()
        self._drawing = self._drawn - begun

    def _gauges(self, state: RobotState) -> dict[str, Any]:
        drive, robot = self._env.drive, self._env.robot
        x, z = state.position.tolist()
        owned = dict(zip(("front", "rear"), self._hands.owned, strict=True))
        # Belts that are not measured run at the robot's speed.
        speed = robot.track_speed if state.belts is None else float(state.belts.mean())
        span = self._ticks[-1] - self._ticks[0] if len(self._ticks) > 1 else 0.0
        return {
            "phase": self._phase,
            "outcome": None,
            "note": self._about.get("note", ""),
            "time": state.time,
            "x": x,
            "z": z,
            "pitch": state.pitch,
            "roll": state.roll,
            "front": state.front,
            "rear": state.rear,
            "belts": speed / robot.track_speed,
            "angles": angles_of(state),
            "targets": drive.targets,
            "variation": self._variation,
            "left": max(0.0, drive.termination.finish - x),
            "who": {name: "person" if mine else "policy" for name, mine in owned.items()},
            "risk": getattr(self._helper, "risk", None),
            "heard": self._heard,
            "rate": (len(self._ticks) - 1) / span if span else 0.0,
        }
