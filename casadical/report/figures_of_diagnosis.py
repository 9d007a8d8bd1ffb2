"""Every figure of a diagnosis' report."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.cross_validation import fitted_without, partitioned_errors
from casadical.identification.result import LeftOut
from casadical.project.remaining_errors import ModelErrors, PoseErrors
from casadical.report.cause_figures import gap_course, posteriors, shrinks
from casadical.report.curve_figures import curve_figures
from casadical.report.error_figures import errors_by_pose
from casadical.report.fit_figures import fit_figures
from casadical.report.parameter_figures import parameter_figures
from casadical.report.share_figures import where_figure
from casadical.report.style import Figure
from casadical.report.workspace import workspace

if TYPE_CHECKING:
    from casadical.diagnosis.details import Details
    from casadical.diagnosis.result import Diagnosis

BASE, WITH = "base model", "with causes"


def diagnosis_figures(d: Diagnosis, more: Details | None = None) -> dict[str, Figure]:
    """Every figure of a diagnosis' report, by name.

    gap; errors (held out, pose by pose); workspace; causes/STEP; shrink (where a cause was found); parameters/lengths,
    /angles, /compliance; fit/residuals, /coverage, /pairs; of `analyse` where/TABLE as `Localisation` names them,
    curves/angles and /lines, and networks beside the gap.

    Parameters
    ----------
    d : Diagnosis
        a diagnosis
    more : Details, optional
        what `casadical.diagnosis.analyse` computed of it

    Returns
    -------
    dict[str, Figure]
        name -> figure of plotly

    Raises
    ------
    InputError
        without plotly

    Examples
    --------
    >>> "gap" in casadical.report.diagnosis_figures(diagnosis)
    True
    """
    poses = held_out_poses(d)
    found = {
        "gap": gap_course(d, more.networks if more else None),
        "errors": errors_by_pose(poses, d.gap.floor),
        "workspace": workspace(fitted_poses(d), d.identification.robot),
    }
    if more and more.where:
        found |= {f"where/{name}": where_figure(name, table) for name, table in more.where.tables()}
    if more and more.curves:
        found |= {f"curves/{name}": figure for name, figure in curve_figures(more.curves).items()}
    found |= {f"causes/{k + 1}": posteriors(d, k) for k in range(len(d.rankings))}
    if d.effects():
        found["shrink"] = shrinks(d)
    found |= {f"parameters/{k}": f for k, f in parameter_figures(d.identification).items()}
    measured = {"poses of the campaign": (d.case.m[d.case.kept],)}
    rest = _left(d)
    measured_numbers = d.case.evidence.measured
    rest = rest if measured_numbers is None else rest[measured_numbers]
    fit = fit_figures(d.identification, measured, rest / float(np.sqrt((rest**2).mean())))
    return found | {f"fit/{k}": f for k, f in fit.items()}


def held_out_poses(d: Diagnosis) -> PoseErrors:
    """Held-out error of every pose that is no outlier: base model, and with the causes in it."""
    e, none = d.case.evidence, np.zeros(0, dtype=np.int64)
    models = [ModelErrors(BASE, partitioned_errors(e, none, d.rankings[0].noise[""], d.seed))]
    if d.columns.size:
        models.append(ModelErrors(WITH, partitioned_errors(e, d.columns, d.noise, d.seed)))
    return _poses(d, tuple(models), "Held-out poses")


def _left(d: Diagnosis) -> Array:
    """What a fit of base model and causes to all poses leaves at each, shape (kept, numbers)."""
    k = d.case.kept
    return fitted_without(d.case.whole, d.columns, d.noise, ~k)[k] if d.columns.size else d.case.evidence.r


def fitted_poses(d: Diagnosis) -> PoseErrors:
    """What a fit to all poses leaves at each, as vectors: base model, and with the causes in it."""
    base, vectors = d.case.lengths, d.case.vectors
    models = [ModelErrors(BASE, np.linalg.norm(base, axis=1), vectors)]
    if d.columns.size:
        rest = _left(d)
        size = d.case.evidence.size
        length = np.linalg.norm(rest if size is None else rest * size, axis=1)
        models.append(ModelErrors(WITH, length, None if vectors is None else rest[:, :3]))
    return _poses(d, tuple(models), "All poses fitted")


def _poses(d: Diagnosis, models: tuple[ModelErrors, ...], name: str) -> PoseErrors:
    m, k = d.case.m, d.case.kept
    out = tuple(LeftOut(m.source, o.row, o.distance) for o in d.outliers)
    return PoseErrors(name, name.startswith("Held"), m.row[k], m.q[k], d.case.positions[k], models, m.source, out)
