"""Which poses to measure, how many are enough, and the predicted accuracy."""

from casadical.measurements.noise import Noise
from casadical.pose_selection.candidates import Circumstances
from casadical.pose_selection.criteria import CRITERIA, Criterion, observability
from casadical.pose_selection.instruments import Instrument
from casadical.pose_selection.places import place_instrument
from casadical.pose_selection.pose_search import select_poses
from casadical.pose_selection.selection import Selection
from casadical.pose_selection.stopping_rule import Forecast, forecast
from casadical.pose_selection.workspace import Box, Tracker, Workspace

__all__ = [
    "CRITERIA",
    "Box",
    "Circumstances",
    "Criterion",
    "Forecast",
    "Instrument",
    "Noise",
    "Selection",
    "Tracker",
    "Workspace",
    "forecast",
    "observability",
    "place_instrument",
    "select_poses",
]
