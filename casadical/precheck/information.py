"""What an identification will be able to tell, from the Jacobian at the nominal robot alone: nothing is solved.

The accuracy to expect is that of noise in the data, carried through the identified parameters to poses all over the
joints' ranges (compare `pose_selection.forecast`). What the model leaves out comes on top.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..identifiability import Unidentifiable, correlated, poorly_determined
from ..least_squares import LeastSquares
from ..measurements import Measurements
from ..pose_selection import Noise, Workspace, observability
from ..pose_selection.candidates import draw_uniform, expected
from ..pose_selection.designs import inverse
from ..pose_selection.information import MM, scaled_jacobian
from ..robot import Robot
from ..transforms import Array

TASK_POSES = 200
ASSUMED = Noise()
ASSUMED_ANGLE = 1e-4


@dataclass(frozen=True, eq=False)
class Outlook:
    """What one method will be able to tell.

    names : parameters that will be identified; held : the others, each with its reason; numbers : observed ones
    unknowns : parameters that are independent, and coordinates of unknown points
    condition : of the scaled Jacobian; O1 : observability index, in units of noise (see `pose_selection.criteria`)
    errors : standard errors to expect of `names` [SI]; accuracy : rms position error to expect of noise [m]
    """

    method: str
    names: tuple[str, ...]
    held: tuple[Unidentifiable, ...]
    numbers: int
    unknowns: int
    condition: float
    O1: float
    errors: Array
    accuracy: float

    @property
    def enough(self) -> bool:
        """Whether more numbers were observed than there are unknowns."""
        return self.numbers > self.unknowns


def outlook(
    robot: Robot, sets: Sequence[Measurements], free: Sequence[str], noise: Noise, method: str, seed: int = 0
) -> Outlook:
    """What an identification of these parameters from these sets can be expected to tell.

    robot : with its base and tool placed; free : as of `identify`. Raises InputError.
    """
    sigmas = tuple((m.sigma or noise.sigma, m.sigma_angle or ASSUMED_ANGLE) for m in sets)
    names = robot.parameters.select(free)
    problem = LeastSquares(robot, tuple(sets), names, "linear", False, sigmas)
    found = problem.identifiability(np.zeros(problem.size))
    problem = problem.with_names(found.independent)
    kept, poor, C = _worth_it(problem)
    _, J = problem.evaluate(np.zeros(problem.size))
    columns = [problem.names.index(n) for n in kept]
    index = observability(J[:, columns], sum(len(m) for m in sets))["O1"] if kept else 0.0
    scale = np.array([robot.parameters[n].scale for n in kept])
    return Outlook(
        method, kept, (*found.held, *poor), problem.residual_count, problem.size, found.condition, index,
        errors=np.sqrt(np.diag(C)) * scale, accuracy=_accuracy(robot, kept, C, seed),
    )  # fmt: skip


def _worth_it(problem: LeastSquares) -> tuple[tuple[str, ...], tuple[Unidentifiable, ...], Array]:
    """Parameters that the data tell better than their priors, the others, and the covariance (units of scale)."""
    _, H = problem.gradient(np.zeros(problem.size))
    prior = np.array([problem.robot.parameters[n].prior for n in problem.names]) / problem.scale
    left = list(range(problem.size))
    poor: list[Unidentifiable] = []
    while True:
        named = [k for k in left if k < len(problem.names)]
        C = inverse(H[np.ix_(left, left)])[: len(named), : len(named)]
        names = [problem.names[k] for k in named]
        worst = poorly_determined(np.sqrt(np.diag(C)), prior[named])
        if worst is None:
            return tuple(names), tuple(poor), C
        reason = "these poses would tell less of it than is known before"
        poor.append(Unidentifiable(names[worst], reason, correlated(C, worst, names)))
        left.remove(named[worst])


def _accuracy(robot: Robot, names: tuple[str, ...], C: Array, seed: int) -> float:
    """Root mean square position error over the joints' ranges [m]; C : covariance, shape (p, p), units of scale."""
    q = draw_uniform(robot, TASK_POSES, Workspace(), np.random.default_rng(seed))
    J = scaled_jacobian(robot, names, expected(robot, q, {}, "task"))
    return MM * float(np.sqrt(np.einsum("kip,pq,kiq->", J, C, J) / len(J)))
