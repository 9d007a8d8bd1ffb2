"""The page beside the instrument: for this machine alone, commands with sentences, alive after a kill, on a phone."""

import asyncio
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import fuzz_page
import pytest

from casadical.core.basics import InputError
from casadical.project.live import LiveSession
from casadical.project.live.server import MAX_CONNECTIONS, REQUEST_TIMEOUT_S, LivePage, bound
from casadical.project.live.sources import journal

ROOT = Path(__file__).parents[3]

TOKEN = fuzz_page.TOKEN
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    return fuzz_page.planar_folder(tmp_path)


@contextmanager
def client(folder: Path) -> Iterator:
    """A client of the page of a session with eight simulated readings; it has the token."""
    testing = pytest.importorskip("starlette.testclient", reason="starlette is not installed: no page was served")
    address = "http://127.0.0.1:8000"
    with fuzz_page.page_with_readings(folder) as page, testing.TestClient(page.app(), base_url=address) as found:
        found.params = {"token": TOKEN}
        yield page.session, found


def test_commands_are_answered_in_sentences(arm: Path) -> None:
    with client(arm) as (session, page):
        assert "casadical measure" in page.get("/").text
        assert "script-src 'unsafe-inline'" in page.get("/").headers["content-security-policy"]

        def do(**asked: object) -> tuple[int, str]:
            told = page.post("/do", json=asked)
            return told.status_code, next(iter(told.json().values()))

        assert do(do="strike", number=2, why="<img src=x>") == (200, "")
        assert session.course.reading(2).struck == "<img src=x>"
        assert do(do="restore", number=2) == (200, "")
        assert do(do="repeat", number=1)[0] == 200
        assert session.state()["next"]["poses"][0] == session.state()["readings"][0]["joints"]
        assert do(do="strike", number=99, why="x") == (400, "there is no reading 99; the last is 8")
        assert do(do="strike", number=2, why="")[0] == 400
        assert do(do="fly")[1].startswith("'fly': is no command")
        assert do(do="type", values={"q1_deg": "1"})[0] == 400
        assert page.post("/do", content="[" * 200_000).status_code == 413
        values = dict.fromkeys(session.fields, 0.0) | {"x_mm": 900.0}
        assert do(do="type", values=values)[1].startswith("9: DOUBTFUL")
        # The stretched arm reaches 700 mm.
        assert session.state()["readings"][8]["off_mm"] == pytest.approx(200, abs=1)
        code, said = do(do="finish")
        assert (code, "wrote" in said) == (200, True), said
        assert (arm / "results/KM.robot.toml").exists()


def test_other_users_and_other_pages_are_refused(arm: Path) -> None:
    with client(arm) as (session, page):
        other = page.post("/do", json={"do": "repeat", "number": 1}, headers={"origin": "http://evil.example"})
        assert (other.status_code, other.text) == (403, "another page sent this command")
        for origin in ("http://[", "null", "\xff"):
            assert page.get("/", headers={"origin": origin.encode("latin-1")}).status_code == 403
        assert page.get("/", headers={"host": "["}).status_code == 200
        for wrong in ("", "wrong", "\xe4", TOKEN[:-1]):
            page.params = {"token": wrong}
            for path in ("/", "/events", "/nothing"):
                refused = page.get(path)
                assert (refused.status_code, "?token=" in refused.text) == (403, True)
            strike = page.post("/do", json={"do": "strike", "number": 1, "why": "x"})
            assert strike.status_code == 403
        assert not any(r.struck for r in session.course.readings)
        with bound("127.0.0.1", 0) as taken, pytest.raises(InputError, match="in use; without --port a free one"):
            bound("127.0.0.1", taken.getsockname()[1])


def test_a_long_body_is_refused_before_it_is_read(arm: Path) -> None:
    """Endless chunks: the server stops taking them soon after the longest command's length."""
    sent = 0

    async def asked(app: Callable[..., Any]) -> list[dict[str, Any]]:
        answers: list[dict[str, Any]] = []

        async def receive() -> dict[str, Any]:
            nonlocal sent
            sent += 10_000
            return {"type": "http.request", "body": b" " * 10_000, "more_body": True}

        async def send(message: dict[str, Any]) -> None:
            answers.append(message)

        scope = {
            "type": "http", "method": "POST", "path": "/do", "raw_path": b"/do", "headers": [], "http_version": "1.1",
            "query_string": f"token={TOKEN}".encode(), "root_path": "", "scheme": "http", "server": ("127.0.0.1", 1),
        }  # fmt: skip
        await app(scope, receive, send)
        return answers

    with journal(arm) as (course, add):
        page = LivePage(LiveSession(arm, course, add, data="synthetic"), None, 0.01, TOKEN)
        answers = asyncio.run(asked(page.app()))
    assert answers[0]["status"] == 413
    assert b"at most 100000 bytes" in answers[1]["body"]
    assert sent <= 120_000


HOSTILE_BODIES = (
    b"", b"{", b"[]", b"null", b"\xff", b"[" * 15_000, b'{"a":' * 15_000, b'{"do": "type"}', b'{"do": ["type"]}',
    b'{"do": "type", "values": [1]}', b'{"do": "type", "values": "x"}', b'{"do": "type", "values": null}',
    b'{"do": "strike", "number": "1", "why": "x"}', b'{"do": "strike", "number": true, "why": "x"}',
    b'{"do": "strike", "number": 1.0, "why": "x"}', b'{"do": "repeat", "number": -1}', b'{"do": "repeat"}',
    b'{"do": "strike", "number": 1, "why": "\\ud800"}', b'{"do": "strike", "number": 1, "why": [1]}',
    b'{"do": "repeat", "number": 1' + b"0" * 5000 + b"}",
)  # fmt: skip


def test_a_request_of_any_shape_is_answered_in_a_sentence(arm: Path) -> None:
    with client(arm) as (_, page):
        for body in HOSTILE_BODIES:
            answer = page.post("/do", content=body)
            why = answer.json()["error"]
            assert (answer.status_code, why != "", "sys." in why) == (400, True, False), body
        for path in ("/do/", "//", "/%00"):
            answer = page.post(path, json={"do": "repeat", "number": 1}, follow_redirects=False)
            assert (answer.status_code, "is not served" in answer.text) == (404, True)
    assert fuzz_page.run(200)[400] > 50


def started(folder: Path, source: Path) -> tuple[subprocess.Popen[str], str]:
    """The command as a process of its own, and the address that it prints."""
    program = "from casadical.cli import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", program, "measure", folder, "--follow", source], stdout=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("open http"):
            return process, line.split()[1]
    raise AssertionError("no address")


@pytest.mark.slow
def test_no_port_is_open_beyond_loopback_and_none_is_blocked(arm: Path) -> None:
    """All that the command listens on, whatever it serves; half-open connections end."""
    psutil = pytest.importorskip("psutil", reason="psutil is not installed: ports were not listed")
    process, address = started(arm, ROOT / "data/planar/planar.csv")
    own = psutil.Process(process.pid)
    asked = [c for p in (own, *own.children(recursive=True)) for c in p.net_connections("inet")]
    at = "127.0.0.1", urlsplit(address).port
    half = socket.create_connection(at)  # its second request stays without an end
    half.sendall(b"GET / HTTP/1.1\r\nhost: x\r\n\r\nGET / HTTP/1.1\r\n")
    idle = [half, *(socket.create_connection(at) for _ in range(MAX_CONNECTIONS + 50))]
    begin, ended = time.monotonic(), []
    for connection in reversed(idle):
        connection.settimeout(4 * REQUEST_TIMEOUT_S)
        while connection.recv(1000):
            pass
        ended.append(time.monotonic() - begin)
        connection.close()
    assert ended[40] < REQUEST_TIMEOUT_S / 2, "connections beyond the greatest number are closed at once"
    process.kill()
    process.communicate()
    assert {c.laddr.ip for c in asked if c.status == psutil.CONN_LISTEN} == {"127.0.0.1"}


@pytest.mark.slow
def test_a_browser_sees_what_comes_and_a_kill_loses_nothing(arm: Path, tmp_path: Path) -> None:
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: no page was opened")
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine: no page was opened")
    rows = (ROOT / "data/planar/planar.csv").read_text().splitlines()
    table = tmp_path / "tracker.csv"
    table.write_text("\n".join(rows[:9]) + "\n")
    process, address = started(arm, table)
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-dev-shm-usage"])
        page = browser.new_page(viewport={"width": 400, "height": 850})
        page.set_default_timeout(60_000)
        faults: list[str] = []
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto(address)
        page.wait_for_selector("#readings tr:nth-child(8)", state="attached")
        with table.open("a") as file:
            file.write("0,0,1,1,1\n" + rows[9])  # the second one is half written
        page.wait_for_selector("#last.doubtful")
        assert page.inner_text("#verdict").startswith("9: Doubtful")
        assert page.evaluate("() => document.documentElement.scrollWidth") == 400
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        table.unlink()
        again, address = started(arm, table)
        page.goto(address)
        page.wait_for_selector("#readings tr:nth-child(10)", state="attached")  # the doubtful one has two
        assert faults == []
        browser.close()
    again.send_signal(signal.SIGINT)
    begin = time.monotonic()
    assert again.wait(30) == 0, time.monotonic() - begin
    again.stdout.close()
