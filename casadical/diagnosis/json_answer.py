"""A diagnosis as plain data and as files to keep."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from casadical.core.files import json_text
from casadical.diagnosis.cause_table import layers
from casadical.diagnosis.details import Details
from casadical.diagnosis.held_out_gap import NetworkGap
from casadical.diagnosis.isolability import cannot_tell
from casadical.diagnosis.next_poses import discrimination_probability
from casadical.diagnosis.result import CauseSet, Diagnosis, Unlisted
from casadical.diagnosis.statements import assumptions, floor_of, headline, missing_columns
from casadical.diagnosis.text import page_of
from casadical.identification.gravity import as_json as gravity_as_json
from casadical.robot.robot_file import to_toml


def as_json(d: Diagnosis, campaign: str, more: Details | None = None) -> dict[str, Any]:
    """The answer in the campaigns' format; lengths in mm, readable by any tool.

    campaign : its name; more : of `analyse`; what was not computed is left out
    """
    more = more or Details()
    poses = pd.DataFrame() if more.poses is None else more.poses
    check, changed = more.check, rounded([vars(c) for c in d.changes])
    return {
        "campaign": campaign,
        **d.to_json(),
        "gap_mm": {"before": _mm(d.gap.before), "after": _mm(d.gap.after), "floor": _mm(floor_of(d, more))},
        **({} if d.p_nothing is None else {"p_nothing": d.p_nothing}),
        **({"prior": {**d.prior.to_json([d.case.m]), "changed": changed}} if d.prior else {}),
        **({} if d.cause_set is None else {"set": _set(d.cause_set)}),
        "unknown_rest": round(d.unknown_rest, 4),
        **({"unlisted": _unlisted(more.unlisted)} if more.unlisted else {}),
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
        "next_measurements": [
            {str(k): v for k, v in row.items() if v == v and v is not None} for row in poses.to_dict("records")
        ],
        **({"told_rightly": rounded(discrimination_probability(d, poses))} if len(poses) else {}),
        **({"refit_mm": {"held_out": _mm(check.refit), "linearised": _mm(check.linearised)}} if check else {}),
        **({"curves": more.curves.to_json()} if more.curves else {}),
        **({"network_mm": [_network(n) for n in more.networks]} if more.networks else {}),
    }


def diagnosis_files(
    folder: str | Path, found: Diagnosis, more: Details, name: str, *, unlisted: bool = False
) -> dict[Path, str]:
    """What `casadical diagnose --out` writes, by file: the robot with its causes, all figures, and the page.

    more : of `analyse`; name : of the campaign
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


def _unlisted(u: Unlisted) -> dict[str, Any]:
    gap = {"before": _mm(u.before), "after": _mm(u.after)}
    return {"forms": list(u.labels), "gap_mm": gap, "shrink_interval": rounded(u.shrink_interval)}


def _network(n: NetworkGap) -> dict[str, Any]:
    return {"before": _mm(n.before), "used": _mm(n.used), "forced": _mm(n.forced), "refused": n.refused}


def _set(s: CauseSet) -> dict[str, Any]:
    others = [{"causes": labels, "probability": p} for labels, p in s.others]
    known: dict[str, Any] = {name: getattr(s, name) for name in ("probability", "one_more", "members")}
    known |= {"others": others, **{name: value for name in ("names", "further") if (value := getattr(s, name))}}
    return {**rounded(known), **({"further_gap_mm": _mm(s.further_gap)} if s.further else {})}


def rounded(value: Any) -> Any:
    """Plain data, probabilities and shares in it to four digits."""
    if isinstance(value, Mapping):
        return {key: rounded(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(part) for part in value]
    return round(value, 4) if isinstance(value, float) else value


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of a table as plain data."""
    return [{str(k): v for k, v in row.items()} for row in table.round(5).to_dict("records")]


def _mm(value: float) -> float:
    return round(1e3 * value, 5)
