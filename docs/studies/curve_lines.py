"""python docs/studies/curve_lines.py [--poses N] [--campaigns N] > docs/studies/curve_lines.txt

Lines of joint error curves: what three series of one real robot say alike, and what is named where the truth is known.

Real: N poses of each UR10 series (A grid, B joint configurations, C random poses). The curves of two series are
compared where both have readings, the shapes that base and tool frame can take up (1, q, sin q, cos q) removed from
both. The search is repeated up to 330 cycles a turn, beyond the harmonics of the curves.

Synthetic: a UR10e whose joints are misread by known functions, from physics that share no code with the effect. In
each campaign one joint has a line of a whole number of cycles and one at twice that; one has a line at any frequency;
one has 60 random harmonics and no line; three are clean.
"""

import argparse
import sys
from collections import Counter
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from campaign_robots import machine
from joint_curves import SERIES
from real_diagnoses import campaign

from casadical import Diagnosis, InputError, diagnose, read_problem
from casadical.blind_check.mujoco_physics import perturb
from casadical.blind_check.mujoco_physics.stops import Stops, only
from casadical.diagnosis.line_search import Line
from casadical.diagnosis.spectrum import JointCurve, Spectrum, curve_rows, seen, spectrum
from casadical.measurements.reading import from_table

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))  # for the simulator in numpy

import numpy_physics

ROOT = Path(__file__).parents[2]
FAR = 330.0


def real(poses: int) -> None:
    found: dict[str, tuple[Diagnosis, Spectrum, Spectrum]] = {}
    for name, folder in SERIES.items():
        robot = read_problem(ROOT / "problems" / folder).robot
        m = campaign(folder, robot)
        m = m[np.sort(np.random.default_rng(0).permutation(len(m))[:poses])]
        d = diagnose(robot, m)
        found[name] = d, spectrum(d), spectrum(d, FAR)
        print(
            f"{name}: {d.verdict}, {', '.join(c.label for c in d.causes)}; curves of {found[name][1].orders} harmonics"
        )
        print("  joint      rms [urad]  share  lines: cycles a turn (amplitude in urad)")
        for joint, rms, share, lines in curve_rows(found[name][1]):
            print(f"  {joint:>5} {rms:>15} {share:>6}  {lines}")
        for c in found[name][2].joints:
            far = [line for line in c.lines if line.frequency > found[name][1].orders]
            for line in far:
                print(f"  beyond the harmonics, joint {c.joint}: {words(line)}")
        print(flush=True)
    print("curves of two series where both have readings: correlation (degrees in common)")
    for first, second in combinations(found, 2):
        rows = [alike(a, b) for a, b in zip(found[first][1].joints, found[second][1].joints, strict=True)]
        print(f"  {first} {second}: {', '.join(r for r in rows if r)}")
    print("lines of two series at the same frequency, within two standard errors of their difference")
    for first, second in combinations(found, 2):
        for k in (1, 2):
            ours, others = ([line for c in found[n][k].joints for line in c.lines] for n in (first, second))
            pairs = [(a, b) for a in ours for b in others if a.joint == b.joint and same(a, b)]
            top = "the harmonics" if k == 1 else f"{FAR:.0f}"
            print(f"  {first} {second} up to {top}: {len(pairs)} of {len(ours)} and {len(others)}", end="")
            print("".join(f"; joint {a.joint}: {words(a)} and {words(b)}" for a, b in pairs), flush=True)


def words(line: Line) -> str:
    size, phase = f"{1e6 * line.amplitude:.0f} +- {1e6 * line.amplitude_error:.0f} urad", np.rad2deg(line.phase)
    return (
        f"{line.frequency:.2f} +- {line.frequency_error:.2f} cycles a turn, {size}, phase {phase:.0f} +- "
        f"{np.rad2deg(line.phase_error):.0f} deg, p = {line.p:.0e}"
    )


def same(a: Line, b: Line) -> bool:
    return abs(a.frequency - b.frequency) < 2 * np.hypot(a.frequency_error, b.frequency_error)


def alike(a: JointCurve, b: JointCurve) -> str:
    """Correlation of two curves, both weighted by how well they are known."""
    both = a.covered & b.covered & seen(a) & seen(b)
    if both.sum() < 40:
        return ""
    q, weight = a.angle[both], 1 / np.hypot(a.error, b.error)[both]
    nuisance = np.stack([np.ones_like(q), q, np.sin(q), np.cos(q)], axis=1) * weight[:, None]
    left = []
    for c in (a, b):
        y = c.value[both] * weight
        left.append(y - nuisance @ np.linalg.lstsq(nuisance, y, rcond=None)[0])
    r = left[0] @ left[1] / np.sqrt((left[0] @ left[0]) * (left[1] @ left[1]))
    return f"joint {a.joint} {r:.2f} ({both.sum() / 2:.0f})"


@dataclass(frozen=True)
class Misread(numpy_physics.Disturbance):
    """A sum of sines of one joint's reading; waves : (cycles a turn, amplitude [rad], phase) of each."""

    joint: int
    waves: tuple[tuple[float, float, float], ...]

    def misread(self, stops: Stops) -> np.ndarray:
        q = stops.q[:, self.joint - 1]
        return only(self.joint, sum(a * np.sin(f * q + phase) for f, a, phase in self.waves))


def drawn(rng: np.random.Generator) -> dict[str, Misread]:
    joints = [int(j) for j in rng.permutation(5)[:3] + 1]
    whole, size = float(rng.integers(6, 29)), rng.uniform(6e-5, 1.2e-4)
    phases = rng.uniform(-np.pi, np.pi, 3)
    sizes = 1.5e-5 * np.minimum(1, 17 / np.arange(1, 61))
    broad = zip(range(1, 61), sizes * rng.rayleigh(size=60), rng.uniform(-np.pi, np.pi, 60), strict=True)
    return {
        "whole": Misread(joints[0], ((whole, size, phases[0]), (2 * whole, size / 2, phases[1]))),
        "any": Misread(joints[1], ((rng.uniform(5, 50), rng.uniform(6e-5, 1.2e-4), phases[2]),)),
        "broad": Misread(joints[2], tuple(broad)),
    }


def known(campaigns: int, poses: int) -> None:
    robot, nominal = machine("ur10e")
    count: Counter[str] = Counter()
    off, sigmas = [], []
    for number in range(campaigns):
        rng = np.random.default_rng([17, number])
        truth = drawn(rng)
        plant = perturb(nominal, int(rng.integers(1 << 30)))
        table = numpy_physics.campaign(
            plant, poses, int(rng.integers(1 << 30)), disturbances=list(truth.values()), noise_mm=0.015
        )
        d = diagnose(robot, from_table(table, 6, "position"), ["joint_error_curve"])
        try:
            s = spectrum(d)
        except InputError:
            count["no curve found"] += 1
            continue
        count["curve found"] += 1
        kinds = {w.joint: kind for kind, w in truth.items()}
        for c in s.joints:
            kind = kinds.get(c.joint, "clean")
            count[f"joints {kind}"] += 1
            waves = list(truth[kind].waves) if kind in ("whole", "any") else []
            count[f"lines {kind}"] += len(waves)
            for line in c.lines:
                near = [w for w in waves if abs(w[0] - line.frequency) < max(0.3, 3 * line.frequency_error)]
                count[f"{'found' if near else 'false'} {kind}"] += 1
                for f, a, _ in near:
                    off.append((line.frequency - f, line.frequency_error))
                    sigmas.append((line.amplitude - a) / line.amplitude_error)
                if not near:
                    print(f"  campaign {number}, joint {c.joint} ({kind}): no such line: {words(line)}")
    offs, errors = np.abs(np.array(off)).T
    print(f"{campaigns} campaigns of {poses} poses; {dict(sorted(count.items()))}")
    print(
        f"  frequency off by {np.median(offs):.3f} cycles in the median, {np.quantile(offs, 0.95):.3f} in 95 %; ",
        end="",
    )
    print(f"beyond three standard errors {np.mean(offs > 3 * errors):.3f}; amplitude {np.mean(np.abs(sigmas) > 3):.3f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--poses", type=int, default=600)
    parser.add_argument("--campaigns", type=int, default=100)
    given = parser.parse_args()
    print(f"real data: UR10, {given.poses} poses of each series\n")
    real(given.poses)
    print("\nsynthetic data: UR10e")
    known(given.campaigns, 150)
