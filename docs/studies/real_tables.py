"""The tables of the UR5 and the WAM: `python docs/studies/real_tables.py > docs/studies/real_tables.txt`.

The published tables hold each pose's target and its error. What the tracker measured is target + error; it goes beside
them, into measured_grid.csv and measured_random.csv in casadical's columns, with the published split in the column
`set`. The description of the tables leaves the sign open, the tables themselves do not: target + error has six
decimals of a millimetre in every row, as the tracker writes its readings, target - error has not (last columns). The
authors' program that makes such tables (tools/get_clean_own_3D_df.py in their repository ASTGCN-robot-pose-deviation)
subtracts the target from the measured position, too.

The rest of what is printed checks angles, units and DH convention by other means than casadical: the nominal table,
with one point fixed to its flange, gives back the published targets.
"""

from pathlib import Path

import numpy as np
import pandas as pd

DATA = Path(__file__).parents[2] / "data"
SETS = {"grid": "identify", "random": "report"}  # as published: identified on the grid, judged on the random poses
SIGN = 1.0  # of the error in: measured = target + SIGN error
# Standard DH rows as the makers publish them: d and a [mm], alpha [deg].
NOMINAL = {
    "ur5": ((89.159, 0, 90), (0, -425, 0), (0, -392.25, 0), (109.15, 0, 90), (94.65, 0, -90), (82.3, 0, 0)),
    "wam": ((0, 0, -90), (0, 0, 90), (550, 45, -90), (0, -45, 90), (300, 0, -90), (0, 0, 90), (60, 0, 0)),
}


def published(robot: str, name: str) -> pd.DataFrame:
    """A table as published: targets and errors [mm], commanded joint angles [deg]."""
    return pd.read_csv(DATA / f"{robot}_laser_tracker" / f"{name}.csv")


def measured(table: pd.DataFrame, use: str, sign: float = SIGN) -> pd.DataFrame:
    """The same poses as a table of measurements, to 1e-6 mm and 1e-6 deg; `use` fills the column `set`."""
    angles = {name.replace("joint_", "q") + "_deg": table[name].round(6) for name in table if "joint" in name}
    points = {f"{c}_mm": (table[f"{c}_t"] + sign * table[f"{c}_dif"]).round(6) for c in "xyz"}
    return pd.DataFrame({"pose": table["step_order"], **angles, **points, "set": use})


def nominal_flange(robot: str, q: np.ndarray) -> np.ndarray:
    """Frames of the flange at readings of shape (n, joints) [rad]; shape (n, 4, 4) [mm]."""
    T = np.tile(np.eye(4), (len(q), 1, 1))
    for (d, a, alpha), theta in zip(NOMINAL[robot], q.T, strict=True):
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(np.deg2rad(alpha)), np.sin(np.deg2rad(alpha))
        row = np.zeros_like(T)
        row[:, 0] = np.stack([c, -s * ca, s * sa, a * c], axis=1)
        row[:, 1] = np.stack([s, c * ca, -c * sa, a * s], axis=1)
        row[:, 2:] = [[0, sa, ca, d], [0, 0, 0, 1]]
        T = T @ row
    return T


def reproduced(robot: str, table: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Point on the flange that gives back the targets best, shape (3,), and what remains, shape (n,) [mm]."""
    T = nominal_flange(robot, np.deg2rad(table.filter(like="joint").to_numpy()))
    target = table[["x_t", "y_t", "z_t"]].to_numpy()
    point = np.mean(np.einsum("nji,nj->ni", T[:, :3, :3], target - T[:, :3, 3]), axis=0)
    return point, np.linalg.norm(T[:, :3, :3] @ point + T[:, :3, 3] - target, axis=1)


def with_six_decimals(table: pd.DataFrame, sign: float) -> float:
    """Share of the coordinates target + sign error that are whole millionths of a millimetre."""
    parts = np.concatenate([1e6 * (table[f"{c}_t"] + sign * table[f"{c}_dif"]) for c in "xyz"])
    return float((np.abs(parts - np.round(parts)) < 1e-3).mean())


def main() -> None:
    print("published targets and those of the nominal DH table, mm")
    print(
        f"{'table':12} {'poses':>5}   {'point on the flange':>24}   {'off, mean':>9} {'max':>7}   {'error, mean':>11}"
        "   six decimals: target + error  target - error"
    )
    for robot in NOMINAL:
        for name, use in SETS.items():
            table = published(robot, name)
            measured(table, use).to_csv(DATA / f"{robot}_laser_tracker" / f"measured_{name}.csv", index=False)
            point, off = reproduced(robot, table)
            error = np.linalg.norm(table[["x_dif", "y_dif", "z_dif"]], axis=1).mean()
            place = " ".join(f"{v:7.3f}" for v in point + 0.0)
            shares = [f"{100 * with_six_decimals(table, sign):.1f} %" for sign in (1, -1)]
            print(
                f"{robot} {name:8} {len(table):5}   {place:>24}   {off.mean():9.4f} {off.max():7.4f}   {error:11.4f}"
                f"   {shares[0]:>28}  {shares[1]:>14}"
            )


if __name__ == "__main__":
    main()
