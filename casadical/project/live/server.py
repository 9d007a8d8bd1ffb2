"""The web page of a live session: one HTML file, the state as server-sent events, commands as JSON.

It is bound to this machine. For another host its address needs a token. Requests that name another
host, and commands that another page sends, are refused (DNS rebinding, cross-site requests).
"""

from __future__ import annotations

import asyncio
import json
import secrets
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from importlib.resources import files
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from casadical.core.basics import ConvergenceError, InputError, optional
from casadical.project.live.session import LiveSession, finished
from casadical.project.live.sources import Source
from casadical.project.live.view import answer

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

# Hosts that are this machine itself: no token is needed.
LOOPBACK_HOSTS = ("127.0.0.1", "localhost", "::1")
# Time between two looks at a source for new readings [s].
POLL_INTERVAL_S = 0.2
SECURITY_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-store", "Referrer-Policy": "no-referrer", "X-Content-Type-Options": "nosniff",
}  # fmt: skip
INSTALL_HINT = "the page needs starlette, uvicorn and sse-starlette: pip install 'casadical[live]', or --no-page"


class LivePage:
    """The server of one session.

    session : session that is shown
    source : source of readings; None: readings are typed alone
    pause : time between two looks at the source [s]
    token : token that requests must carry; None on the loopback
    """

    def __init__(self, session: LiveSession, source: Source | None, pause: float, token: str | None) -> None:
        self.session, self.source, self.pause, self.token = session, source, pause, token
        self._version, self._changed = 0, asyncio.Event()
        self.finished = ""
        self._tasks: set[asyncio.Task[None]] = set()

    def app(self) -> Starlette:
        """Return the web application. Raises InputError without the extra `live`."""
        applications = optional("starlette.applications", INSTALL_HINT)
        routing, middleware = (
            optional("starlette.routing", INSTALL_HINT),
            optional("starlette.middleware", INSTALL_HINT),
        )
        base = optional("starlette.middleware.base", INSTALL_HINT)
        routes = [
            routing.Route("/", self._page),
            routing.Route("/events", self._events),
            routing.Route("/do", self._do, methods=["POST"]),
        ]
        guard = middleware.Middleware(base.BaseHTTPMiddleware, dispatch=self._guarded)
        made: Starlette = applications.Starlette(routes=routes, middleware=[guard], lifespan=self._life)
        return made

    @asynccontextmanager
    async def _life(self, _app: Starlette) -> AsyncIterator[None]:
        """Follow the source for as long as the application runs."""
        follow = asyncio.create_task(self._follow())
        yield
        follow.cancel()
        with suppress(asyncio.CancelledError):
            await follow

    async def _follow(self) -> None:
        """Plan, and take new readings from the source, again and again."""
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
                self.session.said.append(f"this is a bug in casadical, and the readings are kept: {error!r}")
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
        """Let all open pages get the new state."""
        self._version += 1
        self._changed.set()
        self._changed = asyncio.Event()

    async def _guarded(self, request: Request, call: Callable[[Request], Any]) -> Response:
        """Refuse requests of other hosts, of other pages, and with a wrong token."""
        responses = optional("starlette.responses", INSTALL_HINT)
        host = request.headers.get("host", "")
        why = ""
        if self.token is None and urlsplit(f"//{host}").hostname not in LOOPBACK_HOSTS:
            why = "this page is for the machine that it runs on: casadical measure --host ADDRESS gives it to others"
        given = request.query_params.get("token") or request.cookies.get("token", "")
        if self.token is not None and not secrets.compare_digest(given.encode(), self.token.encode()):
            why = "the address of this page ends with ?token=..., as casadical measure printed it; open that one"
        origin = request.headers.get("origin")
        if request.method == "POST" and origin is not None and urlsplit(origin).netloc != host:
            why = "another page sent this command"
        if why:
            refused: Response = responses.PlainTextResponse(why, 403, SECURITY_HEADERS)
            return refused
        response: Response = await call(request)
        response.headers.update(SECURITY_HEADERS)
        if self.token is not None:
            response.set_cookie("token", self.token, httponly=True, samesite="strict")
        return response

    async def _page(self, _request: Request) -> Response:
        """Return the HTML file."""
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
        """Yield the state now and after each change; a slow reader gets the last one."""
        while True:
            changed = self._changed
            state = await asyncio.to_thread(self.session.state)
            yield {"data": json.dumps(state | {"finished": self.finished})}
            await changed.wait()

    async def _do(self, request: Request) -> Response:
        """Carry out one command: type, strike, restore, repeat or finish; faults are sentences."""
        json_response = optional("starlette.responses", INSTALL_HINT).JSONResponse
        response: Response
        try:
            body = await request.body()
            asked = json.loads(body) if len(body) < 100_000 else None
            if not isinstance(asked, dict):
                raise InputError("a command is a JSON object of less than 100,000 characters")
            said = await asyncio.to_thread(self._done, asked)
            response = json_response({"said": said})
        except (InputError, ConvergenceError, ValueError, KeyError, TypeError) as error:
            response = json_response({"error": str(error)}, 400)
        else:
            await self._plan()
        return response

    def _done(self, asked: dict[str, Any]) -> str:
        """Carry out a command on the session and return its answer. Raises InputError."""
        session, do = self.session, asked.get("do")
        if do == "type":
            number = session.type_in({str(name): str(value) for name, value in asked["values"].items()})
            return answer(session.state(), number) if number else "this reading is there already"
        if do == "finish":
            self.finished = finished(session)
            return self.finished
        if do == "strike":
            session.strike(asked["number"], str(asked["why"]))
        elif do in ("restore", "repeat"):
            (session.restore if do == "restore" else session.repeat)(asked["number"])
        else:
            raise InputError(f"{do!r}: is no command; allowed: type, strike, restore, repeat, finish")
        return ""


def bound(host: str, port: int) -> socket.socket:
    """Return a socket that listens at this address; port 0 is any free one.

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
    pause : time between two looks at the source [s]
    Raises InputError.
    """
    uvicorn = optional("uvicorn", INSTALL_HINT)
    token = None if host in LOOPBACK_HOSTS else secrets.token_urlsafe(16)
    page = LivePage(session, source, pause, token)
    app = page.app()
    with bound(host, port) as opened:
        at = f"[{host}]" if ":" in host else host
        show(f"open http://{at}:{opened.getsockname()[1]}/{f'?token={token}' if token else ''}")
        settings = uvicorn.Config(app, log_level="warning", timeout_graceful_shutdown=1, ws="none")
        with suppress(KeyboardInterrupt):
            uvicorn.Server(settings).run(sockets=[opened])
