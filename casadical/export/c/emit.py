"""C99 text of a tape, and of the elementary functions that it calls.

CasADi's own generator with these elementary functions would run as fast. Walking the tape gives
exact constants, no MISRA findings and guards where they are needed; and the NumPy reference, with
which the compiled C is compared, reads the same list.
"""

import re
import zlib
from collections.abc import Callable
from functools import cache
from importlib.resources import files

from casadical.export.c import coefficients
from casadical.export.c.coefficients import COEFFICIENTS, Real, literal, turn_parts
from casadical.export.c.tape import Node, Tape

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
    """Return the C statement that sets the result of node k of a tape.

    a : C texts of its arguments; prefix, real : as of `kernel`
    """
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
