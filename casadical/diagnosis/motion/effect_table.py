"""Cost of each effect: replays without one effect at a time, and torque errors model by model.

Both are of samples that were not fitted, for every arm and without a threshold: a response that was
identified is replayed again with one effect removed, and a torque is predicted by the bodies of
the file, by fitted bodies, with friction, and with friction that grows with load.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.reporting.blocks import Table
from casadical.diagnosis.motion.response import Response
from casadical.diagnosis.motion.signals import Arm, motion_of
from casadical.measurements.logs.log import JointLog

# Function that removes an effect from a response, by the effect's name in tables.
WITHOUT: Mapping[str, Callable[[Response], Response]] = {
    "dry friction": lambda r: replace(r, friction=0 * r.friction),
    "gravity": lambda r: replace(r, gravity=False),
    "damping": lambda r: replace(r, damping=r.damping / 10),
    "delay": lambda r: replace(r, delay=0 * r.delay),
    "inertia": lambda r: replace(r, inertia=0 * r.inertia),
    "surface": lambda r: replace(r, floor=None),
    "stops": lambda r: replace(r, stops=()),
}
# The sentence names the effects and joints that together have this fraction of all costs.
NAMED_SHARE = 0.8
# An effect counts as having no cost if its removal raises the mean square error by less than this
# fraction of it.
NEGLIGIBLE_RISE = 0.1
WITHHELD_THIRDS = 3  # number of parts of each run that are held out in turn in fits of torques
FRICTION_MEMORY_RAD = 3e-3  # half-width of the play operator of dry friction [rad]
# Prior standard deviation of a friction coefficient, divided by the joint's peak torque.
SIGMA_FRICTION = 0.3
# Fraction of the samples that count as independent, as noise is correlated.
INDEPENDENT_SAMPLE_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class EffectTable:
    """Rms replay errors of each joint with all effects, and without one of them at a time.

    joints : names of the joints; before : rms of reading minus command, shape (joints,) [rad]
    full : rms of reading minus replay with all effects, shape (joints,) [rad]
    without : the same without one effect, by its name
    """

    joints: tuple[str, ...]
    before: Array
    full: Array
    without: Mapping[str, Array]

    def costs(self) -> Mapping[str, Array]:
        """Return, by effect, the increase of mean square error without it, (joints,) [rad^2].

        Decreases count as zero.
        """
        return {name: np.maximum(rms**2 - self.full**2, 0.0) for name, rms in self.without.items()}

    @property
    def sum_of_parts(self) -> Array:
        """Return the rms errors if the costs of all effects added up, shape (joints,) [rad]."""
        return np.asarray(np.sqrt(self.full**2 + sum(self.costs().values())))

    @property
    def sentence(self) -> str:
        """Return a sentence that names the effects and joints of most of the error.

        It also names the effects without influence.
        """
        costs, said, share = self.costs(), list[str](), 0.0
        total = sum(float(cost.sum()) for cost in costs.values())
        if not total > 0:
            return "No effect of the response lowers the error."
        for name in sorted(costs, key=lambda k: -float(costs[k].sum())):
            if share >= NAMED_SHARE:
                break
            order = np.argsort(-costs[name], kind="stable")
            reached = np.cumsum(costs[name][order]) / costs[name].sum()
            most = order[: 1 + int(np.searchsorted(reached, NAMED_SHARE))]
            said.append(f"{name} ({', '.join(self.joints[j] for j in sorted(most.tolist()))})")
            share += float(costs[name].sum()) / total
        free = [name for name, cost in costs.items() if cost.sum() < NEGLIGIBLE_RISE * (self.full**2).sum()]
        return f"{', '.join(said)} make {100 * share:.0f} % of what the effects explain" + (
            f"; {', '.join(free)}: nothing." if free else "."
        )

    def table(self) -> Table:
        """Return the table of the rms errors [mrad], one row for each replay."""
        rows = {
            "everything": self.before,
            **{name.split()[-1]: rms for name, rms in self.without.items()},
            "(in sum)": self.sum_of_parts,
            "nothing": self.full,
        }
        return Table(
            "Replays without one effect at a time, of damping without nine tenths, rms [mrad]",
            ("without", *(name.replace("_", " ") for name in self.joints)),  # wrapped at spaces
            [(name, *(f"{1e3 * v:.3g}" for v in rms)) for name, rms in rows.items()],
            frozenset(range(1, 1 + len(self.joints))),
        )


def effect_table(
    runs: Sequence[JointLog], predicted: Sequence[Array], responses: Sequence[Response], before: Array
) -> EffectTable:
    """Return the rms errors of replays with one effect removed at a time.

    predicted : positions of each run by its response, shape (rows, joints) [rad]
    responses : response that predicts each run
    before : rms of reading minus command, shape (joints,) [rad]
    """

    def rms(positions: Sequence[Array]) -> Array:
        error = np.concatenate([run.position - q for run, q in zip(runs, positions, strict=True)])
        return np.asarray(np.sqrt(np.nanmean(error**2, axis=0)))

    there = {"surface": any(r.floor is not None for r in responses), "stops": any(r.stops for r in responses)}
    return EffectTable(
        runs[0].joints,
        before,
        rms(predicted),
        {
            name: rms([change(r).predicted(run) for run, r in zip(runs, responses, strict=True)])
            for name, change in WITHOUT.items()
            if there.get(name, True)
        },
    )


def torque_table(log: JointLog, arm: Arm) -> Mapping[str, Array] | None:
    """Return the rms torque error of each joint by model, shape (joints,) [N m].

    Keys are the models' names, from the file's bodies to those with fitted friction. Each third of
    each run is predicted by a fit to the others. None where no torque was logged, nor a current
    with a declared torque constant.
    """
    if log.torque is None and (log.current is None or log.current_unsigned or arm.per_ampere is None):
        return None
    m = motion_of(log, arm, (FRICTION_MEMORY_RAD,))
    assert m.torque is not None
    n, Y = arm.joints, arm.regressor(m.q, m.v, m.a)
    residual, peak = m.torque - Y @ arm.inertial - arm.rotor * m.a, np.quantile(np.abs(m.torque), 0.99, axis=0) + 1e-9
    slip, load = m.memory[FRICTION_MEMORY_RAD], np.abs(Y @ arm.inertial) / peak
    fast, diagonal = np.quantile(np.abs(m.v), 0.99, axis=0) + 1e-9, np.eye(n)

    def own(values: Array, size: float = SIGMA_FRICTION) -> Array:
        """Return a column for each joint, shape (samples, joints, joints), nonzero in its own row.

        values : shape (samples, joints); size : prior standard deviation, divided by peak torque
        """
        return np.asarray((size * peak * values)[:, :, None] * diagonal)

    bodies = [Y @ arm.spread, (arm.rotor * m.a)[:, :, None] * diagonal, own(np.ones_like(m.q))]
    friction = [own(slip), own(m.v / fast), own(m.v * np.abs(m.v) / fast**2)]
    models = {
        "fitted bodies": bodies,
        "and friction": bodies + friction,
        "and friction that grows with load": [*bodies, *friction, own(slip * load)],
    }
    starts = {r: np.flatnonzero(m.run == r) for r in np.unique(m.run)}
    third = np.concatenate([(WITHHELD_THIRDS * np.arange(len(at))) // len(at) for at in starts.values()])
    out = {"the file's bodies": np.asarray(np.sqrt((residual**2).mean(axis=0)))}
    for name, columns in models.items():
        left = np.empty_like(residual)
        A = np.concatenate(columns, axis=2)
        weight = 1 / list(out.values())[-1]
        white, r = A * weight[:, None], residual * weight
        for k in range(WITHHELD_THIRDS):
            fit = third != k
            rows = white[fit].reshape(-1, A.shape[2])
            H = INDEPENDENT_SAMPLE_SHARE * rows.T @ rows + np.eye(A.shape[2])
            x = np.linalg.solve(H, INDEPENDENT_SAMPLE_SHARE * rows.T @ r[fit].ravel())
            left[~fit] = residual[~fit] - A[~fit] @ x
        out[name] = np.asarray(np.sqrt((left**2).mean(axis=0)))
    return out


def explained(torques: Mapping[str, Array]) -> str:
    """Return a sentence on the percentage of the torque error that each further model explains.

    Percentages are of mean squares and averaged over the joints. torques : as of `torque_table`
    """
    squares = [rms**2 for rms in torques.values()]
    parts = [
        f"{name.removeprefix('and ')} {100 * float(((a - b) / (squares[0] + 1e-300)).mean()):.0f} %"
        for name, a, b in zip(list(torques)[1:], squares, squares[1:], strict=False)
    ]
    return f"Of the torque error of the file's bodies, on rows that were not fitted: {', '.join(parts)}."
