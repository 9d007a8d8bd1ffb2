"""Run `python docs/studies/c_matrix.py` (as root it installs what is missing): every figure of the exported C.

The bits that processors under QEMU compute, and instruction counts, flash and RAM on Cortex-M. The robot and the
network are those of tests/export/c. `--quick` takes a hundredth of the vectors, `--only NAMES` some of the sections.
What a machine cannot run is printed as not run, with the reason.
"""

import argparse
import shutil

from c_bench import (
    PRODUCTS,
    REALS,
    WORK,
    host_and_foreign,
    install,
    lacking,
    line,
    nothing,
    section,
    targets,
)  # fmt: skip

from casadical.export import write_c
from casadical.export.c.kernel import compilers
from casadical.export.c.reference import correct, network
from casadical.export.c.tape_program import tape_program

CALLS = (("network", "arm_network", 3, network), ("command", "arm_correct", 6, correct))


def export_all(count):
    """The four exports; each is compiled and compared in the call that writes it."""
    section(f"C against its NumPy reference, bits, {count} vectors a function, in the call that writes it")
    folders = {}
    for kind, product in PRODUCTS.items():
        for real in REALS:
            folder = WORK / f"{kind}_{real}"
            export = write_c(product, folder, name="arm", real=real, vectors=count)
            folders[kind, real] = folder
            for compiler in dict.fromkeys(c.compiler for c in export.comparisons):
                mine = [c for c in export.comparisons if c.compiler == compiler]
                total, wrong = sum(c.outputs for c in mine), sum(c.different for c in mine)
                line(
                    f"{kind} {real}, {'clang' if 'clang' in compiler else 'gcc'}",
                    f"{total} outputs, {wrong} differ",
                    "0",
                )
            line(f"{kind} {real}, figures of the model", str(export.figures))
    return folders


def processors(folders, count):
    section(f"the same bits on other processors, {count} vectors, one hash (status and outputs)")
    for kind, call, outputs, compute in CALLS:
        for real in REALS:
            program = tape_program(PRODUCTS[kind], real)
            wanted = targets.digest(*compute(program, targets.bench_inputs(real, count)))
            flags = targets.defines(real, call, outputs, count)
            found = {"NumPy": wanted} | host_and_foreign(folders[kind, real], flags)
            for board in targets.CORTEX:
                if not lacking("arm-none-eabi-gcc", "qemu-system-arm"):
                    folder = folders[kind, real]
                    found[board] = targets.cortex(board, [folder / "arm.c"], folder, flags).digest
            same = [name for name, digest in found.items() if digest == wanted]
            other = {name: digest for name, digest in found.items() if digest != wanted}
            line(f"{kind} {real}", f"{wanted} on {', '.join(same)}" + (f"; OTHERS {other}" if other else ""), "all")


def cortex_m(folders):
    section("Cortex-M under QEMU: instructions a call (least to most, jitter), gcc -O2 and -Os, whole image's size")
    if reason := lacking("arm-none-eabi-gcc", "qemu-system-arm"):
        line("Cortex-M", reason)
        return
    empty = {}
    cases = [
        ("network", "M4F", "float"),
        ("network", "M7", "double"),
        ("command", "M4F", "float"),
        ("command", "M7", "double"),
    ]
    for kind, board, real in cases:
        call, outputs = ("arm_network", 3) if kind == "network" else ("arm_correct", 6)
        target = (
            "650, 0 %, 1.6 kB, 0 B" if (kind, board) == ("network", "M4F") else "5600, 2 %" if kind == "command" else ""
        )
        for optimise in ("-O2", "-Os"):
            folder = folders[kind, real]
            if (board, real, optimise) not in empty:
                empty[board, real, optimise] = nothing(board, real, optimise)
            base = empty[board, real, optimise]
            it = targets.cortex(
                board, [folder / "arm.c"], folder, targets.defines(real, call, outputs, 10), optimise=optimise
            )
            figure = f"{it.least:.0f} to {it.most:.0f}, {100 * it.jitter:.1f} %"
            size = f"{it.text - base.text} B flash, {it.ram - base.ram} B RAM added"
            line(f"{kind} {real}, {board} {optimise}", f"{figure}; {size}", target)


SECTIONS = {
    "processors": lambda folders, share: processors(folders, 20_000 // share),
    "cortex": lambda folders, _: cortex_m(folders),
}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="+", choices=[*SECTIONS, "exports"], default=[*SECTIONS, "exports"])
    options = parser.parse_args()
    share = 100 if options.quick else 1
    install()
    print("Exported C: 6R arm with 30 calibrated values and compliance, 6-5-3 network; tests/export/c/export_models.py")
    for compiler in compilers():
        print(f"  {compiler.version}")
    folders = export_all(200_000 // share if "exports" in options.only else 1000)
    for name in options.only:
        if name != "exports":
            SECTIONS[name](folders, share)
    shutil.rmtree(WORK)


if __name__ == "__main__":
    main()
