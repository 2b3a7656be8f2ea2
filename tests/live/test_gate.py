"""Who gets through the gate of a live page, and what hostile and slow clients cannot do."""

from __future__ import annotations

import http.client
import logging
import queue
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest
import viser
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from flipperctl.errors import RequestError
from flipperctl.live.gate import Gate

PAGE = "<!doctype html><title>ours ö</title>".encode()
WAIT = 60
"""Time after which a missing message fails a test [s]."""

UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "MDEyMzQ1Njc4OWFiY2RlZg==",
}


class Recorder:
    """A control that notes its calls, and fails on the message "fail"."""

    def __init__(self) -> None:
        self.calls: queue.Queue[tuple[Any, ...]] = queue.Queue()

    def opened(self, client: int) -> None:
        self.calls.put(("opened", client))

    def received(self, client: int, message: str) -> None:
        if message in ("fail", "foreign"):
            raise (ArithmeticError if message == "fail" else ValueError)(message)
        self.calls.put(("received", client, message))

    def closed(self, client: int) -> None:
        self.calls.put(("closed", client))

    def next(self) -> tuple[Any, ...]:
        return self.calls.get(timeout=WAIT)


class Site:
    """A gate, its control and ways to reach it."""

    def __init__(self, gate: Gate, control: Recorder) -> None:
        self.gate, self.control = gate, control
        self.place = gate.address.removeprefix("http://").partition("/")[0]
        self.query = "?" + gate.address.partition("?")[2]

    def get(
        self, path: str, headers: dict[str, str] | None = None
    ) -> tuple[http.client.HTTPResponse, bytes]:
        plain = http.client.HTTPConnection(self.place, timeout=WAIT)
        plain.request("GET", path, headers=headers or {})
        answer = plain.getresponse()
        body = answer.read()
        plain.close()
        return answer, body

    def open(self, path: str, **options: Any) -> ClientConnection:
        return connect(f"ws://{self.place}{path}", proxy=None, open_timeout=WAIT, **options)

    def raw(self) -> socket.socket:
        """Return a bare connection."""
        host, _, port = self.place.partition(":")
        return socket.create_connection((host, int(port)), timeout=WAIT)

    def client(self, **options: Any) -> tuple[ClientConnection, int]:
        connection = self.open("/control" + self.query, **options)
        kind, number = self.control.next()
        assert kind == "opened"
        return connection, number


@pytest.fixture
def site() -> Iterator[Site]:
    control = Recorder()
    with Gate(0, page=PAGE, control=control) as gate:
        yield Site(gate, control)


def test_only_requests_with_the_token_from_this_page_are_answered(site: Site) -> None:
    right, port = site.query, site.place.partition(":")[2]
    wrong: tuple[tuple[str, dict[str, str]], ...] = (
        ("", {}),
        ("?token=", {}),
        ("?token=guess", {}),
        ("?token=%FF%00%C3%B6", {}),
        ("", {"Cookie": f"flipperctl_{port}=guess"}),
        ("", {"Cookie": f"flipperctl_1={right.removeprefix('?token=')}"}),
        (right, {"Origin": "http://example.org"}),
        (right, {"Origin": "null"}),
        (right, {"Origin": f"https://127.0.0.1:{port}"}),
        (right, {"Origin": f"http://127.0.0.1:{port}.example.org"}),
        (right, {"Host": "example.org"}),
        (right, {"Host": f"example.org:{port}"}),
        (right, {"Host": "127.0.0.1:1"}),
    )
    for query, headers in wrong:
        for path in ("/", "/scene", "/nothing"):
            answer, body = site.get(path + query, headers)
            assert answer.status == 403, (path, query, headers)
            assert answer.getheader("Set-Cookie") is None
            assert PAGE not in body
        for path in ("/", "/scene", "/control"):
            answer, _ = site.get(path + query, headers | UPGRADE)
            assert answer.status == 403, (path, query, headers)
    assert site.control.calls.empty()
    for path in ("/", "/scene", "/control"):  # the same handshake passes without the fault
        answer, _ = site.get(path + right, UPGRADE | {"Origin": f"http://localhost:{port}"})
        assert answer.status == 101


def test_the_cookie_of_the_first_answer_lets_a_browser_in(site: Site) -> None:
    answer, body = site.get("/" + site.query)
    assert (answer.status, body) == (200, PAGE)
    assert answer.getheader("Cache-Control") == "no-store"
    assert answer.getheader("Referrer-Policy") == "no-referrer"
    assert "default-src 'self'" in (answer.getheader("Content-Security-Policy") or "")
    cookie, *rest = (answer.getheader("Set-Cookie") or "").split("; ")
    assert {"HttpOnly", "SameSite=Strict"} <= set(rest)
    headers = {"Cookie": f'other={{"a": 1}}; {cookie}'}
    assert site.get("/", headers)[1] == PAGE
    answer, scene = site.get("/scene", headers)
    assert answer.status == 200
    assert b"viser" in scene.lower()
    with site.open("/control", additional_headers=headers):
        assert site.control.next()[0] == "opened"
    protocol = f"viser-v{viser.__version__}"
    with site.open("/scene", additional_headers=headers, subprotocols=[protocol]) as drawn:
        assert isinstance(drawn.recv(WAIT), bytes)


@pytest.mark.parametrize(
    "path",
    ["/../_viser.py", "/%2e%2e/index.html", "/..%2f..%2f_viser.py", "/..\\_viser.py",
     "//etc/passwd", "/%2Fetc/passwd", "/index.html/..", "/scene/../../_viser.py",
     "/control"],
)  # fmt: skip
def test_no_path_leads_to_another_file(site: Site, path: str) -> None:
    answer, body = site.get(path + site.query)
    assert (answer.status, b"import" in body or b"root" in body) == (404, False)


def test_without_a_page_viser_answers_and_no_control_is_found() -> None:
    with Gate(0) as gate:
        site = Site(gate, Recorder())
        answer, body = site.get("/" + site.query)
        assert answer.status == 200
        assert b"viser" in body.lower()
        assert answer.getheader("Set-Cookie") is not None
        with pytest.raises(InvalidStatus, match="404"):
            site.open("/control" + site.query)
        gate.post("nobody listens")


def test_a_slow_client_gets_the_newest_state_and_holds_nobody_up(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    with ExitStack() as stack:
        good = [stack.enter_context(site.client()[0]) for _ in range(4)]
        slow = stack.enter_context(site.client(max_queue=1)[0])
        huge, huge_number = site.client()
        huge.send("x" * 10_000_000)
        assert site.control.next() == ("closed", huge_number)
        for i in range(3000):  # more than the buffers of the slow client take
            site.gate.post(f"{i:06} {'.' * 1000}", key="state")
            for client in good:
                while int(str(client.recv(WAIT)).split()[0]) != i:
                    pass
        got = [int(str(slow.recv(WAIT)).split()[0])]
        while got[-1] != 2999:
            got.append(int(str(slow.recv(WAIT)).split()[0]))
        assert len(got) < 2900
        for noise in (b"\x00\xff\r\n\r\n", b"HEAD / HTTP/1.1\r\n\r\n", b"GET /" + b"a" * 10_000):
            with site.raw() as bare:
                bare.sendall(noise)
                bare.shutdown(socket.SHUT_WR)
                assert bare.recv(1) == b""
    assert caplog.records == []  # nothing for the terminal


def test_messages_without_a_key_keep_their_order(site: Site) -> None:
    client, number = site.client()
    with client:
        for i in range(50):
            site.gate.post(f"all {i}")
            site.gate.post(bytes([i]), client=number)
        got = [client.recv(WAIT) for _ in range(100)]
        assert got == [m for i in range(50) for m in (f"all {i}", bytes([i]))]


def test_a_lost_connection_and_a_failing_control_end_one_client(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    stays, _ = site.client()
    lost, number = site.client()
    lost.socket.shutdown(socket.SHUT_RDWR)  # no closing handshake
    assert site.control.next() == ("closed", number)
    failing, number = site.client()
    with caplog.at_level(logging.ERROR, "flipperctl"):
        failing.send("fail")
        assert site.control.next() == ("closed", number)
        foreign, number = site.client()
        foreign.send("foreign")
        assert site.control.next() == ("closed", number)
    with pytest.raises(ConnectionClosed, match="no message of the page"):
        foreign.recv(WAIT)
    (record,) = [r for r in caplog.records if r.name.startswith("flipperctl")]
    assert record.exc_info is not None
    with stays:
        stays.send("still here")
        assert site.control.next()[2] == "still here"


def test_stop_closes_every_client_and_the_port() -> None:
    control = Recorder()
    with Gate(0, control=control) as gate:
        site = Site(gate, control)
        client, number = site.client()
        deaf, other = site.client(max_queue=1)
        for _ in range(100):
            gate.post("x" * 100_000, client=other)
    assert sorted(control.next() for _ in range(2)) == [("closed", number), ("closed", other)]
    deaf.socket.close()
    with pytest.raises(ConnectionClosed):
        client.recv(WAIT)
    with pytest.raises(ConnectionRefusedError):
        site.get("/")
    gate.stop()
    gate.post("to nobody")


def test_a_port_in_use_is_one_error() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as other,
        pytest.raises(RequestError, match="--port"),
    ):
        Gate(other.getsockname()[1])
