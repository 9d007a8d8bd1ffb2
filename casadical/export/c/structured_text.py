"""IEC 61131-3 structured text of a program, for controllers that take no C.

The model is a list of operations in arrays, which one loop with a CASE goes through run by run (see `runs`); each
operation is that of the C, so that the results are the same bits.
"""

import textwrap
from collections.abc import Iterable

from casadical.export.c.c_source import box_share, boxes, command_numbers, joint_units
from casadical.export.c.chord import look_size, prepared_size
from casadical.export.c.coefficients import COEFFICIENTS, DTYPE, Real, turn_parts
from casadical.export.c.emit import constants, filled, template
from casadical.export.c.language import Label, Language
from casadical.export.c.periodic_table import TURNS
from casadical.export.c.products import Command
from casadical.export.c.reference import correct, network
from casadical.export.c.runs import WIDTH, Plan, plan_of
from casadical.export.c.self_test import self_test_inputs
from casadical.export.c.tape_program import TapeProgram, operations

_ROWS = (0, 9, 10, 25)  # of the C's self-test: the middle, two random points, one outside the box
_PAIR = "x := v[first[k]];\nv[k] := SEL({}, {}, {});"
_SIMPLE = {
    "add": "v[k] := v[first[k]] + v[second[k]];",
    "sub": "v[k] := v[first[k]] - v[second[k]];",
    "mul": "v[k] := v[first[k]] * v[second[k]];",
    "div": "v[k] := v[first[k]] / v[second[k]];",
    "neg": "v[k] := -v[first[k]];",
    "copy": "v[k] := v[first[k]];",
    "fabs": _PAIR.format("x < 0.0", "x", "-x"),
    "fmin": _PAIR.format("x < v[second[k]]", "v[second[k]]", "x"),
    "fmax": _PAIR.format("x > v[second[k]]", "v[second[k]]", "x"),
    "lt": _PAIR.format("x < v[second[k]]", "0.0", "1.0"),
    "le": _PAIR.format("x <= v[second[k]]", "0.0", "1.0"),
    "select": _PAIR.format("x > 0.0", "0.0", "v[second[k]]"),
    "not": _PAIR.format("x > 0.0", "1.0", "0.0"),
    "sign": _PAIR.format("x < 0.0", "SEL(x > 0.0, 0.0, 1.0)", "-1.0"),
    "guard_min": "v[k] := v[first[k]];\nIF NOT (v[k] >= v[second[k]]) THEN\n"
    "    fine := FALSE;\n    v[k] := v[second[k]];\nEND_IF;",
    "guard_max": "v[k] := v[first[k]];\nIF NOT (v[k] <= v[second[k]]) THEN\n"
    "    fine := FALSE;\n    v[k] := v[second[k]];\nEND_IF;",
}


class StructuredText(Language):
    """Function blocks in one file."""

    name = "structured_text"

    def files(self, program: TapeProgram, label: Label) -> dict[str, str]:
        """NAME.st."""
        return {f"{label.name}.st": structured_text(program, label)}


def structured_text(program: TapeProgram, label: Label) -> str:
    """Text of NAME.st: function blocks for the network, for the correction with ramp and rate limit, and a test."""
    plan, real = plan_of(program), program.real
    values = _common(program, plan, label)
    parts = [filled(template("head.st"), values), _values_block(plan, values, real)]
    parts.append(filled(template("boxed.st"), values))
    if program.network is not None:
        key = program.network.key
        mine = {"function": key, "out": program.network.out, "last_out": str(len(program.network_bounds) - 1)}
        mine |= {"network_out": str(plan.places[f"{key}_out"])} | _span(plan, key, "network")
        parts.append(filled(template("network.st"), values | mine | _box(program, "network")))
    if program.command is not None:
        if program.command.bound is not None:
            mine = {
                "function": "bound",
                "out": "bound_mm",
                "last_out": "0",
                "network_out": str(plan.places["bound_out"]),
            }
            mine |= _span(plan, "bound", "network") | _box(program, "command")
            parts.append(filled(template("network.st"), values | mine))
        parts.append(filled(template("command.st"), values | _command(program, program.command, plan)))
    return _wrapped("\n".join([*parts, _self_test(program, values)]))


def number(value: float, real: Real) -> str:
    """A literal of structured text: always with a point, exponent after E."""
    rounded = float(DTYPE[real](value))
    mantissa, _, exponent = repr(rounded).partition("e")
    mantissa = mantissa if "." in mantissa else mantissa + ".0"
    return mantissa + (f"E{int(exponent)}" if exponent else "")


def _operand(value: float, real: Real) -> str:
    text = number(value, real)
    return f"({text})" if text.startswith("-") else text


def _common(program: TapeProgram, plan: Plan, label: Label) -> dict[str, str]:
    kind = "REAL" if program.real == "float" else "LREAL"
    values = constants(program.real, _operand) | {
        "name": label.name,
        "kind": kind,
        "index": "INT" if plan.size < 2**15 else "DINT",
        "model_sha256": label.model_sha256,
        "data_sha256": label.data_sha256,
        "joint_units": joint_units(program.product),
        "cost": textwrap.fill(operations(program).text(), 116, initial_indent="   ", subsequent_indent="   "),
        "n": str(program.n),
        "last": str(program.n - 1),
        "last_value": str(plan.size - 1),
        "joints": str(plan.places["joints"]),
        "share": number(box_share(program.n), program.real),
    }
    first = [*(number(v, program.real) for v in plan.constants), *["0.0"] * (plan.size - len(plan.constants))]
    return values | {"value_array": _array("v", kind, first)}


def _array(name: str, kind: str, entries: Iterable[str]) -> str:
    """A declaration with initial values; what occurs four times or more in a row is counted."""
    counted: list[list[str]] = []
    for entry in entries:
        if counted and counted[-1][0] == entry:
            counted[-1].append(entry)
        else:
            counted.append([entry])
    size = sum(map(len, counted))
    words = [w for same in counted for w in ([f"{len(same)}({same[0]})"] if len(same) > 3 else same)]
    return f"    {name} : ARRAY[0..{size - 1}] OF {kind} := [{', '.join(words)}];\n"


def _wrapped(text: str) -> str:
    """The text with its long lines divided at spaces."""
    lines: list[str] = []
    for line in text.split("\n"):
        indent = " " * (len(line) - len(line.lstrip()) + 8)
        lines += (
            textwrap.wrap(line, 118, subsequent_indent=indent, break_on_hyphens=False) if len(line) > 118 else [line]
        )
    return "\n".join(lines)


def _list(values: Iterable[float], real: Real) -> str:
    return ", ".join(number(float(v), real) for v in values)


def _values_block(plan: Plan, values: dict[str, str], real: Real) -> str:
    """The block that goes through the list, with a case for each operation that occurs."""
    known = list(dict.fromkeys(plan.operations))
    variables: dict[str, None] = {}
    cases = ""
    for code, op in enumerate(known):
        if op in _SIMPLE:
            body = _SIMPLE[op]
        else:
            more = _tables(plan, real) if op == "periodic" else {}
            declared, body = filled(template(f"{op}.st"), values | more).split("BODY\n")
            variables |= dict.fromkeys(declared.splitlines(keepends=True))
        mine = {"code": str(code), "op": op, "by": f" BY {WIDTH[op]}" if op in WIDTH else ""}
        cases += filled(template("case.st"), mine | {"body": textwrap.indent(body.rstrip(), " " * 12) + "\n"})
    tables = _array("operation", "INT", (str(known.index(op)) for op in plan.operations))
    for name, entries in (("start", plan.starts), ("first", plan.first), ("second", plan.second)):
        tables += _array(name, values["index"], map(str, entries))
    return filled(template("values.st"), values | {"tables": tables, "variables": "".join(variables), "cases": cases})


def _tables(plan: Plan, real: Real) -> dict[str, str]:
    """The numbers of all periodic tables, one after another."""
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
        "offset": _list((TURNS * count for count in points), real),
    }


def _box(program: TapeProgram, key: str) -> dict[str, str]:
    kind = "REAL" if program.real == "float" else "LREAL"
    sides = zip(("lower", "upper"), boxes(program)[key], strict=True)
    return {"box": "".join(_array(name, kind, (number(float(v), program.real) for v in side)) for name, side in sides)}


def _span(plan: Plan, key: str, name: str) -> dict[str, str]:
    return {f"{name}_from": str(plan.spans[key][0]), f"{name}_to": str(plan.spans[key][1])}


_WITHIN = """\
values(from_run := @bound_from@, to_run := @bound_to@, v := v);
IF status = 0 AND NOT (values.fine AND v[@bound_out@] <= @bound_limit@) THEN
    status := 9;
END_IF;
"""


def _within(program: TapeProgram, command: Command, plan: Plan) -> dict[str, str]:
    """The comparison of the bound with its limit, where there is one."""
    if command.limit_mm is None:
        return {"within": ""}
    mine = _span(plan, "bound", "bound") | {"bound_out": str(plan.places["bound_out"])}
    mine["bound_limit"] = number(command_numbers(command).bound_mm, program.real)
    return {"within": filled(_WITHIN, mine)}


def _command(program: TapeProgram, command: Command, plan: Plan) -> dict[str, str]:
    numbers, look, prepared = command_numbers(command), program.look, prepared_size(command)
    joint = f"v[{plan.places['joints']} + i]"
    limits = ("delta", "step", "change", "ramp", "tolerance2", "weakness")
    places = {
        "at": plan.places["at"],
        "look_out": plan.places[f"{look}_out"],
        "advance_out": plan.places["advance_out"],
        "now": plan.places["prepare_out"] + prepared,
        "weakness_at": plan.places["prepare_out"] + prepared - 1,
        "error_at": plan.places["advance_out"] + program.n,
    }
    return (
        {key: str(value) for key, value in places.items()}
        | {f"limit_{key}": number(getattr(numbers, key), program.real) for key in limits}
        | {key: f"{getattr(command.limits, key):.6g}" for key in ("cycle_s", "ramp_s", "rate_rad_s")}
        | {"steps": str(command.steps), "last_p": str(look_size(command) - 1)}
        | {"at_value": "dq[i]" if look == "apart" else f"{joint} + dq[i]"}
        | _span(plan, "prepare", "prepare") | _span(plan, look, "look") | _span(plan, "advance", "advance")
        | _box(program, "command") | _within(program, command, plan)
    )  # fmt: skip


def _self_test(program: TapeProgram, values: dict[str, str]) -> str:
    """A block with known answers: of the correction, or of the network alone."""
    q = self_test_inputs(program)[list(_ROWS)]
    out, status = (correct if program.command else network)(program, q)
    tables = _array("statuses", "INT", (str(int(s)) for s in status))
    for name, table in (("inputs", q), ("expected", out)):
        tables += _array(name, values["kind"], (number(float(v), program.real) for v in table.ravel()))
    name, result = ("correct", "dq") if program.network is None or program.command else (
        program.network.key, program.network.out
    )  # fmt: skip
    mine = {"tested": name, "result": result, "tables": tables, "n_tested": str(out.shape[1])}
    mine |= {"last_tested": str(out.shape[1] - 1), "last_row": str(len(q) - 1)}
    return filled(template("self_test.st"), values | mine)
