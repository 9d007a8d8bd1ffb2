"""Which poses to measure, how many are enough, and the predicted accuracy."""

from casadical.measurements.measurements import Noise
from casadical.pose_selection.candidates import Circumstances
from casadical.pose_selection.pose_search import forecast, place_instrument
from casadical.pose_selection.workspace import Workspace

__all__ = ["Circumstances", "Noise", "Workspace", "forecast", "place_instrument"]
