"""Targets of a controller program: where their numbers stand, what they mean, and what is known of tool and base.

They are the parts of a program that a grammar knows; everything between them stays opaque. A whole grammar of such a
language is that of one release of one maker. A grammar of its targets alone is small, and a line that it does not know
costs nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from lark import Lark, Token, Tree, UnexpectedInput
from lark.parsers.lalr_interactive_parser import InteractiveParser

from casadical.core.basics import Array, InputError

DEG, MM = np.pi / 180, 1e-3
_FINEST = {DEG: 6, MM: 4, 1.0: 9}  # decimals: below a tenth of a micrometre at the tool


@dataclass(frozen=True)
class Number:
    """A number of the text: its place [characters], its text, and the factor that makes it SI.

    decimals : that it is written with; None: as many as it has, and enough for its unit
    """

    start: int
    stop: int
    text: str
    unit: float
    decimals: int | None = None

    @classmethod
    def from_token(cls, token: Any, unit: float, decimals: int | None = None) -> Number:
        return cls(token.start_pos, token.end_pos, str(token), unit, decimals)

    @property
    def si(self) -> float:
        return float(self.text) * self.unit

    def written(self, value: float) -> str:
        """Another value [SI] as text."""
        _, _, fraction = self.text.lower().partition("e")[0].partition(".")
        decimals = max(len(fraction), _FINEST[self.unit]) if self.decimals is None else self.decimals
        text = f"{value / self.unit:.{decimals}f}"
        return text[1:] if float(text) == 0 and text.startswith("-") else text

    def differs(self, text: str) -> bool:
        """Whether a text means another number."""
        return self.text.startswith("'") or text.startswith("'") or float(self.text) != float(text)


class Posture(NamedTuple):
    """Which of the eight arms of a six-axis robot reaches a pose.

    behind : the wrist is behind axis 1; bent_back : it is behind the line from axis 2 through axis 3
    wrist_negative : the reading of joint 5 is negative
    """

    behind: bool
    bent_back: bool
    wrist_negative: bool


@dataclass(frozen=True, eq=False)
class Target:
    """One target.

    joints : whether its numbers are joint readings, else a pose in the language's own form
    posture, turns, turn_text : the arm's configuration and the joints' turns where the program says them, and the
        number or word that says the turns
    near : joints [rad] that the pose's solution is to be near to, shape (n,), where the program says them
    tool, base : tool in the flange's frame and base in the controller's root frame, each (4, 4) [m]; None: not known
    about : names of tool and base; left : why the target stays as it is, empty if it is to be corrected
    external : whether an external axis is off its zero; accurate : whether it was taught with absolute accuracy on
    """

    line: int
    name: str
    joints: bool
    numbers: tuple[Number, ...]
    posture: Posture | None = None
    turns: tuple[int, ...] | None = None
    turn_text: tuple[Number, ...] = ()
    near: Array | None = None
    tool: Array | None = None
    base: Array | None = field(default_factory=lambda: np.eye(4))
    about: str = ""
    left: str = ""
    external: bool = False
    accurate: bool = False

    @property
    def si(self) -> Array:
        return np.array([number.si for number in self.numbers])

    def leave(self, reason: str) -> Target:
        """The same target, to be left as it is; the first reason counts."""
        return self if self.left else replace(self, left=reason)


@dataclass(frozen=True, eq=False)
class Given:
    """What a program does not say itself.

    tools, bases : transforms (4, 4) [m] by the name or number that the program uses; "" for the only one
    texts : other files of the program in which tools and bases are looked up, by file name
    units : rad or m of each joint's reading in the robot file; none: all rad
    """

    tools: dict[str, Array] = field(default_factory=dict)
    bases: dict[str, Array] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    units: tuple[str, ...] = ()

    def joint_units(self, joints: int) -> tuple[float, ...]:
        """Degrees, millimetres of a linear axis, each as a factor to SI."""
        return tuple(MM if unit == "m" else DEG for unit in self.units or ("rad",) * joints)


def whole(texts: Iterable[Any]) -> tuple[int, ...]:
    """Numbers of a program as whole ones; none where one of them is too large for any controller."""
    values = [float(str(text)) for text in texts]
    return tuple(map(int, values)) if all(abs(v) < 2**31 for v in values) else ()


def line_of(text: str, place: int) -> int:
    return text.count("\n", 0, place) + 1


def only_one(source: str, what: str, found: dict[int, Any]) -> Any:
    """What a program sets once or to one value; None where it never does. Raises InputError where it is changed.

    found : by line
    """
    lines = list(found)
    for line in lines[1:]:
        if not same(found[line], found[lines[0]]):
            raise InputError(
                f"{source}: line {line}: {what} is changed here, after line {lines[0]}; which targets it holds for "
                "depends on the order of execution: split the program there"
            )
    return found[lines[0]] if lines else None


def same(a: Any, b: Any) -> bool:
    if isinstance(a, str) or isinstance(b, str) or a is None or b is None:
        return bool(isinstance(a, str) and isinstance(b, str) and a == b) or (a is None and b is None)
    return bool(np.array_equal(a, b))


# Of every language: a number, and whatever no other terminal takes (of lowest priority, so that text is never refused).
COMMON = r"""
_other: OTHER
NUMBER: /[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?/
OTHER.-9: /./s
%ignore /\s+/
"""


_OPENING, _CLOSING = tuple("([{"), tuple(")]}")
# Brackets in brackets: what is deeper and no island is left as a whole, else each of its beginnings is read to the end.
DEEPEST = 20


@cache
def _parser(grammar: str) -> Lark:
    return Lark(grammar + COMMON, parser="lalr", lexer="basic", propagate_positions=True)


def tokens_of(grammar: str, text: str) -> list[Token]:
    """All tokens of a text, without those that the grammar ignores."""
    return list(_parser(grammar).lex(text))


def islands_of(grammar: str, tokens: Sequence[Token]) -> Iterator[Tree[Token]]:
    """Each longest run of tokens that the grammar's `start` derives, in their order, without overlaps."""
    parser, k, closed = _parser(grammar), 0, _closed(tokens)
    first = set(_expected(parser.parse_interactive(""))) - {"OTHER", "$END"}
    while k < len(tokens):
        island, length = _longest(parser, tokens, k, closed) if tokens[k].type in first else (None, 1)
        if island is not None:
            yield island
        k += length


def _closed(tokens: Sequence[Token]) -> set[int]:
    """Indices of the opening brackets that are closed."""
    opened, closed = [], set()
    for k, token in enumerate(tokens):
        if token.endswith(_OPENING):
            opened.append(k)
        elif token.endswith(_CLOSING) and opened:
            closed.add(opened.pop())
    return closed


def _longest(parser: Lark, tokens: Sequence[Token], start: int, closed: set[int]) -> tuple[Tree[Token] | None, int]:
    """The longest run from a token that is a whole island and how many tokens it has, or None and how many to pass."""
    run, ends, fed, depth, deepest = parser.parse_interactive(""), [], start, 0, 0
    with suppress(UnexpectedInput):
        for fed in range(start, len(tokens)):
            opens = tokens[fed].endswith(_OPENING)
            if opens and fed not in closed:
                return None, 1
            depth += opens - tokens[fed].endswith(_CLOSING)
            deepest = max(deepest, depth)
            run.feed_token(tokens[fed])
            if depth == 0 and "$END" in _expected(
                run
            ):  # where lookaheads are merged (LALR), the end may be refused all the same
                ends.append(fed + 1)
        fed = len(tokens)
    runs = ((end, again) for end in reversed(ends) for again in (False, True) if again or end == fed)
    for end, again in runs:
        with suppress(UnexpectedInput):
            if again:  # the first run has taken more, or reduced for a token that it then refused
                run = parser.parse_interactive("")
                for token in tokens[start:end]:
                    run.feed_token(token)
            return run.feed_eof(tokens[end - 1]), end - start  # type: ignore[no-untyped-call]
    return None, max(fed - start, 1) if deepest > DEEPEST else 1


def _expected(run: InteractiveParser) -> dict[str, object]:
    return run.choices()  # type: ignore[no-untyped-call, no-any-return]


def parts(tree: Tree[Token], name: str) -> list[Tree[Token]]:
    """A node's children of one rule."""
    return [c for c in tree.children if isinstance(c, Tree) and c.data == name]


def words(tree: Tree[Token], kind: str) -> list[Token]:
    """A node's own tokens of one kind."""
    return [c for c in tree.children if isinstance(c, Token) and c.type == kind]
