"""KUKA KRL: positions in .dat and .src, with status S and turn T (KSS, "Operating and programming instructions").

S: bit 0 wrist behind axis 1, bit 1 wrist in front of the line through axes 2 and 3, bit 2 joint 5 negative, bit 3
taught by an absolutely accurate robot. T: bit i - 1 is 1 where the reading of joint i is negative.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from lark import Token, Tree

from casadical.core.basics import Array, InputError
from casadical.export.controller.programs.language import ProgramLanguage, angles_of_matrix, matrix_of_angles
from casadical.export.controller.programs.target import (
    DEG,
    MM,
    Given,
    Number,
    Posture,
    Target,
    islands_of,
    only_one,
    parts,
    tokens_of,
    whole,
    words,
)

GRAMMAR = r"""
start: assign | move | pick | _other
assign: ref "=" (aggregate | ref)
move: MOVE place ["," place]
pick: NAME "(" HASH "," NUMBER ")"
?place: aggregate | ref
ref: NAME ["[" [NUMBER] "]"]
aggregate: "{" [NAME ":"] [pair ("," pair)*] "}"
pair: NAME ["[" "]"] (NUMBER | STRING | BITS | HASH | NAME | aggregate)
MOVE.2: /S?(PTP|LIN|CIRC)(_REL)?\b/i
NAME.1: /[$A-Za-z_][\w$]*(\.\w+)*/
HASH: /#\w+/
BITS: /'[BH][0-9A-F]+'/i
STRING: /"[^"\n]*"/
COMMENT.3: /;[^\n]*/
%ignore COMMENT
"""
_POSE, _ORDER = ("X", "Y", "Z", "A", "B", "C"), (2, 1, 0)
_ACCURATE = 8
_POSITIONS = ("POS", "E3POS", "E6POS", "AXIS", "E3AXIS", "E6AXIS")
Pairs = dict[str, Token | Tree[Token]]


class Krl(ProgramLanguage):
    """KUKA KRL."""

    name = "KUKA KRL"
    suffixes = (".src", ".dat")
    pose = "X, Y, Z in mm and A, B, C in degrees"

    def targets(self, source: str, text: str, given: Given, joints: int) -> list[Target]:
        own = _Module(text)
        others = [_Module(other) for other in given.texts.values()]
        elsewhere = {name: file for file, module in zip(given.texts, others, strict=True) for name in module.assigned}
        frames = _Frames(self, source, [own, *others], given)
        used = {name for module in (own, *others) for name in module.moves}
        targets = [
            (t, name, elsewhere.get(name.partition("[")[0]))
            for t, name in own.targets(source, given.joint_units(joints), used)
        ]
        return [
            frames.placed(t if file is None else t.leave(f"{file} gives it another value"), name)
            for t, name, file in targets
        ]

    def move_line(self, joints: Sequence[float]) -> str:
        return f"PTP {{{', '.join(f'A{i} {value:.4f}' for i, value in enumerate(joints, 1))}}}"

    def matrix(self, values: Array) -> Array:
        return matrix_of_angles(values, _ORDER)

    def values(self, T: Array, like: Array) -> Array:
        return angles_of_matrix(T, like, _ORDER)

    def turns(self, q: Array) -> tuple[int, ...]:
        return tuple(int(angle < 0) for angle in q)

    def turns_text(self, target: Target, turns: tuple[int, ...]) -> list[str]:
        value, old = sum(bit << i for i, bit in enumerate(turns)), target.turn_text[0].text
        if not old.startswith("'"):
            return [str(value)]
        digits = len(old) - 3
        return [f"'{old[1]}{value:0{digits}b}'" if old[1] in "bB" else f"'{old[1]}{value:0{digits}X}'"]


class _Module:
    """What is read of one file. assigned : lines in which each variable gets a value, by its name in upper case."""

    def __init__(self, text: str) -> None:
        self.tokens = tokens_of(GRAMMAR, text)
        self.islands = list(islands_of(GRAMMAR, self.tokens))
        self.moves = {
            _name(ref) for island in self.islands for move in parts(island, "move") for ref in parts(move, "ref")
        }
        self.assigned: dict[str, list[int]] = {}
        for name, after in zip(self.tokens, [*self.tokens[1:], None], strict=False):
            if name.type == "NAME" and after is not None and after.value == "=":
                self.assigned.setdefault(name.upper().partition(".")[0], []).append(name.line or 0)

    def assignments(self) -> list[tuple[str, Tree[Token], Tree[Token]]]:
        """Name, left side and right side of each assignment of a list or a name."""
        made = [(a.children[0], a.children[1]) for island in self.islands for a in parts(island, "assign")]
        return [(_name(left), left, right) for left, right in made]  # type: ignore[arg-type, misc]

    def targets(self, source: str, units: tuple[float, ...], used: set[str]) -> list[tuple[Target, str]]:
        """Each target and the name of its variable, empty for one inside of a motion."""
        here = [(_name(left), left, right) for _, left, right in self.assignments()]
        listed = [(r.meta.start_pos, n, r, "") for n, _, r in here if _is_target(n, r, used)]
        for island in self.islands:
            for move in parts(island, "move"):
                word = str(words(move, "MOVE")[0]).upper()
                why = "a relative motion" if word.endswith("_REL") else ""
                listed += [(a.meta.start_pos, "", a, why) for a in parts(move, "aggregate")]
        targets = []
        for _, name, aggregate, why in sorted(listed, key=lambda entry: entry[0]):
            target = _target(source, name, aggregate, units).leave(why)
            lines = self.assigned.get(name.partition("[")[0], []) if "[" not in name else []
            if len(lines) > 1:
                target = target.leave(f"line {lines[1]} gives it another value")
            targets.append((target, name))
        return targets


class _Frames:
    """Tools and bases by number, and the ones that the program selects for all of its targets."""

    def __init__(self, language: Krl, source: str, modules: list[_Module], given: Given) -> None:
        self.language, self.source, self.given = language, source, given
        self.known: dict[str, dict[int, Array]] = {}
        self.of_point: dict[str, Pairs] = {}
        chosen: dict[str, dict[int, str | Array | None]] = {"TOOL": {}, "BASE": {}}
        for module in modules:
            for name, left, right in module.assignments():
                self._read(name, left.meta.line, right, chosen)
            for island in module.islands:
                for pick in parts(island, "pick"):
                    what = str(words(pick, "HASH")[0])[1:].upper()
                    if what in chosen:
                        chosen[what][pick.meta.line] = str(words(pick, "NUMBER")[0])
        self.chosen = chosen

    def _read(self, name: str, line: int, right: Tree[Token], chosen: dict[str, dict[int, str | Array | None]]) -> None:
        values = _pairs(right) if right.data == "aggregate" else {}
        if name.startswith(("TOOL_DATA[", "BASE_DATA[")) and values:
            self.known.setdefault(name, {})[line] = self._transform(values, line)
        elif name in ("$TOOL", "$BASE"):
            number = _name(right).partition("[")[2].rstrip("]") if right.data == "ref" else ""
            null = right.data == "ref" and _name(right) == "$NULLFRAME"
            chosen[name[1:]][line] = "0" if null else number or (self._transform(values, line) if values else None)
        elif "TOOL_NO" in values and "BASE_NO" in values:
            if name == "FDAT_ACT":
                chosen["TOOL"][line], chosen["BASE"][line] = str(values["TOOL_NO"]), str(values["BASE_NO"])
            else:
                self.of_point[name] = values

    def _transform(self, values: Pairs, line: int) -> Array:
        numbers = [values.get(key) for key in _POSE]
        if not all(isinstance(n, Token) and n.type == "NUMBER" for n in numbers):
            raise InputError(f"{self.source}: line {line}: a tool or base needs X, Y, Z, A, B, C as numbers")
        pose = np.array([float(str(n)) for n in numbers]) * self.language.units
        return self.language.frame(f"{self.source}: line {line}", pose)

    def placed(self, target: Target, name: str) -> Target:
        data = self.of_point.get(f"F{name[1:]}") if name.startswith("X") else None
        if data is not None:
            if str(data.get("IPO_FRAME", "#BASE")).upper() == "#TCP":
                target = target.leave("its tool stands still and the robot holds the part (IPO_FRAME #TCP)")
            picks: list[str | Array | None] = [str(data["TOOL_NO"]), str(data["BASE_NO"])]
        else:
            picks = [only_one(self.source, f"${what}", self.chosen[what]) for what in ("TOOL", "BASE")]
        tool = self._frame("TOOL", picks[0], self.given.tools)
        base = self._frame("BASE", picks[1], self.given.bases)
        names = [p if isinstance(p, str) else "given" if p is not None else "?" for p in picks]
        return replace(target, tool=tool, base=base, about=f"tool {names[0]}, base {names[1]}")

    def _frame(self, what: str, pick: str | Array | None, given: dict[str, Array]) -> Array | None:
        if not isinstance(pick, str):
            return pick if pick is not None else given.get("")
        if pick in given:
            return given[pick]
        if pick == "0":
            return np.eye(4)
        made = only_one(self.source, f"{what}_DATA[{pick}]", self.known.get(f"{what}_DATA[{pick}]", {}))
        return made if made is not None else given.get("")


def _name(ref: Tree[Token]) -> str:
    index = words(ref, "NUMBER")
    return str(words(ref, "NAME")[0]).upper() + (f"[{index[0]}]" if index else "")


def _pairs(aggregate: Tree[Token]) -> Pairs:
    named = ((p.children[0], p.children[-1]) for p in parts(aggregate, "pair"))
    return {str(key).upper(): value for key, value in named if value is not None}


def _is_target(name: str, right: Tree[Token], used: set[str]) -> bool:
    """Positions with a configuration, joint readings, and frames that a motion names."""
    if right.data != "aggregate" or name.startswith(("$", "TOOL_DATA[", "BASE_DATA[")):
        return False
    values = _pairs(right)
    posed = set(_POSE) <= set(values)
    return "A1" in values or (posed and ("S" in values or name in used)) or (name in used and bool(values))


def _target(source: str, name: str, aggregate: Tree[Token], units: tuple[float, ...]) -> Target:
    joints = len(units)
    values = _pairs(aggregate)
    line, shown = aggregate.meta.line, name or "in the motion"
    axes = tuple(f"A{i}" for i in range(1, joints + 1))
    keys, unit = (axes, units) if "A1" in values else (_POSE, (MM,) * 3 + (DEG,) * 3)
    tokens = [values.get(key) for key in keys]
    if not all(isinstance(t, Token) and t.type == "NUMBER" for t in tokens):
        lost = ", ".join(k for k, t in zip(keys, tokens, strict=True) if not isinstance(t, Token) or t.type != "NUMBER")
        return Target(line, shown, "A1" in values, (), left=f"without a number for {lost}")
    if f"A{joints + 1}" in values:
        raise InputError(f"{source}: line {line}: {shown} has A{joints + 1}; this robot has only {joints} joints")
    named = [str(pair.children[0]).upper() for pair in parts(aggregate, "pair")]
    if twice := next((key for key in keys if named.count(key) > 1), ""):
        return Target(line, shown, "A1" in values, (), left=f"has {twice} twice")
    numbers = tuple(Number.from_token(t, u) for t, u in zip(tokens, unit, strict=True))
    external = any(_moved(values.get(f"E{i}")) for i in range(1, 7))
    made = Target(line, shown, "A1" in values, numbers, external=external)
    return made if made.joints else _with_words(made, values)


def _with_words(target: Target, values: Pairs) -> Target:
    status, turn = (_bits(values.get(key)) for key in ("S", "T"))
    if status is None or turn is None:
        return target
    posture = Posture(bool(status & 1), not status & 2, bool(status & 4))
    turns = tuple(turn >> i & 1 for i in range(6))
    words_of_turns = (Number.from_token(values["T"], 1.0),)
    accurate = bool(status & _ACCURATE)
    return replace(target, posture=posture, turns=turns, turn_text=words_of_turns, accurate=accurate)


def _bits(token: Token | Tree[Token] | None) -> int | None:
    if not isinstance(token, Token) or token.type not in ("NUMBER", "BITS"):
        return None
    text = str(token)
    number = f"{int(text[2:-1][:99], 2 if text[1] in 'bB' else 16)}" if text.startswith("'") else text
    return next(iter(whole([number])), None)


def _moved(token: Token | Tree[Token] | None) -> bool:
    return isinstance(token, Token) and token.type == "NUMBER" and float(token) != 0
