"""IEC 61131-3 structured text of an export, for controllers that take no C.

The model is a list of operations in arrays, which one loop with a CASE evaluates run by run (see
`runs`); each operation is that of the C, so that the results are bitwise equal.
"""

import re
import textwrap
from collections.abc import Iterable
from itertools import groupby

from casadical.export.c.c_source import joint_units, self_test_inputs
from casadical.export.c.chord import pose_size, prepared_size
from casadical.export.c.coefficients import ADDED_TURNS, COEFFICIENTS, NUMPY_TYPE, Real, turn_parts
from casadical.export.c.emit import constants, filled, template
from casadical.export.c.products import Command
from casadical.export.c.reference import correct, network
from casadical.export.c.runs import RESULT_PLACES, Plan
from casadical.export.c.tape_program import TapeProgram, operations

# Template of a guard's statements: they replace a value that violates it, and clear `fine`.
_GUARD_STATEMENT = """\
v[k] := v[first[k]];
IF NOT (v[k] {} v[second[k]]) THEN fine := FALSE; v[k] := v[second[k]]; END_IF;
"""
# Statement of each operation that needs no template of its own, by its name.
_SIMPLE_STATEMENTS = {
    "add": "v[k] := v[first[k]] + v[second[k]];",
    "sub": "v[k] := v[first[k]] - v[second[k]];",
    "mul": "v[k] := v[first[k]] * v[second[k]];",
    "div": "v[k] := v[first[k]] / v[second[k]];",
    "neg": "v[k] := -v[first[k]];",
    "copy": "v[k] := v[first[k]];",
    "constants": "v[k] := constant[k];",
    "fabs": "v[k] := SEL(v[first[k]] < 0.0, v[first[k]], -v[first[k]]);",
    "fmin": "v[k] := SEL(v[first[k]] < v[second[k]], v[second[k]], v[first[k]]);",
    "fmax": "v[k] := SEL(v[first[k]] > v[second[k]], v[second[k]], v[first[k]]);",
    "lt": "v[k] := SEL(v[first[k]] < v[second[k]], 0.0, 1.0);",
    "le": "v[k] := SEL(v[first[k]] <= v[second[k]], 0.0, 1.0);",
    "select": "v[k] := SEL(v[first[k]] > 0.0, 0.0, v[second[k]]);",
    "not": "v[k] := SEL(v[first[k]] > 0.0, 1.0, 0.0);",
    "sign": "v[k] := SEL(v[first[k]] < 0.0, SEL(v[first[k]] > 0.0, 0.0, 1.0), -1.0);",
    "guard_min": _GUARD_STATEMENT.format(">="),
    "guard_max": _GUARD_STATEMENT.format("<="),
}


def structured_text(program: TapeProgram) -> str:
    """Return the text of NAME.st: blocks of network or curves, correction, cycle, and a self-test.

    Blocks of what the program lacks are omitted.
    """
    plan = Plan(program)
    values = _common(program, plan)
    parts = [filled(template("head.st"), values), _values_block(plan, values, program.real)]
    parts.append(filled(template("boxed.st"), values))
    if program.network is not None:
        key, out = program.network.key, program.network.out
        mine = {"function": key, "out": out, "last_out": str(len(program.tapes[key].outputs) - 1)}
        mine |= {"network_out": str(plan.places[f"{key}_out"])} | _span(plan, key, "run")
        parts.append(filled(template("network.st"), values | mine | _box(program, "network")))
    if program.command is not None:
        mine = _command(program, program.command, plan)
        parts.append(filled(template("command.st"), values | mine | _box(program, "command")))
    return _laid_out("\n".join([*parts, _self_test(program, values)]))


def number(value: float, real: Real) -> str:
    """Return a structured-text literal with the fewest digits that read back as the same number.

    It always has a decimal point; an exponent follows E.
    """
    rounded = NUMPY_TYPE[real](value)
    mantissa, _, exponent = str(float(rounded) if real == "double" else rounded).partition("e")
    mantissa = mantissa if "." in mantissa else mantissa + ".0"
    return mantissa + (f"E{int(exponent)}" if exponent else "")


def _common(program: TapeProgram, plan: Plan) -> dict[str, str]:
    """Return the values of placeholders that every structured-text template may use, by key."""
    cost = operations(program).text()

    def operand(value: float, real: Real) -> str:
        """Return a number as a literal, in brackets if it is negative."""
        text = number(value, real)
        return f"({text})" if text.startswith("-") else text

    return constants(program.real, operand) | {
        "name": program.name,
        "model_sha256": program.model_sha256,
        "data_sha256": program.data_sha256,
        "kind": "REAL" if program.real == "float" else "LREAL",
        "index": "INT" if plan.size < 2**15 else "DINT",
        "joint_units": joint_units(program.product),
        "cost": textwrap.fill(cost, 116, initial_indent="   ", subsequent_indent="   "),
        "n": str(program.n),
        "last": str(program.n - 1),
        "last_value": str(plan.size - 1),
        "joints": str(plan.places["joints"]),
        "share": number(program.sum_scale, program.real),
    }


def _array(name: str, kind: str, entries: Iterable[str]) -> str:
    """Return the declaration of an array with initial values, long runs of one as COUNT(VALUE).

    kind : data type; entries : text of each value
    """
    counted = [list(same) for _, same in groupby(entries)]
    size = sum(map(len, counted))
    words = (min(f"{len(same)}({same[0]})", ",".join(same), key=len) for same in counted)
    return f"    {name} : ARRAY[0..{size - 1}] OF {kind} := [{','.join(words)}];\n"


def _laid_out(text: str) -> str:
    """Return the text with short sections, loops, conditions on one line and long lines broken."""

    # Largest number of characters of a line of structured text.
    line_length = 118

    def in_line(found: re.Match[str]) -> str:
        """Return a section in one line if it is short enough, else unchanged."""
        line = f"{found[1]}{found[2]} {found[3]} {end}"
        short = len(line) <= line_length and "ARRAY" not in found[3].partition(":=")[2]
        return line if short else found[0]

    sections = (("VAR[A-Z_ ]*", "END_VAR"), ("FOR [^\n]* DO", "END_FOR;"), ("IF [^\n]* THEN", "END_IF;"))
    for begin, end in sections:
        for _ in range(2):  # a loop around a loop
            pattern = rf"^( *)({begin})\n *([^\n]*;)\n\1{end}$"
            text = re.sub(pattern, in_line, text, flags=re.MULTILINE)
    lines: list[str] = []
    for line in text.split("\n"):
        while len(line) > line_length:
            cut = max(line.rfind(end, 0, line_length) for end in ", ") + 1
            lines.append(line[:cut])
            line = " " * 8 + line[cut:].lstrip()
        lines.append(line)
    return "\n".join(lines)


def _list(values: Iterable[float], real: Real) -> str:
    """Return numbers as literals, separated by commas."""
    return ", ".join(number(float(v), real) for v in values)


def _values_block(plan: Plan, values: dict[str, str], real: Real) -> str:
    """Return the function block that evaluates the operations, with a CASE branch for each kind.

    values : values of common placeholders by key
    """
    kinds = list(dict.fromkeys(plan.operations))
    arrays, scalars = dict[str, None](), dict[str, dict[str, None]]()
    cases = ""
    for code, op in enumerate(kinds):
        if op in _SIMPLE_STATEMENTS:
            body = _SIMPLE_STATEMENTS[op]
        else:
            more = tables_of(plan, real) if op == "periodic" else {}
            declared, body = filled(template(f"{op}.st"), values | more).split("BODY\n")
            for line in declared.splitlines():
                names, _, of = line.strip().rstrip(";").partition(" : ")
                if of.startswith("ARRAY"):
                    arrays[line + "\n"] = None
                else:
                    scalars.setdefault(of, {}).update(dict.fromkeys(names.split(", ")))
        mine = {"code": str(code), "op": op, "by": f" BY {RESULT_PLACES[op]}" if op in RESULT_PLACES else ""}
        body = body.strip()
        short = "\n" not in body and len(body) < 72  # it shares its line with its loop
        body = f" {body} " if short else "\n" + textwrap.indent(body, " " * 8) + "\n    "
        cases += filled(template("case.st"), mine | {"body": body})
    scalars.setdefault(values["kind"], {})["x"] = None
    variables = [*arrays, *(f"    {', '.join(names)} : {of};\n" for of, names in scalars.items())]
    tables = _array("operation", "INT", (str(kinds.index(op)) for op in plan.operations))
    tables += _array("constant", values["kind"], (number(v, real) for v in plan.constants)) if plan.constants else ""
    for name, entries in (("start", plan.starts), ("first", plan.first), ("second", plan.second)):
        tables += _array(name, values["index"], map(str, entries))
    return filled(template("values.st"), values | {"tables": tables, "variables": "".join(variables), "cases": cases})


def tables_of(plan: Plan, real: Real) -> dict[str, str]:
    """Return values of the placeholders of `periodic`, by key: all spline tables in one array."""
    points = [len(table) - 3 for table in plan.tables]
    begins = [sum(map(len, plan.tables[:i])) for i in range(len(plan.tables))]
    parts = [turn_parts(COEFFICIENTS[real], count) for count in points]
    names = ("per_radian", "step_high", "step_low")
    texts = {name: _list(values, real) for name, values in zip(names, zip(*parts, strict=True), strict=True)}
    return texts | {
        "last_table": str(len(points) - 1),
        "last_entry": str(sum(map(len, plan.tables)) - 1),
        "entries": _list((v for table in plan.tables for v in table), real),
        "begins": ", ".join(map(str, begins)),
        "points": ", ".join(map(str, points)),
        "offset": _list((ADDED_TURNS * count for count in points), real),
    }


def _box(program: TapeProgram, key: str) -> dict[str, str]:
    """Return the value of the placeholder `box`: declarations of the ends of a joint box.

    key : name of the box in `TapeProgram.boxes`
    """
    kind, text = "REAL" if program.real == "float" else "LREAL", ""
    for name, side in zip(("lower", "upper"), program.boxes[key], strict=True):
        text += _array(name, kind, (number(float(v), program.real) for v in side))
    return {"box": text}


def _span(plan: Plan, key: str, name: str) -> dict[str, str]:
    """Return values of the placeholders NAME_from and NAME_to: first and last run of a tape.

    key : name of the tape
    """
    return {f"{name}_from": str(plan.spans[key][0]), f"{name}_to": str(plan.spans[key][1])}


def _command(program: TapeProgram, command: Command, plan: Plan) -> dict[str, str]:
    """Return values of the placeholders of the joint-command correction, by key."""
    limits, prepared = command.limits, prepared_size(command)
    integers = {
        "at": plan.places["at"],
        "look_out": plan.places["forward_out"],
        "advance_out": plan.places["advance_out"],
        "now": plan.places["prepare_out"] + prepared,
        "weakness_at": plan.places["prepare_out"] + prepared - 1,
        "error_at": plan.places["advance_out"] + program.n,
        "steps": command.steps,
        "last_p": pose_size(command) - 1,
    }
    values = {key: str(value) for key, value in integers.items()}
    values |= {f"limit_{key}": number(v, program.real) for key, v in limits.numbers.items()}
    values |= {key: f"{getattr(limits, key):.6g}" for key in ("cycle_s", "ramp_s", "rate_rad_s")}
    for key, name in (("prepare", "prepare"), ("forward", "look"), ("advance", "advance")):
        values |= _span(plan, key, name)
    return values


def _self_test(program: TapeProgram, values: dict[str, str]) -> str:
    """Return the function block of the self-test, which compares outputs with expected ones.

    It tests the correction, or where there is none the network or the curves.
    """
    q = self_test_inputs(program)[[0, 9, 10, 25]]  # the middle, two random points, one outside the box
    out, status = (correct if program.command else network)(program, q)
    tables = _array("statuses", "INT", (str(int(s)) for s in status))
    for name, table in (("inputs", q), ("expected", out)):
        tables += _array(name, values["kind"], (number(float(v), program.real) for v in table.ravel()))
    name, result = "correct", "dq"
    if program.network is not None and not program.command:
        name, result = program.network.key, program.network.out
    mine = {"tested": name, "result": result, "tables": tables, "n_tested": str(out.shape[1])}
    mine |= {"last_tested": str(out.shape[1] - 1), "last_row": str(len(q) - 1)}
    return filled(template("self_test.st"), values | mine)
