"""What measurements must be in themselves, whatever the robot: shapes, finite numbers, sensible sigmas, labels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from casadical.core.errors import InputError

if TYPE_CHECKING:
    from casadical.measurements.measurements import Measurements

# What each kind observes; a distance may have a target.
_NEEDED = {
    "position": ("position",),
    "pose": ("position", "orientation"),
    "distance": ("distance",),
    "pair_distance": ("distance", "other"),
    "contact": ("label",),
}
_SHAPES: dict[str, tuple[int, ...]] = {
    "position": (3,),
    "orientation": (3, 3),
    "distance": (),
    "target": (3,),
    "label": (),
    "weight": (),
    "row": (),
}


def refuse_malformed(m: Measurements) -> None:
    """Raises InputError that names source, entry, row and value."""
    if m.q.ndim != 2:
        raise InputError(f"{m.source}: q has shape {m.q.shape}; it must be (poses, joints)")
    if m.kind not in _NEEDED:
        raise InputError(f"{m.source}: kind {m.kind!r} is not known; allowed: {', '.join(_NEEDED)}")
    for name in _NEEDED[m.kind]:
        if getattr(m, name) is None:
            raise InputError(f"{m.source}: kind {m.kind!r} needs {name}")
    for name, shape in {**_SHAPES, "other": m.q.shape[1:]}.items():
        value = getattr(m, name)
        if value is not None and value.shape != (len(m), *shape):
            raise InputError(f"{m.source}: {name} has shape {value.shape}; for {len(m)} poses it is {(len(m), *shape)}")
    _refuse_not_finite(m)
    _refuse_weights(m)
    _refuse_separations(m)


def _refuse_not_finite(m: Measurements) -> None:
    numbers = {name: getattr(m, name) for name in ("q", "position", "orientation", "distance", "target", "other")}
    for name, value in {**numbers, **m.conditions}.items():
        if value is None:
            continue
        if len(value) != len(m):
            raise InputError(f"{m.source}: {name} has {len(value)} entries for {len(m)} poses")
        bad = ~np.isfinite(value.reshape(len(m), -1)).all(axis=1)
        if bad.any():
            k = int(np.argmax(bad))
            raise InputError(f"{m.source}: row {m.row[k]}: {name} is {value[k]}; only finite numbers are allowed")


def _refuse_weights(m: Measurements) -> None:
    for name, sigma in (("sigma", m.sigma), ("sigma_angle", m.sigma_angle), ("separation_sigma", m.separation_sigma)):
        if sigma is not None and not 0 < sigma < np.inf:
            raise InputError(f"{m.source}: {name} is {sigma:.6g}; a standard deviation must be positive and finite")
    bad = ~(np.isfinite(m.weight) & (m.weight >= 0))
    if bad.any():
        k = int(np.argmax(bad))
        raise InputError(
            f"{m.source}: row {m.row[k]}, column 'weight': {m.weight[k]:.6g}; a weight must be zero or more and finite"
        )
    if not m.weight.any():
        raise InputError(f"{m.source}: column 'weight' is zero in every row; at least one pose must count")


def _refuse_separations(m: Measurements) -> None:
    present = set() if m.label is None else {str(name) for name in m.label}
    for first, second, length in m.separations:
        unknown = sorted({first, second} - present)
        if unknown:
            raise InputError(
                f"{m.source}: separation {first!r} - {second!r}: no pose touches {unknown[0]!r}; "
                f"there are {', '.join(sorted(present)) or 'no touched points (kind contact only)'}"
            )
        if first == second or not 0 < length < np.inf:
            raise InputError(
                f"{m.source}: separation {first!r} - {second!r}: {1e3 * length:.6g} mm; "
                "it must be a positive distance between two different points"
            )
