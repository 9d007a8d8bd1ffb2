"""Advice of a calibration against the truth: made-up users with few poses, much noise, or a robot as it was drawn.

    python docs/studies/advice.py --users 200 [--first 0] > docs/studies/advice.txt

A user has an arm, an instrument and a table as in `users.py`, without slips and in a plain form, and
8 to 60 poses (wires: three times as many, at most 110). One sigma of the noise is between 10 um and
1 mm (camera: 40 um to 4 mm). A sixth of the arms are exactly their drawing and stiff, a sixth
depart from it by 0.03 to 0.3 of the noise and are stiff; the rest depart by 0.3 to 2 times what
`users.py` draws. `new` and `calibrate` are run in this process; what the screen says is compared
with the true errors, without noise, at 1000 poses that were never measured: of the robot before
(base and tool fitted) and after. The truth is better or worse if the mean of the paired differences
exceeds twice its standard error.

The rules were committed before the first run that counts. A statement is false where the screen says:

- keep: held-out errors grow; a refusal to write; "do not use METHOD"; the calibration hardly helps;
  the same error before and after; and the calibrated robot (the method's, of "do not use") is
  truly better, by more than a tenth. Of users 0 to 49 nothing to calibrate to within x mm, and the
  nominal geometry is right as far as these poses tell, counted here, too; two of them were false.
  Since then the first is said as below, and the second is not counted: without x it asks for more
  poses, with x it is judged by x.
- better: errors of held-out poses fall, and the calibrated robot is truly worse.
- open: both robots are equally good to within x mm, and their true mean errors differ by more, or
  the nominal robot, placed as well as it can be at the 1000 poses, has an rms error above 2 x.
- more: if the difference stays, n more poses would tell; it is, of readings with noise, at least as
  great in truth, and with four times as many as are then held out it would still be within the
  uncertainty that `calibrate` states. Up to user 1014 the words did not say "if", and the true
  difference was not asked for; one statement was false.

"Cannot tell" is never false; it is counted, and how often a paired comparison of the same held-out
poses could tell, at twice its standard error.
"""

import argparse
import contextlib
import io
import re
import tempfile
import warnings
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import users

from casadical import Robot, calibrate, read_problem
from casadical.cli import app as casadical
from casadical.core.basics import CasadicalError
from casadical.core.reporting.result import plain_text
from casadical.identification import predicted
from casadical.identification.accuracy import errors
from casadical.measurements.reading import from_table
from casadical.project.outcome import judged_on

TENTH, OPEN, FOUR, TESTED = 0.1, 2.0, 4.0, 1000
# Statement -> what the screen says, in one line.
SAYS = {
    "equally good": r"equally good to within ([\d.]+) mm",
    "nominal is right": r"The nominal geometry is right",
    "hardly helps": r"The calibration hardly helps",
    "method worse": r"do not use (\w+)\.robot",
    "cannot tell": r"cannot tell which is better",
    "more would": r"if this difference stays, some (\d+) more would",
    "undecided": r"cannot be decided whether the calibration helps",
    "falls": r"On \d+ poses that were held out, the mean [\w ]+ falls from",
    "grows": r"On \d+ poses that were held out, the mean [\w ]+ grows from",
    "same": r"mm, before and with",
    "not held out": r"On the \d+ poses it was identified from",
}  # fmt: skip


def drawn(number: int) -> tuple[users.User, str, float]:
    """The user of a number, its name with how the arm departs from the drawing, one sigma of the noise [m]."""
    rng = np.random.default_rng([2614, number])
    user = users.drawn(5_000_000 + number)
    noise = float(np.exp(rng.uniform(np.log(1e-5), np.log(1e-3)))) * (4 if user.instrument == "camera" else 1)
    how = ("as drawn", "nearly", "departs", "departs", "departs", "departs")[number % 6]
    nominal, n = user.nominal, len(user.nominal.rows)
    off = user.true.rows - nominal.rows
    size = {"as drawn": 0.0, "nearly": noise / 5e-4 * rng.uniform(0.03, 0.3)}.get(how, np.exp(rng.uniform(-1.2, 0.7)))
    soft = user.true.compliance if how == "departs" else np.zeros(n)
    true = replace(user.true, rows=nominal.rows + size * off, compliance=soft)
    count = int(np.round(np.exp(rng.uniform(np.log(8), np.log(60)))))
    count = min(count * (3 if user.instrument == "wires" else 1), len(user.q))
    q = user.q[:count]
    seen = true.poses(q)
    seen[:, :3, 3] += rng.normal(0, noise, (count, 3))
    if user.instrument == "camera":
        seen[:, :3, :3] = seen[:, :3, :3] @ np.array([users._turn(v) for v in rng.normal(0, 2 * noise, (count, 3))])
    user = replace(user, true=true, q=q, seen=seen, slips={}, typed=False, raw="")
    kind = f"{user.name.partition(',')[0]}, {user.instrument}{', URDF' * user.urdf}"
    return user, f"{kind}, {how}, {count} poses, noise {1e3 * noise:.2g} mm", noise


def off_by(robot: Robot, user: users.User, q: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """True error vectors [m] of a robot at readings q [rad], shape (m, 3); truth : positions [m].

    Lengths to unknown places do not tell where the robot stands: its positions are laid on the true ones.
    """
    columns = [*(f"q{k}_rad" for k in range(1, q.shape[1] + 1)), "x_m", "y_m", "z_m"]
    m = from_table(pd.DataFrame(np.column_stack([q, truth]), columns=columns), q.shape[1], "position")
    found = predicted(robot, m)[0]
    if user.instrument == "wires":
        a, b = found - found.mean(axis=0), truth - truth.mean(axis=0)
        U, _, Vt = np.linalg.svd(a.T @ b)
        U[:, 2] *= np.sign(np.linalg.det(U @ Vt))
        return a @ U @ Vt - b
    return found - truth


def direction(before: np.ndarray, after: np.ndarray) -> tuple[int, float]:
    """1 where errors after are lower, -1 where higher, 0 where they cannot be distinguished; and by what share."""
    gain = before - after
    sure = abs(gain.mean()) > 2 * gain.std(ddof=1) / np.sqrt(len(gain)) + 1e-12
    return int(np.sign(gain.mean())) if sure else 0, float(gain.mean() / before.mean())


def best_placed(user: users.User, q: np.ndarray, truth: np.ndarray) -> float:
    """Rms error [m] of the nominal robot with base (as any affine map) and tool fitted to the true positions."""
    T = replace(user.nominal, base=np.eye(4), tool=np.eye(4)).poses(q)
    A = np.zeros((len(q), 3, 15))
    for k in range(3):
        A[:, k, 4 * k : 4 * k + 3], A[:, k, 4 * k + 3] = truth, 1.0
    A[:, :, 12:] = -T[:, :3, :3]
    A, b = A.reshape(3 * len(q), -1), T[:, :3, 3].ravel()
    return float(np.sqrt(3 * np.mean((A @ np.linalg.lstsq(A, b, rcond=None)[0] - b) ** 2)))


def needed(
    noise: float, wires: bool, before: np.ndarray, after: np.ndarray, rng: np.random.Generator
) -> tuple[float, float]:
    """True difference of mean errors [m], and held-out poses from which it exceeds the uncertainty that is stated.

    before, after : true error vectors, shape (m, 3) [m]
    """
    noises, line = rng.normal(0, noise, before.shape), rng.normal(size=before.shape)
    line /= np.linalg.norm(line, axis=1, keepdims=True)
    a, b = (
        np.abs(((e - noises) * line).sum(axis=1)) if wires else np.linalg.norm(e - noises, axis=1)
        for e in (before, after)
    )
    off = float(abs(a.mean() - b.mean()))
    return off, float(4 * (a.var() + b.var())) / max(off**2, 1e-20)


def tried(number: int) -> tuple[str, list[str], Counter[str]]:
    """A line on a user, what was false, and what was said."""
    user, name, noise = drawn(number)
    rng = np.random.default_rng([2615, number])
    q = rng.uniform(*users.inner(user.limits), (TESTED, user.q.shape[1]))
    truth = user.true.poses(q)[:, :3, 3]
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        poses = users.table(user, user.q, user.seen, wrong=False)
        given = [*users.robot_file(folder, user), *users.written(folder, user, poses), "--yes"]
        screen = io.StringIO()
        with contextlib.chdir(folder), contextlib.redirect_stdout(screen), contextlib.redirect_stderr(screen):
            try:
                casadical(["new", "arm", *given], standalone_mode=False)
                found = calibrate(read_problem(folder / "arm"))
            except CasadicalError as error:
                return f"{number:3d} {name}: refused: {str(error)[:100]}", [], Counter(["refused"])
    words = " ".join((plain_text(found.brief()) + " " + found.worse).split())
    said = {key: match for key, pattern in SAYS.items() if (match := re.search(pattern, words))}
    if found.worse:
        said["refused to write"] = re.match("", "")
    result = found.identification
    vectors = [off_by(robot, user, q, truth) for robot in (result.placed, result.robot)]
    before, after = (np.linalg.norm(e, axis=1) for e in vectors)
    true, share = direction(before, after)
    false = []
    discouraging = ("hardly helps", "grows", "same", "refused to write")
    if true > 0 and share > TENTH:
        false += [f"keep: {key}, truly {share:.0%} better" for key in discouraging if key in said]
    if "method worse" in said:
        other = off_by(found.identifications[said["method worse"][1]].robot, user, q, truth)
        far, by = direction(before, np.linalg.norm(other, axis=1))
        false += [f"keep: method worse, truly {by:.0%} better"] if far > 0 and by > TENTH else []
    if "falls" in said and true < 0:
        false.append(f"better: truly {-share:.0%} worse")
    if "equally good" in said:
        x, rms = 1e-3 * float(said["equally good"][1]), best_placed(user, q, truth)
        false += [f"open: {1e3 * x:.4f} mm, placed {1e3 * rms:.4f}"] if rms > OPEN * x else []
        false += [f"open: {1e3 * x:.4f} mm, {share:+.0%}"] if abs(after.mean() - before.mean()) > x else []
    held = [m for part, m in found.problem.parts() if part.startswith("report")]
    paired = 0
    if held:
        paired, _ = direction(*(np.concatenate([errors(r, m) for m in held]) for r in (result.placed, result.robot)))
    if "more would" in said:
        n = sum(map(len, held)) + int(said["more would"][1])
        _, read, also, _ = judged_on(found.accuracies)
        off, near = needed(noise, user.instrument == "wires", *vectors, rng)
        if off >= abs(read.mean - also.mean) and near > FOUR * n:
            false.append(f"more: {n} held out, truly {near:.0f}")
    counted = Counter([*said, {1: "truly better", 0: "truly equal", -1: "truly worse"}[true]])
    if "cannot tell" in said:
        counted[f"cannot tell, truly {true:+d}"] += 1
        counted[f"cannot tell, paired {paired:+d}"] += 1
        counted["cannot tell, paired against the truth"] += paired * true < 0
    means = f"{1e3 * before.mean():.4f} -> {1e3 * after.mean():.4f} mm"
    return f"{number:3d} {name}: {', '.join(said)}; truly {means}", false, counted


def main() -> None:
    """Print a line for each user, counts of statements, and the false ones by kind."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--users", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    counted, wrong = Counter[str](), Counter[str]()
    for number in range(asked.first, asked.first + asked.users):
        line, false, said = tried(number)
        print(line + "".join(f"\n    FALSE: {text}" for text in false), flush=True)
        counted += said
        wrong.update({text.partition(":")[0] for text in false})
    print(f"{asked.users} users; said: {', '.join(f'{key} {n}' for key, n in sorted(counted.items()))}")
    print(f"false: {', '.join(f'{key} {wrong[key]}' for key in ('keep', 'better', 'open', 'more'))}")


if __name__ == "__main__":
    main()
