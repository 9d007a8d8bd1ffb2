"""What a calibration or a diagnosis found, to look at: figures for Python, and one HTML file that needs no other."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from casadical.report.calibration import calibration_report as calibration_report
    from casadical.report.diagnosis import diagnosis_report as diagnosis_report
    from casadical.report.figures_of_calibration import calibration_figures as calibration_figures
    from casadical.report.figures_of_diagnosis import diagnosis_figures as diagnosis_figures
    from casadical.report.style import dark as dark

_HOME = {
    "calibration_figures": "figures_of_calibration",
    "calibration_report": "calibration",
    "dark": "style",
    "diagnosis_figures": "figures_of_diagnosis",
    "diagnosis_report": "diagnosis",
}
__all__ = [*_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; there are {', '.join(_HOME)}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
