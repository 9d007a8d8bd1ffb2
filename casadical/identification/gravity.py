"""How far gravity deflects the joints of an identified robot, also where masses, and so its stiffness, are unknown."""

from dataclasses import dataclass

import numpy as np

from casadical.core.arrays import Array
from casadical.identification.result import Identification

# A deflection is named from this many standard errors on.
SURE = 3.0
DRAWS = 64


@dataclass(frozen=True)
class Deflection:
    """Of one joint under gravity: its number, by how much it differs between poses, standard error [rad or m]."""

    joint: int
    change: float
    error: float


def gravity_deflections(found: Identification) -> tuple[Deflection, ...]:
    """Joints that gravity deflects, with certainty, at the poses of an identification.

    What counts is the deflection's course over the poses: a constant one is a joint's zero.
    """
    robot = found.robot
    soft = [i for i, j in enumerate(robot.joints, 1) if j.compliance]
    if not soft:
        return ()
    q = np.concatenate([m.q for m in found.used])
    w = np.concatenate([m.condition_matrix(robot.conditions, robot.declared) for m in found.used])
    places = [robot.parameters.index_of(f"c{i}") for i in soft]
    at = [robot.parameters.index_of(name) for name in found.names]

    def deflected(values: Array) -> Array:
        tau = robot.model.evaluate(("tau",), q, w, values)[0].reshape(robot.n, len(q))
        return np.asarray(values[places, None] * tau[[i - 1 for i in soft]])

    best = robot.parameters.values
    own, spread = deflected(best), np.nan_to_num(found.covariance)
    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(len(at)), spread, DRAWS, method="eigh")
    course = own - own.mean(axis=1, keepdims=True)
    size = np.linalg.norm(course, axis=1)
    along = []
    for step in drawn:
        values = best.copy()
        values[at] += step
        along.append(((deflected(values) - own) * course).sum(axis=1) / np.maximum(size, 1e-300))
    share = np.std(along, axis=0) / np.maximum(size, 1e-300)
    change = np.ptp(own, axis=1)
    named = [Deflection(i, float(g), float(g * s)) for i, g, s in zip(soft, change, share, strict=True)]
    return tuple(d for d in named if d.change > SURE * d.error > 0)


def as_json(found: Identification) -> list[dict[str, float]]:
    """The same as plain data, in mrad (mm of a sliding joint)."""
    return [
        {"joint": d.joint, "deflection_mrad": round(1e3 * d.change, 5), "std_error_mrad": round(1e3 * d.error, 5)}
        for d in gravity_deflections(found)
    ]


def in_words(found: Identification) -> str:
    """What is known of deflections where masses are not: empty for a robot with declared masses."""
    if found.robot.masses != "estimated":
        return ""
    why = "the masses are estimates from the reach, so that no stiffness follows"
    if not (deflections := gravity_deflections(found)):
        return f"no deflection under gravity that these poses show with certainty; {why}"
    joints = ", ".join(str(d.joint) for d in deflections)
    sizes = ", ".join(f"{1e3 * d.change:.2g} +- {1e3 * d.error:.1g}" for d in deflections)
    several = "s" if len(deflections) > 1 else ""
    return f"deflection under gravity at joint{several} {joints}: between poses by up to {sizes} mrad; {why}"
