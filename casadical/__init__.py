"""casadical: robot calibration with known uncertainty.

Names are loaded when they are first used, so that ``import casadical`` costs next to nothing and a stand-alone part
(``casadical.compensator``, ``casadical.export``) never loads the kinematics.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

# Public name -> module that defines it.
_HOME = {
    "Body": "casadical.robot.robot",
    "CasadicalError": "casadical.core.errors",
    "ConvergenceError": "casadical.core.errors",
    "Diagnosis": "casadical.diagnosis.result",
    "Effect": "casadical.effects",
    "FourBar": "casadical.robot.robot",
    "Identification": "casadical.identification.identification",
    "InputError": "casadical.core.errors",
    "Joint": "casadical.robot.robot",
    "Measurements": "casadical.measurements.measurements",
    "Placement": "casadical.robot.robot",
    "Robot": "casadical.robot.robot",
    "calibrated_urdf": "casadical.robot.urdf_export",
    "diagnose": "casadical.diagnosis.diagnose",
    "from_table": "casadical.measurements.measurements",
    "identify": "casadical.identification.identification",
    "read_measurements": "casadical.measurements.measurements",
    "read_problem": "casadical.project.problem",
    "read_robot": "casadical.robot.robot_file",
    "read_urdf": "casadical.robot.urdf",
    "select_poses": "casadical.pose_selection.choice",
    "write_robot": "casadical.robot.robot_file",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'casadical' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
