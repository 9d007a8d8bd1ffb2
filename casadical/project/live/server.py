"""The web page of a live session: one HTML file, the state as server-sent events, commands as JSON.

Every request carries a token in its address, which only the printed link holds: other users of this
machine, other machines and other pages are refused. A request is answered with what it asked for,
or with 400, 403, 404 or 413 and a sentence.
"""

from __future__ import annotations

import asyncio
import json
import secrets
import socket
from collections.abc import AsyncIterator, Callable, MutableMapping
from contextlib import asynccontextmanager, suppress
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from casadical.core.basics import ConvergenceError, InputError, optional, shown
from casadical.project.live.session import LiveSession, finished
from casadical.project.live.sources import POLL_INTERVAL_S, Source
from casadical.project.live.view import answer

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

# Time within which a client must send its request, headers and body each [s].
REQUEST_TIMEOUT_S = 10.0
# Maximum number of open connections: far fewer than the files that a process may open.
MAX_CONNECTIONS = 100
# Maximum length of a command from the page [bytes].
MAX_COMMAND_BYTES = 100_000
# Message where the packages of the web page are not installed.
INSTALL_HINT = "the page needs starlette, uvicorn and sse-starlette: pip install 'casadical[live]', or --no-page"


class LivePage:
    """The server of one session.

    session : session that is shown
    source : source of readings; None: readings are typed alone
    pause : time between two queries of the source [s]
    token : token that the address of every request must have
    """

    def __init__(self, session: LiveSession, source: Source | None, pause: float, token: str) -> None:
        self.session, self.source, self.pause, self.token = session, source, pause, token
        self._version, self._changed = 0, asyncio.Event()
        self.finished = ""
        self._tasks: set[asyncio.Task[None]] = set()

    def app(self) -> Callable[..., Any]:
        """Return the ASGI application that serves the page, its events and its commands.

        Raises InputError without the extra `live`.
        """
        applications = optional("starlette.applications", INSTALL_HINT)
        routing = optional("starlette.routing", INSTALL_HINT)
        routes = [
            routing.Route("/", self._page, methods=["GET"]),
            routing.Route("/events", self._events, methods=["GET"]),
            routing.Route("/do", self._do, methods=["POST"]),
        ]
        unknown = dict.fromkeys((404, 405), self._unknown)
        pages = applications.Starlette(routes=routes, exception_handlers=unknown, lifespan=self._life)
        pages.router.redirect_slashes = False  # /do/ is not served, as any other address

        security_headers = {
            "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
            "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
        }

        async def guarded(scope: MutableMapping[str, Any], receive: Any, send: Any) -> None:
            """Answer an ASGI request: refuse it, or pass it to the pages, with security headers."""
            if scope["type"] != "http":
                await pages(scope, receive, send)
                return

            async def send_with_headers(message: MutableMapping[str, Any]) -> None:
                """Send a message of the answer, its start with security headers added."""
                if message["type"] == "http.response.start":
                    own = [(name.encode(), text.encode()) for name, text in security_headers.items()]
                    message["headers"] = [*message.get("headers", ()), *own]
                await send(message)

            refused = self._refused(optional("starlette.requests", INSTALL_HINT).Request(scope))
            await (refused or pages)(scope, receive, send_with_headers)

        return guarded

    @asynccontextmanager
    async def _life(self, _app: Starlette) -> AsyncIterator[None]:
        """Read the source in the background for as long as the application runs."""
        follow = asyncio.create_task(self._follow())
        yield
        follow.cancel()
        with suppress(asyncio.CancelledError):
            await follow

    async def _follow(self) -> None:
        """Plan poses, and take new readings from the source, until cancelled."""
        while True:
            try:
                if self.session.plan is None:
                    await self._plan()
                if self.source is not None:
                    numbers, said = await asyncio.to_thread(self.session.feed, self.source)
                    if numbers or said:
                        self._tell()
                    if numbers:
                        await self._plan()
            except Exception as error:  # a bug must not end what keeps the readings
                self.session.said.append(f"this is a bug in casadical, and the readings are stored: {error!r}")
                self._tell()
            await asyncio.sleep(self.pause)

    async def _plan(self) -> None:
        """Plan the next poses; the check of the whole table, if due, runs in the background."""
        if self.session.doubted():
            task = asyncio.create_task(self._check())
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        await asyncio.to_thread(self.session.look_ahead)
        self._tell()

    async def _check(self) -> None:
        """Check the whole table in a thread, then send the new state."""
        await asyncio.to_thread(self.session.check)
        self._tell()

    def _tell(self) -> None:
        """Notify all open pages of a new state, which they then receive."""
        self._version += 1
        self._changed.set()
        self._changed = asyncio.Event()

    def _refused(self, request: Request) -> Response | None:
        """Return the refusal of a request without the token or from another page, else None."""
        given = request.query_params.get("token", "")
        origin = request.headers.get("origin")
        if not secrets.compare_digest(given.encode(), self.token.encode()):
            why = "the address of this page ends with ?token=..., as casadical measure printed it; open that one"
        elif origin is not None and origin.partition("://")[2] != request.headers.get("host"):
            why = "another page sent this command"
        else:
            return None
        refused: Response = optional("starlette.responses", INSTALL_HINT).PlainTextResponse(why, 403)
        return refused

    async def _unknown(self, request: Request, _error: Exception) -> Response:
        """Return the answer 404, with a sentence, to a request for something that is not served."""
        why = f"{request.method} {request.url.path}: is not served; GET /, GET /events and POST /do are"
        made: Response = optional("starlette.responses", INSTALL_HINT).PlainTextResponse(why, 404)
        return made

    async def _page(self, _request: Request) -> Response:
        """Return the page itself, an HTML file."""
        page = files("casadical.project.live").joinpath("page.html").read_text(encoding="utf-8")
        made: Response = optional("starlette.responses", INSTALL_HINT).HTMLResponse(page)
        return made

    async def _events(self, _request: Request) -> Response:
        """Return the stream of states as server-sent events."""
        made: Response = optional("sse_starlette", INSTALL_HINT).EventSourceResponse(
            # The connection to a browser that does not read for 20 s is closed.
            self._states(),
            ping=10,
            send_timeout=20.0,
        )
        return made

    async def _states(self) -> AsyncIterator[dict[str, str]]:
        """Yield the session's state as an event, now and after each change.

        A slow reader skips states and gets the latest.
        """
        while True:
            changed = self._changed
            state = await asyncio.to_thread(self.session.state)
            yield {"data": json.dumps(state | {"finished": self.finished})}
            await changed.wait()

    async def _do(self, request: Request) -> Response:
        """Execute the command in a request (type, strike, restore, repeat, finish), and answer.

        The answer is JSON: `said`, or `error` with a sentence.
        """
        json_response = optional("starlette.responses", INSTALL_HINT).JSONResponse
        response: Response
        try:
            body = await asyncio.wait_for(_body(request), REQUEST_TIMEOUT_S)
            if body is None:
                why = f"a command has at most {MAX_COMMAND_BYTES} bytes"
                return json_response({"error": why}, 413, {"Connection": "close"})  # type: ignore[no-any-return]
            said = await asyncio.to_thread(self._done, _command(body))
            response = json_response({"said": said})
        except (InputError, ConvergenceError, TimeoutError) as error:
            why = str(error) or f"the command did not arrive within {REQUEST_TIMEOUT_S:.0f} s"
            response = json_response({"error": why}, 400)
        else:
            await self._plan()
        return response

    def _done(self, asked: dict[str, Any]) -> str:
        """Execute a command on the session and return its answer as text. Raises InputError."""
        session, do = self.session, asked.get("do")
        if do == "type":
            values = asked.get("values")
            if not isinstance(values, dict):
                raise InputError("type: give the reading as an object, values = {column: cell}")
            number = session.type_in({name: str(value) for name, value in values.items()})
            return answer(session.state(), number) if number else "this reading is there already"
        if do == "finish":
            self.finished = finished(session)
            return self.finished
        if do not in ("strike", "restore", "repeat"):
            raise InputError(f"{shown(repr(do))}: is no command; allowed: type, strike, restore, repeat, finish")
        number = asked.get("number")
        if not isinstance(number, int) or isinstance(number, bool):
            raise InputError(f"{do}: give the number of a reading, a whole number")
        if do == "strike":
            why = asked.get("why", "")
            session.strike(number, why if isinstance(why, str) else "")
        else:
            (session.restore if do == "restore" else session.repeat)(number)
        return ""


async def _body(request: Request) -> bytes | None:
    """Return the body of a request, None where it is longer than a command may be.

    No more than the longest command is ever in memory. Raises InputError where the client went away.
    """
    body = b""
    try:
        async for chunk in request.stream():
            body += chunk
            if len(body) > MAX_COMMAND_BYTES:
                return None
    except optional("starlette.requests", INSTALL_HINT).ClientDisconnect:
        raise InputError("the client went away before its command had come") from None
    return body


def _command(body: bytes) -> dict[str, Any]:
    """Return the JSON object in the body of a request, with `do` and its values."""
    try:
        asked = json.loads(body)
        json.dumps(asked, ensure_ascii=False).encode()  # no file can hold lone surrogates
    except (RecursionError, ValueError):
        asked = None
    if not isinstance(asked, dict):
        raise InputError("a command is a JSON object of a few plain values")
    return asked


def bound(host: str, port: int) -> socket.socket:
    """Return a TCP socket that listens at this address; port 0 means any free port.

    Raises InputError where the port is taken.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    made = socket.socket(family, socket.SOCK_STREAM)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # of a server just ended
    try:
        made.bind((host, port))
        made.listen()
    except OSError as error:
        made.close()
        raise InputError(
            f"--host {host} --port {port}: {error.strerror or error}; without --port a free one is taken"
        ) from None
    return made


def serve(
    session: LiveSession,
    source: Source | None,
    show: Callable[[str], None],
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    pause: float = POLL_INTERVAL_S,
) -> None:
    """Serve the page of a session until the process is interrupted.

    source : source of readings; None: readings are typed alone
    show : called with the address of the page
    host, port : address to listen at; port 0: any free one
    pause : time between two queries of the source [s]
    Raises InputError where packages are missing or the port is taken.
    """
    uvicorn = optional("uvicorn", INSTALL_HINT)
    token = secrets.token_urlsafe(16)
    app = LivePage(session, source, pause, token).app()
    protocol = optional("uvicorn.protocols.http.h11_impl", INSTALL_HINT).H11Protocol

    class Protocol(protocol):  # type: ignore[misc, valid-type]
        """HTTP of one connection, which is closed if no request comes within `REQUEST_TIMEOUT_S`."""

        def connection_made(self, transport: asyncio.Transport) -> None:
            """Close a connection above `MAX_CONNECTIONS`, and check later that a request came."""
            super().connection_made(transport)
            if len(self.connections) > MAX_CONNECTIONS:
                transport.close()
            self.loop.call_later(REQUEST_TIMEOUT_S, self._close_without_request, None)

        def _close_without_request(self, last: Any) -> None:
            """Close the connection if its last request is answered and no other one has come whole."""
            if self.cycle is last and (last is None or last.response_complete):
                self.transport.close()
            elif not self.transport.is_closing():
                self.loop.call_later(REQUEST_TIMEOUT_S, self._close_without_request, self.cycle)

    with bound(host, port) as opened:
        at = f"[{host}]" if ":" in host else host
        show(f"open http://{at}:{opened.getsockname()[1]}/?token={token}")
        settings = uvicorn.Config(app, http=Protocol, log_level="warning", timeout_graceful_shutdown=1, ws="none")
        with suppress(KeyboardInterrupt):
            uvicorn.Server(settings).run(sockets=[opened])
