"""Processes killed at every system call of their writing: python docs/studies/kills.py [--kills 2000] [--made-up]

A shim (kills.c, loaded by LD_PRELOAD; gcc and Linux are needed) kills a process at its n-th call that changes files:
open, write (half of it is written), fsync, rename, exchange, link, unlink, mkdir, rmdir, truncate, chmod. Each writer
of sets is killed at every n until it comes to its end; from then on at a random n, and what is left is then written to
by a second process that is killed at a random n too. After each kill the files are read as they lie on the disk:

- old, new, absent: all files of the set are those of before, or of the new one, or there are none
- by journal: renames were under way, and the package's own reader finished them; then all are new
- MIXED: anything else; LOST: a file of another user, or an answer that was complete, is not what it was

The real results of a calibration, a plan, an export, a new problem, a blind check's answers and rows of a fleet's store
are written; with --made-up, small files in place of the sets. As a control, files that are written one after the other
are killed too: of them mixed sets must be found.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
FLEET = "fleet, row by row"
FOREIGN = {"notes.txt": b"mine", "kept/data.csv": b"1,2,3\n"}


@dataclass(frozen=True)
class Writer:
    """A set of files in two versions, and how it is written.

    folder : where, below the scratch folder; old, new : content by name in it; before : whether the old one is there
    write : writes a version into the folder
    """

    name: str
    folder: str
    old: Mapping[str, bytes]
    new: Mapping[str, bytes]
    write: Callable[[Path, Mapping[str, bytes]], None]
    before: bool = True


def write_set(folder: Path, files: Mapping[str, bytes]) -> None:
    """As `Calibration.write`, `write_c`, `new_problem` and the commands with `--out DIR` do."""
    from casadical.core.files import claimed, write_together

    with claimed([folder]):
        write_together({folder / name: blob for name, blob in files.items()})


def write_beside(folder: Path, files: Mapping[str, bytes]) -> None:
    """As `plan` and `--json` with `--report` do, in a folder that is not theirs."""
    from casadical.core.files import write_together

    write_together({folder / name: blob for name, blob in files.items()})


def in_folder(files: Mapping[Path, str], folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): text.encode() for path, text in files.items()}


def write_plainly(folder: Path, files: Mapping[str, bytes]) -> None:
    """The control: what nobody should do."""
    for name, blob in files.items():
        (folder / name).write_bytes(blob)


def made_up() -> Iterator[Writer]:
    """Small sets that need no result."""
    sets = [{f"{k}.txt": f"{version} {k}".encode() * 50 for k in range(4)} for version in ("old", "new")]
    yield Writer("folder, new", "made/results", *sets, write_set, before=False)
    yield Writer("folder, again", "results", *sets, write_set)
    yield Writer("folder, the working one", ".", *sets, write_set)
    yield Writer("files, new", ".", *sets, write_beside, before=False)
    yield Writer("files, again", ".", *sets, write_beside)


def control() -> Writer:
    """Files that are written one after the other."""
    old, new = ({f"{k}.txt": f"{version} {k}".encode() * 50 for k in range(4)} for version in ("old", "new"))
    return Writer("control", "results", old, new, write_plainly)


def writers() -> Iterator[Writer]:
    """Real results, each in two versions."""
    from casadical import calibrate, read_robot
    from casadical.export import write_c
    from casadical.export.controller.commands import Sources, command_of
    from casadical.project.new import new_problem
    from casadical.project.planning import plan

    place = Path("/place")
    results = [in_folder(calibrate(ROOT / "problems/planar", loss=k).files(place), place) for k in ("linear", "huber")]
    yield Writer("results, new folder", "made/results", *results, write_set, before=False)
    yield Writer("results, again", "results", *results, write_set)
    yield Writer("results in the working folder", ".", *results, write_set)
    robot = read_robot(ROOT / "problems/planar/robot.toml")
    plans = [in_folder(plan(robot, n, order=False).files(place / "plan.csv"), place) for n in (6, 8)]
    yield Writer("plan, new files", ".", *plans, write_beside, before=False)
    yield Writer("plan, again", ".", *plans, write_beside)
    with tempfile.TemporaryDirectory() as scratch:
        exports, problems = [], []
        for k in ("linear", "huber"):
            done = calibrate(ROOT / "problems/planar", loss=k)
            done.write(Path(scratch) / k)
            sources = Sources(Path(scratch) / k / "KM.robot.toml", ROOT / "problems/planar/robot.toml")
            made = write_c(command_of(sources, 2), Path(scratch) / f"c_{k}", name="planar", vectors=200)
            exports.append({name: (made.folder / name).read_bytes() for name in made.written})
            new_problem(Path(scratch) / f"new_{k}", seed=len(k))
            problems.append({p.name: p.read_bytes() for p in (Path(scratch) / f"new_{k}").iterdir()})
    yield Writer("export, again", "export", *exports, write_set)
    yield Writer("problem, new folder", "problem", *problems, write_set, before=False)


def state(writer: Writer, folder: Path, *, journal: bool = False) -> str:
    """What a reader finds: old, new, absent or MIXED."""
    if journal:
        from casadical.core.files import settle

        settle(folder)
    names = {*writer.old, *writer.new}
    found = {name: (folder / name).read_bytes() for name in names if (folder / name).is_file()}
    if not found:
        return "absent"
    return "old" if found == writer.old else "new" if found == writer.new else "MIXED"


def killed_at(n: int, act: Callable[[], None]) -> bool:
    """Whether the act, in a process of its own, was killed at its n-th call; else it came to its end."""
    process = os.fork()
    if process == 0:
        try:
            ctypes.CDLL(None).casadical_arm(ctypes.c_long(n))
            act()
        except BaseException as error:
            print(f"failed instead of being killed: {error!r}", file=sys.stderr)
            os._exit(1)
        os._exit(0)
    _, status = os.waitpid(process, 0)
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL:
        return True
    if os.waitstatus_to_exitcode(status):
        raise RuntimeError("the writer failed")
    return False


def trial(writer: Writer, scratch: Path, kills: tuple[int, ...]) -> tuple[bool, str]:
    """Kill writers of one folder one after the other; whether the first was killed at all, and what was then found."""
    place = scratch / "place"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    os.chdir(place)
    folder = place / writer.folder
    present = writer.old if writer.before else {}
    mine = FOREIGN if writer.before else {}
    for name, blob in (present | mine).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(blob)
    killed, found = False, ""
    for n in kills:
        hit = killed_at(n, lambda: writer.write(folder, writer.new))
        killed |= hit
        found = state(writer, folder)
        if found == "MIXED" and state(writer, folder, journal=True) == "new":
            found = "by journal"
        if (found == "MIXED") or (found == "absent" and writer.before):
            return killed, "MIXED"
        if any(not (folder / name).is_file() or (folder / name).read_bytes() != blob for name, blob in mine.items()):
            return killed, "LOST"
    writer.write(folder, writer.new)
    strays = list(place.rglob(".casadical-*"))
    if state(writer, folder) != "new" or strays:
        return killed, f"MIXED after the next writer: {[p.name for p in strays]}"
    return killed, found


def answers_trial(scratch: Path, n: int) -> tuple[bool, str]:
    """Kill a process that adds answers; none that was complete may be lost, and the next process goes on."""
    from casadical.blind_check.protocol import json_line, read_answers, whole_lines
    from casadical.core.files import appending

    path = scratch / "answers.jsonl"
    unseen = {"base_mm": [[1.0, 2.0, 3.0]] * 50, "with_causes_mm": [[1.0, 2.0, 3.0]] * 50}

    def add(numbers: range) -> None:
        with appending(path, whole_lines(path)) as line:
            if not path.stat().st_size:
                line(json_line({"key_sha256": "0" * 64, "by": "study"}))
            for k in numbers:
                gap = {"before": 0.1 * k, "after": 0.01}
                line(json_line({"campaign": f"C{k}", "verdict": "none", "gap_mm": gap, "unseen": unseen}))

    def known() -> set[str]:
        return set(read_answers(path)[1]) if path.exists() and whole_lines(path) else set()

    path.unlink(missing_ok=True)
    add(range(5))
    before = known()
    hit = killed_at(n, lambda: add(range(5, 10)))
    left = known()
    if not before <= left:
        return hit, "LOST"
    add(range(len(left), 10))
    complete = known() == {f"C{k}" for k in range(10)}
    return hit, ("old" if left == before else "by lines") if complete else "LOST"


def fleet_trial(scratch: Path, *kills: int) -> tuple[bool, str]:
    """Kill processes that add rows to a fleet's store one after the other; each robot of a complete row stays, and the
    next process, which computes what is missing, goes on."""
    from casadical.fleet.store import NOTHING, add, opened, rows

    store, names = scratch / "store.parquet", [f"R{k}" for k in range(8)]
    shutil.rmtree(store, ignore_errors=True)

    def known() -> set[str]:
        return set(rows(store, ["robot"])["robot"]) if store.exists() else set()  # raises for a part that is damaged

    def go_on(most: int) -> None:
        with opened(store):
            for name in [n for n in names if n not in known()][:most]:
                add(store, [NOTHING | {"robot": name, "status": "ok", "fingerprint": name}])

    go_on(3)
    hit, left = False, known()
    for n in kills:
        hit |= killed_at(n, lambda: go_on(8))
        before, left = left, known()
        if not before <= left:
            return hit, "LOST"
    go_on(8)
    strays = list(store.glob(".casadical-*"))
    return hit, ("old" if len(left) == 3 else "by lines") if known() == set(names) and not strays else "LOST"


def study(kills: int, seed: int, small: bool) -> Counter[tuple[str, str]]:
    """Counts by writer and what was found, of so many kills or more; a tenth of them are a fleet's."""
    rng = random.Random(seed)
    found: Counter[tuple[str, str]] = Counter()
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        every = list(made_up() if small else writers())
        trials: dict[str, Callable[..., tuple[bool, str]]] = {
            **{w.name: lambda *n, w=w: trial(w, scratch, n) for w in every},
            "answers, line by line": lambda *n: answers_trial(scratch, n[0]),
            FLEET: lambda *n: fleet_trial(scratch, *n),
        }
        calls: dict[str, int] = {}
        for label, act in trials.items():
            for n in range(1, 10_000):
                hit, what = act(n)
                if not hit:
                    calls[label] = n - 1
                    break
                found[label, what] += 1
        print("system calls at which each was killed once:")
        print("\n".join(f"  {label}: {count}" for label, count in calls.items()))
        plain = [trial(control(), scratch, (n,)) for n in range(1, 9)]
        print(f"control: {sum(what.startswith('MIXED') for hit, what in plain if hit)} of {len(plain)} sets mixed")
        while sum(found.values()) < kills:
            of_fleet = sum(count for (label, _), count in found.items() if label.startswith(FLEET))
            label = FLEET if of_fleet < kills / 10 else rng.choice(every).name
            hit, what = trials[label](*(rng.randint(1, calls[label]) for _ in range(2)))
            if hit:
                found[f"{label}, two killed", what] += 1
        os.chdir(ROOT)
    return found


def child(kills: int, seed: int, small: bool) -> int:
    """The study, in a process with the shim; 1 where a set was mixed or anything lost."""
    found = study(kills, seed, small)
    words = ("old", "new", "absent", "by journal", "by lines", "MIXED", "LOST")
    print(f"{'':44}" + "".join(f"{word:>12}" for word in words))
    for name in sorted({writer for writer, _ in found}):
        row = [sum(c for (w, what), c in found.items() if w == name and what.startswith(word)) for word in words]
        print(f"{name:44}" + "".join(f"{count:>12}" for count in row))
    bad = {key: count for key, count in found.items() if key[1].startswith(("MIXED", "LOST"))}
    print(f"{sum(found.values())} kills, {sum(bad.values())} mixed or lost {bad or ''}")
    return 1 if bad else 0


def main() -> int:
    """Build the shim, and run the study in a process that loads it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--made-up", action="store_true")
    given = parser.parse_args()
    if "casadical_shim" in os.environ:
        return child(given.kills, given.seed, given.made_up)
    with tempfile.TemporaryDirectory() as scratch:
        shim = Path(scratch) / "kills.so"
        source = Path(__file__).with_suffix(".c")
        subprocess.run(["gcc", "-O1", "-fPIC", "-shared", "-o", str(shim), str(source), "-ldl"], check=True)
        environment = {**os.environ, "LD_PRELOAD": str(shim), "casadical_shim": "1", "OMP_NUM_THREADS": "1"}
        return subprocess.run([sys.executable, *sys.argv], env=environment, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
