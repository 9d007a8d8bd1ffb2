"""Calibration of the real UR10 with wires instead of a laser tracker, judged by the tracker.

    python docs/studies/cheap_instruments.py [--poses N ...] [--noise MM ...] > docs/studies/cheap_instruments.txt

Real readings and tracker positions of `problems/ur10`. What is made: of the tracker's positions at the poses
for the fit, distances to one, two or three places that stay unknown, with noise of so many millimetres, as draw wires
or a ball bar give them. The robot is calibrated with these distances alone, and compared with the tracker at 500 poses
that were held out: the base frame, which wires do not know, is put where the tracker has it at the poses of the fit.
"scale" is by how much the calibrated robot is larger than the tracker says there. "known": the places were measured by
the tracker. At the end, what a diagnosis says of the same readings.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from casadical.diagnosis.diagnose import diagnose
from casadical.identification.accuracy import errors, predicted
from casadical.identification.identification import identify
from casadical.measurements.measurements import Measurements
from casadical.project.problem import read_problem
from casadical.robot.robot import Robot

ROOT = Path(__file__).parents[2]
HELD_OUT = 500


def places(robot: Robot, count: int) -> np.ndarray:
    """Where the wires end, shape (count, 3) [m] in the tracker's frame: about the robot, at three heights."""
    turn = np.deg2rad([10.0, 130.0, 250.0])[:count]
    heights = np.array([0.0, 1.2, 0.6])[:count]
    local = np.column_stack([1.8 * np.cos(turn), 1.8 * np.sin(turn), heights])
    return local @ robot.base.T[:3, :3].T + robot.base.T[:3, 3]


def wires(
    m: Measurements, to: np.ndarray, noise: float, rng: np.random.Generator, known: bool = False
) -> list[Measurements]:
    assert m.position is not None
    lengths = [np.linalg.norm(m.position - place, axis=1) + rng.normal(0, noise, len(m)) for place in to]
    targets = [np.tile(place, (len(m), 1)) if known else None for place in to]
    return [
        Measurements(m.q, "distance", distance=d, target=target, conditions=m.conditions, source=f"wire {k}")
        for k, (d, target) in enumerate(zip(lengths, targets, strict=True), 1)
    ]


def judged(robot: Robot, fit: Measurements, held_out: Measurements) -> tuple[float, float]:
    """Mean error at held-out poses [m], with the base where the tracker has it in the fit; error of the scale."""
    placed = identify(robot, fit, ("base",), loss="huber").robot
    p, _ = predicted(placed, held_out)
    assert held_out.position is not None
    a, b = (x - x.mean(axis=0) for x in (p, held_out.position))
    return float(errors(placed, held_out).mean()), float((a * b).sum() / (b * b).sum() - 1)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--poses", type=int, nargs="+", default=[60, 150, 400])
    parser.add_argument("--noise", type=float, nargs="+", default=[0.05, 0.2, 0.5])
    options = parser.parse_args()
    started = time.process_time()
    problem = read_problem(ROOT / "problems" / "ur10")
    every = [m for _, m in problem.parts()]
    m = max(every, key=len).positions_alone()
    m = replace(m, sigma=None)
    order = np.random.default_rng(0).permutation(len(m))
    held_out = m[np.sort(order[-HELD_OUT:])]
    print(f"{len(held_out)} poses held out of {m.source}; errors in mm, scale in um/m\n")
    print(f"{'instrument':24s}{'poses':>6s}{'error':>9s}{'of positions':>14s}{'scale':>8s}")
    for poses in options.poses:
        fit = m[np.sort(order[:poses])]
        reference = identify(problem.robot, fit, loss="huber", priors=True).robot
        before, _ = judged(problem.robot, fit, held_out)
        best, scale = judged(reference, fit, held_out)
        print(f"{'none: as it came':24s}{poses:6d}{1e3 * before:9.3f}")
        print(f"{'tracker':24s}{poses:6d}{1e3 * best:9.3f}{1.0:14.2f}{1e6 * scale:8.0f}")
        for count, known in ((1, False), (2, False), (3, False), (3, True)):
            for noise in options.noise:
                sets = wires(fit, places(reference, count), 1e-3 * noise, np.random.default_rng(count), known)
                found = identify(problem.robot, sets, loss="huber", priors=True).robot
                error, scale = judged(found, fit, held_out)
                name = f"{count} wire{'s' * (count > 1)}{', known' * known}, {noise:g} mm"
                print(f"{name:24s}{poses:6d}{1e3 * error:9.3f}{error / best:14.2f}{1e6 * scale:8.0f}", flush=True)
    fit = m[np.sort(order[:150])]
    to = places(identify(problem.robot, fit, loss="huber", priors=True).robot, 3)
    print("\ndiagnosis of 150 poses, and the error at the held-out poses with its causes in the model:")
    answers = {"tracker": diagnose(problem.robot, fit)}
    for noise in (0.05, 0.5):
        sets = wires(fit, to, 1e-3 * noise, np.random.default_rng(3))
        answers[f"3 wires, {noise:g} mm"] = diagnose(problem.robot, sets)
    for name, found in answers.items():
        named = ", ".join(c.label for c in found.causes) or "no cause named"
        error, scale = judged(found.apply(), fit, held_out)
        print(f"{name:24s}{len(fit):6d}{1e3 * error:9.3f}{'':14s}{1e6 * scale:8.0f}  {found.verdict}: {named}")
    print(f"\n{time.process_time() - started:.0f} s of CPU")


if __name__ == "__main__":
    main()
