"""When to stop measuring: the expected accuracy against the number of poses, given the poses measured so far."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from casadical.core.basics import Array, InputError
from casadical.core.telling.blocks import mm
from casadical.core.telling.result import Shown
from casadical.identification.prior import Prior
from casadical.measurements.measurements import Measurements
from casadical.measurements.noise import Noise
from casadical.pose_selection.candidates import Circumstances
from casadical.pose_selection.design_problem import prepare
from casadical.pose_selection.experimental_design import inverse, search
from casadical.pose_selection.information import MM
from casadical.pose_selection.instruments import Instrument
from casadical.pose_selection.workspace import Workspace
from casadical.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Forecast(Shown):
    """Expected rms position error over the task [m], shape (k,), by numbers of poses, shape (k,), if the best come
    next.
    """

    poses: Array
    error: Array

    @property
    def _line(self) -> str:
        first, last = (f"{mm(self.error[k])} mm from {self.poses[k]}" for k in (0, -1))
        return f": {first} to {last} poses"

    def enough(self, target: float) -> int | None:
        """The least number of poses whose expected error is at most target [m]; None where none of these is."""
        good = np.flatnonzero(self.error <= target)
        return int(self.poses[good[0]]) if len(good) else None

    def stop(self, gain: float = 0.1, ahead: int = 10) -> int | None:
        """The number of poses from which on `ahead` more would reduce the error by less than the share `gain`."""
        shares = 1 - self.error[ahead:] / self.error[:-ahead]
        small = np.flatnonzero(shares < gain)
        return int(self.poses[small[0]]) if len(small) else None

    @property
    def table(self) -> pd.DataFrame:
        """Poses and expected error [mm]."""
        return pd.DataFrame({"poses": self.poses, "expected_error_mm": 1e3 * self.error})


def forecast(
    robot: Robot,
    most: int = 100,
    *,
    workspace: Workspace | None = None,
    circumstances: Circumstances | None = None,
    measured: Measurements | None = None,
    free: Iterable[str] | None = None,
    task: Array | None = None,
    noise: Noise | None = None,
    pool: int = 1000,
    seed: int = 0,
    instrument: Instrument | None = None,
    prior: Prior | None = None,
) -> Forecast:
    """The expected error as poses are added one by one, each the best next one by V-optimality.

    Starts with the measured poses or, without any, with a fifth more equations than parameters that no prior knows.

    most : largest number of poses, measured ones included
    workspace, circumstances, measured, free : as of `select_poses`
    task : shape (T, joints) [rad or m]: as of `select_poses`
    noise, pool : as of `select_poses`
    seed : of everything random
    instrument, prior : as of `select_poses`
    Raises InputError: nothing can be chosen.

    Examples
    --------
    >>> ahead = casadical.pose_selection.forecast(robot, 12, pool=100)
    >>> bool(ahead.error[-1] < ahead.error[0])
    True
    """
    before = 0 if measured is None else len(measured)
    if most <= before:
        raise InputError(f"{before} poses were measured already; most is {most} and must be greater")
    noise = noise or Noise()
    problem = prepare(
        robot, most - before, "V", candidates=None, workspace=workspace or Workspace(),
        circumstances=circumstances or Circumstances(), measured=measured, free=free, interest=(), task=task,
        noise=noise, pool=pool, rng=np.random.default_rng(seed), instrument=instrument,
        prior=prior,
    )  # fmt: skip
    design = problem.design(problem.pool, "V", 0.0)
    each, numbers = problem.pool.size, problem.numbers
    known = {*prior.means, *(name for names, _ in prior.known for name in names)} if prior else set()
    p = len(problem.weight) - sum(name in known for name in problem.names)
    # Measurements at one reading hold nearly the same information: only the first of them counts here.
    if numbers * before < 1.2 * p:
        first = min(-(-(int(1.2 * p) - numbers * before) // numbers), (most - before) // each)
        design.start(search(design, first, 1, seed).tolist())
    poses, error = [], []
    while True:
        poses.append(before + each * len(design.chosen))
        error.append(MM * float(np.sqrt(np.sum(problem.weight * inverse(design.M)))))
        k = design.best_to_add()
        if k is None or poses[-1] + each > most:
            return Forecast(np.array(poses), np.array(error))
        design.add(k)
