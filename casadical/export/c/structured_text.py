"""IEC 61131-3 structured text of an export, for controllers that take no C.

The model is a list of operations in arrays, which one loop with a CASE evaluates run by run. A
run has equal operations: they are reordered as far as their arguments allow. Value k is the result
of operation k, so that a run needs the places of its arguments only. Each operation is that of the
C, so that the results are bitwise equal. What `prepare` has in common with `forward`, such as
gravity torques, is computed once.
"""

import re
import textwrap
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from itertools import groupby

from casadical.export.c.c_source import constants, filled, joint_units, self_test_inputs, template
from casadical.export.c.chord import pose_size, prepared_size
from casadical.export.c.coefficients import ADDED_TURNS, COEFFICIENTS, NUMPY_TYPE, Real, turn_parts
from casadical.export.c.products import Command
from casadical.export.c.reference import correct, network
from casadical.export.c.tape import COMMUTATIVE_OPERATIONS, Node, Tape
from casadical.export.c.tape_program import TapeProgram, operations

# Number of places in the array of values that an operation's results take, if not 1.
RESULT_PLACES = {"sincos": 2}


class Plan:
    """The array of values of a program, and the runs of operations that fill it.

    program : program whose tapes are rearranged
    constants : first values of the array, which the first run sets
    places : first place in the array of the joints (`joints`, `at`) and of each tape's outputs
        (`KEY_out`)
    operations : name of the operation of each run
    starts : first place of the results of each run; the last entry is the number of values
    first, second : places of the operation's arguments, for each place of a result; 0 where there
        is none
    spans : indices of the first and the last run of each tape, by its name
    tables : spline tables of `periodic`, whose second argument is the index of a table
    """

    def __init__(self, program: TapeProgram) -> None:
        self.tapes = {key: program.tapes[key] for key in sorted(program.tapes, key=_order)}
        nodes = [node for tape in self.tapes.values() for node in tape.nodes]
        words = dict.fromkeys(_word(v, program.real) for node in nodes for v in _numbers(node))
        self.constants = [float.fromhex(word) for word in words]
        self.constant_places = {word: place for place, word in enumerate(words)}
        self.real = program.real
        self.tables = tuple(dict.fromkeys(node.table for node in nodes if node.table))
        n, inputs = program.n, len(self.constant_places)
        self.places = {"joints": inputs, "at": inputs + n}
        self.starts = [0, inputs + 2 * n if program.command else inputs + n]
        self.operations = ["constants"]
        self.first, self.second = [0] * self.starts[1], [0] * self.starts[1]
        self.spans: dict[str, tuple[int, int]] = {}
        self.numbers_of_equal: dict[Node, int] = {}  # numbers of equal operations, in whatever tape
        self.forward: dict[Node, int] = {}  # place of what `forward` computes
        for key, tape in self.tapes.items():
            begin = len(self.operations)
            self._add(key, tape)
            self.spans[key] = begin, len(self.operations) - 1

    @property
    def size(self) -> int:
        """Return the number of values."""
        return self.starts[-1]

    def _add(self, key: str, tape: Tape) -> None:
        """Append the runs of one tape to the plan; key : name of the tape, such as `forward`."""
        inputs = self.places[{"forward": "at", "advance": "prepare_out"}.get(key, "joints")]
        place: dict[int, int] = {}
        for k, node in enumerate(tape.nodes):
            if node.op == "const":
                place[k] = self.constant_places[_word(node.value, self.real)]
            elif node.op == "input":
                place[k] = inputs + int(node.value)
        if key == "prepare":  # it runs at the same joints after `forward` and can share its values
            self._share(tape, place)
        used = Counter(a for node in tape.nodes for a in node.args)
        for op, batches in _runs(tape, place):
            for batch in batches:
                self._batch(tape, op, batch, place, used)
            self._end(op)
        if key == "forward":
            self._share(tape, dict[int, int](), place)
        self.places[f"{key}_out"] = len(self.first)
        for k in tape.outputs:
            self._one("copy", place[k], 0)
        self._end("copy")

    def _share(self, tape: Tape, place: dict[int, int], forward: dict[int, int] | None = None) -> None:
        """Reuse results of the tape `forward` for equal operations of another tape.

        For `forward` itself, the places of its results are recorded.

        forward : for the tape `forward` itself, places of its nodes, which are recorded; else None
        """
        names: dict[int, Node] = {}
        for k, node in enumerate(tape.nodes):
            args = [self.numbers_of_equal.setdefault(names[a], len(self.numbers_of_equal)) for a in node.args]
            names[k] = replace(node, args=tuple(sorted(args) if node.op in COMMUTATIVE_OPERATIONS else args))
            if forward is not None:
                self.forward[names[k]] = forward[k]
            elif k not in place and names[k] in self.forward:
                place[k] = self.forward[names[k]]
            elif node.op in ("sin", "cos") and node.args[0] in place:
                place[k] = place[node.args[0]] + (node.op == "cos")

    def _batch(self, tape: Tape, op: str, batch: list[int], place: dict[int, int], used: Counter[int]) -> None:
        """Append independent operations of one kind, sorted by their first arguments.

        batch : node indices of the operations
        """
        pairs = []
        for k in batch:
            node, args = tape.nodes[k], tape.nodes[k].args
            if node.op in COMMUTATIVE_OPERATIONS:
                args = tuple(sorted(args, key=lambda a: (-used[a], a)))
            # The second argument is a place, a guard's constant, a table's index, or 0.
            second = place[args[1]] if len(args) > 1 else 0
            if node.op.startswith("guard"):
                second = self.constant_places[_word(node.value, self.real)]
            elif node.op == "periodic":
                second = self.tables.index(node.table)
            pairs.append((place[args[0]], second, k))
        for first, second, k in sorted(pairs):
            place[k] = self._one(op, first, second)
        for k, node in enumerate(tape.nodes):
            if op == "sincos" and node.op in ("sin", "cos") and node.args[0] in place:
                place[k] = place[node.args[0]] + (node.op == "cos")

    def _one(self, op: str, first: int, second: int) -> int:
        """Append one operation and return the place of its result; first, second : as of `Plan`."""
        width = RESULT_PLACES.get(op, 1)
        self.first += [first] * width
        self.second += [second] * width
        return len(self.first) - width

    def _end(self, op: str) -> None:
        """Record the operation of the run that ends here, and the place at which the next begins."""
        self.operations.append(op)
        self.starts.append(len(self.first))


def _order(key: str) -> int:
    """Return the position of a tape among all by its name, for sorting."""
    order = ("forward", "prepare", "advance")  # network or curves follow
    return order.index(key) if key in order else len(order)


def _word(value: float, real: Real) -> str:
    """Return a number, rounded to the real type, as exact hexadecimal text."""
    return float(NUMPY_TYPE[real](value)).hex()


def _numbers(node: Node) -> tuple[float, ...]:
    """Return the number of a constant or a guard in a tuple of one; empty for other nodes."""
    return (node.value,) if node.op == "const" or node.op.startswith("guard") else ()


def _runs(tape: Tape, placed: Collection[int]) -> Iterator[tuple[str, Iterator[list[int]]]]:
    """Yield (operation, batches of node indices) for the runs of a tape, in order of evaluation.

    Each run is of the operation with the most nodes whose arguments are complete.
    """
    there = frozenset(placed)
    users: list[list[int]] = [[] for _ in tape.nodes]
    waiting = [len(set(node.args) - there) for node in tape.nodes]
    for k, node in enumerate(tape.nodes):
        for a in set(node.args) - there if k not in there else ():
            users[a].append(k)
    ready: dict[str, list[int]] = {}

    def done(k: int) -> None:
        """Mark node k as evaluated, and users whose arguments are complete as ready."""
        for user in users[k]:
            waiting[user] -= 1
            if waiting[user] == 0:
                op = tape.nodes[user].op
                if op in ("sin", "cos"):
                    done(user)
                else:
                    ready.setdefault(op, []).append(user)

    def batches(op: str) -> Iterator[list[int]]:
        """Yield lists of indices of nodes with the operation `op` that are ready, until none is."""
        while op in ready:
            batch = ready.pop(op)
            yield batch
            for k in batch:
                done(k)

    for k, node in enumerate(tape.nodes):
        if k not in there and not waiting[k]:
            ready.setdefault(node.op, []).append(k)
    while ready:
        op = max(ready, key=lambda name: len(ready[name]))
        yield op, batches(op)


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
    cost = operations(program).text()

    def operand(value: float, real: Real) -> str:
        """Return a number as a literal, in brackets if it is negative."""
        text = number(value, real)
        return f"({text})" if text.startswith("-") else text

    values = constants(program.real, operand) | {
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


def _array(name: str, kind: str, entries: Iterable[str]) -> str:
    """Return the declaration of an array with initial values, long runs of one as COUNT(VALUE)."""
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
    """Return the function block that evaluates the operations, with a CASE branch for each kind."""
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
    """Return the value of the placeholder `box`: declarations of the ends of a joint box."""
    kind, text = "REAL" if program.real == "float" else "LREAL", ""
    for name, side in zip(("lower", "upper"), program.boxes[key], strict=True):
        text += _array(name, kind, (number(float(v), program.real) for v in side))
    return {"box": text}


def _span(plan: Plan, key: str, name: str) -> dict[str, str]:
    """Return values of the placeholders NAME_from and NAME_to: first and last run of a tape."""
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
