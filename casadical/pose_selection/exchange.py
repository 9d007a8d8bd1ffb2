"""Exchange of poses: DETMAX with excursions and restarts (Mitchell 1974, Technometrics 16, 203-210)."""

import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.pose_selection.experimental_design import Design

# How many poses an excursion adds (or takes away) before it returns to the number wanted.
DEPTH = 4
# Least gain of an exchange in the logarithm of its index: above round-off, which could make it cycle for ever.
LEAST_GAIN = 1e-6


def fill(design: Design, n: int) -> None:
    """Add the best candidates one by one up to n. Raises InputError where too few are open."""
    while len(design.chosen) < n:
        k = design.best_to_add()
        if k is None:
            raise InputError(
                f"only {len(design.chosen)} of {n} poses can be chosen: the {design.N} candidates lie too near to "
                "each other or to measured ones; give more candidates, a smaller min_distance, or fewer poses"
            )
        design.add(k)


def improve(design: Design, depth: int = DEPTH) -> None:
    """Exchange candidates until no excursion of up to `depth` poses gains any more."""
    n = len(design.chosen)
    reach = 1
    while reach <= min(depth, n):
        before, value = design.snapshot(), design.value
        for up in (True, False):
            _excursion(design, n, reach, up)
            if design.value > value + LEAST_GAIN and len(design.chosen) == n:
                break
            design.restore(before)
        else:
            reach += 1
            continue
        reach = 1


def _excursion(design: Design, n: int, reach: int, up: bool) -> None:
    for growing in (True, False) if up else (False, True):
        target = n + reach * ((growing and up) - ((not growing) and not up))
        while len(design.chosen) < target:
            k = design.best_to_add()
            if k is None:
                return
            design.add(k)
        while len(design.chosen) > target:
            design.remove(design.worst())


def search(design: Design, n: int, restarts: int, seed: int) -> Array:
    """The best n candidates of several searches, each from a random start; indices, shape (n,).

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
        fill(design, n)
        improve(design)
        if best is None or design.value > best[0] + LEAST_GAIN:
            best = (design.value, list(design.chosen))
    assert best is not None
    return np.array(best[1])
