"""Selection of poses to measure, their number, and the accuracy to expect."""

from casadical.measurements.measurements import Noise
from casadical.pose_selection.candidates import Circumstances
from casadical.pose_selection.pose_search import forecast, place_instrument
from casadical.pose_selection.workspace import Workspace

__all__ = ["Circumstances", "Noise", "Workspace", "forecast", "place_instrument"]
