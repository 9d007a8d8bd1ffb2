"""The compiled C: its bits, its statuses, its limits under hostile inputs, and builds that must be refused."""

import ctypes
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import casadi as ca
import export_models as models
import numpy as np
import pytest

from casadical.export import Status
from casadical.export.c.c_source import c_files, inside
from casadical.export.c.kernel import compilers
from casadical.export.c.products import Command, Limits, NetworkFunction
from casadical.export.c.reference import correct, step
from casadical.export.c.tape_program import tape_program
from casadical.export.c.write import accuracy, compared

REALS = (pytest.param("float", marks=pytest.mark.slow), "double")
TYPE = {"float": np.float32, "double": np.float64}


def compared_all(product, real, count):
    program = tape_program(product, real)
    files = {name: text.encode() for name, text in c_files(program).items()}
    results = compared(program, files, compilers()[:1], count)
    assert results
    return [str(r) for r in results if r.different], program


def hostile(rng, count, T):
    """Any bit pattern, so: huge, tiny, subnormal, infinite, NaN."""
    unsigned = np.uint32 if T is np.float32 else np.uint64
    return rng.integers(0, np.iinfo(unsigned).max, (count, 6), dtype=unsigned, endpoint=True).view(T)


@pytest.mark.parametrize("real", REALS)
def test_the_four_bar_loop_gives_the_same_bits_and_says_where_it_cannot_close(compiler, real):
    chain = models.kinematics(compliance=False)
    closed = Command(models.nominal(), models.with_loop(), models.LOWER, models.UPPER, jacobian_of=chain)
    wrong, program = compared_all(closed, real, 2_000)
    assert wrong == []
    assert accuracy(program, 500)["share_ok"] > 0.3  # the Jacobian leaves the loop out
    opened = replace(closed, calibrated=models.with_loop(lengths=(0.5, 0.9, 0.3, 1.0)))
    wrong, program = compared_all(opened, real, 2_000)
    assert wrong == []
    q = inside(program, 2_000)
    found = np.array(opened.calibrated.map(2_000)(q.T.astype(float)))
    _, status = correct(program, q)
    assert 0.05 < np.isnan(found).any(0).mean() < 0.95
    assert (status[np.isnan(found).any(0)] == Status.NOT_FINITE).all()


def test_full_poses_give_the_same_bits_and_reach_the_nominal_pose(compiler):
    nominal = models.pose_of(models.NOMINAL, [0.0] * 6)
    product = Command(nominal, models.pose_of(*models.calibrated_rows(1)), models.LOWER, models.UPPER, steps=3)
    wrong, program = compared_all(product, "double", 1_000)
    assert wrong == []
    q = inside(program, 3_000)
    dq, status = correct(program, q)
    fine = status == Status.OK
    assert fine.mean() > 0.4  # a wrist has many poses near its singularity
    exact = q[fine].astype(float)
    p, R = (np.array(o) for o in nominal.map(len(exact))(exact.T))
    moved = exact + dq[fine]
    p2, R2 = (np.array(o) for o in product.calibrated.map(len(exact))(moved.T))
    p0, R0 = (np.array(o) for o in product.calibrated.map(len(exact))(exact.T))
    assert np.median(np.linalg.norm(p0 - p, axis=0)) > 0.02
    assert np.quantile(np.linalg.norm(p2 - p, axis=0), 0.99) < 1e-4
    assert np.quantile(abs(R2 - R).max(0), 0.99) < 3e-4
    assert np.median(abs(R0 - R).max(0)) > 2e-3


def test_casadis_own_c_agrees_with_the_export(exported, kernels, compiler, tmp_path):
    folder = exported["command", "double"]
    library = tmp_path / "cross.so"
    source = folder / "cross_check" / "arm_casadi.c"
    subprocess.run([compiler, "-O1", "-fPIC", "-shared", str(source), "-lm", "-o", str(library)], check=True)
    cross = ca.external("arm_casadi_calibrated", str(library))
    dp = ca.external("arm_casadi_network", str(library))
    q = np.random.default_rng(5).uniform(models.LOWER, models.UPPER, (300, 6))
    kernel = kernels["command", "double"]
    np.testing.assert_allclose(kernel.forward(q)[0], np.array(cross.map(300)(q.T)).T, rtol=0, atol=2e-14)
    np.testing.assert_allclose(kernel.network(q)[0], np.array(dp.map(300)(q.T)).T, rtol=0, atol=2e-14)


@pytest.mark.parametrize("real", REALS)
def test_any_input_at_all_keeps_the_limits_and_gets_a_status(kernels, real):
    kernel, T = kernels["command", real], TYPE[real]
    rng = np.random.default_rng(6)
    q = np.vstack([hostile(rng, 5_000, T), (rng.normal(size=(5_000, 6)) * 3).astype(T)])
    finite = np.isfinite(q).all(1)
    dq, status = kernel.correct(q)
    limit = T(Limits().delta_rad)
    assert np.isfinite(dq).all()
    assert (abs(dq) <= limit).all()
    assert (status[~finite] == Status.NOT_FINITE).all()
    assert (dq[~finite] == 0).all()
    box = (q >= models.LOWER.astype(T)).all(1) & (q <= models.UPPER.astype(T)).all(1)
    assert (status[finite & ~box] >= Status.CLAMPED).all()
    assert {Status.OK, Status.CLAMPED, Status.NOT_FINITE} <= set(status.tolist())
    dp, dp_status = kernel.network(q)
    network = NetworkFunction(models.network(), models.LOWER, models.UPPER)
    bounds = tape_program(network, real).network_bounds
    assert all(low <= dp[:, k].min() and dp[:, k].max() <= high for k, (low, high) in enumerate(bounds))
    assert (dp_status[finite & ~box] == Status.CLAMPED).all()
    assert (dp_status[finite & box] == Status.OK).all()


def test_singular_and_limited_poses_say_so_and_stay_bounded():
    """A robot that hardly moves in z at all: the unguarded step would be without bound."""
    q = ca.SX.sym("q", 6)
    flat = [ca.cos(q[0]) + q[1], ca.sin(q[0]) + q[2], 1e-6 * ca.sin(q[3])]
    nominal = ca.Function("nominal", [q], [ca.vertcat(*flat)])
    shifted = ca.Function("calibrated", [q], [ca.vertcat(*flat) + ca.vertcat(0, 0, 0.03)])
    far = ca.Function("calibrated", [q], [ca.vertcat(*flat) + ca.vertcat(0.9, 0, 0)])
    box = (-np.ones(6), np.ones(6))
    grid = np.random.default_rng(7).uniform(-1, 1, (500, 6))
    dq, status = correct(tape_program(Command(nominal, shifted, *box), "double"), grid)
    assert (status == Status.SINGULAR).all()
    assert abs(dq).max() <= Limits().delta_rad
    steep = ca.Function("nominal", [q], [q[:3]])
    far = ca.Function("calibrated", [q], [q[:3] + ca.vertcat(0.9, 0, 0)])
    dq, status = correct(tape_program(Command(steep, far, *box), "double"), grid)
    assert (status == Status.LIMITED).all()
    np.testing.assert_allclose(dq[:, 0], -Limits().delta_rad)


def test_the_correction_takes_the_tool_where_the_nominal_model_has_it(command):
    program = tape_program(replace(command, steps=3), "double")
    q = inside(program, 2_000)
    target = np.array(models.nominal().map(2_000)(q.T))
    J = ca.Function("J", [s := ca.SX.sym("q", 6)], [ca.jacobian(models.calibrated()(s), s)])
    weakest = np.linalg.svd(np.array(J.map(2_000)(q.T)).reshape(3, 2_000, 6).transpose(1, 0, 2), compute_uv=False)[:, 2]
    away = weakest > 0.7  # m/rad
    dq, status = correct(program, q)
    rest = np.linalg.norm(np.array(models.calibrated().map(2_000)((q + dq).T)) - target, axis=0)
    before = np.linalg.norm(np.array(models.calibrated().map(2_000)(q.T)) - target, axis=0)
    assert before.mean() > 0.015
    assert away.mean() > 0.8
    assert rest[away].max() < 5e-6
    assert np.median(rest) < 1e-7
    assert (status[away] == Status.OK).mean() > 0.99


def test_step_ramps_limits_its_rate_and_equals_the_reference(kernels, command):
    limits, n = command.limits, 700
    kernel, program = kernels["command", "double"], tape_program(command, "double")
    q = np.linspace(models.LOWER * 0.5, models.UPPER * 0.5, n)
    q[100] = np.nan
    q[300:310] *= 30
    enable = np.arange(n) < 500
    dq, status = kernel.steps(q, enable)
    change = np.diff(np.vstack([np.zeros(6), dq]), axis=0)
    assert abs(change).max() <= limits.rate_rad_s * limits.cycle_s * (1 + 1e-12)
    assert abs(dq).max() <= limits.delta_rad
    assert status[100] == Status.NOT_FINITE
    assert abs(dq[490]).max() > 1e-3
    np.testing.assert_allclose(dq[400], kernel.correct(q[400:401])[0][0], atol=1e-12)  # ramped in
    gain = np.clip(1 - (np.arange(500, n) - 499) * limits.cycle_s / limits.ramp_s, 0, 1)
    np.testing.assert_allclose(dq[500:], gain[:, None] * kernel.correct(q[500:])[0], atol=1e-12)
    mine, gain = np.zeros(6), 0.0
    for k in range(130):
        mine, gain, my_status = step(program, mine, gain, q[k], bool(enable[k]))
        np.testing.assert_array_equal(mine, dq[k])
        assert my_status == status[k]


def test_null_pointers_and_spoilt_state(exported, compiler, tmp_path):
    folder = exported["command", "double"]
    library = tmp_path / "arm.so"
    sources = [str(folder / "arm.c"), str(folder / "arm_self_test.c")]
    subprocess.run([compiler, "-O2", "-fPIC", "-shared", *sources, "-o", str(library)], check=True)
    arm = ctypes.CDLL(str(library))
    q, out = (ctypes.c_double * 6)(), (ctypes.c_double * 6)(*[7.0] * 6)
    for function in (arm.arm_network, arm.arm_forward, arm.arm_correct):
        assert function(None, out) == Status.NULL_ARG
        assert function(q, None) == Status.NULL_ARG
    state = (ctypes.c_double * 7)()
    for arguments in ((None, q, 1, out), (state, None, 1, out), (state, q, 1, None)):
        assert arm.arm_step(*arguments) == Status.NULL_ARG
    assert list(out) == [7.0] * 6
    for spoil in (float("nan"), float("inf"), 1e9):
        for place in (2, 6):
            state = (ctypes.c_double * 7)()
            state[place] = spoil
            assert arm.arm_step(state, q, 1, out) == Status.NOT_FINITE
            assert max(map(abs, out)) <= Limits().rate_rad_s * Limits().cycle_s


def test_no_library_no_heap_no_mutable_statics(exported, compiler, tmp_path):
    if shutil.which("nm") is None:
        pytest.skip("no nm (binutils) on this machine")
    subprocess.run(
        [compiler, "-std=c99", "-O2", "-fno-pie", "-c", "arm.c", "-o", str(tmp_path / "arm.o")],
        cwd=exported["command", "double"],
        check=True,
    )
    lines = subprocess.run(
        ["nm", str(tmp_path / "arm.o")], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    kinds = {line.split()[-2] for line in lines}
    assert not kinds & {"U", "D", "d", "B", "b", "C"}, lines


BAD_BUILDS = {
    "fast-math": ["-O2", "-ffast-math"],
    "fused": ["-O2", "-mfma", "-ffp-contract=fast"],
    "x87": ["-O2", "-mfpmath=387"],
}


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "real"), [("network", "float"), ("network", "double"), ("command", "double")])
@pytest.mark.parametrize("build", BAD_BUILDS)
def test_builds_with_other_arithmetic_are_refused_or_fail_the_self_test(exported, tmp_path, kind, real, build):
    if shutil.which("gcc") is None:
        pytest.skip("no gcc on this machine")
    folder, flags = exported[kind, real], BAD_BUILDS[build]
    if subprocess.run(["gcc", *flags, "-E", "-x", "c", "/dev/null"], capture_output=True, check=False).returncode:
        pytest.skip(f"this gcc does not take {flags}")
    main = tmp_path / "main.c"
    main.write_text('#include "arm.h"\nint main(void) { return (int)arm_self_test(); }\n')
    sources = [str(folder / "arm.c"), str(folder / "arm_self_test.c"), str(main)]

    def built(*extra):
        command = ["gcc", "-std=gnu11", f"-I{folder}", *extra, *sources, "-o", str(tmp_path / "test")]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    def runs():
        return subprocess.run([str(tmp_path / "test")], check=False).returncode

    refused = built(*flags)
    if build == "fused":
        if "fma" not in Path("/proc/cpuinfo").read_text():
            pytest.skip("this processor has no fused multiply-add")
        assert refused.returncode == 0  # the pragmas switch it off, so this build conforms
        assert runs() == 0
    else:
        assert "must not be co" in refused.stderr
    assert built(*flags, "-DARM_ANY_ARITHMETIC").returncode == 0
    assert runs() == Status.SELF_TEST_FAILED
