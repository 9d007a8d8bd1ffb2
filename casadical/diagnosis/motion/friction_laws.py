"""Torque errors model by model, and the friction law of an arm: probability and held-out error.

The laws are the six of Better Actuator Models (Duclusaud et al. 2025), and friction proportional to
the torque alone. All are linear in their coefficients, each joint has coefficients of its own, and
masses have the priors of the robot file; friction takes power from the joint, so its coefficients
are at least zero, but for that of v |v|. The torque is the logged one, or the gain of an identified
servo times its position error. Each third of each run is predicted by a fit to the others, and the
rows are those in which the joint moves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy.special import erfcx, log_ndtr

from casadical.core.basics import Array
from casadical.core.reporting.blocks import Table
from casadical.core.statistics import first_of_best
from casadical.diagnosis.motion.effect_table import EffectTable
from casadical.diagnosis.motion.floor import CONTACT_MARGIN_M, INDEPENDENT_SAMPLE_FRACTION, Floor
from casadical.diagnosis.motion.signals import REGRESSOR_BLOCK_SAMPLES, SMOOTHING_WIDTH_S, Arm, motion_of, smoothed
from casadical.measurements.logs.log import JointLog

WITHHELD_THIRDS = 3  # number of parts of each run that are held out in turn
FRICTION_MEMORY_RAD = 1e-3  # half-width of the play operator of dry friction [rad]
# Tried Stribeck curves: speed, divided by the joint's 99 % speed, and exponent.
STRIBECK_CURVES = tuple(product((0.05, 0.15, 0.4), (1, 2)))
NAMED_PROBABILITY = 0.95  # laws that together have this probability are reported
# Columns of each joint: constant, rotor; dry, viscous and curved (v |v|) friction; and dry friction
# times the mean of motor torque and load, times the motor torque, and times the load. The last two,
# gravity and inertia of the fitted bodies, are no terms of a law, but of the effect table.
JOINT_COLUMNS = ("constant", "rotor", "dry", "viscous", "curved", "mean", "motor", "load", "gravity", "inertia")
# Columns of each joint and Stribeck curve, which vanish above its speed. Squared is the smaller of
# load and motor torque.
SLOW_COLUMNS = ("slow", "slow_mean", "slow_motor", "slow_load", "slow_load_squared", "slow_motor_squared")
# Columns of the models whose errors are reported for comparison with those of the laws.
MODELS: Mapping[str, str] = {
    "fitted bodies": "constant rotor",
    "and friction": "constant rotor dry viscous curved",
    "and friction that grows with load": "constant rotor dry viscous curved mean",
}
# Columns of each effect of the effect table.
EFFECT_COLUMNS: Mapping[str, str] = {
    "dry friction": "dry",
    "viscous friction": "viscous curved",
    "load friction": "mean",
    "gravity": "gravity",
    "inertia": "inertia rotor",
    "constant torque": "constant",
}
# Columns of each law.
LAWS: Mapping[str, str] = {
    "M1 Coulomb": "constant rotor dry viscous curved",
    "M2 Stribeck": "constant rotor dry viscous curved slow",
    "M3 load": "constant rotor dry viscous curved mean",
    "M4 Stribeck, load": "constant rotor dry viscous curved mean slow slow_mean",
    "M5 directional": "constant rotor dry viscous curved motor load slow slow_motor slow_load",
    "M6 quadratic": "constant rotor dry viscous curved motor load slow slow_motor slow_load "
    "slow_load_squared slow_motor_squared",
    "loss ~ torque": "constant rotor viscous curved motor",
}


@dataclass(frozen=True, eq=False)
class FrictionLaws:
    """Rms torque errors of held-out rows by model and by friction law, and the laws' probabilities.

    joints : names of the joints
    models : errors by model, from the file's bodies to those with friction, (joints,) each [N m]
    laws : errors by law, shape (joints,) each [N m]; probability : by law, given that one is true
    misfit : by law, sum of squared errors of held-out rows, divided by the variances of noise
    effects : the errors of held-out rows, of the model with all effects and without one at a time
    """

    joints: tuple[str, ...]
    models: Mapping[str, Array]
    laws: Mapping[str, Array]
    probability: Mapping[str, float]
    misfit: Mapping[str, float]
    effects: EffectTable

    @property
    def plain(self) -> dict[str, dict[str, Any]]:
        """Return errors by model and without each effect, and error and probability by law, for JSON."""
        laws = {law: {"probability": self.probability[law], "rms_Nm": rms.tolist()} for law, rms in self.laws.items()}
        errors = {"models": self.models, "effects": self.effects.without}
        return {"laws": laws, **{key: {k: rms.tolist() for k, rms in each.items()} for key, each in errors.items()}}

    @property
    def likely(self) -> list[str]:
        """Return the most probable laws, as many as reach `NAMED_PROBABILITY` together."""
        order = sorted(self.probability, key=lambda law: -self.probability[law])
        sums = np.cumsum([self.probability[law] for law in order])
        return order[: 1 + int(np.searchsorted(sums, NAMED_PROBABILITY))]

    @property
    def better(self) -> list[str]:
        """Return further laws that predict held-out rows better than any of `likely`.

        Where none of the laws is true, probabilities are too certain.
        """
        # A law predicts held-out rows better if its misfit is lower by 2 %.
        limit = min(self.misfit[law] for law in self.likely) * 0.98
        return [law for law in self.probability if law not in self.likely and self.misfit[law] < limit]

    @property
    def sentence(self) -> str:
        """Return a sentence on the friction law, or on those between which the log does not decide."""
        likely = ", ".join(f"{law} {100 * self.probability[law]:.0f} %" for law in self.likely)
        doubt = f", yet held-out rows are fitted better by {' and '.join(self.better)}" if self.better else ""
        return f"Friction law: {'undecided, ' if len(self.likely) > 1 else ''}{likely}{doubt}."

    @property
    def explained(self) -> str:
        """Return a sentence on the percentage of the torque error that each model leaves.

        Percentages are of rms errors and averaged over the joints.
        """
        first, *others = self.models.values()
        parts = [
            f"{name} {100 * float((rms / (first + 1e-300)).mean()):.0f} %"
            for name, rms in zip(list(self.models)[1:], others, strict=True)
        ]
        return f"Of the torque error of the file's bodies remain, on rows that were not fitted: {', '.join(parts)}."

    def tables(self) -> list[Table]:
        """Return the tables of the rms torque errors, by model and by friction law."""
        errors = "rms of each joint [N m], each third of a run by a fit to the others"
        models = [(name, *(f"{v:.3g}" for v in rms)) for name, rms in self.models.items()]
        laws = [(law, f"{self.probability[law]:.2f}", *(f"{v:.3g}" for v in rms)) for law, rms in self.laws.items()]
        n, names = len(self.joints), [name.replace("_", " ") for name in self.joints]  # wrapped at spaces
        return [
            self.effects.table(),
            Table(f"Torque that each model leaves, {errors}", ("model", *names), models, frozenset(range(1, 1 + n))),
            Table(f"Friction laws, {errors}", ("law", "prob.", *names), laws, frozenset(range(1, 2 + n))),
        ]


def friction_laws(log: JointLog, arm: Arm, floor: Floor | None = None) -> FrictionLaws | None:
    """Return torque errors by model and by friction law, with the laws' probabilities.

    arm : with the gains and delays of its servos, if the torque follows from position errors
    floor : surface; rows in contact with it are excluded
    None if there is neither torque, nor current with a torque constant, nor commands with gains.
    """
    m = motion_of(log, arm, (FRICTION_MEMORY_RAD,))
    torque = m.torque if log.torque is not None or arm.per_ampere is not None else None
    if torque is None and m.command is not None and arm.kp is not None:
        torque = arm.kp * (m.command - m.position)
    if torque is None:
        return None
    n, peak = arm.joints, np.quantile(np.abs(torque), 0.99, axis=0) + 1e-9
    fast, slip = np.quantile(np.abs(m.v), 0.99, axis=0) + 1e-9, m.memory[FRICTION_MEMORY_RAD]
    # Rows near a reversal, where the friction of the smoothed signals has not reached its full size,
    # would be mistaken for friction that falls with speed.
    slides, kernel = (m.rest == 0) & (np.abs(slip) > 0.99), np.ones(2 * round(SMOOTHING_WIDTH_S / m.step / 2) + 1)
    moves = m.by_run(lambda part: smoothed(1.0 * part, kernel / len(kernel)) > 0.999, slides)
    moves |= moves.mean(axis=0) < 0.05  # of a joint that hardly moves all rows count
    if floor:
        moves &= (floor.above(m.position) > CONTACT_MARGIN_M)[:, None]
    starts = {r: np.flatnonzero(m.run == r) for r in np.unique(m.run)}
    third = np.concatenate([(WITHHELD_THIRDS * np.arange(len(at))) // len(at) for at in starts.values()])
    # Prior standard deviation of a coefficient, divided by the joint's peak torque.
    own, scale = len(JOINT_COLUMNS) + len(SLOW_COLUMNS) * len(STRIBECK_CURVES), 0.3 * peak
    # Of longer logs every k-th row is used.
    rows = slice(None, None, 1 + len(m.q) // 20_000)
    every = (m.v, m.a / (np.abs(m.a).max(axis=0) + 1e-9), slip, moves, third, torque, torque - arm.rotor * m.a)
    v, a, slip, moves, third, logged, torque = (values[rows] for values in every)
    Y, rest = arm.regressor(m.q[rows], v, m.a[rows]), np.zeros_like(v)
    static = arm.regressor(m.q[rows], rest, rest)

    def sums_of(friction: Array, masses: Array) -> tuple[Array, Array]:
        """Return sums of products of all columns in each third, (thirds, joints, n, n), and counts.

        friction : coefficients by which friction adds to the motor torque, of dry, viscous and
            curved friction and of that which grows with load, (joints, 4)
        masses : fitted parameters of the bodies [SI]
        """
        sums, counts = np.zeros(0), np.zeros((WITHHELD_THIRDS, n))
        for k in range(0, len(v), REGRESSOR_BLOCK_SAMPLES):
            s = slice(k, k + REGRESSOR_BLOCK_SAMPLES)
            speed, dry, bodies = v[s] / fast, slip[s], Y[s] @ arm.inertial
            plain = [np.ones_like(dry), a[s], dry, speed, speed * np.abs(speed)]
            load = np.abs(bodies)
            terms = zip(friction.T, [*plain[2:], dry * load / peak], strict=False)
            made = bodies + scale * sum((x * column for x, column in terms), np.zeros_like(dry))
            motor, load = np.abs(made) / peak, load / peak
            gravity = static[s] @ masses
            moved = Y[s] @ masses - gravity + arm.rotor * m.a[rows][s]
            columns = [*plain, dry * (motor + load) / 2, dry * motor, dry * load, gravity / scale, moved / scale]
            for share, exponent in STRIBECK_CURVES:
                slow = dry * np.exp(-(np.abs(speed / share) ** exponent))
                squares = slow * load**2 * (motor > load), slow * motor**2 * (motor <= load)
                columns += [slow, slow * (motor + load) / 2, slow * motor, slow * load, *squares]
            residual = (torque[s] - bodies)[:, :, None]
            A = np.concatenate([Y[s] @ arm.spread, np.moveaxis(scale * np.stack(columns), 0, 2), residual], axis=2)
            A = (A * moves[s][:, :, None]).transpose(1, 0, 2)
            if not sums.size:
                sums = np.zeros((WITHHELD_THIRDS, n, A.shape[2], A.shape[2]))
            for part in range(WITHHELD_THIRDS):
                there = A[:, third[s] == part]
                sums[part] += there.transpose(0, 2, 1) @ there
                counts[part] += moves[s][third[s] == part].sum(axis=0)
        return sums, counts

    sums, counts = sums_of(np.zeros((n, 0)), arm.inertial)
    total = np.maximum(counts.sum(axis=0), 1)
    alone = np.sqrt(sums[:, :, -1, -1].sum(axis=0) / total)

    def held_out(columns: Sequence[int], sigma: Array, without: Sequence[int] = ()) -> Array:
        """Return the rms errors of held-out thirds with some columns, shape (joints,) [N m].

        without : columns whose torques are left out of the prediction, though they were fitted
        """
        square = np.zeros(n)
        for part in range(WITHHELD_THIRDS):
            x, _ = _solved(sums.sum(axis=0) - sums[part], own, columns, sigma)
            for k in without:
                x[:, k - 1 - own] = -(k >= JOINT_COLUMNS.index("gravity"))
            square += np.einsum("ja,jab,jb->j", x, sums[part], x)
        return np.asarray(np.sqrt(np.maximum(square, 0) / total))

    def at(text: str) -> list[list[int]]:
        """Return the columns that a text names, one list for each Stribeck curve if it has any."""
        words = text.split()
        fixed, slow = ([names.index(w) for w in words if w in names] for names in (JOINT_COLUMNS, SLOW_COLUMNS))
        starts = len(JOINT_COLUMNS) + len(SLOW_COLUMNS) * np.arange(len(STRIBECK_CURVES) if slow else 1)
        return [fixed + [int(start) + c for c in slow] for start in starts]

    sigma = alone + 1e-9 * peak
    for _ in range(2):
        (columns,) = at(LAWS["M3 load"])
        x, _ = _solved(sums.sum(axis=0), own, columns, sigma)
        sums, _ = sums_of(x[:, -1 - own :][:, columns[2:]], arm.inertial + arm.spread @ x[0, : -1 - own])
        sigma = np.min([held_out(columns, sigma) for columns in at(LAWS["M6 quadratic"])], axis=0) + 1e-9 * peak
    models = {"the file's bodies": alone}
    for name, text in MODELS.items():
        models[name] = held_out(at(text)[0], list(models.values())[-1])
    evidence, laws = {}, {}
    for law, text in LAWS.items():
        each = [_solved(sums.sum(axis=0), own, columns, sigma)[1] for columns in at(text)]
        evidence[law] = float(np.logaddexp.reduce(each) - np.log(len(each)))
        laws[law] = held_out(at(text)[first_of_best(each, logs=True)], sigma)
    total_evidence = float(np.logaddexp.reduce(list(evidence.values())))
    probability = {law: float(np.exp(e - total_evidence)) for law, e in evidence.items()}
    misfit = {law: float((counts.sum(axis=0) * (rms / sigma) ** 2).sum()) for law, rms in laws.items()}
    costs = {name: held_out(columns, sigma, at(text)[0]) for name, text in EFFECT_COLUMNS.items()}
    full, before = held_out(columns, sigma), np.sqrt(((logged * moves) ** 2).sum(axis=0) / total)
    effects = EffectTable(log.joints[:n], before, full, costs, "Torque of held-out thirds", "N m", 1.0)
    return FrictionLaws(log.joints[:n], models, laws, probability, misfit, effects)


def _solved(sums: Array, own: int, columns: Sequence[int], sigma: Array) -> tuple[Array, float]:
    """Return the coefficients of all columns and -1 for the torque, and the log evidence [nats].

    The coefficients have the shape (joints, n_bodies + own + 1), zero in columns that are not used;
    evidence is relative to that of the file's bodies, in Laplace's approximation, by the bounded
    parts of the coefficients' normal priors.
    sums : products of bodies' columns, joint's columns and torque, (joints, n, n), n as above
    own : number of columns of each joint; columns : the used ones; sigma : noise, (joints,) [N m]
    """
    n, bodies, m = len(sums), sums.shape[1] - own - 1, len(columns)
    H, right = np.eye(bodies + n * m), np.zeros(bodies + n * m)
    local = np.concatenate([np.arange(bodies), bodies + np.asarray(columns)])
    places = [np.concatenate([np.arange(bodies), bodies + j * m + np.arange(m)]) for j in range(n)]
    for place, products, noise in zip(places, sums, sigma, strict=True):
        share = INDEPENDENT_SAMPLE_FRACTION / noise**2
        H[np.ix_(place, place)] += share * products[np.ix_(local, local)]
        right[place] += share * products[local, -1]
    names = [*JOINT_COLUMNS, *SLOW_COLUMNS * len(STRIBECK_CURVES)]
    either_sign = ("constant", "rotor", "curved", "gravity", "inertia")
    bounded = np.array([False] * bodies + [names[k] not in either_sign for k in columns] * n)
    free, solution = np.ones(len(right), dtype=bool), np.zeros(len(right))
    fewest, tries = len(right) + 1, 0
    for _ in range(10 * len(right)):  # block principal pivoting (Portugal, Judice, Vicente 1994)
        solution[:] = 0.0
        solution[free] = np.linalg.solve(H[np.ix_(free, free)], right[free])
        slope = (H @ solution - right) / (1 + np.abs(right))
        wrong = np.flatnonzero(bounded & np.where(free, solution < 0, slope < -1e-9))
        if not len(wrong):
            break
        fewest, tries = (len(wrong), 3) if len(wrong) < fewest else (fewest, tries - 1)
        free[wrong if tries > 0 else wrong[-1:]] ^= True
    covariance, push = np.linalg.inv(H[np.ix_(free, free)]), (H @ solution - right)[~free]
    coupled = H[np.ix_(~free, free)]
    curvature = np.diag(H)[~free] - np.einsum("ik,kl,il->i", coupled, covariance, coupled)
    evidence = 0.5 * float(right @ solution + np.linalg.slogdet(covariance)[1])
    # Twice the normal integral over positive values: of free coefficients, and of those at zero.
    inside = (solution[free] / np.sqrt(np.diag(covariance)))[bounded[free]]
    evidence += float((np.log(2) + log_ndtr(inside)).sum())
    at_zero = np.log(erfcx(push / np.sqrt(2 * curvature))) - 0.5 * np.log(curvature)
    evidence += float(at_zero.sum())
    out = np.zeros((n, sums.shape[1]))
    for x, place in zip(out, places, strict=True):
        x[local] = solution[place]
    out[:, -1] = -1.0
    return out, evidence
