"""Fleet run: every robot's folder is calibrated, diagnosed and compared on a Dask cluster.

What the robots have in common is computed from the rows of the store at the end. The store is a
folder with one Parquet file per robot, written as each is computed: a row holds all that is
computed for one robot (calibration, diagnosis, comparison) or its error.
"""

import hashlib
import os
import re
import signal
import time
import traceback
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from pydoc import locate
from typing import Any

import numpy as np
import pandas as pd

from casadical import __version__
from casadical.core.basics import CasadicalError, InputError, Show, optional, shown, silent
from casadical.core.files import claimed, json_text, write_together
from casadical.core.reading import read_bytes
from casadical.fleet.campaigns import estimates_of, in_order, later_tables, other_regions
from casadical.fleet.changes import in_words
from casadical.fleet.comparison import compare
from casadical.fleet.estimates import Estimate
from casadical.fleet.result import Fleet, fleet_of, records
from casadical.project.calibration import calibrate
from casadical.project.diagnosis import diagnose_campaign, read_campaigns
from casadical.project.outcome import judged_on
from casadical.project.problem import Problem, read_campaign_robot, read_problem
from casadical.project.problem_file import own_tables, problem_file
from casadical.robot.robot import Robot

# All columns of a store's row, each with the value of a robot that was not calibrated. The lists
# from `names` to `scale` are as of `shared_columns`; left_mm, left_free and days have one number per
# campaign.
EMPTY_ROW: dict[str, Any] = {
    **dict.fromkeys(("robot", "folder", "status", "error", "fingerprint", "written_by", "type", "type_name"), ""),
    **dict.fromkeys(("method", "at_bounds", "verdict", "causes", "changes", "notes"), ""),
    **dict.fromkeys(("finished", "seconds"), 0.0),
    **dict.fromkeys(("poses", "campaigns"), 0),
    **dict.fromkeys(("before_mm", "after_mm"), float("nan")),
    "details": "{}",
    **{name: [] for name in ("names", "departure", "score", "information", "spread", "scale", "identified")},
    **{name: [] for name in ("left_mm", "left_free", "days")},
}


def fingerprint(folder: Path) -> str:
    """Return a hash of all files in a problem folder and of those that its problem.toml names.

    It is the first half of a SHA-256, 32 hexadecimal digits; files with a hidden name do not count.
    """
    digest = hashlib.sha256()
    files = {str(p.relative_to(folder)): p for p in folder.rglob("*") if p.is_file() and not p.name.startswith(".")}
    with suppress(CasadicalError):  # an invalid problem is reported when it is computed
        named = problem_file(folder)
        others = [named.robot, named.of_campaigns, *(data.file for data in named.measurements)]
        files |= {name: folder / name for name in others if (folder / name).is_file()}
    for name, path in sorted(files.items()):
        digest.update(name.encode())
        digest.update(read_bytes(path))
    return digest.hexdigest()[:32]


def name_of(folder: Path, *, whole: bool = False) -> str:
    """Return the name of a robot's folder, with bytes escaped that are not UTF-8.

    whole : whether its absolute path is returned in place of its name
    """
    path = folder.resolve()
    return (str(path) if whole else path.name).encode(errors="backslashreplace").decode()


def one_robot(folder: str, with_diagnosis: bool) -> dict[str, Any]:
    """Calibrate, diagnose and compare one robot, and return its row of the store.

    Its column `status` is "ok", "failed" (invalid input) or "bug" (any other exception), with the
    message in the column `error`.

    folder : problem folder
    with_diagnosis : whether the robot is diagnosed
    Raises nothing.
    """
    start, place = time.perf_counter(), Path(folder)
    row = {**EMPTY_ROW, "robot": name_of(place), "folder": name_of(place, whole=True), "written_by": __version__}
    try:
        if row["folder"] != str(place.resolve()):
            raise InputError(f"{row['folder']}: a name that is not UTF-8; rename the folder")
        row["fingerprint"] = fingerprint(place)
        row |= _results_of(place, with_diagnosis)
        row["status"] = "ok"
    except CasadicalError as error:
        row |= {"status": "failed", "error": str(error)}
    except Exception:  # one robot stops nobody
        row |= {"status": "bug", "error": traceback.format_exc(limit=-4)}
    return row | {"seconds": time.perf_counter() - start, "finished": time.time()}


def _results_of(place: Path, with_diagnosis: bool) -> dict[str, Any]:
    """Return the columns of a robot's row that hold results, by name; see `EMPTY_ROW`.

    They are those of its calibration, its diagnosis and the comparison of its campaigns.

    with_diagnosis : whether the robot is diagnosed
    """
    whole = read_problem(place)
    problem = replace(whole, networks=(), methods=whole.methods[-1:])  # the row is of the method that counts
    calibration = calibrate(problem)
    method, before, after, _ = judged_on(calibration.accuracies)
    last = calibration.identification
    later, day = later_tables(place)
    files = [place, *later]
    computed = estimates_of(files, place)
    if isinstance(computed[0], CasadicalError):
        raise computed[0]
    first = computed[0] if day is None else replace(computed[0], day=day)
    estimates = [first, *(e for e in computed[1:] if isinstance(e, Estimate))]
    notes = [
        f"{p.name} is left out: {e}" for p, e in zip(files, computed, strict=True) if isinstance(e, CasadicalError)
    ]
    notes += [f"{e.label}: {note}" for e in estimates for note in e.notes]
    row: dict[str, Any] = {
        "type": type_of(problem),
        "type_name": problem.robot.name,
        "method": method,
        "poses": sum(e.poses for e in estimates),
        "before_mm": 1e3 * before.mean,
        "after_mm": 1e3 * after.mean,
        "at_bounds": ", ".join(last.at_bounds),
        "identified": list(last.names),
    }
    campaigns = (read_campaigns(place, [table])[0] for table in own_tables(place) if with_diagnosis)
    if (campaign := next((c for c in campaigns if c.sets[0].position is not None), None)) is not None:
        found = diagnose_campaign(campaign).diagnosis
        row |= {"verdict": found.verdict, "causes": ", ".join(c.label for c in found.causes)}
    ordered, said = in_order(estimates, begun=True)
    estimates, notes = ordered, [*notes, *said, *other_regions(ordered)]
    if len(ordered) > 1:
        compared = compare(ordered, notes=notes)
        changes = "; ".join(in_words(compared, c) for c in compared.changes)
        row |= {"changes": changes, "details": json_text(compared.to_json())}
    rows = np.array([(e.day, e.sigma, e.freedom) for e in estimates], dtype=float)  # not a number for None
    days, sigmas, free = (rows * (1.0, 1e3, 1.0)).T.tolist()
    own = {"campaigns": len(estimates), "notes": "; ".join(notes), "days": days, "left_mm": sigmas, "left_free": free}
    return row | own | shared_columns(estimates[-1], read_campaign_robot(place))


def type_of(problem: Problem) -> str:
    """Return the key of a robot's type: a hash of its nominal parameters, 12 hexadecimal digits.

    Robots of one type have equal nominal parameters to nine digits, base and tool excluded.
    """
    own = [(p.name, f"{p.value:.9g}") for p in problem.robot.parameters if p.group not in ("base", "tool")]
    return hashlib.sha256(repr(own).encode()).hexdigest()[:12]


def shared_columns(e: Estimate, drawn: Robot) -> dict[str, Any]:
    """Return a campaign's information on the k parameters that robots of one type share.

    The keys are columns of a row: names; departure, estimate less nominal value; score and
    information of the log likelihood about the nominal values, the matrix as its lower triangle,
    row by row; spread, prior standard deviations. All are in units of scale, the last key [SI].
    Base and tool are excluded.

    drawn : robot with the nominal values
    """
    nominal = {p.name: p for p in drawn.parameters}
    names = tuple(n for n in e.names if n not in nominal or nominal[n].group not in ("base", "tool"))
    at = [e.names.index(n) for n in names]
    zero = np.array([nominal[n].value if n in nominal else 0.0 for n in names])
    H, b = e.about(names, zero)
    return {
        "names": list(names),
        "departure": ((e.values[at] - zero) / e.scale[at]).tolist(),
        "score": b.tolist(),
        "information": H[np.tril_indices(len(H))].tolist(),
        "spread": e.spread[at].tolist(),
        "scale": e.scale[at].tolist(),
    }


def add(folder: Path, row: Mapping[str, Any]) -> None:
    """Write the row of one robot into the store in a folder, as ROBOT.parquet, atomically.

    Raises InputError: no space, no permission.
    """
    kind = {"names": str, "identified": str}  # of a list, which may be empty: all files have columns of the same types
    lists = {n: np.array(row[n], dtype=kind.get(n, float)) for n, empty in EMPTY_ROW.items() if isinstance(empty, list)}
    write_together({folder / f"{row['robot']}.parquet": pd.DataFrame([{**row, **lists}]).to_parquet()})


def rows(folder: Path) -> tuple[pd.DataFrame, list[str]]:
    """Return the rows of the store in a folder, and a sentence on each file that cannot be read.

    The table has the columns of `EMPTY_ROW` and one row per robot; it is empty for an empty store.
    """
    tables, damaged = [pd.DataFrame(columns=list(EMPTY_ROW))], list[str]()
    for path in sorted(folder.glob("*.parquet")):
        try:
            tables.append(pd.read_parquet(path)[list(EMPTY_ROW)])
        except Exception as error:  # of pandas and of pyarrow, as many kinds as a file may be damaged
            why = str(error).splitlines()[0] if str(error) else type(error).__name__
            damaged.append(f"{shown(path)}: holds no row of a robot: {why}; its robot is computed again")
    whole = pd.concat(tables[1:] or tables, ignore_index=True)
    return whole.drop_duplicates("robot", keep="last", ignore_index=True), damaged


# Message of the InputError where dask, distributed or pyarrow is not installed.
MISSING_PACKAGES = "a fleet needs dask, distributed and pyarrow; install them: pip install 'casadical[fleet]'"


def run_fleet(
    folders: Sequence[str | Path],
    store: str | Path,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    with_diagnosis: bool = True,
    show: Show = silent,
) -> Fleet:
    """Calibrate, diagnose and compare every robot of a fleet without a valid row in the store.

    A row is valid if it is of the robot's present files and without an error, and has a diagnosis
    if one is asked for.

    folders : problem folders, one a robot, or folders that hold them
    store : folder that keeps a Parquet file with the row of each robot
    scheduler : address of a Dask scheduler, as tcp://host:8786; None: processes of this machine
    workers : number of processes on this machine; None: one per core
    with_diagnosis : whether every robot is diagnosed, which takes longest
    show : function that is called with each line of progress
    Returns all robots of the store that were asked for, and what they have in common
    Raises InputError: no robots, a store that cannot be used, a scheduler that does not answer.
    Rows that were computed before an error stay in the store.

    Examples
    --------
    >>> fleet = casadical.run_fleet(["problems/planar"], "fleet.parquet", workers=1)
    >>> list(fleet.robots["robot"]), list(fleet.robots["status"])
    (['planar'], ['ok'])
    """
    robots, place = robots_in(folders), Path(store)
    optional("pyarrow", MISSING_PACKAGES)
    with claimed([place]):
        if foreign := [p.name for p in place.iterdir() if not (p.name.startswith(".") or p.suffix == ".parquet")]:
            raise InputError(
                f"{shown(place)}: holds {shown(min(foreign))}, which is no part of a store; a "
                "store is a folder of its own: give another name with --store"
            )
        if not os.access(place, os.W_OK):
            raise InputError(f"{shown(place)}: this store cannot be written to; change its permissions or its place")
        stored, damaged = rows(place)
        stored_rows = stored.set_index("robot")
        robots, pending, renamed, notes = _to_compute(robots, stored_rows, with_diagnosis)
        for row in records(stored[stored["robot"].isin(renamed)]):
            name = renamed[row["robot"]]
            add(place, {**row, "robot": name, "folder": str(robots[name].resolve())})
        count, total = len(robots) - len(pending), len(robots)
        again = f"robots are in {shown(place)}: run the same command again, it continues there"
        show(f"robot {count} of {total}")
        try:
            for row in _computed(pending, robots, scheduler, workers, with_diagnosis) if pending else ():
                add(place, row)
                count += 1
                show(f"robot {count} of {total}")
        except InputError as error:
            raise InputError(
                f"{error}; {count} of {total} {again}" if count > total - len(pending) else f"{error}"
            ) from None
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"interrupted; {count} of {total} {again}") from None
        whole, _ = rows(place)
    whole = whole[whole["robot"].isin(robots)].sort_values("robot", ignore_index=True)
    return fleet_of(whole, (*damaged, *notes), len(pending))


def robots_in(folders: Iterable[str | Path]) -> dict[str, Path]:
    """Return the problem folders, by the names of their robots.

    folders : problem folders, or folders whose direct subfolders are problem folders
    Raises InputError: a folder that is neither, or two robots of one name.
    """
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


def _to_compute(
    robots: dict[str, Path], stored_rows: pd.DataFrame, with_diagnosis: bool
) -> tuple[dict[str, Path], list[str], dict[str, str], list[str]]:
    """Return robots whose files differ, those to compute, new names by old ones, and notes.

    Of robots with equal files the one that the store already has is returned. A robot is computed
    if the store has no successful row of its present files. It counts as renamed if the store has
    its files under a name that is no longer given.

    with_diagnosis : whether a row without a diagnosis counts as not computed
    """
    prints: dict[str, str] = {}
    for name, folder in robots.items():
        try:
            prints[name] = fingerprint(folder)
        except OSError:
            prints[name] = ""
    stored, first = stored_rows["fingerprint"].to_dict(), dict[str, str]()
    for name in sorted(robots, key=lambda n: (stored.get(n) != prints[n], n)):
        first.setdefault(prints[name] or name, name)
    gone = {now: str(name) for name, now in stored.items() if name not in prints and now}
    distinct, pending, renamed, notes = dict[str, Path](), list[str](), dict[str, str](), list[str]()
    for name, folder in robots.items():
        now = prints[name]
        if (original := first[now or name]) != name:
            copy = "a copy, counted once, without a row; remove one"
            notes.append(f"{name} has the same files as {original}: {copy}")
            continue
        distinct[name] = folder
        row = stored_rows.loc[name] if name in stored_rows.index else None
        if row is None and now in gone:
            renamed[gone[now]] = name
        elif row is None or row.fingerprint != now or row.status != "ok" or (with_diagnosis and not row.verdict):
            pending.append(name)
    words = "{} has the files of {}, whose folder is not there: taken for it, renamed"
    return distinct, pending, renamed, [*notes, *(words.format(name, old) for old, name in renamed.items())]


def _computed(
    names: Sequence[str], robots: dict[str, Path], scheduler: str | None, workers: int | None, with_diagnosis: bool
) -> Iterator[dict[str, Any]]:
    """Yield the store's row of each robot as soon as it is computed on a Dask cluster.

    A robot whose process ends three times has a row of status "lost".
    """
    distributed = optional("distributed", MISSING_PACKAGES)
    with client_of(scheduler, workers) as client:
        folders = [robots[name].resolve() for name in names]
        # A robot whose worker dies is given to another worker up to twice.
        options = {"with_diagnosis": with_diagnosis, "pure": False, "retries": 2}
        of = dict(zip(client.map(one_robot, [str(folder) for folder in folders], **options), folders, strict=True))
        for future, row in distributed.as_completed(of, with_results=True, raise_errors=False):
            folder = of.pop(future)
            if future.cancelled():
                raise InputError("the scheduler no longer answers")
            if future.status == "error":
                why = f"the processes that computed it ended: {type(row[1]).__name__}: {str(row[1]).splitlines()[0]}"
                about = {"robot": name_of(folder), "folder": name_of(folder, whole=True)}
                row = {**EMPTY_ROW, **about, "status": "lost", "error": why}
            yield row


@contextmanager
def client_of(scheduler: str | None, workers: int | None) -> Iterator[Any]:
    """Yield a client of a Dask scheduler, or of a local cluster that is closed at the end.

    scheduler : address, HOST:PORT with or without tcp://; None: a local cluster
    workers : number of processes of a local cluster; None: one per core
    Raises InputError: an invalid address, no answer, or workers with another casadical.
    """
    distributed = optional("distributed", MISSING_PACKAGES)  # first: its own settings must not take the place of these
    dask = optional("dask", MISSING_PACKAGES)
    if scheduler is not None:
        if scheduler.startswith("tls://"):
            raise InputError(
                f"--scheduler {shown(scheduler)}: an encrypted one asks for certificates, which "
                "this command cannot give; start the scheduler with tcp:// on a network that you "
                "trust, or reach it through an SSH tunnel"
            )
        parts = re.fullmatch(r"(tcp://)?(\[[0-9a-fA-F:.]+\]|[\w.-]+):(\d{1,5})", scheduler)
        if not parts or int(parts[3]) > 65535:
            raise InputError(f"--scheduler {shown(scheduler)}: is no address; an address is tcp://host:8786")
    settings = {
        "distributed.comm.timeouts.connect": "10s",
        # By default Dask stores the call stacks of the last hour: hundreds of megabytes.
        "distributed.worker.profile.enabled": False,
        "distributed.worker.preload": [__name__],
    }
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(settings))
        try:
            if scheduler is not None:
                client = stack.enter_context(distributed.Client(scheduler, timeout="10s"))
                versions = client.run(locate, "casadical.__version__")
                if not versions:
                    remedy = f"start one there: dask worker {scheduler}"
                    raise InputError(f"{scheduler}: no worker is connected; {remedy}")
                for worker, version in versions.items():
                    if version != __version__:
                        raise InputError(
                            f"worker {worker} has {f'casadical {version}' if version else 'no casadical'}; "
                            f"this is casadical {__version__}: install the same one there, and start "
                            "the worker again"
                        )
            else:  # on the loopback interface; by default Dask serves its pages on all
                host = "127.0.0.1"
                options = {"host": host, "dashboard_address": f"{host}:0", "silence_logs": 50}
                cluster = distributed.LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, **options)
                client = stack.enter_context(distributed.Client(stack.enter_context(cluster)))
        except (OSError, TimeoutError) as error:
            raise InputError(f"{scheduler or 'local cluster'}: no scheduler answers: {error}") from None
        yield client


def dask_setup(_worker: Any) -> None:
    """Ignore Ctrl-C (SIGINT) in a worker process, which the command ends itself.

    Dask calls this in each process of a local cluster.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
