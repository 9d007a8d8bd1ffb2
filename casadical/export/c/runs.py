"""Tapes rearranged into runs of equal operations over one array of values, each run one loop.

Operations are reordered as far as their arguments allow, so that equal ones follow each other.
Value k is the result of operation k, so that a run needs the places of its arguments only. Each
operation is the tape's own: the results are bitwise equal. What `prepare` has in common with
`forward`, such as gravity torques, is computed once.
"""

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import replace

from casadical.export.c.coefficients import NUMPY_TYPE, Real
from casadical.export.c.tape import COMMUTATIVE_OPERATIONS, Node, Tape
from casadical.export.c.tape_program import TapeProgram

# Number of places in the array of values that an operation's results take, if not 1.
RESULT_PLACES = {"sincos": 2}
# Names of the tapes in their order; network or curves follow.
_TAPE_ORDER = ("forward", "prepare", "advance")


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

        place : places of the tape's nodes, to which shared ones are added
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
        place : places of the tape's nodes by their index, to which the results' are added
        used : number of uses of each node
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
    """Return the position of a tape in `_TAPE_ORDER` by its name, for sorting."""
    return _TAPE_ORDER.index(key) if key in _TAPE_ORDER else len(_TAPE_ORDER)


def _word(value: float, real: Real) -> str:
    """Return a number, rounded to the real type, as exact hexadecimal text."""
    return float(NUMPY_TYPE[real](value)).hex()


def _numbers(node: Node) -> tuple[float, ...]:
    """Return the number of a constant or a guard in a tuple of one; empty for other nodes."""
    return (node.value,) if node.op == "const" or node.op.startswith("guard") else ()


def _runs(tape: Tape, placed: Collection[int]) -> Iterator[tuple[str, Iterator[list[int]]]]:
    """Yield (operation, batches of node indices) for the runs of a tape, in order of evaluation.

    Each run is of the operation with the most nodes whose arguments are complete.

    placed : indices of nodes that have a place already
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
