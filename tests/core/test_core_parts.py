"""Small parts of the ground floor, each against another way to say the same."""

import os
import stat
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from casadical.core import subprocesses
from casadical.core.basics import InputError
from casadical.core.files import private_folder
from casadical.core.mapped_function import call
from casadical.core.parts import Arm, Coupling, FourBar, Joint, Placement
from casadical.core.statistics import first_of_best, ranked, rounded_at
from casadical.core.sx_instructions import SxInstructions
from casadical.core.transforms import from_rpy, to_rpy


def test_arrays_through_a_casadi_function_are_casadis_numbers() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    operations = [1 / x, 2 * x, -x, ca.sqrt(x), ca.log1p(x), ca.atan2(x, y), ca.fmax(x, y), x**y, ca.fmod(y, x)]
    operations += [ca.exp(x), ca.tanh(y), ca.sin(x) * ca.cos(y), ca.fabs(x - y), ca.sign(x - y), ca.SX(3.5)]
    f = ca.Function("f", [x, y], [ca.vertcat(*operations, ca.if_else(x < y, x, 0), ca.logic_not(x))])
    points = np.random.default_rng(0).uniform(0.2, 3, (2, 7))
    (found,) = SxInstructions.read(f).on_arrays([points[0]], [points[1]])
    expected = f.map(7)(points[:1], points[1:]).full()
    np.testing.assert_allclose(np.array([np.broadcast_to(v, 7) for v in found]), expected, rtol=1e-14, atol=1e-15)


def test_instructions_with_values_of_any_kind_are_the_function() -> None:
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    inner = ca.Function("inner", [x], [ca.sin(x)], {"never_inline": True})
    f = ca.Function("f", [x, y], [ca.vertcat(inner(x), 3.5), ca.sparsify(ca.diag(ca.vertcat(x[1] * y, 0)))])
    read = SxInstructions.read(f)
    words = {"mul": "({} * {})".format, "assign": str}
    values = read.evaluate([["a", "b"], ["c"]], words.__getitem__, str, call=lambda args: [f"sin {v}" for v in args])
    assert values == [["sin a", "sin b", "3.5"], ["(b * c)"]]
    assert {value for name, *_, value in read.instructions if name != "const"} == {0.0}
    with pytest.raises(NotImplementedError, match="f: CasADi operation call has no numpy counterpart"):
        read.on_arrays([1.0, 2.0], [3.0])


def test_a_function_takes_no_argument_of_another_shape() -> None:
    x, none = ca.SX.sym("x", 2, 4), ca.SX.sym("none", 0, 4)
    f = ca.Function("f", [x, none], [2 * x])
    (found,) = call(f, np.array([[1.0], [3.0]]), np.zeros((0, 4)))
    np.testing.assert_array_equal(found, np.tile([[2.0], [6.0]], 4))
    with pytest.raises(ValueError, match=r"input 0 has shape \(3, 4\), expected \(2, 4\)"):
        call(f, np.zeros((3, 4)), np.zeros((0, 4)))


def test_a_link_is_no_private_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "of others").mkdir()
    (tmp_path / "casadical").symlink_to(tmp_path / "of others")
    monkeypatch.setenv("CASADICAL_CACHE", str(tmp_path))
    assert private_folder() is None
    monkeypatch.setenv("CASADICAL_CACHE", str(tmp_path / "new"))
    assert private_folder("kernels") == tmp_path / "new" / "casadical" / "kernels"


def test_without_a_variable_the_folder_is_the_users_and_with_one_it_may_be_relative(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CASADICAL_CACHE", "near")
    assert private_folder("kernels") == Path("near", "casadical", "kernels")
    monkeypatch.delenv("CASADICAL_CACHE")
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda name: str(tmp_path / "users" / name))
    assert private_folder("kernels") == tmp_path / "users" / "casadical" / "kernels"
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda name: f"~/{name}")
    assert private_folder() is None


def test_the_folder_that_holds_the_cache_keeps_its_mode_and_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tmp_path.chmod(0o777)
    (tmp_path / f"of-another-program-{'0' * 32}.so").touch()
    monkeypatch.setenv("CASADICAL_CACHE", str(tmp_path))
    assert private_folder() == tmp_path / "casadical"
    assert stat.S_IMODE(tmp_path.stat().st_mode) == 0o777
    assert sorted(p.name for p in tmp_path.iterdir()) == ["casadical", f"of-another-program-{'0' * 32}.so"]


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no owners of files here")
def test_a_folder_of_another_user_is_no_private_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CASADICAL_CACHE", str(tmp_path / "cache"))
    assert private_folder() == tmp_path / "cache" / "casadical"
    another = os.geteuid() + 1
    monkeypatch.setattr(os, "geteuid", lambda: another)
    assert private_folder() is None


def test_a_number_of_threads_that_was_given_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    for name in names:
        monkeypatch.setenv(name, "9")  # so that all are as before afterwards
        monkeypatch.delenv(name)
    monkeypatch.setenv(names[1], "3")
    subprocesses.one_thread()
    assert [os.environ.get(name) for name in names] == [None, "3", None]
    monkeypatch.delenv(names[1])
    subprocesses.one_thread()
    assert [os.environ.get(name) for name in names] == ["1", "1", "1"]


def test_the_first_of_equal_values_is_taken() -> None:
    assert first_of_best(np.array([0.0, 1.0 - 1e-9, 1.0, 1.0 - 1e-4])) == 1
    assert first_of_best(np.array([-np.inf, -2.0, -1.0, -1.0 - 1e-9])) == 2
    assert first_of_best(np.array([-np.inf, -np.inf])) == 0
    assert first_of_best([-5000.0, -5000.001], logs=True) == 0
    assert first_of_best([-5000.0 - 1e-9, -5000.0], logs=True) == 0
    assert first_of_best([-5000.001, -5000.0]) == 0, "beside what is no logarithm, the share counts"


def test_equal_values_are_ranked_in_their_order() -> None:
    rng = np.random.default_rng(0)
    values = np.array([0.2, 0.5, 0.2, 1.0, 0.5, -np.inf, 0.2])
    for _ in range(20):
        assert ranked(values * (1 + 1e-12 * rng.normal(size=7))) == [3, 1, 4, 0, 2, 6, 5]
        assert ranked(1e4 + values + 1e-9 * rng.normal(size=7), logs=True) == [3, 1, 4, 0, 2, 6, 5]
    assert ranked([]) == []


def test_digits_that_rounding_decides_are_left_out() -> None:
    assert rounded_at(123.456789012345, 0.01, 6) == rounded_at(123.456789012355, 0.01, 6) == 123.45678901
    assert rounded_at(-1e-12, 0.01, 6) == 0.0
    assert str(rounded_at(-1e-12, 0.01, 6)) == "0.0", "no sign is left"
    assert rounded_at(7.5, 0.0, 6) == 7.5
    assert rounded_at(1e-300, 1e-301, 2) == 1e-300


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


def test_reach_is_the_length_of_all_links_and_the_tool() -> None:
    tool = np.eye(4)
    tool[:3, 3] = 0.3, 0.0, 0.4
    rows = (Joint(a=-0.2, d=0.1), Joint(d=0.25, kind="prismatic", lower=-0.6, upper=0.1))
    assert Arm("two", rows, tool=Placement(tool)).reach == pytest.approx(0.2 + 0.1 + 0.25 + 0.6 + 0.5)


def test_couplings_and_loops_are_refused_by_their_numbers() -> None:
    rows = (Joint(), Joint(coupling=Coupling(((3, 1.0),))), Joint(coupling=Coupling(((1, 1.0),))))
    with pytest.raises(InputError, match=r"joint\[2\].follows: joint 3; allowed: 1, which are not coupled"):
        Arm("two followers", rows)
    with pytest.raises(InputError, match=r"four_bar\[1\]: carrier = 1, driven = 3"):
        Arm("no neighbours", (Joint(a=0.5),) * 3, loops=(FourBar(3, 1, 0.4, 0.4, 0.4),))
