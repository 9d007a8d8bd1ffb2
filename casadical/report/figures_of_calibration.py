"""Every figure of a calibration's report."""

from casadical.project.calibration import Calibration
from casadical.project.remaining_errors import SETS, pose_errors, where_left
from casadical.report.error_figures import error_distribution, errors_by_pose
from casadical.report.fit_figures import fit_figures
from casadical.report.parameter_figures import parameter_figures
from casadical.report.share_figures import where_figure
from casadical.report.style import Figure
from casadical.report.training import training_history
from casadical.report.workspace import workspace


def calibration_figures(calibration: Calibration) -> dict[str, Figure]:
    """Every figure of a calibration's report, by name.

    errors/SET and distribution/SET for each set of poses; workspace; where/TABLE as `Diagnosis.where` names them (of
    measured positions); parameters/lengths, /angles, /compliance; fit/residuals, /coverage, /pairs; training. What the
    data do not hold is not there.

    Parameters
    ----------
    calibration : Calibration
        of `casadical.calibrate`

    Returns
    -------
    dict[str, Figure]
        name -> figure of plotly

    Raises
    ------
    InputError
        where plotly is not installed

    Examples
    --------
    >>> "errors/report" in casadical.report.calibration_figures(calibration)
    True
    """
    poses = pose_errors(calibration)
    found: dict[str, Figure] = {}
    for name, of_set in poses.items():
        found[f"errors/{name}"] = errors_by_pose(of_set)
        found[f"distribution/{name}"] = error_distribution(of_set)
    spatial = next((p for p in poses.values() if p.position is not None), None)
    if spatial is not None:
        found["workspace"] = workspace(spatial, calibration.robot)
    gap = where_left(calibration)
    if gap is not None:
        found |= {f"where/{name}": where_figure(name, table) for name, table in gap.tables()}
    found |= {f"parameters/{kind}": figure for kind, figure in parameter_figures(calibration.identification).items()}
    sets = {SETS.get(name, name): parts for name, parts in calibration.problem.sets.items()}
    found |= {f"fit/{kind}": figure for kind, figure in fit_figures(calibration.identification, sets).items()}
    networks = calibration.networks
    if networks and any(r.compensator for r in networks.results.values()):
        found["training"] = training_history(networks)
    return found
