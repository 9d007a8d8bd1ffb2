"""The command `casadical measure`."""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from typer import Argument, Context, Option

from casadical.cli.options import Json, Quiet, Room, refuse_of_others
from casadical.cli.terminal import plain, save, suggest, tell, with_json
from casadical.core.basics import InputError, shown

if TYPE_CHECKING:
    from rich.console import Console

    from casadical.project.live.session import LiveSession
    from casadical.project.live.sources import Source


def measure(
    context: Context,
    folder: Path = Argument(..., metavar="ARM", help="Problem folder, where readings are stored."),
    follow: str | None = Option(
        None,
        metavar="FILE|DIR|-",
        help="Where readings come from: a table that the instrument's software appends to, a "
        "folder of tables, or - for standard input. Any table that casadical new "
        "understands.",
    ),
    simulate: int | None = Option(
        None,
        metavar="N",
        min=1,
        help="Play an instrument in place of --follow: N made-up readings of a robot that "
        "departs a little from its file, each at the pose that is planned next. The folder "
        "is marked synthetic.",
    ),
    target_mm: float | None = Option(None, min=0, metavar="MM", help="Wanted accuracy; says when it is reached."),
    room: Room = None,
    finish: bool = Option(False, "--finish", help="Calibrate when the readings end, into the folder `results` in ARM."),
    program: str | None = Option(
        None, metavar="WORD", help="Also print the next pose in krl, rapid, urscript or fanuc."
    ),
    no_page: bool = Option(False, "--no-page", help="Print the answers; serve no page."),
    host: str = Option(
        "127.0.0.1",
        metavar="ADDRESS",
        help="Where the page is served; another machine then needs the token it prints.",
    ),
    port: int = Option(0, min=0, max=65535, metavar="N", help="Port of the page; default: a free one."),
    every: float = Option(0.0, min=0, max=3600, metavar="S", help="Seconds between readings of --simulate."),
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Follow a calibration while it is measured, each reading judged before the next pose is driven.

    Says of each reading whether it is plausible and, if not, which slip it looks like; what is
    known of the robot by now; the next pose. Readings are stored in ARM (measured.jsonl,
    measured.csv) as they come: it goes on where it was.

    Serves a page for a browser or a phone and prints its address (needs the extra live); with
    --no-page it prints.

    Example: casadical measure arm --follow tracker.csv

    Exit codes: 0 done, 2 bad input, 70 a bug in casadical.
    """
    from casadical.core.reading import load_toml
    from casadical.project.live.session import TABLE_FILE, LiveSession, finished
    from casadical.project.live.sources import JOURNAL_FILE, POLL_INTERVAL_S, SimulatedSource, journal, source_of
    from casadical.project.live.view import summary

    console = plain(quiet)
    # Parameters that only one source, or only one output, has.
    source_options = {"--simulate": ("every",), "readings that are measured": ()}
    refuse_of_others(context, [*source_options][not simulate], source_options)
    output_options = {"the page": ("host", "port"), "--no-page": ()}
    refuse_of_others(context, [*output_options][no_page], output_options)
    move = None
    if program:
        from casadical.export.controller.programs.program import language_named

        move = language_named(program).move_line
    if (follow and simulate) or (no_page and not (follow or simulate)):
        raise InputError("--follow FILE, DIR or -, or --simulate N: give one of them, from which the readings come")
    if follow and Path(follow).resolve() in {(folder / name).resolve() for name in (JOURNAL_FILE, TABLE_FILE)}:
        raise InputError(f"{shown(follow)}: is what this command writes itself; name what the instrument writes")
    source: Source | None = source_of(follow, sys.stdin.buffer) if follow else None
    target = None if target_mm is None else 1e-3 * target_mm
    load_toml(folder / "problem.toml")  # a folder without it is refused before anything is written there
    with journal(folder) as (course, add):
        data = "synthetic" if simulate else "real"
        session = LiveSession(folder, course, add, target=target, room=room, move=move, data=data)
        if course.readings:
            console.print(f"goes on after {len(course.readings)} readings that {folder} holds")
        played = SimulatedSource(session.robot, session.next_pose, simulate or 0, len(course.readings))
        source, pause = (played, every) if simulate else (source, POLL_INTERVAL_S)
        if no_page and source is not None:
            with suppress(KeyboardInterrupt):
                _follow(session, source, console, pause)
        else:
            from casadical.project.live.server import serve

            serve(session, source, console.print, host=host, port=port, pause=pause)
        save(with_json({}, json_file, session.state()), console)
    if finish:
        console.print(finished(session))
        suggest(console, "to learn the cause of the remaining error", "diagnose", folder)
    else:
        tell(console, *summary(session.state()))
        suggest(console, "to look for slips before a calibration", "check", folder)


def _follow(session: LiveSession, source: Source, console: Console, pause: float) -> None:
    """Take readings from a source, and print an answer to each, until the source ends.

    pause : time between two queries of the source [s]
    """
    from casadical.project.live.view import answer, outlook

    last = time.monotonic()
    # Time without a reading after which a message is printed [s].
    max_silence_s = 180.0
    while True:
        ended = getattr(source, "ended", False)
        numbers, said = session.feed(source)
        state = session.state()
        for text in (*said, *(answer(state, number) for number in numbers)):
            console.print(text)
        if numbers:
            if session.doubted():
                session.check()
            session.look_ahead()
            console.print("\n".join(f"   {line}" for line in outlook(session.state())))
        if ended:
            return
        if numbers or pause > max_silence_s:
            last = time.monotonic()
        elif time.monotonic() - last > max_silence_s:
            console.print(f"no reading for {max_silence_s / 60:.0f} minutes: does {source.words} still grow?")
            last = time.monotonic()
        time.sleep(pause)
