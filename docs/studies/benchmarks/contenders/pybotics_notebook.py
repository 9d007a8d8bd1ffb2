"""pybotics the way its calibration notebook does it: `optimize_accuracy` under scipy's `least_squares`, millimetres.

The notebook frees the joint offsets of a robot that differs in nothing else. Here more is wrong and more is free:
"pybotics" every Denavit-Hartenberg number, "pybotics-subset" those of the 27 identifiable ones that pybotics has (it
knows no Hayati beta), and in both base frame and tool point. It has no start of its own for these two and gets the
harness's.
"""

import numpy as np
from problem import PARALLEL_ROWS, Data, frames_start
from pybotics.geometry import matrix_2_vector, vector_2_matrix
from pybotics.optimization import OptimizationHandler, optimize_accuracy
from pybotics.robot import Robot
from pybotics.tool import Tool
from scipy.optimize import least_squares

NEEDS = {"pybotics": "pybotics"}
VARIANTS = {"pybotics": {"subset": False}, "pybotics-subset": {"subset": True}}


def _mask(subset):
    """Which of alpha, a, theta, d of each row to free, shape (24,)."""
    mask = np.ones((6, 4), dtype=bool)
    if subset:
        mask[0] = False  # the base frame's
        mask[5, 2:] = False  # the tool's
        mask[list(PARALLEL_ROWS), 3] = False
    return mask.ravel()


def contend(data: Data, clock, subset):
    """Predicted positions (m, 3) [m] of the held-out poses."""
    with clock("build"):
        nominal = Robot.from_parameters(data.dh * [1, 1e3, 1, 1e3])
    with clock("solve"):
        R_base, t_base, tool = frames_start(data)
        nominal.world_frame[:3] = np.column_stack([R_base, 1e3 * t_base])
        nominal.world_frame = vector_2_matrix(matrix_2_vector(nominal.world_frame))
        nominal.tool = Tool()
        nominal.tool.position = 1e3 * tool
        handler = OptimizationHandler(nominal, _mask(subset), [True] * 3 + [False] * 3, [True] * 6)
        start = handler.generate_optimization_vector()
        result = least_squares(optimize_accuracy, start, args=(handler, data.q, 1e3 * data.p))
        handler.apply_optimization_vector(result.x)
    clock.note("parameters", len(start))
    clock.note("evaluations", result.nfev)
    return np.array([1e-3 * handler.robot.fk(q)[:3, 3] for q in data.q_held_out])
