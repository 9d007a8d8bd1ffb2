"""Run `python docs/studies/c_curves.py`: joint error curves in C, as tables and as sums of harmonics.

Curves of six joints with random coefficients in the sizes of `joint_error_curve`. Instructions of a call under QEMU
(least to most), bytes of the whole image beyond one that does nothing, the largest error on 10,000 random joints
and the bound, and whether every target gives the bits of the NumPy reference.
"""

import shutil
import sys
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / "export" / "c"), str(Path(__file__).parent)]

import c_bench  # noqa: E402
import export_models as models  # noqa: E402
import export_targets as targets  # noqa: E402

from casadical.effects import JointErrorCurve  # noqa: E402
from casadical.effects.joint_error_curve import series  # noqa: E402
from casadical.export import write_c  # noqa: E402
from casadical.export.c.products import CurveFunction  # noqa: E402
from casadical.export.c.reference import network as reference  # noqa: E402
from casadical.export.c.tape_program import tape_program  # noqa: E402


def curves(orders, as_table, seed=1):
    """curves:(q[6])->(dq[6]), called as a whole (it becomes tables) or written out."""
    size = np.array([s for s, _ in JointErrorCurve(orders=orders).sizes().values()]).reshape(6, orders, 2)
    values = size * np.random.default_rng(seed).normal(size=size.shape)
    q = ca.SX.sym("q", 6)
    rows = ca.vertcat(*[series(q[j], *values[j].T) for j in range(6)])
    inner = ca.Function("joint_curves", [q], [rows], {"never_inline": as_table})
    return CurveFunction(ca.Function("curves", [q], [inner(q)]), models.LOWER, models.UPPER)


def measured(orders, as_table, board, real, folder):
    product = curves(orders, as_table)
    export = write_c(product, folder, name="arm", real=real, vectors=100_000, overwrite=True)
    flags = targets.defines(real, "arm_curves", 6, 500)
    wanted = targets.digest(*reference(tape_program(product, real), targets.bench_inputs(real, 500)))
    found = c_bench.host_and_foreign(folder, flags)
    words = []
    for optimise in ("-O2", "-Os"):
        it = targets.cortex(board, [folder / "arm.c"], folder, flags, optimise=optimise)
        found[f"{board} {optimise}"] = it.digest
        flash = it.text - c_bench.nothing(board, real, optimise).text
        words.append(f"{optimise} {it.least:.0f} to {it.most:.0f} instructions, {flash} B flash")
    error, bound = export.figures["curves_error_urad"], export.figures.get("table_error_urad_at_most")
    kind = "table" if as_table else "harmonics"
    print(f"{orders} orders, {kind}, {board} {real}: {'; '.join(words)}", flush=True)
    print(f"    error {error:g} urad" + (f", bound {bound:g} urad" if bound else "; only rounding"))
    same = [name for name, digest in found.items() if digest == wanted]
    other = [f"{name}: {digest}" for name, digest in found.items() if digest != wanted]
    print(f"    bits of the reference on {', '.join(same)}" + (f"; {'; '.join(other)}" if other else ""))
    if as_table:
        once, twice = (export.figures[f"rest_{word}_urad"] for word in ("once", "twice"))
        print(f"    largest error left by q - dq(q): {once:g} urad, by q - dq(q - dq(q)): {twice:g} urad")
        lint = targets.cppcheck(folder, ["arm.c", "arm_self_test.c"])
        print(f"    cppcheck with the MISRA C:2012 addon: {len(lint)} findings", flush=True)


def main():
    folder = Path(tempfile.mkdtemp())
    for orders in (60, 90):
        for as_table in (True, False):
            for board, real in (("M4F", "float"), ("M7", "double")):
                measured(orders, as_table, board, real, folder / f"{orders}{as_table}{real}")
    shutil.rmtree(folder)


if __name__ == "__main__":
    main()
