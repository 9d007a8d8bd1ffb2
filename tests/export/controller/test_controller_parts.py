"""Geometry and digits of controller programs against scipy's rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from casadical.export.controller.programs.fanuc import Fanuc
from casadical.export.controller.programs.target import DEG, MM, Given, Number
from casadical.export.controller.programs.urscript import UrScript


@pytest.mark.parametrize("seed", range(6))
def test_a_rotation_vector_is_scipys(seed: int) -> None:
    values = np.random.default_rng(seed).normal(0, 1.5, 6)
    T = UrScript().matrix(values)
    np.testing.assert_allclose(T[:3, :3], Rotation.from_rotvec(values[3:]).as_matrix(), atol=1e-14)
    np.testing.assert_array_equal(T[:3, 3], values[:3])


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
    assert {n.written(0.12345678) for n in pose.numbers} == {"123.457", "7.074"}  # a controller of FANUC reads three
