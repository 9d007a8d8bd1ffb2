from casadical.identification.pose_selection.candidates import Circumstances as Circumstances
from casadical.identification.pose_selection.pose_search import forecast as forecast
from casadical.identification.pose_selection.pose_search import place_instrument as place_instrument
from casadical.identification.pose_selection.workspace import Workspace as Workspace
from casadical.measurements.measurements import Noise as Noise
