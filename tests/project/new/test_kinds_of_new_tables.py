"""What a new table holds: orientations in every usual form, names of joints, stamps, lengths, computed coordinates."""

import tomllib
from collections.abc import Callable
from pathlib import Path

import first_hour
import numpy as np
import pandas as pd
import pytest
from command_line import main
from marks import slow
from scipy.spatial.transform import Rotation

from casadical import InputError, calibrate, compare_files, read_measurements, read_problem
from casadical.measurements.raw_table import read_table
from casadical.project.check.check import precheck
from casadical.project.check.repair import repaired
from casadical.project.new import new_problem
from casadical.project.problem import read_campaign, read_campaign_robot

SIX = ["revolute"] * 6
J = [f"J{k} [deg]" for k in range(1, 7)]
XYZ = ["X [mm]", "Y [mm]", "Z [mm]"]
# A camera's target that is turned against the flange.
TURN = Rotation.from_euler("xyz", [70, -40, 130], degrees=True)
ENTRIES = [f"{i}{j}" for i in range(3) for j in range(3)]


def poses(n: int = 40) -> tuple[np.ndarray, np.ndarray, Rotation]:
    """Readings [deg], positions [mm] and orientations as a camera sees its target, by plain numpy."""
    q, p = first_hour.measured(n)
    tips = [first_hour.measured(n, tool=first_hour.TOOL + 1000 * e, noise=0.0)[1] for e in np.eye(3)]
    R = np.stack([(tip - first_hour.measured(n, noise=0.0)[1]) / 1000 for tip in tips], axis=2)
    noise = np.random.default_rng(5).normal(0, 3e-4, (n, 3))
    return q, p, Rotation.from_matrix(R) * TURN * Rotation.from_rotvec(noise)


def table(**columns: np.ndarray) -> pd.DataFrame:
    q, p, _ = poses(len(next(iter(columns.values()))) if columns else 40)
    return pd.DataFrame({**dict(zip(J, q.T, strict=True)), **dict(zip(XYZ, p.T, strict=True)), **columns})


def named(names: list[str], values: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(names, values.T, strict=True))


FORMS: dict[str, Callable[[Rotation], dict[str, np.ndarray]]] = {
    "quaternion": lambda R: named(["qx", "qy", "qz", "qw"], R.as_quat()),
    "ROS": lambda R: named([f"pose.orientation.{c}" for c in "xyzw"], R.as_quat()),
    "w first": lambda R: named([f"quat_{c}" for c in "wxyz"], R.as_quat(scalar_first=True)),
    "numbered, w first": lambda R: named([f"quat{k}" for k in range(4)], R.as_quat(scalar_first=True)),
    "numbered, w last": lambda R: named([f"quat{k}" for k in range(1, 5)], R.as_quat()),
    "matrix": lambda R: named([f"r{i + 1}{j + 1}" for i in range(3) for j in range(3)], R.as_matrix().reshape(-1, 9)),
    "brackets": lambda R: named([f"R[{e[0]}][{e[1]}]" for e in ENTRIES], R.as_matrix().reshape(-1, 9)),
    "numbered matrix": lambda R: named([f"m{k}" for k in range(1, 10)], R.as_matrix().reshape(-1, 9)),
    "by columns": lambda R: named([f"m{k}" for k in range(9)], R.as_matrix().transpose(0, 2, 1).reshape(-1, 9)),
    "rotation vector": lambda R: named([f"rvec_{c} [rad]" for c in "xyz"], R.as_rotvec()),
    "OpenCV": lambda R: named([f"rvec{k}" for k in range(3)], R.as_rotvec()),
    "UR": lambda R: named(["rx", "ry", "rz"], R.as_rotvec()),
    "rx ry rz, fixed": lambda R: named([f"R{c} [deg]" for c in "xyz"], R.as_euler("xyz", degrees=True)),
    "rx ry rz, new axes": lambda R: named([f"rot_{c}_deg" for c in "xyz"], R.as_euler("XYZ", degrees=True)),
    "roll, pitch, yaw": lambda R: named(["roll (rad)", "pitch (rad)", "yaw (rad)"], R.as_euler("xyz")),
    "KUKA": lambda R: named(["A [°]", "B [°]", "C [°]"], R.as_euler("ZYX", degrees=True)),
    "FANUC": lambda R: named(["W", "P", "R"], R.as_euler("xyz", degrees=True)),
}


def folder_of(tmp_path: Path, data: pd.DataFrame, **more: object) -> Path:
    new_problem(tmp_path / "arm", **first_hour.given(tmp_path, data), **more)  # type: ignore[arg-type]
    return tmp_path / "arm"


@pytest.mark.parametrize("form", FORMS)
def test_an_orientation_is_read_as_it_was_measured_and_makes_the_tools_pose_unknown(form: str, tmp_path: Path) -> None:
    """By rows that are too few to look for a camera, which takes seconds."""
    _, _, R = poses(11)
    arm = folder_of(tmp_path, table(**FORMS[form](R)), ask=lambda question: pytest.fail(question.text))
    problem = read_problem(arm)
    assert problem.robot.tool.unknown == "pose"
    assert tomllib.loads((arm / "problem.toml").read_text())["measurements"][0]["kind"] == "pose"
    m = read_campaign(arm, arm / "poses.csv", problem.robot)
    assert m.orientation is not None
    np.testing.assert_allclose(m.orientation, R.as_matrix(), atol=1e-6)
    assert m.unused == ()


@pytest.mark.parametrize(
    "form", ["UR", *slow("numbered, w first", "numbered, w last", "by columns", "rx ry rz, new axes")]
)
def test_what_an_orientation_is_is_asked_again_when_the_readings_are_repaired(form: str, tmp_path: Path) -> None:
    """With a joint that counts the other way no form fits the robot, and the first choice may be the wrong one."""
    _, _, R = poses()
    data = table(**FORMS[form](R))
    arm = folder_of(tmp_path, data.assign(**{J[2]: -data[J[2]]}))
    assert repaired(precheck(arm))
    assert precheck(arm).ok
    whole = read_campaign(arm, arm / "poses.csv", read_problem(arm).robot)
    assert whole.orientation is not None
    np.testing.assert_allclose(whole.orientation, R.as_matrix(), atol=1e-6)


@pytest.mark.slow
def test_a_table_of_camera_poses_is_calibrated_from_a_urdf_with_and_without_a_folder(tmp_path, monkeypatch, capfd):  # type: ignore[no-untyped-def]
    """Readings by the names of the URDF's joints, as ROS writes them, in another order; time as stamps."""
    pytest.importorskip("yourdfpy", reason="the extra urdf is not installed")
    q, p, R = poses(60)
    text = first_hour.urdf()
    names = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]
    for k, name in enumerate(names, 1):
        text = text.replace(f'name="joint{k}"', f'name="{name}_joint"')
    (tmp_path / "arm.urdf").write_text(text)
    order = [2, 1, 0, 3, 4, 5]
    columns = {"header.stamp.sec": 1_700_000_000 + np.arange(60), "header.stamp.nanosec": np.full(60, 5e8)}
    columns |= {f"name[{i}]": np.full(60, f"{names[k]}_joint") for i, k in enumerate(order)}
    columns |= {f"position[{i}]": np.deg2rad(q[:, k]) for i, k in enumerate(order)}
    columns |= {f"effort[{i}]": np.zeros(60) for i in range(6)}
    columns |= named(["tx", "ty", "tz"], p / 1e3) | named([f"q{c}" for c in "xyzw"], R.as_quat())
    pd.DataFrame(columns).to_csv(tmp_path / "poses.csv", index=False)
    arm = tmp_path / "arm"
    assert main(monkeypatch, "new", arm, "--urdf", tmp_path / "arm.urdf", "--data", tmp_path / "poses.csv") == 0
    said = " ".join(capfd.readouterr().out.split())
    assert "kind pose" in said
    assert "qw qw" in said
    assert "Not used: name[0]" in said
    kept = tomllib.loads((arm / "problem.toml").read_text())
    assert kept["urdf"]["tool"][0]["unknown"] == "pose"
    assert kept["measurements"][0]["columns"]["q1_rad"] == "position[2]"
    for folder, tables in ((arm, ()), (tmp_path / "arm.urdf", (tmp_path / "poses.csv",))):
        result = calibrate(folder, tables=tables).identification
        assert result.robot.tool.unknown == "pose"
        assert 1e3 * result.accuracy(*result.measurements)["calibrated"].mean < 0.06
        (m,) = result.measurements
        assert np.ptp(m.conditions["time_s"]) == pytest.approx(59, abs=20)
    calibrate(arm).write(tmp_path / "results")
    compared = compare_files([tmp_path / "results", tmp_path / "poses.csv"], arm)
    assert not compared.changed
    by_name = pd.DataFrame({f"{names[k]}_joint": np.deg2rad(q[:, k]) for k in order}).assign(
        **named(["px", "py", "pz"], p / 1e3)
    )
    by_name.to_csv(tmp_path / "named.csv", index=False)
    robot = read_campaign_robot(tmp_path / "arm.urdf")
    np.testing.assert_allclose(np.rad2deg(read_campaign(tmp_path / "arm.urdf", tmp_path / "named.csv", robot).q), q)


def test_orientations_that_the_robot_cannot_have_had_are_no_result(tmp_path: Path) -> None:
    """Of a tool whose orientation nobody left open, and of a convention that is another one."""
    _, _, R = poses(20)
    arm = folder_of(tmp_path, table(**FORMS["quaternion"](R)))
    robot, data = arm / "robot.toml", arm / "poses.csv"
    text = robot.read_text()
    head, tool = text.split("[tool]")
    robot.write_text(f"{head}[tool]" + tool.replace('unknown = "pose"', 'unknown = "position"', 1))
    said = r'would be 0\.\d+ deg with the tool turned: write unknown = "pose" in \[tool\]'
    with pytest.raises(InputError, match=said):
        calibrate(arm)
    assert not precheck(arm).ok
    robot.write_text(text)
    data.write_text(data.read_text().replace("qx,qy", "qy,qx"))
    with pytest.raises(InputError, match=r"deg \(median\) from the nominal robot, however base and tool are turned"):
        calibrate(arm)


def test_a_kind_that_a_problem_says_holds_for_other_tables() -> None:
    folder = Path(__file__).parents[3] / "problems" / "ur10"
    path = folder.parents[1] / "data" / "ur10_laser_tracker" / "series_A_grid.csv"
    assert {"rx_deg", "ry_deg"} <= {*read_table(path).header}
    assert read_campaign(folder, path, read_campaign_robot(folder)).kind == "position"


@pytest.mark.parametrize("key", ["sigma", "datasheet"])
def test_a_noise_that_a_problem_declares_holds_for_its_table_and_another_of_its_instrument(
    key: str, tmp_path: Path
) -> None:
    new_problem(tmp_path / "arm")
    path, table = tmp_path / "arm" / "problem.toml", tmp_path / "arm" / "poses.csv"
    declared = path.read_text().replace("# sigma_mm = 0.02", f"{key}_mm = 0.04")
    path.write_text(declared)
    other = tmp_path / "other.csv"
    other.write_text(table.read_text().rsplit("\n", 2)[0])

    def noise(of: Path) -> float | None:
        return getattr(read_campaign(path.parent, of, read_campaign_robot(path.parent)), key)

    assert noise(table) == noise(other) == 0.04e-3
    second = f'\n[[measurements]]\nfile = "more.csv"\n{key}_mm = 0.01\n\n[sets]'
    path.write_text(declared.replace("\n[sets]", second))
    (path.parent / "more.csv").write_text(other.read_text().rsplit("\n", 2)[0])
    assert (noise(table), noise(other)) == (0.04e-3, None)  # of two instruments another table may be of either


def test_stamps_and_dates_are_seconds_and_rounded_dates_no_time(tmp_path: Path) -> None:
    dates = pd.date_range("2021-03-04 12:00:00", periods=40, freq="30s")
    written = {
        "Zeit": dates.strftime("%d.%m.%Y %H:%M:%S"),
        "timestamp": dates.strftime("%Y%m%d%H%M%S").astype(float),
        "Time": dates.astype("datetime64[ns]").astype(np.int64),
        "time [ms]": dates.astype("datetime64[ns]").astype(np.int64) // 10**6,
        "Datum": dates.astype(str),
    }
    for name, cells in written.items():
        table().assign(**{name: cells}).to_csv(tmp_path / "t.csv", index=False)
        time = read_measurements(tmp_path / "t.csv", 6).conditions["time_s"]
        np.testing.assert_allclose(np.diff(time), 30, atol=1e-5)
    table().assign(timestamp="2,02103E+13").to_csv(tmp_path / "t.csv", index=False, sep=";", decimal=",")
    m = read_measurements(tmp_path / "t.csv", 6)
    assert len(m) == 40
    assert "time_s" not in m.conditions


def test_coordinates_that_the_robot_has_itself_give_way_to_a_measured_length(tmp_path: Path) -> None:
    """A wire's length beside nominal coordinates; where these are measured, the length is said to be unused."""
    q, p, _ = poses()
    nominal = first_hour.positions(q, first_hour.ROWS, first_hour.TOOL)
    length = np.linalg.norm(p - [900.0, -2400.0, 100.0], axis=1)
    said: list[str] = []

    def show(block: object) -> None:
        said.append(str(block))

    for name, coordinates, kind in (("wire", nominal, "distance"), ("points", p, "position")):
        (tmp_path / name).mkdir()
        data = table(Laenge=length).assign(**named(XYZ, coordinates.round(3)))
        arm = folder_of(tmp_path / name, data, show=show)
        assert read_problem(arm).sets["identify"][0].kind == kind
        assert ("the coordinates are computed" in " ".join(said)) == (kind == "distance")
        assert ("Not used: X [mm], Y [mm], Z [mm]" in " ".join(said)) == (kind == "distance")
        assert ("Not used: Laenge" in " ".join(said)) == (kind == "position")
        said.clear()
    blocks = "".join(str(block) for block in calibrate(tmp_path / "wire" / "arm").blocks())
    assert "error of distance" in blocks
    assert "position error" not in blocks


@pytest.mark.parametrize("tilt", [40.0, 89.0, *slow(0.0, 180.0)])
def test_gravity_is_taken_in_the_base_where_the_instrument_is_not_levelled(tilt: float, tmp_path: Path) -> None:
    """At right angles a tracker is levelled and the robot hangs; a camera, which sees orientations, looks that way."""
    _, p, R = poses()
    lean = Rotation.from_euler("x", tilt, degrees=True)
    said: list[str] = []
    for name, columns in (("tracker", {}), ("camera", named(["qx", "qy", "qz", "qw"], (lean * R).as_quat()))):
        (tmp_path / name).mkdir()
        data = table(**columns).assign(**named(XYZ, lean.apply(p)))
        robot = folder_of(tmp_path / name, data, show=lambda block: said.append(str(block))) / "robot.toml"
        leans = tilt == 40 or (tilt > 40 and name == "camera")
        assert tomllib.loads(robot.read_text())["gravity"]["frame"] == ("base" if leans else "measuring")
        words = f"{tilt:.0f} deg from that of the robot: the robot is taken to stand upright"
        assert (words in " ".join(said)) == leans
        said.clear()


def test_orientations_of_the_controller_beside_measured_positions_are_not_used(tmp_path: Path) -> None:
    """They are in the robot's base; under our own names, which nobody can leave out, they are an error."""
    q, p, R = poses()
    leaned = Rotation.from_euler("xz", [25, 50], degrees=True).apply(p)
    arm = folder_of(tmp_path, table(**FORMS["KUKA"](R)).assign(**named(XYZ, leaned)))
    assert read_problem(arm).sets["identify"][0].kind == "position"
    own = named(["qx", "qy", "qz", "qw"], R.as_quat()) | named(["x_mm", "y_mm", "z_mm"], leaned)
    pd.DataFrame(named([f"q{k}_deg" for k in range(1, 7)], q) | own).to_csv(arm / "poses.csv", index=False)
    (arm / "problem.toml").write_text('casadical = 1\ntitle = "t"\n[[measurements]]\nfile = "poses.csv"\n')
    robot = (arm / "robot.toml").read_text().replace('unknown = "position"', 'unknown = "pose"')
    (arm / "robot.toml").write_text(robot)
    with pytest.raises(InputError, match=r"they are of another frame than these, as the controller's own would be"):
        calibrate(arm)
