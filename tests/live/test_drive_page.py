"""The page of ``flipperctl drive`` in a browser, before a server that says what a test wants.

The browser's clock stands still but for ``run``, so that messages and latencies are exact.
"""

import json
import queue
import re
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from benchmarks.browser import crowded
from flipperctl.live.gate import page_file

pytestmark = pytest.mark.slow
POLICY = (  # nothing but the page's own code and its own server
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src blob: data:; connect-src 'self'; frame-src 'self'; worker-src blob:"
)
SCENE = {
    "kind": "scene", "title": "stair", "episode": 0, "operator": "anna", "practice": False,
    "robot": {"hinge": 0.28, "flipper": 0.336, "radius": 0.1},
    "ground": [[0, 0], [0, 0.2], [1, 0.2]],
    "start": -1.0, "finish": 2.0, "cameras": True, "shared": True, "step": 0.2618, "limit": 1.0472,
    "flipper_speed": 0.436, "track_speed": 0.2, "joints": ["front", "rear"],
}  # fmt: skip
STATE = {
    "kind": "state", "phase": "driving", "you": True, "driver": True, "watchers": 0, "time": 1.25,
    "x": 0.1, "z": 0.2, "pitch": 0.1, "roll": -0.05, "front": 0.2, "rear": -0.3,
    "angles": [0.2, -0.3], "targets": [0.2, 0.1], "belts": 1.0, "variation": 0.4, "left": 2.1,
    "risk": None, "heard": 0, "who": {"front": "person", "rear": "policy"},
    "rate": 20.0, "outcome": None, "note": "",
}  # fmt: skip


class Server:
    """Serves the page, keeps what the newest browser sends, and sends what the test gives it."""

    def __init__(self) -> None:
        from websockets.sync.server import serve

        self.received: queue.Queue[dict[str, Any]] = queue.Queue()
        self.opened: queue.Queue[Any] = queue.Queue()
        self.server = serve(self._talk, "127.0.0.1", 0, process_request=self._answer)
        self.address = f"http://127.0.0.1:{self.server.socket.getsockname()[1]}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def _answer(self, connection: Any, request: Any) -> Any:
        if request.path == "/control":
            return None
        text = (
            page_file("drive.html").decode() if request.path == "/" else "<!doctype html><canvas>"
        )
        response = connection.respond(200, text)
        del response.headers["Content-Type"]
        response.headers["Content-Type"] = "text/html; charset=utf-8"
        response.headers["Content-Security-Policy"] = POLICY
        return response

    def _talk(self, connection: Any) -> None:
        self.connection = connection
        self.send(SCENE)
        self.send(STATE)
        self.opened.put(connection)
        for message in connection:
            self.received.put(json.loads(message))

    def send(self, document: dict[str, Any]) -> None:
        self.connection.send(json.dumps(document))


class Tab:
    """A browser tab on the page, with a clock of its own [ms]."""

    def __init__(self, page: Any, server: Server) -> None:
        self.page, self.server = page, server
        self.hands_sent: list[dict[str, Any]] = []
        self.base = STATE
        self.problems: list[str] = []

    def run(self, milliseconds: int = 20) -> list[dict[str, Any]]:
        """Return what the page sends while its clock runs, without what its worker repeats."""
        self.page.clock.run_for(milliseconds)
        self.page.evaluate("act('again')")  # a last message, after all that the page has sent
        sent = []
        while (message := self.server.received.get(timeout=30)) != {"kind": "do", "what": "again"}:
            if message in self.hands_sent:  # a repeat, by the worker's clock, which runs on
                continue
            sent.append(message)
            if message["kind"] == "hands":
                self.hands_sent.append(message)
        return sent

    def hands(self, milliseconds: int = 60) -> tuple[float, ...]:
        """Return the rates of the joints, the belts' and the steps of the newest hands message."""
        newest = [m for m in self.run(milliseconds) if m["kind"] == "hands"][-1]
        return (*newest["rates"], newest["belts"], *newest["steps"])

    def shows(self, condition: str) -> None:
        for _ in range(200):
            self.page.clock.run_for(20)
            if self.page.evaluate(condition):
                return
            self.page.wait_for_timeout(20)
        raise AssertionError(condition + ": " + self.page.inner_text("body"))

    def four(self) -> None:
        """Go on with a robot of four flippers."""
        joints = [f"{end}_{side}" for end in ("front", "rear") for side in ("left", "right")]
        angles = {key: [-0.8, -1.04, -1.04, -0.2] for key in ("angles", "targets")}
        self.server.send(SCENE | {"joints": joints})
        self.base = STATE | angles
        self.state()
        self.shows("four()")

    def state(self, **changes: Any) -> None:
        self.server.send(self.base | changes)
        text = json.dumps(changes)
        self.shows(f"Object.entries({text}).every(([k, v]) => state && state[k] === v)")
        self.page.clock.run_for(40)  # two frames: it is drawn


@pytest.fixture(scope="module")
def opened(chromium: Any) -> Iterator[Tab]:
    """Yield a tab into which each test loads the page anew."""
    tab = Tab(chromium.new_page(viewport={"width": 1280, "height": 800}), Server())
    tab.page.on("pageerror", lambda error: tab.problems.append(str(error)))
    tab.page.on("console", lambda m: tab.problems.append(m.text) if m.type == "error" else None)
    tab.page.clock.install(time=0)
    tab.page.clock.pause_at(1000)
    yield tab
    tab.page.close()
    tab.server.server.shutdown()


@pytest.fixture
def tab(opened: Tab) -> Iterator[Tab]:
    opened.hands_sent.clear()
    opened.base = STATE
    opened.page.goto(opened.server.address)
    opened.shows("state !== null")
    yield opened
    assert opened.problems == []


def test_hands_are_sent_every_50_ms_and_at_once_on_a_change(tab: Tab) -> None:
    tab.run()  # what the page sent while it was opened
    sent = tab.run(1000)
    assert len(sent) == 20
    times = [message["at"] for message in sent]
    assert times == sorted(set(times))
    tab.page.keyboard.down("ArrowUp")
    assert [message["belts"] for message in tab.run(1)] == [1]
    tab.page.keyboard.up("ArrowUp")


def test_keys(tab: Tab) -> None:
    key = tab.page.keyboard
    key.down("q")
    key.down("q")  # the key's own repeat
    assert tab.hands() == (0, 0, 0, 1, 0)
    key.up("q")
    for name in ("q", "a", "a", "a", "e", "d"):
        key.press(name)
    assert tab.hands() == (0, 0, 0, -1, 0)
    key.press("m")
    key.down("a")
    key.down("e")
    key.down("ArrowDown")
    assert tab.hands() == (-1, 1, -1, -1, 0)
    tab.page.evaluate("window.dispatchEvent(new Event('blur'))")
    tab.page.wait_for_timeout(50)
    assert tab.hands() == (0, 0, 0, -1, 0)
    for name in ("a", "e", "ArrowDown"):
        key.up(name)
    tab.page.fill("#speed", "40")
    key.press("c")
    assert tab.hands() == (0, 0, 0.4, -1, 0)
    key.press(" ")
    assert tab.hands() == (0, 0, 0, -1, 0)
    tab.page.frames[1].locator("canvas").click()  # the scene has the focus, and gives it back
    key.down("ArrowUp")
    assert tab.hands() == (0, 0, 0.4, -1, 0)
    key.up("ArrowUp")
    tab.page.evaluate("document.getElementById('scene').contentWindow.focus()")
    key.down("ArrowDown")
    assert tab.hands() == (0, 0, -0.4, -1, 0)
    key.up("ArrowDown")
    assert tab.hands() == (0, 0, 0, -1, 0)


def test_keys_buttons_and_shoulders_choose_the_side_of_four(tab: Tab) -> None:
    tab.page.keyboard.press("3")  # of pairs it means nothing
    tab.page.keyboard.press("q")
    assert tab.hands() == (0, 0, 0, 1, 0)
    tab.four()
    key = tab.page.keyboard
    for name in ("q", "1", "q", "e", "3", "q", "d", "2", "a"):
        key.press(name)
    assert tab.hands() == (0, 0, 0, 0, 0, 1, 1, 1, -1)
    key.press("m")
    tab.page.click("#side-right")
    tab.run(60)
    assert tab.page.get_attribute("#side-right", "aria-pressed") == "true"
    key.down("q")
    key.down("d")
    assert tab.hands()[:5] == (0, 1, 0, -1, 0)
    key.press("1")  # what is held is let go
    assert tab.hands()[:5] == (0, 0, 0, 0, 0)
    key.up("q")
    key.up("d")
    tab.page.evaluate(PAD % ("standard", 0, 0, -1, 0))
    tab.run(60)
    for button, rates in ((-1, (1, 0, -1, 0)), (5, (0, 1, 0, -1)), (4, (1, 0, -1, 0))):
        tab.page.evaluate(PAD % ("standard", -1, 1, button, 0))
        assert tab.hands()[:4] == rates
    assert tab.page.inner_text("#front") == "−46°/−60°"
    assert tab.page.inner_text("#rear") == "−60°/−11°"


def test_a_hold_button_holds_until_its_pointer_ends(tab: Tab) -> None:
    mouse, cancel = tab.page.mouse, ("#forward", "pointercancel", {"pointerId": 1})
    ends = mouse.up, lambda: mouse.move(600, -20), lambda: tab.page.dispatch_event(*cancel)
    for end in ends:
        tab.page.hover("#forward")
        mouse.down()
        assert tab.hands() == (0, 0, 1, 0, 0)
        mouse.move(600, 300)  # off the button, over the scene
        assert tab.hands() == (0, 0, 1, 0, 0)
        end()
        assert tab.hands() == (0, 0, 0, 0, 0)
        mouse.up()


PAD = """navigator.getGamepads = () => [null, {mapping: '%s', index: 1, axes: [0, %s, 0, %s],
    buttons: [...Array(8).keys()].map(i => ({pressed: i === %d, value: i === 7 ? %s : 0}))}]"""


def test_a_gamepad(tab: Tab) -> None:
    tab.page.evaluate(PAD % ("standard", 0, 0, -1, 0))
    tab.run(60)
    tab.page.evaluate(PAD % ("standard", -1, 1, -1, 1))
    assert tab.hands() == (1, -1, 1, 0, 0)
    tab.page.evaluate(PAD % ("standard", -1, 1, 1, 1))  # B: sticks count again when let go
    assert tab.hands() == (0, 0, 0, 0, 0)
    tab.page.evaluate(PAD % ("standard", 0, 0.1, -1, 0))
    tab.run(60)
    tab.page.evaluate(PAD % ("standard", 0, 1, -1, 0))
    assert tab.hands() == (0, -1, 0, 0, 0)


def test_a_gamepad_of_another_layout_drives_nothing(tab: Tab) -> None:
    for mapping in ("", "xr-standard"):
        tab.page.evaluate(PAD % (mapping, -1, -1, 0, 1))  # as triggers that rest at -1
        assert not [message for message in tab.run(300) if message["kind"] == "do"]
        assert tab.page.inner_text("#pad") == "gamepad not used: its layout is not the standard one"
    tab.page.keyboard.press("q")
    assert tab.hands() == (0, 0, 0, 1, 0)


def test_a_gamepad_counts_once_it_has_been_at_rest(tab: Tab) -> None:
    tab.page.evaluate(PAD % ("standard", -1, 0, 1, 1))  # B is down as it is plugged in
    tab.run(60)
    assert tab.page.inner_text("#pad") == "gamepad: let go of sticks and triggers"
    tab.page.evaluate(PAD % ("standard", -1, -0.5, -1, 1))
    assert tab.hands() == (0, 0.42, 0, 0, 0)
    tab.page.evaluate(PAD % ("standard", 0, -0.5, -1, 0))
    tab.run(60)
    assert tab.page.inner_text("#pad") == ""
    tab.page.evaluate(PAD % ("standard", -1, 0, -1, 1))
    assert tab.hands() == (1, 0, 1, 0, 0)


@pytest.mark.parametrize("flippers", ["pairs", "four"])
def test_on_a_phone_held_upright_every_button_is_wide_enough_and_stop_comes_first(
    tab: Tab, flippers: str
) -> None:
    if flippers == "four":
        tab.four()
    for width, height in ((393, 727), (480, 800), (360, 640), (599, 900)):
        tab.page.set_viewport_size({"width": width, "height": height})
        boxes = tab.page.evaluate(
            "Object.fromEntries([...document.querySelectorAll('#dock button, #speed')]"
            ".filter(b => b.offsetParent).map(b => {"
            "const r = b.getBoundingClientRect();"
            "return [b.id, [r.x, r.y, r.right, r.width, r.height]]}))"
        )
        assert all(w >= 44 and h >= 24 for *_, w, h in boxes.values()), (width, boxes)
        assert all(x >= 0 and right <= width for x, _, right, *_ in boxes.values())
        assert boxes["stop"][1] == min(box[1] for box in boxes.values())
        assert tab.page.evaluate("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize("flippers", ["pairs", "four"])
@pytest.mark.parametrize(
    ("width", "height"), [(1280, 800), (800, 1000), (800, 640), (390, 844), (844, 390)]
)
def test_nothing_is_cut_or_lies_over_something_else(
    tab: Tab, width: int, height: int, flippers: str
) -> None:
    if flippers == "four":
        tab.four()
    tab.page.set_viewport_size({"width": width, "height": height})
    for phase, outcome in (("ready", None), ("driving", None), ("held", None), ("over", "reached")):
        tab.state(phase=phase, outcome=outcome, risk=0.75)
        assert crowded(tab.page) == []
        assert tab.page.evaluate("$('phase').clientHeight") < 30  # one line


TEXTS = """() => {
  window.texts = [];
  const pen = CanvasRenderingContext2D.prototype, write = pen.fillText;
  pen.fillText = function (text, x, y) {
    const width = this.measureText(text).width, left = x - width * (this.textAlign === "right");
    const right = this.canvas.clientWidth - left - width;
    if (this.textAlign !== "center") texts.push([text, left, right]);
    write.call(this, text, x, y);
  };
}"""


def test_names_in_the_side_view_are_whole(tab: Tab) -> None:
    tab.page.set_viewport_size({"width": 390, "height": 844})
    tab.page.evaluate(TEXTS)
    for x in np.linspace(-1.5, 3.0, 31).tolist():
        tab.state(x=x)
    shown = tab.page.evaluate("texts")
    assert {"start", "finish"} <= {text for text, *_ in shown}
    assert [text for text, left, right in shown if min(left, right) < 0] == []


def test_keys_before_the_beginning_say_what_to_do(tab: Tab) -> None:
    tab.state(phase="ready")
    tab.page.keyboard.press("ArrowUp")
    assert tab.hands() == (0, 0, 0, 0, 0)
    assert tab.page.inner_text("#phase") == "Not begun yet: press Begin or Enter"
    tab.state(phase="driving", belts=0.0)
    assert tab.page.inner_text("#phase") == "Standing: hold Forward or ↑"
    tab.state(phase="driving")
    assert tab.page.inner_text("#phase") == "Driving"


def test_commands_follow_the_phase(tab: Tab) -> None:
    key = tab.page.keyboard
    for phase, name, what in [
        ("driving", "Enter", []), ("ready", "Enter", ["begin"]), ("over", "Enter", ["next"]),
        ("driving", "p", ["release"]), ("ready", "#begin", ["begin"]), ("over", "#begin", ["next"]),
        ("driving", "#release", ["release"]),
    ]:  # fmt: skip
        tab.state(phase=phase, outcome="reached" if phase == "over" else None)
        tab.run()
        if name[0] == "#":
            tab.page.click(name)
        else:
            key.press(name)
        assert [m["what"] for m in tab.run() if m["kind"] == "do"] == what
    assert tab.page.inner_text("#phase") == "Driving"
    tab.state(you=False)
    key.press("q")
    assert tab.hands() == (0, 0, 0, 0, 0)
    tab.page.click("#take")
    assert [m["what"] for m in tab.run() if m["kind"] == "do"] == ["take"]


def test_gauges_show_the_newest_state(tab: Tab) -> None:
    tab.state(time=2.5, left=1.75, variation=0.61)
    for name, value in [
        ("time", 2.5), ("variation", 0.61), ("pitch", 0.1), ("roll", -0.05), ("front", 0.2),
        ("rear", -0.3), ("left", 1.75), ("rate", 20.0),
    ]:  # fmt: skip
        assert float(tab.page.get_attribute("#" + name, "data-value")) == value
    assert tab.page.inner_text("#rear") == "−17.2°"
    assert tab.page.inner_text("#front-who") == "you"
    assert tab.page.inner_text("#rear-who") == "policy"
    tab.run(1000)
    now = tab.page.evaluate("performance.now()")
    tab.state(heard=now - 300, time=2.55)
    tab.state(heard=now - 300, time=2.6)  # counted once
    then = tab.page.evaluate("performance.now()")
    shown = float(tab.page.get_attribute("#latency", "data-value"))
    assert 0.3 <= shown <= (then - now) / 1000 + 0.3
    tab.page.clock.run_for(2500)
    tab.state(time=2.65)
    assert tab.page.get_attribute("#latency", "data-value") == ""


def test_the_questions_need_six_answers(tab: Tab) -> None:
    tab.server.send({"kind": "questions"})
    tab.shows("document.getElementById('asking').open")
    sliders = tab.page.locator("#questions input")
    for i in range(5):
        sliders.nth(i).fill(str(10 * i + 5))
    tab.page.click("#answer")
    assert re.search("last question", tab.page.inner_text("#missing"))
    sliders.nth(5).fill("100")
    tab.page.click("#answer")
    answers = [m["values"] for m in tab.run() if m["kind"] == "answers"]
    assert answers == [[5, 15, 25, 35, 45, 100]]


def test_a_lost_connection_releases_everything_and_comes_back(tab: Tab) -> None:
    tab.server.opened.get(timeout=30)
    tab.page.keyboard.press("c")
    assert tab.hands() == (0, 0, 1, 0, 0)
    tab.server.connection.close()
    tab.shows("document.getElementById('connection').dataset.value === 'lost'")
    tab.shows("state !== null")
    tab.server.opened.get(timeout=30)
    assert tab.hands() == (0, 0, 0, 0, 0)
