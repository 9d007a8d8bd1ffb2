"""IEC 61131-3 structured text of a program, for controllers that take no C.

It uses the PLC's own SIN, COS, SQRT, EXP and ATAN, so its results agree with the C to rounding, not to the bit.
"""

from casadical.core.arrays import Array
from casadical.export.c.c_source import boxes, command_numbers
from casadical.export.c.coefficients import COEFFICIENTS, DTYPE, Real, turn_parts
from casadical.export.c.emit import filled, table_name, tables_used, template
from casadical.export.c.language import Label, Language
from casadical.export.c.periodic_table import TURNS
from casadical.export.c.products import Command
from casadical.export.c.tape import Node, Tape
from casadical.export.c.tape_program import TapeProgram, prepared_size

_INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/"}


class StructuredText(Language):
    """Function blocks in one file."""

    name = "structured_text"

    def files(self, program: TapeProgram, label: Label) -> dict[str, str]:
        """NAME.st."""
        return {f"{label.name}.st": structured_text(program, label)}


def structured_text(program: TapeProgram, label: Label) -> str:
    """Text of NAME.st: function blocks for the network, and for the correction with ramp and rate limit."""
    kind = "REAL" if program.real == "float" else "LREAL"
    values = {
        "name": label.name,
        "kind": kind,
        "model_sha256": label.model_sha256,
        "data_sha256": label.data_sha256,
        "last": str(program.n - 1),
    }
    parts = [filled(template("head.st"), values)]
    if any(node.op == "atan2" for tape in program.tapes.values() for node in tape.nodes):
        parts.append(filled(template("atan2.st"), values))
    parts += [_periodic(table, values, program.real) for table in tables_used(program.tapes.values())]
    parts += [
        _block(tape, f"{label.name}_{key}_values", kind, program.real) for key, tape in sorted(program.tapes.items())
    ]
    if program.network is not None:
        size = {"function": program.network.key, "out": program.network.out}
        size["last_out"] = str(len(program.network_bounds) - 1)
        parts.append(filled(template("network.st"), values | size | _box(program, "network")))
    if program.command is not None:
        parts.append(filled(template("command.st"), values | _command(program, program.command)))
    return "\n".join(parts).replace("@name@", label.name)


def _periodic(table: tuple[float, ...], values: dict[str, str], real: Real) -> str:
    points = len(table) - 3
    mine = {"table": table_name(table), "points": str(points), "last_entry": str(len(table) - 1)}
    mine["numbers"] = ", ".join(number(v, real) for v in table)
    numbers = dict(zip(("per_radian", "step_high", "step_low"), turn_parts(COEFFICIENTS[real], points), strict=True))
    numbers["offset"] = float(TURNS * points)
    return filled(template("periodic.st"), values | mine | {key: number(v, real) for key, v in numbers.items()})


def number(value: float, real: Real) -> str:
    """A literal of structured text: always with a point, exponent after E."""
    rounded = float(DTYPE[real](value))
    mantissa, _, exponent = repr(rounded).partition("e")
    mantissa = mantissa if "." in mantissa else mantissa + ".0"
    return mantissa + (f"E{int(exponent)}" if exponent else "")


def _block(tape: Tape, name: str, kind: str, real: Real) -> str:
    names = [_name(k, node, real) for k, node in enumerate(tape.nodes)]
    statements = [
        s for k, node in enumerate(tape.nodes) for s in _statements(k, node, [names[a] for a in node.args], real)
    ]
    own = [s.split(" := ")[0] for s in statements if s.startswith("v")]
    declared = "".join(f"    {v} : {kind};\n" for v in own)
    blocks = {k: table_name(node.table) for k, node in enumerate(tape.nodes) if node.table}
    declared += "".join(f"    p{k} : @name@_{table};\n" for k, table in blocks.items())
    body = "".join(f"{s};\n" if not s.endswith("END_IF;") else f"{s}\n" for s in statements)
    results = "".join(f"y[{i}] := {names[k]};\n" for i, k in enumerate(tape.outputs))
    return (
        f"FUNCTION_BLOCK {name}\n"
        f"VAR_INPUT\n    x : ARRAY[0..{tape.n_in - 1}] OF {kind};\nEND_VAR\n"
        f"VAR_OUTPUT\n    y : ARRAY[0..{len(tape.outputs) - 1}] OF {kind};\n    fine : BOOL;\nEND_VAR\n"
        f"VAR\n{declared}END_VAR\nfine := TRUE;\n{body}{results}END_FUNCTION_BLOCK\n"
    )


def _name(k: int, node: Node, real: Real) -> str:
    if node.op == "const":
        text = number(node.value, real)
        return f"({text})" if text.startswith("-") else text
    return f"v{k}"


def _statements(k: int, node: Node, a: list[str], real: Real) -> list[str]:
    if node.op in ("const", "sin", "cos"):
        which = {"sin": "SIN", "cos": "COS"}.get(node.op)
        return [f"v{k} := {which}({a[0]})"] if which else []
    if node.op == "periodic":
        return [f"p{k}(x := {a[0]})", f"v{k} := p{k}.y"]
    if node.op.startswith("guard"):
        limit = number(node.value, real)
        inside = f"{a[0]} >= {limit}" if node.op == "guard_min" else f"{a[0]} <= {limit}"
        choose = "MAX" if node.op == "guard_min" else "MIN"
        return [f"IF NOT ({inside}) THEN fine := FALSE; END_IF;", f"v{k} := {choose}({a[0]}, {limit})"]
    return [f"v{k} := {_expression(node, a, real)}"]


def _expression(node: Node, a: list[str], real: Real) -> str:
    if node.op in _INFIX:
        return f"{a[0]} {_INFIX[node.op]} {a[1]}"
    if node.op == "input":
        return f"x[{int(node.value)}]"
    limit = "9.25" if real == "float" else "19.5"
    first, second = a[0], a[-1]
    return {
        "sincos": first,
        "neg": f"-{first}",
        "fabs": f"ABS({first})",
        "sqrt": f"SQRT({first})",
        "exp": f"EXP({first})",
        "tansig": f"1.0 - 2.0 / (EXP(2.0 * LIMIT(-{limit}, {first}, {limit})) + 1.0)",
        "atan2": f"@name@_atan2({first}, {second})",
        "fmin": f"MIN({first}, {second})",
        "fmax": f"MAX({first}, {second})",
        "lt": f"SEL({first} < {second}, 0.0, 1.0)",
        "le": f"SEL({first} <= {second}, 0.0, 1.0)",
        "select": f"SEL({first} > 0.0, 0.0, {second})",
        "not": f"SEL({first} > 0.0, 1.0, 0.0)",
        "sign": f"SEL({first} < 0.0, SEL({first} > 0.0, 0.0, 1.0), -1.0)",
    }[node.op]


def _box(program: TapeProgram, key: str) -> dict[str, str]:
    lower, upper = boxes(program)[key]
    return {"lower": _list(lower, program.real), "upper": _list(upper, program.real)}


def _list(values: Array, real: Real) -> str:
    return ", ".join(number(float(v), real) for v in values)


def _command(program: TapeProgram, command: Command) -> dict[str, str]:
    numbers, real, n_p = command_numbers(command), program.real, len(program.tapes["forward"].outputs)
    prepared = prepared_size(command)
    integers = {
        "steps": command.steps,
        "last_p": n_p - 1,
        "prepared": prepared,
        "last_work": prepared + n_p - 1,
        "i_weakness": prepared - 1,
        "i_error": program.n,
        "i_rest": program.n + 1,
    }
    limits = {key: getattr(numbers, key) for key in ("delta", "step", "change", "ramp", "tolerance2", "weakness")}
    return (
        {key: str(value) for key, value in integers.items()}
        | {f"limit_{key}": number(value, real) for key, value in limits.items()}
        | {"largest": number(3e38 if real == "float" else 1e300, real)}
        | _box(program, "command")
    )
