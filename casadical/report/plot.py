"""All figures of a result by one call."""

from __future__ import annotations

from typing import TYPE_CHECKING, overload

from casadical.core.errors import InputError
from casadical.diagnosis.result import Diagnosis
from casadical.fleet.changes import Comparison
from casadical.identification.result import Identification
from casadical.project.calibration import Calibration
from casadical.report.figures_of_calibration import calibration_figures
from casadical.report.figures_of_diagnosis import diagnosis_figures
from casadical.report.fit_figures import fit_figures
from casadical.report.life import comparison_figures
from casadical.report.parameter_figures import parameter_figures
from casadical.report.style import Figure

if TYPE_CHECKING:
    from casadical.diagnosis.details import Details


@overload
def plot(
    result: Calibration | Identification | Diagnosis | Comparison, name: None = None, more: Details | None = None
) -> dict[str, Figure]: ...
@overload
def plot(
    result: Calibration | Identification | Diagnosis | Comparison, name: str, more: Details | None = None
) -> Figure: ...
def plot(
    result: Calibration | Identification | Diagnosis | Comparison, name: str | None = None, more: Details | None = None
) -> Figure | dict[str, Figure]:
    """The figures of a report, as plotly makes them: one by its name, or all by name.

    Parameters
    ----------
    result : Calibration | Identification | Diagnosis | Comparison
        of `calibrate`, `identify`, `diagnose` or `casadical.fleet.compare`
    name : str, optional
        as "errors/report"; None: all figures
    more : Details, optional
        what `casadical.diagnosis.analyse` computed of a diagnosis

    Returns
    -------
    Figure | dict[str, Figure]
        a figure, or name -> figure

    Raises
    ------
    InputError
        a name that the result does not have, or plotly is not installed

    Examples
    --------
    >>> sorted(casadical.plot(calibration))[:3]
    ['distribution/identify', 'distribution/report', 'errors/identify']
    """
    if isinstance(result, Calibration):
        found = calibration_figures(result)
    elif isinstance(result, Diagnosis):
        found = diagnosis_figures(result, more)
    elif isinstance(result, Comparison):
        found = comparison_figures(result)
    else:
        found = {f"parameters/{kind}": figure for kind, figure in parameter_figures(result).items()}
        found |= {f"fit/{k}": f for k, f in fit_figures(result, {"poses that identified": result.used}).items()}
    if name is None:
        return found
    if name not in found:
        raise InputError(f"plot: {name!r} is no figure of this result; there are {', '.join(found)}")
    return found[name]
