"""Program language of FANUC listings (.ls): positions of /POS with CONFIG.

CONFIG (R-30iB manual, "Position data"): N (joint 5 negative, the wrist bent down) or F, U (wrist in
front of the line through axes 2 and 3) or D, T (wrist in front of axis 1) or B, then the turns of
joints 1, 4 and 6: 0 for -180 to 180 degrees. Values have three decimals, as the controller prints
them.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from lark import Token, Tree

from casadical.core.basics import M_PER_MM, Array, InputError
from casadical.export.controller.programs.language import (
    AngleLanguage,
    ParsedText,
    integers,
    is_number,
    parts,
    repeated,
    words,
)
from casadical.export.controller.programs.target import Given, Number, Target, numbers

# Lark grammar of the positions of a listing, see `ParsedText`.
FANUC_GRAMMAR = r"""
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


class Fanuc(AngleLanguage):
    """FANUC TP programs as listings."""

    name = "FANUC listing"
    suffixes = (".ls",)
    pose = "X, Y, Z in mm and W, P, R in degrees"
    order = (0, 1, 2)

    def targets(self, source: str, text: str, given: Given, joints: int) -> list[Target]:
        """Return the positions of a listing, those that must stay unchanged included.

        Raises InputError: a tool or frame is changed in the program, or a position has another
        number of joints or other units.
        """
        begin = re.search(r"^/POS\b", text, re.MULTILINE)
        if begin is None:
            return []
        parsed = ParsedText(FANUC_GRAMMAR, re.sub(r"\S", " ", text[: begin.start()]) + text[begin.start() :])
        positions: dict[int | None, Tree[Token]] = {p.meta.start_pos: p for p in parsed.all("position")}
        targets = []
        for point, opens, number in zip(parsed.tokens, parsed.tokens[1:], parsed.tokens[2:], strict=False):
            if point.value != "P" or opens.value != "[":
                continue
            line, position = point.line or 0, positions.get(point.start_pos)
            if position is None:
                targets.append((Target(line, f"P[{number}]", False, (), skip_reason="cannot be read"), ("?", "?")))
            else:
                targets.append(_target(source, line, position, given.joint_units(joints)))
        # Pattern of an incremental motion, by a position and not to it.
        increment_pattern = re.compile(r"\bP\[\s*(\d+)[^\]\n]*\][^;\n]*\bINC\b", re.IGNORECASE)
        steps = {step[1]: _line(text, step) for step in increment_pattern.finditer(text)}
        # Pattern of an assignment of a tool or user frame.
        frame_change_pattern = re.compile(r"(UTOOL|UFRAME)\[\s*(\d+)[^\]\n]*\]\s*=")
        changes = {(change[1], change[2]): _line(text, change) for change in frame_change_pattern.finditer(text)}
        count = Counter(target.name for target, _ in targets)
        for target, frames in targets:
            for what, pick in zip(("UTOOL", "UFRAME"), frames, strict=True):
                if (what, pick) in changes and not target.skip_reason:
                    raise InputError(
                        f"{source}: line {changes[what, pick]}: {what}[{pick}] is changed here, "
                        f"and {target.name} (line {target.line}) is given in it; split the program "
                        "there, or give the frame to the controller"
                    )
        once = [
            (t.leave(f"is there {count[t.name]} times") if count[t.name] > 1 else t, frames) for t, frames in targets
        ]
        return [_placed(target, frames, given, steps) for target, frames in once]

    def move_line(self, joints: Sequence[float]) -> str:
        """Return a slow motion to joints [deg], with its position, as lines of a listing."""
        axes = ", ".join(f"J{i}= {value:.3f} deg" for i, value in enumerate(joints, 1))
        return f"J P[1] 10% FINE ;\n/POS\nP[1]{{\n   GP1:\n    UF : 0, UT : 1,\n    {axes}\n}};"

    def turns(self, q: Array) -> tuple[int, ...]:
        """Return the turns of joints 1, 4 and 6, 0 for -180 to 180 degrees; () if not six joints.

        q : joints, shape (n,) [rad]
        """
        return tuple(int(np.floor((q[i] + np.pi) / (2 * np.pi))) for i in (0, 3, 5)) if len(q) == 6 else ()


def _line(text: str, found: re.Match[str]) -> int:
    """Return the number of the line in which a match begins."""
    return text.count("\n", 0, found.start()) + 1


def _target(source: str, line: int, position: Tree[Token], axes: Sequence[float]) -> tuple[Target, tuple[str, str]]:
    """Return the target of a position, and the numbers of its tool and base as text, "?" if none.

    axes : factor of each joint's number to SI
    """
    name = f"P[{words(position, 'NUMBER')[0]}]"
    group = parts(parts(position, "group")[0], "item")
    items = {str(item.children[0]): item.children for item in group}
    tool, base = (str(items[key][1]) if key in items else "?" for key in ("UT", "UF"))
    joints = "J1" in items
    keys = [f"J{i}" for i in range(1, len(axes) + 1)] if joints else ["X", "Y", "Z", "W", "P", "R"]
    if (beyond := f"J{len(axes) + 1}") in items:
        raise InputError(f"{source}: line {line}: {name} has {beyond}; this robot has only {len(axes)} joints")
    if not all(key in items and is_number(items[key][1]) for key in keys):
        return Target(line, name, joints, (), skip_reason="has a coordinate without a number"), (tool, base)
    if twice := repeated((str(item.children[0]) for item in group), keys):
        return Target(line, name, joints, (), skip_reason=f"has {twice} twice"), (tool, base)
    units = axes if joints else Fanuc.units
    for key, unit in zip(keys, units, strict=True):
        stated, allowed = str(items[key][-1]).lower(), "mm" if unit == M_PER_MM else "deg"
        if stated != allowed:
            raise InputError(f"{source}: line {line}: {name}: {key} is given in {stated}; it must be in {allowed}")
    external = any(re.fullmatch(r"E\d", key) and float(str(item[1])) != 0 for key, item in items.items())
    read = numbers((items[key][1] for key in keys), units, decimals=3)
    made = Target(line, name, joints, read, external=external)
    return (_configured(made, items["CONFIG"][1]) if "CONFIG" in items and not joints else made), (tool, base)


def _configured(target: Target, config: object) -> Target:
    """Return a target with posture and turns of its CONFIG, or marked with why it has none."""
    # Pattern of a configuration such as 'N U T, 0, 0, 0', with the turns of joints 1, 4 and 6.
    config_pattern = re.compile(r"'\s*([NF])\s*([UD])\s*([TB])\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*'")
    match = config_pattern.fullmatch(str(config))
    if match is None or not isinstance(config, Token):
        return target.leave(f"CONFIG {config} is not of the form 'N U T, 0, 0, 0'")
    begin = config.start_pos or 0
    turn_text = tuple(Number(begin + match.start(k), begin + match.end(k), match[k], 1.0) for k in (4, 5, 6))
    turns = integers(match.group(4, 5, 6))
    if not turns:
        return target.leave(f"CONFIG {config[:40]} has a number that is too large")
    posture = match[3] == "B", match[2] == "D", match[1] == "N"
    return replace(target, posture=posture, turns=turns, turn_text=turn_text)


def _placed(target: Target, frames: tuple[str, str], given: Given, steps: dict[str, int]) -> Target:
    """Return a target with its tool and base frames; positions used as increments are skipped."""
    number = target.name[2:].partition("]")[0]
    if number in steps:
        target = target.leave(f"line {steps[number]} moves by it (INC), not to it")
    tool, base = (
        transforms.get(pick, np.eye(4) if pick == "0" else transforms.get(""))
        for pick, transforms in zip(frames, (given.tools, given.bases), strict=True)
    )
    return replace(target, tool=tool, base=base, about=f"tool {frames[0]}, base {frames[1]}")
