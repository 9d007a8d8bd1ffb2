"""Causes under other noise than the usual: python docs/studies/forms_of_noise.py [--keep FILE] [--seconds S] [--table]

Again until all are done. Every fourth practice and sealed campaign lends its readings and logged columns. Positions are
those of the calibrated base model with joints that repeat to 4 urad and a noise of 20 um a coordinate:

- plain: normal and independent
- tails: Student's t of three degrees of freedom, alike for the three coordinates of a pose
- scatter: plain, and one joint that repeats so badly that it moves the point by 60 um or so
- follows: of which .7 stays from pose to pose

with nothing in it, or with one effect of the list in one joint, as in where_known.py, 1 to 4 times the noise as the
base model leaves it. Right is a campaign whose named causes are that effect and outliers at most; "named" counts
those whose effect is among the causes, "false" those with any other listed cause. Laws are not searched. Seed 5 was for
practice; 6 judges.
"""

import argparse
import zlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from campaign_robots import campaigns
from kept import Row, add_options, rows_of
from where_known import Known, effect, known

from casadical import InputError, diagnose
from casadical.core.basics import Array
from casadical.identification.accuracy import predicted

NOISE, REPEATS, SCATTER, STAYS = 20e-6, 4e-6, 100e-6, 0.7
FORMS = ("plain", "tails", "scatter", "follows")


def noise(form: str, k: Known, rng: np.random.Generator) -> Array:
    """Of the positions, shape (n, 3) [m]."""
    n = len(k.m)
    white = NOISE * rng.standard_normal((n, 3))
    if form == "tails":
        return np.asarray(white * np.sqrt(3 / rng.chisquare(3, (n, 1))))
    if form == "scatter":
        return white + k.moved(int(rng.choice(k.joints)), SCATTER * rng.standard_normal(n))
    if form == "follows":
        for i in range(1, n):
            white[i] = STAYS * white[i - 1] + np.sqrt(1 - STAYS**2) * white[i]
    return white


def judged(entry: tuple[Path, str, bool, int]) -> Row:
    path, form, hidden, seed = entry
    rng = np.random.default_rng([seed, zlib.crc32(path.stem.encode()), FORMS.index(form), hidden])
    try:
        k = known(path)
        repeats = REPEATS * rng.standard_normal((len(k.m), k.robot.n, 1))
        own = noise(form, k, rng) + (k.found.case.whole.Jq @ repeats)[:, :, 0]
        label, shift = "", np.zeros_like(own)
        if hidden:
            label, _, shift = effect(k, k.joints, float(np.sqrt(np.mean(own**2))), rng)
        found = diagnose(
            k.robot, replace(k.m, position=predicted(k.found.case.robot, k.m)[0] + own + shift), laws=False
        )
    except InputError as error:
        return {"form": form, "refused": str(error)}
    causes = [c.label for c in found.causes]
    return {"form": form, "hidden": label, "verdict": found.verdict, "causes": causes}


def table(rows: Sequence[Row]) -> None:
    print(f"{'':10}{'nothing':>9}{'false':>7}{'unknown':>9}{'one effect':>13}{'right':>7}{'named':>7}{'false':>7}")
    for form in FORMS:
        clean = [r for r in rows if r["form"] == form and r.get("hidden") == ""]
        one = [r for r in rows if r["form"] == form and r.get("hidden")]
        others = [{*r["causes"]} - {r["hidden"], "outliers"} for r in (*clean, *one)]
        false, named = [bool(o) for o in others], [r["hidden"] in r["causes"] for r in one]
        misled = sum(false[len(clean) :])
        right = sum(n and not f for n, f in zip(named, false[len(clean) :], strict=True))
        unknown = sum(r["verdict"] == "unknown" for r in clean)
        print(
            f"{form:10}{len(clean):9}{sum(false[: len(clean)]):7}{unknown:9}"
            f"{len(one):13}{right:7}{sum(named):7}{misled:7}"
        )
    for r in rows:
        if "refused" in r:
            print(f"left out: {r['name']}: {r['refused']}")
        elif wrong := {*r["causes"]} - {r["hidden"], "outliers"}:
            print(f"{r['name']}: {r['hidden'] or 'nothing'} is {', '.join(sorted(wrong))}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=6)
    add_options(parser, "forms_of_noise")
    given = parser.parse_args()
    todo = [
        (f"{path.stem} {form} {'one' if hidden else 'nothing'}", (path, form, hidden, given.seed))
        for path in campaigns([])[::4]
        for form in FORMS
        for hidden in (False, True)
    ]
    rows = rows_of(todo, judged, given)
    print(f"{len(rows)} of {len(todo)} done")
    table(rows)


if __name__ == "__main__":
    main()
