"""Requests of any shape to the page of `casadical measure`.

hypothesis draws a request and hands it to the ASGI application as a server would: method, path, query, headers and
body in bytes, the body in chunks, the client gone before its end. What must hold of each:

- the application raises nothing; the status is 200, 400, 403, 404 or 413, and the answer holds a sentence
- without the token the status is 403, and the session is as it was
- after all of them the session answers a plain command, and its journal can be read again

The long form: python -c "import fuzz_page; print(fuzz_page.run(20_000))", in this folder.
"""

from __future__ import annotations

import asyncio
import json
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from casadical.project.live import LiveSession
from casadical.project.live.server import LivePage
from casadical.project.live.sources import SimulatedSource, journal

ROOT = Path(__file__).parents[3]
TOKEN = "token"

JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)
PIECES = st.sampled_from([b"[" * 15_000, b'{"a":' * 15_000, b" " * 60_000, b'"\\ud800"', b"\x00", b"\xff", b"1e999"])


def mostly(usual: Any, others: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """Return a strategy that draws the usual value nine times of ten, so that most requests reach a command."""
    return st.integers(0, 9).flatmap(lambda k: others if k == 0 else st.just(usual))


def requests(fields: tuple[str, ...]) -> st.SearchStrategy[dict[str, Any]]:
    """Return a strategy of requests, each with method, path, query, headers, chunks and whether the client goes."""
    commands = st.fixed_dictionaries(
        {"do": st.sampled_from(["type", "strike", "restore", "repeat", "fly"])},
        optional={
            "number": st.integers(-1, 9) | JSON_VALUES,
            "why": st.text(max_size=20) | JSON_VALUES,
            "values": st.dictionaries(st.sampled_from(fields) | st.text(max_size=5), JSON_VALUES, max_size=6)
            | JSON_VALUES,
        },
    )
    bodies = (commands | JSON_VALUES).map(lambda value: [json.dumps(value).encode()])
    header_names = st.sampled_from([b"host", b"origin", b"content-length", b"content-type", b"cookie", b"range"])
    return st.fixed_dictionaries(
        {
            "method": mostly("POST", st.sampled_from(["GET", "PUT", "DELETE", "OPTIONS", "HEAD", "BREW", ""])),
            "path": mostly("/do", st.sampled_from(["/", "//", "/do/", "/../do", "/\x00"]) | st.text(max_size=12)),
            "query": mostly(
                f"token={TOKEN}".encode(),
                st.sampled_from([b"", b"token", b"token=", b"token=a&token=b", b"%", b"token=%ff"])
                | st.binary(max_size=20),
            ),
            "headers": st.lists(st.tuples(header_names, st.binary(max_size=20) | PIECES), max_size=4),
            "chunks": bodies | bodies | st.lists(st.binary(max_size=50) | PIECES, max_size=4),
            "gone": st.sampled_from([False] * 4 + [True]),
        }
    )


async def answer_of(app: Any, request: dict[str, Any]) -> tuple[int, bytes]:
    """Return status and body of the application's answer to a request; 0 where the client had gone before it."""
    chunks, answers = list(request["chunks"]), []

    async def receive() -> dict[str, Any]:
        if chunks:
            more = len(chunks) > 1 or request["gone"]
            return {"type": "http.request", "body": chunks.pop(0), "more_body": more}
        if request["gone"]:
            return {"type": "http.disconnect"}
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: dict[str, Any]) -> None:
        answers.append(message)

    path = request["path"] if request["path"].startswith("/") else "/" + request["path"]
    scope = {
        "type": "http", "http_version": "1.1", "scheme": "http", "server": ("127.0.0.1", 1), "root_path": "",
        "method": request["method"], "path": path, "raw_path": quote(path, errors="replace").encode(),
        "query_string": request["query"], "headers": request["headers"],
    }  # fmt: skip
    await asyncio.wait_for(app(scope, receive, send), 20)
    return answers[0]["status"] if answers else 0, b"".join(m.get("body", b"") for m in answers[1:])


def planar_folder(parent: Path) -> Path:
    """Return a new problem folder of the planar arm, without measurements."""
    folder = parent / "arm"
    folder.mkdir()
    shutil.copy(ROOT / "problems/planar/robot.toml", folder)
    (folder / "problem.toml").write_text('casadical = 1\ntitle = "t"\nmethods = ["KM"]\n')
    return folder


@contextmanager
def page_with_readings(folder: Path) -> Iterator[LivePage]:
    """Yield the page of a session of this folder with eight simulated readings."""
    with journal(folder) as (course, add):
        session = LiveSession(folder, course, add, data="synthetic")
        source = SimulatedSource(session.robot, session.next_pose, 8)
        while not source.ended:
            session.feed(source)
            session.look_ahead()
        yield LivePage(session, None, 0.01, TOKEN)


def run(n_requests: int) -> Counter[int]:
    """Send requests to the page; return how often each status came.

    Raises AssertionError for the first request that breaks a rule.
    """
    statuses: Counter[int] = Counter()
    with tempfile.TemporaryDirectory() as scratch:
        folder = planar_folder(Path(scratch))
        with page_with_readings(folder) as page:
            app, course, fields = page.app(), page.session.course, page.session.fields

            @settings(
                max_examples=n_requests,
                database=None,
                deadline=None,
                derandomize=True,
                phases=(Phase.generate,),
                suppress_health_check=list(HealthCheck),
            )
            @given(requests((*fields, "x_m", "")))
            def send(request: dict[str, Any]) -> None:
                entries = len(course.readings), [r.struck for r in course.readings]
                if request["path"] == "/events" and request["method"] == "GET":
                    return  # a stream without end, which its own tests read
                status, body = asyncio.run(answer_of(app, request))
                statuses[status] += 1
                assert status in (200, 400, 403, 404, 413), (status, body, request)
                assert body or request["method"] == "HEAD", (status, request)
                if f"token={TOKEN}".encode() not in request["query"]:
                    assert status == 403, (status, request)
                    assert entries == (len(course.readings), [r.struck for r in course.readings])

            send()
            plain = {"method": "POST", "path": "/do", "query": f"token={TOKEN}".encode(), "headers": [], "gone": False}
            for do in ("restore", "repeat"):  # a request may have struck it
                command = [json.dumps({"do": do, "number": 1}).encode()]
                status, body = asyncio.run(answer_of(app, plain | {"chunks": command}))
            assert status == 200, body
        with journal(folder) as (course, add):
            LiveSession(folder, course, add, data="synthetic")
    return statuses
