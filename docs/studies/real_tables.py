"""The tables of the UR5 and the WAM: `python docs/studies/real_tables.py > docs/studies/real_tables.txt`.

The published tables hold each pose's target and its error. What the tracker measured is target + error; it goes beside
them, into measured_grid.csv and measured_random.csv in casadical's columns, with the published split in the column
`set`. The description of the tables leaves the sign open, the tables themselves do not: target + error has six
decimals of a millimetre in every row, as the tracker writes its readings, target - error has not (last columns). The
authors' program that makes such tables (tools/get_clean_own_3D_df.py in their repository ASTGCN-robot-pose-deviation)
subtracts the target from the measured position, too.
"""

from pathlib import Path

import numpy as np
import pandas as pd

DATA = Path(__file__).parents[2] / "data"
SETS = {"grid": "identify", "random": "report"}  # as published: identified on the grid, judged on the random poses
SIGN = 1.0  # of the error in: measured = target + SIGN error


def published(robot: str, name: str) -> pd.DataFrame:
    """A table as published: targets and errors [mm], commanded joint angles [deg]."""
    return pd.read_csv(DATA / f"{robot}_laser_tracker" / f"{name}.csv")


def measured(table: pd.DataFrame, use: str, sign: float = SIGN) -> pd.DataFrame:
    """The same poses as a table of measurements, to 1e-6 mm and 1e-6 deg; `use` fills the column `set`."""
    angles = {name.replace("joint_", "q") + "_deg": table[name].round(6) for name in table if "joint" in name}
    points = {f"{c}_mm": (table[f"{c}_t"] + sign * table[f"{c}_dif"]).round(6) for c in "xyz"}
    return pd.DataFrame({"pose": table["step_order"], **angles, **points, "set": use})


def with_six_decimals(table: pd.DataFrame, sign: float) -> float:
    """Share of the coordinates target + sign error that are whole millionths of a millimetre."""
    parts = np.concatenate([1e6 * (table[f"{c}_t"] + sign * table[f"{c}_dif"]) for c in "xyz"])
    return float((np.abs(parts - np.round(parts)) < 1e-3).mean())


def main() -> None:
    print("table        poses   six decimals: target + error  target - error")
    for robot in ("ur5", "wam"):
        for name, use in SETS.items():
            table = published(robot, name)
            measured(table, use).to_csv(DATA / f"{robot}_laser_tracker" / f"measured_{name}.csv", index=False)
            shares = [f"{100 * with_six_decimals(table, sign):.1f} %" for sign in (1, -1)]
            print(f"{robot} {name:8} {len(table):5}   {shares[0]:>28}  {shares[1]:>14}")


if __name__ == "__main__":
    main()
