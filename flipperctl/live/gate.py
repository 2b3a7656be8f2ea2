"""A live page on one port of this machine, behind a token: viser's server and a socket of our own.

In: a port, a page, and what listens to the control socket. Out: an address with a token, viser's
server for scene and panel, and messages to and from the browsers. Every HTTP request and every
WebSocket handshake is checked before viser sees it.
"""

from __future__ import annotations

import asyncio
import hmac
import io
import itertools
import logging
import os
import secrets
import socket
import threading
from collections.abc import Awaitable, Callable
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from importlib.resources import files
from typing import TYPE_CHECKING, Any, Protocol
from urllib.parse import parse_qs

from flipperctl.errors import FlipperctlError, RequestError, missing_extra

if TYPE_CHECKING:
    from types import TracebackType

    import viser
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

    Handler = Callable[[ServerConnection], Awaitable[None]]
    Answer = Callable[[ServerConnection, Request], Response | None]

_HOST = "127.0.0.1"  # this machine alone is served
_FRAME = 2**16
"""Largest message that is received at all, by viser's socket as well [bytes]."""
_SEND_BUFFER = 2**16
"""The system's buffer for a control client; it bounds how old a slow client's messages are."""
_PATIENCE = 1.0
"""Time that a client has to answer the end of its connection [s]."""
_REFUSED, _FAILED = 1008, 1011  # close codes of RFC 6455
_HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_POLICY = "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval' {}; frame-ancestors 'self'"
"""Pages load nothing from elsewhere; the place is for WebSockets."""
_log = logging.getLogger(__name__)
_handshakes = logging.getLogger(f"{__name__}.handshakes")
_handshakes.setLevel(logging.CRITICAL)  # whoever reaches the port could fill the terminal
_starting = threading.Lock()


def page_file(name: str) -> bytes:
    """Return a live page with the style and the script that all of them share."""
    folder = files("flipperctl.live")
    text = folder.joinpath(name).read_text("utf-8")
    for part in ("page.css", "page.js"):
        text = text.replace(f"/* {part} */", folder.joinpath(part).read_text("utf-8"))
    return text.encode()


class Control(Protocol):
    """Listens to the control socket; it is called in the server's thread and must return at once.

    ``client`` is a number that no other client of the gate gets. ``closed`` follows every
    ``opened``, also after a lost connection.
    """

    def opened(self, client: int) -> None:
        """Take note of a new client."""

    def received(self, client: int, message: str) -> None:
        """Take a message of the page; ``ValueError`` if it is none, which closes the connection."""

    def closed(self, client: int) -> None:
        """Take note that a client is gone."""


@dataclass
class _Client:
    """A browser at the control socket, and the messages that wait for it."""

    connection: ServerConnection
    pending: dict[str | int, str | bytes] = field(default_factory=dict)
    wake: asyncio.Event = field(default_factory=asyncio.Event)


class Gate:
    """Serves viser, a page and a control socket until ``stop``.

    ``/`` answers with ``page`` [HTML in UTF-8] or viser's client, ``/scene`` with viser's client.
    The WebSocket ``/control`` belongs to ``control``, all others to viser. ``what`` is what a
    missing viser prevents.

    Raises:
        MissingExtraError: viser is not installed.
        RequestError: the port is taken.
    """

    server: viser.ViserServer
    address: str

    def __init__(
        self,
        port: int,
        *,
        page: bytes | None = None,
        control: Control | None = None,
        what: str = "watching",
    ) -> None:
        self._page, self._control = page, control
        self._token = secrets.token_urlsafe()
        self._lock = threading.Lock()
        self._clients: dict[int, _Client] = {}
        self._open: set[ServerConnection] = set()
        self._numbers = itertools.count()
        self._order = itertools.count()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stopped = False

        # A missing viser is named before the port is taken.
        try:
            import viser
        except ImportError as error:
            raise missing_extra(what, "viser") from error

        # The page answers to its own names alone, since another site's name may lead here as well.
        listener = _bind(port)
        self._port = listener.getsockname()[1]
        hosts = (f"{_HOST}:{self._port}", f"localhost:{self._port}")
        self._hosts = {*hosts, _HOST, "localhost"} if self._port == 80 else set(hosts)
        self._place = hosts[0]
        self._cookie = f"flipperctl_{self._port}"

        # viser is started behind these checks, or not at all.
        self.server = self._start(listener)
        if self._loop is None:
            with redirect_stdout(io.StringIO()):
                self.server.stop()
            listener.close()
            raise FlipperctlError(
                f"viser {viser.__version__} starts its server in a way that cannot be put behind "
                "a token; pip install 'viser==1.1.*'"
            )
        self.address = f"http://{self._place}/?token={self._token}"

    def __enter__(self) -> Gate:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    def stop(self) -> None:
        """Close all connections and the port."""
        if not self._stopped:
            self._stopped = True
            if self._loop is not None:  # a client that does not read would hold the server up
                self._loop.call_soon_threadsafe(self._loop.call_later, _PATIENCE, self._abort)
            with redirect_stdout(io.StringIO()):
                self.server.stop()

    def _abort(self) -> None:
        for connection in self._open:
            connection.transport.abort()

    def post(self, message: str | bytes, key: str | None = None, client: int | None = None) -> None:
        """Send a message to one client of the control socket, or to all; return at once.

        A pending message of the same key is replaced and the new one keeps its place, so that a
        slow client gets the newest state. Messages without a key keep their order. Any thread may
        call it.
        """
        with self._lock:
            receivers = [c for n, c in self._clients.items() if client in (None, n)]
            for receiver in receivers:
                receiver.pending[next(self._order) if key is None else key] = message

        # Clients live in the server's thread.
        if self._loop is not None:
            try:
                for receiver in receivers:
                    self._loop.call_soon_threadsafe(receiver.wake.set)
            except RuntimeError:  # the server stopped meanwhile
                return

    def _start(self, listener: socket.socket) -> viser.ViserServer:
        """Return viser's server, whose ``websockets.serve`` was replaced by one with our checks.

        viser 1.1 takes no socket, no handler and no check of requests. A proxy before it would
        leave viser's own port open to every user of this machine.
        """
        import viser
        import websockets.asyncio.server as library

        plain = library.serve

        def serve(handler: Handler, *place: Any, **options: Any) -> Any:
            if not getattr(handler, "__module__", "").startswith("viser."):
                return plain(handler, *place, **options)
            # The socket is bound already, so that viser's own place does not count.
            self._loop = asyncio.get_running_loop()
            del place
            options = {k: v for k, v in options.items() if k not in ("host", "port")}
            options["process_request"] = self._checked(options.get("process_request"))
            options |= {"sock": listener, "logger": _handshakes}
            options |= {"max_size": _FRAME, "close_timeout": _PATIENCE}
            return plain(self._routed(handler), **options)

        # A banner is printed, whatever ``verbose`` is.
        with _starting, redirect_stdout(io.StringIO()):
            library.serve = serve  # type: ignore[assignment,misc]
            try:
                host, port = listener.getsockname()
                server = viser.ViserServer(host=host, port=port, verbose=False)
            finally:
                library.serve = plain  # type: ignore[misc]
        # Any browser could ask for a public tunnel to this page.
        server.request_share_url = lambda verbose=True: None  # type: ignore[method-assign]
        return server

    def _checked(self, viser_answer: Answer | None) -> Answer:
        """Return what answers each request: None lets a handshake go on."""
        from websockets.datastructures import Headers
        from websockets.http11 import Request, Response

        def answer(connection: ServerConnection, request: Request) -> Response | None:
            # Without a token nothing is answered, whatever the path.
            path, _, query = request.path.partition("?")
            offered = parse_qs(query).get("token", ())
            upgrades = [value.lower() for value in request.headers.get_all("Upgrade")]
            handshake = upgrades == ["websocket"]
            response: Response | None
            if refusal := self._refusal(request.headers, offered):
                response = connection.respond(403, refusal + "\n")
            elif handshake and path == "/control":
                response = None if self._control else connection.respond(404, "no control here\n")
            elif handshake or viser_answer is None:
                return None
            elif path == "/" and self._page is not None:
                kind = {"Content-Type": "text/html; charset=utf-8"}
                kind["Content-Length"] = str(len(self._page))
                response = Response(200, "OK", Headers(kind), self._page)
            else:
                scene = Request("/", request.headers)
                response = viser_answer(connection, scene if path == "/scene" else request)
            if response is None:
                return None

            # Pages load nothing from elsewhere, and the cookie spares later requests the token.
            sockets = " ".join(f"ws://{host}" for host in sorted(self._hosts))
            policy = {"Content-Security-Policy": _POLICY.format(sockets)}
            response.headers.update(_HEADERS | policy)
            if offered and response.status_code != 403:
                response.headers["Set-Cookie"] = (
                    f"{self._cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/"
                )
            return response

        return answer

    def _refusal(self, headers: Any, offered: Any) -> str:
        """Return why a request is refused; empty if it is not."""
        # A foreign name that leads to this machine (DNS rebinding) is refused.
        if headers.get_all("Host") not in [[host] for host in self._hosts]:
            return f"this page is {self._place} alone; a tunnel keeps the port"
        origins = headers.get_all("Origin")
        if origins and origins not in [[f"http://{host}"] for host in self._hosts]:
            return "requests of other pages are refused"

        # The time of a comparison tells nothing of the token.
        pairs = [c.strip().partition("=") for h in headers.get_all("Cookie") for c in h.split(";")]
        tokens = [*offered, *(value for name, _, value in pairs if name == self._cookie)]
        right = self._token.encode()
        if not any(hmac.compare_digest(t.encode(errors="replace"), right) for t in tokens):
            return "the token is missing or wrong; open the address that flipperctl printed"
        return ""

    def _routed(self, viser_handler: Handler) -> Handler:
        async def handle(connection: ServerConnection) -> None:
            request = connection.request
            self._open.add(connection)
            try:
                if request is not None and request.path.partition("?")[0] == "/control":
                    await self._talk(connection)
                else:
                    await viser_handler(connection)
            finally:
                self._open.discard(connection)

        return handle

    async def _talk(self, connection: ServerConnection) -> None:
        """Serve one client of the control socket until either side closes."""
        from websockets.exceptions import ConnectionClosed

        control = self._control
        assert control is not None
        # Little may wait in the system, so that a slow client gets the newest state soon.
        peer = connection.transport.get_extra_info("socket")
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        number, client = next(self._numbers), _Client(connection)
        with self._lock:
            self._clients[number] = client

        # Whatever happens to this client, it is counted out and the others go on.
        sender = asyncio.ensure_future(self._send(client))
        code, reason = 1000, ""
        try:
            control.opened(number)
            async for message in connection:
                control.received(number, str(message))
        except ConnectionClosed:
            pass
        except ValueError:
            code, reason = _REFUSED, "this is no message of the page"
        except Exception:  # noqa: BLE001 - a fault of one client must not end the others
            _log.exception("the control of a live page failed; its client is closed")
            code, reason = _FAILED, "the server failed"
        finally:
            with self._lock:
                del self._clients[number]
            sender.cancel()
            control.closed(number)
        await connection.close(code, reason)

    async def _send(self, client: _Client) -> None:
        """Send what is pending, as fast as the client reads."""
        from websockets.exceptions import ConnectionClosed

        while True:
            await client.wake.wait()
            client.wake.clear()
            while client.pending:
                with self._lock:
                    message = client.pending.pop(next(iter(client.pending)))
                try:
                    await client.connection.send(message)
                except ConnectionClosed:
                    return


def _bind(port: int) -> socket.socket:
    """Return a socket bound to the port, or to a free one for 0."""
    listener = socket.socket()
    if os.name == "posix":  # elsewhere it would share a port that is in use
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((_HOST, port))
        listener.listen()
    except OSError as error:
        listener.close()
        raise RequestError(
            f"--port {port}: {error.strerror}; another number is allowed, or 0 for a free one"
        ) from error
    return listener
