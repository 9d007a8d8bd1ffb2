"""Run the exported C elsewhere: Cortex-M boards and foreign processors under QEMU; shared by tests and docs/studies."""

import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import export_models as models
import numpy as np

HERE = Path(__file__).parent / "targets"
TICKS = 25.6  # of the 25 MHz counter in an instruction with -icount shift=10 (1.024 us)
TYPE = {"float": np.float32, "double": np.float64}
CORTEX = {
    "M4F": ("mps2-an386", ["-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16"]),
    "M7": ("mps2-an500", ["-mcpu=cortex-m7", "-mfpu=fpv5-d16"]),
}
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
    """Instructions of a call (least, most, mean), a hash of the results' bits, and bytes of the whole image."""

    least: float
    most: float
    mean: float
    digest: str
    text: int
    ram: int

    @property
    def jitter(self) -> float:
        """Largest minus smallest count, relative to the mean."""
        return (self.most - self.least) / self.mean


def missing(*tools):
    """The tools that are not installed, for a skip's reason."""
    return [tool for tool in tools if shutil.which(tool) is None]


def defines(real, call, outputs, count, header="arm.h"):
    """The bench's macros."""
    box = [("LOWER", models.LOWER), ("UPPER", models.UPPER)]
    flags = [f"-D{name}={','.join(float(TYPE[real](v)).hex() for v in values)}" for name, values in box]
    flags += [f"-DREAL_BITS={32 if real == 'float' else 64}", f"-DN_OUT={outputs}", f"-DCOUNT={count}U"]
    return flags + ([f"-DCALL={call}", f'-DPRODUCT_HEADER="{header}"'] if header else [f"-DRAW={call}"])


def cortex(board, sources, include, flags, libraries=(), optimise="-O2"):
    """Compile, run on a board, and read the counters."""
    machine, processor = CORTEX[board]
    with tempfile.TemporaryDirectory() as folder:
        image = Path(folder) / "image.elf"
        own = [str(HERE / "cortex.c"), str(HERE / "bench.c")]
        build = ["arm-none-eabi-gcc", *processor, "-mthumb", "-mfloat-abi=hard", optimise, "-std=gnu11"]
        build += ["-ffp-contract=off", "-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections", "-nostartfiles"]
        build += ["-specs=nosys.specs", f"-I{HERE}", f"-I{include}", f"-T{HERE / 'link.ld'}", "-DCORTEX", *flags]
        subprocess.run(
            [*build, *own, *map(str, sources), *libraries, "-o", str(image)], check=True, capture_output=True
        )
        size = subprocess.run(
            ["arm-none-eabi-size", str(image)], check=True, capture_output=True, text=True
        ).stdout.split()
        qemu = ["qemu-system-arm", "-M", machine, "-nographic", "-monitor", "none", "-serial", "none"]
        qemu += ["-semihosting-config", "enable=on,target=native", "-icount", "shift=10", "-kernel", str(image)]
        run = subprocess.run(qemu, check=True, capture_output=True, text=True, timeout=300)
    least, most, total, digest = (run.stdout + run.stderr).split()
    counts = [round(int(v, 16) / TICKS, 1) for v in (least, most)]
    return CortexRun(*counts, int(total, 16) / TICKS / 256, digest, int(size[6]), int(size[8]))


def _output(*command):
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def bench_inputs(real, count):
    """The joints that targets/bench.c makes, in NumPy: a linear congruential generator, one row in sixteen tripled."""
    T = TYPE[real]
    seed, draws = 12345, np.empty(count * 6, np.uint32)
    for k in range(count * 6):
        seed = (seed * 1664525 + 1013904223) % 2**32
        draws[k] = seed
    u = (draws >> 8).astype(T) * T(1 / 16777216)
    lower, upper = models.LOWER.astype(T), models.UPPER.astype(T)
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
