"""A fleet: every robot's folder calibrated, diagnosed and compared on a cluster, and what the robots have in common."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from time import monotonic
from typing import Any

import pandas as pd

from casadical.core.basics import InputError, Show, shown, silent
from casadical.fleet.cluster import SchedulerLostError, client_of, results
from casadical.fleet.result import KEPT, SHARED, Fleet, fleet_of
from casadical.fleet.store import NOTHING, add, each, fingerprint, name_of, one_robot, opened, rows

# Rows are written when there are so many, or after so many seconds.
ROWS, SECONDS = 50, 20.0
# Of a stored row, what says whether a robot is to be computed again.
_LOOKED_AT = ("robot", "folder", "status", "fingerprint", "verdict")


def run_fleet(
    folders: Sequence[str | Path],
    store: str | Path,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    with_diagnosis: bool = True,
    show: Show = silent,
) -> Fleet:
    """Calibrate, diagnose and compare every robot of a fleet; what a store has already is not computed again.

    folders : problem folders, one a robot, or folders that hold them
    store : folder of parquet files that keeps a row of each robot
    scheduler : address of a Dask scheduler, as tcp://host:8786; None: processes of this machine
    workers : how many processes of this machine; None: one a core
    with_diagnosis : whether every robot is diagnosed, which takes longest
    show : called with a line of progress
    Returns all robots of the store that were asked for, and what they have in common
    Raises InputError: no robots, a store that cannot be used, a scheduler that does not answer; what was done until
        then is kept.

    Examples
    --------
    >>> fleet = casadical.run_fleet(["problems/planar"], "fleet.parquet", workers=1)
    >>> list(fleet.robots["robot"]), list(fleet.robots["status"])
    (['planar'], ['ok'])
    """
    robots, place = robots_in(folders), Path(store)
    with opened(place):
        damaged: list[str] = []
        known = rows(place, _LOOKED_AT, damaged).set_index("robot")
        robots, prints, notes = _without_copies(robots, known)
        left, renamed = _to_compute(robots, prints, known, with_diagnosis, place)
        notes += renamed
        show(f"robot {len(robots) - len(left)} of {len(robots)}")
        if left:
            with client_of(scheduler, workers) as client:
                tasks = [(str(robots[name].resolve()), with_diagnosis) for name in left]
                _compute(results(client, one_robot, tasks), place, len(robots), len(left), show)
        whole = rows(place, KEPT, damaged=[])
    whole = whole[whole["robot"].isin(robots)].sort_values("robot", ignore_index=True)
    if gone := len(robots) - len(whole):
        notes.append(
            f"rows of {gone} robots are gone: {shown(place)} was changed meanwhile; run the same command again"
        )
    return fleet_of(whole, (*damaged, *notes), lambda some: each(place, some, SHARED), len(left))


def robots_in(folders: Iterable[str | Path]) -> dict[str, Path]:
    """Problem folders by name: those that are given, and those in given folders that are none. Raises InputError."""
    robots: dict[str, Path] = {}
    for given in map(Path, folders):
        inner = [given] if (given / "problem.toml").exists() else sorted(p.parent for p in given.glob("*/problem.toml"))
        if not inner:
            raise InputError(
                f"{shown(given)}: neither a problem folder nor a folder of such; a robot has a problem.toml"
            )
        for folder in inner:
            name = name_of(folder)
            if name in robots and robots[name].resolve() != folder.resolve():
                raise InputError(f"{shown(folder)}: a second robot of the name {name!r}; rename one of the folders")
            robots[name] = folder
    return robots


def _without_copies(robots: dict[str, Path], known: pd.DataFrame) -> tuple[dict[str, Path], dict[str, str], list[str]]:
    """Robots without copies of others, the fingerprints of all, and which are copies: of two, one the store has not."""
    prints: dict[str, str] = {}
    for name, folder in robots.items():
        try:
            prints[name] = fingerprint(folder)
        except OSError:
            prints[name] = ""
    stored, first = known["fingerprint"].to_dict(), dict[str, str]()
    for name in sorted(robots, key=lambda n: (stored.get(n) != prints[n], n)):
        first.setdefault(prints[name] or name, name)
    of = {name: first[prints[name] or name] for name in robots}
    said = [
        f"{name} has the same files as {of[name]}: a copy, counted once, without a row; remove one"
        for name in robots
        if of[name] != name
    ]
    return {name: folder for name, folder in robots.items() if of[name] == name}, prints, said


def _to_compute(
    robots: dict[str, Path], prints: dict[str, str], known: pd.DataFrame, with_diagnosis: bool, place: Path
) -> tuple[list[str], list[str]]:
    """Robots that are to be computed; a row whose folder was renamed is taken over under the new name."""
    left: list[str] = []
    renamed: dict[str, str] = {}
    gone = {now: str(name) for name, now in known["fingerprint"].items() if name not in prints and now}
    for name in robots:
        row, now = known.loc[name] if name in known.index else None, prints[name]
        if row is None and now in gone:
            renamed[gone[now]] = name
        elif row is None or row.fingerprint != now or row.status != "ok" or (with_diagnosis and not row.verdict):
            left.append(name)
    same = (
        {**old, "robot": renamed[old["robot"]], "folder": str(robots[renamed[old["robot"]]].resolve())}
        for old in each(place, renamed)
    )
    while some := list(islice(same, ROWS)):
        add(place, some)
    return left, [
        f"{name} has the files of {old}, whose folder is not there: taken for it, renamed"
        for old, name in renamed.items()
    ]


def _compute(
    done: Iterator[tuple[tuple[Any, ...], dict[str, Any] | Exception]], place: Path, total: int, left: int, show: Show
) -> None:
    """Keeps the rows as they come. Raises SchedulerLostError with how to go on."""
    waiting: list[dict[str, Any]] = []
    count, written = total - left, monotonic()
    again = f"robots are in {shown(place)}: run the same command again, it continues there"
    try:
        for (folder, _), record in done:
            if isinstance(record, Exception):
                why = f"the processes that computed it ended: {type(record).__name__}: {str(record).splitlines()[0]}"
                place_of = {"robot": name_of(Path(folder)), "folder": name_of(Path(folder), whole=True)}
                record = {**NOTHING, **place_of, "status": "lost", "error": why}
            waiting.append(record)
            count += 1
            show(f"robot {count} of {total}")
            if len(waiting) >= ROWS or monotonic() - written > SECONDS:
                add(place, waiting)
                waiting, written = [], monotonic()
    except SchedulerLostError as error:
        raise SchedulerLostError(f"{error}; {count} of {total} {again}") from None
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted; {count} of {total} {again}") from None
    finally:
        add(place, waiting)
