"""Serialisation of a diagnosis: as data for JSON, and as files."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from casadical.core.files import json_text
from casadical.core.reporting.plain import plain
from casadical.diagnosis.cause_table import layers
from casadical.diagnosis.details import Details
from casadical.diagnosis.isolability import cannot_tell
from casadical.diagnosis.next_poses import discrimination_probability
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.statements import assumptions, floor_of, headline, missing_columns
from casadical.diagnosis.text import page_of
from casadical.identification.gravity import as_json as gravity_as_json
from casadical.robot.robot_file import robot_files


def as_json(d: Diagnosis, campaign: str, more: Details | None = None) -> dict[str, Any]:
    """Return the diagnosis as data for JSON; keys name their units, lengths are in mm.

    campaign : name of the campaign
    more : result of `analyse`; analyses that were not computed are omitted
    """
    more = more or Details()
    poses = pd.DataFrame() if more.poses is None else more.poses
    check, of_floor, form = more.check, floor_of(d, more), d.rankings[-1].noise_form
    prior = d.prior and {**d.prior.to_json([d.case.m]), "changed": d.changes}
    answer = {
        "campaign": campaign,
        **d.to_json(),
        "gap_mm": {"before": _mm(d.gap.before), "after": _mm(d.gap.after), "floor": _mm(of_floor)},
        "p_nothing": d.p_nothing,
        "prior": prior,
        "set": d.cause_set,
        "unknown_rest": round(d.unknown_rest, 4),
        "unlisted": more.unlisted,
        "laws": more.laws and more.laws.laws_json(),
        "course": d.course.round(5),
        "layers": layers(d, more.floor) or None,
        "where": more.where and {name: table.round(5) for name, table in more.where.tables()},
        "noise": {
            "sigma_mm": _mm(d.noise.sigma),
            "repeatability_urad": round(1e6 * d.noise.repeatability, 2),
            **plain(d.account),
            **({"form": form} if form else {}),
        },
        "replicates": {
            "sigma_mm": _mm(d.replicates.sigma),
            "poses": d.replicates.poses,
            "used": d.replicates.enough,
        },
        "outliers": d.outliers,
        "outlier_rows": [o.row for o in d.outliers],
        "outliers_along_joint": d.joint_of_outliers,
        "assumed": assumptions(d) or None,
        "cannot": cannot_tell(d) or None,
        "ruled_out": more.ruled_out or None,
        "gravity": gravity_as_json(d.gravity) if d.identification.given.masses == "estimated" else None,
        "missing_columns": missing_columns(d),
        "next_measurements": [
            {str(k): v for k, v in row.items() if v == v and v is not None} for row in poses.to_dict("records")
        ],
        "told_rightly": [round(p, 4) for p in discrimination_probability(d, poses)] if len(poses) else None,
        "refit_mm": check and {"held_out": _mm(check.refit), "linearised": _mm(check.linearised)},
        "curves": more.curves,
        "network_mm": [
            {**{k: _mm(getattr(gap, k)) for k in ("before", "used", "forced")}, "refused": gap.refused}
            for gap in more.networks or ()
        ]
        or None,
    }
    return {key: plain(value) for key, value in answer.items() if value is not None}


def diagnosis_files(
    folder: str | Path,
    found: Diagnosis,
    more: Details,
    name: str,
    *,
    unlisted: bool = False,
    tables: Sequence[Mapping[str, Any]] = (),
) -> dict[Path, str | bytes]:
    """Return the text of each file that `casadical diagnose --out` writes: robot, data and report.

    Keys are the paths.
    folder : folder of the files; more : result of `analyse`; name : name of the campaign
    unlisted : whether the robot's model includes the description of an unlisted cause, if any
    tables : how tables of the campaign are interpreted, as of `DataTable.interpretation`
    Raises ConvergenceError: Ipopt finds no optimum of the refit.
    """
    folder = Path(folder)
    refit = found.refit(unlisted=more.unlisted if unlisted else None)
    comment = f"Diagnosed by casadical from {name}.\n{headline(found, more)}\n{refit.verdict}"
    kinds = [type(effect) for effect in refit.robot.effects]
    return {
        **robot_files(folder / "diagnosed.robot.toml", refit.robot, comment, kinds, reproducible=True),
        folder / "diagnosis.json": json_text({**as_json(found, name, more), "tables": list(tables)}),
        folder / "diagnosis.txt": page_of(found, more) + "\n",
    }


def _mm(value: float) -> float:
    """Return a length [m] in millimetres, rounded to five decimals."""
    return round(1e3 * value, 5)
