"""Whether joint readings are in the unit of angle that their columns say."""

from collections.abc import Collection, Sequence

import numpy as np

from casadical.core.arrays import Array

# More turns than this are refused; joints that all move less [deg] may have been logged in radians.
MOST_TURNS, RADIANS = 4, 6.3


def angle_fault(q: Array, turning: Sequence[int], names: Collection[str]) -> tuple[int | None, str]:
    """What is wrong where angles are in another unit than their columns say: of which row, or of all, and in words.

    q : readings, shape (n, joints) [rad or m]; turning : numbers of the revolute joints, from 0; names : of the columns
    """
    if not turning:
        return None, ""
    row, i = divmod(int(np.argmax(np.abs(q[:, turning]))), len(turning))
    name, largest = f"q{turning[i] + 1}", q[row, turning[i]]
    if abs(largest) > MOST_TURNS * 2 * np.pi:
        unit, said = ("rad", largest) if f"{name}_rad" in names else ("deg", np.rad2deg(largest))
        remedy = f"at most {MOST_TURNS} are allowed: correct the reading"
        if unit == "rad":
            remedy = f"are the columns in degrees? name them {name}_deg"
        return row, f", column '{name}_{unit}': {said:.6g} {unit} is {abs(largest) / (2 * np.pi):.1f} turns; {remedy}"
    widest = float(np.rad2deg(np.ptp(q[:, turning], axis=0).max()))
    if all(f"q{i + 1}_deg" in names for i in turning) and len(q) >= 10 and widest < RADIANS:
        return None, (
            f": no joint moves by more than {widest:.2f} deg over {len(q)} poses; "
            "are the columns in radians? name them q1_rad, ..."
        )
    return None, ""
