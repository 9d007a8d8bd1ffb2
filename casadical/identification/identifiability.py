"""Which parameters the data determine: independent columns of the scaled Jacobian, and which are confounded.

Columns are taken in order of preference and scaled to unit length. One that the columns before it reproduce is not
identifiable; the columns that reproduce it are named. Exact dependences come out at round-off (1e-10) and true
parameters far above, so one tolerance serves where the columns are scaled (compare Khalil and Dombre 2002, ch. 5).
"""

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.normal_equations import inverse_of_triangle
from casadical.core.parameters import Parameter

DEPENDENT = 1e-6
INVISIBLE = 1e-9
# Condition number from which on some parameters are nearly confounded.
CONFOUNDED = 1000
NO_EFFECT = "it has no effect on what was measured"


@dataclass(frozen=True)
class Unidentifiable:
    """A parameter that stays at its nominal value, why, and which parameters move the measurement as it does.

    reason : in words
    """

    name: str
    reason: str
    confounded_with: tuple[str, ...] = ()


@dataclass(frozen=True)
class Identifiability:
    """Which parameters the data determine.

    independent : names, in model order
    held : the others, each with its reason
    condition : condition number of the scaled Jacobian of the independent ones
    """

    independent: tuple[str, ...]
    held: tuple[Unidentifiable, ...]
    condition: float


def analyse(
    J: Array, names: Sequence[str], always: int, held: dict[str, str], moved: str = "moves the measured points"
) -> Identifiability:
    """Split the columns of a Jacobian into independent and dependent ones.

    J : shape (residuals, always + len(names)), in units of sigma per unit of scale; the first `always` columns
        (unknown points) are kept whatever the others are
    names : of the further columns, the preferred ones first
    held : name -> reason, for those that are not to be identified whatever the data
    moved : what a parameter does to the data, in words
    """
    R: Array = np.asarray(np.linalg.qr(J, mode="r")) if len(J) > J.shape[1] else J
    length = np.linalg.norm(R, axis=0)
    unit = R / np.where(length > 0, length, 1.0)
    invisible = length <= INVISIBLE * length.max(initial=0.0)
    first = np.linalg.qr(unit[:, :always])[0].T
    basis, size = np.zeros((len(first) + len(names), len(R))), len(first)
    basis[:size] = first
    kept: list[int] = []
    reasons: dict[int, str] = {}
    for k, (name, column) in enumerate(zip(names, unit.T[always:], strict=True), always):
        if invisible[k]:
            reasons[k] = NO_EFFECT
            continue
        left, rest = _without(basis[:size], column)
        if name in held:
            reasons[k] = held[name]
        elif left <= DEPENDENT:
            reasons[k] = ""
        else:
            basis[size] = rest / left
            size += 1
            kept.append(k)
    columns = [*range(always), *kept]
    shares, _, _, singular = np.linalg.lstsq(unit[:, columns], unit[:, list(reasons)], rcond=None)
    shares, independent = np.abs(shares[always:]), [names[j - always] for j in kept]
    least = np.maximum(0.05 * shares.max(axis=0, initial=0.0), 1e-6)
    alike = [_strongest(share, independent, low) for share, low in zip(shares.T, least, strict=True)]
    dropped = []
    for (k, why), those in zip(reasons.items(), alike, strict=True):
        name, reason = names[k - always], why
        if name in held:  # whatever the data: the identified ones carry its share
            if those and set(re.findall(r"\w+", why)).isdisjoint(those):
                reason += f"; {' and '.join(those)} {'carries' if len(those) == 1 else 'carry'} it"
        elif not why and those:
            reason = f"it {moved} exactly as {', '.join(those)} {'does' if len(those) == 1 else 'do together'}"
        elif not why:
            reason = "the unknown points absorb it"
        dropped.append(Unidentifiable(name, reason, those if name in held or not why else ()))
    condition = float(singular[0] / max(singular[-1], 1e-300)) if kept else 1.0
    return Identifiability(tuple(independent), tuple(dropped), condition)


def _without(basis: Array, column: Array) -> tuple[float, Array]:
    """Length and rest of a column of unit length less its part in an orthonormal basis, shape (size, rows)."""
    rest = column - (basis @ column) @ basis
    left = math.sqrt(rest @ rest)
    # A rest below this has lost digits: it is made orthogonal a second time (Daniel et al. 1976).
    if left < 0.7:
        rest -= (basis @ rest) @ basis
        left = math.sqrt(rest @ rest)
    return left, rest


def _strongest(share: Array, names: Sequence[str], least: float) -> tuple[str, ...]:
    """Up to six names with a greater share than the least, the strongest first; share : of each."""
    return tuple(names[j] for j in np.argsort(-share)[:6] if share[j] > least)


def drop_poor(
    parameters: Sequence[Parameter], H: Array, variance: float = 1.0
) -> tuple[list[int], list[Unidentifiable], Array]:
    """Leave out parameters that the data determine less accurately than their prior, one by one, the worst first.

    parameters : of the first rows of H; further rows are unknown points, which stay
    H : information of all, shape (size, size), the parameters in units of their scale; variance : of a residual

    Guesses stay, held back by their priors. Returns the indices of the kept ones, the others with the reason, and the
    covariance of the kept ones, shape (p, p). Bounds do not count: a parameter may sit at one just because the data do
    not determine it.
    """
    priors = np.array([np.inf if p.guess else p.prior / p.scale for p in parameters])
    left = list(range(len(H)))
    poor: list[Unidentifiable] = []
    while True:
        kept = [k for k in left if k < len(parameters)]
        covariance = variance * scaled_inverse(H[np.ix_(left, left)])[: len(kept), : len(kept)]
        errors = np.sqrt(np.diag(covariance))
        ratio = errors / priors[kept]
        if not kept or ratio.max() <= 1:
            return kept, poor, covariance
        worst = int(np.argmax(ratio))
        share = np.abs(covariance[worst] / (errors[worst] * errors))
        share[worst] = 0.0
        # Parameters whose estimates are more correlated than this are named together.
        partners = _strongest(share, [parameters[k].name for k in kept], 0.9)
        p = parameters[kept[worst]]
        reason = (
            f"these poses determine it only to +/- {p.readable(errors[worst] * p.scale):.3g} {p.readable_unit}, worse "
            f"than its prior, {p.readable(p.prior):.3g} {p.readable_unit}"
        )
        if partners:
            verb = "does" if len(partners) == 1 else "do"
            reason += f"; it moves the measured points nearly as {', '.join(partners)} {verb}"
        poor.append(Unidentifiable(p.name, reason, partners))
        left.remove(kept[worst])


def scaled_inverse(H: Array) -> Array:
    """Inverse of a positive semidefinite matrix, scaled first; directions at round-off come out as very uncertain."""
    root = np.sqrt(np.maximum(np.diag(H), 1e-200))
    scaled = H / np.outer(root, root)
    with suppress(np.linalg.LinAlgError):
        L = inverse_of_triangle(np.linalg.cholesky(scaled))
        inverse = np.asarray(L.T @ L)
        # Cholesky's factors give the inverse faster, and well if no scaled variance is greater than
        # this.
        if np.diag(inverse).max(initial=0.0) < 1e8:  # no direction is at round-off
            return np.asarray(inverse / np.outer(root, root))
    eigenvalues, V = np.linalg.eigh(scaled)
    return np.asarray((V / np.maximum(eigenvalues, 1e-15)) @ V.T / np.outer(root, root))
