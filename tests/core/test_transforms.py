"""Roll-pitch-yaw against scipy, also next to pitch +-90 deg, where roll and yaw cannot be told apart."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from casadical.core.transforms import from_rpy, to_rpy

angle = st.floats(-np.pi, np.pi)
SAMPLING = settings(deadline=None, max_examples=200, derandomize=True)


@SAMPLING
@given(st.tuples(angle, angle, angle).map(np.array))
def test_from_rpy_turns_about_fixed_axes(rpy):
    np.testing.assert_allclose(from_rpy(rpy), Rotation.from_euler("xyz", rpy).as_matrix(), rtol=0, atol=1e-15)


@SAMPLING
@given(angle, angle, st.floats(-18, 0).map(lambda e: 10**e), st.sampled_from([1, -1]))
def test_to_rpy_gives_the_same_rotation_at_every_pitch(roll, yaw, off, sign):
    R = Rotation.from_euler("xyz", [roll, sign * (np.pi / 2 - off), yaw]).as_matrix()
    rpy = to_rpy(R)
    np.testing.assert_allclose(from_rpy(rpy), R, rtol=0, atol=3e-15)
    assert abs(rpy[1]) <= np.pi / 2


def test_yaw_is_zero_at_pitch_90_deg():
    np.testing.assert_allclose(to_rpy(from_rpy(np.array([0.3, np.pi / 2, 0.5]))), [-0.2, np.pi / 2, 0], atol=1e-15)
