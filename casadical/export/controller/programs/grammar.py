"""Island parsing of robot programs: tokens, and the runs of tokens that a target grammar derives.

Everything between the runs (islands) stays opaque. A complete grammar of such a language is that of
one release of one maker. A grammar of its targets alone is small, and a line that it cannot parse
does no harm (island grammars; Moonen 2001).
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from typing import Any

import numpy as np
from lark import Lark, Token, Tree, UnexpectedInput
from lark.parsers.lalr_interactive_parser import InteractiveParser

from casadical.core.basics import InputError

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
    """Yield the syntax trees of those parts of a token sequence that the grammar derives, in order.

    parser : parser of the grammar
    """
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
    start : index of the token; closed : indices of the opening brackets that are closed; an island
        has no others
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

    source, what : names of program and variable, for the message
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
