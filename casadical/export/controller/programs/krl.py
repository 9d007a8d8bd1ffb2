"""Program language KUKA KRL: positions in .dat and .src, with status S and turn T.

S (KSS operating manual): bit 0 wrist behind axis 1, bit 1 wrist in front of the line through axes 2
and 3, bit 2 joint 5 negative, bit 3 taught by an absolutely accurate robot. T: bit i - 1 is 1 where
the reading of joint i is negative.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from lark import Token, Tree

from casadical.core.basics import Array, InputError
from casadical.export.controller.programs.language import (
    AngleLanguage,
    ParsedText,
    integers,
    is_number,
    only_one,
    parts,
    repeated,
    words,
)
from casadical.export.controller.programs.target import Given, Target, numbers

# Lark grammar of assignments, motions and selections of tools, see `ParsedText`.
KRL_GRAMMAR = r"""
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
# Names of the components of a pose.
_POSE_KEYS = ("X", "Y", "Z", "A", "B", "C")
# Type of the components of an aggregate by name.
Pairs = dict[str, Token | Tree[Token]]
# Type of a selected tool or base: its number, its transform (4, 4) [m], or None if unreadable.
Pick = str | Array | None


class Krl(AngleLanguage):
    """KUKA KRL."""

    name = "KUKA KRL"
    suffixes = (".src", ".dat")
    pose = "X, Y, Z in mm and A, B, C in degrees"
    order = (2, 1, 0)

    def targets(self, source: str, text: str, given: Given, joints: int) -> list[Target]:
        """Return the targets of a module, those that must stay unchanged included.

        Raises InputError: a target has too many joints, or a tool or base changes or lacks a number.
        """
        own, *others = [_Module(each) for each in (text, *given.texts.values())]
        elsewhere = {name: file for file, module in zip(given.texts, others, strict=True) for name in module.assigned}
        frames = _Frames(self, source, [own, *others], given)
        used = {name for module in (own, *others) for name in module.moves}
        targets = []
        for target, name in own.targets(source, given.joint_units(joints), used):
            file = elsewhere.get(name.partition("[")[0])
            targets.append(frames.placed(target.leave(f"{file} gives it another value" if file else ""), name))
        return targets

    def move_line(self, joints: Sequence[float]) -> str:
        """Return a PTP motion to joints [deg or mm]."""
        return f"PTP {{{', '.join(f'A{i} {value:.4f}' for i, value in enumerate(joints, 1))}}}"

    def turns(self, q: Array) -> tuple[int, ...]:
        """Return the bit of T for each joint: 1 if its reading is negative, else 0.

        q : joints, shape (n,) [rad or m]
        """
        return tuple(int(angle < 0) for angle in q)

    def turns_text(self, target: Target, turns: tuple[int, ...]) -> list[str]:
        """Return the new text of T in a list of one, in the number format of the old text.

        T is the integer whose bit i is that of joint i, from 0.

        turns : bits of the joints, as of `turns`
        """
        value, old = sum(bit << i for i, bit in enumerate(turns)), target.turn_text[0].text
        if not old.startswith("'"):
            return [str(value)]
        digits = len(old) - 3
        return [f"'{old[1]}{value:0{digits}b}'" if old[1] in "bB" else f"'{old[1]}{value:0{digits}X}'"]


class _Module:
    """Assignments and motions of one KRL file.

    assignments : (variable, line, right side) of each assignment of an aggregate or a name
    assigned : lines in which each variable gets a value, by its name in upper case
    moves : names of variables that are targets of motions, in upper case
    """

    def __init__(self, text: str) -> None:
        self.parsed = ParsedText(KRL_GRAMMAR, text)
        self.moves = {_name(ref) for move in self.parsed.all("move") for ref in parts(move, "ref")}
        sides = ((assign.children[0], assign.children[1]) for assign in self.parsed.all("assign"))
        self.assignments: list[tuple[str, int, Tree[Token]]] = [
            (_name(left), left.meta.line, right)  # type: ignore[arg-type, union-attr, misc]
            for left, right in sides
        ]
        self.assigned: dict[str, list[int]] = {}
        for name, after in pairwise(self.parsed.tokens):
            if name.type == "NAME" and after.value == "=":
                self.assigned.setdefault(name.upper().partition(".")[0], []).append(name.line or 0)

    def targets(self, source: str, units: tuple[float, ...], used: set[str]) -> list[tuple[Target, str]]:
        """Return each target and the name of its variable, "" for one inside a motion.

        units : factor of each joint's number to SI
        """
        listed = []
        for name, _, right in self.assignments:
            if right.data != "aggregate" or name.startswith(("$", "TOOL_DATA[", "BASE_DATA[")):
                continue
            # Targets are positions with a configuration, joint readings, and frames of motions.
            values, named = _pairs(right), name in used
            posed = set(_POSE_KEYS) <= set(values) and ("S" in values or named)
            if "A1" in values or posed or (named and bool(values)):
                listed.append((right, name, ""))
        for move in self.parsed.all("move"):
            why = "a relative motion" if str(words(move, "MOVE")[0]).upper().endswith("_REL") else ""
            listed += [(aggregate, "", why) for aggregate in parts(move, "aggregate")]
        targets = []
        for aggregate, name, why in sorted(listed, key=lambda entry: entry[0].meta.start_pos):
            target = _target(source, name, aggregate, units).leave(why)
            lines = self.assigned.get(name.partition("[")[0], []) if "[" not in name else []
            if len(lines) > 1:
                target = target.leave(f"line {lines[1]} gives it another value")
            targets.append((target, name))
        return targets


class _Frames:
    """Tools and bases by number, and those that the program selects for all of its targets.

    frames : transforms (4, 4) [m] of TOOL_DATA[..] and BASE_DATA[..], by name and line
    of_point : components of the aggregates (FDAT) that give a point its tool and base numbers, by
        their variable
    chosen : tools and bases that the program selects, by "TOOL" or "BASE" and line
    """

    def __init__(self, language: Krl, source: str, modules: list[_Module], given: Given) -> None:
        self.language, self.source, self.given = language, source, given
        self.frames: dict[str, dict[int, Array]] = {}
        self.of_point: dict[str, Pairs] = {}
        self.chosen: dict[str, dict[int, Pick]] = {"TOOL": {}, "BASE": {}}
        for module in modules:
            for name, line, right in module.assignments:
                self._read(name, line, right)
            for pick in module.parsed.all("pick"):
                what = str(words(pick, "HASH")[0])[1:].upper()
                if what in self.chosen:
                    self.chosen[what][pick.meta.line] = str(words(pick, "NUMBER")[0])

    def _read(self, name: str, line: int, right: Tree[Token]) -> None:
        """Store an assignment that defines a tool or base, or selects one for program or point."""
        values = _pairs(right) if right.data == "aggregate" else {}
        if name.startswith(("TOOL_DATA[", "BASE_DATA[")) and values:
            self.frames.setdefault(name, {})[line] = self._transform(values, line)
        elif name in ("$TOOL", "$BASE"):
            number = _name(right).partition("[")[2].rstrip("]") if right.data == "ref" else ""
            null = right.data == "ref" and _name(right) == "$NULLFRAME"
            made = self._transform(values, line) if values else None
            self.chosen[name[1:]][line] = "0" if null else number or made
        elif "TOOL_NO" in values and "BASE_NO" in values:
            if name == "FDAT_ACT":
                for what in self.chosen:
                    self.chosen[what][line] = str(values[f"{what}_NO"])
            else:
                self.of_point[name] = values

    def _transform(self, values: Pairs, line: int) -> Array:
        """Return the transform, shape (4, 4) [m], of a pose's components."""
        pose = [values.get(key) for key in _POSE_KEYS]
        if not all(map(is_number, pose)):
            raise InputError(f"{self.source}: line {line}: a tool or base needs X, Y, Z, A, B, C as numbers")
        si = np.array([float(str(number)) for number in pose]) * self.language.units
        return self.language.frame(f"{self.source}: line {line}", si)

    def placed(self, target: Target, name: str) -> Target:
        """Return a target with its tool and base frames.

        The numbers in a point's FDAT take precedence over the program's selection.

        name : name of the target's variable, "" for one inside a motion
        """
        data = self.of_point.get(f"F{name[1:]}") if name.startswith("X") else None
        if data is not None and str(data.get("IPO_FRAME", "#BASE")).upper() == "#TCP":
            target = target.leave("its tool stands still and the robot holds the part (IPO_FRAME #TCP)")
        picks = {
            what: str(data[f"{what}_NO"]) if data is not None else only_one(self.source, f"${what}", chosen)
            for what, chosen in self.chosen.items()
        }
        tool, base = (
            self._frame(what, picks[what], transforms)
            for what, transforms in (("TOOL", self.given.tools), ("BASE", self.given.bases))
        )
        names = [p if isinstance(p, str) else "given" if p is not None else "?" for p in picks.values()]
        return replace(target, tool=tool, base=base, about=f"tool {names[0]}, base {names[1]}")

    def _frame(self, what: str, pick: Pick, given: dict[str, Array]) -> Array | None:
        """Return the transform of a tool or base, shape (4, 4) [m]; None if it is unknown."""
        if isinstance(pick, str):
            if pick in given:
                return given[pick]
            name = f"{what}_DATA[{pick}]"
            pick = np.eye(4) if pick == "0" else only_one(self.source, name, self.frames.get(name, {}))
        return given.get("") if pick is None else pick


def _name(ref: Tree[Token]) -> str:
    """Return a variable's name in upper case, with its index: NAME or NAME[INDEX]."""
    index = words(ref, "NUMBER")
    return str(words(ref, "NAME")[0]).upper() + (f"[{index[0]}]" if index else "")


def _pairs(aggregate: Tree[Token]) -> Pairs:
    """Return the components of an aggregate by their names in upper case."""
    named = ((p.children[0], p.children[-1]) for p in parts(aggregate, "pair"))
    return {str(key).upper(): value for key, value in named if value is not None}


def _target(source: str, name: str, aggregate: Tree[Token], axes: tuple[float, ...]) -> Target:
    """Return the target of an aggregate such as {A1 0, A2 -90, ..} or {X 1200, .., S 2, T 10}.

    A target that lacks a number or has one twice has the reason in `skip_reason` and no numbers.

    name : name of its variable, "" for one inside a motion
    axes : factor of each joint's number to SI
    """
    values, line, shown = _pairs(aggregate), aggregate.meta.line, name or "in the motion"
    joints = "A1" in values
    keys = [f"A{i}" for i in range(1, len(axes) + 1)] if joints else _POSE_KEYS
    if lost := [key for key in keys if not is_number(values.get(key))]:
        return Target(line, shown, joints, (), skip_reason=f"without a number for {', '.join(lost)}")
    if (beyond := f"A{len(axes) + 1}") in values:
        raise InputError(f"{source}: line {line}: {shown} has {beyond}; this robot has only {len(axes)} joints")
    if twice := repeated((str(pair.children[0]).upper() for pair in parts(aggregate, "pair")), keys):
        return Target(line, shown, joints, (), skip_reason=f"has {twice} twice")
    external = any(is_number(e := values.get(f"E{i}")) and float(str(e)) != 0 for i in range(1, 7))
    read = numbers((values[key] for key in keys), axes if joints else Krl.units)
    made = Target(line, shown, joints, read, external=external)
    status, turn = (_bits(values.get(key)) for key in ("S", "T"))
    if joints or status is None or turn is None:
        return made
    return replace(
        made,
        posture=(bool(status & 1), not status & 2, bool(status & 4)),
        turns=tuple(turn >> i & 1 for i in range(6)),
        turn_text=numbers([values["T"]], [1.0]),
        accurate=bool(status & 8),
    )


def _bits(token: Token | Tree[Token] | None) -> int | None:
    """Return the integer of a decimal or a literal 'B..' or 'H..'; None from 2^31 or for others."""
    if not isinstance(token, Token) or token.type not in ("NUMBER", "BITS"):
        return None
    text = str(token)
    number = f"{int(text[2:-1][:99], 2 if text[1] in 'bB' else 16)}" if text.startswith("'") else text
    return next(iter(integers([number])), None)
