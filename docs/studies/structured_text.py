"""Run `python docs/studies/structured_text.py`: size and cost of the exported structured text.

For two committed problems, the KR 210 as calibrated (SKCM), and the robot of tests/export/c:
lines, values, runs, operations of a call. The text is
parsed by tree-sitter's IEC 61131-3 grammar, turned into C by tests/export/c/structured_text_in_c.py, compared with the
reference bit by bit, and its instructions are counted under QEMU (emulated, no PLC was measured): the list in runs, the
same list with every operation as a run of its own, and the exported C, which has a statement for each operation.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "export" / "c"))

import export_models as models  # noqa: E402
import export_targets as targets  # noqa: E402
import structured_text_in_c as translated  # noqa: E402

from casadical import calibrate, read_robot  # noqa: E402
from casadical.export import Sources, command_of, write_c  # noqa: E402
from casadical.export.c import structured_text as language  # noqa: E402
from casadical.export.c.c_source import comparison_inputs  # noqa: E402
from casadical.export.c.kernel import compilers  # noqa: E402
from casadical.export.c.products import Command  # noqa: E402
from casadical.export.c.reference import correct  # noqa: E402
from casadical.export.c.structured_text import RESULT_PLACES, Plan  # noqa: E402
from casadical.export.c.tape_program import operations, tape_program  # noqa: E402
from casadical.project.calibration import with_knowledge  # noqa: E402

WORK = Path(tempfile.mkdtemp())
HEADER = "#include <stdint.h>\nint st_correct(const {real} *q, {real} *out);\n"
CALL = """
int st_correct(const {real} *q, {real} *out)
{{
    static arm_correct block;
    static int ready = 0;
    if (!ready) {{ arm_correct_init(&block); ready = 1; }}
    memcpy(block.q, q, sizeof block.q);
    arm_correct_run(&block);
    memcpy(out, block.dq, sizeof block.dq);
    return block.status;
}}
"""


def products():
    """The committed problems, calibrated by some values, and the robot of the tests."""
    for problem, values, pose in (
        ("hh800", {"a2": 1.6012, "theta3": 0.002, "L5": 0.7995, "c2": 6e-8}, False),
        ("hh800", {"a2": 1.6012, "theta3": 0.002, "L5": 0.7995, "c2": 6e-8}, True),
        ("kr210", {"a2": 1.1508, "theta3": -1.5690}, False),
        ("kr210", {"a2": 1.1508, "theta3": -1.5690}, True),
    ):
        nominal = ROOT / "problems" / problem / "robot.toml"
        robot = read_robot(nominal).with_values(values)
        yield f"{problem}, {'pose' if pose else 'position'}", command_of(Sources(robot, nominal), orientation=pose)
    nominal = ROOT / "problems" / "kr210" / "robot.toml"
    real = with_knowledge(calibrate(nominal.parent, method="SKCM").identification)
    yield "kr210 calibrated, position", command_of(Sources(real, nominal))
    yield "tests' 6R arm, position", arm()


def arm():
    return Command(
        models.nominal(), models.kinematics(), models.LOWER, models.UPPER,
        jacobian_of=models.kinematics(compliance=False), jacobian_at=models.bent(),
    )  # fmt: skip


def one_by_one(program):
    """The plan with every operation as a run of its own."""
    plan = Plan(program)
    operations, starts, first_run = [], [], [0]
    for op, begin, end in zip(plan.operations, plan.starts, plan.starts[1:], strict=False):
        places = list(range(begin, end, RESULT_PLACES.get(op, 1)))
        operations += [op] * len(places)
        starts += places
        first_run.append(len(operations))
    spans = {key: (first_run[a], first_run[b + 1] - 1) for key, (a, b) in plan.spans.items()}
    plan.operations, plan.starts, plan.spans = operations, [*starts, plan.size], spans
    return plan


def compared(text, program, folder, count):
    """Different bits of `correct` in so many rows."""
    q = comparison_inputs(program, count)
    found = translated.Compiled(text, folder, compilers()[0], "arm", "correct", "dq", q.shape[1], q.shape[1])
    dq, status = found.rows(q)
    expected = correct(program, q)
    word = np.uint32 if program.real == "float" else np.uint64
    same = (dq.view(word) == np.ascontiguousarray(expected[0]).view(word)).all(1) & (status == expected[1])
    return int((~same).sum()), found.self_test()


def counted(text, program, folder, board, count=200):
    """Emulated instructions of a call, and the size of the image."""
    (folder / "st.h").write_text(HEADER.format(real=program.real))
    (folder / "st.c").write_text('#include "st.h"\n' + translated.in_c(text) + CALL.format(real=program.real))
    flags = targets.defines(program.real, "st_correct", 6, count, header="st.h")
    return targets.cortex(board, [folder / "st.c"], folder, flags)


def main():
    count = 20000
    print(f"Structured text of `export c`; rows compared with the reference: {count} of each real type")
    for name, product in products():
        for real in ("double", "float"):
            program = tape_program(product, real)
            text, plan = language.structured_text(program), Plan(program)
            folder = Path(tempfile.mkdtemp(dir=WORK))
            different, passed = compared(text, program, folder, count)
            print(
                f"  {name}, {real}: {len(text.splitlines())} lines, {plan.size} values, {len(plan.operations)} runs; "
                f"parsed; rows that differ: {different}; its own test passes: {passed}",
                flush=True,
            )
        print(f"    {operations(program).text()}")
    print("\nInstructions of a correction of the tests' 6R arm, two steps, gcc -O2 under QEMU (emulated)")
    if lacking := targets.missing("arm-none-eabi-gcc", "qemu-system-arm"):
        print(f"  not run: {', '.join(lacking)} not installed")
        return
    for real, board in (("float", "M4F"), ("double", "M7")):
        program = tape_program(arm(), real)
        folder = Path(tempfile.mkdtemp(dir=WORK))
        write_c(arm(), folder / "c", name="arm", real=real, vectors=2000)
        flags = targets.defines(real, "arm_correct", 6, 200)
        found = {"exported C": targets.cortex(board, [folder / "c" / "arm.c"], folder / "c", flags)}
        found["structured text"] = counted(language.structured_text(program), program, folder, board)
        language.Plan = one_by_one
        found["structured text, a run for each operation"] = counted(
            language.structured_text(program), program, folder, board
        )
        language.Plan = Plan
        for what, it in found.items():
            first = f" ({it.most:.0f} in the first, which fills the arrays)" if "text" in what else ""
            print(f"  {board} {real}, {what}: {it.least:.0f}{first}; image {it.text} B flash, {it.ram} B RAM")


if __name__ == "__main__":
    main()
