"""The C99 files of an export: templates filled with tapes, joint box, limits and test vectors.

CasADi's own generator with these elementary functions would run as fast. Walking the tape gives
exact constants, no MISRA findings and guards where they are needed; and the NumPy reference, with
which the compiled C is compared, reads the same list.
"""

import re
import zlib
from collections.abc import Callable
from functools import cache
from importlib.resources import files
from textwrap import wrap
from typing import Any

import casadi
import numpy as np

from casadical.core.basics import Array
from casadical.export.c import coefficients
from casadical.export.c.chord import pose_size, prepared_size, residual_size
from casadical.export.c.coefficients import COEFFICIENTS, NUMPY_TYPE, Real, literal, turn_parts
from casadical.export.c.products import Command, Product
from casadical.export.c.reference import correct, forward, network, step
from casadical.export.c.tape import Node, Tape
from casadical.export.c.tape_program import TapeProgram

# Operations of a tape that the C calls as elementary functions.
_CALLED_FUNCTIONS = ("sincos", "tansig", "exp", "sqrt", "atan2")


def template(name: str) -> str:
    """Return the text of a template by its name: a short one, or a file's."""
    return _short()[name] if name in _short() else _read(name)


@cache
def _short() -> dict[str, str]:
    """Return the short templates by name; each follows a line `==== NAME` in one of the files."""
    text = "".join(_read(f"parts.{language}") for language in ("c", "h", "st"))
    return dict(part.split("\n", 1) for part in text.split("==== ")[1:])


def _read(file: str) -> str:
    """Return the text of a file in the folder of templates."""
    return (files("casadical.export.c") / "templates" / file).read_text(encoding="utf-8")


def filled(text: str, values: dict[str, str]) -> str:
    """Return a template with every @key@ replaced by its value; without one KeyError is raised."""
    return re.sub(r"@([\w:.\-]+)@", lambda match: values[match.group(1)], text)


def elementary_functions(tapes: list[Tape], name: str, real: Real) -> str:
    """Return C text of the static elementary functions and tables that the tapes call, each once.

    name : prefix of the exported C functions; real : type of numbers
    """
    nodes = [node for tape in tapes for node in tape.nodes]
    values = constants(real) | {"name": name, "real": f"{name}_real"}
    texts = [filled(template(f"{op}.c"), values) for op in _CALLED_FUNCTIONS if any(n.op == op for n in nodes)]
    for table in dict.fromkeys(n.table for n in nodes if n.table):
        points = len(table) - 3
        parts = turn_parts(COEFFICIENTS[real], points)
        numbers = dict(zip(("per_radian", "step_high", "step_low"), parts, strict=True))
        numbers |= {"offset": float(coefficients.ADDED_TURNS * points), "3": 3.0}
        words = [literal(v, real) for v in table]
        rows = (", ".join(words[k : k + 6]) for k in range(0, len(words), 6))
        mine = {"table": table_name(table), "points": str(points)}
        mine |= {"size": str(len(table)), "mask": str(points - 1)}
        mine |= {"numbers": ",\n".join(f"        {row}" for row in rows)}
        mine |= {key: literal(v, real) for key, v in numbers.items()}
        texts.append(filled(template("periodic.c"), values | mine))
    return "\n".join(texts)


def table_name(table: tuple[float, ...]) -> str:
    """Return the name of a table's C function, without the export's prefix.

    It has a checksum of the numbers: equal tables have equal names, so that tapes share them.
    """
    return f"periodic_{zlib.crc32(repr(table).encode()):08x}"


def kernel(tape: Tape, prefix: str, name: str, real: Real) -> str:
    """Return C text of the static function PREFIX_NAME that evaluates a tape.

    The C function takes arrays of inputs and outputs, and returns 1, or 0 where an argument
    violated a guard.

    prefix : prefix of the exported C functions; real : type of numbers
    """
    real_name = f"{prefix}_real"
    names = []
    for k, node in enumerate(tape.nodes):
        text = literal(node.value, real) if node.op == "const" else f"v{k}"
        names.append(f"({text})" if text.startswith("-") else text)
    guarded = any(node.op.startswith("guard") for node in tape.nodes)
    arguments = f"const {real_name} in[{tape.n_in}], {real_name} out[{len(tape.outputs)}]"
    body = ["uint32_t fine = 1U;"] if guarded else []
    for k, node in enumerate(tape.nodes):
        if node.op != "const":
            body.append(_statement(k, node, [names[i] for i in node.args], prefix, real))
    body += [f"out[{i}] = {names[k]};" for i, k in enumerate(tape.outputs)]
    body += ["return fine;" if guarded else "return 1U;"]
    lines = "".join(f"    {line}\n" for line in "\n".join(body).split("\n"))
    return f"static uint32_t {prefix}_{name}({arguments})\n{{\n{lines}}}\n"


def _statement(k: int, node: Node, a: list[str], prefix: str, real: Real) -> str:
    """Return the C statement that sets the result of node k of a tape."""
    if node.op == "sincos":
        return f"{prefix}_real v{k}[2];\n{prefix}_sincos({a[0]}, v{k});"
    text = _expression(node, a, prefix, real)
    line = f"const {prefix}_real v{k} = {text};"
    if node.op.startswith("guard"):
        sign = ">=" if node.op == "guard_min" else "<="
        line += f"\nif (!({a[0]} {sign} {literal(node.value, real)}))\n{{\n    fine = 0U;\n}}"
    return line


def _expression(node: Node, a: list[str], prefix: str, real: Real) -> str:
    """Return the C expression of a node's result; a : C texts of its arguments."""
    zero, one = literal(0.0, real), literal(1.0, real)
    # Operations of a tape that are C operators, by name.
    infix_operators = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
    if node.op in infix_operators:
        return f"{a[0]} {infix_operators[node.op]} {a[1]}"
    if node.op in _CALLED_FUNCTIONS:
        return f"{prefix}_{node.op}({', '.join(a)})"
    if node.op == "periodic":
        return f"{prefix}_{table_name(node.table)}({a[0]})"
    if node.op == "input":
        return f"in[{int(node.value)}]"
    limit = literal(node.value, real)
    return {
        "sin": lambda: f"{a[0]}[0]",
        "cos": lambda: f"{a[0]}[1]",
        "neg": lambda: f"-{a[0]}",
        "fabs": lambda: f"({a[0]} < {zero}) ? -{a[0]} : {a[0]}",
        "fmin": lambda: f"({a[0]} < {a[1]}) ? {a[0]} : {a[1]}",
        "fmax": lambda: f"({a[0]} > {a[1]}) ? {a[0]} : {a[1]}",
        "lt": lambda: f"({a[0]} < {a[1]}) ? {one} : {zero}",
        "le": lambda: f"({a[0]} <= {a[1]}) ? {one} : {zero}",
        "select": lambda: f"({a[0]} > {zero}) ? {a[1]} : {zero}",
        "not": lambda: f"({a[0]} > {zero}) ? {zero} : {one}",
        "sign": lambda: f"({a[0]} < {zero}) ? -{one} : (({a[0]} > {zero}) ? {one} : {zero})",
        "guard_min": lambda: f"({a[0]} >= {limit}) ? {a[0]} : {limit}",
        "guard_max": lambda: f"({a[0]} <= {limit}) ? {a[0]} : {limit}",
    }[node.op]()


def constants(real: Real, write: Callable[[float, Real], str] = literal) -> dict[str, str]:
    """Return the text of each number, list and polynomial of the elementary functions' templates.

    The texts are by the key of their placeholder.

    write : function that writes a number of the real type as text, by default a C literal
    """
    c = COEFFICIENTS[real]
    numbers = {"tan_pi_8": coefficients.TAN_PI_8, "exp_limit": coefficients.EXP_LIMIT}
    for key, (high, low) in (("half_pi", c.half_pi), ("ln2", c.ln2)):
        numbers |= {f"{key}_high": high, f"{key}_low": low}
    names = ("two_over_pi", "one_over_ln2", "pi", "pi_2", "pi_4", "tansig_limit", "smallest", "largest")
    numbers |= {name: getattr(c, name) for name in names}
    numbers |= {f"guess_{i}": g for i, g in enumerate(coefficients.SQRT_GUESS)}
    numbers |= {text: float(text) for text in ("0", "1", "2", "4", "0.5", "1024", "1024.5")}
    values = {key: write(value, real) for key, value in numbers.items()}
    for key in ("sin", "cos", "coth", "atan"):
        *terms, last = getattr(c, key)
        text = write(last, real)
        for term in reversed(terms):
            text = f"({write(term, real)} + (z * {text}))"
        values[f"poly:{key}"] = text
    values |= {f"powers:{s}": ", ".join(write(2.0 ** (s * i), real) for i in range(8)) for s in (1, 8)}
    steps = c.sqrt_steps
    values |= {"sqrt_count": str(len(steps)), "sqrt_last": str(len(steps) - 1), "heron": str(c.heron_steps)}
    lists = {"power": 1.0, "root": 0.5, "inverse": -1.0, "inverse_root": -0.5}
    values |= {f"sqrt_{k}": ", ".join(write(2.0 ** (e * s), real) for s in steps) for k, e in lists.items()}
    return values


# Version number of the exported files' format.
FILES_SCHEMA = 1


def c_files(program: TapeProgram) -> dict[str, str]:
    """Return the texts of all files of the C export by file name, build files included."""
    name, values = program.name, _values(program)
    build = {f"CMAKE_INSTALL_{key}": f"@CMAKE_INSTALL_{key}@" for key in ("PREFIX", "LIBDIR", "INCLUDEDIR")}
    # The text of NAME.h: prototypes, limits, status codes and notes.
    command, network = program.command, program.network
    parts = [template("network.h")] if network else []
    parts += [template("command.h")] if command else []
    more = {
        "prototypes": "".join(filled(part, values) for part in parts).rstrip("\n") + "\n",
        "defines": filled(template("command_defines.h"), values) if command else "",
        "command_statuses": filled(template("command_statuses.h"), values) if command else "",
        "title": network.title if network and not command else "correction of joint commands",
    }
    return {
        f"{name}.h": filled(template("header.h"), values | more),
        f"{name}.c": _source(program, values),
        f"{name}_self_test.c": _self_test(program, values),
        f"{name}_example.c": _example(program, values),
        "CMakeLists.txt": filled(template("CMakeLists.txt"), values),
        f"{name}.pc.in": filled(template("pkg_config.pc.in"), values | build),
        f"cross_check/{name}_casadi.c": _casadis_own(program),
    }


def _source(program: TapeProgram, values: dict[str, str]) -> str:
    """Return the text of NAME.c: elementary functions, tape kernels and the exported functions."""
    parts = [template("network.c")] if program.network else []
    parts += [template("command.c")] if program.command else []
    kernels = (
        kernel(tape, program.name, f"{name}_values", program.real) for name, tape in sorted(program.tapes.items())
    )
    more = {
        "functions": "".join(filled(part, values) for part in parts),
        "elementary": elementary_functions(list(program.tapes.values()), program.name, program.real),
        "kernels": "\n".join(kernels),
    }
    return filled(template("source.c"), values | more)


def _casadis_own(program: TapeProgram) -> str:
    """Return CasADi's own C (double, math.h) of the same functions, as an independent check."""
    generator = casadi.CodeGenerator(f"{program.name}_casadi", {"with_header": False})
    functions = {} if program.network is None else {program.network.key: program.network.function}
    if program.command is not None:
        functions |= {"nominal": program.command.nominal, "calibrated": program.command.calibrated}
    for key, function in functions.items():
        q = [casadi.SX.sym("q", program.n)]
        generator.add(casadi.Function(f"{program.name}_casadi_{key}", q, function.call(q)))
    return str(generator.dump())


def _values(program: TapeProgram) -> dict[str, str]:
    """Return values of the placeholders that every C template may use, by key."""
    real, command, network = program.real, program.command, program.network
    double = real == "double"
    product, box = program.product, ""
    for i, (low, high, unit) in enumerate(zip(product.lower, product.upper, product.units, strict=True)):
        degrees = f"  ({np.rad2deg(low):.6g} to {np.rad2deg(high):.6g} deg)" if unit == "rad" else " m"
        box += f" *   q[{i}]  {low:.9g} to {high:.9g}{degrees}\n"
    lines = [" Notes on the model:"]
    for note in command.notes if command else ():  # which cannot terminate the comment
        safe = note.encode("ascii", "replace").decode().replace("*/", "* /").replace("/*", "/ *")
        lines += wrap(safe, 110, initial_indent="  - ", subsequent_indent="    ")
    # values of FLT_EVAL_METHOD at which arithmetic in this type is not evaluated in a wider one
    methods = (0, 1, 16, 32, 64) if double else (0, 16, 32)
    values = {
        "name": program.name,
        "model_sha256": program.model_sha256,
        "data_sha256": program.data_sha256,
        "NAME": program.name.upper(),
        "real": real,
        "schema": str(FILES_SCHEMA),
        "bits": "binary64" if double else "binary32",
        "n": str(program.n),
        "steps": str(command.steps if command else 0),
        "box": box,
        "joint_units": joint_units(program.product),
        "notes": "".join(f" *{line}\n" for line in lines) + " *\n" if len(lines) > 1 else "",
        "wider": " && ".join(f"(FLT_EVAL_METHOD != {m})" for m in methods),
        "MANT_DIG": "DBL_MANT_DIG" if double else "FLT_MANT_DIG",
        "mant_dig": "53" if double else "24",
        "MAX": "DBL_MAX" if double else "FLT_MAX",
        "zeros": ", ".join([literal(0.0, real)] * program.n),
        "share": literal(program.sum_scale, real),
        "largest": literal(COEFFICIENTS[real].largest, real),
    } | {text: literal(float(text), real) for text in ("0", "1", "9")}
    for key, pair in program.boxes.items():
        rows = ("{ " + ", ".join(literal(float(v), real) for v in side) + " }" for side in pair)
        values[f"box_table:{key}"] = "{\n            " + ",\n            ".join(rows) + "\n        }"
    if network is not None:
        values |= {"function": network.key, "out": network.out, "unit": network.unit, "what": network.title}
        values["n_out"] = str(len(program.network_bounds))
        values["network_bounds"] = "".join(
            f" *   {network.out}[{i}]  {low:.9g} to {high:.9g}\n"
            for i, (low, high) in enumerate(program.network_bounds)
        )
    return values | (_command_values(command, program) if command else {})


def _command_values(command: Command, program: TapeProgram) -> dict[str, str]:
    """Return the values of a joint-command correction's placeholders by key."""
    limits, real, n, prepared = command.limits, program.real, program.n, prepared_size(command)
    n_p = pose_size(command)
    pose = "position p [m]" if n_p == 3 else "position p[0..2] [m], then the columns of the rotation matrix"
    integers = {
        "n_p": n_p,
        "n_prepared": prepared,
        "n_work": prepared + n_p,
        "i_weakness": prepared - 1,
        "n_moved": n + 1,
        "i_error": n,
        "all_cycles": int(np.ceil(2 * limits.ramp_s / limits.cycle_s)),
    }
    numbers = limits.numbers
    values = {key: str(value) for key, value in integers.items()}
    values |= {key: repr(getattr(limits, key)) for key in ("cycle_s", "ramp_s", "rate_rad_s")}
    values |= {f"limit_{key}": literal(value, real) for key, value in numbers.items()}
    for key in ("delta", "change"):
        # The header is read by C++ before 17 too, which has no hexadecimal floating constants.
        # The decimal constant gives the same number when it is read back.
        values[f"{key}_decimal"] = repr(float(NUMPY_TYPE[real](numbers[key]))) + ("F" if real == "float" else "")
    moved, turned = command.freedom
    words = [f"in {moved} of 3 directions"] if moved < 3 else []
    if residual_size(command) == 6 and turned < 3:
        words += [f"turned in {turned} of 3 directions as near as can be, the position first"]
    unreached = f",\n * {', '.join(words)}: the joints reach no more, and the status is of these" if words else ""
    return values | {
        "pose_text": pose,
        "freedom": unreached,
        "damping2": f"{limits.damping**2:.6g}",
        "tolerance_mm": f"{limits.tolerance_mm:.6g}",
    }


def joint_units(product: Product) -> str:
    """Return the units of the joints q in words, such as "radians, q[2] in metres"."""
    linear = [f"q[{i}]" for i, unit in enumerate(product.units) if unit == "m"]
    return f"radians, {', '.join(linear)} in metres" if linear else "radians"


# Random seed of the test vectors, fixed so that exports are reproducible.
_VECTOR_SEED = 20201


def inside(program: TapeProgram, count: int, seed: int = _VECTOR_SEED) -> Array:
    """Return random joints in the product's box, of the real type, shape (count, n) [rad or m]."""
    lower, upper = program.product.lower, program.product.upper
    return np.random.default_rng(seed).uniform(lower, upper, (count, program.n)).astype(NUMPY_TYPE[program.real])


def self_test_inputs(program: TapeProgram) -> Array:
    """Return the joints [rad or m] of the self-test, shape (29, n), of the real type.

    They are, in this order, the middle of the box, 8 of its corners, 16 random points inside and 4
    points outside.
    """
    lower, upper, n = program.product.lower, program.product.upper, program.n
    signs = np.random.default_rng(_VECTOR_SEED).integers(0, 2, (8, n))
    corners = np.where(signs == 1, upper, lower)
    outside = (lower + upper) / 2 + (upper - lower) * np.array([[0.6], [-0.6], [40.0], [-1e6]])
    rows: Array = np.vstack([(lower + upper) / 2, corners, inside(program, 16), outside])
    return rows.astype(NUMPY_TYPE[program.real])


def comparison_inputs(program: TapeProgram, count: int) -> Array:
    """Return the joints [rad or m] for comparing compiled C with the reference, shape (count, n).

    Seven of eight rows are random inside the box. The others are such rows times 1 to 1e6; a fourth
    of these are corners of the box instead, some have an entry that is not finite or extreme.
    """
    T = NUMPY_TYPE[program.real]
    q = inside(program, count, _VECTOR_SEED + 1)
    rng = np.random.default_rng(_VECTOR_SEED + 2)
    odd = np.flatnonzero(np.arange(count) % 8 == 7)
    scales = T(10.0) ** rng.uniform(0, 6, len(odd)).astype(T)
    q[odd] *= scales[:, None]
    corner = odd[::4]
    low = rng.integers(0, 2, (len(corner), program.n)) == 1
    q[corner] = np.where(low, program.product.lower, program.product.upper)
    special, number = odd[1::16], np.finfo(T)
    values = np.array([np.nan, np.inf, -np.inf, number.max, -number.max, number.tiny, -0.0], T)
    columns = rng.integers(0, program.n, len(special))
    q[special, columns] = values[rng.integers(0, len(values), len(special))]
    return q


def functions(program: TapeProgram) -> dict[str, Any]:
    """Return the NumPy reference of each exported function of joints, by the function's name.

    It takes the program and joints, (k, n), and returns values and statuses; see `reference`.
    """
    exported: dict[str, Any] = {} if program.network is None else {program.network.key: network}
    return exported | ({"forward": forward, "correct": correct} if program.command is not None else {})


def _self_test(program: TapeProgram, values: dict[str, str]) -> str:
    """Return the text of NAME_self_test.c: inputs with the expected outputs and statuses."""
    q = self_test_inputs(program)
    values = values | {"rows": str(len(q)), "inputs": _rows(q, program.real)}
    parts, checks, bad_checks = [], [], []
    for name, compute in functions(program).items():
        out, status = compute(program, q)
        mine = {"function": name, "size": str(out.shape[1]), "expected": _rows(out, program.real, 8)}
        mine["statuses"] = ", ".join(f"{int(s)}U" for s in status)
        parts.append(filled(template("self_test_rows.c"), values | mine))
        checks.append(f"    passed = passed & {program.name}_test_{name}();")
        bad_checks.append(f"        passed = passed & {program.name}_test_bad_{name}(q);\n")
    if program.command is not None:
        dq, gain, cycles, on_cycles, given = np.zeros(program.n), 0.0, 8, 6, []
        for k in range(cycles):
            dq, gain, step_status = step(program, dq, gain, q[0], k < on_cycles)
            given.append((dq, step_status))
        mine = {"cycles": str(cycles), "on_cycles": str(on_cycles)}
        mine["expected_step"] = _rows(np.array([row for row, _ in given]), program.real, 8)
        mine["statuses_step"] = ", ".join(f"{int(s)}U" for _, s in given)
        parts.append(filled(template("self_test_step.c"), values | mine))
        checks.append(f"    passed = passed & {program.name}_test_step();")
    more = {"functions": "".join(parts), "checks": "\n".join(checks), "bad_checks": "".join(bad_checks)}
    return filled(template("self_test.c"), values | more)


def _example(program: TapeProgram, values: dict[str, str]) -> str:
    """Return the text of NAME_example.c, which calls the functions at the centre of the box."""
    centre = ", ".join(literal(float(v), program.real) for v in self_test_inputs(program)[0])
    parts = [template("example_network.c")] if program.network else []
    parts += [template("example_command.c")] if program.command else []
    body = "".join(filled(part, values) for part in parts)
    return filled(template("example.c"), values | {"centre": centre, "body": body})


def _rows(table: Array, real: Real, indent: int = 4) -> str:
    """Return a table as the initializers of a C array, one row of literals per line."""
    rows = (", ".join(literal(float(v), real) for v in row) for row in table)
    return ",\n".join(f"{' ' * indent}{{ {row} }}" for row in rows)
