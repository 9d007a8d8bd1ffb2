"""python docs/studies/hh800_twin_effects.py > docs/studies/hh800_twin_effects.txt

What the HH800 twin is made of: how far each unmodelled effect alone moves the reflector (nothing is fitted, so most
would vanish in an identification), and how much of all of them does not repeat at the same joint readings.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))  # for the simulator in numpy

from numpy_physics import campaign, hh800_true, hh800_twin
from numpy_physics.twin import UNMODELLED, WARMUP

Q = [f"q{j}_deg" for j in range(1, 7)]
TRUE = ["x_true_mm", "y_true_mm", "z_true_mm"]


def main() -> None:
    clean = hh800_twin(disturbances=(), truth=True)
    still = clean[TRUE].to_numpy()
    print(f"{'effect alone':28s} mean_mm  max_mm   (shift of the reflector, {len(clean)} poses of the twin)")
    for effect in (*UNMODELLED, None):
        chosen = UNMODELLED if effect is None else (effect,)
        shift = hh800_twin(disturbances=chosen, truth=True)[TRUE].to_numpy() - still
        length = np.linalg.norm(shift, axis=1)
        where = "" if effect is None or not hasattr(effect, "joint") else f", joint {effect.joint}"
        name = "all together" if effect is None else f"{type(effect).__name__}{where}"
        print(f"{name:28s} {length.mean():7.3f} {length.max():7.3f}")
    print("\nThe same 190 readings measured 20 times, other approaches, times and noise each time:")
    q_deg = clean[Q].to_numpy()
    for label, effects in (("noise and repeatability only", ()), ("all effects", UNMODELLED)):
        again = [
            campaign(hh800_true(), 190, seed, q_deg=q_deg, payload_states=[300.0], warmup=WARMUP, disturbances=effects)
            for seed in range(20)
        ]
        spread = np.var([t[["x_mm", "y_mm", "z_mm"]].to_numpy() for t in again], axis=0, ddof=1).sum(1)
        print(f"{label:28s} spread {np.sqrt(spread.mean()):.3f} mm rms (3-D)")


if __name__ == "__main__":
    main()
