"""nice python docs/studies/parameter_sets.py > docs/studies/parameter_sets.txt

Is the right parameter set found? 200 random six-axis robots, half of them with parallel axes, 30 to 2000 poses each,
base pose and tool point unknown, 0.02 mm noise. The right set follows from the structure alone (`correct_set`). The
held-out error on 500 noise-free poses is set against the noise floor: sigma sqrt(trace) of the best linear unbiased
estimate, as the covariance of the truth's own Jacobian gives it, not the fit's.
"""

from __future__ import annotations

import numpy as np
from synthetic import NOISE, correct_set, measured, planted, random_robot, readings

from casadical import identify
from casadical.core.basics import Array
from casadical.identification.accuracy import errors
from casadical.identification.least_squares import LeastSquares
from casadical.robot.robot import Robot

ROBOTS = 200
SIZES = (30, 50, 100, 300, 1000, 2000)


def floor(built: Robot, names: tuple[str, ...], q: Array, probe: Array) -> float:
    """RMS error [m] at the probe poses of an efficient estimate from positions at q with NOISE."""
    jacobians = []
    for readings_ in (q, probe):
        m = measured(built, readings_, np.random.default_rng(0), 0.0)
        problem = LeastSquares(built, (m,), names, "linear", False, ((1.0, 1.0),))
        jacobians.append(problem.evaluate(np.zeros(problem.size))[1])
    J, P = jacobians
    root = np.linalg.solve(np.linalg.qr(J, mode="r").T, P.T)
    return float(NOISE * np.sqrt((root**2).sum() / len(probe)))


def main() -> None:
    rows: dict[tuple[bool, int], list[tuple[bool, float, bool]]] = {}
    wrong: list[str] = []
    for k in range(ROBOTS):
        parallel = k % 2 == 1
        rng = np.random.default_rng([2026, k])
        robot = random_robot(rng, parallel)
        built = planted(robot, rng)
        probe = readings(built, 500, rng)
        truth = measured(built, probe, rng, 0.0)
        for n in SIZES if k < ROBOTS // 2 else SIZES[:4]:
            q = readings(built, n, rng)
            result = identify(robot, measured(built, q, rng), ["kinematic"])
            right = correct_set(robot)
            found = set(result.names)
            error = np.sqrt(np.mean(errors(result.robot, truth) ** 2))
            ratio = error / floor(built, tuple(x for x in robot.parameters.names if x in right), q, probe)
            rows.setdefault((parallel, n), []).append((found == right, ratio, result.is_optimal()))
            if found != right:
                wrong.append(f"robot {k}, {n} poses: missing {sorted(right - found)}, too many {sorted(found - right)}")
    report(rows, wrong)


def report(rows: dict[tuple[bool, int], list[tuple[bool, float, bool]]], wrong: list[str]) -> None:
    fits = sum(len(r) for r in rows.values())
    every = np.concatenate([[ratio for _, ratio, _ in r] for r in rows.values()])
    verdict = "met" if not wrong else "MISSED"
    print(f"{verdict}: {len(wrong)} wrong sets in {fits} fits of {ROBOTS} robots (target 0)")
    print(f"held-out RMS over the noise floor: mean {np.sqrt(np.mean(every**2)):.3f}, largest {every.max():.2f}")
    print(f"not optimal by is_optimal(): {sum(not ok for r in rows.values() for *_, ok in r)}")
    print()
    print("axes      poses  robots  wrong  RMS/floor: mean   5 %  95 %   max")
    for (parallel, n), r in sorted(rows.items()):
        ratio = np.array([x for _, x, _ in r])
        low, high = np.quantile(ratio, [0.05, 0.95])
        mean = np.sqrt(np.mean(ratio**2))
        count = sum(not right for right, *_ in r)
        kind = "parallel" if parallel else "general "
        print(f"{kind}  {n:5d}  {len(r):6d}  {count:5d}  {mean:15.3f} {low:5.2f} {high:5.2f} {ratio.max():5.2f}")
    print(*wrong, sep="\n")


if __name__ == "__main__":
    main()
