"""Run `python docs/studies/cortex_m.py`: instructions, stack and flash of the exported command on small controllers.

For three committed problems, position and pose, float and double: a Cortex-M0+ (no floating point unit), M4F (single
precision), M7 (double precision) and a 64-bit Cortex-A53, gcc -O2. Instructions are counted under QEMU and are no
cycles; no silicon was measured. The bits of every build are compared with the reference. The calibrated robots are the
nominal ones with random changes (synthetic). Flash is what the function adds to a program that does nothing else;
stack is painted before a call and read after it.
"""

import argparse
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / "export" / folder) for folder in ("c", "controller")]

import controller_arms as arms  # noqa: E402
import export_targets as targets  # noqa: E402

from casadical.export import Sources, command_of, write_c  # noqa: E402
from casadical.export.c.reference import correct  # noqa: E402
from casadical.export.c.tape_program import tape_program  # noqa: E402

WORK = Path(tempfile.mkdtemp())
COUNT = 100
BOARDS = ("M0+", "M4F", "M7", "A53")


def nothing(board, real, count=1):
    """The image of a program that calls a function that does nothing so many times."""
    (WORK / "nothing.h").write_text(f"int arm_nothing(const {real} *q, {real} *out);\n")
    (WORK / "nothing.c").write_text(
        f'#include "nothing.h"\nint arm_nothing(const {real} *q, {real} *out) {{ out[0] = q[0]; return 0; }}\n'
    )
    flags = targets.defines(real, "arm_nothing", 6, count, header="nothing.h")
    return targets.cortex(board, [WORK / "nothing.c"], WORK, flags)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problems", default="kr210,ur10e,hh800", help="by commas")
    problems = parser.parse_args().problems.split(",")
    tools = ("arm-none-eabi-gcc", "qemu-system-arm", "aarch64-linux-gnu-gcc", "qemu-system-aarch64")
    boards = [b for b in BOARDS if not targets.missing(*(tools[2:] if b == "A53" else tools[:2]))]
    print("Correction of a joint command, two steps; gcc -O2 under QEMU: instructions a call (emulated), stack, flash")
    print(f"not run, for lack of a compiler or QEMU: {', '.join(set(BOARDS) - set(boards)) or 'none'}")
    empty = {(b, real): nothing(b, real).text for b in boards for real in ("float", "double")}
    for problem in problems:
        for pose in (False, True):
            command = command_of(Sources(arms.planted(problem), arms.nominal_path(problem)), orientation=pose)
            for real in ("float", "double"):
                folder = WORK / f"{problem}_{pose}_{real}"
                write_c(command, folder, name="arm", real=real, vectors=2000, languages=[])
                box = (command.lower, command.upper)
                flags = targets.defines(real, "arm_correct", 6, COUNT, box=box)
                wanted = targets.digest(*correct(tape_program(command, real), targets.bench_inputs(real, COUNT, box)))
                for board in boards:
                    it = targets.cortex(board, [folder / "arm.c"], folder, flags, shift=6)
                    same = "same bits" if it.digest == wanted else f"OTHER BITS {it.digest}"
                    what = f"{problem} {'pose' if pose else 'position'} {real}"
                    flash = it.text - empty[board, real]
                    print(f"  {what:24s} {board:4s} {it.most:8.0f}; {it.stack:5d} B; {flash:6d} B; {same}", flush=True)


if __name__ == "__main__":
    main()
