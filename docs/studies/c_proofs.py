"""What tools say of the exported C, for c_matrix.py: analysers, Frama-C's EVA, fuzzing, and its own self-test."""

import itertools
import re

import numpy as np
from c_bench import PRODUCTS, REALS, WORK, casadi_c, lacking, line, run, section, targets

from casadical.export.c.kernel import WARNING_FLAGS
from casadical.export.c.tape_program import tape_program


def analysers(folders):
    section("warnings and static analysis, all exported C files (source, self-test, example)")
    names = ["arm.c", "arm_self_test.c", "arm_example.c"]

    def each(words, files):
        """Runs of a compiler on all of the files."""
        command = [words[0], "-std=c99", "-O2", *words[1:], "-c", "-o", "/dev/null"]
        return [run([*command, name], cwd=f) for f in folders.values() for name in files]

    for compiler in ("gcc", "clang"):
        if reason := lacking(compiler):
            line(compiler, reason)
            continue
        runs = each([compiler, *WARNING_FLAGS], names)
        wrong = sum(r.returncode != 0 for r in runs)
        line(f"{compiler} {' '.join(WARNING_FLAGS)}", f"{wrong} of {len(runs)} files with a warning", "0")
    if not lacking("gcc"):
        found = sum(r.stderr.count("warning:") for r in each(["gcc", "-fanalyzer"], names[:2]))
        line("gcc -fanalyzer", f"{found} findings", "0")
    for what, tool, linted in (
        ("cppcheck with the MISRA C:2012 addon", "cppcheck", targets.cppcheck),
        ("clang-tidy bugprone, cert, analyzer, misc, performance", "clang-tidy", targets.clang_tidy),
    ):
        reason = lacking(tool)
        line(what, reason or f"{sum(len(linted(f, names[:2])) for f in folders.values())} findings", "0")
    if not lacking("cppcheck"):
        path = casadi_c("float")["tanh"]
        found = len(targets.cppcheck(path.parent, [path.name]))
        line("the same cppcheck on CasADi's generated network", f"{found} findings")


EVA = """
#include <float.h>
#include "arm.h"
volatile REAL any;
int main(void)
{
    REAL q[6];
    REAL out[OUTPUTS];
    for (int i = 0; i < 6; i++) {
        REAL v = any;
        /*@ assert finite: \\is_finite(v); */
        q[i] = v;
    }
    CALL(q, out);
    for (int k = 0; k < OUTPUTS; k++) {
        REAL found = out[k];
        Frama_C_show_each(k, found);
    }
    return 0;
}
"""


def evaluated(folder, real, call, outputs, *, edges, before, options):
    """EVA's alarms in the exported C, and the range of each output, for any finite joints; or why it did not end.

    edges : EVA takes the variable x piece by piece between these, in the same code; before : the line that uses it
    """
    pieces = [f"x <= {edges[0]!r}", *(f"{a!r} <= x <= {b!r}" for a, b in itertools.pairwise(edges))]
    note = "    /*@ assert pieces: " + " || ".join([*pieces, f"{edges[-1]!r} <= x"]) + "; */\n"
    text = (folder / "arm.c").read_text()
    place = text.index(before)
    copy, main = WORK / f"arm_{call}_{real}.c", WORK / f"eva_{call}_{real}.c"
    copy.write_text(text[:place] + note + text[place:])
    main.write_text(EVA.replace("REAL", real).replace("OUTPUTS", str(outputs)).replace("CALL", call))
    extra = f"-cpp-extra-args=-I{folder} -DFLT_EVAL_METHOD=0"
    result = run(["frama-c", "-eva", *options, "-warn-special-float", "non-finite", extra, main, copy])
    said = result.stdout + result.stderr
    if "ANALYSIS SUMMARY" not in said:
        return f"not run: {said[-300:]}", []
    alarms = re.findall(r"\[eva:alarm\] (.*?):\s*(Warning:.*?)(?=\n\[)", said, flags=re.S)
    own = [f"{where} {what}" for where, what in alarms if copy.name in where]
    shown = dict(re.findall(r"Frama_C_show_each:\s*\{(\d+)\},\s*(.*)", said))
    return f"{len(own)} alarms in the exported C" + (f"; {own[:3]}" if own else ""), list(shown.values())


def eva(folders):
    section("Frama-C EVA, the network, any finite joints")
    if reason := lacking("frama-c"):
        line("frama-c", reason)
        return
    for real, limit in (("float", 9.25), ("double", 19.5)):
        found, shown = evaluated(
            folders["network", real], real, "arm_network", 3,
            edges=(np.arange(0.5, 2 * limit / np.log(2) + 1, 0.5) * np.log(2) / 2).tolist(),
            before="    const arm_real y = x + x;", options=("-eva-precision", "5", "-eva-slevel", "3000"),
        )  # fmt: skip
        line(real, found, "0")
        line("  EVA's bounds of dp_mm", " ".join(shown) or "none")
        bounds = tape_program(PRODUCTS["network"], real).network_bounds
        line("  the header's bounds", " ".join(f"[{a:.6g} .. {b:.6g}]" for a, b in bounds))


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
        flags = ["-std=gnu11", "-O2", "-g", "-ffp-contract=off", checks, "-fno-sanitize-recover=all", f"-I{folder}"]
        built = run(["clang", *flags, source, folder / "arm.c", "-o", out])
        if built.returncode:
            line(real, f"not run: {built.stderr[:150]}")
            continue
        result = run([out, f"-runs={runs // 2}", "-seed=1", "-max_len=128", "-len_control=0", "-print_final_stats=1"])
        done = re.search(r"number_of_executed_units:\s*(\d+)", result.stderr)
        found = f"1 findings{result.stderr[-500:]}" if result.returncode else "0 findings"
        line(real, f"{done[1] if done else '?'} executions, {found}", "0")


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
