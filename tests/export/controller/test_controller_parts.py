"""Geometry and digits of controller programs against scipy's rotations."""

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from casadical.core.transforms import frame
from casadical.export.controller.drivers import row_of, standard_rows
from casadical.export.controller.postures import about_axis
from casadical.export.controller.programs.fanuc import Fanuc
from casadical.export.controller.programs.target import DEG, MM, Given, Number
from casadical.export.controller.programs.urscript import UrScript


@pytest.mark.parametrize("seed", range(6))
def test_a_turn_about_an_axis_is_scipys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axis, angle, v = rng.normal(size=3), rng.uniform(-4, 4), rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    expected = Rotation.from_rotvec(angle * axis)
    found = np.array(ca.DM(about_axis(ca.SX(ca.DM(axis)), ca.SX(angle), ca.DM(v)))).ravel()
    np.testing.assert_allclose(found, expected.apply(v), atol=1e-14)
    values = np.concatenate([rng.normal(size=3), angle * axis])
    T = UrScript().matrix(values)
    np.testing.assert_allclose(T[:3, :3], expected.as_matrix(), atol=1e-14)
    np.testing.assert_array_equal(T[:3, 3], values[:3])


@pytest.mark.parametrize("seed", range(8))
def test_a_standard_row_leads_to_the_next_axis_with_theta_near_the_wanted_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    at, following = (frame(Rotation.random(random_state=seed + k).as_matrix(), rng.normal(size=3)) for k in (0, 50))
    like = rng.uniform(-np.pi, np.pi)
    theta, d, a, alpha = row_of(at, following, like)
    assert np.cos(theta - like) >= 0
    T = at @ standard_rows(theta, d, a, alpha)
    np.testing.assert_allclose(T[:3, 2], following[:3, 2], atol=1e-12)  # the same axis,
    across = np.cross(T[:3, 3] - following[:3, 3], following[:3, 2])
    np.testing.assert_allclose(across, 0, atol=1e-12)  # somewhere on it


@pytest.mark.parametrize(
    ("text", "unit", "value", "written"),
    [
        ("12.5", MM, 0.0123456789, "12.3457"),
        ("1", DEG, np.deg2rad(30.00000049), "30.000000"),
        ("0.25", 1.0, 0.1234567891234, "0.123456789"),
        ("1.234567", MM, 0.001, "1.000000"),
        ("5.0", MM, -1e-9, "0.0000"),
    ],
)
def test_digits_of_a_number_are_its_own_or_the_finest_of_its_unit(text, unit, value, written):
    assert Number(0, len(text), text, unit).written(value) == written


LISTING = """/PROG T
/MN
   1:J P[1] 100% FINE ;
   2:L P[2] 100mm/sec FINE ;
/POS
P[1]{
   GP1:
\tUF : 0, UT : 1,
\tJ1=  10.000 deg,\tJ2= -20.000 deg,\tJ3=  30.000 deg,
\tJ4=  40.000 deg,\tJ5=  50.000 deg,\tJ6=  60.000 deg
};
P[2]{
   GP1:
\tUF : 0, UT : 1,\tCONFIG : 'N U T, 0, 0, 0',
\tX =  100.000  mm,\tY =  200.000  mm,\tZ =  300.000  mm,
\tW =   10.000 deg,\tP =   20.000 deg,\tR =   30.000 deg
};
/END
"""


def test_positions_of_a_listing_are_joints_or_a_pose() -> None:
    given = Given(tools={"1": np.eye(4)}, bases={"0": np.eye(4)})
    joints, pose = Fanuc().targets("t.ls", LISTING, given, 6)
    assert (joints.name, joints.left, pose.name, pose.left) == ("P[1]", "", "P[2]", "")
    np.testing.assert_allclose([n.si for n in joints.numbers], np.deg2rad([10, -20, 30, 40, 50, 60]))
    np.testing.assert_allclose([n.si for n in pose.numbers], [0.1, 0.2, 0.3, *np.deg2rad([10, 20, 30])])
