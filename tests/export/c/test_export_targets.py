"""Builds that need more than gcc: Cortex-M under QEMU, other compilers' warnings, static analysis."""

import re
import subprocess
from pathlib import Path

import export_targets as targets
import numpy as np
import pytest
from export_targets import need
from test_export_curves import coefficients, curve_function

from casadical.export import write_c
from casadical.export.c.kernel import WARNING_FLAGS
from casadical.export.c.products import CurveFunction
from casadical.export.c.reference import correct, network
from casadical.export.c.tape_program import tape_program

pytestmark = pytest.mark.slow
PAGE = Path(__file__).parents[3] / "docs" / "cortex-m.md"
BLOCKS = re.findall(r"```c\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S)
KEYS = [(kind, real) for kind in ("network", "command") for real in ("float", "double")]


@pytest.fixture(scope="module")
def curves(tmp_path_factory, compiler):
    """The error curves of six joints and the folders of their export, by number type."""
    box = targets.models.LOWER, targets.models.UPPER
    product, folders = CurveFunction(curve_function(coefficients()), *box), {}
    for real in ("float", "double"):
        folders[real] = tmp_path_factory.mktemp(f"curves_{real}")
        write_c(product, folders[real], name="arm", real=real, vectors=1_000)
    return product, folders


# The command was to take 5600; it takes more since it looks at what its last step left, and is to grow no further.
@pytest.mark.parametrize(
    ("board", "kind", "real", "most", "jitter"),
    [
        ("M4F", "network", "float", 650, 0),
        ("M4F", "command", "float", 7500, 0.02),
        ("M7", "command", "double", 7500, 0.02),
        ("M4F", "curves", "float", 500, 0),
        ("M7", "curves", "double", 500, 0),
    ],
)
def test_cortex_m_gives_the_same_bits_within_the_instruction_budget(
    request, exported, curves, board, kind, real, most, jitter
):
    need("arm-none-eabi-gcc", "qemu-system-arm")
    product = curves[0] if kind == "curves" else request.getfixturevalue(kind)
    folder = curves[1][real] if kind == "curves" else exported[kind, real]
    call, compute = ("correct", correct) if kind == "command" else (kind, network)
    flags = targets.defines(real, f"arm_{call}", 3 if kind == "network" else 6, 500)
    run = targets.cortex(board, [folder / "arm.c"], folder, flags)
    values, status = compute(tape_program(product, real), targets.bench_inputs(real, 500))
    assert run.digest == targets.digest(values, status)
    assert run.most <= most
    assert run.jitter <= jitter


@pytest.mark.parametrize("compiler_name", ["gcc", "clang"])
def test_no_warning(exported, compiler_name):
    need(compiler_name)
    more = ["-Wshadow", "-Wdouble-promotion", "-Wstrict-prototypes", "-Wcast-qual", "-Wundef"]
    for key in KEYS:
        for name in ("arm.c", "arm_self_test.c", "arm_example.c"):
            command = [compiler_name, "-std=c99", "-O2", *WARNING_FLAGS, *more, "-c", name, "-o", "/dev/null"]
            run = subprocess.run(command, cwd=exported[key], capture_output=True, text=True, check=False)
            assert (run.returncode, run.stderr) == (0, ""), f"{key} {name}: {run.stderr}"


def test_gcc_analyzer_finds_nothing(exported):
    need("gcc")
    for real in ("float", "double"):
        for name in ("arm.c", "arm_self_test.c"):
            command = ["gcc", "-std=c99", "-O1", "-fanalyzer", "-c", name, "-o", "/dev/null"]
            run = subprocess.run(command, cwd=exported["network", real], capture_output=True, text=True, check=False)
            assert (run.returncode, run.stderr) == (0, "")


@pytest.mark.parametrize("tool", ["cppcheck", "clang-tidy"])
def test_static_analysis_finds_nothing(exported, curves, tool):
    """cppcheck with its MISRA addon, and clang-tidy."""
    need(tool)
    findings = targets.cppcheck if tool == "cppcheck" else targets.clang_tidy
    for folder in (exported["network", "float"], exported["command", "float"], curves[1]["float"]):
        assert findings(folder, ["arm.c", "arm_self_test.c"]) == []


def test_the_header_is_for_cpp_too(exported, tmp_path):
    need("g++")
    for key in KEYS:
        main = tmp_path / "main.cpp"
        main.write_text('#include "arm.h"\nint main() { return arm_self_test() == ARM_OK ? 0 : 1; }\n')
        flags = ["-std=c++98", "-Wall", "-Wextra", "-Werror", f"-I{exported[key]}", "-fsyntax-only"]
        subprocess.run(["g++", *flags, str(main)], check=True)


def test_example_and_cmake_build_and_install(exported, kernels, tmp_path):
    need("cmake")
    folder = exported["command", "float"]

    def run(*command):
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout

    prefix = f"-DCMAKE_INSTALL_PREFIX={tmp_path / 'here'}"
    run("cmake", "-S", str(folder), "-B", str(tmp_path / "build"), prefix)
    run("cmake", "--build", str(tmp_path / "build"), "--target", "install")
    said = run(str(tmp_path / "build" / "arm_example"))
    assert "correction after 500 cycles, status 0:" in said
    middle = ((targets.models.LOWER + targets.models.UPPER) / 2)[None, :]
    expected = kernels["command", "float"].correct(middle)[0][0]
    found = [float(word) for word in said.split("status 0:")[-1].split() if word != "rad"]
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert (tmp_path / "here" / "include" / "arm.h").exists()
    assert "-larm" in next((tmp_path / "here").rglob("arm.pc")).read_text()


@pytest.mark.parametrize("board", ["M4F", "M7", "M0+"])
def test_the_lines_of_the_page_that_measure_on_a_board_compile_without_a_warning(exported, tmp_path, board):
    need("arm-none-eabi-gcc")
    names = [re.findall(r"uint32_t (\w+)\(", block)[-1] for block in BLOCKS]
    assert names == ["cycles_of_a_step", "stack_of_a_correction"]
    flags = ["-std=c99", *WARNING_FLAGS, "-O2", "-mthumb", f"-I{exported['command', 'float']}"]
    for block in BLOCKS:
        (tmp_path / "measure.c").write_text(block)
        command = ["arm-none-eabi-gcc", *flags, *targets.BOARDS[board][1], "-c", str(tmp_path / "measure.c")]
        subprocess.run([*command, "-o", str(tmp_path / "measure.o")], check=True)
