"""The page beside the instrument: for this machine alone, commands with sentences, alive after a kill, on a phone."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from casadical.core.basics import InputError
from casadical.project.live import LiveSession
from casadical.project.live.server import LivePage, bound
from casadical.project.live.sources import SimulatedSource, journal

ROOT = Path(__file__).parents[3]
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    folder = tmp_path / "arm"
    folder.mkdir()
    shutil.copy(ROOT / "problems/planar/robot.toml", folder)
    (folder / "problem.toml").write_text('casadical = 1\ntitle = "t"\nmethods = ["KM"]\n')
    return folder


@contextmanager
def client(folder: Path, token: str | None = None, host: str = "127.0.0.1") -> Iterator:
    """A client of the page of a session with eight simulated readings."""
    testing = pytest.importorskip("starlette.testclient", reason="starlette is not installed: no page was served")
    with journal(folder) as (course, add):
        session = LiveSession(folder, course, add, data="synthetic")
        source = SimulatedSource(session.robot, session.next_pose, 8)
        while not source.ended:
            session.feed(source)
            session.look_ahead()
        page = LivePage(session, None, 0.01, token)
        with testing.TestClient(page.app(), base_url=f"http://{host}:8000") as found:
            yield session, found


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
        assert page.post("/do", content="[" * 200_000).status_code == 400
        values = dict.fromkeys(session.fields, 0.0) | {"x_mm": 900.0}
        assert do(do="type", values=values)[1].startswith("9: DOUBTFUL")
        code, said = do(do="finish")
        assert (code, "wrote" in said) == (200, True), said
        assert (arm / "results/KM.robot.toml").exists()


def test_other_machines_and_other_pages_are_refused(arm: Path) -> None:
    with client(arm) as (session, page):
        assert page.get("/", headers={"host": "evil.example"}).status_code == 403
        other = page.post("/do", json={"do": "repeat", "number": 1}, headers={"origin": "http://evil.example"})
        assert (other.status_code, other.text) == (403, "another page sent this command")
        assert len(session.course.readings) == 8
        with bound("127.0.0.1", 0) as taken, pytest.raises(InputError, match="in use; without --port a free one"):
            bound("127.0.0.1", taken.getsockname()[1])


def test_another_host_needs_the_token(arm: Path) -> None:
    with client(arm, "secret", "192.168.1.5") as (_, page):
        assert page.get("/").status_code == 403
        assert "?token=" in page.get("/events?token=wrong").text
        assert page.get("/?token=secret").status_code == 200
        assert page.get("/").status_code == 200  # by its cookie


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
def test_no_port_is_open_beyond_loopback(arm: Path) -> None:
    """All that the command listens on, whatever it serves."""
    psutil = pytest.importorskip("psutil", reason="psutil is not installed: ports were not listed")
    process, _ = started(arm, ROOT / "data/planar/planar.csv")
    own = psutil.Process(process.pid)
    asked = [c for p in (own, *own.children(recursive=True)) for c in p.net_connections("inet")]
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
