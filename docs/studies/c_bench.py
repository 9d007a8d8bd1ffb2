"""What the studies of the exported C share: tools, products, builds for processors under QEMU, and how they print."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / "export" / folder) for folder in ("c", "controller")]

import controller_arms as arms  # noqa: E402, F401
import export_models as models  # noqa: E402
import export_targets as targets  # noqa: E402

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
