"""Which poses to measure, how many are enough, and the predicted accuracy."""

from casadical.measurements.noise import Noise
from casadical.pose_selection.candidates import Circumstances
from casadical.pose_selection.places import place_instrument
from casadical.pose_selection.stopping_rule import forecast
from casadical.pose_selection.workspace import Workspace

__all__ = ["Circumstances", "Noise", "Workspace", "forecast", "place_instrument"]
