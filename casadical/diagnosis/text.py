"""Text of a diagnosis for a terminal, full or short; its data for JSON; its files."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from casadical.core.files import json_text
from casadical.core.reporting.blocks import Table, Words, cut, mm
from casadical.core.reporting.plain import plain
from casadical.core.reporting.result import plain_text
from casadical.diagnosis.details import Details
from casadical.diagnosis.isolability import cannot_tell
from casadical.diagnosis.joint_curves import CURVE_COLUMNS, curve_of, curve_rows
from casadical.diagnosis.next_poses import discrimination_probability
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.statements import (
    LAYER_COLUMNS,
    SUBJECTS,
    Statement,
    assumptions,
    cause_rows,
    floor_of,
    headline,
    layer_rows,
    layers,
    missing_columns,
    readings_of,
    statements,
)
from casadical.identification.gravity import as_json as gravity_as_json
from casadical.robot.robot_file import robot_files

# Largest width of the full report on a terminal [characters].
PAGE_WIDTH = 112


def page_of(d: Diagnosis, more: Details | None = None) -> str:
    """Return the full report as plain text, at most `PAGE_WIDTH` characters wide (see `detailed`).

    Examples
    --------
    >>> print(casadical.diagnosis.page_of(diagnosis).splitlines()[0])
    VERDICT  explained: gear_eccentricity@2; 0.081 -> 0.037 mm, noise alone would leave 0.033
    """
    return "\n".join(line.rstrip() for line in plain_text(detailed(d, more), PAGE_WIDTH).splitlines())


def detailed(d: Diagnosis, more: Details | None = None) -> Sequence[Words | Table]:
    """Return the full report as blocks: statements by topic, each table after its introduction.

    more : result of `analyse`; None for a report of the diagnosis alone
    """
    blocks: list[Words | Table] = []
    rows: list[tuple[str, str]] = []
    last = ""
    for s in statements(d, more):
        # The label of these topics precedes each of their statements, not only the first.
        rows.append((f"{s.about if s.about != last or s.about in ('CANNOT', 'MISSING') else '':<7}", s.text))
        tables: list[Table] = []
        if s.about == "WHICH" and d.causes:
            tables = [*_sized(d)]
            if more and more.curves and curve_of(d.causes):
                tables.append(Table("", CURVE_COLUMNS, curve_rows(more.curves), frozenset({0, 1, 2})))
        if s.about == "LAYERS":
            tables = [Table("", LAYER_COLUMNS, layer_rows(d, floor_of(d, more)), frozenset({1, 2, 3, 4}))]
        if tables:
            blocks, rows = [*blocks, Table("", ("", ""), rows), *tables], []
        last = s.about
    return [*blocks, Table("", ("", ""), rows)] if rows else blocks


def _sized(d: Diagnosis) -> Iterator[Table]:
    """Yield the table of the causes: signature, label, parameters, posterior, gap and shrink."""
    rows = []
    for k, r in enumerate(cause_rows(d), 1):
        sizes = (
            f"{name} {value} +- {error} {unit}" if error else f"{name} {value} {unit}"
            for name, value, error, unit in r.parameters
        )
        words = [r.shown, r.named, ", ".join(size.rstrip() for size in sizes)]
        rows.append((str(k), "\n".join(filter(None, words)), f"{r.cause.confidence:.2f}", r.gap, r.shrinks))
    yield Table("", ("", "signature", "posterior", "gap if added", "shrinks by, 95 %"), rows, frozenset({0, 2, 3, 4}))


def brief(title: str, d: Diagnosis, more: Details | None = None) -> Sequence[Words | Table]:
    """Return the short answer as blocks, meant to be about 25 lines of 100 columns.

    It has title, verdict, error before and after, causes, and the statements of `things_to_know`.
    """
    sentences = statements(d, more)
    return [
        Words(title, "title"),
        Words(sentences[0].sentence, "verdict"),
        _errors(d, more),
        *_causes(d),
        *(Words(cut(s.sentence, 290), "warning" if s.doubtful else "note") for s in things_to_know(d, sentences)),
    ]


def _errors(d: Diagnosis, more: Details | None) -> Table:
    """Return the table of mean held-out errors before and after causes, and of noise [mm]."""
    rows = [("before, outliers in", mm(d.gap.before))] if d.gap.before > d.gap.without_outliers else []
    rows += [("before: calibrated, without causes", mm(d.gap.without_outliers))]
    rows += [("after: with the causes in the model", mm(d.gap.after))] if d.effects() else []
    rows += [("noise alone would leave", mm(floor_of(d, more)))]
    title = f"Mean error on {int(d.case.inliers.sum())} held-out poses{readings_of(d)} [mm]"
    return Table(title, ("model", "mean"), rows, frozenset({1}))


def _causes(d: Diagnosis) -> Iterator[Table | Words]:
    """Yield a table of the first six causes and the number of further ones; nothing without any."""
    rows = [(r.cause.label, f"{r.cause.confidence:.2f}", r.shrinks, r.shown) for r in cause_rows(d)]
    if rows:
        columns = ("cause", "probability", "reduction, 95 %", "what the data show")
        yield Table("", columns, rows[:6], frozenset({1, 2}))
    if len(rows) > 6:
        yield Words(f"and {len(rows) - 6} more")


def things_to_know(d: Diagnosis, every: Sequence[Statement]) -> list[Statement]:
    """Return at most three statements of different topics, warnings first, and one on the noise.

    every : all statements; topics are ordered as in `SUBJECTS`, which has all that may be chosen
    """
    of_each: dict[str, Statement] = {}
    for s in every:
        previous = of_each.get(s.about)
        # Of the topics CANNOT, AFTER and SET only doubts are shown.
        if (
            s.about in SUBJECTS
            and (s.doubtful or s.about not in ("CANNOT", "AFTER", "SET"))
            and (previous is None or s.doubtful)
        ):
            of_each[s.about] = previous if previous and previous.doubtful else s
    if d.verdict == "none":
        of_each.pop("WHERE", None)
    first = sorted(of_each.values(), key=lambda s: (not s.doubtful, [*SUBJECTS].index(s.about)))[:3]
    return [*first, *[s for s in every if s.about == "NOISE" and s not in first][:1]]


def as_json(d: Diagnosis, campaign: str, more: Details | None = None) -> dict[str, Any]:
    """Return the diagnosis as data for JSON; keys name their units, lengths are in mm.

    campaign : name of the campaign
    more : result of `analyse`; analyses that were not computed are omitted
    """
    more = more or Details()
    poses, curved = pd.DataFrame() if more.poses is None else more.poses, curve_of(d.causes)
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
        "curves": {"joints": more.curves, "harmonics": curved.orders} if curved and more.curves else None,
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
