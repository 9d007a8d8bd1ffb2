"""The structured text: run by other means than the exporter's own."""

import json
from dataclasses import replace

import casadi as ca
import export_models as models
import numpy as np
import pytest
from structured_text_in_c import Compiled, parsed

from casadical.export import Status, load, write_c
from casadical.export.c import reference
from casadical.export.c.c_source import c_files, comparison_inputs
from casadical.export.c.products import Command, NetworkFunction
from casadical.export.c.reference import correct, network
from casadical.export.c.structured_text import structured_text
from casadical.export.c.tape_program import operations, tape_program
from casadical.export.c.write import compared

REALS = (pytest.param("float", marks=pytest.mark.slow), "double")


def bits(values):
    return np.ascontiguousarray(values).view(np.uint32 if values.dtype == np.float32 else np.uint64)


@pytest.mark.parametrize("real", REALS)
def test_structured_text_gives_the_bits_of_the_c(command, kernels, compiler, tmp_path, real):
    program = tape_program(command, real)
    text, q = structured_text(program), comparison_inputs(program, 1000)
    low, high = (q == end.astype(q.dtype) for end in (models.LOWER, models.UPPER))
    assert ((low | high).all(axis=1) & low.any(axis=1) & high.any(axis=1)).any()  # corners are among them
    for block, out, outputs, expected in (
        ("correct", "dq", 6, kernels["command", real].correct(q)),
        ("network", "dp_mm", 3, kernels["command", real].network(q)),
    ):
        compiled = Compiled(text, tmp_path, compiler, "arm", block, out, outputs=outputs)
        found = compiled.rows(q)
        assert (bits(found[0]) == bits(expected[0])).all()
        assert found[1].tolist() == expected[1].tolist()
        assert compiled.self_test()
    assert {Status.OK, Status.CLAMPED, Status.NOT_FINITE} <= set(found[1].tolist())


@pytest.mark.parametrize("real", REALS)
def test_structured_text_ramps_like_the_c(command, kernels, compiler, tmp_path, real):
    n = 600
    q = np.linspace(models.LOWER * 0.5, models.UPPER * 0.5, n)
    q[20] = np.nan
    enable = np.arange(n) < 450
    text = structured_text(tape_program(command, real))
    found = Compiled(text, tmp_path, compiler, "arm", "step", "dq").rows(q, enable)
    expected = kernels["command", real].steps(q, enable)
    assert (bits(found[0]) == bits(expected[0])).all()
    assert found[1].tolist() == expected[1].tolist()
    assert abs(found[0]).max() > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cycle_s", "ramp_s", "rate_rad_s", "limited"), [(0.001, 0.5, 0.5, False), (0.02, 1.0, 0.005, True)]
)
def test_ramp_and_rate_hold_in_seconds_at_other_cycles(
    command, compiler, tmp_path, cycle_s, ramp_s, rate_rad_s, limited
):
    limits = replace(command.limits, cycle_s=cycle_s, ramp_s=ramp_s, rate_rad_s=rate_rad_s)
    product = replace(command, limits=limits, network=None)
    folder = tmp_path / "c"
    write_c(product, folder, name="arm", vectors=500, languages=["structured_text"])
    (tmp_path / "st").mkdir()
    text = Compiled((folder / "arm.st").read_text(), tmp_path / "st", compiler, "arm", "step", "dq")
    q = np.tile((models.LOWER + models.UPPER) / 3, (int(4 / cycle_s), 1))
    kernel = load(folder)
    full = kernel.correct(q[:1])[0][0]
    for dq, status in (kernel.steps(q, np.ones(len(q))), text.rows(q)):
        t = cycle_s * np.arange(1, len(q) + 1)
        rate = abs(np.diff(np.vstack([np.zeros(6), dq]), axis=0)).max() / cycle_s
        arrived = t[(abs(dq - full) < 1e-9).all(1)][0]
        wanted = abs(full).max() / rate_rad_s if limited else ramp_s
        assert arrived == pytest.approx(wanted, abs=1.01 * cycle_s)
        assert rate == pytest.approx(rate_rad_s if limited else abs(full).max() / ramp_s, rel=1e-6)
        assert (Status.RATE_LIMITED in status) is limited
    header = (folder / "arm.h").read_text()
    assert f"ARM_CHANGE_LIMIT a call, {rate_rad_s} rad/s" in header
    assert f"once in {cycle_s} s: ramps in over {ramp_s} s" in header
    assert json.loads((folder / "manifest.json").read_text())["limits"] == vars(limits)


@pytest.mark.parametrize("real", REALS)
def test_structured_text_of_a_loop_gives_the_bits_of_the_reference(compiler, tmp_path, real):
    program = tape_program(Command(models.nominal(), models.with_loop(), models.LOWER, models.UPPER, steps=3), real)
    assert {"atan2", "sqrt", "guard_min"} <= {node.op for node in program.tapes["forward"].nodes}
    q = comparison_inputs(program, 1000)
    found = Compiled(structured_text(program), tmp_path, compiler, "arm", "correct", "dq").rows(q)
    expected = correct(program, q)
    assert (bits(found[0]) == bits(expected[0])).all()
    assert found[1].tolist() == expected[1].tolist()


@pytest.mark.parametrize("real", REALS)
def test_structured_text_of_every_other_operation_gives_the_bits_of_the_reference(compiler, tmp_path, real):
    q = ca.SX.sym("q", 6)
    choice = ca.if_else(q[0] < q[1], ca.fmin(q[0], q[2]), ca.fmax(q[1], q[2])) + ca.if_else(q[3] <= 0, 1, -q[3])
    other = ca.sign(q[4]) * ca.fabs(q[5]) + ca.exp(q[0] / 3) / (1 + ca.exp(-q[1])) + ca.sqrt(q[2])
    function = ca.Function("odd", [q], [ca.vertcat(choice, other, ca.atan2(q[4], q[5]))], ["q"], ["dp_mm"])
    program = tape_program(NetworkFunction(function, models.LOWER, models.UPPER), real)
    used = {node.op for node in program.tapes["network"].nodes}
    assert {"fmin", "fmax", "fabs", "lt", "le", "not", "select", "sign", "exp", "neg", "guard_min"} <= used
    q = comparison_inputs(program, 1000)
    q[:100] = np.repeat(np.array([-0.0, 0.0, 1.0, -1.0]), 25)[:, None]
    text = structured_text(program)
    found = Compiled(text, tmp_path, compiler, "arm", "network", "dp_mm", outputs=3).rows(q)
    expected = network(program, q)
    assert (bits(found[0]) == bits(expected[0])).all()
    assert found[1].tolist() == expected[1].tolist()
    files = {name: text.encode() for name, text in c_files(program).items()}
    assert [str(result) for result in compared(program, files, [compiler], 1000) if result.different] == []


def test_the_test_of_the_controller_notices_another_bit(network, compiler, tmp_path):
    text = structured_text(tape_program(network, "double"))
    before, numbers = text.split("expected : ARRAY[0..11] OF LREAL := [")
    first = numbers.split(",")[0]
    changed = f"{before}expected : ARRAY[0..11] OF LREAL := [{float(first) * (1 + 1e-15)!r}{numbers[len(first) :]}"
    for name, variant, passes in (("good", text, True), ("bad", changed, False)):
        (tmp_path / name).mkdir()
        compiled = Compiled(variant, tmp_path / name, compiler, "arm", "network", "dp_mm", outputs=3)
        assert compiled.self_test() is passes


def test_the_parser_refuses_what_is_no_structured_text(network):
    text = structured_text(tape_program(network, "float"))
    assert len(parsed(text).children) > 3
    with pytest.raises(AssertionError):
        parsed(text.replace("END_FOR", "END", 1))


def test_the_operations_of_a_network_are_counted(network):
    found = operations(tape_program(network, "float"))
    # Six inputs, five units, three outputs, and two inputs whose ranges have another middle than zero.
    assert found.count == {"multiplications": 6 * 5 + 5 * 3, "additions": 2 + 6 * 5 + 5 * 3, "tansig": 5}
    assert found.text() == (
        "Operations of network, the same in every call: 47 additions, 45 multiplications, 5 tansig."
    )


@pytest.mark.parametrize("steps", [1, 3])
def test_the_operations_of_a_correction_are_those_that_the_reference_does(steps: int, monkeypatch) -> None:
    command = Command(models.nominal(), models.calibrated(), models.LOWER, models.UPPER, steps=steps)
    program, done, run = tape_program(command, "double"), [], reference.run
    monkeypatch.setattr(reference, "run", lambda tape, *more: done.append(tape) or run(tape, *more))
    correct(program, 0.5 * (models.LOWER + models.UPPER)[None])
    kinds = [node.op for tape in done for node in tape.nodes]
    expected = sum(kind not in ("input", "const", "sin", "cos") for kind in kinds)
    assert sum(operations(program).count.values()) == expected
