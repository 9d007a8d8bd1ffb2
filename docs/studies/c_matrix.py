"""The exported C on processors under QEMU: python docs/studies/c_matrix.py > docs/studies/c_matrix.txt

The bits that a call computes on x86-64, ARM, RISC-V and PowerPC, and instructions of a call, flash and RAM on Cortex-M.
The robot and the network are those of tests/export/c. Debian's packages of compilers and QEMU are needed (gcc, clang,
gcc-arm-none-eabi, libnewlib-arm-none-eabi, qemu-system-arm, qemu-user, and gcc of the architectures below); what a
machine cannot run is printed as not run.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / "export" / folder) for folder in ("c", "controller")]

import export_models as models  # noqa: E402
import export_targets as targets  # noqa: E402
from cortex_m import nothing  # noqa: E402

from casadical.export import write_c  # noqa: E402
from casadical.export.c.kernel import compilers, version_of  # noqa: E402
from casadical.export.c.reference import correct  # noqa: E402
from casadical.export.c.tape_program import tape_program  # noqa: E402

VECTORS = 20_000
COMPILERS = {
    "x86-64 gcc": "gcc",
    "x86-64 clang": "clang",
    "aarch64": "aarch64-linux-gnu-gcc",
    "armhf": "arm-linux-gnueabihf-gcc",
    "riscv64": "riscv64-linux-gnu-gcc",
    "ppc64": "powerpc64-linux-gnu-gcc",
}
EMULATORS = {"aarch64": "qemu-aarch64", "armhf": "qemu-arm", "riscv64": "qemu-riscv64", "ppc64": "qemu-ppc64"}
WORK = Path(tempfile.mkdtemp())


def digests(folder, flags):
    """Return the hash of status and outputs on each processor, by its name."""
    found = {}
    for name, compiler in COMPILERS.items():
        emulator = [EMULATORS[name]] if name in EMULATORS else []
        if targets.missing(compiler, *emulator):
            found[name] = "not run"
            continue
        out = WORK / "bench"
        command = [compiler, "-std=gnu11", "-O2", "-static", "-ffp-contract=off", f"-I{folder}", *flags]
        subprocess.run([*command, targets.HERE / "bench.c", folder / "arm.c", "-o", out], check=True)
        found[name] = subprocess.run([*emulator, out], capture_output=True, text=True, check=True).stdout.strip()
    if not targets.missing("arm-none-eabi-gcc", "qemu-system-arm"):
        found |= {board: targets.cortex(board, [folder / "arm.c"], folder, flags).digest for board in targets.CORTEX}
    return found


def main():
    print("Exported C: 6R arm with 30 calibrated values and compliance, 6-5-3 network; tests/export/c/export_models.py")
    print(*(f"  {version_of(compiler)}" for compiler in compilers()), sep="\n")
    print(f"\nthe same bits on other processors, {VECTORS} vectors, one hash (status and outputs)")
    folders, command = {}, models.command(models.network_function())
    for real in ("float", "double"):
        folders[real] = WORK / real
        write_c(command, folders[real], name="arm", real=real, vectors=1000)
        wanted = targets.digest(*correct(tape_program(command, real), targets.bench_inputs(real, VECTORS)))
        found = digests(folders[real], targets.defines(real, "arm_correct", 6, VECTORS))
        same = ", ".join(["NumPy", *(name for name, digest in found.items() if digest == wanted)])
        others = {name: digest for name, digest in found.items() if digest != wanted}
        print(f"  command {real}: {wanted} on {same}" + (f"; OTHERS {others}" if others else ""), flush=True)
    print("\nCortex-M under QEMU: instructions a call (least to most), gcc -O2; flash and RAM that it adds")
    if targets.missing("arm-none-eabi-gcc", "qemu-system-arm"):
        print("  not run")
        return
    for board, real in (("M4F", "float"), ("M7", "double")):
        empty = nothing(board, real, 10)
        flags = targets.defines(real, "arm_correct", 6, 10)
        it = targets.cortex(board, [folders[real] / "arm.c"], folders[real], flags)
        size = f"{it.text - empty.text} B flash, {it.ram - empty.ram} B RAM"
        print(f"  command {real}, {board}: {it.least:.0f} to {it.most:.0f}; {size}", flush=True)


if __name__ == "__main__":
    main()
