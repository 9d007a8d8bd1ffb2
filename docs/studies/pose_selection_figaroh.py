"""PYTHON_WITH_FIGAROH docs/studies/pose_selection_figaroh.py ROWS.npy OUT.json N...

figaroh's two D-optimal selections on given information matrices: the weights of its SOCP, of which the n heaviest are
taken, and its Detmax, whose result is the set it evaluated last. Runs in a virtual environment of its own; called by
pose_selection.py.
"""

import json
import random
import sys
import time

import numpy as np
from figaroh.optimal.base_optimal_calibration import Detmax, SOCPOptimizer


class Watched(Detmax):
    """Detmax keeps its set to itself; the last one whose criterion it asks for is its result."""

    def get_critD(self, chosen):
        self.last = list(chosen)
        return super().get_critD(chosen)


def main() -> None:
    rows, out, *sizes = sys.argv[1:]
    J = np.load(rows)
    pool = {k: A.T @ A for k, A in enumerate(J)}
    start = time.process_time()
    weights = np.array(SOCPOptimizer(pool, {"NbSample": len(J)}).solve()[0])
    socp = time.process_time() - start
    found = []
    for n in map(int, sizes):
        random.seed(0)
        start = time.process_time()
        watched = Watched(pool, n)
        watched.main_algo()
        seconds = time.process_time() - start
        top = np.argsort(-weights)[:n].tolist()
        print(f"{n}: {socp:.1f} s, {seconds:.1f} s", file=sys.stderr, flush=True)
        found.append({"n": n, "socp": top, "socp_s": socp, "detmax": watched.last, "detmax_s": seconds})
    with open(out, "w", encoding="utf-8") as file:
        json.dump(found, file)


if __name__ == "__main__":
    main()
