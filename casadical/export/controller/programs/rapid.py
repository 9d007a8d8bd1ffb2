"""Program language ABB RAPID (.mod): robtarget and jointtarget, declared or inside a motion.

confdata: the quarter turns of axes 1, 4 and 6, and cfx = 4 (wrist behind axis 1) + 2 (behind the
lower arm) + 1 (joint 5 negative). Tool and work object are those of the motions that use a target.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from lark import Token, Tree

from casadical.core.basics import M_PER_MM, Array, InputError
from casadical.core.transforms import frame, from_quaternion, quaternion
from casadical.export.controller.programs.language import ParsedText, ProgramLanguage, integers, is_number, parts
from casadical.export.controller.programs.target import Given, Target, numbers

# Lark grammar of declarations, motions and assignments, see `ParsedText`.
RAPID_GRAMMAR = r"""
start: declaration | motion | assignment | _other
declaration: NAME ref ":=" list
assignment: ref ":="
motion: MOTION argument ("," argument)* ";"
argument: (ref | call | list | NUMBER | STRING | OP | option)+
option: "\\" NAME [":=" (ref | NUMBER | list)]
call: NAME "(" [argument ("," argument)*] ")"
ref: NAME ["{" (NUMBER | NAME) ("," (NUMBER | NAME))* "}"]
list: "[" [_value ("," _value)*] "]"
_value: NUMBER | NAME | STRING | list
MOTION.3: /(Move|Arc|Trigg|Search|Spot|Cap|Disp|Paint)[A-Za-z]*\b/i
NAME.2: /[A-Za-z_]\w*(\.\w+)*/
OP: /[-+*\/]/
STRING: /"[^"\n]*"/
COMMENT.4: /![^\n]*/
%ignore COMMENT
"""
# Names of the data types of targets.
_TARGET_TYPES = ("robtarget", "jointtarget")


class Rapid(ProgramLanguage):
    """ABB RAPID."""

    name = "ABB RAPID"
    suffixes = (".mod", ".modx", ".prg")
    units = (M_PER_MM, M_PER_MM, M_PER_MM, 1.0, 1.0, 1.0, 1.0)
    pose = "x, y, z in mm and the quaternion q1, q2, q3, q4"

    def targets(self, source: str, text: str, given: Given, joints: int) -> list[Target]:
        """Return the targets of a module, those that must stay unchanged included.

        Raises InputError: the robot has not six joints, a displacement is switched on, a target is
        used with two tools or work objects, or a frame has no numbers or changes.
        """
        if joints != 6:
            raise InputError(f"{source}: a RAPID target has six axes; this robot has {joints}")
        parsed = ParsedText(RAPID_GRAMMAR, text)
        for token in parsed.tokens:
            if token.type == "NAME" and str(token).lower() in ("pdispon", "pdispset", "eoffson", "eoffsset"):
                raise InputError(
                    f"{source}: line {token.line}: {token} displaces the targets that follow, by "
                    "an amount that is not in the program; give the displacement to the work object"
                )
        module = _Module(self, source, parsed, given)
        return [module.placed(target, name) for target, name in module.targets()]

    def move_line(self, joints: Sequence[float]) -> str:
        """Return the text of a MoveAbsJ motion to joints [deg]."""
        axes = ",".join(f"{value:.4f}" for value in (*joints, *[0.0] * (6 - len(joints))))
        return f"MoveAbsJ [[{axes}],[{','.join(['9E9'] * 6)}]]\\NoEOffs, v100, fine, tool0;"

    def matrix(self, values: Array) -> Array:
        """Return the pose, shape (4, 4) [m], of a position and a quaternion.

        values : position [m], then quaternion with its scalar first, shape (7,)
        Raises InputError: the quaternion's length differs from 1 by more than 1 %.
        """
        q = values[3:]
        length = float(np.linalg.norm(q))
        if abs(length - 1) > 1e-2:  # more is no rounding
            raise InputError(f"quaternion {q.tolist()}: its length is {length:.4g}; it must be 1")
        return frame(from_quaternion(q), values[:3])

    def values(self, T: Array, like: Array) -> Array:
        """Return position [m] and quaternion, scalar first, of a pose, shape (7,).

        T : pose, shape (4, 4) [m]
        like : other numbers of this kind; of the two equivalent quaternions, that nearer to its
            quaternion is returned
        """
        q = quaternion(T[:3, :3])
        return np.concatenate([T[:3, 3], q if q @ like[3:] >= 0 else -q])

    def turns(self, q: Array) -> tuple[int, ...]:
        """Return the quarter turns of axes 1, 4 and 6, as in confdata; () if not six joints.

        q : joints, shape (n,) [rad]
        """
        return tuple(int(np.floor(q[i] / (np.pi / 2))) for i in (0, 3, 5)) if len(q) == 6 else ()


class _Module:
    """Declarations and motions of a module, and the tool and work object of each target.

    changed : line in which a variable gets a value after its declaration, by its name
    frames : transforms (4, 4) [m] of tools and work objects, or the reason why one cannot be used,
        by data type and name
    uses : line of a target's first motion, and its tool and work object there, by its key, as of
        `targets`
    """

    def __init__(self, language: Rapid, source: str, parsed: ParsedText, given: Given) -> None:
        self.language, self.source, self.given, self.tokens = language, source, given, parsed.tokens
        self.motions, self.declared = parsed.all("motion"), _declared(parsed)
        self.known_targets = {name for kind, name, _ in self.declared if kind in _TARGET_TYPES}
        self.changed: dict[str, int] = {}
        for change in parsed.all("assignment"):
            self.changed.setdefault(_variable(change).partition(".")[0], change.meta.line)
        self.frames: dict[tuple[str, str], Array | str] = {}
        for each in (parsed, *(ParsedText(RAPID_GRAMMAR, text) for text in given.texts.values())):
            for kind, name, value in _declared(each):
                if kind in ("tooldata", "wobjdata"):
                    self.frames[kind, name] = self._frame(kind, value)
        self.uses: dict[str, tuple[int, str, str]] = {}
        for motion in self.motions:
            *arguments, last = parts(motion, "argument")
            tool, work = _tool_of(last)
            for name in (name for argument in arguments for name in _names(argument)):
                line, *before = self.uses.setdefault(name, (motion.meta.line, tool, work))
                if before != [tool, work] and name in self.known_targets:
                    raise InputError(
                        f"{self.source}: line {motion.meta.line}: {name} is used with tool {tool} "
                        f"and work object {work}, in line {line} with {before[0]} and {before[1]}; "
                        "give it a target of its own"
                    )

    def targets(self) -> list[tuple[Target, str]]:
        """Return (target, key) of each target of the module, in its order.

        The key is that under which `uses` has a target that a motion takes: its name, or for one
        inside a motion its line and column. It is "" for a target whose value is an expression.
        """
        made: list[tuple[int, Target, str]] = []
        for kind, name, value in self.declared:
            if kind in _TARGET_TYPES:
                made += [(v.meta.start_pos, self._target(kind, n, v), name) for n, v in _elements(name, value)]
        for motion in self.motions:
            arguments = parts(motion, "argument")
            for value in (value for argument in arguments for value in parts(argument, "list")):
                kind = "jointtarget" if len(value.children) == 2 else "robtarget"
                key = f"in line {value.meta.line}, {value.meta.column}"
                self.uses[key] = (value.meta.line, *_tool_of(arguments[-1]))
                made.append((value.meta.start_pos, self._target(kind, "in the motion", value), key))
        # Declarations of targets whose value is not a list of numbers are skipped with a reason.
        for typed, variable, sign in zip(self.tokens, self.tokens[1:], self.tokens[2:], strict=False):
            unread = (
                typed.lower() in _TARGET_TYPES and sign.value == ":=" and variable.lower() not in self.known_targets
            )
            if unread:
                unread_target = Target(
                    variable.line or 0, str(variable), False, (), skip_reason="its value is an expression"
                )
                made.append((variable.start_pos or 0, unread_target, ""))
        return [(target, name) for _, target, name in sorted(made, key=lambda entry: entry[0])]

    def _target(self, kind: str, name: str, value: Tree[Token]) -> Target:
        """Return the target of a declared list of numbers, or why it cannot be corrected."""
        line, joints = value.meta.line, kind == "jointtarget"
        flat = [part.children for part in value.children if isinstance(part, Tree)]
        sizes = [6, 6] if joints else [3, 4, 4, 6]
        if [len(part) for part in flat] != sizes or not all(is_number(token) for part in flat for token in part):
            return Target(line, name, joints, (), skip_reason="is not made of numbers alone")
        external = any(float(str(t)) not in (0.0, 9e9) for t in flat[-1])
        if joints:
            return Target(line, name, True, numbers(flat[0], self.given.joint_units(6)), external=external)
        pose = numbers([*flat[0], *flat[1]], self.language.units)
        configuration = integers(flat[2])
        if not configuration:
            return Target(line, name, False, pose, skip_reason="its configuration has a number that is too large")
        *turns, cfx = configuration
        posture = bool(cfx & 4), bool(cfx & 2), bool(cfx & 1)
        turn_text = numbers(flat[2][:3], [1.0] * 3)
        made = Target(line, name, False, pose, posture, tuple(turns), turn_text, external=external)
        length = float(np.linalg.norm(made.si[3:]))
        if not abs(length - 1) <= 1e-2:
            made = made.leave(f"its quaternion has the length {length:.4g}; it must be 1")
        return made if cfx in range(8) else made.leave(f"its cfx is {cfx:g}; 0 to 7 are defined")

    def placed(self, target: Target, name: str) -> Target:
        """Return a target with its tool and base frames, or with why it stays unchanged."""
        if name in self.changed:
            target = target.leave(f"line {self.changed[name]} gives it another value")
        _, *named = self.uses.get(name, (0, "", ""))
        frames: list[Array | None] = []
        givens = (self.given.tools, self.given.bases)
        for kind, word, given in zip(("tooldata", "wobjdata"), named, givens, strict=True):
            found = self._frame_named(kind, word, given)
            if isinstance(found, str):
                target, found = target.leave(found), None
            frames.append(found)
        tool, work = (word or "?" for word in named)
        return replace(target, tool=frames[0], base=frames[1], about=f"tool {tool}, base {work}")

    def _frame_named(self, kind: str, name: str, given: dict[str, Array]) -> Array | str | None:
        """Return a named tool or work object: its transform, (4, 4) [m], or None if unknown.

        The reason is returned as text where it cannot be used.
        """
        by_name = {key.lower(): T for key, T in given.items()}
        if name in by_name:
            return by_name[name]
        if name in ("tool0", "wobj0"):
            return np.eye(4)
        if (kind, name) not in self.frames:
            return by_name.get("")
        if name in self.changed:
            raise InputError(
                f"{self.source}: line {self.changed[name]}: {name} is changed here; which targets "
                "it holds for depends on the order of execution: split the program there"
            )
        return self.frames[kind, name]

    def _frame(self, kind: str, value: Tree[Token]) -> Array | str:
        """Return the transform, (4, 4) [m], of tool or work object data, or why it is unusable."""
        first = str(value.children[0]).upper()
        if kind == "tooldata":
            return self._pose(value.children[1]) if first == "TRUE" else "its tool stands still (robhold FALSE)"
        if first == "TRUE":
            return "the robot holds its work object (robhold TRUE)"
        if str(value.children[1]).upper() != "TRUE":
            return "a mechanical unit moves its work object (ufprog FALSE)"
        return self._pose(value.children[3]) @ self._pose(value.children[4])

    def _pose(self, value: Tree[Token] | Token) -> Array:
        """Return the transform, (4, 4) [m], of a pose. Raises InputError: not seven numbers."""
        tokens = value.scan_values(lambda t: isinstance(t, Token)) if isinstance(value, Tree) else [value]
        numbers = [float(str(t)) for t in tokens if t.type == "NUMBER"]
        line = value.meta.line if isinstance(value, Tree) else value.line
        if len(numbers) != len(self.language.units):
            raise InputError(f"{self.source}: line {line}: a frame must be [[x, y, z], [q1, q2, q3, q4]] in numbers")
        return self.language.frame(f"{self.source}: line {line}", np.array(numbers) * self.language.units)


def _variable(node: Tree[Token]) -> str:
    """Return the variable of a declaration or assignment, in lower case."""
    return str(parts(node, "ref")[0].children[0]).lower()


def _declared(parsed: ParsedText) -> list[tuple[str, str, Tree[Token]]]:
    """Return (data type, name, value) of each declaration with a list; both words in lower case."""
    return [(str(d.children[0]).lower(), _variable(d), parts(d, "list")[0]) for d in parsed.all("declaration")]


def _elements(name: str, value: Tree[Token]) -> list[tuple[str, Tree[Token]]]:
    """Return (name, value) of each target of a declaration.

    They are the variable itself, or the elements of an array with names such as p{2}.
    """
    inner = [c for c in value.children if isinstance(c, Tree)]
    nested = any(isinstance(c, Tree) and any(isinstance(cc, Tree) for cc in c.children) for c in inner)
    if not nested or len(inner) != len(value.children):
        return [(name, value)]
    return [e for i, c in enumerate(inner, 1) for e in _elements(f"{name}{{{i}}}", c)]


def _tool_of(last: Tree[Token]) -> tuple[str, str]:
    """Return the names of tool and work object of a motion, from its last argument, in lower case.

    The tool is "" if it is no variable; without a work object it is "wobj0".
    """
    tool = next((str(ref.children[0]).lower() for ref in parts(last, "ref")), "")
    options = (option for option in parts(last, "option") if str(option.children[0]).lower() == "wobj")
    works = [_variable(option) for option in options if parts(option, "ref")]
    return tool, works[-1] if works else "wobj0"


def _names(argument: Tree[Token]) -> list[str]:
    """Return the names, in lower case, of the variables in an argument and in calls inside it.

    Such calls are Offs and RelTool.
    """
    own = [str(r.children[0]).lower() for r in parts(argument, "ref")]
    return own + [n for call in parts(argument, "call") for a in parts(call, "argument") for n in _names(a)]
