"""A program in a controller's language with corrected targets: what each target becomes, and how far off it was.

A pose is solved with the nominal robot in its posture, its joints are corrected like any others, and the nominal
robot's pose at the corrected joints is written: the controller, which solves it with the nominal robot, finds them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.core.parts import Placement
from casadical.core.transforms import frame
from casadical.export.c.reference import Status
from casadical.export.controller.commands import Sources, command_of, own_robots, robot_of
from casadical.export.controller.correction import FINE, LEAVES_BOX, Corrector, corrected_joints, model_corrector
from casadical.export.controller.functions import tool_function
from casadical.export.controller.inverse import solved
from casadical.export.controller.postures import Postures
from casadical.export.controller.programs.language import ProgramLanguage
from casadical.export.controller.programs.target import Target

LEFT = "LEFT"  # statuses beside those of the correction
NO_TOOL, NO_CONFIGURATION, UNREACHABLE = "NO_TOOL", "NO_CONFIGURATION", "UNREACHABLE"
AMBIGUOUS, CONFIGURATION_CHANGES, EXTERNAL_AXIS = "AMBIGUOUS", "CONFIGURATION_CHANGES", "EXTERNAL_AXIS"
NEEDS_ROBOT_FILE = "NEEDS_ROBOT_FILE"


@dataclass(frozen=True, eq=False)
class Tooled:
    """One tool: its correction, and nominal and real robot as functions q[n] -> (p[3] m, R[3x3]); None for a folder."""

    corrector: Corrector
    nominal: ca.Function | None = None
    real: ca.Function | None = None


@dataclass(frozen=True, eq=False)
class Cell:
    """The robots that a program is corrected for, and what the program does not say of its frames.

    sources, steps, orientation, limit_mm : as of `command_of`
    root : the controller's root frame in the robot file's base frame; flange : its flange in the last link's frame;
        each (4, 4) [m]
    nearest : a pose without a configuration is reached as near as possible to the target before it
    external_still : external axes carry neither the robot nor its bases
    folder : the corrector of an export folder, in place of robot files; its tool is that of the export
    """

    sources: Sources | None
    steps: int = 2
    orientation: bool = False
    limit_mm: float | None = None
    root: Array = field(default_factory=lambda: np.eye(4))
    flange: Array = field(default_factory=lambda: np.eye(4))
    nearest: bool = False
    external_still: bool = False
    folder: Corrector | None = None
    _made: dict[bytes, Tooled] = field(default_factory=dict, repr=False)

    @property
    def units(self) -> tuple[str, ...]:
        """Of each joint's reading, rad or m."""
        if self.sources is None and self.folder:
            return self.folder.units or ("rad",) * self.folder.joints
        return robot_of(self._files.robot).units

    @property
    def _files(self) -> Sources:
        assert self.sources is not None
        return self.sources

    @cached_property
    def postures(self) -> Postures:
        """Solutions of the nominal robot's flange."""
        nominal = own_robots(self._files)[1]
        return Postures(replace(nominal, tool=Placement(self.flange)), self.root)

    def with_tool(self, tool: Array | None) -> Tooled:
        """The robots with a tool, (4, 4) [m] in the flange's frame; None: the tool of the robot file."""
        if self.sources is None:
            assert self.folder is not None
            return Tooled(self.folder)
        key = b"" if tool is None else tool.tobytes()
        if key not in self._made:
            self._made[key] = _tooled(
                self.sources if tool is None else self._holding(tool), self.steps, self.orientation, self.limit_mm
            )
        return self._made[key]

    def _holding(self, tool: Array) -> Sources:
        held = self.flange @ tool
        files = self._files
        if files.nominal is None:
            return files
        given = (robot_of(r) for r in (files.robot, files.nominal))
        robots = [replace(r, tool=replace(r.tool, T=held), knowledge=None) for r in given]
        return replace(files, robot=robots[0], nominal=robots[1], tool="shared")


def _tooled(sources: Sources, steps: int, orientation: bool, limit_mm: float | None) -> Tooled:
    command = command_of(sources, steps, orientation=orientation, limit_mm=limit_mm)
    fallback = model_corrector(command_of(sources, steps, limit_mm=limit_mm)) if orientation else None
    real, nominal, turn = own_robots(sources)
    return Tooled(
        model_corrector(command, fallback),
        tool_function(nominal, "nominal", True),
        tool_function(real, "calibrated", True, turn, command.network),
    )


@dataclass(frozen=True, eq=False)
class Result:
    """What becomes of one target.

    status : OK, or why it keeps its numbers; why : the same in words, where the status does not say it
    texts : the new text of each number, and of each word that says the turns
    moved_mm : how far the real tool is moved; off_mm, off_deg : how far the real tool is from the nominal one's
        position and orientation, before and after, with the numbers as they are written; None: not known
    bound_mm : below it 95 % of the errors are that remain in position; None: not known
    q : joints of the target, before and after [rad or m], each shape (n,); None: not known
    """

    target: Target
    status: str
    why: str = ""
    texts: tuple[str, ...] = ()
    moved_mm: float | None = None
    off_mm: tuple[float, float] | None = None
    off_deg: tuple[float, float] | None = None
    bound_mm: float | None = None
    q: tuple[Array, Array] | None = None

    @property
    def fine(self) -> bool:
        """Whether the target was corrected."""
        return self.status in FINE


def corrected_targets(language: ProgramLanguage, targets: list[Target], cell: Cell) -> list[Result]:
    """Each target corrected, or left with the reason."""
    results: list[Result] = []
    before: Array | None = None
    for target in targets:
        found = _joints(target, cell, language, before)
        if isinstance(found, Result):
            results.append(found)
        else:
            before = found
            results.append(Result(target, Status.OK.name, q=(found, found)))
    for tool in {_key(r.target): r.target.tool for r in results if r.fine}.values():
        chosen = [k for k, r in enumerate(results) if r.fine and _key(r.target) == _key(replace(r.target, tool=tool))]
        made = cell.with_tool(tool)
        q = np.array([results[k].q[0] for k in chosen])  # type: ignore[index]
        new, names = corrected_joints(made.corrector, q)
        for k, old, to, name in zip(chosen, q, new, names, strict=True):
            if name not in FINE:
                results[k] = replace(results[k], status=name, q=None)
            else:
                found = _written(language, results[k].target, cell, made, old, to)
                results[k] = replace(found, status=name) if found.fine else found
    return results


def _key(target: Target) -> bytes:
    return b"" if target.tool is None else target.tool.tobytes()


def _joints(target: Target, cell: Cell, language: ProgramLanguage, before: Array | None) -> Array | Result:
    """Joints [rad or m] of a target, shape (n,), or the result that says why there are none."""
    if target.left:
        return Result(target, LEFT, target.left)
    if target.joints:
        return target.si
    if cell.sources is None:
        return Result(target, NEEDS_ROBOT_FILE)
    if target.tool is None or target.base is None:
        missing = "tool" if target.tool is None else "base"
        return Result(target, NO_TOOL, f"its {missing} is not known ({target.about})")
    if target.external and not cell.external_still:
        return Result(target, EXTERNAL_AXIS)
    T = cell.root @ target.base @ language.matrix(target.si) @ np.linalg.inv(target.tool)
    postures = cell.postures
    near = before if target.near is None and target.posture is None and cell.nearest else target.near
    if near is not None:
        found = postures.nearest(T, near)
        return Result(target, UNREACHABLE) if found is None else found
    if target.posture is None or target.turns is None:
        return Result(target, NO_CONFIGURATION)
    if postures.why_not:
        return Result(target, NO_CONFIGURATION, postures.why_not)
    every = postures.solutions(T, _sides(target), language.turns, target.turns)
    if len(every) != 1:
        return Result(target, AMBIGUOUS if len(every) else UNREACHABLE)
    return np.asarray(every[0])


def _sides(target: Target) -> tuple[bool, bool, bool]:
    posture = target.posture
    assert posture is not None
    return posture.behind, posture.bent_back, posture.wrist_negative


def _written(language: ProgramLanguage, target: Target, cell: Cell, made: Tooled, old: Array, new: Array) -> Result:
    """The new numbers of a target as text, and what is off with them."""
    if target.joints:
        values = new
    else:
        assert made.nominal is not None
        assert target.base is not None
        values = language.values(np.linalg.inv(cell.root @ target.base) @ _pose(made.nominal, new), target.si)
    texts = tuple(n.written(v) for n, v in zip(target.numbers, values, strict=True))
    reads = np.array([float(text) * n.unit for text, n in zip(texts, target.numbers, strict=True)])
    if target.posture is not None:
        if tuple(cell.postures.sides(new[None])[0]) != _sides(target):
            return Result(target, CONFIGURATION_CHANGES)
        if target.turns is not None and target.turn_text:
            texts += tuple(language.turns_text(target, language.turns(new)))
    q = reads if target.joints else _controller(language, target, cell, made, reads, new)
    if q is None or _beyond(cell, q):
        return Result(target, LEAVES_BOX if q is not None else UNREACHABLE)
    bound = made.corrector.bound(old[None])[0] if made.corrector.bound else None
    result = Result(target, Status.OK.name, "", texts, bound_mm=bound, q=(old, q))
    if made.real is None or made.nominal is None:
        return replace(result, moved_mm=_apart(*made.corrector.position(np.array([old, q]))))
    wanted, was, now = _pose(made.nominal, old), _pose(made.real, old), _pose(made.real, q)
    off = (_apart(was[:3, 3], wanted[:3, 3]), _apart(now[:3, 3], wanted[:3, 3]))
    turned = (_angle(was, wanted), _angle(now, wanted))
    return replace(result, moved_mm=_apart(was[:3, 3], now[:3, 3]), off_mm=off, off_deg=turned)


def _controller(
    language: ProgramLanguage, target: Target, cell: Cell, made: Tooled, reads: Array, new: Array
) -> Array | None:
    """Joints at which a controller, which has the nominal robot, reaches the pose as it is written."""
    assert target.base is not None
    assert made.nominal is not None
    T = cell.root @ target.base @ language.matrix(reads)
    found = solved(made.nominal, T[None, :3, 3], T[None, :3, :3], new[None], cell.postures.nominal.limits)
    return found.q[0] if found.reached[0] else None


def _beyond(cell: Cell, q: Array) -> bool:
    if cell.sources is None:
        return False
    lower, upper = cell.postures.nominal.limits
    return bool((q < lower).any() or (q > upper).any())


def _pose(function: ca.Function, q: Array) -> Array:
    p, R = function(q)
    return frame(R.full(), p.full()[:, 0])


def _apart(a: Array, b: Array) -> float:
    return float(1e3 * np.linalg.norm(a - b))


def _angle(A: Array, B: Array) -> float:
    """Angle between two orientations [deg]."""
    return float(np.rad2deg(2 * np.arcsin(min(1.0, float(np.linalg.norm(A[:3, :3] - B[:3, :3]) / np.sqrt(8))))))


def refuse_accuracy(source: str, targets: list[Target]) -> None:
    """Raises InputError for targets that were taught with the controller's own absolute accuracy on."""
    for target in targets:
        if target.accurate:
            raise InputError(
                f"{source}: line {target.line}: {target.name} was taught with the controller's absolute accuracy on "
                "(bit 3 of S); with it on, errors are corrected twice: switch it off, and say so with --accuracy-off"
            )


def summary(results: list[Result]) -> dict[str, Any]:
    """The results as plain data: targets, corrected ones, refused ones by line, errors [mm, deg]."""
    fine = [r for r in results if r.fine]
    found: dict[str, Any] = {
        "targets": len(results),
        "corrected": len(fine),
        "refused": [
            {"line": r.target.line, "name": r.target.name, "status": r.status, "why": r.why}
            for r in results
            if not r.fine
        ],
    }
    for key, pairs in (
        ("off_nominal_mm_max", [r.off_mm for r in fine]),
        ("off_nominal_deg_max", [r.off_deg for r in fine]),
    ):
        known = [p for p in pairs if p is not None]
        if known:
            found[key] = {"before": max(p[0] for p in known), "after": max(p[1] for p in known)}
    return found
