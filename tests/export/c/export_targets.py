"""Run the exported C elsewhere: Cortex-M boards and foreign processors under QEMU; shared by tests and docs/studies."""

import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import export_models as models
import numpy as np

HERE = Path(__file__).parent / "targets"
TICKS = 25.6  # of the 25 MHz counter in an instruction with -icount shift=10 (1.024 us); half with shift=9, ...
TYPE = {"float": np.float32, "double": np.float64}
CORTEX = {
    "M4F": ("mps2-an386", ["-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"]),
    "M7": ("mps2-an500", ["-mcpu=cortex-m7", "-mfpu=fpv5-d16", "-mfloat-abi=hard"]),
}
# QEMU has no M0+: its code runs on an M3, which executes all of its instructions.
BOARDS = CORTEX | {
    "M0+": ("mps2-an385", ["-mcpu=cortex-m0plus", "-mfloat-abi=soft"]),
    "A53": ("virt", ["-mcpu=cortex-a53"]),
}
A53_TICKS = 64.0  # of the 62.5 MHz counter
LINT = [
    "-DFLT_EVAL_METHOD=0",
    "-DFLT_RADIX=2",
    "-DFLT_MANT_DIG=24",
    "-DDBL_MANT_DIG=53",
    "-DFLT_MAX=3e38F",
    "-DDBL_MAX=1e308",
]


@dataclass(frozen=True)
class CortexRun:
    """Instructions of a call (least, most, mean), hash of the results' bits, bytes of image and stack."""

    least: float
    most: float
    mean: float
    digest: str
    text: int
    ram: int
    stack: int

    @property
    def jitter(self) -> float:
        """Largest minus smallest count, relative to the mean."""
        return (self.most - self.least) / self.mean


def missing(*tools):
    """The tools that are not installed, for a skip's reason."""
    return [tool for tool in tools if shutil.which(tool) is None]


def need(*tools):
    """Skip a test for want of tools."""
    import pytest

    if lacking := missing(*tools):
        pytest.skip(f"not installed: {', '.join(lacking)} (apt-get install a package that has it)")


def defines(real, call, outputs, count, header="arm.h", box=(models.LOWER, models.UPPER)):
    """The bench's macros."""
    flags = [
        f"-D{name}={','.join(float(TYPE[real](v)).hex() for v in values)}"
        for name, values in zip(("LOWER", "UPPER"), box, strict=True)
    ]
    flags += [f"-DREAL_BITS={32 if real == 'float' else 64}", f"-DN_OUT={outputs}", f"-DCOUNT={count}U"]
    return flags + ([f"-DCALL={call}", f'-DPRODUCT_HEADER="{header}"'] if header else [f"-DRAW={call}"])


def cortex(board, sources, include, flags, libraries=(), optimise="-O2", shift=10):
    """Compile, run on a board, and read the counters; with a smaller shift longer calls fit into the 24-bit counter."""
    machine, processor = BOARDS[board]
    wide = board == "A53"
    with tempfile.TemporaryDirectory() as folder:
        image = Path(folder) / "image.elf"
        own = [str(HERE / ("aarch64.c" if wide else "cortex.c")), str(HERE / "bench.c")]
        build = ["arm-none-eabi-gcc", "-mthumb", "-specs=nosys.specs"]
        if wide:
            build = ["aarch64-linux-gnu-gcc", "-static", "-fno-pie", "-no-pie", "-Wl,--build-id=none"]
        build += ["-nostartfiles"]
        build += [*processor, optimise, "-std=gnu11", "-ffp-contract=off", "-ffunction-sections", "-fdata-sections"]
        build += ["-Wl,--gc-sections", f"-I{HERE}", f"-I{include}", "-DCORTEX", *flags]
        build.append(f"-T{HERE / ('aarch64.ld' if wide else 'link.ld')}")
        subprocess.run(
            [*build, *own, *map(str, sources), *libraries, "-o", str(image)], check=True, capture_output=True
        )
        size = subprocess.run(
            ["aarch64-linux-gnu-size" if wide else "arm-none-eabi-size", str(image)],
            check=True, capture_output=True, text=True,
        ).stdout.split()  # fmt: skip
        qemu = ["qemu-system-aarch64", "-cpu", "cortex-a53", "-nic", "none"] if wide else ["qemu-system-arm"]
        qemu += ["-M", machine, "-nographic", "-monitor", "none", "-serial", "none"]
        qemu += ["-semihosting-config", "enable=on,target=native", "-icount", f"shift={shift}", "-kernel", str(image)]
        run = subprocess.run(qemu, check=True, capture_output=True, text=True, timeout=300)
    least, most, total, stack, digest = (run.stdout + run.stderr).split()
    ticks = (A53_TICKS if wide else TICKS) * 2.0 ** (shift - 10)
    counts = [round(int(v, 16) / ticks, 1) for v in (least, most)]
    return CortexRun(*counts, int(total, 16) / ticks / 256, digest, int(size[6]), int(size[8]), int(stack, 16))


def bench_inputs(real, count, box=(models.LOWER, models.UPPER)):
    """The joints that targets/bench.c makes, in NumPy: a linear congruential generator, one row in sixteen tripled."""
    T = TYPE[real]
    seed, draws = 12345, np.empty(count * 6, np.uint32)
    for k in range(count * 6):
        seed = (seed * 1664525 + 1013904223) % 2**32
        draws[k] = seed
    u = (draws >> 8).astype(T) * T(1 / 16777216)
    lower, upper = (side.astype(T) for side in box)
    q = lower + u.reshape(count, 6) * (upper - lower)
    q[15::16] *= T(3)
    return q


def digest(values, status):
    """The hash that targets/bench.c prints: FNV-1a over status and bits of every row."""
    words = np.ascontiguousarray(values).view(np.uint32 if values.dtype == np.float32 else np.uint64)
    rows = np.column_stack([np.asarray(status, np.uint64), words.astype(np.uint64)])
    total = 14695981039346656037
    for byte in rows.astype("<u8").tobytes():
        total = ((total ^ byte) * 1099511628211) % 2**64
    return f"{total:016x}"


def cppcheck(folder, names):
    """Findings of cppcheck with the MISRA addon in the exported files, without the functions that users call."""
    command = ["cppcheck", "--addon=misra", "--enable=all", "--inconclusive", "--quiet", "--std=c99", *LINT]
    command += [
        "--suppress=missingIncludeSystem",
        "--suppress=unusedFunction",
        "--template={file}:{line}: {id} {message}",
    ]
    run = subprocess.run([*command, *names], cwd=folder, capture_output=True, text=True, check=False)
    return [line for line in (run.stdout + run.stderr).splitlines() if ": " in line]


def clang_tidy(folder, names):
    """Findings of clang-tidy's checks for bugs (not for names and numbers)."""
    checks = "--checks=-*,bugprone-*,cert-*,clang-analyzer-*,misc-*,performance-*,portability-*,concurrency-*"
    command = ["clang-tidy", checks, *names, "--", "-std=c99"]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return [line for line in run.stdout.splitlines() if "warning:" in line or "error:" in line]
