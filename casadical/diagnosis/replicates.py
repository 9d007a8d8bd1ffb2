"""Noise from poses that were measured more than once: no model can explain their differences."""

import re
from dataclasses import dataclass

import numpy as np

from casadical.core.arrays import Array
from casadical.measurements.measurements import Measurements

# Readings that differ by less than this [rad or m] are one pose; the model's own small difference is taken off.
SAME_POSE = 1e-3
# Fewer degrees of freedom than this leave the noise uncertain by more than a fifth.
ENOUGH = 12
_CIRCUMSTANCE = re.compile(r"payload_kg|approach\d+")


@dataclass(frozen=True)
class Replicates:
    """Scatter of repeated poses.

    sigma : of one coordinate [m], instrument and joint repeatability together; poses, groups : how many poses repeat,
    and of how many different ones; freedom : degrees of freedom
    """

    sigma: float
    poses: int
    groups: int
    freedom: int

    @property
    def enough(self) -> bool:
        """Whether they are enough to go by."""
        return self.freedom >= ENOUGH


def replicates(m: Measurements, r: Array, kept: Array) -> Replicates:
    """Scatter of the residuals r, shape (n, 3) [m], of kept poses at the same readings, payload and logged approach."""
    circumstances = [values for name, values in m.conditions.items() if _CIRCUMSTANCE.fullmatch(name)]
    key = np.column_stack([np.round(m.q / SAME_POSE), *circumstances])[kept]
    _, group, counts = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    group = group.ravel()
    means = np.zeros((len(counts), 3))
    np.add.at(means, group, r[kept])
    apart = r[kept] - (means / counts[:, None])[group]
    several = counts[counts > 1]
    freedom = 3 * int((several - 1).sum())
    sigma = float(np.sqrt((apart**2).sum() / freedom)) if freedom else 0.0
    return Replicates(sigma, int(several.sum()), len(several), freedom)
