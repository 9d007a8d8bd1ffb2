"""Every figure of a calibration's report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from casadical.diagnosis.cross_validation import Noise
from casadical.diagnosis.linear_problem import make_case
from casadical.diagnosis.localisation import Where, where
from casadical.identification.identification import Identification
from casadical.project.networks import Networks
from casadical.project.problem import Problem
from casadical.report.error_figures import error_distribution, errors_by_pose
from casadical.report.parameter_figures import parameter_figures
from casadical.report.pose_errors import PoseErrors, pose_errors
from casadical.report.share_figures import where_figure
from casadical.report.training import training_history
from casadical.report.workspace import workspace

if TYPE_CHECKING:
    import plotly.graph_objects as go

Results = Mapping[str, Identification]


def calibration_figures(problem: Problem, results: Results, networks: Networks | None = None) -> dict[str, go.Figure]:
    """Every figure of a calibration's report, by name.

    problem, results, networks : as `calibrate_problem` and `problem_networks` give them

    errors/SET and distribution/SET for each set of poses; workspace; where/TABLE as `Diagnosis.where` names them (of
    measured positions); parameters/lengths, /angles, /compliance; training. What the data do not hold is not there.
    Raises InputError where plotly is not installed.
    """
    poses = pose_errors(problem, results, networks)
    found: dict[str, go.Figure] = {}
    for name, of_set in poses.items():
        found[f"errors/{name}"] = errors_by_pose(of_set)
        found[f"distribution/{name}"] = error_distribution(of_set)
    last = last_of(results)
    spatial = _in_space(poses)
    if spatial is not None:
        found["workspace"] = workspace(spatial, last.robot)
    gap = where_left(last)
    if gap is not None:
        found |= {f"where/{name}": where_figure(name, table) for name, table in gap.tables()}
    found |= {f"parameters/{kind}": figure for kind, figure in parameter_figures(last).items()}
    if networks and any(r.compensator for r in networks.results.values()):
        found["training"] = training_history(networks)
    return found


def where_left(result: Identification) -> Where | None:
    """Where the error that an identification left lies; None unless it is of one set of measured positions."""
    if len(result.measurements) != 1 or result.measurements[0].position is None:
        return None
    return where(make_case(result, ()), Noise(result.sigmas[0][0], 0.0))


def last_of(results: Results) -> Identification:
    """The method that counts: the last one asked for."""
    return list(results.values())[-1]


def _in_space(poses: Mapping[str, PoseErrors]) -> PoseErrors | None:
    return next((p for p in poses.values() if p.position is not None), None)
