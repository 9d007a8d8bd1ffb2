"""Run `python docs/studies/c_matrix.py [--install]`: every figure of the exported C.

The bits that processors under QEMU compute, and instruction counts, flash and RAM on Cortex-M. The robot and the
network are those of tests/export/c. `--quick` takes a hundredth of the vectors, `--only NAMES` some of the sections.
`--install` first installs Debian's packages of the tools that are missing. What a machine cannot run is printed as not
run, with the reason.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / "export" / folder) for folder in ("c", "controller")]

import export_models as models  # noqa: E402
import export_targets as targets  # noqa: E402

from casadical.export import write_c  # noqa: E402
from casadical.export.c.kernel import compilers  # noqa: E402
from casadical.export.c.reference import correct, network  # noqa: E402
from casadical.export.c.tape_program import tape_program  # noqa: E402

PACKAGES = {
    "gcc": "gcc",
    "clang": "clang",
    "arm-none-eabi-gcc": "gcc-arm-none-eabi libnewlib-arm-none-eabi",
    "qemu-system-arm": "qemu-system-arm",
    "qemu-aarch64": "qemu-user",
    "aarch64-linux-gnu-gcc": "gcc-aarch64-linux-gnu libc6-dev-arm64-cross",
    "arm-linux-gnueabihf-gcc": "gcc-arm-linux-gnueabihf libc6-dev-armhf-cross",
    "riscv64-linux-gnu-gcc": "gcc-riscv64-linux-gnu libc6-dev-riscv64-cross",
    "powerpc64-linux-gnu-gcc": "gcc-powerpc64-linux-gnu libc6-dev-ppc64-cross",
}
FOREIGN = {
    "aarch64": "aarch64-linux-gnu-gcc",
    "armhf": "arm-linux-gnueabihf-gcc",
    "riscv64": "riscv64-linux-gnu-gcc",
    "ppc64": "powerpc64-linux-gnu-gcc",
}
QEMU = {"armhf": "qemu-arm"}
REALS = ("float", "double")
WORK = Path(tempfile.mkdtemp())

NETWORK = models.network_function()
PRODUCTS = {"network": NETWORK, "command": models.command(NETWORK)}


def install():
    """Install Debian's packages of the tools that are missing, where that is allowed."""
    lacking = sorted({p for tool, p in PACKAGES.items() if shutil.which(tool) is None})
    if lacking and os.geteuid() == 0 and shutil.which("apt-get"):
        names = " ".join(lacking).split()
        subprocess.run(["apt-get", "update"], check=False, capture_output=True)
        command = ["apt-get", "install", "-y", "--no-install-recommends", *names]
        environment = os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
        subprocess.run(command, check=False, capture_output=True, env=environment)


def section(title):
    print(f"\n{title}", flush=True)


def line(what, figure, target=""):
    print(f"  {what:58s} {figure}" + (f"   [target {target}]" if target else ""), flush=True)


def run(command, **more):
    return subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False, **more)


def lacking(*tools):
    gone = targets.missing(*tools)
    return f"not run: {', '.join(gone)} not installed" if gone else ""


def host_and_foreign(folder, flags):
    found = {}
    sources = [targets.HERE / "bench.c", folder / "arm.c"]
    for name, compiler in {"x86-64 gcc": "gcc", "x86-64 clang": "clang"}.items() | FOREIGN.items():
        qemu = QEMU.get(name, f"qemu-{name}")
        if lacking(compiler, *([qemu] if name in FOREIGN else [])):
            found[name] = "not run"
            continue
        out = WORK / "bench"
        command = [compiler, "-std=gnu11", "-O2", "-static", "-ffp-contract=off", f"-I{folder}", *flags, *sources]
        built = run([*command, "-o", out])
        if built.returncode:
            found[name] = built.stderr[:200]
            continue
        found[name] = run([*([qemu] if name in FOREIGN else []), out]).stdout.strip()
    return found


def nothing(board, real, optimise):
    """The image with a function that does nothing: what the bench itself weighs."""
    (WORK / "empty.h").write_text("int empty(const float *q, float *out);\n".replace("float", real))
    (WORK / "empty.c").write_text(
        f'#include "empty.h"\nint empty(const {real} *q, {real} *out) {{ out[0] = q[0]; return 0; }}\n'
    )
    flags = targets.defines(real, "empty", 6, 10, header="empty.h")
    return targets.cortex(board, [WORK / "empty.c"], WORK, flags, optimise=optimise)


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
    parser.add_argument("--install", action="store_true")
    options = parser.parse_args()
    share = 100 if options.quick else 1
    if options.install:
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
