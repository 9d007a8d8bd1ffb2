"""What a calibration or a diagnosis found, to look at: figures for Python, and one HTML file that needs nothing else."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .calibration import calibration_figures as calibration_figures
    from .calibration import calibration_part as calibration_part
    from .diagnosis import diagnosis_figures as diagnosis_figures
    from .diagnosis import diagnosis_part as diagnosis_part
    from .look import dark as dark
    from .page import report_html as report_html
    from .provenance import provenance_of as provenance_of

_HOME = {
    "calibration_figures": "calibration",
    "calibration_part": "calibration",
    "dark": "look",
    "diagnosis_figures": "diagnosis",
    "diagnosis_part": "diagnosis",
    "report_html": "page",
    "provenance_of": "provenance",
}
__all__ = [*_HOME]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
