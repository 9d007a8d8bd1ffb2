"""Run `python docs/studies/c_matrix.py` (as root it installs what is missing): every figure of the exported C.

Compilers, processors under QEMU, analysers, fuzzing, instruction counts and times beside CasADi's own generated C. The
robot and the network are those of tests/export/c. `--quick` takes a hundredth of the vectors, `--only NAMES` some of
the sections (`--help` lists them). What a machine cannot run is printed as not run, with the reason.
"""

import argparse
import itertools
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / "export" / folder) for folder in ("c", "controller")]

import controller_arms as arms  # noqa: E402
import export_models as models  # noqa: E402
import export_targets as targets  # noqa: E402

from casadical.export import Command, NetworkFunction, Sources, Status, command_of, load, write_c  # noqa: E402
from casadical.export.c.reference import correct, network  # noqa: E402
from casadical.export.c.self_test import inside  # noqa: E402
from casadical.export.c.tape_program import tape_program  # noqa: E402
from casadical.export.c.toolchain import WARNINGS, compilers  # noqa: E402
from casadical.robot.knowledge import ErrorBound  # noqa: E402

PACKAGES = {
    "gcc": "gcc",
    "clang": "clang",
    "clang-tidy": "clang-tidy",
    "cppcheck": "cppcheck",
    "frama-c": "frama-c-base",
    "arm-none-eabi-gcc": "gcc-arm-none-eabi libnewlib-arm-none-eabi",
    "qemu-system-arm": "qemu-system-arm",
    "qemu-aarch64": "qemu-user",
    "aarch64-linux-gnu-gcc": "gcc-aarch64-linux-gnu libc6-dev-arm64-cross",
    "arm-linux-gnueabihf-gcc": "gcc-arm-linux-gnueabihf libc6-dev-armhf-cross",
    "riscv64-linux-gnu-gcc": "gcc-riscv64-linux-gnu libc6-dev-riscv64-cross",
    "powerpc64-linux-gnu-gcc": "gcc-powerpc64-linux-gnu libc6-dev-ppc64-cross",
    "valgrind": "valgrind",
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


def install():
    """Install Debian's packages of the tools that are missing, where that is allowed."""
    lacking = sorted({p for tool, p in PACKAGES.items() if shutil.which(tool) is None})
    if lacking and os.geteuid() == 0 and shutil.which("apt-get"):
        names = " ".join(lacking).split()
        if not list(Path("/usr/lib").glob("clang/*/lib/linux/libclang_rt.fuzzer*")):
            names.append("libclang-rt-14-dev")
        subprocess.run(["apt-get", "update"], check=False, capture_output=True)
        command = ["apt-get", "install", "-y", "--no-install-recommends", *names]
        environment = os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
        subprocess.run(command, check=False, capture_output=True, env=environment)
    if shutil.which("frama-c") is None:
        print("(frama-c cannot be installed here)")


def section(title):
    print(f"\n{title}", flush=True)


def line(what, figure, target=""):
    print(f"  {what:58s} {figure}" + (f"   [target {target}]" if target else ""), flush=True)


def run(command, **more):
    return subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False, **more)


def lacking(*tools):
    gone = targets.missing(*tools)
    return f"not run: {', '.join(gone)} not installed" if gone else ""


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


def three_million(folders, count):
    section("network, 3e6 outputs, 0 ulp wanted")
    for real in REALS:
        program = tape_program(PRODUCTS["network"], real)
        q = inside(program, count, seed=1)
        expected, _ = network(program, q)
        for compiler in compilers():
            from casadical.export.c.kernel import build
            from casadical.export.c.verification import shape_of

            folder = folders["network", real]
            sources = [folder / "arm.c", folder / "arm_self_test.c"]
            out, _ = build(shape_of(program, "arm"), sources, WORK, compiler, (f"-DTIME={real}",)).network(q)
            line(f"{real}, {compiler.command}", f"{out.size} outputs, {(out != expected).sum()} differ", "0")


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


def casadi_c(real):
    """CasADi's generated network in three variants: tanh, 1-2/(exp+1), and tanh on the exporter's own functions."""
    generated = {}
    for form in ("tanh", "one_minus"):
        name = f"generated_{form}_{real}"
        options = {"casadi_real": real, "casadi_int": "long long int", "with_header": False}
        generator = ca.CodeGenerator(name, options)
        q = ca.SX.sym("q", 6)
        generator.add(ca.Function("network", [q], [models.network_dp(q, 0, 5, form)]))
        path = WORK / f"{name}.c"
        path.write_text(generator.dump())
        generated[form] = path
    return generated | {"portable": portable(generated["tanh"], real)}


def portable(path, real):
    """CasADi's C with its tanh replaced by the exporter's: the second way to get there, for comparison."""
    from casadical.export.c.emit import elementary_functions

    function = elementary_functions([tape_program(PRODUCTS["network"], real).tapes["network"]], "arm", real)
    text = path.read_text().replace("#include <math.h>", f"#include <stdint.h>\ntypedef {real} arm_real;\n{function}\n")
    out = path.with_name(f"portable_{real}.c")
    out.write_text(re.sub(r"\btanh\(", "arm_tansig(", text))
    return out


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
    for real, board in (("float", "M4F"), ("double", "M7")):
        for form, path in casadi_c(real).items():
            flags = targets.defines(real, "network", 3, 10, header=None)
            it = targets.cortex(board, [path], WORK, flags, libraries=["-lm"])
            base = empty[board, real, "-O2"]
            figure = f"{it.least:.0f} to {it.most:.0f}, {100 * it.jitter:.1f} %; {it.text - base.text} B flash added"
            line(f"CasADi generate, {form}, {real}, {board} -O2", figure)


def nothing(board, real, optimise):
    """The image with a function that does nothing: what the bench itself weighs."""
    (WORK / "empty.h").write_text("int empty(const float *q, float *out);\n".replace("float", real))
    (WORK / "empty.c").write_text(
        f'#include "empty.h"\nint empty(const {real} *q, {real} *out) {{ out[0] = q[0]; return 0; }}\n'
    )
    flags = targets.defines(real, "empty", 6, 10, header="empty.h")
    return targets.cortex(board, [WORK / "empty.c"], WORK, flags, optimise=optimise)


TIMER = """
#define _POSIX_C_SOURCE 199309L
#include <stdint.h>
#include <stdio.h>
#include <time.h>
#ifdef PRODUCT_HEADER
#include PRODUCT_HEADER
#endif
typedef REAL real;
static real q[4096][6], out[4096][6];
#ifdef RAW
int RAW(const real **arg, real **res, long long int *iw, real *w, int mem);
static real scratch[4096];
#endif
int main(void)
{
    const real lower[6] = {LOWER}, upper[6] = {UPPER};
    uint32_t seed = 1U;
    for (int k = 0; k < 4096; k++) for (int i = 0; i < 6; i++) {
        seed = seed * 1664525U + 1013904223U;
        q[k][i] = lower[i] + (upper[i] - lower[i]) * (real)(seed >> 8) / (real)16777216;
    }
    double best = 1e9;
    for (int pass = 0; pass < PASSES; pass++) {
        struct timespec a, b;
        clock_gettime(CLOCK_MONOTONIC, &a);
        for (int k = 0; k < 4096; k++) {
#ifdef RAW
            const real *arg[1] = {q[k]}; real *res[1] = {out[k]};
            RAW(arg, res, 0, scratch, 0);
#else
            (void)CALL(q[k], out[k]);
#endif
        }
        clock_gettime(CLOCK_MONOTONIC, &b);
        const double ns = ((b.tv_sec - a.tv_sec) * 1e9 + (b.tv_nsec - a.tv_nsec)) / 4096;
        best = ns < best ? ns : best;
    }
    printf("%.2f\\n", best);
    return (int)out[7][0] & 0;
}
"""


def timer(compiler, sources, folder, flags, real):
    (WORK / "timer.c").write_text(TIMER)
    out = WORK / f"timer_{len(list(WORK.glob('timer_*')))}"
    command = [
        compiler,
        "-std=gnu11",
        "-O2",
        "-ffp-contract=off",
        f"-DREAL={real}",
        "-DPASSES=300",
        f"-I{folder}",
        *flags,
    ]
    built = run([*command, WORK / "timer.c", *sources, "-lm", "-o", out])
    if built.returncode:
        raise RuntimeError(built.stderr)
    return out


def host_times(folders):
    section(
        "x86-64, ns a call (best of 5 x 300 passes, taken in turns), and relative to CasADi's tanh code in the same run"
    )
    for compiler in [c for c in ("gcc", "clang") if shutil.which(c)]:
        for real in REALS:
            flags = targets.defines(real, "arm_network", 3, 1)
            folder = folders["network", real]
            programs = {"exported network, guarded": timer(compiler, [folder / "arm.c"], folder, flags, real)}
            raw = targets.defines(real, "network", 3, 1, header=None)
            for form, path in casadi_c(real).items():
                programs[f"CasADi generate, {form}"] = timer(compiler, [path], WORK, raw, real)
            command_flags = targets.defines(real, "arm_correct", 6, 1)
            folder = folders["command", real]
            programs["exported command, 2 steps, guarded"] = timer(
                compiler, [folder / "arm.c"], folder, command_flags, real
            )
            best = dict.fromkeys(programs, 1e9)
            for _ in range(5):
                for name, program in programs.items():
                    best[name] = min(best[name], float(run([program]).stdout))
            for name, ns in best.items():
                ratio = ns / best["CasADi generate, tanh"]
                line(
                    f"{compiler} {real}: {name}",
                    f"{ns:.1f} ns, {ratio:.2f}",
                    "0.8" if "guarded" in name and "net" in name else "",
                )


def convergence(count):
    section(f"remaining error [um] after 1, 2, 3 steps; {count} poses in the box, four random robots")
    print("  away from singular: smallest singular value of the position Jacobian above 0.7 m/rad (median here 1.1)")
    x = ca.SX.sym("x", 6)
    for seed in range(4):
        chain = models.kinematics(seed, compliance=False)
        real_robot, nominal = models.calibrated(seed), models.nominal()
        product = replace(PRODUCTS["command"], calibrated=real_robot, jacobian_of=chain, network=None)
        q = inside(tape_program(product, "double"), count, seed=7)
        slope = ca.Function("J", [x], [ca.jacobian(real_robot(x), x)])
        J = np.array(slope.map(count)(q.T)).reshape(3, count, 6).transpose(1, 0, 2)
        weakest = np.linalg.svd(J, compute_uv=False)[:, 2]
        target = np.array(nominal.map(count)(q.T))
        before = np.linalg.norm(np.array(real_robot.map(count)(q.T)) - target, axis=0)
        chosen = (weakest > 0.7) & (before > 0.025) & (before < 0.035)
        for real in REALS:
            words = []
            for steps in (1, 2, 3):
                dq, status = correct(tape_program(replace(product, steps=steps), real), q)
                moved = np.array(real_robot.map(count)((q + dq.astype(float)).T))
                rest = 1e6 * np.linalg.norm(moved - target, axis=0)
                unsaid = int(((status == Status.OK) & (rest > 50)).sum())
                words.append(
                    f"{rest[chosen].max():.3g} (median {np.median(rest[chosen]):.2g}; {unsaid} unreported > 50)"
                )
            line(f"robot {seed}, {real}, {chosen.sum()} poses from 25-35 mm", "; ".join(words), "-, 20, 1")


def any_input(folders, count):
    section(f"any bit pattern as joints, {count} vectors: the delta stays within its limit and is finite")
    for real in REALS:
        kernel, T = load(folders["command", real]), targets.TYPE[real]
        unsigned = np.uint32 if T is np.float32 else np.uint64
        q = np.random.default_rng(3).integers(0, np.iinfo(unsigned).max, (count, 6), unsigned, endpoint=True).view(T)
        q[::2] = np.random.default_rng(4).normal(size=(len(q[::2]), 6)) * 3
        dq, status = kernel.correct(q)
        limit = PRODUCTS["command"].limits.delta_rad
        names = {Status(int(s)).name: int(k) for s, k in zip(*np.unique(status, return_counts=True), strict=True)}
        line(real, f"largest |dq| {abs(dq).max():.4g} of {limit}, finite: {np.isfinite(dq).all()}, {names}", "within")


def analysers(folders):
    section("warnings and static analysis, all exported C files (source, self-test, example)")
    names = ["arm.c", "arm_self_test.c", "arm_example.c"]
    for compiler in ("gcc", "clang"):
        if reason := lacking(compiler):
            line(compiler, reason)
            continue
        runs = [
            run([compiler, "-std=c99", "-O2", *WARNINGS, "-c", n, "-o", "/dev/null"], cwd=f)
            for f in folders.values()
            for n in names
        ]
        wrong = sum(r.returncode != 0 for r in runs)
        line(f"{compiler} {' '.join(WARNINGS)}", f"{wrong} of {len(runs)} files with a warning", "0")
    if not lacking("gcc"):
        runs = [
            run(["gcc", "-std=c99", "-O2", "-fanalyzer", "-c", n, "-o", "/dev/null"], cwd=f)
            for f in folders.values()
            for n in names[:2]
        ]
        line("gcc -fanalyzer", f"{sum(r.stderr.count('warning:') for r in runs)} findings", "0")
    line(
        "cppcheck with the MISRA C:2012 addon",
        lacking("cppcheck") or f"{sum(len(targets.cppcheck(f, names[:2])) for f in folders.values())} findings",
        "0",
    )
    line(
        "clang-tidy bugprone, cert, analyzer, misc, performance",
        lacking("clang-tidy") or f"{sum(len(targets.clang_tidy(f, names[:2])) for f in folders.values())} findings",
        "0",
    )
    if not lacking("cppcheck"):
        path = casadi_c("float")["tanh"]
        line(
            "the same cppcheck on CasADi's generated network",
            f"{len(targets.cppcheck(path.parent, [path.name]))} findings",
        )


EVA = """
#include <float.h>
#include "arm.h"
volatile REAL any;
int main(void)
{
    REAL q[6];
    REAL dp[3];
    for (int i = 0; i < 6; i++) {
        REAL v = any;
        /*@ assert finite: \\is_finite(v); */
        q[i] = v;
    }
    arm_network(q, dp);
    REAL a = dp[0], b = dp[1], c = dp[2];
    Frama_C_show_each_dp(a, b, c);
    return 0;
}
"""


def split_for_eva(folder, real):
    """A copy of the source with an annotation: EVA takes the tansig's argument piece by piece, in the same code."""
    limit = {"float": 9.25, "double": 19.5}[real]
    edges = (np.arange(0.5, 2 * limit / np.log(2) + 1, 0.5) * np.log(2) / 2).tolist()
    pieces = [f"x <= {edges[0]!r}", *(f"{a!r} <= x <= {b!r}" for a, b in itertools.pairwise(edges))]
    note = "    /*@ assert pieces: " + " || ".join([*pieces, f"{edges[-1]!r} <= x"]) + "; */\n"
    text = (folder / "arm.c").read_text()
    place = text.index("    const arm_real y = x + x;")
    copy = WORK / f"arm_{real}.c"
    copy.write_text(text[:place] + note + text[place:])
    return copy


def eva(folders):
    section("Frama-C EVA, the network, any finite joints")
    if reason := lacking("frama-c"):
        line("frama-c", reason)
        return
    for real in REALS:
        folder = folders["network", real]
        main = WORK / f"eva_{real}.c"
        main.write_text(EVA.replace("REAL", real))
        command = ["frama-c", "-eva", "-eva-precision", "5", "-eva-slevel", "3000", "-warn-special-float", "non-finite"]
        command += [f"-cpp-extra-args=-I{folder} -DFLT_EVAL_METHOD=0", main, split_for_eva(folder, real)]
        result = run(command)
        text = result.stdout + result.stderr
        alarms = re.findall(r"\[eva:alarm\] (.*?):\s*(Warning:.*?)(?=\n\[)", text, flags=re.S)
        own = [f"{where} {what}" for where, what in alarms if "arm_" in where]
        shown = re.findall(r"Frama_C_show_each_dp:\s*((?:.*,\n)*.*)", text)
        bounds = tape_program(PRODUCTS["network"], real).network_bounds
        done = "ANALYSIS SUMMARY" in text
        line(
            f"{real}",
            "not run: " + text[-300:]
            if not done
            else f"{len(own)} alarms in the exported C" + (f"; {own[:3]}" if own else ""),
            "0",
        )
        line("  EVA's bounds of dp_mm", " ".join("".join(shown[-1:]).split()) or "none")
        line("  the header's bounds", " ".join(f"[{a:.6g} .. {b:.6g}]" for a, b in bounds))


EVA_BOUND = """
#include <float.h>
#include "arm.h"
volatile REAL any;
int main(void)
{
    REAL q[6];
    REAL bound_mm[1];
    for (int i = 0; i < 6; i++) {
        REAL v = any;
        /*@ assert finite: \\is_finite(v); */
        q[i] = v;
    }
    arm_bound(q, bound_mm);
    REAL b = bound_mm[0];
    Frama_C_show_each_bound(b);
    return 0;
}
"""


def eva_of_bound():
    """The bound of the UR10 with planted errors (synthetic); EVA takes the angle of each sine in pieces of pi/8."""
    section("Frama-C EVA, the bound of the error that remains, any finite joints")
    if reason := lacking("frama-c"):
        line("frama-c", reason)
        return
    names, factor = ("a2", "theta3", "joint_error_curve.s1_q2"), np.diag([2e-4, 2e-4, 3e-4])
    robot = replace(arms.planted("ur10"), bound=ErrorBound(names, factor, 2e-4, 1.7, 100))
    command = command_of(Sources(robot, arms.nominal_path("ur10")))
    edges = (np.pi / 16 + np.pi / 8 * np.arange(-40, 41)).tolist()
    pieces = [f"x <= {edges[0]!r}", *(f"{a!r} <= x <= {b!r}" for a, b in itertools.pairwise(edges))]
    note = "    /*@ assert pieces: " + " || ".join([*pieces, f"{edges[-1]!r} <= x"]) + "; */\n"
    for real in REALS:
        folder = WORK / f"bound_{real}"
        write_c(command, folder, name="arm", real=real, vectors=1000, languages=())
        main, copy = WORK / f"eva_bound_{real}.c", WORK / f"arm_bound_{real}.c"
        main.write_text(EVA_BOUND.replace("REAL", real))
        text = (folder / "arm.c").read_text()
        place = text.index("    const arm_real nearest = ")
        copy.write_text(text[:place] + note + text[place:])
        found = run(
            [
                *("frama-c", "-eva", "-eva-precision", "1", "-eva-slevel", "90"),
                *("-warn-special-float", "non-finite", f"-cpp-extra-args=-I{folder} -DFLT_EVAL_METHOD=0", main, copy),
            ]
        )
        alarms = re.findall(r"\[eva:alarm\] (.*?):\s*Warning:", found.stdout + found.stderr)
        own = [where for where in alarms if copy.name in where]
        shown = re.findall(r"Frama_C_show_each_bound: (.*)", found.stdout)
        done = "ANALYSIS SUMMARY" in found.stdout
        line(real, f"{len(own)} alarms in the exported C" if done else f"not run: {found.stdout[-300:]}", "0")
        line("  EVA's range of bound_mm", shown[-1] if shown else "none")


FUZZ = """
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include "arm.h"
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    REAL q[6] = {0}, out[6], dp[3], p[3];
    arm_state state = {{0}, 0};
    const size_t kept = size < sizeof q ? size : sizeof q;
    memcpy(q, data, kept);
    if (size > sizeof q) {
        const size_t more = size - sizeof q;
        memcpy(&state, data + sizeof q, more < sizeof state ? more : sizeof state);
    }
    if (arm_correct(q, out) > ARM_NOT_FINITE) abort();
    for (int i = 0; i < 6; i++) if (!(out[i] <= ARM_DELTA_LIMIT && out[i] >= -ARM_DELTA_LIMIT)) abort();
    if (arm_step(&state, q, size & 1U, out) > ARM_NOT_FINITE) abort();
    for (int i = 0; i < 6; i++) if (!(out[i] <= ARM_DELTA_LIMIT && out[i] >= -ARM_DELTA_LIMIT)) abort();
    if (arm_network(q, dp) > ARM_NOT_FINITE || arm_forward(q, p) > ARM_NOT_FINITE) abort();
    for (int i = 0; i < 3; i++) if (!(dp[i] - dp[i] >= 0) || !(p[i] - p[i] >= 0)) abort();
    return 0;
}
"""


def fuzz(folders, runs):
    section(
        f"libFuzzer with ASan and UBSan (float conversions too): {runs} executions of correct, step, network, forward"
    )
    if reason := lacking("clang"):
        line("fuzzing", reason)
        return
    for real in REALS:
        folder = folders["command", real]
        source = WORK / f"fuzz_{real}.c"
        source.write_text(FUZZ.replace("REAL", real))
        out = WORK / f"fuzz_{real}"
        checks = "-fsanitize=fuzzer,address,undefined,float-cast-overflow,float-divide-by-zero"
        command = [
            "clang",
            "-std=gnu11",
            "-O2",
            "-g",
            "-ffp-contract=off",
            checks,
            "-fno-sanitize-recover=all",
            f"-I{folder}",
        ]
        built = run([*command, source, folder / "arm.c", "-o", out])
        if built.returncode:
            line(real, f"not run: {built.stderr[:150]}")
            continue
        result = run([out, f"-runs={runs // 2}", "-seed=1", "-max_len=128", "-len_control=0", "-print_final_stats=1"])
        done = re.search(r"number_of_executed_units:\s*(\d+)", result.stderr)
        findings = 0 if result.returncode == 0 else 1
        line(
            real,
            f"{done[1] if done else '?'} executions, {findings} findings"
            + ("" if not findings else result.stderr[-500:]),
            "0",
        )


def self_tests(folders):
    section("the self-test: 0 passes, 8 fails; with the #error and pragmas switched off for the builds that must fail")
    main = WORK / "self.c"
    main.write_text('#include "arm.h"\nint main(void) { return (int)arm_self_test(); }\n')
    good = ["gcc -O0", "gcc -O2", "gcc -O3 -march=native", "gcc -O2 -mfma", "gcc -Os", "clang -O0", "clang -O2"]
    good += ["clang -O3 -march=native", "gcc -O2 -mfma -ffp-contract=fast"]
    bad = ["gcc -O2 -ffast-math", "gcc -O2 -mfma -ffp-contract=fast", "gcc -O2 -mfpmath=387", "clang -O2 -ffast-math"]
    bad += ["clang -O2 -mfma -ffp-contract=fast"]
    builds = [(name.split(), 0) for name in good] + [([*name.split(), "-DARM_ANY_ARITHMETIC"], 8) for name in bad]
    line("builds that must pass", "; ".join(good))
    line("builds that must fail", "; ".join(bad))
    for (kind, real), folder in folders.items():
        words, refused = [], []
        for command, wanted in builds:
            sources = [f"-I{folder}", folder / "arm.c", folder / "arm_self_test.c", main]
            built = run([*command, "-std=gnu11", *sources, "-o", WORK / "self"])
            code = run([WORK / "self"]).returncode if built.returncode == 0 else None
            if code != wanted:
                words.append(f"{' '.join(command)}: {'does not build here' if code is None else code}")
            if wanted and run([*command[:-1], "-std=gnu11", *sources, "-o", WORK / "self"]).returncode:
                refused.append(" ".join(command[:-1]))
        line(f"{kind} {real}", "all as wanted" if not words else f"except {words}", "all")
        line("  refused by #error when it is on", "; ".join(refused))


SECTIONS = {
    "vectors": lambda folders, share: three_million(folders, 1_000_000 // share),
    "processors": lambda folders, share: processors(folders, 20_000 // share),
    "cortex": lambda folders, _: cortex_m(folders),
    "times": lambda folders, _: host_times(folders),
    "steps": lambda _, share: convergence(20_000 // min(share, 10)),
    "any": lambda folders, share: any_input(folders, 1_000_000 // share),
    "analysers": lambda folders, _: analysers(folders),
    "eva": lambda folders, _: eva(folders),
    "eva_bound": lambda *_: eva_of_bound(),
    "self_test": lambda folders, _: self_tests(folders),
    "fuzz": lambda folders, share: fuzz(folders, 10_000_000 // share),
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


NETWORK = NetworkFunction(models.network(), models.LOWER, models.UPPER)
PRODUCTS = {
    "network": NETWORK,
    "command": Command(
        models.nominal(),
        models.calibrated(),
        models.LOWER,
        models.UPPER,
        jacobian_of=models.kinematics(compliance=False),
        jacobian_at=models.bent(),
        network=NETWORK,
    ),
}
CALLS = (("network", "arm_network", 3, network), ("command", "arm_correct", 6, correct))

if __name__ == "__main__":
    main()
