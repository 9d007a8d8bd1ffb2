"""The command that a robot file becomes, judged in the measuring frame where it was not made.

After correction the real tool's positions there must be the nominal ones carried by one rigid motion, the instrument's,
which Kabsch's method finds without knowing how the base was taken off.
"""

from dataclasses import replace

import numpy as np
import pytest
from controller_arms import NAMES, nominal_path, planted, poses, positions, rigid_motion

from casadical.compensator import Compensator, save_compensator
from casadical.core.basics import InputError
from casadical.core.parts import Coupling
from casadical.effects import GearEccentricity, Law, PayloadError, ThermalGrowth
from casadical.export.controller.commands import Sources, command_of, network_of
from casadical.export.controller.correction import corrected_joints, model_corrector
from casadical.export.controller.programs.correction import Cell
from casadical.robot.axes import row_matrix
from casadical.robot.robot_file import read_robot, write_robot

MICROMETRE = 1e-6
LAW = Law(2, "joint", "a * max(0, abs(tau2) - 0.3) * step(q1) + a * tanh(q4)")


@pytest.fixture(scope="module")
def compensator(tmp_path_factory):
    """A network for hh800 that adds about half a millimetre in the measuring frame."""
    q = poses(planted("hh800"), 150, seed=5)
    residual = 0.5 * np.stack([np.sin(q[:, 1]), np.cos(2 * q[:, 2]), np.sin(q[:, 0])], axis=1)
    made = Compensator.fit(q, residual, trainer="lm", folds=2)
    assert made.helps
    path = tmp_path_factory.mktemp("net") / "net.json"
    save_compensator(made, path)
    return path, made


def corrected_positions(name, sources, q, steps=3, payload_kg=None):
    """Real tool after the correction, in the measuring frame, and which rows are fine."""
    dq, status = model_corrector(command_of(sources, steps)).correct(q)
    return positions(read_robot(sources.robot), q + dq, payload_kg), status == 0, q + dq


def rigid(name, **changes):
    robot = read_robot(nominal_path(name))
    return replace(robot, joints=tuple(replace(j, compliance=None) for j in robot.joints), **changes)


@pytest.mark.parametrize("name", NAMES)
def test_where_the_instrument_stood_is_not_corrected(name, tmp_path):
    robot = planted(name, only_base=True)
    q = poses(robot, 200)
    assert np.linalg.norm(positions(robot, q) - positions(rigid(name), q), axis=1).mean() > 1e-3
    # compliance is not zero in the nominal file of no problem here, so that nothing but the base differs
    write_robot(robot, tmp_path / "moved.toml")
    command = command_of(Sources(tmp_path / "moved.toml", nominal_path(name)))
    apart = command.calibrated.map(200)(q.T).full() - command.nominal.map(200)(q.T).full()
    assert abs(apart).max() < 1e-12
    dq, _ = model_corrector(command).correct(q)
    assert abs(dq).max() < 1e-9


@pytest.mark.parametrize("name", NAMES)
def test_after_correction_the_real_tool_is_where_the_nominal_one_would_be(name, files):
    sources = Sources(files / f"{name}.toml", nominal_path(name))
    robot = read_robot(sources.robot)
    q = poses(robot, 300)
    wanted = positions(rigid(name, tool=robot.tool), q)
    before = rigid_motion(wanted, positions(robot, q))[2]
    assert before.mean() > 5e-4  # no rigid motion explains the planted errors
    after, fine, _ = corrected_positions(name, sources, q)
    assert fine.mean() > 0.9
    R, t, rest = rigid_motion(wanted[fine], after[fine])
    assert np.median(rest) < 0.1 * MICROMETRE
    assert rest.max() < 20 * MICROMETRE
    base = robot.base.T @ np.linalg.inv(rigid(name).base.T)
    if name == "hh800":
        base = row_matrix(robot.joints[0]) @ np.linalg.inv(row_matrix(rigid(name).joints[0]))
    assert pytest.approx(base[:3, :3], abs=1e-5) == R
    assert pytest.approx(base[:3, 3], abs=2e-5) == t


def test_a_robot_with_effects_in_its_model_is_corrected_like_its_file(files):
    robot = read_robot(files / "hh800.toml").with_effect(GearEccentricity(3), PayloadError(), LAW)
    values = {"gear_eccentricity@3.sin1": 300e-6, "payload_error.mass": 0.05, f"{LAW.label}.a": 200e-6}
    robot = robot.with_values(values)
    sources = Sources(robot, read_robot(nominal_path("hh800")))
    q = poses(robot, 100)
    wanted = positions(rigid("hh800", tool=robot.tool), q)
    dq, status = model_corrector(command_of(sources, 3)).correct(q)
    plain, _ = model_corrector(command_of(Sources(files / "hh800.toml", nominal_path("hh800")), 3)).correct(q)
    fine = status == 0
    assert fine.mean() > 0.9
    assert rigid_motion(wanted[fine], positions(robot, q + dq)[fine])[2].max() < 20 * MICROMETRE
    assert rigid_motion(wanted[fine], positions(robot, q + plain)[fine])[2].mean() > 100 * MICROMETRE


def test_an_effect_of_what_the_controller_does_not_know_is_refused(files):
    robot = read_robot(files / "hh800.toml").with_effect(ThermalGrowth(None, 300.0))
    with pytest.raises(InputError, match="thermal_growth: follows warmth_300s"):
        command_of(Sources(robot, nominal_path("hh800")))
    robot = read_robot(files / "hh800.toml").with_effect(Law(2, "joint", "a * step(t - 0.5)"))
    with pytest.raises(InputError, match="law at joint 2 by t: follows progress"):
        command_of(Sources(robot, nominal_path("hh800")))


def test_the_network_is_turned_from_the_measuring_frame_into_the_robots(files, compensator):
    path, made = compensator
    sources = Sources(files / "hh800.toml", nominal_path("hh800"), path)
    robot = read_robot(sources.robot)
    q = poses(robot, 300)
    q = q[made.inside(q)]
    after, fine, moved = corrected_positions("hh800", sources, q)
    wanted = positions(rigid("hh800", tool=robot.tool), q)
    with_network = after + 1e-3 * made.correction_mm(moved)
    assert rigid_motion(wanted[fine], after[fine])[2].mean() > 1e-4
    assert rigid_motion(wanted[fine], with_network[fine])[2].max() < 20 * MICROMETRE
    command = command_of(sources)
    assert (command.lower >= np.array(made.trained_box.lower) - 1e-15).all()
    assert (command.upper <= np.array(made.trained_box.upper) + 1e-15).all()
    own, nominal = (
        replace(r, joints=(replace(r.joints[0], readings=Coupling(((1, -1.0),))), *r.joints[1:]))
        for r in (robot, read_robot(nominal_path("hh800")))
    )
    assert "the network alone takes the robot file's q" in command_of(Sources(own, nominal, path)).notes[-1]


def angle(R: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Angles between orientations, each of shape (k, 3, 3) [rad], by the length of the difference."""
    return 2 * np.arcsin(np.linalg.norm(R - other, axis=(1, 2)) / np.sqrt(8))


def orientations(robot, q):
    return np.array([robot.pose(row, robot.parameters.values)[1].full() for row in q])


@pytest.mark.parametrize("orientation", [True, False])
def test_the_orientation_is_reached_where_it_is_asked_for(orientation, files, compensator):
    """With a network, and by the robots' own functions, which the correction was not made of."""
    path, made = compensator
    sources = Sources(read_robot(files / "hh800.toml"), nominal_path("hh800"), made)
    robot, q = sources.robot, poses(sources.robot, 300)
    q = q[made.inside(q)]
    dq, status = model_corrector(command_of(sources, 6, orientation=orientation)).correct(q)
    fine = status == 0
    assert fine.mean() > 0.8
    same = command_of(Sources(files / "hh800.toml", nominal_path("hh800"), path), 6, orientation=orientation)
    assert np.array_equal(model_corrector(same).correct(q)[0], dq)
    nominal = rigid("hh800", tool=robot.tool)
    turn = row_matrix(robot.joints[0])[:3, :3] @ row_matrix(nominal.joints[0])[:3, :3].T
    before = angle(turn @ orientations(nominal, q), orientations(robot, q))
    after = angle(turn @ orientations(nominal, q), orientations(robot, q + dq))[fine]
    assert before.mean() > 1e-3
    assert (after.max() < 1e-4) == orientation
    moved = positions(robot, q + dq) + 1e-3 * made.correction_mm(q + dq)
    assert rigid_motion(positions(nominal, q)[fine], moved[fine])[2].max() < 50 * MICROMETRE


def test_without_the_orientation_the_joints_change_by_the_least(files):
    """To first order the change has no part in the null space of the position's Jacobian, by finite differences."""
    sources = Sources(files / "hh800.toml", nominal_path("hh800"))
    robot = read_robot(sources.robot)
    q = poses(robot, 20)
    least, status = model_corrector(command_of(sources, 3)).correct(q)
    whole, whole_status = model_corrector(command_of(sources, 3, orientation=True)).correct(q)
    both = (status == 0) & (whole_status == 0)
    assert both.sum() > 10
    assert np.all(np.linalg.norm(least, axis=1)[both] <= np.linalg.norm(whole, axis=1)[both])
    for row, change in zip(q[both], least[both], strict=True):
        step = 1e-6 * np.eye(6)
        J = (positions(robot, row + step) - positions(robot, row - step)).T / 2e-6
        null_space = np.linalg.svd(J)[2][3:]
        assert np.abs(null_space @ change).max() < 0.02 * np.linalg.norm(change)


def test_another_payload_bends_the_arm_otherwise(files):
    sources = Sources(files / "hh800.toml", nominal_path("hh800"), payload_kg=0.0)
    robot = read_robot(sources.robot)
    assert command_of(sources).notes[-1].startswith("payload in the model: 0 kg, mass centre ")
    q = poses(robot, 200)
    wanted = positions(rigid("hh800", tool=robot.tool), q)
    empty, fine, moved = corrected_positions("hh800", sources, q, payload_kg=0.0)
    assert rigid_motion(wanted[fine], empty[fine])[2].max() < 20 * MICROMETRE
    assert rigid_motion(wanted[fine], positions(robot, moved)[fine])[2].mean() > 2e-5


@pytest.mark.parametrize("tool", ["shared", "own"])
def test_the_tool_of_the_nominal_file_counts_only_when_told(tool, files):
    sources = Sources(files / "ur10.toml", nominal_path("ur10"), tool=tool)
    robot = read_robot(sources.robot)
    q = poses(robot, 200)
    after, fine, _ = corrected_positions("ur10", sources, q)
    own, shared = (positions(r, q) for r in (rigid("ur10"), rigid("ur10", tool=robot.tool)))
    hit, missed = (own, shared) if tool == "own" else (shared, own)
    assert rigid_motion(hit[fine], after[fine])[2].max() < 20 * MICROMETRE
    assert rigid_motion(missed[fine], after[fine])[2].mean() > 1e-4


def test_what_cannot_be_one_robot_is_refused(files, tmp_path):
    ur10, hh800 = files / "ur10.toml", files / "hh800.toml"
    with pytest.raises(InputError, match="--nominal NOMINAL"):
        command_of(Sources(ur10))
    with pytest.raises(InputError, match="must be of one robot"):
        command_of(Sources(ur10, nominal_path("hh800")))
    with pytest.raises(InputError, match=r"mm from that of .*one robot"):
        command_of(Sources(ur10, nominal_path("kr210")))
    with pytest.raises(InputError, match="declares no payload"):
        command_of(Sources(ur10, nominal_path("ur10"), payload_kg=3.0))
    with pytest.raises(InputError, match="zero or more"):
        command_of(Sources(hh800, nominal_path("hh800"), payload_kg=-3.0))
    with pytest.raises(InputError, match="allowed: shared, own"):
        Sources(ur10, tool="mine")
    text = nominal_path("ur10").read_text().replace("limits_deg = [-360, 360]", 'type = "prismatic"', 1)
    (tmp_path / "slide.toml").write_text(text)
    with pytest.raises(InputError, match=r"joint 1 is prismatic, in .* revolute"):
        command_of(Sources(ur10, tmp_path / "slide.toml"))


def test_a_network_is_exported_only_where_it_helps(files, compensator, tmp_path):
    path, made = compensator
    network = network_of(Sources(files / "hh800.toml", compensator=path))
    q = poses(planted("hh800"), 20)
    assert pytest.approx(made.correction_mm(q), abs=1e-12) == network.function(q.T).full().T
    save_compensator(replace(made, network=None), tmp_path / "null.json")
    null = Sources(files / "hh800.toml", nominal_path("hh800"), tmp_path / "null.json")
    with pytest.raises(InputError, match="does not help"):
        network_of(null)
    assert command_of(null).network is None
    with pytest.raises(InputError, match="give --compensator"):
        network_of(Sources(files / "hh800.toml"))


def test_a_pose_that_cannot_be_corrected_is_corrected_in_its_position_and_says_so(files):
    sources = Sources(files / "ur10.toml", nominal_path("ur10"))
    plain = model_corrector(command_of(sources, 3))
    both = model_corrector(command_of(sources, 3, orientation=True), plain)
    q = poses(read_robot(sources.robot), 100)
    q[:50, 4] = 0.002 * np.sign(q[:50, 4])  # the axes of joints 4 and 6 are nearly parallel
    moved, names = corrected_joints(both, q)
    alone, its = corrected_joints(plain, q)
    only = np.array(names) == "POSITION_ONLY"
    assert set(np.array(names)[:50]) - {"SINGULAR", "LIMITED"} == {"POSITION_ONLY"}
    assert "SINGULAR" not in names[50:] or only[50:].mean() < 0.5
    assert np.array_equal(moved[only], alone[only])
    assert all(its[k] == "OK" for k in np.flatnonzero(only))
    assert (np.array(names) == "OK")[50:].mean() > 0.5


def test_a_measured_tool_centre_is_taken_in_a_program() -> None:
    """With --tool own the real tool stays where it was measured, and the nominal one is that of the program."""
    robot = planted("ur10")
    held = np.array(robot.tool.T)
    held[:3, 3] += (0.0008, -0.0005, 0.0006)
    q = poses(robot, 30)
    cell = Cell(Sources(robot, nominal_path("ur10"), tool="own"), steps=3)
    dq, status = cell.with_tool(held).correct(q)
    fine = status == 0
    nominal = rigid("ur10")
    T = np.array(nominal.tool.T)
    T[:3, 3] = held[:3, 3]
    wanted = positions(replace(nominal, tool=replace(nominal.tool, T=T)), q)
    assert rigid_motion(wanted[fine], positions(robot, q + dq)[fine])[2].max() < 20e-6
    shared = Cell(Sources(robot, nominal_path("ur10")), steps=3).with_tool(held)
    assert rigid_motion(wanted[fine], positions(robot, q + shared.correct(q)[0])[fine])[2].mean() > 5e-4
