"""Whether joint readings are in the unit of angle that their columns say."""

from collections.abc import Collection, Sequence

import numpy as np

from casadical.core.basics import Array, InputError

# More turns than this are refused; joints that all move less [deg] may have been logged in radians.
MOST_TURNS, RADIANS = 4, 6.3


def refuse_other_unit(q: Array, kinds: Sequence[str], names: Collection[str], source: str, row: Array) -> None:
    """Raises InputError where angles are in another unit than their columns say.

    q : readings, shape (n, joints) [rad or m]; kinds : revolute or prismatic, of each; names : of the columns
    row : line of the source of each reading, shape (n,)
    """
    turning = [i for i, kind in enumerate(kinds) if kind == "revolute"]
    if not turning:
        return
    ends = np.array([[column.min(), column.max()] for column in (q[:, i] for i in turning)])
    if np.abs(ends).max() > MOST_TURNS * 2 * np.pi:
        k, i = divmod(int(np.argmax(np.abs(q[:, turning]))), len(turning))
        name, largest = f"q{turning[i] + 1}", q[k, turning[i]]
        unit, said = ("rad", largest) if f"{name}_rad" in names else ("deg", np.rad2deg(largest))
        remedy = f"at most {MOST_TURNS} are allowed: correct the reading"
        if unit == "rad":
            remedy = f"are the columns in degrees? name them {name}_deg"
        turns = abs(largest) / (2 * np.pi)
        raise InputError(
            f"{source}: row {row[k]}, column '{name}_{unit}': {said:.6g} {unit} is {turns:.1f} turns; {remedy}"
        )
    widest = float(np.rad2deg(np.ptp(ends, axis=1).max()))
    if all(f"q{i + 1}_deg" in names for i in turning) and len(q) >= 10 and widest < RADIANS:
        raise InputError(
            f"{source}: no joint moves by more than {widest:.2f} deg over {len(q)} poses; "
            "are the columns in radians? name them q1_rad, ..."
        )
