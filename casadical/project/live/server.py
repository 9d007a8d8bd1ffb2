"""The page beside the instrument: one HTML file, the session's state as server-sent events, commands as JSON.

It is bound to this machine. Another host needs a token in its address; requests that name another host, and commands
that another page sends, are refused (DNS rebinding, cross-site requests).
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

LOOPBACK = ("127.0.0.1", "localhost", "::1")
# How often a source is looked at, and after how long a browser that never reads is given up [s].
PAUSE = 0.2
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-store", "Referrer-Policy": "no-referrer", "X-Content-Type-Options": "nosniff",
}  # fmt: skip
NEEDED = "the page needs starlette, uvicorn and sse-starlette: pip install 'casadical[live]', or --no-page"


class LivePage:
    """The server of one session.

    source : None: readings are typed alone; pause : between looks at it [s]; token : None on the loopback
    """

    def __init__(self, session: LiveSession, source: Source | None, pause: float, token: str | None) -> None:
        self.session, self.source, self.pause, self.token = session, source, pause, token
        self._version, self._changed = 0, asyncio.Event()
        self.finished = ""
        self._tasks: set[asyncio.Task[None]] = set()

    def app(self) -> Starlette:
        """The application. Raises InputError where the extra `live` is not installed."""
        applications = optional("starlette.applications", NEEDED)
        routing, middleware = optional("starlette.routing", NEEDED), optional("starlette.middleware", NEEDED)
        base = optional("starlette.middleware.base", NEEDED)
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
        follow = asyncio.create_task(self._follow())
        yield
        follow.cancel()
        with suppress(asyncio.CancelledError):
            await follow

    async def _follow(self) -> None:
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
        """The next poses and, now and then, the check of the whole table beside what goes on."""
        if self.session.doubted():
            task = asyncio.create_task(self._check())
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        await asyncio.to_thread(self.session.look_ahead)
        self._tell()

    async def _check(self) -> None:
        await asyncio.to_thread(self.session.check)
        self._tell()

    def _tell(self) -> None:
        self._version += 1
        self._changed.set()
        self._changed = asyncio.Event()

    async def _guarded(self, request: Request, call: Callable[[Request], Any]) -> Response:
        """Refuse other hosts, other pages and a wrong token."""
        responses = optional("starlette.responses", NEEDED)
        host = request.headers.get("host", "")
        why = ""
        if self.token is None and urlsplit(f"//{host}").hostname not in LOOPBACK:
            why = "this page is for the machine that it runs on: casadical measure --host ADDRESS gives it to others"
        given = request.query_params.get("token") or request.cookies.get("token", "")
        if self.token is not None and not secrets.compare_digest(given.encode(), self.token.encode()):
            why = "the address of this page ends with ?token=..., as casadical measure printed it; open that one"
        origin = request.headers.get("origin")
        if request.method == "POST" and origin is not None and urlsplit(origin).netloc != host:
            why = "another page sent this command"
        if why:
            refused: Response = responses.PlainTextResponse(why, 403, HEADERS)
            return refused
        response: Response = await call(request)
        response.headers.update(HEADERS)
        if self.token is not None:
            response.set_cookie("token", self.token, httponly=True, samesite="strict")
        return response

    async def _page(self, _request: Request) -> Response:
        page = files("casadical.project.live").joinpath("page.html").read_text(encoding="utf-8")
        made: Response = optional("starlette.responses", NEEDED).HTMLResponse(page)
        return made

    async def _events(self, _request: Request) -> Response:
        made: Response = optional("sse_starlette", NEEDED).EventSourceResponse(
            # A browser that does not read for 20 s is given up.
            self._states(),
            ping=10,
            send_timeout=20.0,
        )
        return made

    async def _states(self) -> AsyncIterator[dict[str, str]]:
        """The state now and after each change; who reads slowly gets the last one."""
        while True:
            changed = self._changed
            state = await asyncio.to_thread(self.session.state)
            yield {"data": json.dumps(state | {"finished": self.finished})}
            await changed.wait()

    async def _do(self, request: Request) -> Response:
        """One command: type, strike, restore, repeat or finish. Its faults are sentences."""
        json_response = optional("starlette.responses", NEEDED).JSONResponse
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
    """A socket that listens at this address; port 0: any that is free. Raises InputError where it is taken."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    made = socket.socket(family, socket.SOCK_STREAM)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # of one that has just ended
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
    pause: float = PAUSE,
) -> None:
    """Serve the page until the process is interrupted; show : gets its address. Raises InputError."""
    uvicorn = optional("uvicorn", NEEDED)
    token = None if host in LOOPBACK else secrets.token_urlsafe(16)
    page = LivePage(session, source, pause, token)
    app = page.app()
    with bound(host, port) as opened:
        at = f"[{host}]" if ":" in host else host
        show(f"open http://{at}:{opened.getsockname()[1]}/{f'?token={token}' if token else ''}")
        settings = uvicorn.Config(app, log_level="warning", timeout_graceful_shutdown=1, ws="none")
        with suppress(KeyboardInterrupt):
            uvicorn.Server(settings).run(sockets=[opened])
