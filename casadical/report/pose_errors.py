"""What each model leaves at each pose: the numbers behind the figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from casadical.core.transforms import Array
from casadical.identification.accuracy import errors, predicted
from casadical.identification.identification import Identification
from casadical.measurements.measurements import Measurements
from casadical.project.networks import NetworkResult, Networks
from casadical.project.problem import Problem
from casadical.robot.robot import Robot

BEFORE = "before"
SETS = {
    "report": "Held-out poses",
    "identify": "Poses that identified",
    "train": "Poses networks learnt",
    "choose": "Poses that judged networks",
}


@dataclass(frozen=True, eq=False)
class Left:
    """What one model leaves.

    length : of each pose [m], shape (n,); vector : measured less computed [m], shape (n, 3), where positions are known
    note : what a reader must know of this model ("refused"); shown : whether it is drawn before it is asked for
    """

    model: str
    length: Array
    vector: Array | None = None
    note: str = ""
    shown: bool = True

    @property
    def words(self) -> str:
        """How a legend names it."""
        return f"{self.model}, {self.note}" if self.note else self.model


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """What every model leaves at the poses of one set.

    name : of the set; held_out : whether no model saw it; row : line of the source file, shape (n,)
    q : shape (n, joints) [rad or m]; position : measured, shape (n, 3) [m], or None; models : in order of reading
    """

    name: str
    held_out: bool
    row: Array
    q: Array
    position: Array | None
    models: tuple[Left, ...]

    def __len__(self) -> int:
        return len(self.row)

    @property
    def words(self) -> str:
        """How a title names the set."""
        name, _, kind = self.name.partition("/")
        return SETS.get(name, name) + (f" ({kind})" if kind else "")

    def thinned(self, most: int) -> PoseErrors:
        """At most so many of the poses, evenly spaced in their order."""
        if len(self) <= most:
            return self
        k = np.linspace(0, len(self) - 1, most).round().astype(int)
        models = tuple(
            Left(x.model, x.length[k], None if x.vector is None else x.vector[k], x.note, x.shown) for x in self.models
        )
        position = None if self.position is None else self.position[k]
        return PoseErrors(self.name, self.held_out, self.row[k], self.q[k], position, models)


def pose_errors(
    problem: Problem, results: Mapping[str, Identification], networks: Networks | None = None
) -> dict[str, PoseErrors]:
    """For every set of a problem, report first: what placement, each method and each network leave at its poses.

    Networks that were refused are there as they were trained, and say so.
    """
    found = {}
    for name in sorted(problem.sets, key=lambda n: ("report", "identify", "train", "choose").index(n)):
        for m in problem.sets[name]:
            label = name if len(problem.sets[name]) == 1 else f"{name}/{m.kind}"
            models = tuple(_models(m, results, networks))
            found[label] = PoseErrors(label, name == "report", m.row, m.q, m.position, models)
    return found


def left_by(robot: Robot, m: Measurements) -> tuple[Array, Array | None]:
    """Length [m] and, where positions were measured, vector [m] of what a robot leaves at every pose."""
    vector = None if m.position is None else m.position - predicted(robot, m)[0]
    return errors(robot, m), vector


def _models(m: Measurements, results: Mapping[str, Identification], networks: Networks | None) -> Iterator[Left]:
    last = list(results.values())[-1]
    yield Left(BEFORE, *left_by(last.placed, m), shown=False)
    for method, result in results.items():
        yield Left(method, *left_by(result.robot, m))
    for trained in networks.results.values() if networks else ():
        found = _with_network(m, results["SKCM"], trained)
        if found:
            yield found


def _with_network(m: Measurements, result: Identification, trained: NetworkResult) -> Left | None:
    network = trained.compensator.trained if trained.compensator else None
    vector = left_by(result.robot, m)[1]
    if network is None or vector is None:
        return None
    rest = vector - 1e-3 * network.output_mm(m.q)
    in_paper = trained.method in ("NN-SKCM", "IWO-NN-SKCM")
    note = "" if trained.helps else "refused"
    return Left(trained.method, np.linalg.norm(rest, axis=1), rest, note, trained.helps or in_paper)
