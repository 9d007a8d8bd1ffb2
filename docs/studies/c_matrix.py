"""Run `python docs/studies/c_matrix.py` (as root it installs what is missing): every figure of the exported C.

Compilers, processors under QEMU, analysers, fuzzing, instruction counts and times beside CasADi's own generated C. The
robot and the network are those of tests/export/c. `--quick` takes a hundredth of the vectors, `--only NAMES` some of
the sections (`--help` lists them). What a machine cannot run is printed as not run, with the reason.
"""

import argparse
import shutil
from dataclasses import replace

import casadi as ca
import numpy as np
from c_bench import (
    PRODUCTS,
    REALS,
    WORK,
    casadi_c,
    host_and_foreign,
    install,
    lacking,
    line,
    models,
    nothing,
    run,
    section,
    targets,
)  # fmt: skip
from c_proofs import analysers, eva, fuzz, self_tests

from casadical.export import Status, load, write_c
from casadical.export.c.c_source import inside
from casadical.export.c.kernel import build, compilers
from casadical.export.c.reference import correct, network
from casadical.export.c.tape_program import tape_program
from casadical.export.c.write import shape_of

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


def three_million(folders, count):
    section("network, 3e6 outputs, 0 ulp wanted")
    for real in REALS:
        program = tape_program(PRODUCTS["network"], real)
        q = inside(program, count, seed=1)
        expected, _ = network(program, q)
        for compiler in compilers():
            folder = folders["network", real]
            sources = [folder / "arm.c", folder / "arm_self_test.c"]
            out, _ = build(shape_of(program), sources, WORK, compiler, (f"-DTIME={real}",)).network(q)
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


SECTIONS = {
    "vectors": lambda folders, share: three_million(folders, 1_000_000 // share),
    "processors": lambda folders, share: processors(folders, 20_000 // share),
    "cortex": lambda folders, _: cortex_m(folders),
    "times": lambda folders, _: host_times(folders),
    "steps": lambda _, share: convergence(20_000 // min(share, 10)),
    "any": lambda folders, share: any_input(folders, 1_000_000 // share),
    "analysers": lambda folders, _: analysers(folders),
    "eva": lambda folders, _: eva(folders),
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


if __name__ == "__main__":
    main()
