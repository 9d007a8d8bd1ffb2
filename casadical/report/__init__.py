"""What a calibration or a diagnosis found, to look at: figures for Python, and one HTML file that needs no other."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .calibration import calibration_report as calibration_report
    from .diagnosis import diagnosis_report as diagnosis_report
    from .look import dark as dark
    from .of_calibration import calibration_figures as calibration_figures
    from .of_diagnosis import diagnosis_figures as diagnosis_figures

_HOME = {
    "calibration_figures": "of_calibration",
    "calibration_report": "calibration",
    "dark": "look",
    "diagnosis_figures": "of_diagnosis",
    "diagnosis_report": "diagnosis",
}
__all__ = [*_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; there are {', '.join(_HOME)}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
