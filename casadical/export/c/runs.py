"""The tapes of a program as runs over one array of values: many equal operations in one loop.

Operations are put into another order that their arguments allow, in which equal ones follow each other. Value k is
the result of operation k, so that a run needs the places of its arguments only. Each operation is the tape's own: the
results are the same bits.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from casadical.export.c.coefficients import DTYPE, Real
from casadical.export.c.tape import Node, Tape, in_single_operations
from casadical.export.c.tape_program import TapeProgram

WIDTH = {"sincos": 2}  # places of an operation's results; one where it is not here
_TAPES = ("prepare", "forward", "apart", "advance")  # then the network or the curves; "apart" takes joints and "at"


@dataclass(frozen=True)
class Plan:
    """One array of values, and what is done with it.

    constants : the first values; places : the first place of the inputs and of the outputs (`KEY_out`) of each tape
    operations, starts : of each run, its operation and its first place; one more start is the number of values
    first, second : for each place, those of the arguments; 0 where there is none
    spans : the first and the last run of each tape; tables : of `periodic`, whose number is the second argument
    """

    constants: tuple[float, ...]
    places: dict[str, int]
    operations: tuple[str, ...]
    starts: tuple[int, ...]
    first: tuple[int, ...]
    second: tuple[int, ...]
    spans: dict[str, tuple[int, int]]
    tables: tuple[tuple[float, ...], ...]

    @property
    def size(self) -> int:
        """Number of values."""
        return self.starts[-1]


def plan_of(program: TapeProgram) -> Plan:
    """The runs of all tapes of a program."""
    return _Planner(program).plan()


class _Planner:
    def __init__(self, program: TapeProgram) -> None:
        self.tapes = {key: in_single_operations(program.tapes[key]) for key in sorted(program.tapes, key=_order)}
        nodes = [node for tape in self.tapes.values() for node in tape.nodes]
        self.constants = dict.fromkeys(_word(v, program.real) for node in nodes for v in _numbers(node))
        self.known = {word: place for place, word in enumerate(self.constants)}
        self.real = program.real
        self.tables = tuple(dict.fromkeys(node.table for node in nodes if node.table))
        n, inputs = program.n, len(self.known)
        self.places = {"joints": inputs, "at": inputs + n}
        self.starts = [inputs + 2 * n] if program.command else [inputs + n]
        self.operations: list[str] = []
        self.first, self.second = [0] * self.starts[0], [0] * self.starts[0]
        self.spans: dict[str, tuple[int, int]] = {}

    def plan(self) -> Plan:
        for key, tape in self.tapes.items():
            begin = len(self.operations)
            self._add(key, tape)
            self.spans[key] = begin, len(self.operations) - 1
        constants = tuple(float.fromhex(word) for word in self.constants)
        return Plan(
            constants, self.places, tuple(self.operations), tuple(self.starts), tuple(self.first), tuple(self.second),
            self.spans, self.tables,
        )  # fmt: skip

    def _add(self, key: str, tape: Tape) -> None:
        inputs = self.places[{"forward": "at", "advance": "prepare_out"}.get(key, "joints")]
        place: dict[int, int] = {}
        for k, node in enumerate(tape.nodes):
            if node.op == "const":
                place[k] = self._constant(node.value)
            elif node.op == "input":
                place[k] = inputs + int(node.value)
        for op, run in _runs(tape):
            for k in run:
                node = tape.nodes[k]
                place[k] = self._one(op, place[node.args[0]], self._second(node, place))
            self._end(op)
            for k, node in enumerate(tape.nodes):
                if op == "sincos" and node.op in ("sin", "cos") and node.args[0] in place:
                    place[k] = place[node.args[0]] + (node.op == "cos")
        self.places[f"{key}_out"] = len(self.first)
        for k in tape.outputs:
            self._one("copy", place[k], 0)
        self._end("copy")

    def _constant(self, value: float) -> int:
        return self.known[_word(value, self.real)]

    def _second(self, node: Node, place: dict[int, int]) -> int:
        if node.op.startswith("guard"):
            return self._constant(node.value)
        if node.op == "periodic":
            return self.tables.index(node.table)
        return place[node.args[1]] if len(node.args) > 1 else 0

    def _one(self, op: str, first: int, second: int) -> int:
        width = WIDTH.get(op, 1)
        self.first += [first] * width
        self.second += [second] * width
        return len(self.first) - width

    def _end(self, op: str) -> None:
        self.operations.append(op)
        self.starts.append(len(self.first))


def _order(key: str) -> int:
    return _TAPES.index(key) if key in _TAPES else len(_TAPES)


def _word(value: float, real: Real) -> str:
    return float(DTYPE[real](value)).hex()


def _numbers(node: Node) -> tuple[float, ...]:
    return (node.value,) if node.op == "const" or node.op.startswith("guard") else ()


def _runs(tape: Tape) -> Iterator[tuple[str, list[int]]]:
    """Operations and their nodes; each time the operation that most nodes are ready for, as long as it goes on."""
    users: list[list[int]] = [[] for _ in tape.nodes]
    waiting = [len(set(node.args)) for node in tape.nodes]
    for k, node in enumerate(tape.nodes):
        for a in set(node.args):
            users[a].append(k)
    ready: dict[str, list[int]] = {}

    def done(k: int) -> None:
        for user in users[k]:
            waiting[user] -= 1
            if waiting[user] == 0:
                op = tape.nodes[user].op
                if op in ("sin", "cos"):
                    done(user)
                else:
                    ready.setdefault(op, []).append(user)

    for k, node in enumerate(tape.nodes):
        if node.op in ("const", "input"):
            done(k)
    while ready:
        op = max(ready, key=lambda name: len(ready[name]))
        run: list[int] = []
        while op in ready:
            batch = ready.pop(op)
            run += batch
            for k in batch:
                done(k)
        yield op, run
