"""python docs/studies/harmonics.py [--seed N] [--each N] [--poses N ...] > docs/studies/harmonics.txt

Harmonics of a joint hidden in noise that follows itself: are they found where an optimal detector finds them?

Synthetic. A UR10 as it is built (the package's model) measures points of a smooth path, one after the other, with noise
of which .8 stays from each pose to the next. One joint is off by a sine of a whole number of cycles a turn, 30
to 129. Its level is what knowledge of it would be worth: half of the square of its white signal beside the base model
[nats]. The optimal detector knows the noise and the base model's form, and tries all joints and frequencies: it finds
the sine where the greatest gain of any is beyond that of noise alone in 99 of 100 campaigns, and stands at the right
place. The diagnosis knows the table alone; it finds the sine where it names a ripple of that joint with this frequency.
"Seen": it names something of that joint, or says that what is left follows this
sine. Within 3 dB: it finds at twice a level what the detector finds at that level.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from casadical import Diagnosis, diagnose, read_problem
from casadical.core.basics import Array
from casadical.effects import TransmissionRipple
from casadical.identification.accuracy import predicted
from casadical.measurements.reading import from_table
from casadical.project.new.new import as_built
from casadical.robot.robot import Robot

ROOT = Path(__file__).parents[2]
LEVELS = (10.0, 20.0, 40.0, 80.0, 160.0)
SIGMA, STAYS = 30e-6, 0.8
CYCLES = (30.0, 130.0)
STEP = 0.2  # of frequencies that the detector tries, in cycles over all readings
BESIDE = 1.0  # a frequency is right within this, in cycles over all readings
ARM = 0.05  # joints that move the point by less [m/rad] are not asked for
NOISES = 200  # draws of noise alone, for the detector's threshold
RANK = 1e-4  # directions of the base that move the white numbers less, of the greatest, are none


def path(n: int, joints: int, rng: np.random.Generator) -> Array:
    """Readings along a smooth path, shape (n, joints) [rad]."""
    t = np.linspace(0.0, 1.0, n)
    q = rng.uniform(-1.2, 1.2, joints) + 0 * t[:, None]
    for turns in (0.5, 1.0, 2.0):
        q = q + rng.uniform(0.05, 0.35, joints) * np.sin(2 * np.pi * (turns * t[:, None] + rng.random(joints)))
    return np.asarray(q)


def followed(n: int, rng: np.random.Generator) -> Array:
    """Noise that follows itself, shape (n, 3) [m]."""
    noise = rng.normal(0.0, SIGMA, (n, 3))
    for k in range(1, n):
        noise[k] = STAYS * noise[k - 1] + np.sqrt(1 - STAYS**2) * noise[k]
    return noise


class Path:
    """A robot's path: its measurements, and the optimal detector of a joint's sine."""

    def __init__(self, nominal: Robot, n: int, rng: np.random.Generator) -> None:
        self.robot, self.built, self.q = nominal, as_built(nominal, rng), path(n, nominal.n, rng)
        names = [*nominal.reading_units]
        table = pd.DataFrame(self.q / list(nominal.reading_units.values()), columns=names)
        self.table = table.assign(pose=np.arange(n), x_mm=0.0, y_mm=0.0, z_mm=0.0)
        self.m = from_table(self.table, nominal.n, "position")
        known = {p.name: p.value for p in self.built.parameters}
        J = [
            self.slope(lambda s, p=p: self.at(self.q, self.built.with_values({p.name: known[p.name] + s * p.prior})))
            for p in self.built.parameters
        ]
        base, square, _ = np.linalg.svd(self.white(np.stack(J, axis=2)), full_matrices=False)
        self.base = base[:, square > RANK * square[0]]
        axes = np.eye(nominal.n)
        arms = [self.slope(lambda s, a=a: self.at(self.q + s * a)) for a in axes]
        self.arms = np.stack(arms, axis=2)
        self.sines = [self._sines(j) for j in range(nominal.n)]

    def at(self, q: Array, robot: Robot | None = None) -> Array:
        """Positions [m], shape (n, 3)."""
        return predicted(robot or self.built, replace(self.m, q=q))[0]

    @staticmethod
    def slope(f: Callable[[float], Array]) -> Array:
        """Derivative of a function of a number, by a central difference."""
        return np.asarray((f(1e-4) - f(-1e-4)) / 2e-4)

    @staticmethod
    def white(X: Array) -> Array:
        """Numbers at the poses, shape (n, 3, k), as white rows, shape (3 n, k)."""
        moved = np.concatenate([X[:1], (X[1:] - STAYS * X[:-1]) / np.sqrt(1 - STAYS**2)]) / SIGMA
        return np.asarray(moved.reshape(-1, X.shape[2]))

    def beside(self, X: Array) -> Array:
        """White rows without what the base model takes."""
        return np.asarray(X - self.base @ (self.base.T @ X))

    def over(self, joint: int) -> float:
        """Turns that a joint's readings span."""
        return float(np.ptp(self.q[:, joint])) / (2 * np.pi)

    def _sines(self, joint: int) -> tuple[Array, Array]:
        """Frequencies [cycles a turn], shape (k,), and orthonormal pairs of white rows, shape (k, 3 n, 2)."""
        cycles = np.arange(CYCLES[0], CYCLES[1], STEP / self.over(joint))
        waves = [f(c * self.q[:, joint]) for c in cycles for f in (np.sin, np.cos)]
        A = self.beside(self.white(self.arms[:, :, [joint]] * np.stack(waves, axis=1)[:, None]))
        pairs = np.linalg.qr(A.T.reshape(len(cycles), 2, -1).transpose(0, 2, 1))[0]
        return cycles, pairs

    def best(self, error: Array) -> tuple[float, int, float]:
        """The greatest gain of a sine [nats], its joint, its frequency; error : shape (n, 3) [m]."""
        y = self.beside(self.white(error[:, :, None]))[:, 0]
        found = []
        for j, (cycles, pairs) in enumerate(self.sines):
            gain = 0.5 * (np.einsum("krc,r->kc", pairs, y) ** 2).sum(axis=1)
            found.append((float(gain.max()), j, float(cycles[gain.argmax()])))
        return max(found)

    def sine(self, joint: int, cycles: float, level: float, phase: float) -> Array:
        """The error of a sine of this level, of one joint's reading, shape (n,) [rad]."""
        wave = np.sin(cycles * self.q[:, joint] + phase)
        signal = self.beside(self.white((self.arms[:, :, joint] * wave[:, None])[:, :, None]))
        return np.asarray(wave * np.sqrt(2 * level / float((signal**2).sum())))

    def measured(self, joint: int, error: Array, noise: Array) -> pd.DataFrame:
        """The table that is diagnosed."""
        q = self.q.copy()
        q[:, joint] += error
        p = 1e3 * (self.at(q) + noise)
        return self.table.assign(x_mm=p[:, 0], y_mm=p[:, 1], z_mm=p[:, 2])


def lines(d: Diagnosis) -> Iterator[tuple[int, float]]:
    """Joint (1-based) and cycles a turn of the sines that a diagnosis names."""
    for cause in d.causes:
        for e in cause.effects:
            if isinstance(e, TransmissionRipple):
                yield e.joint, e.cycles


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--each", type=int, default=10)
    parser.add_argument("--poses", type=int, nargs="+", default=[300, 1000, 2500])
    args = parser.parse_args()
    nominal = read_problem(ROOT / "problems" / "ur10").robot
    print(f"Synthetic; seed {args.seed}, {args.each} paths of each length; sine found, of {args.each}")
    print("poses  level [nats]  amplitude [urad]  detector  diagnosis   seen  a wrong sine named  verdicts")
    for n in args.poses:
        rng = np.random.default_rng([args.seed, n])
        found = {level: Counter[str]() for level in (0.0, *LEVELS)}
        sizes = {level: list[float]() for level in found}
        for _ in range(args.each):
            p = Path(nominal, n, rng)
            threshold = float(np.quantile([p.best(followed(n, rng))[0] for _ in range(NOISES)], 0.99))
            for level in found:
                moves = np.flatnonzero(np.sqrt((p.arms**2).sum(axis=1).mean(axis=0)) > ARM)
                joint = int(rng.choice(moves))
                cycles, noise = float(rng.integers(*CYCLES)), followed(n, rng)
                error = p.sine(joint, cycles, level, float(rng.uniform(0, 2 * np.pi)))
                sizes[level].append(1e6 * float(np.abs(error).max()))

                def right(j: int, c: float, joint: int = joint, cycles: float = cycles, p: Path = p) -> bool:
                    return j == joint and abs(c - cycles) < BESIDE / p.over(joint)

                gain, j, c = p.best(p.arms[:, :, joint] * error[:, None] + noise)
                d = diagnose(nominal, from_table(p.measured(joint, error, noise), nominal.n, "position"))
                named = [(j - 1, c) for j, c in lines(d)]
                left = [s.line for s in d.account.structures if s.line]
                good = any(right(j, c) for j, c in named)
                seen = good or any(right(j - 1, c) for j, c in left) or any(x.joint == joint + 1 for x in d.causes)
                found[level]["detector"] += gain > threshold and right(j, c)
                found[level]["diagnosis"] += good
                found[level]["seen"] += seen
                found[level]["wrong"] += any(not right(j, c) for j, c in named)
                found[level][d.verdict] += 1
                print(n, level, joint + 1, cycles, d.verdict, [x.label for x in d.causes], named, file=sys.stderr)
        for level, f in found.items():
            verdicts = ", ".join(f"{v} {k}" for k, v in f.items() if k in ("none", "unknown", "explained", "ambiguous"))
            amplitude = f"{np.median(sizes[level]):.0f}"
            counts = "".join(
                f"{f[k]:{w}}" for k, w in {"detector": 10, "diagnosis": 11, "seen": 7, "wrong": 20}.items()
            )
            print(f"{n:5}  {level:12.0f}  {amplitude:>16}{counts}  {verdicts}", flush=True)


if __name__ == "__main__":
    main()
