"""nice python docs/studies/tool_frames.py [ROBOTS] [SEED] | tee docs/studies/tool_frames.txt

Does the bound of `correct` hold the true error of a program's own tool, where the tool frame is wrong?

Synthetic. Each robot departs from the KR 210 or the UR10 of `problems` by a fifth of the priors of its geometry and
half of those of its springs; one reflector, anywhere on the tool, is measured at 60 poses with 0.02 mm a coordinate.
The calibrated robot corrects 40 joint targets of a program whose tool is 0.1 to 0.4 m long. The true error is the
distance of the true tool's centre from where the nominal robot has the program's, in the robot's own base frame. The
true centre is so many millimetres from where the program has it, in a random direction: flange, last row and tool may
share in that.

Rule, fixed before the study ran: of each row 95 % or more of the errors are below the bound. "Before" is the bound
without the place of the tool; "measured" has the reflector at the tool's centre, and `--tool own`.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from casadical import identify, read_robot
from casadical.core.parts import Placement
from casadical.core.transforms import frame
from casadical.export import Sources
from casadical.export.controller.correction import corrected_joints
from casadical.export.controller.programs.correction import Cell
from casadical.identification.error_bound import learn_bound
from casadical.measurements.measurements import Measurements

PROBLEMS = Path(__file__).parents[2] / "problems"
NAMES = ("kr210", "ur10")
ENDS = {"alpha0", "a0", "theta1", "d1", "theta6", "d6"}  # they say where base and flange are, not what the robot is
OFF_MM = ((0.0, 0.0), (0.5, 0.5), (1.0, 1.0), (0.0, 1.0))  # least and most of the tool frame's error
NOISE = 2e-5


def nominal_robot(name):
    """In its own base frame."""
    robot = read_robot(PROBLEMS / name / "robot.toml")
    return replace(robot, base=Placement(np.eye(4), "pose"), tool=replace(robot.tool, unknown="position"))


def true_robot(nominal, rng):
    share = {"geometry": 0.2, "loop": 0.2, "compliance": 0.5}
    values = {
        p.name: p.value + share[p.group] * p.prior * (abs(rng.normal()) if p.group == "compliance" else rng.normal())
        for p in nominal.parameters
        if p.group in share and p.name not in ENDS
    }
    return nominal.with_values(values)


def at(robot, point):
    """The robot with another measured point on its last link."""
    return replace(robot, tool=Placement(frame(np.eye(3), point), "position"))


def positions(robot, q):
    w = np.tile(robot.declared, (len(q), 1))
    return robot.model.evaluate(("p",), q, w, robot.parameters.values)[0].T


def direction(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def rigid(robot):
    return replace(robot, joints=tuple(replace(j, compliance=None) for j in robot.joints))


def one(name, rng, off_mm, measured):
    """True errors [mm] and bounds [mm], without and with the place of the tool, of one robot."""
    nominal = nominal_robot(name)
    true = true_robot(nominal, rng)
    tcp = rng.uniform(0.1, 0.4) * direction(rng)
    true_tcp = tcp + 1e-3 * rng.uniform(*off_mm) * direction(rng)
    reflector = true_tcp if measured else rng.uniform(0.05, 0.3) * direction(rng)
    lower, upper = nominal.limits
    middle, half = (lower + upper) / 2, 0.4 * (upper - lower)
    q = rng.uniform(middle - half, middle + half, (100, nominal.n))
    p = positions(at(true, reflector), q[:60]) + rng.normal(0, NOISE, (60, 3))
    found = identify(at(nominal, reflector + rng.normal(0, 2e-3, 3)), Measurements(q[:60], "position", position=p))
    real = replace(found.robot, bound=learn_bound(found))
    errors = []
    for tcp_mm in (0.0, None):
        sources = Sources(real, nominal, tool="own" if measured else "shared", tcp_mm=tcp_mm)
        corrector = Cell(sources).with_tool(frame(np.eye(3), tcp)).corrector
        new, status = corrected_joints(corrector, q[60:])
        fine = np.array(status) == "OK"
        apart = positions(at(true, true_tcp), new) - positions(at(rigid(nominal), tcp), q[60:])
        errors.append((1e3 * np.linalg.norm(apart, axis=1)[fine], corrector.bound(q[60:])[fine]))
    return errors


def main(robots, seed):
    print(f"tool frames wrong by 0 to 1 mm: {robots} robots a row, 40 targets each, seed {seed}")
    print(
        f"{'tool frame off by':<20}{'error, mm: mean, 95 %':>24}{'below the bound: before':>26}{'now':>8}"
        f"{'bound, mm':>11}"
    )
    rng = np.random.default_rng(seed)
    for measured in (False, True):
        for low, high in OFF_MM:
            parts = [one(NAMES[k % 2], rng, (low, high), measured) for k in range(robots)]
            (before, narrow), (now, wide) = (
                (np.concatenate([p[i][0] for p in parts]), np.concatenate([p[i][1] for p in parts])) for i in (0, 1)
            )
            words = f"{low:g} mm" if low == high else f"{low:g} to {high:g} mm"
            words += ", measured" if measured else ""
            print(
                f"{words:<20}{now.mean():>16.3f}{np.quantile(now, 0.95):>8.3f}{(before <= narrow).mean():>26.3f}"
                f"{(now <= wide).mean():>8.3f}{wide.mean():>11.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main(*(int(a) for a in (sys.argv[1:] + ["12", "7"][len(sys.argv) - 1 :])))
