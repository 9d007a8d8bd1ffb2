"""PYTHON_WITH_FIGAROH docs/studies/figaroh_designs.py ROWS.npy OUT.json N...

figaroh's two D-optimal selections on given information matrices: its Detmax, whose result is the set it evaluated last,
and the weights of its SOCP, of which the n heaviest are taken. Runs in a virtual environment of its own; called by
pose_selection_figaroh.py, which says how to make that.
"""

import json
import random
import signal
import sys
import time

import numpy as np
from figaroh.optimal.base_optimal_calibration import Detmax, SOCPOptimizer

LONGEST = 90


class Watched(Detmax):
    """Detmax keeps its set to itself; the last one whose criterion it asks for is its result."""

    def get_critD(self, chosen):
        self.last = list(chosen)
        return super().get_critD(chosen)


def socp(pool):
    """Weights of all poses, None if there are none after LONGEST seconds; and the seconds."""

    def stop(*_):
        raise TimeoutError

    signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, LONGEST)
    start = time.process_time()
    try:
        weights = np.array(SOCPOptimizer(pool, {"NbSample": len(pool)}).solve()[0])
    except TimeoutError:
        weights = None
    signal.setitimer(signal.ITIMER_VIRTUAL, 0)
    return weights, time.process_time() - start


def main() -> None:
    rows, out, *sizes = sys.argv[1:]
    J = np.load(rows)
    pool = {k: A.T @ A for k, A in enumerate(J)}
    found = []
    for n in map(int, sizes):
        random.seed(0)
        start = time.process_time()
        watched = Watched(pool, n)
        watched.main_algo()
        found.append({"n": n, "detmax": watched.last, "detmax_s": time.process_time() - start})
    weights, seconds = socp(pool)
    for f in found:
        f |= {"socp": None if weights is None else np.argsort(-weights)[: f["n"]].tolist(), "socp_s": seconds}
    with open(out, "w", encoding="utf-8") as file:
        json.dump(found, file)


if __name__ == "__main__":
    main()
