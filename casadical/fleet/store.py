"""A store of rows, one a robot: a folder of parquet files that is only added to, so that nothing is lost midway.

All that is computed of one robot of a fleet: calibrated, diagnosed, compared; an error is a row, too.
"""

import hashlib
import io
import os
import time
import traceback
import uuid
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from casadical import __version__
from casadical.core.basics import CasadicalError, InputError, optional, shown
from casadical.core.files import json_text, locked, write_together
from casadical.core.reading import foreign, read_bytes
from casadical.fleet.campaigns import estimates_of, in_order, later_tables, other_regions
from casadical.fleet.changes import in_words
from casadical.fleet.cluster import NEEDED
from casadical.fleet.comparison import compare
from casadical.fleet.estimates import Estimate
from casadical.project.calibration import calibrate
from casadical.project.diagnosis import CampaignDiagnosis, diagnose_campaign, read_campaigns
from casadical.project.outcome import judged_on
from casadical.project.problem import Problem, read_campaign_robot, read_problem
from casadical.project.problem_file import own_tables, problem_file
from casadical.robot.robot import Robot

# A row of a store of which nothing is known.
NOTHING: dict[str, Any] = {
    "robot": "", "folder": "", "status": "", "error": "", "fingerprint": "", "written_by": "", "finished": 0.0,
    "seconds": 0.0, "type": "", "type_name": "", "method": "", "poses": 0, "campaigns": 0, "before_mm": float("nan"),
    "after_mm": float("nan"), "at_bounds": "", "verdict": "", "causes": "", "changes": "", "details": "{}",
    "notes": "", "names": [], "departure": [], "score": [], "information": [], "spread": [], "scale": [],
    "identified": [], "left_mm": [], "left_free": [], "days": [],
}  # fmt: skip


def fingerprint(folder: Path) -> str:
    """Of the content of all files of a robot's folder, and of the tables and robot that its problem names elsewhere."""
    digest = hashlib.sha256()
    files = {str(p.relative_to(folder)): p for p in folder.rglob("*") if p.is_file() and not p.name.startswith(".")}
    with suppress(CasadicalError):  # what is wrong with the problem is said when it is computed
        named = problem_file(folder)
        others = [named.robot, named.of_campaigns, *(data.file for data in named.measurements)]
        files |= {name: folder / name for name in others if (folder / name).is_file()}
    for name, path in sorted(files.items()):
        digest.update(name.encode())
        digest.update(read_bytes(path))
    return digest.hexdigest()[:32]


def name_of(folder: Path, *, whole: bool = False) -> str:
    """Name or whole path of a robot's folder, bytes that are not UTF-8 by their codes."""
    path = folder.resolve()
    return (str(path) if whole else path.name).encode(errors="backslashreplace").decode()


def _refuse_bytes(folder: Path) -> None:
    if (name := name_of(folder, whole=True)) != str(folder.resolve()):
        raise InputError(f"{name}: a name that is not UTF-8; rename the folder")


def one_robot(folder: str, with_diagnosis: bool) -> dict[str, Any]:
    """The row of one robot; what goes wrong is in it, nothing is raised."""
    start, place = time.perf_counter(), Path(folder)
    row = {**NOTHING, "robot": name_of(place), "folder": name_of(place, whole=True), "written_by": __version__}
    try:
        _refuse_bytes(place)
        row["fingerprint"] = fingerprint(place)
        row |= _computed(place, with_diagnosis)
        row["status"] = "ok"
    except CasadicalError as error:
        row |= {"status": "failed", "error": str(error)}
    except Exception:  # one robot stops nobody
        row |= {"status": "bug", "error": traceback.format_exc(limit=-4)}
    return row | {"seconds": time.perf_counter() - start, "finished": time.time()}


def _computed(place: Path, with_diagnosis: bool) -> dict[str, Any]:
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
    if with_diagnosis and (diagnosed := first_diagnosis(place)) is not None:
        causes = ", ".join(c.label for c in diagnosed.diagnosis.causes)
        row |= {"verdict": diagnosed.diagnosis.verdict, "causes": causes}
    ordered, said = in_order(estimates, begun=True)
    estimates, notes = ordered, [*notes, *said, *other_regions(ordered)]
    if len(ordered) > 1:
        compared = compare(ordered, notes=notes)
        changes = "; ".join(in_words(compared, c) for c in compared.changes)
        row |= {"changes": changes, "details": json_text(compared.to_json())}
    known = np.array([(e.day, e.sigma, e.freedom) for e in estimates], dtype=float)  # not a number for None
    days, left, free = (known * (1.0, 1e3, 1.0)).T.tolist()
    own = {"campaigns": len(estimates), "notes": "; ".join(notes), "days": days, "left_mm": left, "left_free": free}
    return row | own | shared_columns(estimates[-1], read_campaign_robot(place))


def first_diagnosis(place: Path) -> CampaignDiagnosis | None:
    """Of a folder's first table of positions, all its poses, as the command diagnoses it; None without positions."""
    for table in own_tables(place):
        (campaign,) = read_campaigns(place, [table])
        if campaign.sets[0].position is not None:
            return diagnose_campaign(campaign)
    return None


def type_of(problem: Problem) -> str:
    """A word for all robots of one drawing: same parameters, same nominal values but those of base and tool."""
    own = [(p.name, f"{p.value:.9g}") for p in problem.robot.parameters if p.group not in ("base", "tool")]
    return hashlib.sha256(repr(own).encode()).hexdigest()[:12]


def shared_columns(e: Estimate, drawn: Robot) -> dict[str, Any]:
    """What the last campaign tells of the parameters that robots of one type share, about the nominal values."""
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


VERSION = 1
# Key of the version in the metadata of every file.
KEY = b"casadical_fleet"
# Columns that files of this version may lack.
ADDED = ("left_free",)
# Rows of a file; one is written for `casadical.fleet.run.ROWS` robots at most.
MOST_ROWS = 10_000
AGAIN = "the robots in it are computed again; remove it"


@contextmanager
def opened(folder: Path) -> Iterator[None]:
    """A store that this process alone writes to. Raises InputError: another one does, no folder, another version."""
    optional("pyarrow", NEEDED)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{shown(folder)}: is a file; a store is a folder: give another name with --store")
    made = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            handle = os.open(folder, os.O_RDONLY)
            stack.callback(os.close, handle)
            if not locked(handle):
                raise InputError(f"{shown(folder)}: another casadical is writing to this store; wait for it")
            if not os.access(folder, os.W_OK):
                raise InputError(
                    f"{shown(folder)}: this store cannot be written to; change its permissions or its place"
                )
            foreign = [p.name for p in folder.iterdir() if not p.name.startswith((".", "part-"))]
            if foreign:
                raise InputError(
                    f"{shown(folder)}: holds {shown(min(foreign))}, which is no part of a store; a store is a folder "
                    "of its own: give another name with --store"
                )
            yield
    except OSError as error:
        raise InputError(f"{shown(folder)}: cannot be used as a store: {error.strerror or error}") from None
    finally:
        if made:  # and nothing was written into it
            with suppress(OSError):
                folder.rmdir()


def add(folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Add rows as one more file, which appears completely or not at all. Raises InputError."""
    if not rows:
        return
    arrow, parquet = optional("pyarrow", NEEDED), optional("pyarrow.parquet", NEEDED)
    columns = {name: [row.get(name, empty) for row in rows] for name, empty in NOTHING.items()}
    table = arrow.table({name: arrow.array(values, _type(NOTHING[name])) for name, values in columns.items()})
    blob = io.BytesIO()
    parquet.write_table(table.replace_schema_metadata({KEY: str(VERSION).encode()}), blob, compression="zstd")
    number = 1 + max((int(p.name[5:11]) for p in parts(folder)), default=0)
    try:
        write_together({folder / f"part-{number:06d}-{uuid.uuid4().hex[:8]}.parquet": blob.getvalue()})
    except InputError as error:
        raise InputError(
            f"{error} of {len(rows)} robots; those written before are kept: run the command again"
        ) from None


def _type(empty: Any) -> Any:
    arrow = optional("pyarrow", NEEDED)
    if isinstance(empty, list):
        return arrow.list_(
            arrow.string() if empty is NOTHING["names"] or empty is NOTHING["identified"] else arrow.float64()
        )
    return {str: arrow.string(), int: arrow.int64(), float: arrow.float64()}[type(empty)]


def parts(folder: Path) -> list[Path]:
    return sorted(folder.glob("part-" + 6 * "[0-9]" + "-*.parquet"))


def rows(folder: Path, columns: Sequence[str] | None = None, damaged: list[str] | None = None) -> pd.DataFrame:
    """The last row of every robot. Raises InputError for files of another version.

    damaged : files that cannot be read are named here and passed over; where it is not given they raise InputError, too
    """
    tables = [
        table.to_pandas(ignore_metadata=True)
        for path in parts(folder)
        if (table := _read(path, columns, damaged)) is not None
    ]
    empty = pd.DataFrame({name: [] for name in columns or NOTHING})
    whole = pd.concat(tables, ignore_index=True) if tables else empty
    return whole.drop_duplicates("robot", keep="last", ignore_index=True)


def each(folder: Path, robots: Collection[str], columns: Sequence[str] | None = None) -> Iterator[dict[str, Any]]:
    """The last row of some robots, one by one: of the store, one file at a time is in memory."""
    left = set(robots)
    for path in reversed(parts(folder)):
        names = _read(path, ["robot"], [])
        if names is None or left.isdisjoint(names["robot"].to_pylist()):
            continue
        if (table := _read(path, columns, [])) is None:
            continue
        last = {name: k for k, name in enumerate(names["robot"].to_pylist()) if name in left}
        left -= last.keys()
        yield from records(table.take(list(last.values())).to_pandas(ignore_metadata=True))


def records(robots: pd.DataFrame) -> list[dict[str, Any]]:
    return [{str(k): v for k, v in r.items()} for r in robots.to_dict("records")]


def _read(path: Path, columns: Sequence[str] | None, damaged: list[str] | None) -> Any:
    """Table of a file; None where it cannot be read, which `damaged` then says. Raises InputError."""
    parquet = optional("pyarrow.parquet", NEEDED)
    blob = io.BytesIO(read_bytes(path))
    try:
        with foreign(f"{shown(path)}: is no part of a store", AGAIN):
            schema = parquet.read_schema(blob)
            version = (schema.metadata or {}).get(KEY, b"").decode(errors="replace")
            if version == str(VERSION):
                _refuse_malformed(schema, parquet.read_metadata(blob).num_rows)
                table = parquet.read_table(blob, columns=[n for n in schema.names if columns is None or n in columns])
                table.validate(full=True)  # its texts, too
                if lost := [name for name in table.column_names if table[name].null_count]:
                    raise ValueError(f"a cell of column {lost[0]!r} is empty")
                return table
    except InputError as error:
        if damaged is None:
            raise
        damaged.append(str(error))
        return None
    raise InputError(
        f"{shown(path)}: a store of version {version or 'unknown'}; this casadical reads version {VERSION}: "
        "give another --store, or use the casadical that wrote it. Nothing was changed"
    )


def _refuse_malformed(schema: Any, count: int) -> None:
    """Raises ValueError where a file has too many rows, or its columns are not those of a row."""
    if count > MOST_ROWS:
        raise ValueError(f"it has {count} rows; at most {MOST_ROWS} are read")
    for name, empty in NOTHING.items():
        if name not in schema.names and name not in ADDED:
            raise ValueError(f"column {name!r} is missing")
        if name in schema.names and schema.field(name).type != _type(empty):
            raise ValueError(f"column {name!r} is of type {schema.field(name).type}, not {_type(empty)}")
