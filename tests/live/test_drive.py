"""``flipperctl drive``: what its page's socket makes the robot do, in real time."""

import json
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import browser
from benchmarks.drive import ScriptedOperator, Way
from flipperctl.checkpoint import recording
from flipperctl.config import EvalConfig
from flipperctl.evaluation.replay import replay
from flipperctl.evaluation.rows import Row
from flipperctl.live.drive import DrivePage
from flipperctl.live.drives import DriveFolder, Task, drive
from flipperctl.plugging.plugins import load
from flipperctl.policies.source import load_policy

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def _patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no busy machine be taken for a lost browser; tests/live/test_hands.py has the limit."""
    monkeypatch.setattr("flipperctl.live.hands.LOST", 10.0)
    monkeypatch.setattr("flipperctl.live.drive._WAITS", 0.5)


class Session:
    """An episode on a step that waits for somebody to drive it."""

    def __init__(self, folder: Path, helper: str | None = None, **settings: Any) -> None:
        load(())
        low = {"name": "step", "height": 0.1, "platform": 0.6}
        short = {"run_up": 0.8, "run_out": 0.3, "start_noise": 0}
        robot = {"track_speed": 0.5, **settings.pop("robot", {})}  # it drives in real time
        self.config = EvalConfig(terrain=low, episode=short, robot=robot, **settings)
        self.folder = DriveFolder(folder / "anna", "script: test")
        self.page = DrivePage(0, "anna")
        self.rows: list[Row] = []
        source = None if helper is None else load_policy(helper)
        task = Task("step", self.config, 0, self.folder, source)
        self._thread = threading.Thread(
            target=drive, args=(self.page, [task], lambda task, row, late: self.rows.append(row))
        )
        self._thread.daemon = True
        self._thread.start()

    @property
    def address(self) -> str:
        return self.page.gate.address

    def over(self) -> Row:
        self._thread.join(60)
        assert not self._thread.is_alive()
        (row,) = self.rows
        return row

    def episode(self) -> recording.RecordedEpisode:
        (found,) = recording.read(self.folder.path).episodes
        return found


class Client:
    """A browser's socket without the browser."""

    def __init__(self, session: Session) -> None:
        from websockets.sync.client import connect

        http, token = session.address.split("/?")
        self.socket = connect(f"{http.replace('http', 'ws')}/control?{token}", max_size=None)
        self.at = 0.0
        self.state: dict[str, Any] = {}
        self.scene: dict[str, Any] = {}
        self.pictures: dict[int, bytes] = {}
        self.next(lambda s: bool(self.scene))

    def next(self, until: Any, **hands: float) -> dict[str, Any]:
        """Say what the hands do at each state, until a condition of a state is true."""
        for message in self.socket:
            if isinstance(message, bytes):
                self.pictures[message[0]] = message[1:]
                continue
            found: dict[str, Any] = json.loads(message)
            if found["kind"] == "scene":
                self.scene = found
            elif found["kind"] == "state":
                self.state = found
                if until(found):
                    return found
                if hands:
                    self.hands(**hands)
        raise AssertionError("closed")

    def hands(self, **hands: float) -> None:
        self.at += 1
        names = self.scene["joints"]
        rates, steps = ([hands.get(n + kind, 0) for n in names] for kind in ("", "_steps"))
        asked = {"belts": hands.get("belts", 0), "rates": rates, "steps": steps}
        self.send({"kind": "hands", "at": self.at, **asked})

    def do(self, what: str) -> None:
        self.send({"kind": "do", "what": what})

    def send(self, document: dict[str, Any]) -> None:
        self.socket.send(json.dumps(document))


@contextmanager
def page_of(session: Session, chromium: Any, problems: list[str]) -> Iterator[Any]:
    """Open the page in a browser, without the 3-D scene, whose drawing takes a core."""
    http = session.address.split("/?")[0]
    own = http, http.replace("http", "ws"), "data:", "blob:"
    tab = chromium.new_page(viewport={"width": 1280, "height": 800})
    tab.set_default_timeout(120_000)
    tab.route("**/scene*", lambda route: route.fulfill(body="<p>scene</p>"))
    tab.on("request", lambda r: None if r.url.startswith(own) else problems.append(r.url))
    tab.on("pageerror", lambda error: problems.append(str(error)))
    tab.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
    tab.goto(session.address)
    tab.locator("#phase[data-value=ready]").wait_for()
    yield tab
    tab.close()


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    opened = Session(tmp_path)
    with opened.page.gate:
        yield opened


def test_a_drive_from_start_to_finish_is_an_episode(session: Session) -> None:
    client, watcher = Client(session), Client(session)
    assert client.scene["operator"] == "anna"
    assert client.state["phase"] == "ready"
    client.do("begin")
    client.next(lambda s: s["time"] > 0.5, belts=1)
    watcher.next(lambda s: s["time"] > 0.5)
    assert (client.state["you"], watcher.state["you"]) == (True, False)
    watcher.hands(belts=-1, front_steps=4)  # who watches cannot drive
    client.next(lambda s: s["time"] > 1.5, belts=1, front_steps=2)
    assert client.state["targets"][0] == pytest.approx(2 * client.scene["step"])
    client.next(lambda s: s["phase"] == "over", belts=1, front_steps=2)
    assert client.state["outcome"] == "reached"
    client.do("next")
    client.next(lambda s: s["phase"] == "done")
    row = session.over()
    assert client.state["variation"] == pytest.approx(row["pitch_variation_100hz"], abs=0.02)
    assert client.state["time"] == pytest.approx(row["t_cost"], abs=0.051)
    (record,) = session.folder.path.glob("*.json")
    assert replay(record).differences == []
    assert row["taken"] == 1.0
    commands = session.episode().commands
    assert commands is not None
    assert (commands[:, 2] >= 0).all()


def test_a_lost_connection_holds_the_robot(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    client, closed, lost = Client(session), session.page.closed, list[float]()

    def note(number: int) -> None:
        lost.append(session.page._state["time"])
        closed(number)

    monkeypatch.setattr(session.page, "closed", note)
    client.do("begin")
    client.next(lambda s: s["time"] > 0.5, belts=1, front=1)
    client.socket.socket.shutdown(socket.SHUT_RDWR)  # without a word
    again = Client(session)
    again.next(lambda s: s["phase"] == "held")
    again.next(lambda s: s["phase"] == "ready")  # then the clock stands, too
    again.hands(front_steps=5)
    again.do("begin")
    again.next(lambda s: s["phase"] == "driving", belts=1, front_steps=5)
    assert again.state["targets"][0] < 4 * again.scene["step"]  # pressed before it went on
    again.next(lambda s: s["phase"] == "over", belts=1, front_steps=5)
    again.do("next")
    session.over()
    commands = session.episode().commands
    assert commands is not None
    stood = np.flatnonzero(commands[:, 2] == 0.0) * 0.05
    stood = stood[stood >= lost[0]]
    assert stood[0] <= lost[0] + 0.3
    held = commands[commands[:, 2] == 0.0][-len(stood) :]
    assert np.ptp(held[:, 0]) < 1e-9  # the flipper is not driven on, nor let sag


def test_a_policy_turns_what_the_person_leaves(tmp_path: Path) -> None:
    session = Session(tmp_path, "okada")
    with session.page.gate:
        client = Client(session)
        assert client.scene["shared"]
        client.do("begin")
        client.next(lambda s: s["time"] > 0.5, belts=1)
        assert client.state["who"] == {"front": "policy", "rear": "policy"}
        client.next(lambda s: s["time"] > 1.0, belts=1, rear_steps=1)
        assert client.state["who"] == {"front": "policy", "rear": "person"}
        client.do("release")
        client.next(lambda s: s["who"]["rear"] == "policy", belts=1, rear_steps=1)
        client.next(lambda s: s["phase"] == "over", belts=1, rear_steps=1)
        client.do("next")
        row = session.over()
    assert 0 < row["taken"] < 0.5
    (record,) = session.folder.path.glob("*.json")
    assert replay(record).differences == []


def test_four_flippers_are_driven_one_by_one_with_a_helper_for_a_pair(tmp_path: Path) -> None:
    robot = {"flippers": "four"}
    session = Session(
        tmp_path, "okada_sides", sim="mujoco", robot=robot, perception={"sides": True}
    )
    with session.page.gate:
        client, hands = Client(session), {"belts": 0.5, "front_left_steps": 1, "front_right": -0.5}
        client.do("begin")
        client.next(lambda s: s["time"] > 0.5, belts=0.5)
        client.next(lambda s: s["time"] > 1.5, **hands)
        assert client.state["who"] == {"front": "person", "rear": "policy"}
        left, right = client.state["targets"][:2]
        assert left == pytest.approx(client.scene["step"])
        assert right < -0.2
        assert client.state["angles"][:2] == pytest.approx([left, right], abs=0.15)
        client.next(lambda s: s["phase"] == "over", belts=1, front_left_steps=1)
        client.do("next")
        row = session.over()
    assert 0.3 < row["taken"] < 0.5  # one pair of both, but for the beginning
    (record,) = session.folder.path.glob("*.json")
    assert replay(record).differences == []
    episode = session.episode()
    assert episode.commands is not None
    assert episode.commands.shape[1] == 9
    assert episode.actions.max() > 8  # the sides turned apart
    assert (episode.labels.argmax(1) == episode.actions).all()


def test_cameras_show_what_is_there(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    from PIL import Image

    session = Session(tmp_path, sim="mujoco", perception="lidar")
    with session.page.gate:
        client = Client(session)
        assert client.scene["cameras"]
        client.do("begin")
        client.next(lambda s: len(client.pictures) == 2, belts=1)
        for data in client.pictures.values():
            (tmp_path / "p.jpg").write_bytes(data)
            pixels = np.asarray(Image.open(tmp_path / "p.jpg"))
            assert pixels.shape == (240, 320, 3)
            assert pixels.std() > 10
        nodes: Any = session.page.gate.server.scene._handle_from_node_name
        points = nodes["/drive/0/perceived/points"].points
        ahead = points[points[:, 0] > 0.05]  # the step, 0.1 m high
        assert len(ahead) > 5
        assert np.median(ahead[:, 2]) == pytest.approx(0.1, abs=0.03)
        client.do("again")
        client.next(lambda s: s["phase"] == "ready")
        assert not session.folder.path.exists()  # a drive that was broken off leaves nothing


def test_a_browser_drives_by_keys(session: Session, chromium: Any) -> None:
    problems: list[str] = []
    with page_of(session, chromium, problems) as tab:
        operator = ScriptedOperator(
            tab, [Way(-2, 1, 0), Way(0, 0, 0)], 0.4, keys=True, reaction=0.1
        )
        assert operator.drive() == "reached"
        shown = {name: operator.value(name) for name in ("time", "variation", "front", "pitch")}
        tab.keyboard.press("Enter")
        row = session.over()
    assert shown["time"] == pytest.approx(row["t_cost"], abs=0.051)
    assert shown["variation"] == pytest.approx(row["pitch_variation_100hz"], abs=0.05)
    assert problems == []
    assert operator.latencies


def test_a_closed_browser_holds_the_robot(
    session: Session, chromium: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()  # the real limit
    received, heard = session.page.received, [0.0]

    def note(client: int, message: str) -> None:
        if '"belts":1' in message:
            heard[0] = session.page._state["time"]
        received(client, message)

    monkeypatch.setattr(session.page, "received", note)
    with page_of(session, chromium, []) as tab:
        tab.keyboard.press("Enter")
        tab.keyboard.down("ArrowUp")
        tab.wait_for_function("state.time > 1.0")
    client = Client(session)
    client.do("take")
    client.next(lambda s: s["phase"] == "ready")
    client.do("begin")
    client.next(lambda s: s["phase"] == "over", belts=1)
    client.do("next")
    session.over()
    commands = session.episode().commands
    assert commands is not None
    stood = np.flatnonzero(commands[:, 2] == 0.0) * 0.05
    assert stood[stood > heard[0]][0] <= heard[0] + 0.3


@pytest.mark.long
@pytest.mark.skipif(browser.installed() is None, reason="no Chromium is installed")
@pytest.mark.parametrize("by", ["keys", "buttons"])
@pytest.mark.parametrize("sim", ["planar", "mujoco"])
@pytest.mark.parametrize("name", ["step", "stair"])
def test_a_script_drives_from_start_to_finish(name: str, sim: str, by: str, tmp_path: Path) -> None:
    words = ["--scene", name, "--sim", sim, "--by", by, "--folder", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.drive", *words],
        capture_output=True, text=True, check=True, timeout=300,
    )  # fmt: skip
    assert "reached after" in done.stdout
    (record,) = tmp_path.glob("drives/fixed/*.json")
    assert replay(record).differences == []
