"""nice python docs/studies/coverage.py > docs/studies/coverage.txt

Do 95 % intervals hold the truth in 93 to 97 % of cases? Synthetic campaigns with a new truth and new poses each; an arm
with parallel axes 2 and 3 and compliant joints, base pose and tool point unknown, 0.02 mm noise. Intervals of
parameters are those of `Identification.parameters`; those of positions come from `predict`, by coordinate, over the
whole range.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from scipy.special import stdtrit
from synthetic import NOISE, measured, planted, readings

from casadical import Body, Identification, Joint, Measurements, Placement, Robot, identify
from casadical.core.basics import Array
from casadical.core.transforms import frame
from casadical.identification.accuracy import predicted
from casadical.identification.residuals import Loss

RUNS = 200
RIGHT = np.pi / 2


def arm() -> Robot:
    rows = [(0, 0, 0.4), (RIGHT, 0.1, 0), (0, 0.5, 0), (RIGHT, 0.05, 0.45), (-RIGHT, 0, 0), (RIGHT, 0, 0.1)]
    masses = [20.0, 12, 8, 4, 2, 1]
    joints = tuple(
        Joint(alpha=alpha, a=a, d=d, lower=-2.6, upper=2.6, compliance=2e-5 if 0 < i < 5 else None,
              body=Body(mass, np.array([0.2 if i in (1, 2) else 0.0, 0.02, 0.05])))
        for i, ((alpha, a, d), mass) in enumerate(zip(rows, masses, strict=True))
    )  # fmt: skip
    tool = Placement(frame(np.eye(3), np.array([0.05, 0.08, 0.12])), "position")
    return Robot("arm", joints, base=Placement(np.eye(4), "pose"), tool=tool, payload=Body(5.0, np.array([0, 0, 0.1])))


def planted_in(robot: Robot, names: tuple[str, ...], rng: np.random.Generator) -> Robot:
    """A truth that departs only in what can be identified, so that it can be compared number by number."""
    full = planted(robot, rng)
    built = robot.with_values({n: full.parameters[n].value for n in names if not n.startswith("base")})
    return replace(built, base=full.base)


def inside(result: Identification, built: Robot, probe: Array) -> tuple[Array, Array]:
    """Masks: which parameters and which coordinates of predicted positions lie in their 95 % intervals."""
    table = result.parameters.set_index("name").loc[list(result.names)]
    own = [n for n in result.names if not n.startswith("base")]
    truth = np.array([built.parameters[n].readable(built.parameters[n].value) for n in own])
    hit = (table.loc[own, "low"].to_numpy() <= truth) & (truth <= table.loc[own, "high"].to_numpy())
    m = Measurements(q=probe, kind="position", position=np.zeros((len(probe), 3)))
    p, covariance = result.predict(probe)
    half = stdtrit(max(1, result.degrees_of_freedom), 0.975) * np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return hit, np.abs(p - predicted(built, m)[0]) <= half


def case(n: int, loss: Loss, bad: float, runs: int) -> tuple[float, float, float]:
    """Coverage of parameters and positions, and the lowest of any single parameter."""
    robot = arm()
    rng = np.random.default_rng([7, n, len(loss)])
    names = identify(robot, measured(planted(robot, rng), readings(robot, 200, rng), rng)).names
    hits, places = [], []
    for _ in range(runs):
        built = planted_in(robot, names, rng)
        m = measured(built, readings(robot, n, rng), rng)
        if bad:
            m = spoiled(m, bad, rng)
        result = identify(robot, m, loss=loss)
        if result.names != names:
            raise SystemExit(f"another parameter set: {set(names) ^ set(result.names)}")
        hit, place = inside(result, built, readings(robot, 40, rng))
        hits.append(hit)
        places.append(place)
    each = np.mean(hits, axis=0)
    return float(np.mean(hits)), float(np.mean(places)), float(each.min())


def spoiled(m: Measurements, share: float, rng: np.random.Generator) -> Measurements:
    """A share of the positions wrong by 1 mm."""
    assert m.position is not None
    bad = rng.permutation(len(m))[: round(share * len(m))]
    wrong = m.position.copy()
    wrong[bad] += 50 * NOISE * rng.normal(size=(len(bad), 3))
    return replace(m, position=wrong)


CASES: tuple[tuple[int, Loss, float], ...] = (
    (40, "linear", 0.0),
    (150, "linear", 0.0),
    (60, "huber", 0.0),
    (100, "soft_l1", 0.1),
)


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else RUNS
    found = [(*c, *case(*c, runs)) for c in CASES]
    met = all(0.93 <= x <= 0.97 for row in found for x in row[3:5])
    print(f"{'met' if met else 'MISSED'}: 95 % intervals over {runs} runs a row (target 93 to 97 %)")
    print()
    print("poses  loss     outliers  parameters  positions  worst single parameter")
    for n, loss, bad, hit, place, least in found:
        print(f"{n:5d}  {loss:7s}  {bad:8.0%}  {hit:10.1%}  {place:9.1%}  {least:22.1%}")


if __name__ == "__main__":
    main()
