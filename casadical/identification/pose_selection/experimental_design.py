"""V-optimal sets of poses, with the least mean variance of the position, found by exchanges.

The criterion V is trace(W C), C the inverse of the information matrix and W the mean of J'J over
the task (Atkinson, Donev and Tobias 2007, "Optimum Experimental Designs", chapters 10 and 17).
Adding or removing a candidate changes C by a matrix of as many ranks as it has rows (Woodbury's
formula), and the gain of each candidate follows from its own small block A_k C A_k' (Fedorov 1972).
The blocks are updated too, so that a step costs a few products of tall, thin matrices.
"""

from typing import Any

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.statistics import first_of_best


class Design:
    """State of a search: chosen candidates, and the gain of adding or removing each candidate.

    weight : W of the mean variance trace(W C), shape (p, p)
    rows : whitened Jacobian of each of N candidates, shape (N, m, p) [sigmas per unit of scale]
    fixed : information from priors and poses already measured, shape (p, p)
    places : coordinates of the candidates, shape (N, d), in fractions of the joints' ranges
    apart : candidates within this distance (largest coordinate difference) of a chosen one cannot
        be chosen, itself included; below zero: a candidate may be chosen more than once
    occupied : coordinates of poses already measured, shape (k, d)

    As long as the set does not determine all parameters, gains are of the determinant.
    """

    def __init__(self, weight: Array, rows: Array, fixed: Array, places: Array, apart: float, occupied: Array) -> None:
        """Start with no candidate chosen."""
        self.W = weight
        self.rows = rows
        self.N, self.m, self.p = rows.shape
        flat = rows.reshape(-1, self.p)
        whole = flat.T @ flat + fixed
        # A share of the mean information per candidate keeps that of few poses invertible.
        self.fixed = fixed + 1e-10 * np.diag(np.diag(whole)) / self.N
        self.places, self.apart = places, max(apart, 1e-9) if apart >= 0 else apart
        self._taken = sum((self._near(place) for place in occupied), np.zeros(self.N, dtype=int))
        self.start([])

    def _near(self, place: Array) -> Array:
        """Return 1 for each candidate within `apart` of a place, shape (d,), else 0, shape (N,)."""
        return np.asarray((np.abs(self.places - place).max(axis=1) <= self.apart).astype(int))

    def start(self, chosen: list[int]) -> None:
        """Restart with these candidates chosen, given by their indices."""
        self.chosen = list(chosen)
        self.closed = self._taken + sum((self._near(self.places[k]) for k in chosen), np.zeros(self.N, dtype=int))
        A = self.rows[self.chosen].reshape(-1, self.p)
        self.M: Array = self.fixed + A.T @ A
        self._refresh()

    def _change(self, k: int, sign: int) -> None:
        """Update information, covariance and gains for candidate k, added (1) or removed (-1)."""
        self.closed = self.closed + sign * self._near(self.places[k])
        self.M = self.M + sign * self.rows[k].T @ self.rows[k]
        self._update(self.rows[k], sign)

    def add(self, k: int) -> None:
        """Add the candidate of index k to the chosen ones, and update the gains."""
        self.chosen.append(k)
        self._change(k, 1)

    def remove(self, position: int) -> None:
        """Remove the candidate at this position in the list `chosen`, and update the gains."""
        self._change(self.chosen.pop(position), -1)

    def best_to_add(self) -> int | None:
        """Return the index of the candidate with the largest gain; None if none may be chosen."""
        candidates = np.flatnonzero(self.closed == 0)
        if not len(candidates):
            return None
        gains = self.gains(candidates, 1)
        best = first_of_best(gains)
        return int(candidates[best]) if np.isfinite(gains[best]) else None

    def worst(self) -> int:
        """Return the position in `chosen` of the candidate whose removal has the largest gain."""
        return first_of_best(self.gains(np.array(self.chosen), -1))

    def snapshot(self) -> dict[str, Any]:
        """Return the whole state for `restore`; arrays are replaced, never changed in place."""
        return vars(self) | {"chosen": list(self.chosen)}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a state that `snapshot` returned."""
        vars(self).update(state, chosen=list(state["chosen"]))

    @property
    def regular(self) -> bool:
        """Return whether chosen and measured poses and priors determine all parameters.

        Parameters without any information do not count.
        """
        determined = np.diag(self.M) > 0
        root = np.sqrt(np.diag(self.M)[determined])
        least = np.linalg.eigvalsh(self.M[np.ix_(determined, determined)] / np.outer(root, root))[0]
        # Singular sets have eigenvalues below 1e-11, from the ridge: their variances mean nothing.
        return bool(least > 1e-9)

    @property
    def value(self) -> float:
        """Return minus log of the mean variance trace(W C), or -inf if it is not above 0."""
        variance = float(np.sum(self.W * self.C))
        return -np.log(variance) if variance > 0 else -np.inf

    def _times(self, B: Array) -> Array:
        """Return A_k B for all candidates k, shape (N, m, columns); B : shape (p, columns)."""
        return np.asarray((self.rows.reshape(-1, self.p) @ B).reshape(self.N, self.m, -1))

    def _refresh(self) -> None:
        """Compute C = M^-1 and, for each candidate k, D_k = A_k C A_k' and L_k = A_k C W C A_k'.

        M is the information matrix and C the covariance of the parameters, A_k the whitened
        Jacobian of candidate k, and trace(W C) the mean variance.
        """
        self.C: Array = inverse(self.M)
        self.D: Array = np.einsum("kip,kjp->kij", self._times(self.C), self.rows)
        self.L: Array = np.einsum("kip,kjp->kij", self._times(self.C @ self.W @ self.C), self.rows)
        self._age = 0

    def _update(self, A: Array, sign: int) -> None:
        """Update C, D_k and L_k (see `_refresh`) for rows A, (m, p), added (1) or removed (-1)."""
        self._age += 1
        U = self.C @ A.T
        small = np.eye(len(A)) + sign * A @ U
        # They are computed anew after 50 updates, and where the determinant changes so much that an
        # update would lose digits.
        if self._age > 50 or not 1e-4 < np.linalg.det(small) < 1e4:
            self._refresh()
            return
        S = sign * np.linalg.inv(small)
        P = self._times(U)
        WU = self.W @ U
        Q = self._times(self.C @ WU) @ S @ P.transpose(0, 2, 1)
        self.L = self.L - Q - Q.transpose(0, 2, 1) + P @ S @ (U.T @ WU) @ S @ P.transpose(0, 2, 1)
        self.C = self.C - U @ S @ U.T
        self.D = self.D - P @ S @ P.transpose(0, 2, 1)

    def gains(self, which: Array, sign: int) -> Array:
        """Return the gain of adding (1) or removing (-1) each of some candidates, (len(which),).

        It is the reduction of the mean variance, negative for a removal, or, as long as the set
        does not determine all parameters, the logarithm of the ratio of the information's
        determinants after and before. It is minus infinity for an indispensable pose.

        which : indices of the candidates
        """
        small = np.eye(self.m) + sign * self.D[which]
        if not self.regular:
            signs, logs = np.linalg.slogdet(small)
            # Poses without which the determinant falls below a millionth are indispensable; how far
            # below is rounding, so all count alike.
            return np.where((signs > 0) & (logs > np.log(1e-6)), logs, -np.inf)
        regular = np.linalg.det(small) > 1e-6
        small[~regular] = np.eye(self.m)
        change = sign * np.trace(np.linalg.solve(small, self.L[which]), axis1=1, axis2=2)
        return np.where(regular, change, -np.inf)


def inverse(M: Array) -> Array:
    """Return the inverse of an information matrix M, shape (p, p), which is positive definite.

    Variables without any information (rows of zeros) are independent with variance one.
    """
    M = M + np.diag(np.diag(M) == 0)
    root = np.sqrt(np.diag(M))
    return np.asarray(np.linalg.inv(M / np.outer(root, root)) / np.outer(root, root))


def grow_to(design: Design, n: int) -> bool:
    """Add the best candidates one by one up to n; return False where too few may be chosen."""
    while len(design.chosen) < n and (k := design.best_to_add()) is not None:
        design.add(k)
    return len(design.chosen) >= n


def improve(design: Design, depth: int = 4) -> None:
    """Exchange chosen candidates until no excursion of up to `depth` poses increases the value.

    The number of chosen candidates stays the same; see `excursion`.
    """
    n = len(design.chosen)
    reach = 1
    while reach <= min(depth, n):
        before, value = design.snapshot(), design.value
        for up in (True, False):
            excursion(design, n, reach, up)
            # A minimum gain above round-off prevents an infinite cycle.
            if design.value > value + 1e-6 and len(design.chosen) == n:
                break
            design.restore(before)
        else:
            reach += 1
            continue
        reach = 1


def excursion(design: Design, n: int, reach: int, up: bool) -> None:
    """Add the best `reach` poses and remove the worst, or, if not `up`, remove first and then add.

    The set is smaller than n afterwards if too few can be added. Source: Mitchell (1974).

    n : number of chosen poses before and after
    """
    for target in (n + reach if up else n - reach, n):
        if not grow_to(design, target):
            return
        while len(design.chosen) > target:
            design.remove(design.worst())


def search(design: Design, n: int, restarts: int, seed: int) -> Array:
    """Return the indices of the best n candidates of several searches, shape (n,).

    The first search starts from an empty set, each other one from n // 2 random candidates.

    restarts : number of searches, at least 1; seed : of the random starts
    Raises InputError where fewer than n can be chosen.
    """
    rng = np.random.default_rng(seed)
    best: tuple[float, list[int]] | None = None
    for k in range(max(restarts, 1)):
        design.start([])
        for candidate in rng.permutation(design.N) if k else ():
            if len(design.chosen) == n // 2:
                break
            if design.closed[candidate] == 0:
                design.add(int(candidate))
        if not grow_to(design, n):
            raise InputError(
                f"only {len(design.chosen)} of {n} poses can be chosen: the {design.N} candidates "
                "lie too near to each other or to measured ones; give more candidates, a smaller "
                "min_distance, or fewer poses"
            )
        improve(design)
        if best is None or design.value > best[0] + 1e-6:
            best = (design.value, list(design.chosen))
    assert best is not None
    return np.array(best[1])
