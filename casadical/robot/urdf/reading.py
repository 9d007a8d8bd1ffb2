"""Reading a serial robot with its masses from a URDF, as from a robot file."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.parts import STANDARD_GRAVITY, Body, Coupling, Joint, Placement, possible_inertia
from casadical.robot.axes import rows_from_axes
from casadical.robot.robot import Robot
from casadical.robot.robot_schema import MAX_JOINTS, far_centre
from casadical.robot.urdf.tree import Tree, parse_urdf


@dataclass(frozen=True, eq=False)
class UrdfChain:
    """The moving joints between two links of a URDF, as in the file and in modified DH form.

    name : of the robot; base_link, tip_link : ends of the chain
    moving : the moving joints (yourdfpy's) from base to tip
    fixed_tip : the fixed joint before the tip, None if there is none
    frames : of the base link and all below it, at zero readings, in its frame, each (4, 4) [m]
    base, rows, link_frames, tool : the same chain in modified DH form (see `rows_from_axes`)
    bodies : body that each moving joint moves and the next does not, in the link's modified DH
        frame; None without mass
    up : the root link's z axis in the base link's frame, shape (3,)
    notes : assumptions that a user must know
    followed : coupling and leader of each moving joint, as of `Joint`
    """

    name: str
    base_link: str
    tip_link: str
    moving: tuple[Any, ...]
    fixed_tip: Any | None
    frames: dict[str, Array]
    base: Array
    rows: tuple[Joint, ...]
    link_frames: tuple[Array, ...]
    tool: Array
    bodies: tuple[Body | None, ...]
    up: Array
    notes: tuple[str, ...]
    followed: tuple[tuple[Coupling | None, tuple[str, str, float, float] | None], ...] = ()


def read_urdf(
    path: str | Path, base_link: str | None = None, tip_link: str | None = None, *, compliant: Collection[int] = ()
) -> Robot:
    """Read a robot from a URDF file.

    The measuring frame is nominally the base link (its true pose unknown), the tool is the tip link
    (its position unknown). Joints keep their zero, sign and range; a continuous one gets +-360 deg.
    Down is -z of the file's root link. Links on fixed joints, and side branches at zero reading,
    count as mass of the link that carries them; if a mass centre is implausible, no mass is read.

    base_link : first end of the chain; None: the root
    tip_link : last end of the chain; None: the only end that moves, or a gripper's link
    compliant : joints (1-based, counted from the base link) whose drives are compliant; a URDF has
        no compliance, so that its nominal value is zero
    Raises InputError: no parser installed, no file, malformed XML, no such link, a branching chain,
    no moving joint, a joint that floats, or has no axis or no range.

    Examples
    --------
    >>> from casadical.robot.urdf import new_urdf
    >>> size = Path("arm.urdf").write_text(new_urdf(found.robot))
    >>> casadical.read_urdf("arm.urdf", compliant=[1, 2]).parameters.names[-2:]
    ('c1', 'c2')
    """
    chain = read_chain(Path(path), base_link, tip_link)
    if unknown := set(compliant) - set(range(1, len(chain.moving) + 1)):
        raise InputError(f"{path}: compliant joint {min(unknown)} is not there; the chain has 1..{len(chain.moving)}")
    joints = []
    for i, (row, j, body) in enumerate(zip(chain.rows, chain.moving, chain.bodies, strict=True), 1):
        kind: Literal["revolute", "prismatic"] = "prismatic" if j.type == "prismatic" else "revolute"
        lower, upper = _range(j, str(path))
        coupling, leader = chain.followed[i - 1]
        soft = 0.0 if i in compliant else None
        more = {"compliance": soft, "body": body, "coupling": coupling, "name": j.name, "leader": leader}
        joints.append(replace(row, kind=kind, lower=lower, upper=upper, **more))
    robot = Robot(
        name=chain.name or Path(path).stem,
        joints=tuple(joints),
        base=Placement(chain.base, "pose"),
        tool=Placement(chain.tool, "position"),
        gravity=-STANDARD_GRAVITY * chain.base[:3, :3].T @ chain.up,
        gravity_frame="base",
        notes=chain.notes,
    )
    if not (far := far_centre(robot)):
        return robot
    # Without one of the masses the others give no torque.
    note = (
        f"masses left out: the mass centre of link {chain.moving[far[0] - 1].child!r}, or of one fixed to it, is "
        f"{far[1]}; those of a robot with compliant joints are estimated from its reach"
    )
    joints = [replace(j, body=None) for j in robot.joints]
    return replace(robot, joints=tuple(joints), notes=(*robot.notes, note))


def read_chain(path: Path, base_link: str | None, tip_link: str | None) -> UrdfChain:
    """Return the chain between two links of a URDF file.

    base_link, tip_link, and Raises InputError : as of `read_urdf`
    """
    urdf = parse_urdf(path)
    tree = Tree(urdf, str(path))
    base = tree.link(base_link, "base_link") if base_link else tree.root
    tip = tree.link(tip_link, "tip_link") if tip_link else tree.only_end(base)
    joints = tree.path(base, tip)
    moving = tuple(j for j in joints if j.type != "fixed")
    if not moving:
        raise InputError(f"{path}: no joint moves between {base!r} and {tip!r}; name other links")
    if len(moving) > MAX_JOINTS:
        raise InputError(
            f"{path}: {len(moving)} joints move between {base!r} and {tip!r}; allowed: up to "
            f"{MAX_JOINTS}; name other links"
        )
    own = {j.name for j in moving}
    for j in moving:
        _refuse_unusable(j, str(path))
    followed = _followed(moving, {j.name: j for j in urdf.joints}, str(path))
    frames, movers = tree.at_zero(base, own)
    directions = [frames[j.child][:3, :3] @ (j.axis / np.linalg.norm(j.axis)) for j in moving]
    points = [frames[j.child][:3, 3] for j in moving]
    frame_0, rows, link_frames, tool = rows_from_axes(points, directions, frames[tip])
    bodies = _bodies(urdf, tree, link_frames, frames, movers)
    notes = [f"from {path.name}: {base} to {tip}"]
    if aside := [j.name for j in urdf.joints if j.type != "fixed" and movers.get(j.child) and j.name not in own]:
        notes.append(f"masses on side branches stand as at zero reading of {', '.join(aside)}")
    for j, (coupling, leader) in zip(moving, followed, strict=True):
        if j.mimic is not None and leader is None and coupling is None:
            notes.append(f"{j.name} mimics {j.mimic.joint}, which is not between base and tip: it has its own reading")
        elif leader is not None:
            notes.append(
                f"{j.name} mimics {leader[0]}, which is not between base and tip: its reading is "
                f"{leader[2]:g} x that of {leader[0]}" + f" {leader[3]:+g}" * bool(leader[3])
            )
    if marked := [j.name for j in moving if j.calibration and (j.calibration.rising or j.calibration.falling)]:
        notes.append(
            f"<calibration> of {', '.join(marked)}, where a switch acts, moves no zero: it is kept and not used"
        )
    massive = [link for link in urdf.links if movers.get(link.name) and link.inertial and link.inertial.mass]
    if odd := [k.name for k in massive if np.any(k.inertial.inertia) and _inertia(k) is None]:
        notes.append(f"no body has the inertia of {', '.join(odd)}: it is taken as unknown")
    turning = [j for j in moving if j.type == "revolute" and j.limit]
    # A range of a revolute joint that ends between 25 and 720 rad is probably in degrees; larger
    # ones mean that there is no limit.
    if wide := [j.name for j in turning if 25.0 < max(map(abs, _range(j, str(path)))) <= 720.0]:
        notes.append(f"the range of {', '.join(wide)} looks like degrees, and is read as radians, as a URDF has them")
    if not any(bodies):
        notes.append("the URDF states no masses; those of a robot with compliant joints are estimated from its reach")
    return UrdfChain(
        name=urdf.name,
        base_link=base,
        tip_link=tip,
        moving=moving,
        fixed_tip=joints[-1] if joints[-1].type == "fixed" else None,
        frames=frames,
        base=frame_0,
        rows=rows,
        link_frames=link_frames,
        tool=tool,
        bodies=bodies,
        up=tree.frame_of(base)[2, :3],
        notes=tuple(notes),
        followed=followed,
    )


def _refuse_unusable(joint: Any, source: str) -> None:
    """Refuse a joint that is not revolute, continuous or prismatic, or has no axis."""
    name = f"{source}: joint {joint.name!r}"
    if joint.type not in ("revolute", "continuous", "prismatic"):
        raise InputError(f"{name} is of type {joint.type!r}; allowed: revolute, continuous, prismatic, fixed")
    if joint.axis.shape != (3,) or not 1e-9 < np.linalg.norm(joint.axis) < np.inf:
        raise InputError(f"{name} has the axis {joint.axis.tolist()}; it needs three finite numbers, not all zero")


def _followed(
    moving: Sequence[Any], joints: Mapping[str, Any], source: str
) -> tuple[tuple[Coupling | None, tuple[str, str, float, float] | None], ...]:
    """Return coupling and leader, as of `Joint`, of each moving joint of the chain.

    Both are None for a joint that mimics no joint of the file. Of several that mimic one outside of
    the chain, the first has that leader and the others follow the first. A factor of zero locks.

    moving, joints : joints (yourdfpy's) of the chain in order, and all of the file by name
    """
    names = [j.name for j in moving]
    first: dict[str, tuple[int, float, float]] = {}
    followed: list[tuple[Coupling | None, tuple[str, str, float, float] | None]] = []
    for i, joint in enumerate(moving, 1):
        leader, factor, plus, ring = joint, 1.0, 0.0, {joint.name}
        while leader.mimic is not None and leader.mimic.joint in joints:
            times, offset = leader.mimic.multiplier, float(leader.mimic.offset or 0.0)
            leader = joints[leader.mimic.joint]
            if leader.name in ring:
                raise InputError(f"{source}: joint {joint.name!r} mimics itself, by way of {', '.join(sorted(ring))}")
            ring.add(leader.name)
            factor, plus = factor * (1.0 if times is None else float(times)), plus + factor * offset
        if leader is joint:
            followed.append((None, None))
        elif leader.name in names or factor == 0.0:
            follows = ((names.index(leader.name) + 1, factor),) if factor else ()
            followed.append((Coupling(follows, plus), None))
        elif leader.name in first:
            k, other, at = first[leader.name]
            followed.append((Coupling(((k, factor / other),), plus - at * factor / other), None))
        else:
            first[leader.name] = (i, factor, plus)
            kind = "prismatic" if leader.type == "prismatic" else "revolute"
            followed.append((None, (leader.name, kind, factor, plus)))
    return tuple(followed)


def _range(joint: Any, source: str) -> tuple[float, float]:
    """Return lower and upper limit of a joint [rad or m]; -2 pi and 2 pi of a continuous one.

    A missing side is 0.
    """
    # Limit that a continuous joint gets to either side [rad].
    full_turn = 2 * np.pi
    if joint.type == "continuous":
        return -full_turn, full_turn
    lower, upper = (float(getattr(joint.limit, side, None) or 0.0) for side in ("lower", "upper"))
    if not -np.inf < lower < upper < np.inf:
        raise InputError(
            f"{source}: joint {joint.name!r} has the range [{lower:g}, {upper:g}]; give it a "
            "<limit> with lower < upper (rad or m), or make it continuous"
        )
    return lower, upper


def _bodies(
    urdf: Any, tree: Tree, links: Sequence[Array], frames: dict[str, Array], movers: dict[str, int]
) -> tuple[Body | None, ...]:
    """Return the body that each joint moves and the next does not, None where it has no mass.

    It is in the frame of the joint's link by its modified DH row.

    links : these frames, each (4, 4) [m], in the frame of `frames`
    """
    parts: list[list[Body]] = [[] for _ in range(len(links) + 1)]
    for link in urdf.links:
        mass = link.inertial.mass if link.inertial and link.name in frames else None
        if mass is None or mass == 0:
            continue
        if not 0 < mass < np.inf:
            raise InputError(f"{tree.source}: link {link.name!r} has the mass {mass:g} kg; it must be positive or zero")
        own = Body(float(mass), np.zeros(3), _inertia(link))
        parts[movers[link.name]].append(own.moved(frames[link.name] @ tree.origin(link.inertial)))
    of_link = zip(parts[1:], links, strict=True)
    return tuple(Body.joined(p).moved(np.linalg.inv(T)) if p else None for p, T in of_link)


def _inertia(link: Any) -> Array | None:
    """Return a link's inertia about its mass centre in the axes of its <inertial>, (3, 3) [kg m^2].

    None where the file states none, or one that no body has.
    """
    stated = link.inertial.inertia
    if stated is None or not np.any(stated) or not np.isfinite(stated).all() or not possible_inertia(stated):
        return None
    return np.asarray(stated, dtype=float)
