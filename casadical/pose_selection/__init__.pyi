from casadical.measurements.measurements import Noise as Noise
from casadical.pose_selection.candidates import Circumstances as Circumstances
from casadical.pose_selection.pose_search import forecast as forecast
from casadical.pose_selection.pose_search import place_instrument as place_instrument
from casadical.pose_selection.workspace import Workspace as Workspace
