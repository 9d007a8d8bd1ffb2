"""Program language URScript (.script): joint lists and poses p[...] that are motion targets.

A pose is a target where a motion or get_inverse_kin takes it as it is, `qnear` of which is read
too; one that is part of an expression (pose_trans, pose_add) is relative to something that only the
controller knows, and stays unchanged.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from lark import Token, Tree

from casadical.core.basics import Array, InputError
from casadical.core.transforms import frame
from casadical.export.controller.programs.language import ParsedText, ProgramLanguage, is_number, only_one, parts, words
from casadical.export.controller.programs.target import RAD_PER_DEG, Given, Number, Target, numbers

# Lark grammar of assignments and calls, see `ParsedText`.
URSCRIPT_GRAMMAR = r"""
start: assign | call | _other
assign: NAME "=" _value
call: NAME "(" [argument ("," argument)*] ")"
argument: [NAME "="] _value
_value: _atom (OP _atom)*
_atom: NUMBER | NAME | STRING | list | pose | call
pose: POSE [_value ("," _value)*] "]"
list: "[" [_value ("," _value)*] "]"
POSE.3: /\bp\s*\[/
NAME.2: /[A-Za-z_]\w*/
OP: /[-+*\/]/
STRING: /"[^"\n]*"/
COMMENT.4: /#[^\n]*/
%ignore COMMENT
"""


class UrScript(ProgramLanguage):
    """Universal Robots URScript."""

    name = "URScript"
    suffixes = (".script", ".urscript")
    units = (1.0,) * 6
    pose = "x, y, z in m and the rotation vector rx, ry, rz in rad"

    def targets(self, source: str, text: str, given: Given, joints: int) -> list[Target]:
        """Return the targets of a program, those that must stay unchanged included.

        Raises InputError: the robot has linear joints, the tool centre point changes, or numbers
        look like mm or degrees.
        """
        if "m" in given.units:
            raise InputError(f"{source}: URScript has no linear axes; joint {given.units.index('m') + 1} is one")
        program = _Program(source, text, joints)
        tools = {
            line: None if pose is None else self.frame(f"{source}: line {line}", pose)
            for line, pose in program.tools.items()
        }
        tool = given.tools.get("", only_one(source, "the tool centre point", tools))
        base, about = given.bases.get("", np.eye(4)), "set_tcp" if tools else ""
        return [replace(t, tool=tool, base=base, about=about) for t in program.targets()]

    def move_line(self, joints: Sequence[float]) -> str:
        """Return the text of a movej motion, in rad, to joints [deg]."""
        return f"movej([{', '.join(f'{value:.6f}' for value in np.deg2rad(joints))}], a=0.5, v=0.3)"

    def matrix(self, values: Array) -> Array:
        """Return the pose, shape (4, 4) [m], of a position [m] and a rotation vector [rad].

        values : the two, shape (6,)
        """
        from scipy.spatial.transform import Rotation

        return frame(Rotation.from_rotvec(values[3:]).as_matrix(), values[:3])

    def values(self, T: Array, like: Array) -> Array:
        """Return position [m] and rotation vector [rad] of a pose, shape (6,).

        Of the equivalent rotation vectors, whole turns apart, it has the nearest to that of `like`.

        T : pose, shape (4, 4) [m]; like : other numbers of this kind, shape (6,)
        """
        from scipy.spatial.transform import Rotation

        vector = Rotation.from_matrix(T[:3, :3]).as_rotvec()
        angle = float(np.linalg.norm(vector))
        axis = vector / angle if angle > 0 else np.array([0.0, 0.0, 1.0])
        around = [axis * (angle + 2 * np.pi * k) for k in (-2, -1, 0, 1)]
        return np.concatenate([T[:3, 3], min(around, key=lambda r: float(np.linalg.norm(r - like[3:])))])


@dataclass
class _Variable:
    """A variable that holds a pose or a list of joints.

    line : line of its first assignment
    value : value that is assigned first
    sets : lines of all its assignments
    target : whether a motion takes it
    near : `qnear` of its inverse kinematics; None: none
    read : number of places where it is read as a target or as `qnear`
    """

    line: int
    value: Tree[Token]
    sets: list[int] = field(default_factory=list)
    target: bool = False
    near: Tree[Token] | None = None
    read: int = 0


class _Program:
    """Poses and joint lists of a URScript program, and where each is used."""

    def __init__(self, source: str, text: str, joints: int) -> None:
        parsed = ParsedText(URSCRIPT_GRAMMAR, text)
        self.source, self.joints, self.tokens = source, joints, parsed.tokens
        self.variables: dict[str, _Variable] = {}
        for assign in parsed.all("assign"):
            if len(assign.children) == 2 and (value := _listed(assign.children[1])):
                variable = self.variables.setdefault(str(assign.children[0]), _Variable(assign.meta.line, value))
                variable.sets.append(assign.meta.line)
        for name, sign in pairwise(self.tokens):
            own = self.variables.get(str(name)) if name.type == "NAME" else None
            if own is not None and sign.value == "=" and name.line not in own.sets and name.line is not None:
                own.sets.append(name.line)
        self.tools: dict[int, Array | None] = {}
        self.made: list[tuple[int, Target]] = []
        for island in parsed.islands:
            for call in island.iter_subtrees_topdown():  # type: ignore[no-untyped-call]
                if call.data == "call":
                    self._call(call)

    def _call(self, call: Tree[Token]) -> None:
        """Record the targets or the tool of a call. Raises InputError: a tool longer than 3 m."""
        name, arguments = str(call.children[0]), parts(call, "argument")
        # Number of targets of each motion command.
        targets_of_motion = {"movej": 1, "movel": 1, "movep": 1, "movec": 2, "servoj": 1, "servoc": 1}
        if name == "set_tcp" and arguments:
            tool = self.tools[call.meta.line] = _si(self._resolved(arguments[0]))
            if tool is not None and (away := np.abs(tool[:3]).max()) > 3.0:
                raise InputError(
                    f"{self.source}: line {call.meta.line}: the tool is {away:g} m long; URScript "
                    "has metres, and this looks like millimetres"
                )
        elif name == "get_inverse_kin" and arguments:
            near = next((self._resolved(a) for a in arguments[1:] if _keyword(a) in ("", "qnear")), None)
            for word in (word for argument in arguments[1:] for word in words(argument, "NAME")):
                if str(word) in self.variables:
                    self.variables[str(word)].read += 1
            self._take(arguments[0], near, call)
        elif name in targets_of_motion:
            for argument in arguments[: targets_of_motion[name]]:
                self._take(argument, None, call)

    def _take(self, argument: Tree[Token], near: Tree[Token] | None, call: Tree[Token]) -> None:
        """Record a call's argument as a target, or with the reason why it cannot be corrected.

        near : `qnear` of its inverse kinematics; None: none
        """
        value = argument.children[-1]
        single = len([c for c in argument.children if c is not None]) == (2 if _keyword(argument) else 1)
        if single and (listed := _listed(value)):
            self.made.append((listed.meta.start_pos, self._target("in the motion", listed, near)))
        elif single and isinstance(value, Token) and str(value) in self.variables:
            variable = self.variables[str(value)]
            variable.target, variable.read = True, variable.read + 1
            variable.near = variable.near if near is None else near
        elif not (single and isinstance(value, Tree) and str(value.children[0]) == "get_inverse_kin"):
            why = "is an expression that only the controller can evaluate"
            self.made.append(
                (call.meta.start_pos, Target(call.meta.line, str(call.children[0]), False, (), skip_reason=why))
            )

    def _resolved(self, argument: Tree[Token]) -> Tree[Token] | None:
        """Return the pose or list that an argument is, or that its variable has, else None.

        A variable counts if the program assigns it once.
        """
        value = argument.children[-1]
        if isinstance(value, Token):
            own = self.variables.get(str(value))
            return own.value if own is not None and len(own.sets) == 1 else None
        return _listed(value)

    def targets(self) -> list[Target]:
        """Return the targets in the order of the text, those that must stay unchanged included."""
        made = list(self.made)
        named = Counter(str(t) for t in self.tokens if t.type == "NAME")
        for name, variable in self.variables.items():
            if not variable.target:
                continue
            target = self._target(name, variable.value, variable.near)
            if len(variable.sets) > 1:
                target = target.leave(f"line {variable.sets[1]} gives it another value")
            if named[name] > len(variable.sets) + variable.read:
                target = target.leave("it is also part of an expression")
            made.append((variable.value.meta.start_pos, target))
        return [target for _, target in sorted(made, key=lambda entry: entry[0])]

    def _target(self, name: str, value: Tree[Token], near: Tree[Token] | None) -> Target:
        """Return the target of a pose or list; near : its `qnear`."""
        line, joints = value.meta.line, value.data == "list"
        read, wanted = _numbers(value), self.joints if joints else 6
        if read is None or len(read) != wanted:
            return Target(line, name, joints, (), skip_reason=f"is not made of {wanted} numbers")
        made = Target(line, name, joints, read)
        size = np.abs(made.si)
        if not joints and size[:3].max() > 20.0:
            raise InputError(
                f"{self.source}: line {line}: {name} is {size[:3].max():g} m away; "
                "URScript has metres, and this looks like millimetres"
            )
        if (size if joints else size[3:]).max() > 4 * np.pi:
            raise InputError(
                f"{self.source}: line {line}: {name} has an angle of {size.max():g} "
                "rad; URScript has radians, and this looks like degrees: write d2r(..)"
            )
        return made if near is None or joints else replace(made, near=_si(near))


def _keyword(argument: Tree[Token]) -> str:
    """Return the keyword of an argument, "" if it has none."""
    first = argument.children[0]
    return str(first) if len(argument.children) > 1 and isinstance(first, Token) and first.type == "NAME" else ""


def _listed(value: Tree[Token] | Token | None) -> Tree[Token] | None:
    """Return a value if it is a pose or a list, else None."""
    return value if isinstance(value, Tree) and value.data in ("pose", "list") else None


def _si(value: Tree[Token] | None) -> Array | None:
    """Return the numbers of a pose or list in SI units, shape (6,); None if they are not six."""
    read = None if value is None else _numbers(value)
    return np.array([number.si for number in read]) if read and len(read) == 6 else None


def _numbers(value: Tree[Token]) -> tuple[Number, ...] | None:
    """Return the numbers of a pose or list; None if it holds anything but numbers and d2r(number).

    The unit of the latter is the degree.
    """
    read: list[Number] = []
    for part in value.children:
        token, unit = part, 1.0
        if isinstance(part, Tree) and part.data == "call" and str(part.children[0]) == "d2r":
            token, unit = parts(part, "argument")[0].children[-1], RAD_PER_DEG
        if is_number(token):
            read += numbers([token], [unit])
        elif not (isinstance(part, Token) and part.type == "POSE"):
            return None
    return tuple(read)
