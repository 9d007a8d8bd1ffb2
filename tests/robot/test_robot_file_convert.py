"""Robot files: standard rows against direct matrices in numpy, round trips, units by key, loops, prismatic joints."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from numeric_arm import shift, turn
from scipy.spatial.transform import Rotation

from casadical import Body, FourBar, Joint, Placement, Robot
from casadical.core.drive import Drive
from casadical.core.parts import WIDTHS, Width
from casadical.robot.robot_file import read_robot, robot_from, write_robot

GRAVITY = np.array([0.0, 0.0, -9.81])


def random_standard(seed: int) -> dict:
    """A standard table of six joints, one of them prismatic, with bodies, tool and payload."""
    rng = np.random.default_rng(seed)
    rows = []
    for i in range(6):
        row = {
            "theta_deg": rng.uniform(-90, 90),
            "d_mm": rng.uniform(-300, 300),
            "a_mm": rng.uniform(-500, 500),
            "alpha_deg": rng.choice([0, 90, -90, 37.0]),
            "body": {"mass_kg": rng.uniform(1, 20), "com_mm": list(rng.uniform(-200, 200, 3))},
        }
        rows.append(row | ({"type": "prismatic"} if i == 2 else {}))
    return {
        "casadical": 1,
        "name": "random",
        "convention": "standard",
        "tool": {"xyz_mm": [10.0, -20.0, 150.0], "rpy_deg": [10.0, 20.0, 30.0]},
        "payload": {"mass_kg": 7.0, "com_mm": [5.0, 6.0, 70.0]},
        "gravity": {"frame": "base", "vector_m_per_s2": list(GRAVITY)},
        "joint": [{k: v.item() if isinstance(v, np.generic) else v for k, v in row.items()} for row in rows],
    }


def standard_frames(data: dict, q: np.ndarray) -> list[np.ndarray]:
    """Frames 1..6 by the definition Rz(theta) Tz(d) Tx(a) Rx(alpha)."""
    T, found = np.eye(4), []
    for row, reading in zip(data["joint"], q, strict=True):
        prismatic = row.get("type") == "prismatic"
        theta = np.deg2rad(row["theta_deg"]) + (0 if prismatic else reading)
        d = 1e-3 * row["d_mm"] + (reading if prismatic else 0)
        T = T @ turn("z", theta) @ shift(1e-3 * row["a_mm"], 0, d) @ turn("x", np.deg2rad(row["alpha_deg"]))
        found.append(T)
    return found


def height_energy(data: dict, q: np.ndarray) -> float:
    """Potential energy [J] of all bodies and the payload, mass times height."""
    frames = standard_frames(data, q)
    loads = [(row["body"], T) for row, T in zip(data["joint"], frames, strict=True)] + [(data["payload"], frames[-1])]
    return sum(-b["mass_kg"] * GRAVITY @ (T @ [*(1e-3 * np.array(b["com_mm"])), 1])[:3] for b, T in loads)


@pytest.mark.parametrize("seed", range(5))
def test_standard_rows_are_the_same_robot(seed: int) -> None:
    data = random_standard(seed)
    robot = robot_from(data, "random")
    tool = shift(*(1e-3 * np.array(data["tool"]["xyz_mm"])))
    tool[:3, :3] = Rotation.from_euler("xyz", data["tool"]["rpy_deg"], degrees=True).as_matrix()
    for q in np.random.default_rng(seed).uniform(-2, 2, (5, 6)):
        expected = standard_frames(data, q)[-1] @ tool
        p, R = robot.pose(q, robot.parameters.values)
        assert np.abs(p.full().ravel() - expected[:3, 3]).max() < 1e-12
        assert np.abs(R.full() - expected[:3, :3]).max() < 1e-12


@pytest.mark.parametrize("seed", range(5))
def test_mass_centres_go_with_standard_rows(seed: int) -> None:
    """Gravity torques against central differences of mass times height, in the standard frames."""
    data = random_standard(seed)
    robot = robot_from(data, "random")
    q = np.random.default_rng(seed).uniform(-2, 2, 6)
    step = 1e-5 * np.eye(6)
    expected = [-(height_energy(data, q + h) - height_energy(data, q - h)) / 2e-5 for h in step]
    assert robot.torque(q, robot.parameters.values).full().ravel() == pytest.approx(expected, abs=1e-6)


def whole_robot() -> Robot:
    """A robot with something in every place that a file has."""
    return Robot(
        name='arm "7" \\ é',
        joints=(
            Joint(0.01, 0.02, 0.03, 0.04, beta=0.05, b=0.06, lower=-1.0, upper=2.0, compliance=1 / 3e6),
            Joint(np.pi / 2, 1 / 3, body=Body(10.0, np.array([0.1, 0.2, 0.3]))),
            Joint(0.001, 0.7, np.pi / 7, 0.011, lower=-2.5, upper=2.0),
            Joint(-0.002, 0.6, 0.1, compliance=0.0),
            Joint(1.0, 0.1, 0.2, 0.3, kind="prismatic", lower=-0.2, upper=0.9, compliance=1 / 7e5),
        ),
        base=Placement(shift(0.1, 0.2, 0.3) @ turn("z", 0.3) @ turn("x", -1.2), "pose"),
        tool=Placement(shift(-0.1, 0, 0.4) @ turn("x", 2.0), "position"),
        loops=(FourBar(3, 2, 0.3, 0.7, 0.31, -1.5), FourBar(4, 3, 0.2, 0.6, 0.2)),
        gravity=np.array([0.1, 0.2, -9.7]),
        gravity_frame="base",
        payload=Body(5.5, np.array([0.01, 0.02, 1 / 7])),
        widths=dict(WIDTHS) | {"geometry": Width(0.01, 0.02, 0.003, 0.004)},
        notes=("one", "two"),
    )


def same(a: object, b: object) -> None:
    """Equal field by field, numbers to 1e-12."""
    assert type(a) is type(b)
    if hasattr(a, "__dataclass_fields__"):
        for f in fields(a):
            same(getattr(a, f.name), getattr(b, f.name))
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            same(x, y)
    elif isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            same(a[key], b[key])
    elif isinstance(a, float | np.ndarray):
        assert np.abs(np.asarray(a) - np.asarray(b)).max() <= 1e-12 * max(1.0, np.abs(np.asarray(a)).max())
    else:
        assert a == b


def test_round_trip_keeps_everything(tmp_path: Path) -> None:
    robot = whole_robot()
    write_robot(robot, tmp_path / "arm.toml", "made by a test\nin two lines")
    same(robot, read_robot(tmp_path / "arm.toml"))
    assert (tmp_path / "arm.toml").read_text().startswith("# made by a test\n# in two lines\n")
    assert [p.name for p in tmp_path.iterdir()] == ["arm.toml"]


def test_units_go_by_the_key() -> None:
    def joint(**keys: object) -> Joint:
        return robot_from({"casadical": 1, "name": "x", "joint": [keys]}, "x").joints[0]

    assert joint(a_mm=250.0).a == joint(a_m=0.25).a == 0.25
    assert joint(alpha_deg=90).alpha == pytest.approx(np.pi / 2, abs=1e-15)
    assert joint(alpha_rad=1.5).alpha == 1.5
    assert joint(theta_mrad=1.5).theta == 0.0015
    assert joint(limits_deg=[-90, 180]).upper == pytest.approx(np.pi)
    rail = joint(type="prismatic", limits_mm=[0, 2500], stiffness_N_per_m=2e6)
    assert (rail.lower, rail.upper, rail.compliance) == (0, 2.5, 1 / 2e6)
    linear = Drive(kp_N_per_m=2.0, damping_Ns_per_m=3.0, friction_N=4.0, rotor_inertia_kg=5.0, speed_limit_mm_s=6.0)
    assert (linear.kp, linear.damping, linear.friction, linear.rotor_inertia, linear.speed_limit) == (2, 3, 4, 5, 0.006)
    assert (
        joint(body={"mass_kg": 2, "com_m": [0, 0, 1]}).body.com[2]
        == joint(body={"mass_kg": 2, "com_mm": [0, 0, 1000]}).body.com[2]
    )


def test_a_prismatic_reading_moves_along_its_axis() -> None:
    rows = [{"type": "prismatic", "limits_mm": [0, 900]}, {"alpha_deg": 90, "a_mm": 100}]
    robot = robot_from({"casadical": 1, "name": "gantry", "joint": rows, "tool": {"xyz_mm": [50, 0, 0]}}, "gantry")
    position = robot.position([0.4, np.pi / 2], robot.parameters.values).full().ravel()
    assert position == pytest.approx([0.1, 0, 0.4 + 0.05], abs=1e-12)
