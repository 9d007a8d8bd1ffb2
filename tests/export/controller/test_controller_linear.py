"""Corrections of arms with linear joints and of arms with fewer axes than a pose needs, in Python and in C.

Positions and orientations are computed here with scipy's rotations, row by row, apart from the package's model.
"""

from dataclasses import replace

import numpy as np
import pytest
from controller_arms import poses as readings
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from casadical.core.basics import InputError
from casadical.core.parts import Joint, Placement
from casadical.core.reporting.result import plain_text
from casadical.export import Sources, Status, command_of, inverse_kinematics, model_corrector, write_c
from casadical.export.c.kernel import compilers
from casadical.export.controller.commands import measured_range, poses_of, unreached
from casadical.export.controller.correction import kernel_corrector
from casadical.export.controller.inverse import freedom_of
from casadical.export.controller.programs.correction import Cell
from casadical.export.controller.programs.fanuc import Fanuc
from casadical.export.controller.programs.krl import Krl
from casadical.export.controller.programs.program import corrected_program, read_target_program
from casadical.export.controller.programs.target import Given
from casadical.export.controller.programs.urscript import UrScript
from casadical.robot.robot import Knowledge, Robot

RIGHT = np.pi / 2
SIX = (
    Joint(d=0.4, lower=-2.8, upper=2.8),
    Joint(alpha=-RIGHT, a=0.1, lower=-2.0, upper=0.6),
    Joint(a=0.6, lower=-1.0, upper=1.6),
    Joint(alpha=-RIGHT, a=0.05, d=0.6, lower=-3, upper=3),
    Joint(alpha=RIGHT, lower=0.3, upper=2.0),
    Joint(alpha=-RIGHT, d=0.1, lower=-3, upper=3),
)
RAIL = (Joint(kind="prismatic", alpha=RIGHT, lower=0, upper=3), replace(SIX[0], alpha=-RIGHT), *SIX[1:])
SCARA = (
    Joint(d=0.4, lower=-2.3, upper=2.3),
    Joint(a=0.35, lower=0.3, upper=2.4),
    Joint(a=0.3, kind="prismatic", lower=-0.3, upper=0.0),
    Joint(lower=-3, upper=3),
)
GANTRY = (
    Joint(kind="prismatic", lower=0, upper=2),
    Joint(alpha=-RIGHT, theta=RIGHT, kind="prismatic", lower=0, upper=1.5),
    Joint(alpha=RIGHT, kind="prismatic", lower=-0.8, upper=0),
)
PLANAR = (Joint(lower=-2, upper=2), Joint(a=0.5, lower=0.3, upper=2.5))
ARMS = {"rail": RAIL, "scara": SCARA, "gantry": GANTRY, "five": SIX[:5], "planar": PLANAR}
FREEDOM = {"rail": (3, 3), "scara": (3, 1), "gantry": (3, 0), "five": (3, 2), "planar": (2, 0)}


def arm(name):
    tool = np.eye(4)
    tool[:3, 3] = (0.4, 0, 0) if name == "planar" else (0.05, 0.02, 0.2)
    return Robot(name, ARMS[name], tool=Placement(tool))


def planted(robot, seed=0):
    """Errors of a millimetre and two milliradians in every row."""
    rng = np.random.default_rng(seed)
    size = {p.name: 1e-3 if p.unit == "m" else 2e-3 for p in robot.parameters if p.group == "geometry"}
    return robot.with_values({n: robot.parameters[n].value + s * rng.normal() for n, s in size.items()})


def poses(robot, q):
    """Tool positions (k, 3) and orientations (k, 3, 3) by scipy."""
    R, p = Rotation.identity(len(q)), np.zeros((len(q), 3))
    for i, j in enumerate(robot.joints):
        slides = j.kind == "prismatic"
        for axis, angle, shift in (
            ((1, 0, 0), j.alpha, (j.a, 0, 0)),
            ((0, 1, 0), j.beta or 0.0, (0, j.b or 0.0, 0)),
            ((0, 0, 1), j.theta + (0 if slides else q[:, i]), (0, 0, 0)),
        ):
            R = R * Rotation.from_rotvec(np.outer(np.broadcast_to(angle, len(q)), axis))
            p = p + R.apply(shift)
        lift = j.d + (q[:, i] if slides else 0.0)
        p = p + R.apply([0, 0, 1]) * np.broadcast_to(lift, len(q))[:, None]
    return p + R.apply(robot.tool.T[:3, 3]), (R * Rotation.from_matrix(robot.tool.T[:3, :3])).as_matrix()


def turned(A, B):
    """Angles between orientations [rad]."""
    return np.linalg.norm(A - B, axis=(1, 2)) / np.sqrt(2)


@pytest.mark.parametrize("name", ARMS)
def test_the_freedom_of_an_arm_is_counted(name):
    assert freedom_of(arm(name)) == FREEDOM[name]


@pytest.mark.parametrize("name", ["rail", "scara", "gantry", "five"])
@pytest.mark.parametrize("orientation", [False, True])
def test_the_real_tool_is_where_the_nominal_one_would_be(name, orientation):
    nominal, q = arm(name), readings(arm(name), 200, seed=1)
    real = planted(nominal)
    dq, status = model_corrector(command_of(Sources(real, nominal), 3, orientation=orientation)).correct(q)
    ok = status == Status.OK
    assert ok.mean() > 0.8
    (wanted, R), (before, _), (after, turn) = poses(nominal, q), poses(real, q), poses(real, q + dq)
    assert np.linalg.norm(before - wanted, axis=1).mean() > 5e-4
    assert np.linalg.norm(after - wanted, axis=1)[ok].max() < 20e-6
    if orientation and FREEDOM[name][1] == 3:
        assert turned(turn, R)[ok].max() < 50e-6


@pytest.mark.parametrize("name", ["scara", pytest.param("five", marks=pytest.mark.slow)])
def test_fewer_axes_turn_the_tool_as_near_as_they_can_beside_the_position(name):
    """Against a constrained minimum by SLSQP of scipy."""
    nominal, q = arm(name), readings(arm(name), 12, seed=4)
    real = planted(nominal)
    dq, status = model_corrector(command_of(Sources(real, nominal), 4, orientation=True)).correct(q)
    ok = np.flatnonzero(status == Status.OK)
    assert len(ok) >= 8
    wanted, R = poses(nominal, q)
    for k in ok:
        best = minimize(
            lambda x, k=k: 1e6 * turned(poses(real, x[None])[1], R[k : k + 1])[0] ** 2,
            q[k] + dq[k],
            constraints={"type": "eq", "fun": lambda x, k=k: 1e3 * (poses(real, x[None])[0][0] - wanted[k])},
            method="SLSQP",
            options={"ftol": 1e-10, "maxiter": 200},
        )
        ours = turned(poses(real, (q + dq)[k : k + 1])[1], R[k : k + 1])[0]
        assert ours < 1.01 * np.sqrt(best.fun / 1e6) + 2e-5


def test_what_a_planar_arm_cannot_move_is_left_and_said():
    nominal, q = arm("planar"), readings(arm("planar"), 50, seed=1)
    real = planted(nominal)
    dq, status = model_corrector(command_of(Sources(real, nominal))).correct(q)
    assert (status == Status.OK).mean() > 0.9
    (wanted, _), (after, _) = poses(nominal, q), poses(real, q + dq)
    off = abs(after - wanted)[status == Status.OK]
    assert off[:, :2].max() < 20e-6
    assert off[:, 2].mean() > 1e-4
    assert "2 of 3 directions" in unreached(nominal)
    assert unreached(arm("scara")) == ""
    assert "orientation in 1 of 3 directions" in poses_of(arm("scara"))
    assert "in 2 of 3 directions alone is corrected" in poses_of(nominal)


def test_inverse_kinematics_of_a_rail_moves_it_in_metres():
    robot, q = planted(arm("rail")), readings(arm("rail"), 20, seed=1)
    p, R = poses(robot, q)
    found = inverse_kinematics(robot, p, R, start=q + 0.01)
    assert found.reached.all()
    assert np.linalg.norm(poses(robot, found.q)[0] - p, axis=1).max() < 2e-6


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    if not compilers():
        pytest.skip("no C compiler (gcc, clang, cc) on this machine")
    folder = tmp_path_factory.mktemp("scara")
    robot = arm("scara")
    command = command_of(Sources(planted(robot), robot), 2, orientation=True)
    write_c(replace(command, notes=("q1 = -'A1' */ here",)), folder, name="scara", vectors=500)
    return folder


def test_the_c_has_the_bits_and_says_units_freedom_and_notes(exported):
    head = (exported / "scara.h").read_text()
    assert "radians, q[2] in metres" in head
    assert "-0.3 to 0 m" in head
    assert "turned in 1 of 3 directions" in head
    assert "q1 = -'A1' * / here" in head
    assert "joint limits of the robot file" in head
    assert "radians, q[2] in metres" in (exported / "scara.st").read_text()
    robot, q = arm("scara"), readings(arm("scara"), 30, seed=1)
    kernel = kernel_corrector(exported)
    mine = model_corrector(command_of(Sources(planted(robot), robot), 2, orientation=True))
    assert kernel.units == ("rad", "rad", "m", "rad")
    assert np.array_equal(kernel.correct(q)[0], mine.correct(q)[0])


def test_a_csv_program_has_millimetres_of_a_linear_joint(exported, tmp_path):
    text = "q1_deg,q2_deg,q3_mm,q4_deg,speed\n10,60,-120,30,5\n20,70,-100,-30,5\n"
    (tmp_path / "p.csv").write_text(text)
    cell = Cell(None, folder=kernel_corrector(exported))
    program = read_target_program(tmp_path / "p.csv", Given(units=cell.units), 4)
    assert program.targets[0].si[2] == pytest.approx(-0.12)
    done = corrected_program(program, cell)
    assert all(r.fine for r in done.results)
    moved = [float(v) for v in done.content().decode().splitlines()[1].split(",")[:4]]
    found = np.array(moved) * [np.pi / 180, np.pi / 180, 1e-3, np.pi / 180]
    assert found == pytest.approx(done.results[0].q[1], abs=1e-12)
    assert "joint 3 [mm]" in plain_text(done.blocks())
    (tmp_path / "d.csv").write_text(text.replace("q3_mm", "q3_deg"))
    with pytest.raises(InputError, match="q3_mm or q3_m is missing"):
        read_target_program(tmp_path / "d.csv", Given(units=cell.units), 4)


def test_languages_read_linear_axes_in_millimetres():
    units = ("rad", "rad", "m", "rad")
    (target,) = Krl().targets("p", "PTP {A1 10, A2 60, A3 -120, A4 30}\n", Given(units=units), 4)
    assert target.si == pytest.approx([np.deg2rad(10), np.deg2rad(60), -0.12, np.deg2rad(30)])
    axes = "J1= 10.000 deg, J2= 60.000 deg, J3= -120.000 mm, J4= 30.000 deg"
    listing = f"/POS\nP[1]{{\n GP1:\n UF : 0, UT : 1,\n {axes}\n}};\n"
    (target,) = Fanuc().targets("p", listing, Given(units=units), 4)
    assert target.si[2] == pytest.approx(-0.12)
    with pytest.raises(InputError, match=r"line 2: P\[1\]: J3 is given in deg; it must be in mm"):
        Fanuc().targets("p", listing.replace("-120.000 mm", "-120.000 deg"), Given(units=units), 4)
    with pytest.raises(InputError, match="URScript has no linear axes"):
        UrScript().targets("p", "movej([0,0,0,0])\n", Given(units=units), 4)


def test_the_measured_range_is_said_where_the_robot_file_has_it():
    robot = arm("scara")
    assert measured_range(robot) == ()
    learnt = replace(robot, knowledge=Knowledge(readings=np.array([[-1, 1], [0.5, 2], [-0.2, -0.1], [-2, 2]])))
    (said,) = command_of(Sources(learnt, robot)).notes
    assert "1: -57.3 to 57.3 deg" in said
    assert "3: -200 to -100 mm" in said
