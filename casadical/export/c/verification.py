"""The exported C compiled and compared: with the NumPy reference bit for bit, with CasADi's doubles in micrometres."""

import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from casadical.core.basics import Array
from casadical.export.c.c_language import comparison_inputs, functions, inside
from casadical.export.c.kernel import WARNINGS, Compiler, Shape, build
from casadical.export.c.products import mapped
from casadical.export.c.reference import Status
from casadical.export.c.tape_program import TapeProgram


@dataclass(frozen=True)
class Comparison:
    """One function of the C, as one compiler made it, against the NumPy reference."""

    function: str
    compiler: str
    vectors: int
    outputs: int
    different: int  # outputs or statuses that are not the same bits

    def __str__(self) -> str:
        verdict = "identical bits" if self.different == 0 else f"{self.different} DIFFERENT"
        return f"{self.function}: {self.vectors} vectors, {self.outputs} outputs, {verdict} ({self.compiler})"


def shape_of(program: TapeProgram, name: str) -> Shape:
    sizes: dict[str, int] = {}
    if program.network is not None:
        sizes[program.network.key] = len(program.network_bounds)
    if program.command is not None:
        sizes |= {"forward": len(program.tapes["forward"].outputs), "correct": program.n}
        sizes |= {"bound": 1} if "bound" in program.tapes else {}
    return Shape(name, program.real, program.n, sizes, program.product.units)


def compared(
    program: TapeProgram, name: str, files: dict[str, bytes], found: list[Compiler], count: int
) -> list[Comparison]:
    """Compile with each compiler and compare every function on ``count`` vectors; the self-test is one vector."""
    if not found:
        return []
    q = comparison_inputs(program, count)
    results: list[Comparison] = []
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(len(found)) as pool:
        sources = [Path(folder) / file for file in (f"{name}.h", f"{name}.c", f"{name}_self_test.c")]
        for source in sources:
            source.write_bytes(files[source.name])
        shape = shape_of(program, name)
        kernels = [pool.submit(build, shape, sources[1:], Path(folder), compiler, WARNINGS) for compiler in found]
        # The compilers work in processes of their own meanwhile.
        expected = {key: compute(program, q) for key, compute in functions(program).items()}
        for compiler, built in zip(found, kernels, strict=True):
            kernel = built.result()
            results.append(Comparison("self_test", compiler.version, 1, 1, int(kernel.self_test() != Status.OK)))
            for key, (out, status) in expected.items():
                mine, my_status = kernel.rows(key, q)
                different = int((_bits(mine) != _bits(out)).sum() + (my_status != status).sum())
                results.append(Comparison(key, compiler.version, count, out.size, different))
    return results


def _bits(values: Array) -> Array:
    return np.ascontiguousarray(values).view(np.uint32 if values.dtype == np.float32 else np.uint64)


def accuracy(program: TapeProgram, count: int = 10_000) -> dict[str, float]:
    """Figures of this model, from the reference arithmetic and CasADi's doubles on joints inside the box.

    Largest errors of the network [um], of the joints' curves [urad] and of the forward kinematics [um]; for curves,
    what is left if a controller commands q - curves(q) [urad], and if it calls twice, q - curves(q - curves(q)); for a
    command, the tool's error before the correction [um], what remains of it over the poses with status OK [um], and
    their share; for poses also what remains of the orientation [urad], and the share of singular ones, which count in
    the first share only. Joints at which the model has no value (a four-bar that cannot close) count in this share
    only, not in the share of those where the correction converged. Of tables their bytes and the bound of their error,
    before rounding [urad].
    """
    q = inside(program, count)
    figures: dict[str, float] = {}
    exact = q.astype(np.float64)
    for key, compute in functions(program).items():
        values, status = compute(program, q)
        known = status != Status.NOT_FINITE
        if program.network is not None and key == program.network.key:
            function = program.network.function
            error = abs(values - mapped(function, exact))[known].max()
            if key == "curves":
                figures["curves_error_urad"] = 1e6 * float(error)
                once = exact - values
                for word, command in (("once", once), ("twice", exact - mapped(function, once))):
                    rest = command + mapped(function, command) - exact
                    figures[f"rest_{word}_urad"] = 1e6 * float(abs(rest).max())
            else:
                figures["network_error_um"] = 1e3 * float(error)
        if key == "forward" and program.command is not None:
            error = abs(values - mapped(program.command.calibrated, exact))[known, :3].max()
            figures["forward_error_um"] = 1e6 * float(error)
        if key == "bound":
            figures |= {"bound_mm_median": float(np.median(values)), "bound_mm_worst": float(values.max())}
        if key == "correct" and program.command is not None:
            wanted, moved = mapped(program.command.nominal, exact), mapped(program.command.calibrated, exact + values)
            before = np.linalg.norm(mapped(program.command.calibrated, exact)[:, :3] - wanted[:, :3], axis=1)
            fine = status == Status.OK
            rest = np.linalg.norm(moved[:, :3] - wanted[:, :3], axis=1)[fine]
            figures |= {"start_error_um_mean": 1e6 * float(before[known].mean()), "share_ok": float(fine.mean())}
            if moved.shape[1] > 3:  # of poses many are singular; a correction that says so has not failed to converge
                known = known & (status != Status.SINGULAR)
                figures["share_singular"] = float((status == Status.SINGULAR).mean())
                turned = np.linalg.norm(moved[:, 3:] - wanted[:, 3:], axis=1)[fine] / np.sqrt(2)  # small angles
                if fine.any():
                    figures |= {
                        "rest_urad_median": 1e6 * float(np.median(turned)),
                        "rest_urad_worst": 1e6 * turned.max(),
                    }
            reached = fine | (status == Status.ABOVE_LIMIT)
            figures["share_converged"] = float(reached[known].mean()) if known.any() else 0.0
            if fine.any():
                figures |= {"rest_um_median": 1e6 * float(np.median(rest)), "rest_um_worst": 1e6 * float(rest.max())}
    nodes = {node.table: node for tape in program.tapes.values() for node in tape.nodes if node.table}
    if nodes:
        figures["table_bytes"] = q.itemsize * sum(map(len, nodes))
        figures["table_error_urad_at_most"] = 1e6 * max(node.value for node in nodes.values())
    return {key: float(f"{value:.3g}") for key, value in figures.items()}
