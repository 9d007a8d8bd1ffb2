"""URDF texts for the tests, and Pinocchio as the oracle for them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

GRAVITY = 9.80665


def link(name, mass=0.0, com=(0, 0, 0), rpy=(0, 0, 0)):
    inertia = '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial><origin xyz="{_v(com)}" rpy="{_v(rpy)}"/><mass value="{mass!r}"/>{inertia}</inertial>'
    return f'  <link name="{name}">{inertial if mass else ""}</link>\n'


def joint(name, kind, parent, child, xyz=(0, 0, 0), rpy=(0, 0, 0), axis=(0, 0, 1), limit=(-3.0, 3.0), extra=""):
    text = f'  <joint name="{name}" type="{kind}">\n    <origin xyz="{_v(xyz)}" rpy="{_v(rpy)}"/>\n'
    text += f'    <parent link="{parent}"/>\n    <child link="{child}"/>\n'
    if kind != "fixed":
        text += f'    <axis xyz="{_v(axis)}"/>\n'
    if kind in ("revolute", "prismatic"):
        text += f'    <limit lower="{limit[0]!r}" upper="{limit[1]!r}" effort="10" velocity="1"/>\n'
    return text + f"    {extra}\n  </joint>\n"


def robot(*parts, name="arm"):
    return f'<?xml version="1.0"?>\n<!-- the file\'s own header -->\n<robot name="{name}">\n{"".join(parts)}</robot>\n'


def _v(values):
    return " ".join(repr(float(v)) for v in values)


UR10 = robot(
    link("base_link", 4.0),
    link("shoulder", 7.778),
    link("upper_arm", 12.93, (0, 0, 0.306)),
    link("forearm", 3.87, (0, 0, 0.28615)),
    link("wrist_1", 1.96),
    link("wrist_2", 1.96),
    link("wrist_3", 0.202, (0, 0.05, 0)),
    link("tool0"),
    joint("pan", "revolute", "base_link", "shoulder", (0, 0, 0.1273), limit=(-6.28, 6.28)),
    joint("lift", "revolute", "shoulder", "upper_arm", (0, 0.220941, 0), (0, np.pi / 2, 0), (0, 1, 0)),
    joint("elbow", "revolute", "upper_arm", "forearm", (0, -0.1719, 0.612), axis=(0, 1, 0)),
    joint("w1", "revolute", "forearm", "wrist_1", (0, 0, 0.5723), (0, np.pi / 2, 0), (0, 1, 0)),
    joint("w2", "revolute", "wrist_1", "wrist_2", (0, 0.1149, 0)),
    joint("w3", "revolute", "wrist_2", "wrist_3", (0, 0, 0.1157), axis=(0, 1, 0)),
    joint("flange", "fixed", "wrist_3", "tool0", (0, 0.0922, 0), (-np.pi / 2, 0, 0)),
    name="ur10",
)

RELATIONS = ("generic", "parallel", "antiparallel", "intersecting", "coincident", "nearly parallel", "square")


def random_arm(seed, n=6, tip=True):
    """A chain base..tip of n joints j1..jn whose neighbouring axes stand in all relations, with side branches."""
    rng = np.random.default_rng(seed)
    T_root = _frame(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    parts = [link("world"), link("base", 5.0), _between("foot", "world", "base", np.eye(4), T_root)]
    point, direction, above, T_above = np.zeros(3), _unit(rng.normal(size=3)), "base", np.eye(4)
    for i in range(1, n + 1):
        point, direction = _next_axis(rng, point, direction, rng.choice(RELATIONS))
        if rng.random() < 0.3:
            T = _frame(Rotation.random(rng=rng).as_matrix(), point + rng.normal(size=3))
            name = f"bracket{i}"
            parts += [link(name, 1.5, rng.normal(size=3)), _between(f"{name}_joint", above, name, T_above, T)]
            above, T_above = name, T
        T = _frame(Rotation.random(rng=rng).as_matrix(), point)
        kind = rng.choice(["revolute", "prismatic", "continuous"], p=[0.7, 0.2, 0.1])
        axis = T[:3, :3].T @ direction * rng.uniform(0.5, 2.0)
        parts += [link(f"l{i}", rng.uniform(1, 9), rng.normal(size=3) / 3, rng.normal(size=3))]
        parts += [_between(f"j{i}", above, f"l{i}", T_above, T, kind, axis)]
        above, T_above = f"l{i}", T
        if rng.random() < 0.4:
            kind = rng.choice(["fixed", "revolute"])
            side = _frame(Rotation.random(rng=rng).as_matrix(), point + rng.normal(size=3))
            parts += [link(f"side{i}", 2.0, rng.normal(size=3))]
            parts += [_between(f"side{i}_joint", above, f"side{i}", T_above, side, kind)]
    if tip:
        T = _frame(Rotation.random(rng=rng).as_matrix(), point + 0.3 * rng.normal(size=3))
        parts += [link("tip", 0.7, rng.normal(size=3) / 5), _between("tip_joint", above, "tip", T_above, T)]
    return robot(*parts)


def _next_axis(rng, point, direction, relation):
    """A point on the next axis and its direction, in the base link."""
    aside, other = 0.5 * rng.normal(size=3), _unit(rng.normal(size=3))
    along = direction * rng.normal()
    if relation == "parallel":
        return point + aside, direction
    if relation == "antiparallel":
        return point + aside, -direction
    if relation == "intersecting":
        return point + along, other
    if relation == "coincident":
        return point + along, direction * rng.choice([-1, 1])
    if relation == "nearly parallel":
        tilt = np.deg2rad(10 ** rng.uniform(-7, np.log10(5))) * _unit(np.cross(direction, other))
        return point + aside, Rotation.from_rotvec(tilt).apply(direction) * rng.choice([-1, 1])
    if relation == "square":
        return point + aside, _unit(np.cross(direction, other))
    return point + aside, other


def _between(name, parent, child, T_parent, T_child, kind="fixed", axis=(0, 0, 1)):
    """A joint whose child link stands at T_child when its parent stands at T_parent."""
    T = np.linalg.inv(T_parent) @ T_child
    return joint(name, kind, parent, child, T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_euler("xyz"), axis)


def _frame(R, p):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


def _unit(v):
    return v / np.linalg.norm(v)


@dataclass
class Oracle:
    """Pinocchio's forward kinematics and gravity torques between two links of a URDF file."""

    path: Path
    base: str
    tip: str

    def __post_init__(self):
        import pinocchio as pin

        self.pin = pin
        self.model = pin.buildModelFromUrdf(str(self.path))
        self.model.gravity.linear = np.array([0, 0, -GRAVITY])
        self.data = self.model.createData()
        tip, base = (self.model.frames[self.model.getFrameId(f)].parentJoint for f in (self.tip, self.base))
        carried = list(self.model.supports[base])
        self.joints = [self.model.joints[k] for k in self.model.supports[tip] if k not in carried]

    def configuration(self, q):
        full = self.pin.neutral(self.model)
        for value, j in zip(q, self.joints, strict=True):
            full[j.idx_q : j.idx_q + j.nq] = (np.cos(value), np.sin(value)) if j.nq == 2 else value
        return full

    def pose(self, q, tip=None):
        """T of the tip in the base link, shape (4, 4)."""
        self.pin.framesForwardKinematics(self.model, self.data, self.configuration(q))
        base, end = (self.data.oMf[self.model.getFrameId(f)] for f in (self.base, tip or self.tip))
        return (base.inverse() * end).homogeneous

    def gravity_torques(self, q):
        """Torques that gravity puts on the chain's joints, shape (n,): minus what holds the arm."""
        held = self.pin.computeGeneralizedGravity(self.model, self.data, self.configuration(q))
        return -np.array([held[j.idx_v] for j in self.joints])


def pose_of(arm, q):
    """casadical's pose as one transform, shape (4, 4)."""
    p, R = arm.pose(q, arm.parameters.values)
    return _frame(R.full(), p.full().ravel())


def readings(arm, rng, count):
    """Random readings within the arm's limits, shape (count, n)."""
    return rng.uniform([j.lower for j in arm.joints], [j.upper for j in arm.joints], (count, arm.n))
