"""figaroh the documented way: a URDF, a configuration file, a CSV file, a subclass with the example's cost function.

"figaroh": `structural` selection, its default. "figaroh-map": `estimation.method: map` with its default priors. Base
frame and marker are unknown (`known_baseframe`, `known_tipframe` false, as in its examples) and start from figaroh's
own closed form. The URDF has a tool frame some centimetres off: the structural selection looks at that frame, and
with one on the last axis it was seen to drop two or three parameters too many at every size tried. "solve" is
`initialize()`, which picks the parameters on the measured data, and `solve()`.
"""

import contextlib
import io
import json
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
from figaroh.calibration.base_calibration import BaseCalibration
from figaroh.calibration.calibration_tools import calc_updated_fkm
from figaroh.tools.load_robot import load_robot
from problem import Data, placements, rigid

NEEDS = {"figaroh": "figaroh"}
VARIANTS = {"figaroh": {"method": "structural"}, "figaroh-map": {"method": "map"}}

TOOL_GUESS_M = 0.05  # along x, y and z of the last joint's frame: some centimetres off, as a drawing would be

LINK = """<link name="link{i}"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>"""
JOINT = """<joint name="joint{i}" type="{kind}"><parent link="link{before}"/><child link="link{i}"/>
<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>
<limit lower="-3.15" upper="3.15" effort="100" velocity="1"/></joint>"""


class Calibration(BaseCalibration):
    """Unweighted position residuals in metres, as figaroh's UR10 example has them."""

    def cost_function(self, var):
        estimated = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
        residuals = self._compute_logmap_residuals(self.PEE_measured, estimated)
        return self.apply_measurement_weighting(residuals, pos_weight=1.0, orient_weight=0.5)


def _write_urdf(path, dh):
    parts = [LINK.format(i=0)]
    for i, T in enumerate([*placements(dh), rigid(np.zeros(3), np.full(3, TOOL_GUESS_M))], start=1):
        xyz, rpy = (" ".join(f"{x:.17g}" for x in v) for v in (T[:3, 3], pin.rpy.matrixToRpy(T[:3, :3])))
        kind = "revolute" if i <= len(dh) else "fixed"
        parts += [LINK.format(i=i), JOINT.format(i=i, kind=kind, before=i - 1, xyz=xyz, rpy=rpy)]
    path.write_text('<robot name="arm">' + "".join(parts) + "</robot>")


def _write_config(path, data: Data, csv, method):
    calibration = {
        "enabled": True,
        "parameters": {"calibration_level": "full_params", "estimation": {"method": method}},
        "kinematics": {"base_frame": "universe", "tool_frame": "link7"},
        "measurements": {"markers": [{"name": "marker", "measurable_dof": [True] * 3 + [False] * 3}]},
        "data": {"source_file": str(csv), "number_of_samples": len(data.q)},
    }
    path.write_text(json.dumps({"robot": {"name": "arm"}, "tasks": {"calibration": calibration}}))  # JSON is YAML


def contend(data: Data, clock, method):
    """Predicted positions (m, 3) [m] of the held-out poses."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        urdf, csv, config = (Path(folder) / name for name in ("arm.urdf", "poses.csv", "config.yaml"))
        columns = ["x1", "y1", "z1", *(f"joint{i}" for i in range(1, 7))]
        pd.DataFrame(np.hstack([data.p, data.q]), columns=columns).to_csv(csv, index=False)
        with clock("build"):
            _write_urdf(urdf, data.dh)
            _write_config(config, data, csv, method)
            calibration = Calibration(load_robot(str(urdf), load_by_urdf=True), str(config))
            calibration.calib_config["known_baseframe"] = False
            calibration.calib_config["known_tipframe"] = False
        with clock("solve"):
            started = time.process_time()
            calibration.initialize()
            selection = time.process_time() - started
            result = calibration.solve(enable_logging=False)
        clock.note("parameters", len(result.x))
        clock.note("of which initialize()", f"{selection:.2f} s")
        config = dict(calibration.calib_config, NbSample=len(data.q_held_out))
        predicted = calc_updated_fkm(calibration.model, calibration.data, result.x, data.q_held_out, config)
    return predicted.reshape(3, -1).T
