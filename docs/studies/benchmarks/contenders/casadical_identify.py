"""casadical as its users call it: nominal rows in, everything else decided by `identify`.

Its solve holds everything: checks, closed-form start, choice of the identifiable parameters, Ipopt, the second look at
poorly determined ones. Nothing is compiled: a rigid chain is evaluated by numpy.
"""

import numpy as np

import casadical
from casadical.identification.accuracy import predicted
from casadical.identification.identification import identify

NEEDS = {"casadical": "casadical"}
VARIANTS = {"casadical": {}}


def contend(data, clock):
    with clock("build"):
        joints = tuple(casadical.Joint(*row, lower=-7.0, upper=7.0) for row in data.dh)
        unknown = casadical.Placement(np.eye(4), "pose"), casadical.Placement(np.eye(4), "position")
        robot = casadical.Robot("UR10-like", joints, *unknown)
    with clock("solve"):
        measured = casadical.Measurements(q=data.q, kind="position", position=data.p)
        result = identify(robot, measured, ["kinematic"], loss="linear")  # as all the others
    clock.note("parameters", len(result.names))
    positions, _ = predicted(
        result.robot,
        casadical.Measurements(q=data.q_held_out, kind="position", position=np.zeros((len(data.q_held_out), 3))),
    )
    return positions
