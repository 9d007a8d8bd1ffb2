"""A diagnosis as plain data and as files to keep."""

from pathlib import Path
from typing import Any

import pandas as pd

from casadical.core.files import json_text
from casadical.diagnosis.cause_table import layers
from casadical.diagnosis.details import Details
from casadical.diagnosis.held_out_gap import NetworkGap
from casadical.diagnosis.limits import cannot_tell
from casadical.diagnosis.next_poses import discrimination_probability
from casadical.diagnosis.result import CauseSet, Diagnosis, Unlisted
from casadical.diagnosis.spectrum import as_json as curves_as_json
from casadical.diagnosis.statements import assumptions, floor_of, headline, missing_columns
from casadical.diagnosis.text import page_of
from casadical.identification.gravity import as_json as gravity_as_json
from casadical.identification.prior import Prior
from casadical.robot.robot_file import to_toml


def as_json(d: Diagnosis, campaign: str, more: Details | None = None) -> dict[str, Any]:
    """The answer in the campaigns' format; lengths in mm, readable by any tool.

    d : a diagnosis
    campaign : its name
    more : what `analyse` computed; what was not computed is left out
    """
    more = more or Details()
    poses = pd.DataFrame() if more.poses is None else more.poses
    check, networks, unlisted = more.check, more.networks, more.unlisted
    return {
        "campaign": campaign,
        **d.to_json(),
        "gap_mm": {"before": _mm(d.gap.before), "after": _mm(d.gap.after), "floor": _mm(floor_of(d, more))},
        **({} if d.p_nothing is None else {"p_nothing": d.p_nothing}),
        **({"prior": _prior(d, d.prior)} if d.prior else {}),
        **({} if d.cause_set is None else {"set": _set(d.cause_set)}),
        "unknown_rest": round(d.unknown_rest, 4),
        **({} if unlisted is None else {"unlisted": _unlisted(unlisted)}),
        **({"laws": more.laws.laws_json()} if more.laws else {}),
        "course": _records(d.course),
        **({"layers": rows} if (rows := layers(d, more.floor)) else {}),
        **({"where": {name: _records(table) for name, table in more.where.tables()}} if more.where else {}),
        "noise": {
            "sigma_mm": _mm(d.noise.sigma),
            "repeatability_urad": round(1e6 * d.noise.repeatability, 2),
            **d.account.to_json(),
            **({"form": form} if (form := d.rankings[-1].noise_form) else {}),
        },
        "replicates": {"sigma_mm": _mm(d.replicates.sigma), "poses": d.replicates.poses, "used": d.replicates.enough},
        "outliers": [{"row": o.row, "distance_mm": _mm(o.distance), "sigmas": round(o.sigmas, 2)} for o in d.outliers],
        "outlier_rows": [o.row for o in d.outliers],
        **({"outliers_along_joint": d.joint_of_outliers} if d.joint_of_outliers else {}),
        **({"assumed": list(said)} if (said := assumptions(d)) else {}),
        **({"cannot": list(missing)} if (missing := cannot_tell(d)) else {}),
        **({"ruled_out": {k: list(v) for k, v in more.ruled_out.items()}} if more.ruled_out else {}),
        **({"gravity": gravity_as_json(d.identification)} if d.identification.given.masses == "estimated" else {}),
        "missing_columns": {label: list(columns) for label, columns in missing_columns(d).items()},
        "next_measurements": _next(poses),
        **({"told_rightly": [round(p, 4) for p in discrimination_probability(d, poses)]} if len(poses) else {}),
        **({"refit_mm": {"held_out": _mm(check.refit), "linearised": _mm(check.linearised)}} if check else {}),
        **({"curves": curves_as_json(more.curves)} if more.curves else {}),
        **({"network_mm": [_network(n) for n in networks]} if networks else {}),
    }


def diagnosis_files(
    folder: str | Path, found: Diagnosis, more: Details, name: str, *, unlisted: bool = False
) -> dict[Path, str]:
    """What `casadical diagnose --out` writes, by file: the robot with its causes, all figures, and the page.

    folder : where they are to be
    found : a diagnosis
    more : what `analyse` computed
    name : of the campaign
    unlisted : whether the description of the unknown, where there is one, is in the robot's model, too
    Raises ConvergenceError: Ipopt finds no optimum of the refit.
    """
    folder = Path(folder)
    refit = found.refit(unlisted=more.unlisted if unlisted else None)
    comment = f"Diagnosed by casadical from {name}.\n{headline(found, more)}\n{refit.verdict}"
    kinds = [type(effect) for effect in refit.robot.effects]
    return {
        folder / "diagnosed.robot.toml": to_toml(refit.robot, comment, kinds, known_alone=True),
        folder / "diagnosis.json": json_text(as_json(found, name, more)),
        folder / "diagnosis.txt": page_of(found, more) + "\n",
    }


def _prior(d: Diagnosis, prior: Prior) -> dict[str, Any]:
    """What was known before, and how probably each part of it changed."""
    changed = [{"effect": c.effect, "joint": c.joint, "probability": round(c.probability, 4)} for c in d.changes]
    return {**prior.to_json([d.case.m]), "changed": changed}


def _next(poses: pd.DataFrame) -> list[dict[str, Any]]:
    """Poses that distinguish what these data cannot."""
    rows = poses.to_dict("records")
    return [{str(k): v for k, v in row.items() if v == v and v is not None} for row in rows]


def _unlisted(u: Unlisted) -> dict[str, Any]:
    return {
        "forms": list(u.labels),
        "gap_mm": {"before": _mm(u.before), "after": _mm(u.after)},
        "shrink_interval": [round(x, 4) for x in u.shrink_interval],
    }


def _network(n: NetworkGap) -> dict[str, Any]:
    return {"before": _mm(n.before), "used": _mm(n.used), "forced": _mm(n.forced), "refused": n.refused}


def _set(s: CauseSet) -> dict[str, Any]:
    members = {label: round(p, 4) for label, p in s.members.items()}
    others = [{"causes": list(labels), "probability": round(p, 4)} for labels, p in s.others]
    return {
        "probability": round(s.probability, 4),
        "one_more": round(s.one_more, 4),
        "members": members,
        "others": others,
        **(
            {"names": {k: {n: round(p, 4) for n, p in names.items()} for k, names in s.names.items()}}
            if s.names
            else {}
        ),
        **({"further": {k: round(p, 4) for k, p in s.further.items()}} if s.further else {}),
        **({"further_gap_mm": _mm(s.further_gap)} if s.further else {}),
    }


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of a table as plain data."""
    return [{str(k): v for k, v in row.items()} for row in table.round(5).to_dict("records")]


def _mm(value: float) -> float:
    return round(1e3 * value, 5)
