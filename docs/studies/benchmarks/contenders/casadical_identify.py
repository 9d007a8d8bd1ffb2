"""casadical as its users call it: nominal rows in, everything else decided by `identify`.

Its solve holds everything: checks, closed-form start, choice of the identifiable parameters, Ipopt, the second look at
poorly determined ones. "compiled" lets kernels and model go through the C compiler at any size; what was compiled stays
on disk, so "first" pays for the compiler and later runs do not.
"""

import numpy as np

NEEDS = {"casadical": "casadical"}
VARIANTS = {"casadical": {"compile_from": 1000000000}, "casadical-compiled": {"compile_from": 1}}


def contend(data, clock, compile_from):
    import casadical
    from casadical.core import mapped_function
    from casadical.identification.accuracy import predicted

    mapped_function.LIBRARY_LOOKUP_POINTS = mapped_function.COMPILATION_POINTS = compile_from
    with clock("build"):
        joints = tuple(casadical.Joint(*row, lower=-7.0, upper=7.0) for row in data.dh)
        unknown = casadical.Placement(np.eye(4), "pose"), casadical.Placement(np.eye(4), "position")
        robot = casadical.Robot("UR10-like", joints, *unknown)
    with clock("solve"):
        measured = casadical.Measurements(q=data.q, kind="position", position=data.p)
        result = casadical.identify(robot, measured, ["kinematic"], loss="linear")  # as all the others
    clock.note("parameters", len(result.names))
    positions, _ = predicted(
        result.robot,
        casadical.Measurements(q=data.q_held_out, kind="position", position=np.zeros((len(data.q_held_out), 3))),
    )
    return positions
