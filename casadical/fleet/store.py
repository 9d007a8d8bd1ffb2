"""Store of a fleet: a folder with one Parquet file per robot, written as each is computed.

A row holds all that is computed for one robot (calibration, diagnosis, comparison) or its error.
"""

import hashlib
import time
import traceback
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from casadical import __version__
from casadical.core.basics import CasadicalError, InputError, shown
from casadical.core.files import json_text, write_together
from casadical.core.reading import read_bytes
from casadical.fleet.campaigns import estimates_of, in_order, later_tables, other_regions
from casadical.fleet.changes import in_words
from casadical.fleet.comparison import compare
from casadical.fleet.estimates import Estimate
from casadical.project.calibration import calibrate
from casadical.project.diagnosis import diagnose_campaign, read_campaigns
from casadical.project.outcome import judged_on
from casadical.project.problem import Problem, read_campaign_robot, read_problem
from casadical.project.problem_file import own_tables, problem_file
from casadical.robot.robot import Robot

# Names of the columns of a store's row that hold text, separated by spaces.
_TEXT_COLUMNS = (
    "robot folder status error fingerprint written_by type type_name method at_bounds verdict causes changes notes"
)
# Names of the columns of a store's row that hold lists, separated by spaces. Those from `names` to
# `scale` are as of `shared_columns`; left_mm, left_free and days have one number per campaign.
_LIST_COLUMNS = "names departure score information spread scale identified left_mm left_free days"
# All columns of a store's row, each with the value of a robot that was not calibrated.
EMPTY_ROW: dict[str, Any] = {
    **dict.fromkeys(_TEXT_COLUMNS.split(), ""),
    **dict.fromkeys(("finished", "seconds"), 0.0),
    **dict.fromkeys(("poses", "campaigns"), 0),
    **dict.fromkeys(("before_mm", "after_mm"), float("nan")),
    "details": "{}",
    **{name: [] for name in _LIST_COLUMNS.split()},
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
        row |= _computed(place, with_diagnosis)
        row["status"] = "ok"
    except CasadicalError as error:
        row |= {"status": "failed", "error": str(error)}
    except Exception:  # one robot stops nobody
        row |= {"status": "bug", "error": traceback.format_exc(limit=-4)}
    return row | {"seconds": time.perf_counter() - start, "finished": time.time()}


def _computed(place: Path, with_diagnosis: bool) -> dict[str, Any]:
    """Return the columns of a robot's row that hold results, by name; see `EMPTY_ROW`.

    They are those of its calibration, its diagnosis and the comparison of its campaigns.

    place : problem folder; with_diagnosis : whether the robot is diagnosed
    Raises CasadicalError: its calibration or its first campaign cannot be used.
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


def records(robots: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of a table as dictionaries from column to value."""
    return [{str(k): v for k, v in r.items()} for r in robots.to_dict("records")]
