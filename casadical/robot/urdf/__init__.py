"""URDF: a robot read, a calibrated robot written back into its file, and a new file of a robot that came from none."""

from casadical.robot.urdf.reading import read_urdf as read_urdf
from casadical.robot.urdf.writing import calibrated_urdf_text as calibrated_urdf_text
from casadical.robot.urdf.writing import new_urdf as new_urdf
