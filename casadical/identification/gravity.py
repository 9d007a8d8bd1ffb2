"""Deflections of the joints under gravity from an identification, also with estimated masses.

With estimated masses the stiffness is not determined, but the product of compliance and torque is.
"""

from dataclasses import dataclass

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.normal_equations import scaled_inverse
from casadical.identification.result import Identification


@dataclass(frozen=True)
class Deflection:
    """The deflection of one joint under gravity.

    joint : number of the joint, from 1
    change : its range over the poses, largest minus smallest deflection [rad or m]
    error : standard error of the change [rad or m]
    """

    joint: int
    change: float
    error: float

    @property
    def sure(self) -> bool:
        """Whether the poses determine the deflection: it exceeds four positive standard errors."""
        # Below this the sentence gives a 95 % upper limit instead.
        return self.change > 4.0 * self.error > 0


def gravity_deflections(found: Identification) -> tuple[Deflection, ...]:
    """Return the deflection over the used poses of every joint whose compliance was identified.

    It is () if none was. Only the variation over the poses counts: a constant deflection is
    indistinguishable from a joint's zero. Its standard error follows to first order from the
    covariance of all identified parameters: masses and compliances change it together.
    Bounds are ignored, so that a joint that came out rigid has an error too.
    """
    robot, problem = found.robot, found.problem
    soft = [i for i in robot.numbers if f"c{i}" in problem.names]
    if not soft:
        return ()
    q = np.concatenate([m.q for m in found.used])
    w = np.concatenate([m.condition_matrix(robot.conditions, robot.declared) for m in found.used])
    best, place = robot.parameters.values, robot.parameters.index_of

    def courses(values: Array) -> Array:
        """Return each compliant joint's deflection minus its mean, (joints, poses) [rad or m].

        values : of all parameters [SI]
        """
        tau = robot.model.evaluate(("tau",), q, w, values)[0].reshape(robot.n, len(q))
        bent = np.array([values[place(f"c{i}")] * tau[i - 1] for i in soft])
        return np.asarray(bent - bent.mean(axis=1, keepdims=True))

    p = len(problem.names)
    C = found.variance * scaled_inverse(problem.gradient(found.solution.v)[1])[:p, :p]
    own, slopes = courses(best), np.zeros((p, len(soft), len(q)))
    for k, (name, step) in enumerate(zip(problem.names, problem.scale, strict=True)):
        ends = [best.copy(), best.copy()]
        for values, by in zip(ends, (step, -step), strict=True):
            values[place(name)] += by
        slopes[k] = (courses(ends[0]) - courses(ends[1])) / 2
    deflections = []
    for j, i in enumerate(soft):
        # A joint that came out rigid has no deflection: its shape is that of a compliant one.
        course = own[j] if own[j].any() else slopes[problem.names.index(f"c{i}"), j]
        along = slopes[:, j] @ course / max(course @ course, 1e-300)
        deflections.append(Deflection(i, float(np.ptp(own[j])), float(np.sqrt(along @ C @ along) * np.ptp(course))))
    return tuple(deflections)


def as_json(found: Identification) -> list[dict[str, float]]:
    """Return the gravity deflections that the poses determine, a dict per joint, for JSON.

    The keys are joint (from 1), deflection_mrad (range over the poses) and std_error_mrad.
    """
    return [
        {"joint": d.joint, "deflection_mrad": round(1e3 * d.change, 5), "std_error_mrad": round(1e3 * d.error, 5)}
        for d in gravity_deflections(found)
        if d.sure
    ]


def in_words(found: Identification) -> str:
    """Return a sentence on the joints' deflections under gravity if masses are estimates.

    It states their ranges over the poses with standard errors [mrad], or 95 % upper limits where
    none is certain. Empty for declared masses, or without identified compliance.
    """
    if found.robot.masses != "estimated" or not (every := gravity_deflections(found)):
        return ""
    why = "the masses are estimates from the reach, so that no stiffness follows"
    if not (deflections := [d for d in every if d.sure]):
        most = ", ".join(f"{1e3 * (d.change + 1.645 * d.error):.2g} at joint {d.joint}" for d in every)
        return f"deflection under gravity between poses: at most {most} mrad (95 %), none is certain; {why}"
    joints = ", ".join(str(d.joint) for d in deflections)
    sizes = ", ".join(f"{1e3 * d.change:.2g} +- {1e3 * d.error:.1g}" for d in deflections)
    several = "s" if len(deflections) > 1 else ""
    return f"deflection under gravity at joint{several} {joints}: between poses by up to {sizes} mrad; {why}"
