"""FANUC listings (.ls): the positions of the part /POS, with their CONFIG (R-30iB operator's manual, "Position data").

CONFIG: N (joint 5 negative, the wrist bent down) or F, U (wrist in front of the line through axes 2 and 3) or D, T
(wrist in front of axis 1) or B, then the turns of joints 1, 4 and 6: 0 for -180 to 180 degrees. Values have three
decimals, as the controller prints them.
"""

import re
from collections import Counter
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
    line_of,
    parts,
    tokens_of,
    whole,
    words,
)

GRAMMAR = r"""
start: position | _other
position: POINT "[" NUMBER [":" STRING] "]" "{" group+ "}"
group: GROUP ":" (item ","?)*
item: NAME ":" (NUMBER | NAME | CONFIG) | NAME "=" (NUMBER | UNSET) [NAME]
POINT.2: /P(?=\s*\[)/
GROUP.2: /GP\d+/
NAME.1: /[A-Za-z_]\w*/
STRING: /"[^"\n]*"/
CONFIG: /'[^'\n]*'/
UNSET: /\*+/
"""
_POSE, _ORDER = ("X", "Y", "Z", "W", "P", "R"), (0, 1, 2)
_TURNING = (0, 3, 5)
_DECIMALS = 3
_CONFIG = re.compile(r"'\s*([NF])\s*([UD])\s*([TB])\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*'")
_CHANGE = re.compile(r"(UTOOL|UFRAME)\[\s*(\d+)[^\]\n]*\]\s*=")
_INCREMENT = re.compile(r"\bP\[\s*(\d+)[^\]\n]*\][^;\n]*\bINC\b", re.IGNORECASE)


class Fanuc(ProgramLanguage):
    """FANUC TP programs as listings."""

    name = "FANUC listing"
    suffixes = (".ls",)
    pose = "X, Y, Z in mm and W, P, R in degrees"

    def targets(self, source: str, text: str, given: Given, joints: int) -> list[Target]:
        begin = re.search(r"^/POS\b", text, re.MULTILINE)
        if begin is None:
            return []
        tokens = tokens_of(GRAMMAR, text[begin.start() :])
        for token in tokens:  # of the whole text
            token.start_pos, token.end_pos = _place(token) + begin.start(), (token.end_pos or 0) + begin.start()
        islands = [p for island in islands_of(GRAMMAR, tokens) for p in parts(island, "position")]
        heads = [k for k in range(len(tokens) - 2) if tokens[k].value == "P" and tokens[k + 1].value == "["]
        read = {island.meta.start_pos: island for island in islands}
        targets = []
        for k in heads:
            line = line_of(text, _place(tokens[k]))
            if _place(tokens[k]) in read:
                targets.append(_target(source, line, read[_place(tokens[k])], given.joint_units(joints)))
            else:
                targets.append((Target(line, f"P[{tokens[k + 2]}]", False, (), left="cannot be read"), ("?", "?")))
        steps = {number: line_of(text, m.start()) for m in _INCREMENT.finditer(text) for number in [m[1]]}
        changes = {(m[1], m[2]): line_of(text, m.start()) for m in _CHANGE.finditer(text)}
        count = Counter(t.name for t, _ in targets)
        once = [
            (t.leave(f"is there {count[t.name]} times" if count[t.name] > 1 else ""), frames) for t, frames in targets
        ]
        return [self._placed(source, t, frames, given, steps, changes) for t, frames in once]

    def _placed(
        self,
        source: str,
        target: Target,
        frames: tuple[str, str],
        given: Given,
        steps: dict[str, int],
        changes: dict[tuple[str, str], int],
    ) -> Target:
        for what, number in zip(("UTOOL", "UFRAME"), frames, strict=True):
            if (what, number) in changes and not target.left:
                raise InputError(
                    f"{source}: line {changes[what, number]}: {what}[{number}] is changed here, and {target.name} "
                    f"(line {target.line}) is given in it; split the program there, or give the frame to the controller"
                )
        number = target.name[2:].partition("]")[0]
        if number in steps:
            target = target.leave(f"line {steps[number]} moves by it (INC), not to it")
        tool, base = (_frame(pick, known) for pick, known in zip(frames, (given.tools, given.bases), strict=True))
        return replace(target, tool=tool, base=base, about=f"tool {frames[0]}, base {frames[1]}")

    def move_line(self, joints: Sequence[float]) -> str:
        axes = ", ".join(f"J{i}= {value:.3f} deg" for i, value in enumerate(joints, 1))
        return f"J P[1] 10% FINE ;\n/POS\nP[1]{{\n   GP1:\n    UF : 0, UT : 1,\n    {axes}\n}};"

    def matrix(self, values: Array) -> Array:
        return matrix_of_angles(values, _ORDER)

    def values(self, T: Array, like: Array) -> Array:
        return angles_of_matrix(T, like, _ORDER)

    def turns(self, q: Array) -> tuple[int, ...]:
        return tuple(int(np.floor((q[i] + np.pi) / (2 * np.pi))) for i in _TURNING) if len(q) == 6 else ()

    def turns_text(self, target: Target, turns: tuple[int, ...]) -> list[str]:
        return [str(turn) for turn in turns]


def _place(token: Token) -> int:
    return token.start_pos or 0


def _frame(pick: str, known: dict[str, Array]) -> Array | None:
    return known[pick] if pick in known else np.eye(4) if pick == "0" else known.get("")


def _target(
    source: str, line: int, position: Tree[Token], axis_units: tuple[float, ...]
) -> tuple[Target, tuple[str, str]]:
    joints = len(axis_units)
    name = f"P[{words(position, 'NUMBER')[0]}]"
    group = parts(position, "group")[0]
    named = [str(i.children[0]) for i in parts(group, "item")]
    items = dict(zip(named, parts(group, "item"), strict=True))
    frames = (_value(items, "UT"), _value(items, "UF"))
    axes = tuple(f"J{i}" for i in range(1, joints + 1))
    keys = axes if "J1" in items else _POSE
    if f"J{joints + 1}" in items:
        raise InputError(f"{source}: line {line}: {name} has J{joints + 1}; this robot has only {joints} joints")
    tokens = [items[key].children[1] if key in items else None for key in keys]
    if not all(isinstance(t, Token) and t.type == "NUMBER" for t in tokens):
        return Target(line, name, "J1" in items, (), left="has a coordinate without a number"), frames
    if twice := next((key for key in keys if named.count(key) > 1), ""):
        return Target(line, name, "J1" in items, (), left=f"has {twice} twice"), frames
    units = {"mm": MM, "deg": DEG}
    own = tuple("mm" if unit == MM else "deg" for unit in axis_units)
    wanted = own if "J1" in items else ("mm",) * 3 + ("deg",) * 3
    for key, unit in zip(keys, wanted, strict=True):
        said = str(items[key].children[-1]).lower()
        if said != unit:
            raise InputError(f"{source}: line {line}: {name}: {key} is given in {said}; it must be in {unit}")
    numbers = tuple(Number.from_token(t, units[u], _DECIMALS) for t, u in zip(tokens, wanted, strict=True))
    external = any(re.fullmatch(r"E\d", k) and float(str(i.children[1])) != 0 for k, i in items.items())
    made = Target(line, name, "J1" in items, numbers, external=external)
    return (made if made.joints else _configured(made, items)), frames


def _value(items: dict[str, Tree[Token]], key: str) -> str:
    return str(items[key].children[1]) if key in items else "?"


def _configured(target: Target, items: dict[str, Tree[Token]]) -> Target:
    if "CONFIG" not in items:
        return target
    token = items["CONFIG"].children[1]
    match = _CONFIG.fullmatch(str(token))
    if match is None or not isinstance(token, Token):
        return target.leave(f"CONFIG {token} is not of the form 'N U T, 0, 0, 0'")
    begin = token.start_pos or 0
    turn_text = tuple(Number(begin + match.start(k), begin + match.end(k), match[k], 1.0) for k in (4, 5, 6))
    posture = Posture(match[3] == "B", match[2] == "D", match[1] == "N")
    turns = whole(match.group(4, 5, 6))
    if not turns:
        return target.leave(f"CONFIG {token[:40]} has a number that is too large")
    return replace(target, posture=posture, turns=turns, turn_text=turn_text)
