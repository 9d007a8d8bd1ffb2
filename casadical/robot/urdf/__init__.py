"""URDF files: reading a robot, writing a calibrated one back, and writing a new file."""

from casadical.robot.urdf.reading import read_urdf as read_urdf
from casadical.robot.urdf.writing import calibrated_urdf_text as calibrated_urdf_text
from casadical.robot.urdf.writing import new_urdf as new_urdf
from casadical.robot.urdf.writing import no_urdf_place as no_urdf_place
