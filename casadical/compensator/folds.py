"""Folds of a cross-validation."""

import numpy as np

from casadical.core.arrays import Array


def training_masks(samples: int, folds: int, seed: int) -> Array:
    """Split samples at random into folds of sizes that differ by one at most.

    Returns a boolean array of shape (folds, samples), true where a sample is trained on.
    """
    order = np.random.default_rng(seed).permutation(samples)
    masks = np.ones((folds, samples), dtype=bool)
    for mask, held_out in zip(masks, np.array_split(order, folds), strict=True):
        mask[held_out] = False
    return masks
