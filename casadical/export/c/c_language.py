"""C99: header, source, self-test and example with the vectors that are compared, CMake, pkg-config, CasADi's own C."""

from typing import Any

import casadi
import numpy as np

from casadical.core.basics import Array
from casadical.export.c.c_source import SCHEMA, common_values, header, source
from casadical.export.c.coefficients import DTYPE, Real, literal
from casadical.export.c.emit import filled, template
from casadical.export.c.language import Label, Language
from casadical.export.c.reference import correct, forward, network, started, step
from casadical.export.c.tape_program import TapeProgram


class C99(Language):
    """The language that is compiled and compared; every export has it."""

    name = "c"

    def files(self, program: TapeProgram, label: Label) -> dict[str, str]:
        """What `write_c` compiles, and what an integrator needs around it."""
        name = label.name
        values = {"name": name, "schema": str(SCHEMA)}
        return {
            f"{name}.h": header(program, label),
            f"{name}.c": source(program, label),
            f"{name}_self_test.c": self_test_source(program, label),
            f"{name}_example.c": example_source(program, label),
            "CMakeLists.txt": filled(template("CMakeLists.txt"), values),
            f"{name}.pc.in": filled(template("pkg_config.pc.in"), values | _FILLED_BY_CMAKE),
            f"cross_check/{name}_casadi.c": other_source(program, label),
        }


_FILLED_BY_CMAKE = {f"CMAKE_INSTALL_{key}": f"@CMAKE_INSTALL_{key}@" for key in ("PREFIX", "LIBDIR", "INCLUDEDIR")}


def other_source(program: TapeProgram, label: Label) -> str:
    """C by CasADi's own code generator (double, with math.h): a second way from the same functions to numbers."""
    generator = casadi.CodeGenerator(f"{label.name}_casadi", {"with_header": False})
    functions = {} if program.network is None else {program.network.key: program.network.function}
    if program.command is not None:
        functions |= {"nominal": program.command.nominal, "calibrated": program.command.calibrated}
    for key, function in functions.items():
        q = [casadi.SX.sym("q", program.n)]
        generator.add(casadi.Function(f"{label.name}_casadi_{key}", q, function.call(q)))
    return str(generator.dump())


_SEED = 20201  # of the vectors; any number does, the same one each time keeps the files the same
CYCLES, ON_CYCLES = 8, 6


def inside(program: TapeProgram, count: int, seed: int = _SEED) -> Array:
    lower, upper = program.product.lower, program.product.upper
    return np.random.default_rng(seed).uniform(lower, upper, (count, program.n)).astype(DTYPE[program.real])


def self_test_inputs(program: TapeProgram) -> Array:
    """The middle, eight corners, sixteen random points, and four outside the box."""
    lower, upper, n = program.product.lower, program.product.upper, program.n
    signs = np.random.default_rng(_SEED).integers(0, 2, (8, n))
    corners = np.where(signs == 1, upper, lower)
    outside = (lower + upper) / 2 + (upper - lower) * np.array([[0.6], [-0.6], [40.0], [-1e6]])
    rows: Array = np.vstack([(lower + upper) / 2, corners, inside(program, 16), outside])
    return rows.astype(DTYPE[program.real])


def comparison_inputs(program: TapeProgram, count: int) -> Array:
    """Mostly random joints inside the box; one row in eight outside, some far, some not finite, some at corners."""
    T = DTYPE[program.real]
    q = inside(program, count, _SEED + 1)
    rng = np.random.default_rng(_SEED + 2)
    odd = np.flatnonzero(np.arange(count) % 8 == 7)
    scales = T(10.0) ** rng.uniform(0, 6, len(odd)).astype(T)
    q[odd] *= scales[:, None]
    corner = odd[::4]
    low = rng.integers(0, 2, (len(corner), program.n)) == 1
    q[corner] = np.where(low, program.product.lower, program.product.upper)
    special = odd[1::16]
    values = np.array([np.nan, np.inf, -np.inf, np.finfo(T).max, -np.finfo(T).max, np.finfo(T).tiny, -0.0], T)
    q[special, rng.integers(0, program.n, len(special))] = values[rng.integers(0, len(values), len(special))]
    return q


def functions(program: TapeProgram) -> dict[str, Any]:
    """The exported functions of joints alone, with the reference that computes each."""
    known: dict[str, Any] = {}
    if program.network is not None:
        known[program.network.key] = network
    if program.command is not None:
        known |= {"forward": forward, "correct": correct}
    return known


def self_test_source(program: TapeProgram, label: Label) -> str:
    real, q = program.real, self_test_inputs(program)
    values = common_values(program, label) | {
        "rows": str(len(q)),
        "inputs": _rows(q, real),
        "MAX": "FLT_MAX" if real == "float" else "DBL_MAX",
        "zeros": ", ".join([literal(0.0, real)] * program.n),
    }
    parts, checks, bad_checks = [], [], []
    for name, compute in functions(program).items():
        out, status = compute(program, q)
        mine = {"function": name, "size": str(out.shape[1]), "expected": _rows(out, real, 8)}
        mine["statuses"] = ", ".join(f"{int(s)}U" for s in status)
        parts.append(filled(template("self_test_rows.c"), values | mine))
        checks.append(f"    passed = passed & {label.name}_test_{name}();")
        bad_checks.append(f"        passed = passed & {label.name}_test_bad_{name}(q);\n")
    if program.command is not None:
        parts.append(_step_part(program, values, q[0]))
        checks.append(f"    passed = passed & {label.name}_test_step();")
    values |= {"functions": "".join(parts), "checks": "\n".join(checks), "bad_checks": "".join(bad_checks)}
    return filled(template("self_test.c"), values)


def _step_part(program: TapeProgram, values: dict[str, str], q: Array) -> str:
    state = started(program)
    given = [step(program, state, q, k < ON_CYCLES) for k in range(CYCLES)]
    mine = {"cycles": str(CYCLES), "on_cycles": str(ON_CYCLES)}
    mine["expected_step"] = _rows(np.array([dq for dq, _ in given]), program.real, 8)
    mine["statuses_step"] = ", ".join(f"{int(status)}U" for _, status in given)
    return filled(template("self_test_step.c"), values | mine)


def example_source(program: TapeProgram, label: Label) -> str:
    values = common_values(program, label)
    values["zeros"] = ", ".join([literal(0.0, program.real)] * program.n)
    values["centre"] = ", ".join(literal(float(v), program.real) for v in self_test_inputs(program)[0])
    parts = [template("example_network.c")] if program.network else []
    if program.command:
        parts.append(template("example_command.c"))
        limits = program.command.limits
        values["all_cycles"] = str(int(np.ceil(2 * limits.ramp_s / limits.cycle_s)))
    values["body"] = "".join(filled(part, values) for part in parts)
    return filled(template("example.c"), values)


def _rows(table: Array, real: Real, indent: int = 4) -> str:
    pad = " " * indent
    return ",\n".join(f"{pad}{{ {', '.join(literal(float(v), real) for v in row)} }}" for row in table)
