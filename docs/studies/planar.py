"""Make the planar arm's data: `python docs/studies/planar.py` writes data/planar/planar.csv.

Two links in a horizontal plane, a point on the second one measured from above. The arm differs from its drawing in four
numbers; nothing of casadical is used to make the data, only the sine and cosine of school.
"""

from pathlib import Path

import numpy as np
import pandas as pd

# As drawn: links of 400 and 300 mm, zero offsets, the arm's plane at z = 0. As built:
LINK_1_MM, LINK_2_MM = 400.6, 299.3
OFFSET_1_DEG, OFFSET_2_DEG = 0.25, -0.4
NOISE_MM = 0.02
POSES, SEED = 40, 1


def planar() -> pd.DataFrame:
    """Joint readings [deg] and noisy positions [mm] of the arm as built, in the columns of a measurement file."""
    rng = np.random.default_rng(SEED)
    q1 = np.round(rng.uniform(-120, 120, POSES), 3)
    q2 = np.round(rng.uniform(-140, 140, POSES), 3)
    first = np.deg2rad(q1 + OFFSET_1_DEG)
    second = first + np.deg2rad(q2 + OFFSET_2_DEG)
    x = LINK_1_MM * np.cos(first) + LINK_2_MM * np.cos(second)
    y = LINK_1_MM * np.sin(first) + LINK_2_MM * np.sin(second)
    table = pd.DataFrame({"q1_deg": q1, "q2_deg": q2, "x_mm": x, "y_mm": y, "z_mm": 0.0})
    table[["x_mm", "y_mm", "z_mm"]] += rng.normal(0, NOISE_MM, (POSES, 3))
    return table.round(4)


if __name__ == "__main__":
    planar().to_csv(Path(__file__).parents[2] / "data" / "planar" / "planar.csv", index=False)
