"""What a campaign cannot show, and what it rules out."""

import pandas as pd

from casadical.diagnosis.candidates import gathered
from casadical.diagnosis.isolability import Isolability, of_case
from casadical.diagnosis.result import Diagnosis, Unlisted
from casadical.identification.undetermined import undetermined

# An effect is invisible if the base absorbs so much of it, or if it must be so many times its usual size to be found.
ABSORBED, OUT_OF_REACH = 0.98, 5.0
# Effects below this rms [mm] move nothing.
NO_MARK = 1e-6
# Multiples of its usual size from which a cause is ruled out.
TIMES = (1.0, 2.0, OUT_OF_REACH)


def cannot_tell(d: Diagnosis) -> tuple[str, ...]:
    """What these kinds of readings cannot tell at all, each with what would; the ends of "these data cannot ..."."""
    return tuple(undetermined(d.identification.measurements, d.identification.unknown_points))


def indistinguishable(d: Diagnosis, poses: Isolability | None) -> dict[str, str]:
    """Label of a cause -> those that these data cannot tell from it, with the share that looks alike."""
    table = poses.alike if poses else pd.DataFrame()
    return {
        c.label: ", ".join(
            f"{k} ({100 * float(table.loc[c.label, k]):.0f} % similar here)"  # type: ignore[arg-type]
            if c.label in table.index and k in table.columns
            else k
            for k in c.indistinguishable
        )
        for c in d.causes
        if c.indistinguishable
    }


def invisible(d: Diagnosis, poses: Isolability | None) -> dict[str, str]:
    """Why -> effects that these poses cannot show, those of several joints gathered; claimed causes left out."""
    if poses is None:
        return {}
    seen = poses.effects.drop(index=[c.label for c in d.causes], errors="ignore")
    idle = seen["size_mm"] < NO_MARK
    absorbed = ~idle & (seen["absorbed"] > ABSORBED)
    weak = ~idle & ~absorbed & (seen["findable_from"] > OUT_OF_REACH)
    reasons = {
        "as nothing here causes them (no masses in the robot file, an idle joint)": seen.index[idle],
        f"as the base model takes up {100 * ABSORBED:.0f} % or more of each in these poses": seen.index[absorbed],
        f"against this noise, unless {OUT_OF_REACH:.0f} times their usual size": seen.index[weak],
    }
    return {why: gathered(labels) for why, labels in reasons.items() if len(labels)}


def ruled_out(d: Diagnosis, unlisted: Unlisted | None) -> dict[str, list[str]]:
    """Listed causes that are not there: multiple of the usual size -> labels that would be found from there on.

    Nine times in ten, in these poses, beside the named causes and the description of the unknown; and the evidence is
    against each of them. What the description takes up, as a curve of one joint does its gear, is not ruled out.
    """
    if unlisted is None or unlisted.beside is None:
        return {}
    noise = unlisted.beside.noise[""]
    poses = of_case(d.case, noise, d.effects(unlisted=unlisted))
    seen = poses.effects[(poses.effects["size_mm"] >= NO_MARK) & (poses.effects["absorbed"] <= ABSORBED)]
    named = {label for c in d.causes for label in (c.label, *c.indistinguishable)} | set(d.in_question)
    last = unlisted.beside.log_factor
    found: dict[str, list[str]] = {}
    for label in (c.label for c in d.case.candidates if c.listed and c.label in seen.index and c.label not in named):
        times = [t for t in TIMES if float(seen.loc[label, "findable_from"]) <= t]  # type: ignore[arg-type]
        if times and last.get(label, 0.0) < 0:
            found.setdefault(f"{times[0]:g}", []).append(label)
    return {f"{t:g}": found[f"{t:g}"] for t in TIMES if f"{t:g}" in found}
