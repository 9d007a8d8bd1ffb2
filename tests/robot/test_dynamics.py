"""Inverse dynamics and regressor: against Pinocchio and MuJoCo, against gravity alone; the bodies that it allows."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
import urdf_arms

from casadical import Body, FourBar, InputError, Joint, Robot, read_robot, read_urdf, write_robot
from casadical.core.drive import Drive, read_drive
from casadical.robot.dynamics import INERTIA_LOG_SIGMA, Dynamics
from casadical.robot.robot_file import robot_from

STATES = np.random.default_rng(3).normal(size=(3, 20, 7))


def arm_file(tmp_path, seed=2, n=6):
    """A URDF with inertias, turned and lumped links, and a sliding joint."""
    rng = np.random.default_rng(seed)
    parts, plain = [urdf_arms.link("base", 3.0)], 'ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"'
    for i in range(1, n + 1):
        com, rpy = rng.normal(0, 0.1, 3), rng.normal(size=3)
        d = rng.uniform(0.01, 0.02, 3)
        text = urdf_arms.link(f"l{i}", rng.uniform(0.5, 3), com, rpy)
        sizes = f'ixx="{d[1] + d[2]}" iyy="{d[0] + d[2]}" izz="{d[0] + d[1]}" ixy="0.001" ixz="-0.002" iyz="0.0005"'
        before = f"l{i - 1}" if i > 1 else "base"
        kind = "prismatic" if i == 3 else "revolute"
        at, turned, axis = rng.normal(0, 0.3, 3), rng.normal(size=3), rng.normal(size=3)
        parts += [text.replace(plain, sizes), urdf_arms.joint(f"j{i}", kind, before, f"l{i}", at, turned, axis)]
    parts += [urdf_arms.link("tip", 0.4, (0.1, 0, 0)), urdf_arms.joint("f", "fixed", f"l{n}", "tip", (0, 0, 0.1))]
    path = tmp_path / "arm.urdf"
    path.write_text(urdf_arms.robot(*parts))
    return path


def as_body(numbers: np.ndarray) -> Body:
    """The body with these ten numbers, shape (10,); its mass must not be zero."""
    mass, com = float(numbers[0]), numbers[1:4] / numbers[0]
    about = np.zeros((3, 3))
    about[np.triu_indices(3)] = numbers[4:]
    about = about + np.triu(about, 1).T
    return Body(mass, com, about - mass * (com @ com * np.eye(3) - np.outer(com, com)))


def is_physical(numbers: np.ndarray) -> bool:
    """Whether ten numbers, shape (10,), are those of a body: its pseudo-inertia is positive definite."""
    xx, xy, xz, yy, yz, zz = numbers[4:]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    pseudo = np.empty((4, 4))
    pseudo[:3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia
    pseudo[3], pseudo[:, 3] = [*numbers[1:4], 0.0], [*numbers[1:4], numbers[0]]
    pseudo[3, 3] = numbers[0]
    return bool(np.linalg.eigvalsh(pseudo)[0] > 0)


@pytest.fixture
def arm(tmp_path):
    return read_urdf(arm_file(tmp_path))


def without_rotors(dynamics):
    return np.concatenate([dynamics.values[: -dynamics.robot.n], np.zeros(dynamics.robot.n)])


def test_torque_and_regressor_are_those_of_pinocchio(tmp_path) -> None:
    import pinocchio as pin

    for seed in range(3):
        path = arm_file(tmp_path, seed)
        dynamics = Dynamics(read_urdf(path))
        model = pin.buildModelFromUrdf(str(path))
        model.gravity.linear[2] = -urdf_arms.GRAVITY
        data, n = model.createData(), dynamics.robot.n
        q, v, a = STATES[:, :, :n]
        expected = np.array([pin.rnea(model, data, *state) for state in zip(q, v, a, strict=True)])
        pi = without_rotors(dynamics)
        assert np.abs(expected).max() > 10
        assert dynamics.torque(q, v, a, pi) == pytest.approx(expected, abs=1e-10)
        assert dynamics.regressor(q, v, a) @ pi == pytest.approx(expected, abs=1e-10)
        assert dynamics.function(q[0], v[0], a[0], pi).full().ravel() == pytest.approx(expected[0], abs=1e-10)


def test_torque_is_that_of_mujoco_with_armature(tmp_path) -> None:
    import mujoco

    path = arm_file(tmp_path)
    drive = Drive(rotor_inertia_at_joint_kgm2=[0.3, 0.2, 0.1, 0.05, 0.04, 0.03])
    dynamics = Dynamics(replace(read_urdf(path), drive=drive))
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.gravity[2], model.dof_armature[:] = -urdf_arms.GRAVITY, drive.rotor_inertia_at_joint
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)
    for q, v, a in zip(*STATES[:, :, :6], strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(model, data)
        assert dynamics.torque(*(x[None] for x in (q, v, a)))[0] == pytest.approx(data.qfrc_inverse, abs=1e-10)


def test_at_rest_it_is_the_gravity_torque_of_the_pose_model() -> None:
    """Also with a four-bar, a coupled joint and a payload; signs: the drive holds what gravity pulls."""
    body = Body(4.0, np.array([0.2, 0.05, 0.01]))
    rows = [Joint(body=body), Joint(alpha=np.pi / 2, a=0.3, body=body), Joint(a=0.4, lower=0.5, upper=2.0, body=body)]
    robot = Robot("loop", (*rows, Joint(a=0.5, body=body)), loops=(FourBar(3, 2, 0.4, 0.4, 0.4),))
    robot = replace(robot, payload=Body(2.0, np.array([0.1, 0.0, 0.2])))
    q = np.array([[0.3, 0.4, 1.2, -0.5]])
    rest = np.zeros_like(q)
    expected = -robot.torque(q[0], robot.parameters.values).full().ravel()
    assert np.abs(expected).max() > 10
    assert Dynamics(robot).torque(q, rest, rest)[0] == pytest.approx(expected, abs=1e-9)


def test_four_bar_in_motion_keeps_the_balance_of_power() -> None:
    """tau . v is the growth of kinetic and potential energy, along a motion through the loop."""
    body = Body(4.0, np.array([0.2, 0.05, 0.0]), np.diag([0.02, 0.1, 0.1]))
    rows = (Joint(body=body), Joint(alpha=np.pi / 2, a=0.3, body=body), Joint(a=0.4, lower=0.5, upper=2.0, body=body))
    dynamics = Dynamics(Robot("loop", rows, loops=(FourBar(3, 2, 0.4, 0.45, 0.35),)))
    t = np.linspace(0, 1, 4001)[:, None]
    rate, size, start = np.array([[2.0, 3.0, 4.0]]), np.array([[0.5, 0.3, 0.2]]), np.array([[0.1, 0.3, 1.2]])
    q, v, a = start + size * np.sin(rate * t), size * rate * np.cos(rate * t), -size * rate**2 * np.sin(rate * t)
    rest = np.zeros_like(q)
    power = (dynamics.torque(q, v, a) * v).sum(axis=1)
    kinetic = sum(
        0.5 * v[:, k] * v[:, j] * dynamics.torque(q, rest, np.eye(3)[[j]] + rest, gravity=np.zeros(3))[:, k]
        for k in range(3) for j in range(3)
    )  # fmt: skip
    lifted = (dynamics.torque(q, rest, rest) * v).sum(axis=1)
    grown = np.gradient(kinetic, t[1, 0]) + lifted
    assert np.abs(power[2:-2] - grown[2:-2]).max() < 1e-4 * np.abs(power).max()


def test_coupled_joint_loads_the_one_that_it_follows(tmp_path) -> None:
    path = arm_file(tmp_path)
    free = read_urdf(path)
    end = '  </joint>\n  <link name="l3'
    path.write_text(path.read_text().replace(end, f'<mimic joint="j1" multiplier="-0.5"/>{end}'))
    coupled = read_urdf(path)
    assert coupled.joints[1].coupling is not None
    q, v, a = STATES[:, :, :6].copy()
    for x in (q, v, a):
        x[:, 1] = -0.5 * x[:, 0]
    pi = without_rotors(Dynamics(free))
    own, borne = Dynamics(free).torque(q, v, a, pi), Dynamics(coupled).torque(q, v, a, pi)
    assert borne[:, 0] == pytest.approx(own[:, 0] - 0.5 * own[:, 1], abs=1e-9)
    assert borne[:, 1] == pytest.approx(np.zeros(20), abs=1e-12)


def test_all_coordinates_lead_to_bodies(arm) -> None:
    import pinocchio as pin

    dynamics = Dynamics(arm)
    rng = np.random.default_rng(0)
    for size in (0.0, 1.0, 5.0):
        pi = dynamics.at(size * dynamics.sigma * rng.normal(size=len(dynamics.sigma)))
        bodies = pi[: 10 * arm.n].reshape(-1, 10)
        assert all(map(is_physical, bodies))
        assert all(np.linalg.eigvalsh(pin.Inertia(b.mass, b.com, b.inertia).toPseudoInertia().toMatrix())[0] > 0
                   for b in map(as_body, bodies))  # fmt: skip
        assert (pi[10 * arm.n :] > 0).all()
    assert not is_physical(np.array([1.0, 0, 0, 0, 1, 0, 0, 1, 0, 3]))
    heavier = dynamics.at(np.eye(len(dynamics.sigma))[0] * np.log(1.1) / 2)
    assert heavier[:10] == pytest.approx(1.1 * dynamics.values[:10])
    wider = dynamics.at(np.r_[np.zeros(4), dynamics.sigma[4:7], np.zeros(11 * arm.n - 7)])
    moments = as_body(wider[:10]).inertia, as_body(dynamics.values[:10]).inertia
    assert moments[0] == pytest.approx(np.exp(INERTIA_LOG_SIGMA) * moments[1])  # one sigma of their logarithm
    step = 1e-4 * rng.normal(size=len(dynamics.sigma))
    assert dynamics.at(step) - dynamics.values == pytest.approx(dynamics.tangent @ step, abs=1e-6)


def test_robot_file_keeps_inertias_and_drive(arm, tmp_path) -> None:
    drive = Drive(
        servo="P", kp_Nm_per_rad=[10, 20, 30, 4, 5, 6.5], gear_ratio=101.0, torque_constant_Nm_per_A=0.1,
        rotor_inertia_kgm2=1e-4, encoder_side="motor", delay_s=0.004, command_filter_ms=3.0, log_rate_Hz=125,
    )  # fmt: skip
    robot = replace(arm, drive=drive)
    write_robot(robot, tmp_path / "robot.toml")
    again = read_robot(tmp_path / "robot.toml")
    assert again.drive == drive
    assert again.drive.command_filter == pytest.approx(0.003)
    assert again.drive.torque_per_ampere(6) == pytest.approx([10.1] * 6)
    assert again.drive.inertia_at_joint(6) == pytest.approx([1.0201] * 6)
    assert again.drive.of_joints("ki", 6) is None
    assert Dynamics(again).values == pytest.approx(Dynamics(robot).values, rel=1e-9, abs=1e-12)
    write_robot(again, tmp_path / "second.toml")
    first, second = (tomllib.loads((tmp_path / f"{name}.toml").read_text()) for name in ("robot", "second"))
    assert first["drive"] == second["drive"]
    assert first["drive"]["kp_Nm_per_rad"] == [10, 20, 30, 4, 5, 6.5]


def test_drive_beside_a_log(tmp_path) -> None:
    path = tmp_path / "drive.toml"
    path.write_text("[drive]\nkp_Nm_per_rad = [10, 20]\n")
    assert read_drive(path, 2).kp == [10, 20]
    with pytest.raises(InputError, match=r"drive.toml: drive.kp: has 2 numbers; allowed: one, or one for each of 3"):
        read_drive(path, 3)
    path.write_text("kp = 3")
    with pytest.raises(InputError, match=r"has no table \[drive\]"):
        read_drive(path, 2)


def test_inertia_that_no_body_has_is_refused_in_a_robot_file_and_unknown_in_a_urdf(tmp_path) -> None:
    table = {
        "casadical": 1,
        "name": "x",
        "joint": [{"body": {"mass_kg": 1.0, "inertia_kgm2": [1.0, 0, 0, 1.0, 0, 3.0]}}],
    }
    with pytest.raises(InputError, match=r"joint\[1\].body.inertia_kgm2.*no body has such moments"):
        robot_from(table, "robot.toml")
    path = arm_file(tmp_path)
    path.write_text(path.read_text().replace('ixy="0.001"', 'ixy="5"', 1))
    robot = read_urdf(path)
    assert "no body has the inertia of l1: it is taken as unknown" in robot.notes
    assert robot.joints[0].body.inertia is None
    assert robot.joints[1].body.inertia is not None


def test_a_robot_without_masses_gets_estimates(tmp_path) -> None:
    robot = read_robot("problems/planar/robot.toml")
    bare = replace(robot, joints=tuple(replace(j, body=None) for j in robot.joints))
    dynamics = Dynamics(bare)
    assert dynamics.robot.masses == "estimated"
    assert all(map(is_physical, dynamics.values[:20].reshape(-1, 10)))
    assert dynamics.sigma[0] == 1.0
