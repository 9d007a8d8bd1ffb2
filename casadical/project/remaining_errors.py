"""The errors left after a calibration: of every model at every pose."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.linear_problem import make_case
from casadical.diagnosis.localisation import Localisation, localise_residual
from casadical.identification.accuracy import errors, residual_mm
from casadical.identification.result import LeftOut
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements
from casadical.measurements.noise import Noise
from casadical.project.calibration import Calibration, used_poses
from casadical.robot.robot import Robot

BEFORE = "before"
# Of more poses than this, drawn at random, where the gap lies is told.
MOST_LOCATED = 5_000
SETS = {
    "report": "Held-out poses",
    "identify": "Poses that identified",
    "train": "Poses networks learnt",
    "choose": "Poses that judged networks",
}


@dataclass(frozen=True, eq=False)
class ModelErrors:
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
    """What every model leaves at the poses of one set, outliers left out.

    name : of the set; held_out : whether no model saw it; row : line of the source file, shape (n,)
    q : shape (n, joints) [rad or m]; position : measured, shape (n, 3) [m], or None; models : in order of reading
    source : the file; left_out : its poses that are in no figure of the set
    """

    name: str
    held_out: bool
    row: Array
    q: Array
    position: Array | None
    models: tuple[ModelErrors, ...]
    source: str = ""
    left_out: tuple[LeftOut, ...] = ()

    def __len__(self) -> int:
        return len(self.row)

    @property
    def words(self) -> str:
        """How a title names the set."""
        name, *more = self.name.split("/")
        return SETS.get(name, name) + (f" ({', '.join(more)})" if more else "")

    def thinned(self, most: int) -> PoseErrors:
        """At most so many of the poses, evenly spaced in their order."""
        if len(self) <= most:
            return self
        k = np.linspace(0, len(self) - 1, most).round().astype(int)
        models = tuple(
            replace(x, length=x.length[k], vector=None if x.vector is None else x.vector[k]) for x in self.models
        )
        position = None if self.position is None else self.position[k]
        return replace(self, row=self.row[k], q=self.q[k], position=position, models=models)


def pose_errors(calibration: Calibration) -> dict[str, PoseErrors]:
    """For every set of a problem, report first: what placement, each method and each network leave at its poses.

    Of the same poses as `Calibration.accuracies`. Refused networks are there as they were trained, and say so.
    """
    order = list(SETS)
    found = {}
    whole, used = dict(calibration.problem.parts()), used_poses(calibration.problem, calibration.identifications)
    for name in sorted(used, key=lambda name: order.index(name.split("/")[0])):
        m, every = used[name], whole[name]
        out = ~np.isin(every.row, m.row)
        rows = zip(every.row[out], errors(calibration.robot, every)[out], strict=True)
        left_out = tuple(LeftOut(every.source, int(row), float(e)) for row, e in rows)
        models = tuple(_models(m, calibration))
        found[name] = PoseErrors(name, name.startswith("report"), m.row, m.q, m.position, models, m.source, left_out)
    return found


def where_left(calibration: Calibration) -> Localisation | None:
    """Where the error that the last method left lies; None unless it is of one set of measured positions."""
    result = calibration.identification
    if len(result.measurements) != 1 or result.measurements[0].position is None:
        return None
    if len(m := result.measurements[0]) > MOST_LOCATED:
        # How a pose was approached, and when it was measured, follows from all of them.
        m, _ = derive(m, [*(f"approach{i}" for i in range(1, result.given.n + 1)), "progress"])
        some = (m[np.sort(np.random.default_rng(0).choice(len(m), MOST_LOCATED, replace=False))],)
        result = replace(result, measurements=some, outliers=(), problem=replace(result.problem, sets=some))
    return localise_residual(make_case(result, ()), Noise(result.sigmas[0][0], 0.0))


def _models(m: Measurements, calibration: Calibration) -> Iterator[ModelErrors]:
    yield _errors_of(BEFORE, calibration.identification.placed, m)
    for method, result in calibration.identifications.items():
        yield _errors_of(method, result.robot, m)
    paper = calibration.problem.paper
    published = {*paper.calibration, *paper.validation} if paper else set()
    for trained in calibration.networks.results.values() if calibration.networks else ():
        network = trained.compensator.trained if trained.compensator else None
        if network and m.position is not None:
            rest = 1e-3 * (residual_mm(calibration.identifications["SKCM"].robot, m) - network.output_mm(m.q))
            note = "" if trained.helps else "refused"
            length = np.linalg.norm(rest, axis=1)
            yield ModelErrors(trained.method, length, rest, note, trained.helps or trained.method in published)


def _errors_of(model: str, robot: Robot, m: Measurements) -> ModelErrors:
    vector = None if m.position is None else 1e-3 * residual_mm(robot, m)
    return ModelErrors(model, errors(robot, m), vector)
