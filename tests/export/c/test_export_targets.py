"""The same bits and few instructions on a Cortex-M4F under QEMU; static analysis of every exported source."""

import subprocess

import export_targets as targets
import pytest

from casadical.export.c.kernel import WARNINGS
from casadical.export.c.reference import correct, network
from casadical.export.c.tape_program import tape_program


def need(*tools):
    if lacking := targets.missing(*tools):
        pytest.skip(f"not installed: {', '.join(lacking)} (apt-get install a package that has it)")


# The command was to take 5600; it takes more since it looks at what its last step left, and is to grow no further.
@pytest.mark.parametrize(
    ("board", "kind", "real", "most"),
    [("M4F", "network", "float", 650), ("M4F", "command", "float", 7500), ("M7", "command", "double", 7500)],
)
def test_cortex_m_gives_the_same_bits_within_the_instruction_budget(request, exported, board, kind, real, most):
    need("arm-none-eabi-gcc", "qemu-system-arm")
    product = request.getfixturevalue(kind)
    folder, compute, outputs = (
        exported[kind, real],
        network if kind == "network" else correct,
        3 if kind == "network" else 6,
    )
    flags = targets.defines(real, f"arm_{'network' if kind == 'network' else 'correct'}", outputs, 500)
    run = targets.cortex(board, [folder / "arm.c"], folder, flags)
    values, status = compute(tape_program(product, real), targets.bench_inputs(real, 500))
    assert run.digest == targets.digest(values, status)
    assert run.most <= most
    assert run.jitter <= 0.02
    if kind == "network":
        assert run.jitter == 0


def sources(exported):
    return [(folder, name) for folder in exported.values() for name in ("arm.c", "arm_self_test.c", "arm_example.c")]


@pytest.mark.parametrize("compiler_name", ["gcc", "clang"])
def test_no_warning(exported, compiler_name):
    need(compiler_name)
    more = ["-Wshadow", "-Wdouble-promotion", "-Wstrict-prototypes", "-Wcast-qual", "-Wundef"]
    for folder, name in sources(exported):
        command = [compiler_name, "-std=c99", "-O2", *WARNINGS, *more, "-c", name, "-o", "/dev/null"]
        run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert (run.returncode, run.stderr) == (0, ""), f"{folder} {name}: {run.stderr}"


def test_gcc_analyzer_finds_nothing(exported):
    need("gcc")
    for real in ("float", "double"):
        for name in ("arm.c", "arm_self_test.c"):
            command = ["gcc", "-std=c99", "-O1", "-fanalyzer", "-c", name, "-o", "/dev/null"]
            run = subprocess.run(command, cwd=exported["network", real], capture_output=True, text=True, check=False)
            assert (run.returncode, run.stderr) == (0, "")


def test_cppcheck_with_its_misra_addon_finds_nothing(exported):
    need("cppcheck")
    for key in (("network", "float"), ("command", "float")):
        assert targets.cppcheck(exported[key], ["arm.c", "arm_self_test.c"]) == []


def test_clang_tidy_finds_nothing(exported):
    need("clang-tidy")
    assert targets.clang_tidy(exported["command", "float"], ["arm.c", "arm_self_test.c"]) == []
