"""All that is computed of one robot of a fleet: calibrated, diagnosed, compared; an error is a row, too."""

from __future__ import annotations

import hashlib
import time
import traceback
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from casadical import __version__
from casadical.core.basics import CasadicalError, InputError
from casadical.core.files import json_text
from casadical.core.reading import read_bytes
from casadical.fleet.campaigns import estimates_of, in_order, later_tables, other_regions
from casadical.fleet.changes import in_words
from casadical.fleet.comparison import compare
from casadical.fleet.estimates import Estimate
from casadical.project.calibration import calibrate
from casadical.project.diagnosis import CampaignDiagnosis, diagnose_campaign, read_campaigns
from casadical.project.problem import Problem, read_campaign_robot, read_problem
from casadical.project.problem_file import own_tables, problem_file
from casadical.project.tables import judged_on
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
    told = estimates_of(files, place)
    if isinstance(told[0], CasadicalError):
        raise told[0]
    first = told[0] if day is None else replace(told[0], day=day)
    estimates = [first, *(e for e in told[1:] if isinstance(e, Estimate))]
    notes = [f"{p.name} is left out: {e}" for p, e in zip(files, told, strict=True) if isinstance(e, CasadicalError)]
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
    if with_diagnosis:
        diagnosed = first_diagnosis(place)
        if diagnosed is not None:
            causes = ", ".join(c.label for c in diagnosed.diagnosis.causes)
            row |= {"verdict": diagnosed.diagnosis.verdict, "causes": causes}
    ordered, said = in_order(estimates, begun=True)
    estimates, notes = ordered, [*notes, *said, *other_regions(ordered)]
    if len(ordered) > 1:
        compared = compare(ordered, notes=notes)
        changes = "; ".join(in_words(compared, c) for c in compared.changes)
        row |= {"changes": changes, "details": json_text(compared.to_json())}
    days = [float("nan") if e.day is None else e.day for e in estimates]
    left = [float("nan") if e.sigma is None else 1e3 * e.sigma for e in estimates]
    free = [float("nan") if e.freedom is None else e.freedom for e in estimates]
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
