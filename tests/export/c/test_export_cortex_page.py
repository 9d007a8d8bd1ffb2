"""The lines of docs/cortex-m.md that measure on a board of the user: they compile and give what our bench gives."""

import re
import subprocess
from pathlib import Path

import export_targets as targets
import pytest
from test_export_targets import need

PAGE = Path(__file__).parents[3] / "docs" / "cortex-m.md"
BLOCKS = re.findall(r"```c\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S)
MAIN = """
#include "cortex.h"
uint32_t cycles_of_a_correction(const arm_real *q, arm_real *dq);
uint32_t stack_of_a_correction(const arm_real *q, arm_real *dq);
static arm_real q[ARM_JOINTS], dq[ARM_JOINTS];

int main(void)
{
    print_hex(cycles_of_a_correction(q, dq));
    print_hex(stack_of_a_correction(q, dq));
    print_hex((uint64_t)arm_self_test());
    return 0;
}
"""


def test_the_page_has_three_ways_to_measure():
    assert [re.findall(r"uint32_t (\w+)\(", block)[-1] for block in BLOCKS] == [
        "cycles_of_a_step", "cycles_of_a_correction", "stack_of_a_correction"
    ]  # fmt: skip


@pytest.mark.parametrize("number", range(len(BLOCKS)))
@pytest.mark.parametrize("board", ["M4F", "M7", "M0+"])
def test_the_lines_compile_without_a_warning(exported, tmp_path, board, number):
    need("arm-none-eabi-gcc")
    source = tmp_path / "measure.c"
    source.write_text(BLOCKS[number])
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-O2", "-mthumb"]
    folder = exported["command", "float"]
    command = ["arm-none-eabi-gcc", *flags, *targets.BOARDS[board][1], f"-I{folder}", "-c", str(source)]
    subprocess.run([*command, "-o", str(tmp_path / "measure.o")], check=True)


def test_they_measure_what_the_bench_of_the_tests_does(exported, tmp_path):
    need("arm-none-eabi-gcc", "qemu-system-arm")
    folder = exported["command", "float"]
    (tmp_path / "measure.c").write_text(BLOCKS[1] + BLOCKS[2].replace("DEPTH 4096U", "DEPTH 16384U") + MAIN)
    sources = [tmp_path / "measure.c", folder / "arm.c", folder / "arm_self_test.c", targets.HERE / "cortex.c"]
    machine, processor = targets.CORTEX["M4F"]
    build = ["arm-none-eabi-gcc", *processor, "-mthumb", "-O2", "-std=gnu11", "-ffp-contract=off", "-nostartfiles"]
    build += ["-specs=nosys.specs", f"-I{targets.HERE}", f"-I{folder}", f"-T{targets.HERE / 'link.ld'}"]
    image = tmp_path / "image.elf"
    subprocess.run([*build, *map(str, sources), "-o", str(image)], check=True, capture_output=True)
    qemu = ["qemu-system-arm", "-M", machine, "-nographic", "-monitor", "none", "-serial", "none"]
    qemu += ["-semihosting-config", "enable=on,target=native", "-icount", "shift=10", "-kernel", str(image)]
    run = subprocess.run(qemu, check=True, capture_output=True, text=True, timeout=300)
    ticks, stack, status = (int(word, 16) for word in (run.stdout + run.stderr).split())
    flags = targets.defines("float", "arm_correct", 6, 10)
    bench = targets.cortex("M4F", [folder / "arm.c"], folder, flags)
    assert ticks / targets.TICKS == pytest.approx(bench.most, rel=0.02)
    assert stack == pytest.approx(bench.stack, abs=128)
    assert status == 0
