"""Where the time of an identification goes: OMP_NUM_THREADS=1 python docs/studies/identify_time.py (half a minute)

The task of benchmarks.py at 500 poses, 27 parameters, positions, compiled kernels, beside its hand-made Gauss-Newton of
numpy, in turns and in one process. That has no loss robust to outliers, so here it is linear; the default, which looks
for outliers too, stands in a line of its own. Every function below is timed by a wrapper; its own time is without
that of the others below it. CPU time of one thread, medians; "x numpy" is in units of the median of the hand-made
solve. Wrappers take some time themselves: the whole without them stands in the last lines. Ipopt's own share is what a
solve takes whose functions answer from memory: Ipopt, its linear algebra (MUMPS), and CasADi's calls of Python.
"""

import argparse
import contextlib
import functools
import importlib
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent / "benchmarks"
sys.path[:0] = [str(HERE), str(HERE / "contenders")]

import numpy_handmade  # noqa: E402
from problem import make  # noqa: E402

import casadical  # noqa: E402
from casadical.core import mapped_function  # noqa: E402

# Label, module where the name is looked up, name there.
STAGES = (
    ("checks of the measurements", "measurements.measurements", "Measurements.__post_init__"),
    ("check against the nominal robot", "identification.identification", "check_against"),
    ("start of base and tool", "identification.sessions", "place_frames"),
    ("  placement in closed form", "identification.placement", "solve_placement"),
    ("list of parameters", "robot.robot", "Parameters"),
    ("numbers of the kernel", "identification.least_squares", "make_block"),
    ("kernels: model, residuals and Jacobian", "core.mapped_function", "MappedFunction.__call__"),
    ("Gram matrix and gradient", "identification.least_squares", "LeastSquares._summed"),
    ("triangular factor (QR)", "numpy.linalg", "qr"),
    ("independence of the columns", "identification.reduction", "analyse"),
    ("poorly determined ones", "identification.reduction", "drop_poor"),
    ("functions that Ipopt calls", "identification.solver", "_Evaluation.eval_buffer"),
    ("Ipopt and CasADi's calls", "identification.least_squares", "minimise"),
    ("choice of parameters, the rest", "identification.identification", "solve_without_outliers"),
    ("the calibrated robot", "robot.robot", "Robot.with_values"),
    ("identify, the rest", "identification.identification", "identify"),
)


class Stages:
    """Wrapped functions and the time of each."""

    def __init__(self) -> None:
        self.own: dict[str, float] = {}
        self._inside: list[float] = []

    def wrap(self, label: str, module: str, name: str) -> Callable[[], None]:
        """Time a function from now on; returns what undoes it."""
        owner = importlib.import_module(module if module.startswith("numpy") else f"casadical.{module}")
        *path, name = name.split(".")
        for part in path:
            owner = getattr(owner, part)
        plain = getattr(owner, name)

        @functools.wraps(plain, updated=())
        def timed(*args, **kwargs):
            began = time.thread_time()
            self._inside.append(0.0)
            try:
                return plain(*args, **kwargs)
            finally:
                took, below = time.thread_time() - began, self._inside.pop()
                self.own[label] = self.own.get(label, 0.0) + took - below
                if self._inside:
                    self._inside[-1] += took

        setattr(owner, name, timed)
        return lambda: setattr(owner, name, plain)


class NoClock:
    def __call__(self, _: str):
        return contextlib.nullcontext()

    def note(self, *_: object) -> None:
        pass


def ours(data, loss="linear"):
    from casadical.identification import identification

    joints = tuple(casadical.Joint(*row, lower=-7.0, upper=7.0) for row in data.dh)
    unknown = casadical.Placement(np.eye(4), "pose"), casadical.Placement(np.eye(4), "position")
    robot = casadical.Robot("UR10-like", joints, *unknown)

    def solve():
        measured = casadical.Measurements(q=data.q, kind="position", position=data.p)
        return identification.identify(robot, measured, ["kinematic"], loss=loss)

    return solve


def seconds(call: Callable[[], object]) -> float:
    began = time.thread_time()
    call()
    return time.thread_time() - began


def ipopt_alone(problem) -> Callable[[], object]:
    """The solve again, with answers that were computed before."""
    from casadical.identification.solver import minimise

    known: dict[bytes, tuple] = {}

    def answer(v):
        if v.tobytes() not in known:
            known[v.tobytes()] = problem.cost(v), problem.gradient(v)
        return known[v.tobytes()]

    scale = 0.5 * problem.residual_count
    return lambda: minimise(lambda v: answer(v)[0], lambda v: answer(v)[1], *problem.bounds, scale=scale)


def commands() -> None:
    """CPU time of commands as a user starts them: the best and the median of nine, with what is compiled in place."""
    goals = {"--help": 0.25, "calibrate problems/hh800": 6.0}
    for words, goal in goals.items():
        spent = []
        for _ in range(9):
            before = sum(os.times()[2:4])
            program = [sys.executable, "-c", "from casadical.cli import main; main()", *words.split()]
            subprocess.run(program, cwd=HERE.parents[2], check=True, stdout=subprocess.DEVNULL)
            spent.append(sum(os.times()[2:4]) - before)
        print(f"casadical {words}: {min(spent):.2f} s at best, {np.median(spent):.2f} s median; goal {goal} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--poses", type=int, default=500)
    parser.add_argument("--repeats", type=int, default=300)
    parser.add_argument("--commands", action="store_true", help="CPU of two commands in its place")
    options = parser.parse_args()
    if options.commands:
        commands()
        return
    mapped_function.LOOK_FROM = mapped_function.COMPILE_FROM = 1
    data, _ = make(options.poses, 1)
    # The given robot is new in each run: what it computes once counts.
    for _ in range(3):
        found = ours(data)()
    alone = ipopt_alone(found.problem)
    numpy_runs, our_runs, default_runs, ipopt_runs = [], [], [], []
    for _ in range(options.repeats):
        numpy_runs.append(seconds(lambda: numpy_handmade.contend(data, NoClock())))
        our_runs.append(seconds(ours(data)))
        default_runs.append(seconds(ours(data, "auto")))
        ipopt_runs.append(seconds(alone))
    stages, shares = Stages(), []
    undo = [stages.wrap(*stage) for stage in STAGES]
    for _ in range(options.repeats):
        stages.own = {}
        ours(data)()
        shares.append([stages.own.get(label, 0.0) for label, _, _ in STAGES])
    for one in undo:
        one()
    unit = float(np.median(numpy_runs))
    print(f"{options.poses} poses, 27 parameters, {options.repeats} runs in turns; numpy {1e3 * unit:.2f} ms")
    print(f"{'own time of':42}{'ms':>7}{'x numpy':>9}")
    for (label, _, _), own in zip(STAGES, np.median(shares, axis=0), strict=True):
        print(f"{label:42}{1e3 * own:7.3f}{own / unit:9.3f}")
    total = float(np.median(np.sum(shares, axis=1)))
    print(f"{'sum, with the wrappers':42}{1e3 * total:7.3f}{total / unit:9.3f}")
    for label, runs in (
        ("identify, without wrappers", our_runs),
        ("identify with a search for outliers", default_runs),
        ("Ipopt alone, answers from memory", ipopt_runs),
    ):
        ratio = np.median(np.array(runs) / np.array(numpy_runs))
        print(
            f"{label:42}{1e3 * float(np.median(runs)):7.3f}{float(np.median(runs)) / unit:9.3f}"
            f"   (median of the ratios run by run {ratio:.2f}; of the least times {min(runs) / min(numpy_runs):.2f})"
        )


if __name__ == "__main__":
    main()
