"""Base class of the controllers' program languages, each a module listed in `PROGRAM_LANGUAGES`.

Programs are parsed as islands, the runs of tokens that a target grammar derives; everything between
them stays opaque. A complete grammar of such a language is that of one release of one maker. A
grammar of its targets alone is small, and a line that it cannot parse does no harm (island
grammars; Moonen 2001).
"""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from typing import Any, ClassVar

import numpy as np
from lark import Lark, Token, Tree, UnexpectedInput
from lark.parsers.lalr_interactive_parser import InteractiveParser

from casadical.core.basics import M_PER_MM, Array, InputError, errors_of
from casadical.core.transforms import frame, from_rpy, to_rpy
from casadical.export.controller.programs.target import RAD_PER_DEG, Given, Target


class ProgramLanguage(ABC):
    """A controller's programming language: how programs are read and their targets written.

    Derived classes have no constructor arguments.

    name : name of the language in messages
    suffixes : suffixes of its files, in lower case, with their dot
    units : factor of each number of a pose to SI
    pose : numbers of a pose, in words
    place : word for a target's position in the file, such as "line"
    report_beside : whether a report is written next to a corrected program
    """

    name: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]]
    units: ClassVar[tuple[float, ...]] = (M_PER_MM, M_PER_MM, M_PER_MM, RAD_PER_DEG, RAD_PER_DEG, RAD_PER_DEG)
    pose: ClassVar[str]
    place: ClassVar[str] = "line"
    report_beside: ClassVar[bool] = True

    def decoded(self, source: str, content: bytes) -> str:
        """Return a program's bytes as text, one character each. Raises InputError as `text_of`."""
        return text_of(source, content)

    def written(self, source: str, text: str, results: Sequence[Any]) -> bytes:
        """Return the program's bytes with the new texts of its targets; all others are unchanged.

        source : path of the program; text : one character for each byte
        results : correction of each target, as of `CorrectedTarget`
        """
        pieces, end = [], 0
        for number, new in sorted(((n, t) for r in results for n, t in r.changes), key=lambda change: change[0].start):
            pieces += [text[end : number.start], new]
            end = number.stop
        return "".join([*pieces, text[end:]]).encode("latin-1")

    @abstractmethod
    def targets(self, source: str, text: str, given: Given, joints: int) -> list[Target]:
        """Return every target of a program in order, those that must stay unchanged included.

        text : one character for each byte
        given : tools, bases and units from outside the program
        Raises InputError that names the line where the program cannot be corrected.
        """

    def matrix(self, values: Array) -> Array:
        """Return the transform, shape (4, 4) [m], of a pose's numbers, shape (k,) [SI].

        Raises InputError: the numbers are no pose, or targets of the language are joints alone.
        """
        raise InputError(f"a {self.name} holds {self.pose}")

    def values(self, T: Array, like: Array) -> Array:
        """Return the numbers of a pose, shape (k,) [SI]; of equivalent ones the nearest to `like`.

        T : the pose, shape (4, 4) [m]
        like : numbers of another pose, shape (k,) [SI]
        Raises InputError: targets of the language are joints alone.
        """
        raise InputError(f"a {self.name} holds {self.pose}")

    def turns(self, q: Array) -> tuple[int, ...]:
        """Return the turns of joints as the language states them; () if it states none.

        q : joints, shape (n,) [rad or m]
        """
        return ()

    def turns_text(self, target: Target, turns: tuple[int, ...]) -> list[str]:
        """Return the new texts of the words that hold the turns, as many as `target.turn_text`.

        turns : new turns, as of the method `turns`
        """
        return [str(turn) for turn in turns]

    def move_line(self, joints: Sequence[float]) -> str:
        """Return lines of a slow motion to joints [deg or mm]. Raises InputError if it has none."""
        raise InputError(f"{self.name}: has no motion in a line; give krl, rapid, urscript or fanuc")

    def frame(self, where: str, values: Array) -> Array:
        """Return the transform, shape (4, 4) [m], of a tool or base.

        where : beginning of error messages; values : its numbers [SI]
        Raises InputError: they are not finite, or no pose.
        """
        if not np.isfinite(values).all():
            raise InputError(f"{where}: a tool or base needs finite numbers, {self.pose}")
        with errors_of(f"{where}: "):
            return self.matrix(values)

    def transform(self, option: str, text: str) -> Array:
        """Return the transform, shape (4, 4) [m], of a pose in an option of a command.

        text : numbers of the pose as the controller shows them, separated by commas
        Raises InputError: they are not as many as `units`, not finite, or no pose.
        """
        try:
            numbers = [float(part) for part in text.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) != len(self.units) or not np.isfinite(numbers).all():
            raise InputError(f"{option} {text}: give {len(self.units)} numbers with commas, {self.pose}")
        return self.frame(f"{option} {text}", np.array(numbers) * self.units)

    def shown(self, T: Array) -> str:
        """Return a pose, (4, 4) [m], as the text that `transform` reads: numbers and commas."""
        values = self.values(T, np.zeros(len(self.units)))
        return ",".join(f"{round(v / unit, 6) + 0.0:g}" for v, unit in zip(values, self.units, strict=True))


class AngleLanguage(ProgramLanguage):
    """Base class of languages whose poses are x, y, z and three angles about fixed axes.

    order : indices of roll, pitch and yaw among the angles
    """

    order: ClassVar[tuple[int, int, int]]

    def matrix(self, values: Array) -> Array:
        """Return the transform, shape (4, 4) [m], of x, y, z [m] and angles [rad], shape (6,)."""
        return frame(from_rpy(values[3:][list(self.order)]), values[:3])

    def values(self, T: Array, like: Array) -> Array:
        """Return x, y, z [m] and three angles [rad] of a pose, shape (6,).

        Of the equivalent angles they are the nearest to those of `like`.

        T : pose, shape (4, 4) [m]; like : other numbers of this kind, shape (6,) [m, rad]
        """
        roll, pitch, yaw = to_rpy(T[:3, :3])
        flipped = np.array([roll + np.pi, np.pi - pitch, yaw + np.pi])
        wanted = like[3:][list(self.order)]
        turn = 2 * np.pi
        near = [a - turn * np.round((a - wanted) / turn) for a in (np.array([roll, pitch, yaw]), flipped)]
        angles = np.empty(3)
        angles[list(self.order)] = min(near, key=lambda a: float(np.abs(a - wanted).max()))
        return np.concatenate([T[:3, 3], angles])


def text_of(source: str, content: bytes) -> str:
    """Return a program's bytes as text, one character per byte (Latin-1).

    Raises InputError: a control character other than white space, as in compiled programs.
    """
    for place, byte in enumerate(content):
        if byte < 32 and byte not in b"\t\n\r\f\x1a":
            line = content.count(b"\n", 0, place) + 1
            raise InputError(
                f"{source}: line {line}: byte {byte} is not text; encrypted, compiled and UTF-16 "
                "programs cannot be corrected: give the program as the controller shows it, as text"
            )
    return content.decode("latin-1")


# Lark text of the terminals of every language: a number, and any character that no other terminal
# takes (with the lowest priority, so that no text is refused).
COMMON_TERMINALS = r"""
_other: OTHER
NUMBER: /[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?/
OTHER.-9: /./s
%ignore /\s+/
"""


class ParsedText:
    """A program's tokens without those that the grammar ignores, and its islands.

    grammar : Lark grammar of a language's islands; text : text of the program
    tokens : tokens of the program in their order
    islands : trees of the longest runs of tokens that the grammar's `start` derives, in their
        order, without overlaps
    """

    def __init__(self, grammar: str, text: str) -> None:
        parser = _parser(grammar)
        self.tokens = list(parser.lex(text))
        self.islands = list(_islands(parser, self.tokens))

    def all(self, rule: str) -> list[Tree[Token]]:
        """Return all nodes of a rule, by its name, at the top level of the islands."""
        return [node for island in self.islands for node in parts(island, rule)]


@cache
def _parser(grammar: str) -> Lark:
    """Return the LALR parser of a grammar with the common terminals."""
    return Lark(grammar + COMMON_TERMINALS, parser="lalr", lexer="basic", propagate_positions=True)


def _islands(parser: Lark, tokens: Sequence[Token]) -> Iterator[Tree[Token]]:
    """Yield the syntax trees of the parts of a token sequence that the grammar derives, in order."""
    opened, closed = [], set()  # indices of opening brackets, and of those that are closed
    for k, token in enumerate(tokens):
        if token.endswith(("(", "[", "{")):
            opened.append(k)
        elif token.endswith((")", "]", "}")) and opened:
            closed.add(opened.pop())
    k = 0
    first = set(_expected(parser.parse_interactive(""))) - {"OTHER", "$END"}
    while k < len(tokens):
        island, length = _longest(parser, tokens, k, closed) if tokens[k].type in first else (None, 1)
        if island is not None:
            yield island
        k += length


def _longest(parser: Lark, tokens: Sequence[Token], start: int, closed: set[int]) -> tuple[Tree[Token] | None, int]:
    """Return the longest island from a token on and its number of tokens.

    Without an island it is None, and the number of tokens to skip: those read before the grammar
    refused one if brackets are nested more than 20 deep, else 1.
    """
    run, ends, fed, depth, deepest = parser.parse_interactive(""), [], start, 0, 0
    with suppress(UnexpectedInput):
        for fed in range(start, len(tokens)):
            opens = tokens[fed].endswith(("(", "[", "{"))
            if opens and fed not in closed:
                return None, 1
            depth += opens - tokens[fed].endswith((")", "]", "}"))
            deepest = max(deepest, depth)
            run.feed_token(tokens[fed])
            # As LALR merges lookaheads, the parser may refuse the end that it announces here.
            if depth == 0 and "$END" in _expected(run):
                ends.append(fed + 1)
        fed = len(tokens)
    runs = ((end, again) for end in reversed(ends) for again in (False, True) if again or end == fed)
    for end, again in runs:
        with suppress(UnexpectedInput):
            if again:  # the first run took more tokens, or reduced for a token it then refused
                run = parser.parse_interactive("")
                for token in tokens[start:end]:
                    run.feed_token(token)
            return run.feed_eof(tokens[end - 1]), end - start  # type: ignore[no-untyped-call]
    # Deeply nested brackets that are no island are skipped as a whole: otherwise the text would be
    # parsed to its end from each opening bracket, in quadratic time.
    return None, max(fed - start, 1) if deepest > 20 else 1


def _expected(run: InteractiveParser) -> dict[str, object]:
    """Return the terminals that the parser accepts next."""
    return run.choices()  # type: ignore[no-untyped-call, no-any-return]


def parts(tree: Tree[Token], name: str) -> list[Tree[Token]]:
    """Return a node's children that are nodes of one rule."""
    return [c for c in tree.children if isinstance(c, Tree) and c.data == name]


def words(tree: Tree[Token], kind: str) -> list[Token]:
    """Return a node's children that are tokens of one kind."""
    return [c for c in tree.children if isinstance(c, Token) and c.type == kind]


def is_number(node: Any) -> bool:
    """Return whether a node is a NUMBER token."""
    return isinstance(node, Token) and node.type == "NUMBER"


def integers(texts: Iterable[Any]) -> tuple[int, ...]:
    """Return texts of numbers as integers, truncated; () if one is not below 2^31 in magnitude."""
    values = [float(str(text)) for text in texts]
    return tuple(map(int, values)) if all(abs(v) < 2**31 for v in values) else ()


def only_one(source: str, what: str, by_line: dict[int, Any]) -> Any:
    """Return the only value that a program assigns to a variable, or None if it assigns none.

    by_line : values by the line of their assignment
    Raises InputError where the value changes.
    """
    first = next(iter(by_line), 0)
    for line, value in by_line.items():
        if type(value) is not type(by_line[first]) or not np.array_equal(value, by_line[first]):
            raise InputError(
                f"{source}: line {line}: {what} is changed here, after line {first}; which targets "
                "it holds for depends on the order of execution: split the program there"
            )
    return by_line.get(first)


def repeated(names: Iterable[str], keys: Iterable[str]) -> str:
    """Return the first key that is among the names more than once, or ""."""
    count = Counter(names)
    return next((key for key in keys if count[key] > 1), "")
