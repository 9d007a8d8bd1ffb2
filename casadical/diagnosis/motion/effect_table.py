"""What each effect costs: replays without it, one effect at a time, and torques model by model.

Both are of samples that were not fitted, for every arm and without a threshold: a response that was
identified is replayed again with one effect taken out, and a torque is predicted by the bodies of
the file, by fitted bodies, with friction, and with friction that grows with load.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.telling.blocks import Table
from casadical.diagnosis.motion.response import Response
from casadical.diagnosis.motion.signals import Arm, motion_of
from casadical.measurements.logs.log import JointLog

# Effects of a response, and the response without each of them.
WITHOUT: Mapping[str, Callable[[Response], Response]] = {
    "dry friction": lambda r: replace(r, friction=0 * r.friction),
    "gravity": lambda r: replace(r, gravity=False),
    "nine tenths of the damping": lambda r: replace(r, damping=r.damping / 10),
    "delay": lambda r: replace(r, delay=0 * r.delay),
    "inertia": lambda r: replace(r, inertia=0 * r.inertia),
    "surface": lambda r: replace(r, floor=None),
}
NAMED_SHARE = 0.8  # the sentence names effects and joints that make this share of all costs
# An effect whose absence raises the mean square error by less than this share costs nothing.
NEGLIGIBLE_RISE = 0.1
WITHHELD_THIRDS = 3  # parts of each run that are withheld in turn where torques are fitted
FRICTION_MEMORY_RAD = 3e-3  # half-width of the play operator of dry friction [rad]
# Prior standard deviation of a friction coefficient, as a share of the peak torque.
SIGMA_FRICTION = 0.3
# Share of the samples that count as independent, as noise is correlated.
INDEPENDENT_SAMPLE_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class EffectTable:
    """Root mean square errors of each joint with every effect, and without one of them at a time.

    before : of the error that is explained, shape (joints,) [rad or N m]; full : with every effect
    without : effect -> with all others, shape (joints,)
    """

    joints: tuple[str, ...]
    before: Array
    full: Array
    without: Mapping[str, Array]

    def costs(self) -> Mapping[str, Array]:
        """Return what each effect adds to the mean squares of the joints, shape (joints,)."""
        return {name: np.maximum(rms**2 - self.full**2, 0.0) for name, rms in self.without.items()}

    @property
    def sum_of_parts(self) -> Array:
        """Return the rms errors if the effects' costs simply added up, shape (joints,)."""
        return np.asarray(np.sqrt(self.full**2 + sum(self.costs().values())))

    @property
    def sentence(self) -> str:
        """Return which effects of which joints make most of the error, and which ones nothing."""
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
        """Return the table, in mrad."""
        rows = {
            "position = command": self.before,
            "sum of the parts": self.sum_of_parts,
            **{f"without {name}": rms for name, rms in self.without.items()},
            "with every effect": self.full,
        }
        return Table(
            "Replays with one effect taken out at a time, rms of each joint [mrad]",
            ("replay", *self.joints),
            [(name, *(f"{1e3 * v:.3g}" for v in rms)) for name, rms in rows.items()],
            frozenset(range(1, 1 + len(self.joints))),
        )


def effect_table(
    runs: Sequence[JointLog], predicted: Sequence[Array], responses: Sequence[Response], before: Array
) -> EffectTable:
    """Return the rms errors of replays with one effect taken out at a time.

    predicted : by the response of each run, shape (rows, joints) [rad]
    responses : that predict each run; before : rms of reading minus command, shape (joints,) [rad]
    """

    def rms(positions: Sequence[Array]) -> Array:
        error = np.concatenate([run.position - q for run, q in zip(runs, positions, strict=True)])
        return np.asarray(np.sqrt(np.nanmean(error**2, axis=0)))

    floors = any(r.floor is not None for r in responses)
    return EffectTable(runs[0].joints, before, rms(predicted), {
        name: rms([change(r).predicted(run) for run, r in zip(runs, responses, strict=True)])
        for name, change in WITHOUT.items() if floors or name != "surface"
    })  # fmt: skip


def torque_table(log: JointLog, arm: Arm) -> Mapping[str, Array] | None:
    """Return what each model leaves of a logged torque, rms by joint, shape (joints,) [N m].

    Each third of each run is predicted by a fit to the others. None where no torque was logged, nor
    a current of known torque constant.
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
        """Return a column for each joint: values in its own row, times a prior deviation."""
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
    """Return in one sentence which shares of the torque error the models of `torque_table` explain.

    They are shares of the mean squares, averaged over the joints.
    """
    squares = [rms**2 for rms in torques.values()]
    parts = [
        f"{name.removeprefix('and ')} {100 * float(((a - b) / (squares[0] + 1e-300)).mean()):.0f} %"
        for name, a, b in zip(list(torques)[1:], squares, squares[1:], strict=False)
    ]
    return f"Of the torque error beside the file's bodies, where it was not fitted: {', '.join(parts)}."
