"""Which poses to measure, how many are enough, and what accuracy to expect before and while measuring."""

from .candidates import Circumstances
from .choice import select_poses
from .criteria import CRITERIA, Criterion, observability
from .information import Noise
from .selection import Selection
from .stopping import Forecast, forecast
from .workspace import Box, Tracker, Workspace

__all__ = [
    "CRITERIA",
    "Box",
    "Circumstances",
    "Criterion",
    "Forecast",
    "Noise",
    "Selection",
    "Tracker",
    "Workspace",
    "forecast",
    "observability",
    "select_poses",
]
