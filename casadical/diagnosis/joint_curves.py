"""Joint error curves of a diagnosis, each with its 95 % band and the evidence for it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.reporting.plain import WRITTEN, Key, written
from casadical.diagnosis.cross_validation import new_fit
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.result import Cause, Diagnosis
from casadical.diagnosis.structure import sines
from casadical.effects.joint_error_curve import JointErrorCurve
from casadical.measurements.measurements import Noise

# Titles of the columns of `curve_rows`.
CURVE_COLUMNS = ("joint", "rms [urad]", "share")


@dataclass(frozen=True, eq=False)
class JointCurve:
    """One joint's error as a function of its own angle, the joint variable.

    joint : number of the joint, 1-based; angle : angles over a turn, shape (k,) [rad]
    value, error : error of the joint there and its standard error, shapes (k,) [rad]
    covered : mask of the angles near which there are poses, shape (k,); elsewhere the prior alone
        determines the curve
    rms, rms_error : rms of the curve and of its standard error at the inlier poses [rad]
    lost : log evidence that is lost without the curve [nats]
    share : `lost`, if positive, divided by its sum over all joints, 0 to 1
    middle : frequencies between which the middle half of the curve's square lies [cycles per turn]
    """

    derived: ClassVar[tuple[Key, ...]] = (Key("covered", "covered_parts", "deg", 1),)

    joint: int = field(metadata=WRITTEN)
    angle: Array
    value: Array
    error: Array
    covered: Array
    rms: float = field(metadata=written("rms", "urad", 2))
    rms_error: float = field(metadata=written("rms_error", "urad", 2))
    lost: float = field(metadata=written("log_evidence_lost", digits=2))
    share: float = field(metadata=written(digits=4))
    middle: tuple[float, float] = field(metadata=written("middle_half_cycles"))

    @property
    def seen(self) -> bool:
        """Return whether the curve gains evidence and its rms is above two standard errors."""
        return self.lost > 0 and self.rms > 2 * self.rms_error

    @property
    def covered_parts(self) -> list[tuple[float, float]]:
        """Return (first, last) angle of each interval near which there are poses [rad]."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], self.covered, [False]])))
        return [(float(self.angle[a]), float(self.angle[b - 1])) for a, b in edges.reshape(-1, 2)]


def curve_rows(curves: Sequence[JointCurve]) -> list[tuple[str, str, str]]:
    """Return (joint, rms [urad], part of log evidence [%]) as texts, the largest part first.

    Of a curve that is not significant the text is "<" and its rms plus two standard errors.
    """
    rows = []
    for c in sorted(curves, key=lambda c: -c.share):
        rms, error = 1e6 * c.rms, 1e6 * c.rms_error
        size = f"{rms:.0f} +- {error:.0f}" if c.seen else f"< {rms + 2 * error:.0f}"
        rows.append((str(c.joint), size, f"{100 * c.share:.0f} %"))
    return rows


def joint_curves(found: Diagnosis) -> tuple[JointCurve, ...]:
    """Return the error curves of a diagnosis that names joint_error_curve.

    Raises InputError: where no joint_error_curve is among the causes.
    """
    effect = curve_of(found.causes)
    if effect is None:
        named = ", ".join(c.label for c in found.causes) or "none"
        raise InputError(f"no joint error curve was found; causes: {named}")
    return curves_of(found.case, effect, found.columns, found.noise)


def curve_of(causes: Sequence[Cause]) -> JointErrorCurve | None:
    """Return the joint error curve among the causes' effects, or None."""
    effects = (e for c in causes for e in c.effects)
    return next((e for e in effects if isinstance(e, JointErrorCurve)), None)


def curves_of(case: Case, effect: JointErrorCurve, columns: Array, noise: Noise) -> tuple[JointCurve, ...]:
    """Return the error curves of an effect in the model of a case.

    columns : indices of the columns of all causes, rising, shape (k,); noise : assumed by the fit
    """
    e, q = case.evidence, case.m.q[case.inliers]
    fit = new_fit(e, columns, noise, combined=False)
    place = e.J.shape[2] + np.searchsorted(columns, case.columns[effect])
    own = {j: place[part] for j, part in effect.parts.items()}
    units = {j: case.sizes(case.columns[effect][part]) for j, part in effect.parts.items()}
    square = float((fit.whitened_residual**2).sum() + (((fit.x - fit.mean) / fit.prior) ** 2).sum())
    # The log evidence that is lost without a joint's curve, with re-estimated noise.
    lost = {}
    for j, places in own.items():
        prior = fit.prior[places]
        scaled = fit.covariance[np.ix_(places, places)] / np.outer(prior, prior)
        x = fit.x[places] / prior
        more = float(x @ np.linalg.solve(scaled, x))
        noisier = len(fit.y) * float(np.log1p(more / square))
        lost[j] = 0.5 * (float(np.linalg.slogdet(scaled)[1]) + noisier)
    total = sum(max(v, 0.0) for v in lost.values()) or 1.0
    angle, orders = np.linspace(-np.pi, np.pi, 721), range(1, effect.orders + 1)
    joints = []
    for j, places in own.items():
        x, covariance = fit.x[places], fit.covariance[np.ix_(places, places)]
        value, error = _valued(sines(angle, orders) * units[j], x, covariance)
        there, band = _valued(sines(q[:, j - 1], orders) * units[j], x, covariance)
        square = ((x * units[j]) ** 2).reshape(-1, 2).sum(axis=1).cumsum()
        # Angles with a reading within half a period of the highest harmonic, modulo a turn.
        around = np.sort((q[:, j - 1] + np.pi) % (2 * np.pi)) - np.pi
        around = np.concatenate([[around[-1] - 2 * np.pi], around, [around[0] + 2 * np.pi]])
        after = np.searchsorted(around, angle).clip(1, len(around) - 1)
        nearest = np.minimum(angle - around[after - 1], around[after] - angle)
        low, high = (float(1 + np.searchsorted(square, part * square[-1])) for part in (0.25, 0.75))
        joints.append(
            JointCurve(
                joint=j,
                angle=angle,
                value=value,
                error=error,
                covered=nearest <= np.pi / effect.orders,
                rms=float(np.sqrt((there**2).mean())),
                rms_error=float(np.sqrt((band**2).mean())),
                lost=lost[j],
                share=max(lost[j], 0.0) / total,
                middle=(low, high),
            )
        )
    return tuple(joints)


def _valued(shapes: Array, x: Array, covariance: Array) -> tuple[Array, Array]:
    """Return the values of a curve at k angles and their standard errors, shapes (k,).

    shapes : functions at the angles, shape (k, parameters); x, covariance : their coefficients'
        estimate and covariance
    """
    return shapes @ x, np.sqrt(((shapes @ covariance) * shapes).sum(axis=1))
