"""robotkinecal: product of exponentials, four parameters an axis and the measured point, its own Gauss-Newton.

It estimates the axes in the frame of the measurements and needs a nominal robot near the truth, so the harness's
start puts the measurements into the robot's frame and the tool point onto the nominal robot. Position measurements
leave 4 x 6 + 3 = 27 parameters: all of them. Version 0.1.0 runs on a robot made of links as below without a patch.
"""

import numpy as np
import roboticstoolbox as rtb
from problem import Data, frames_start, placements
from robotkinecal import SerialRobotKineCal
from spatialmath import SE3

NEEDS = {"robotkinecal": "robotkinecal"}
VARIANTS = {"robotkinecal": {}}


def _nominal_robot(data: Data, tool):
    """Nominal arm as links of the Robotics Toolbox, with a link at the tool point."""
    links = []
    for i, T in enumerate(placements(data.dh)):
        ets = rtb.ETS([rtb.ET.SE3(SE3(T, check=False)), rtb.ET.Rz()])
        links.append(rtb.Link(ets, name=f"link{i + 1}", parent=links[-1] if links else None))
    links.append(rtb.Link(rtb.ETS([rtb.ET.SE3(SE3(*tool))]), name="tool", parent=links[-1]))
    return rtb.ERobot(links)


def contend(data: Data, clock):
    """Predicted positions (m, 3) [m] of the held-out poses."""
    np.random.seed(0)  # noqa: NPY002 - robotkinecal draws its bases from numpy's global generator
    with clock("solve"):
        R_base, t_base, tool = frames_start(data)
    with clock("build"):
        calibration = SerialRobotKineCal(_nominal_robot(data, tool), ee_name="tool")
    with clock("solve"):
        calibration.set_observations(list(data.q), list((data.p - t_base) @ R_base))
        result = calibration.solve()
    if not result.has_converged:
        raise RuntimeError(f"no convergence in {result.nb_iterations_executed} iterations")
    clock.note("parameters", calibration.N_PARAMS)
    clock.note("iterations", result.nb_iterations_executed)
    positions = [calibration.forward_kinematics(len(calibration.joints) + 1, q).t for q in data.q_held_out]
    return np.array(positions) @ R_base.T + t_base
