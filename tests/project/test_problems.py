"""Every problem folder: the same files, certified figures that still hold, data that are what they say."""

import sys
import tomllib
from importlib import import_module
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from casadical import InputError, read_problem
from casadical.project.diagnosis import read_logs
from casadical.project.problem import error_groups, read_campaign_robot
from casadical.project.problem_file import CameraErrorsTable, DataTable, LogsTable, result_in

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs" / "studies"))  # for their scripts as modules
FOLDERS = sorted(p for p in (ROOT / "problems").iterdir() if p.is_dir())


LOGS = [p for p in FOLDERS if "logs" in tomllib.loads((p / "problem.toml").read_text())]

every_set_of_poses = pytest.mark.parametrize("folder", [p for p in FOLDERS if p not in LOGS], ids=lambda f: f.name)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(p.name, marks=() if p.name in ("hh800", "planar") else pytest.mark.slow)
        for p in FOLDERS
        if p not in LOGS
    ],
)
def test_certified_figures_hold(name: str, calibrated) -> None:
    expected = tomllib.loads((ROOT / "problems" / name / "certified.toml").read_text())
    tolerance = expected.pop("tolerance_mm")
    found = import_module("certify").figures(calibrated(name))
    assert found.keys() == expected.keys()
    for method, entries in expected.items():
        assert found[method].keys() == entries.keys()
        for key, figure in entries.items():
            wanted = pytest.approx(figure, abs=tolerance) if isinstance(figure, dict) else figure
            assert found[method][key] == wanted, f"{method} {key}"


@pytest.mark.parametrize("folder", LOGS, ids=lambda f: f.name)
def test_certified_figures_of_logs_hold(folder: Path) -> None:
    expected = tomllib.loads((folder / "certified.toml").read_text())
    found = import_module("certify").figures_of_logs(folder)
    assert found.keys() == expected.keys() == {"identify", "report"}
    for name, figures in expected.items():
        assert found[name].keys() == figures.keys()
        for key, figure in figures.items():
            assert found[name][key] == pytest.approx(figure, abs=1e-3), f"{name} {key}"


def test_folder_of_logs_is_no_calibration_and_names_its_command() -> None:
    with pytest.raises(InputError, match=r"holds joint logs, no measured poses; take casadical diagnose .*so101"):
        read_problem(ROOT / "problems" / "so101")
    assert read_logs(ROOT / "problems" / "planar") is None


def test_no_motion_may_be_fitted_and_reported() -> None:
    with pytest.raises(ValueError, match=r"a\.csv is in identify, too"):
        LogsTable(identify=["a.csv", "b.csv"], report=["a.csv"])


@every_set_of_poses
def test_no_pose_is_in_two_sets(folder: Path) -> None:
    sets = read_problem(folder).sets
    rows = [set(map(tuple, np.concatenate([m.q for m in parts]))) for parts in sets.values()]
    for i, some in enumerate(rows):
        for other in rows[i + 1 :]:
            assert some & other == set()


def test_folders_that_share_a_robot_hold_the_same_one() -> None:
    for names in (("ur10", "ur10_grid", "ur10_joints"), ("panda_1", "panda_3")):
        texts = {(ROOT / "problems" / name / "robot.toml").read_text() for name in names}
        assert len(texts) == 1


def test_the_planar_data_come_from_the_script() -> None:
    made = import_module("planar").planar()
    stored = pd.read_csv(ROOT / "data" / "planar" / "planar.csv")
    pd.testing.assert_frame_equal(made, stored, atol=1.01e-4)


@pytest.mark.parametrize("robot", ["ur5", "wam"])
@pytest.mark.parametrize("name", ["grid", "random"])
def test_the_measured_tables_come_from_the_published_ones(robot: str, name: str) -> None:
    """And the nominal DH table gives back the published targets, so that angles and units are what they say."""
    tables = import_module("real_tables")
    table = tables.published(robot, name)
    stored = pd.read_csv(ROOT / "data" / f"{robot}_laser_tracker" / f"measured_{name}.csv")
    pd.testing.assert_frame_equal(tables.measured(table, tables.SETS[name]), stored, rtol=0, atol=1e-9)
    rest = stored[["x_mm", "y_mm", "z_mm"]].to_numpy() - table[["x_dif", "y_dif", "z_dif"]].to_numpy()
    np.testing.assert_allclose(rest, table[["x_t", "y_t", "z_t"]], rtol=0, atol=1e-9)
    assert tables.with_six_decimals(table, tables.SIGN) == 1.0  # as the tracker writes its readings
    assert tables.with_six_decimals(table, -tables.SIGN) < 0.01
    _, off = tables.reproduced(robot, table)
    assert off.mean() < 0.011
    assert off.max() < 0.05


def test_the_planar_arm_gets_its_planted_errors_back(calibrated) -> None:
    """Within four standard errors; theta2 stands in the direction of the tool, as its README says."""
    planted = import_module("planar")
    found = calibrated("planar").identification.parameters.set_index("name")
    offset = np.deg2rad(planted.OFFSET_2_DEG)
    truth = {
        "theta1": planted.OFFSET_1_DEG,
        "a1": planted.LINK_1_MM,
        "tool_x": planted.LINK_2_MM * np.cos(offset),
        "tool_y": planted.LINK_2_MM * np.sin(offset),
    } | dict.fromkeys(("alpha0", "a0", "alpha1", "beta1", "tool_z"), 0.0)
    assert set(truth) == set(found[found.status == "identified"].index)
    for name, value in truth.items():
        assert abs(found.value[name] - value) < 4 * found.std_error[name], name


@pytest.mark.parametrize(("name", "most"), [("focal", 0.2), ("tilt", 0.2), ("board", 0.2), ("distortion", 1.0)])
def test_errors_of_a_camera_are_small(name: str, most: float) -> None:
    for sign in (-1, 1):
        assert getattr(CameraErrorsTable(**{name: sign * 0.99 * most}), name) == sign * 0.99 * most
        with pytest.raises(ValueError, match=name):
            CameraErrorsTable(**{name: sign * most})


def test_a_kind_of_measurement_that_is_not_there_is_refused_with_those_that_are() -> None:
    for kind in ("positions", ""):
        with pytest.raises(ValueError, match=r"must be .*'pose'"):
            DataTable(file="a.csv", kind=kind)
    assert DataTable(file="a.csv", kind=None).kind is None


def test_errors_are_told_of_tables_and_of_all_tables_of_one_kind() -> None:
    names = ["report/pose/a", "report/pose/b", "report/distance/c"]
    own = {name: [name] for name in names}
    assert error_groups(names) == {"report/pose": names[:2], "report/distance": names[2:], **own}


def test_a_urdf_alone_is_the_robot_of_a_campaign(tmp_path: Path) -> None:
    links = '<link name="a"/><link name="b"/>'
    joint = '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>'
    limit = '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    (tmp_path / "arm.urdf").write_text(f'<robot name="one">{links}{joint}{limit}</robot>')
    assert read_campaign_robot(tmp_path / "arm.urdf").n == 1


@pytest.mark.parametrize("text", ['{"methods": {}}', '{"methods": 3}', "{}"])
def test_a_folder_of_results_without_a_method_is_none(text: str, tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(InputError, match=r"no result\.json of a calibration is in it, and 0 robot files"):
        result_in(tmp_path)
