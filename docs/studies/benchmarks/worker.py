"""Runs one contender on one data set in a process of its own: worker.py CONTENDER_FILE VARIANT DATA.npz RESULT.json."""

import importlib.metadata
import importlib.util
import json
import os
import resource
import sys
import time
import traceback
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from declared import declared
from problem import Data


def cpu_seconds() -> float:
    """CPU time of this process and of the children it has waited for (a compiler, say) [s]."""
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def peak_mb() -> float:
    """Highest resident memory of this process so far [MB].

    Linux's VmHWM where there is one: ru_maxrss also remembers what the parent held when it forked.
    """
    try:
        status = Path("/proc/self/status").read_text()
        return int(status.split("VmHWM:")[1].split()[0]) / 1024
    except (OSError, IndexError):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


class Clock:
    """Adds up wall and CPU seconds under the names "build" and "solve", and takes notes for the table."""

    def __init__(self) -> None:
        self.wall = {"build": 0.0, "solve": 0.0}
        self.cpu = {"build": 0.0, "solve": 0.0}
        self.notes: dict[str, str] = {}

    @contextmanager
    def __call__(self, stage: str):
        wall, cpu = time.perf_counter(), cpu_seconds()
        yield
        self.wall[stage] += time.perf_counter() - wall
        self.cpu[stage] += cpu_seconds() - cpu

    def note(self, name: str, value: object) -> None:
        """Something to say beside the figures, for example how many parameters were estimated."""
        self.notes[name] = str(value)


def load(path: Path):
    """The contender's module, imported from its file."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run(path: Path, variant: str, data: Data, write, repeats: int, budget: float) -> None:
    """First run, then `repeats` more and for a second at least, unless the time budget [s] ends; reports after each."""
    settings = declared(path)
    missing = [pip for module, pip in settings["NEEDS"].items() if importlib.util.find_spec(module) is None]
    if missing:
        write({"status": "not installed: pip install " + " ".join(missing)})
        return
    started = cpu_seconds()
    contender = load(path)
    import_s = cpu_seconds() - started
    versions = {pip: importlib.metadata.version(pip) for pip in ["numpy", *settings["NEEDS"].values()]}
    report = {
        "status": "ok",
        "versions": versions,
        "import_s": import_s,
        "baseline_mb": peak_mb(),
        "runs": [],
    }
    started = time.perf_counter()
    while len(report["runs"]) <= repeats or time.perf_counter() - started < 1.0:
        clock = Clock()
        predicted = np.asarray(contender.contend(data, clock, **settings["VARIANTS"][variant]))
        report.setdefault("peak_mb", peak_mb())  # of the first run
        report.setdefault("predicted", predicted.tolist())
        spread = float(np.abs(predicted - report["predicted"]).max())
        report["runs"].append({"wall": clock.wall, "cpu": clock.cpu, "spread_m": spread})
        report["notes"] = clock.notes
        write(report)
        if time.perf_counter() - started > budget:
            return


def main() -> None:
    """Reads the job from the command line; whatever goes wrong is written down as the result."""
    path, variant, data_path, result_path, repeats, budget, memory_mb = sys.argv[1:]
    limit = int(float(memory_mb) * 2**20)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

    def write(report: dict) -> None:
        temporary = Path(result_path + ".part")
        temporary.write_text(json.dumps(report))
        os.replace(temporary, result_path)

    try:
        with np.load(data_path) as arrays:
            data = Data(**arrays)
        run(Path(path), variant, data, write, int(repeats), float(budget))
    except BaseException as error:  # also MemoryError and SystemExit of third-party code
        traceback.print_exc()
        what = str(error).strip().splitlines()
        write({"status": f"failed: {type(error).__name__}: {what[0] if what else ''}"[:160]})


if __name__ == "__main__":
    main()
