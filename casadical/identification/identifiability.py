"""Identifiability: which parameters the data determine, and which ones are confounded.

Columns of the scaled Jacobian are taken in order of preference and scaled to unit length. One that
is a linear combination of the columns before it is not identifiable; the columns that reproduce it
are named. Exact dependences come out at round-off (1e-10) and independent parameters far above, so
one tolerance serves where the columns are scaled (compare Khalil and Dombre 2002, ch. 5).
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.normal_equations import scaled_inverse
from casadical.core.parameters import Parameter

# Largest length of a Jacobian column, as a share of the longest one, at which the parameter has no
# effect on the measurements.
MAX_INVISIBLE_LENGTH_RATIO = 1e-9
# Condition number of the scaled Jacobian above which some parameters are nearly confounded.
CONFOUNDED_CONDITION_NUMBER = 1000
# The reason given for a parameter that has no effect on the measurements.
NO_EFFECT_REASON = "it has no effect on what was measured"


@dataclass(frozen=True)
class Identifiability:
    """Which parameters the data determine.

    independent : names of the identifiable parameters, in the order in which they were given
    unidentifiable : the reason of each other parameter, which stays at its nominal value, by name
    condition : condition number of the scaled Jacobian of these and the unknown points; 1 if none
    """

    independent: tuple[str, ...]
    unidentifiable: Mapping[str, str]
    condition: float


def analyse(
    J: Array, names: Sequence[str], always: int, fixed: dict[str, str], moved: str = "moves the measured points"
) -> Identifiability:
    """Return which parameters (columns of a Jacobian) are independent, and why others are not.

    J : shape (residuals, always + len(names)), in units of sigma per unit of scale
    always : number of first columns (unknown points), which are always variables
    names : parameters of the further columns, the preferred ones first
    fixed : name -> reason, of parameters that are fixed whatever the data
    moved : verb phrase for the effect of a parameter on the data, in the reasons
    """
    R: Array = np.asarray(np.linalg.qr(J, mode="r")) if len(J) > J.shape[1] else J
    length = np.linalg.norm(R, axis=0)
    unit = R / np.where(length > 0, length, 1.0)
    invisible = length <= MAX_INVISIBLE_LENGTH_RATIO * length.max(initial=0.0)
    first = np.linalg.qr(unit[:, :always])[0].T
    basis, size = np.zeros((len(first) + len(names), len(R))), len(first)
    basis[:size] = first
    independent_columns: list[int] = []
    reasons: dict[int, str] = {}
    for k, (name, column) in enumerate(zip(names, unit.T[always:], strict=True), always):
        if invisible[k]:
            reasons[k] = NO_EFFECT_REASON
            continue
        norm, residual = _projection_residual(basis[:size], column)
        if name in fixed:
            reasons[k] = fixed[name]
        elif norm <= 1e-6:
            reasons[k] = ""
        else:
            basis[size] = residual / norm
            size += 1
            independent_columns.append(k)
    columns = [*range(always), *independent_columns]
    shares, _, _, singular = np.linalg.lstsq(unit[:, columns], unit[:, list(reasons)], rcond=None)
    shares, independent = np.abs(shares[always:]), [names[j - always] for j in independent_columns]
    least = np.maximum(0.05 * shares.max(axis=0, initial=0.0), 1e-6)
    alike = [
        tuple(independent[j] for j in np.argsort(-share)[:6] if share[j] > low)
        for share, low in zip(shares.T, least, strict=True)
    ]
    dropped = {}
    for (k, why), those in zip(reasons.items(), alike, strict=True):
        name, reason = names[k - always], why
        if name in fixed:  # fixed whatever the data: the identified ones take up its effect
            if those and set(re.findall(r"\w+", why)).isdisjoint(those):
                reason += f"; {' and '.join(those)} {'carries' if len(those) == 1 else 'carry'} it"
        elif not why and those:
            reason = f"it {moved} exactly as {', '.join(those)} {'does' if len(those) == 1 else 'do together'}"
        elif not why:
            reason = "the unknown points absorb it"
        dropped[name] = reason
    condition = float(singular[0] / max(singular[-1], 1e-300)) if independent_columns else 1.0
    return Identifiability(tuple(independent), dropped, condition)


def _projection_residual(basis: Array, column: Array) -> tuple[float, Array]:
    """Return length and vector, shape (rows,), of a unit column's residual after projection.

    It is the part of the column orthogonal to the basis.

    basis : orthonormal, shape (size, rows); column : shape (rows,)
    """
    residual = column - (basis @ column) @ basis
    norm = math.sqrt(residual @ residual)
    # A residual below this has lost digits: it is orthogonalised a second time (Daniel et al.
    # 1976).
    if norm < 0.7:
        residual -= (basis @ residual) @ basis
        norm = math.sqrt(residual @ residual)
    return norm, residual


def drop_poor(
    parameters: Sequence[Parameter], H: Array, variance: float = 1.0
) -> tuple[list[int], dict[str, str], Array]:
    """Separate parameters that the data determine less accurately than their prior from the others.

    They are removed one by one, the worst first. Guesses stay, constrained by their priors. Bounds
    are ignored: a parameter may be at one just because the data do not determine it.

    parameters : of the first rows of H; further rows are unknown points, which stay
    H : information matrix of all, shape (size, size), the parameters in units of their scale
    variance : of a residual in units of sigma squared
    Returns the indices of the remaining parameters, the reasons of the others by name, and the
    covariance of the remaining ones in units of their scale, shape (p, p), points marginalised.
    """
    priors = np.array([np.inf if p.guess else p.prior / p.scale for p in parameters])
    remaining = list(range(len(H)))
    poor: dict[str, str] = {}
    while True:
        tested = [k for k in remaining if k < len(parameters)]
        covariance = variance * scaled_inverse(H[np.ix_(remaining, remaining)])[: len(tested), : len(tested)]
        errors = np.sqrt(np.diag(covariance))
        ratio = errors / priors[tested]
        if not tested or ratio.max() <= 1:
            return tested, poor, covariance
        worst = int(np.argmax(ratio))
        share = np.abs(covariance[worst] / (errors[worst] * errors))
        share[worst] = 0.0
        # Parameters whose estimates are more correlated than this are named together.
        names = [parameters[k].name for k in tested]
        partners = tuple(names[j] for j in np.argsort(-share)[:6] if share[j] > 0.9)
        p = parameters[tested[worst]]
        reason = (
            f"these poses determine it only to +/- {p.readable(errors[worst] * p.scale):.3g} {p.readable_unit}, worse "
            f"than its prior, {p.readable(p.prior):.3g} {p.readable_unit}"
        )
        if partners:
            verb = "does" if len(partners) == 1 else "do"
            reason += f"; it moves the measured points nearly as {', '.join(partners)} {verb}"
        poor[p.name] = reason
        remaining.remove(tested[worst])
