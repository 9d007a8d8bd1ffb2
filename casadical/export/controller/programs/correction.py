"""Correct the targets of a robot program: new numbers, or a reason, and the tool's deviation.

A pose is solved with the nominal robot in its posture, its joints are corrected like any others,
and the nominal robot's pose at the corrected joints is written: the controller, which solves it
with the nominal robot, arrives at the corrected joints.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import permutations, product

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.parts import Placement
from casadical.core.transforms import frame
from casadical.export.c.reference import Status
from casadical.export.controller.commands import Sources, command_of, own_robots, robot_of
from casadical.export.controller.correction import (
    CORRECTED_STATUSES,
    Corrector,
    corrected_joints,
    model_corrector,
    tool_function,
)
from casadical.export.controller.inverse import Newton, Postures
from casadical.export.controller.programs.language import ProgramLanguage
from casadical.export.controller.programs.target import Number, Target


@dataclass(frozen=True, eq=False)
class Cell:
    """Robots for which a program is corrected, and the frames that the program does not contain.

    sources, steps, orientation : as of `command_of`; sources None: there is an export folder
    root : pose of the controller's root frame in the robot file's base frame, shape (4, 4) [m]
    flange : pose of the controller's flange in the last link's frame, shape (4, 4) [m]
    nearest : whether a pose without a configuration is solved nearest to the target before it
    external_still : whether external axes carry neither the robot nor its bases
    leave_unreached : whether poses that the nominal robot does not reach remain unchanged;
        otherwise the program is refused
    folder : corrector of an export folder, in place of robot files; its tool is that of the export
    _made : cache of the correctors of each tool
    """

    sources: Sources | None
    steps: int = 2
    orientation: bool = False
    root: Array = field(default_factory=lambda: np.eye(4))
    flange: Array = field(default_factory=lambda: np.eye(4))
    nearest: bool = False
    external_still: bool = False
    leave_unreached: bool = False
    folder: Corrector | None = None
    _made: dict[bytes, Corrector] = field(default_factory=dict, repr=False)

    @property
    def units(self) -> tuple[str, ...]:
        """Return the unit of each joint's reading, "rad" or "m", n words."""
        if self.folder:
            return self.folder.units or ("rad",) * self.folder.joints
        assert self.sources is not None
        return robot_of(self.sources.robot).units

    @cached_property
    def postures(self) -> Postures:
        """Return the nominal robot's inverse kinematics at the controller's flange."""
        assert self.sources is not None
        return Postures(replace(own_robots(self.sources)[1], tool=Placement(self.flange)), self.root)

    def with_tool(self, tool: Array | None) -> Corrector:
        """Return the corrector for a tool.

        tool : pose of the tool in the controller's flange frame, shape (4, 4) [m]; None: the robot
            file's tool. An export folder has its own tool, whatever this one is
        """
        if self.folder:
            return self.folder
        assert self.sources is not None
        key = b"" if tool is None else tool.tobytes()
        if key in self._made:
            return self._made[key]
        files = self.sources
        if tool is not None and files.nominal is not None:
            # Where the measured point is the tool's centre point, the real robot keeps that point.
            real, nominal, tool_frame = robot_of(files.robot), robot_of(files.nominal), self.flange @ tool
            of_real = frame(tool_frame[:3, :3], real.tool.T[:3, 3]) if files.tool == "own" else tool_frame
            files = replace(
                files,
                robot=replace(real, tool=replace(real.tool, T=of_real), knowledge=None),
                nominal=replace(nominal, tool=replace(nominal.tool, T=tool_frame), knowledge=None),
                tool="own",
            )
        self._made[key] = self._corrector(files)
        return self._made[key]

    def _corrector(self, sources: Sources) -> Corrector:
        """Return the corrector, with functions of the tool poses of both robots, for one tool."""
        plain = command_of(sources, self.steps)
        corrector = model_corrector(plain)
        if self.orientation:
            pose_command = command_of(sources, self.steps, orientation=True)
            corrector = model_corrector(pose_command, corrector)
        real, nominal, turn = own_robots(sources)
        return replace(
            corrector,
            nominal=tool_function(nominal, "nominal", True),
            real=tool_function(real, "calibrated", True, turn, plain.network),
        )


@dataclass(frozen=True, eq=False)
class CorrectedTarget:
    """Correction of one target: its new numbers, or the reason why it remains unchanged.

    target : target as it is in the program
    status : OK or POSITION_ONLY, or the name of the reason why it keeps its numbers
    why : the reason in words, where the status does not state it
    texts : new text of each number, and of each word that holds the turns
    moved_mm : distance by which the correction moves the real tool [mm]; None: unknown
    off_mm, off_deg : distance and angle of the real tool from the nominal tool, before and after
        the correction, with the numbers as they are written [mm, deg]; None: unknown
    q : joints of the target before and after, shape (n,) each [rad or m]; None: unknown
    """

    target: Target
    status: str
    why: str = ""
    texts: tuple[str, ...] = ()
    moved_mm: float | None = None
    off_mm: tuple[float, float] | None = None
    off_deg: tuple[float, float] | None = None
    q: tuple[Array, Array] | None = None

    @property
    def fine(self) -> bool:
        """Return whether the target is corrected."""
        return self.status in CORRECTED_STATUSES

    @property
    def changes(self) -> Iterator[tuple[Number, str]]:
        """Yield those numbers and words of the target that change, each with its new text.

        There are none if the target is not corrected.
        """
        if self.fine:
            for number, text in zip((*self.target.numbers, *self.target.turn_text), self.texts, strict=False):
                if number.differs(text):
                    yield number, text


def corrected_targets(language: ProgramLanguage, targets: Sequence[Target], cell: Cell) -> list[CorrectedTarget]:
    """Return the correction of each target, or the reason why it remains unchanged.

    cell : robots and frames
    Raises InputError: the nominal robot does not reach a pose, and `leave_unreached` is not set.
    Then the frames are not the controller's, and other targets would be corrected at wrong places.
    """
    results = _solved(language, targets, cell)
    unreached = [r.target for r in results if r.status == "UNREACHABLE"]
    if unreached and not cell.leave_unreached:
        raise InputError(_unreached(language, unreached, sum(not t.joints for t in targets), cell))
    groups: dict[bytes, list[int]] = {}
    for k, r in enumerate(results):
        if r.fine:
            groups.setdefault(b"" if r.target.tool is None else r.target.tool.tobytes(), []).append(k)
    for chosen in groups.values():
        corrector = cell.with_tool(results[chosen[0]].target.tool)
        q = np.array([results[k].q[0] for k in chosen])  # type: ignore[index]
        new, names = corrected_joints(corrector, q)
        fine = np.array([name in CORRECTED_STATUSES for name in names])
        corrected = [results[k].target for k in np.array(chosen)[fine]]
        written = _rewritten(language, corrected, cell, corrector, q[fine], new[fine])
        for k, name in zip(chosen, names, strict=True):
            result = next(written) if name in CORRECTED_STATUSES else replace(results[k], q=None)
            results[k] = replace(result, status=name if result.fine else result.status)
    return results


def _solved(language: ProgramLanguage, targets: Sequence[Target], cell: Cell) -> list[CorrectedTarget]:
    """Return each target with its joints before the correction, or with the reason for having none.

    Pose targets are solved by the nominal robot's inverse kinematics; nothing is corrected yet.
    """
    results = [CorrectedTarget(t, *_obstacle(t, cell)) for t in targets]
    flanges = {
        k: _flange(language, r.target, cell.root, np.eye(4))
        for k, r in enumerate(results)
        if r.fine and not r.target.joints
    }
    own = [k for k in flanges if targets[k].near is not None]
    wanted = [np.array([flanges[k] for k in own]), np.array([targets[k].near for k in own])]
    near = dict(zip(own, cell.postures.nearest(*wanted), strict=True)) if own else {}
    before: Array | None = None
    for k, r in enumerate(results):
        if not r.fine:
            continue
        if r.target.joints:
            results[k] = _with_joints(r.target, r.target.si)
        elif k in near:
            results[k] = _with_joints(r.target, near[k])
        elif r.target.posture is None and cell.nearest and before is not None:
            results[k] = _with_joints(r.target, *cell.postures.nearest(flanges[k][None], before[None]))
        else:
            results[k] = _in_posture(language, r.target, flanges[k], cell.postures)
        before = before if (q := results[k].q) is None else q[0]
    return results


def _flange(language: ProgramLanguage, target: Target, root: Array, turned: Array) -> Array:
    """Return the flange pose of a target in the robot's own base frame, shape (4, 4) [m].

    root : pose of the controller's root frame there, shape (4, 4) [m]
    turned : additional rotation of the flange, shape (4, 4)
    """
    assert target.base is not None
    assert target.tool is not None
    return np.asarray(root @ target.base @ language.matrix(target.si) @ np.linalg.inv(turned @ target.tool))


def _obstacle(target: Target, cell: Cell) -> tuple[str, str]:
    """Return status and reason of a target whose joints cannot be computed; else ("OK", "").

    The reason is "" where the status says everything.
    """
    if target.skip_reason:
        return "LEFT", target.skip_reason
    if target.joints:
        return Status.OK.name, ""
    if cell.sources is None:
        return "NEEDS_ROBOT_FILE", ""
    if target.tool is None or target.base is None:
        return "NO_TOOL", f"its {'tool' if target.tool is None else 'base'} is unknown ({target.about})"
    return ("EXTERNAL_AXIS" if target.external and not cell.external_still else Status.OK.name), ""


def _with_joints(target: Target, q: Array | None) -> CorrectedTarget:
    """Return a target with its joints q, (n,) [rad or m]; with status UNREACHABLE for None."""
    return CorrectedTarget(target, "UNREACHABLE") if q is None else CorrectedTarget(target, Status.OK.name, q=(q, q))


def _in_posture(language: ProgramLanguage, target: Target, flange: Array, postures: Postures) -> CorrectedTarget:
    """Return a target with the joints that reach it in the program's arm configuration and turns.

    Its status is the reason if the program states no configuration, or no or several joints fit.

    flange : pose of the flange in the robot's own base frame, shape (4, 4) [m]
    """
    if target.posture is None or target.turns is None:
        return CorrectedTarget(target, "NO_CONFIGURATION")
    if postures.why_not:
        return CorrectedTarget(target, "NO_CONFIGURATION", postures.why_not)
    every = postures.solutions(flange, target.posture, language.turns, target.turns)
    return (
        _with_joints(target, every[0] if len(every) else None)
        if len(every) < 2
        else CorrectedTarget(target, "AMBIGUOUS")
    )


def _unreached(language: ProgramLanguage, targets: Sequence[Target], poses: int, cell: Cell) -> str:
    """Return the error message for targets that the nominal robot does not reach."""
    names = ", ".join(f"{language.place} {t.line}, {t.name}" for t in targets[:5])
    more = f" and {len(targets) - 5} more" if len(targets) > 5 else ""
    frames = _frames_that_reach(language, targets[:8], cell)
    tried = "no quarter turns of them reach these poses either"
    if frames:
        which = f"with {', or with '.join(frames)} the nominal robot reaches"
        these = "them" if len(targets) <= 8 else "the first 8"
        tried = f"{which} {these}; the controller shows which is right"
    return (
        f"nothing is corrected: the nominal robot does not reach {len(targets)} of {poses} poses "
        f"in the configuration that the program says ({names}{more}). Its frames must be the "
        "controller's: give --root, the controller's root frame in the robot file's base frame, "
        f"and --flange, its flange in the last link's frame ({tried}). If the frames are right, "
        "the robot does not reach these poses either: --leave-unreached leaves them as they are"
    )


def _frames_that_reach(language: ProgramLanguage, targets: Sequence[Target], cell: Cell) -> list[str]:
    """Return options --flange or --root with which the nominal robot reaches all targets, as text.

    Their frames are those of the cell, rotated by quarter turns, the root about its z axis only.
    There are at most three, those of the smallest rotation first.
    """
    turns = [
        np.diag(signs)[list(order)] for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)
    ]
    quarters = sorted((R for R in turns if np.linalg.det(R) > 0), key=lambda R: -float(np.trace(R)))
    frames: list[str] = []
    for turn in (frame(R, np.zeros(3)) for R in quarters[1:]):
        if all(_reaches(language, t, cell.root, turn, cell.postures) for t in targets):
            frames.append(f"--flange {language.shown(cell.flange @ turn)}")
        if turn[2, 2] == 1:
            root = cell.root @ turn
            postures = replace(cell.postures, root=root)
            if all(_reaches(language, t, root, np.eye(4), postures) for t in targets):
                frames.append(f"--root {language.shown(root)}")
    return frames[:3]


def _reaches(language: ProgramLanguage, target: Target, root: Array, turned: Array, postures: Postures) -> bool:
    """Return whether the nominal robot reaches a target with these frames."""
    T = _flange(language, target, root, turned)
    if target.posture is None:
        near = np.zeros(postures.nominal.n) if target.near is None else target.near
        return postures.nearest(T[None], near[None])[0] is not None
    return _in_posture(language, target, T, postures).status == Status.OK.name


def _rewritten(
    language: ProgramLanguage, targets: Sequence[Target], cell: Cell, corrector: Corrector, old: Array, new: Array
) -> Iterator[CorrectedTarget]:
    """Yield corrected targets with new texts, and the tool's deviation with the numbers as written.

    Targets whose corrected joints leave their configuration or the limits, or whose written pose
    the nominal robot does not reach, remain unchanged.

    old, new : joints before and after the correction, each shape (k, n) [rad or m]
    """
    posed = np.array([not t.joints for t in targets], dtype=bool)
    wanted = _poses(corrector.nominal, new) if posed.any() else np.zeros((len(new), 4, 4))
    texts, q, flanges = [], new.copy(), []
    for k, t in enumerate(targets):
        base = cell.root @ t.base if posed[k] else None
        values = new[k] if base is None else language.values(np.linalg.inv(base) @ wanted[k], t.si)
        texts.append(tuple(n.written(v) for n, v in zip(t.numbers, values, strict=True)))
        q_or_pose = np.array([float(text) * n.unit for text, n in zip(texts[k], t.numbers, strict=True)])
        if base is None:
            q[k] = q_or_pose
        else:
            flanges.append(base @ language.matrix(q_or_pose))
    reached = np.ones(len(new), dtype=bool)
    if flanges:  # a controller, which has the nominal robot, solves the pose as it is written
        T = np.array(flanges)
        assert corrector.nominal is not None
        inverse = Newton(corrector.nominal).solved(
            T[:, :3, 3], T[:, :3, :3], new[posed], cell.postures.nominal.reading_limits
        )
        q[posed], reached[posed] = inverse.q, inverse.reached
    lower, upper = (-np.inf, np.inf) if cell.sources is None else cell.postures.nominal.reading_limits
    beyond = np.any((q < lower) | (q > upper), axis=1)
    off = _deviations(corrector, old, q)
    for k, t in enumerate(targets):
        if t.posture is not None and tuple(cell.postures.sides(new[k : k + 1])[0]) != t.posture:
            yield CorrectedTarget(t, "CONFIGURATION_CHANGES")
        elif beyond[k] or not reached[k]:
            yield CorrectedTarget(t, "LEAVES_BOX" if reached[k] else Status.NOT_CONVERGED.name)
        else:
            turned = language.turns_text(t, language.turns(new[k])) if t.turns is not None and t.turn_text else ()
            figures = {name: v[k].tolist() if v.ndim == 1 else tuple(v[k].tolist()) for name, v in off.items()}
            yield CorrectedTarget(t, Status.OK.name, "", (*texts[k], *turned), q=(old[k], q[k]), **figures)  # type: ignore[arg-type]


def _deviations(corrector: Corrector, old: Array, new: Array) -> dict[str, Array]:
    """Return figures of `CorrectedTarget` by name for joints before and after, (k,) or (k, 2).

    They are moved_mm and, with robot models, off_mm and off_deg.

    old, new : joints before and after, shape (k, n) [rad or m]
    """
    if corrector.real is None or corrector.nominal is None:
        return {"moved_mm": _distances_mm(corrector.position(old), corrector.position(new))}
    wanted, was, now = _poses(corrector.nominal, old), _poses(corrector.real, old), _poses(corrector.real, new)
    columns = {"moved_mm": _distances_mm(was[:, :3, 3], now[:, :3, 3])}
    columns["off_mm"] = np.stack([_distances_mm(T[:, :3, 3], wanted[:, :3, 3]) for T in (was, now)], axis=1)
    turned = [np.linalg.norm((T - wanted)[:, :3, :3], axis=(1, 2)) for T in (was, now)]
    columns["off_deg"] = np.rad2deg(2 * np.arcsin(np.minimum(1.0, np.stack(turned, axis=1) / np.sqrt(8))))
    return columns


def _poses(function: ca.Function | None, q: Array) -> Array:
    """Return the tool pose in the base frame at each row of joints, shape (k, 4, 4) [m].

    function : function q -> (p, R) of one pose, as of `pose_function`
    q : joints, shape (k, n) [rad or m]
    """
    assert function is not None
    p, R = function.map(len(q))(q.T)
    T = np.tile(np.eye(4), (len(q), 1, 1))
    T[:, :3, 3], T[:, :3, :3] = p.full().T, R.full().reshape(3, len(q), 3).transpose(1, 0, 2)
    return T


def _distances_mm(a: Array, b: Array) -> Array:
    """Return distances [mm] between points a and b, each shape (k, 3) [m]."""
    return np.asarray(1e3 * np.linalg.norm(a - b, axis=1))


def refuse_accuracy(source: str, targets: Iterable[Target]) -> None:
    """Check that no target was taught with the controller's absolute accuracy on.

    Raises InputError: one was.
    """
    for target in targets:
        if target.accurate:
            raise InputError(
                f"{source}: line {target.line}: {target.name} was taught with the controller's "
                "absolute accuracy on (bit 3 of S); with it on, errors are corrected twice: switch "
                "it off, and say so with --accuracy-off"
            )
