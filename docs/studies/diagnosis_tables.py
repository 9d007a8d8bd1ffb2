"""python docs/studies/diagnosis_tables.py

Writes the tables of docs/effects.md and docs/diagnosis-statistics.md again from the effect classes and the
thresholds in the code; a test compares.
"""

import re
from pathlib import Path

from casadical.diagnosis import posterior as which
from casadical.diagnosis.candidates import Candidate, candidates_of
from casadical.diagnosis.settings import SETTINGS
from casadical.effects.plugins import signature_of
from casadical.project.problem import read_campaign_robot

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "docs" / name for name in ("effects.md", "diagnosis-statistics.md")]
MOST = 40  # names in a row of a table
READABLE = {"rad": (1e6, "urad"), "m": (1e6, "um"), "m/m": (1e6, "um/m"), "rad/rad": (1e6, "urad/rad")}
READABLE |= {"rad/K": (1e6, "urad/K"), "1/K": (1e6, "1e-6/K"), "1/m": (1e6, "um/m^2"), "": (1e2, "% of peak torque")}
READABLE |= {"kg/kg": (1e2, "%")}


def tables() -> dict[str, str]:
    """Return what must stand at each marked place of the pages, by its name."""
    robot = read_campaign_robot(ROOT / "problems" / "hh800")
    standard = [c for c in candidates_of(robot, "standard") if c.listed]
    names = {c.name for c in standard}
    rare = [c for c in candidates_of(robot, "extended") if c.listed and c.name not in names]
    from casadical.effects import MissingCompliance

    rare.append(Candidate("missing_compliance@2", "missing_compliance", 2, ((MissingCompliance(2),),)))
    return {
        "standard": _effects(standard),
        "extended": _effects(rare),
        "thresholds": _thresholds(),
    }


def _by_name(candidates: list[Candidate]) -> dict[str, Candidate]:
    """One candidate a name: joint 2's where there is one, else the first."""
    found: dict[str, Candidate] = {}
    for c in candidates:
        if c.name not in found or c.joint == 2:
            found[c.name] = c
    return found


def _effects(candidates: list[Candidate]) -> str:
    """Return a list of the effects: what the data show, the physics, sizes, columns, and what it is confused with."""
    lines = []
    for name, c in sorted(_by_name(candidates).items()):
        effect = c.variants[0][0]
        joint = "@joint" if c.joint is not None and name != "gravity_compensator" else ""
        needs = f" Needs {columns}." if (columns := _columns(c)) else ""
        shown = signature_of(name)
        lines.append(
            f"- **`{name}{joint}`**: {shown}. {effect.physics} *Sizes*: {_sizes(c)}.{needs} "
            f"*Confused with* {effect.confused_with}."
        )
    return "\n".join(lines)


def _sizes(c: Candidate) -> str:
    by_size: dict[str, list[str]] = {}
    for effect in {type(v[0]): v[0] for v in c.variants}.values():
        for name, (size, unit) in effect.sizes().items():
            factor, word = (1e3, "mm") if unit == "m" and size >= 1e-3 else READABLE[unit]
            by_size.setdefault(f"{size * factor:.3g} {word}", []).append(re.sub(r"(?<=[kxyzp])\d$", "", name))
    groups = [(list(dict.fromkeys(names)), size) for size, names in by_size.items()]
    few = [f"{_short(names)}: {size}" for names, size in groups]
    return "; ".join(few if len(few) <= MOST else [few[0], f"falling to {groups[-1][1]} with {groups[-1][0][-1]}"])


def _short(names: list[str]) -> str:
    """Names in a row; of many, the first and the last."""
    return ", ".join(names) if len(names) <= MOST else f"{names[0]}, {names[1]} ... {names[-1]}"


def _columns(c: Candidate) -> str:
    needed = {column for v in c.variants for e in v for column in e.conditions}
    words = set()
    for column in needed:
        if column.startswith(("far_", "wire")):
            words.add("measured distances")
        elif column.startswith(("fixed_", "carried_")):
            words.add("measured full poses")
        elif column.startswith("warmth"):
            words |= {"temperature_degC", "time_s"}
        elif column.startswith("approach"):
            words.add("approach")
        elif column == "progress" or column.startswith(("move", "memory")):
            words.add("order")
        else:
            words.add(column)
    return ", ".join(sorted(words))


def _thresholds() -> str:
    d = SETTINGS
    first, further = which.PRIOR_FIRST, which.PRIOR_FURTHER
    rows = [
        ("prior of nothing / a listed effect / the unknown, first cause", _shares(first)),
        ("the same, for a further cause", _shares(further)),
        ("prior factor of a further cause at a joint that has one", f"{SETTINGS.same_joint_prior_factor:g}"),
        ("something is there if P(nothing) is at most", f"{d.max_p_nothing:g}"),
        ("the same for a further cause", f"{d.max_p_nothing_further:g}"),
        (
            "with a bootstrap: something is there if noise alone looks like it so often at most",
            f"{d.max_bootstrap_p:g}",
        ),
        ("one cause is claimed from / that it only looks like one on no list", f"{d.min_claim:g} / {d.look_alike:g}"),
        ("named causes explain if exactly these have a probability of", f"{d.min_set:g}"),
        (
            "something that was not tried acts beside named causes, the rest like noise / in doubt",
            f"{d.untried:g} / {d.untried_in_doubt:g}",
        ),
        ("a further cause is taken up from a probability of", f"{d.min_further:g}"),
        ("an unlisted remainder of this share of the evidence makes the verdict unknown", f"{d.max_flaw:g}"),
        ("a set holds this share of the probability, and at most so many", f"{d.ambiguous_share:g}, {d.max_ambiguous}"),
        (
            "squared Mahalanobis distance of an outlier / of one taken back",
            f"{d.outlier_distance:g} / {d.inlier_distance:g}",
        ),
        ("most causes, partitions into five folds", f"{d.max_causes}, {d.partitions}"),
    ]
    return "\n".join(["| threshold | value |", "|---|---|", *(f"| {what} | {value} |" for what, value in rows)])


def _shares(prior: dict[str, float]) -> str:
    return " / ".join(f"{prior[k]:g}" for k in ("none", "listed", "unknown"))


def filled(page: str) -> str:
    """Return the page with its marked places written again."""
    for name, text in tables().items():
        mark = re.compile(rf"(<!-- {name} -->\n).*?(<!-- end -->)", re.DOTALL)
        page = mark.sub(lambda m, text=text: f"{m[1]}{text}\n{m[2]}", page)
    return page


if __name__ == "__main__":
    for path in PAGES:
        path.write_text(filled(path.read_text(encoding="utf-8")), encoding="utf-8")
