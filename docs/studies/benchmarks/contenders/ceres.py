"""Ceres by pyceres, told the 27 parameters and given the hand-made residuals and Jacobian: what a solver costs."""

import numpy as np
import pyceres
from contenders.numpy_handmade import Told

NEEDS = {"pyceres": "pyceres"}
VARIANTS = {"ceres": {}}


class Cost(pyceres.CostFunction):
    def __init__(self, told, n):
        super().__init__()
        self.told = told
        self.set_num_residuals(3 * n)
        self.set_parameter_block_sizes([27])

    def Evaluate(self, parameters, residuals, jacobians):
        residuals[:], J = self.told(parameters[0])
        if jacobians is not None:
            jacobians[0][:] = J.ravel()
        return True


def contend(data, clock):
    with clock("solve"):
        told, step = Told(data), np.zeros(27)
        problem, options, summary = pyceres.Problem(), pyceres.SolverOptions(), pyceres.SolverSummary()
        problem.add_residual_block(cost := Cost(told, len(data.q)), None, [step])
        options.linear_solver_type, options.num_threads = pyceres.LinearSolverType.DENSE_QR, 1
        pyceres.solve(options, problem, summary)
        del problem, cost
    return told.predicted(clock, step)
