"""What a diagnosis says in words, alike on the page and in the report: verdict, what is left, what cannot be seen."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence

from casadical.diagnosis.result import Diagnosis

# An effect is invisible if the base absorbs so much of it, or if it must be so many times its usual size to be found.
ABSORBED, OUT_OF_REACH = 0.98, 5.0
# Effects below this rms [mm] move nothing.
NO_MARK = 1e-6
# From this share of the gap on, what lies above the noise floor and has no named cause is spoken of.
REST = 0.05


def headline(d: Diagnosis) -> str:
    """The verdict in a sentence: causes, and how much of the gap they leave without a cause."""
    named = _and(c.label for c in d.causes)
    if d.verdict == "none":
        return "none: what is left is noise, no cause can be claimed"
    if d.verdict == "ambiguous":
        words = "ambiguous: something is there that several causes explain alike, no single one can be claimed"
        return f"{words}; {_rest(d)}" if has_rest(d) else words
    if d.verdict == "unknown":
        words = f"unknown: something is there that no listed cause explains; {_rest(d)}"
        return f"{words}; named: {named}" if named else words
    if has_rest(d):
        return f"explained in part only: {named}; yet {_rest(d)}"
    return f"explained: {named}; {mm(d.gap.before)} -> {mm(d.gap.after)} mm, noise alone would leave {mm(d.gap.floor)}"


def has_rest(d: Diagnosis) -> bool:
    """Whether more is left above the noise floor than can be passed over."""
    return d.verdict != "none" and d.unknown_rest > REST


def left_over(d: Diagnosis) -> tuple[float, float, float]:
    """Error of the model without the noise, rms [mm]: of the base model, with all causes, and the share left of it."""
    before, after = float(d.course.iloc[0]["model_mm"]), float(d.course.iloc[-1]["model_mm"])
    return before, after, after / before if before > 0 else 0.0


def _rest(d: Diagnosis) -> str:
    before, after, share = left_over(d)
    of = f" of {before:.3f}" if d.effects() else ""
    return f"{after:.3f}{of} mm rms beyond the noise{f' ({100 * share:.0f} %)' if of else ''} has no named cause"


def resembles(d: Diagnosis) -> str:
    """The form on no list that the rest looks most like; empty where a listed cause comes first."""
    ranking, listed = d.rankings[-1], {c.label for c in d.case.candidates if c.listed}
    best = ranking.order[0] if ranking.order else ""
    if not best or best in listed or ranking.probability[best] < 0.5:
        return ""
    rare = any(c.label == best and c.name != "unknown" for c in d.case.candidates)
    words = f"most like {best} ({ranking.probability[best]:.2f})" + (", see --effects extended" if rare else "")
    if d.unlisted is None:
        return words
    u = d.unlisted
    low, high = (100 * x for x in u.shrink_interval)
    return (
        f"{words}; with {', '.join(u.labels[:-1])}{' and ' if u.labels[1:] else ''}{u.labels[-1]} in the model, causes "
        f"or not, {1e3 * u.before:.3f} -> {1e3 * u.after:.3f} mm on poses "
        f"held out, {low:.0f} to {high:.0f} % less (from Python: apply(unlisted=True))"
    )


def unsure_floor(d: Diagnosis) -> str:
    """Why the noise floor may be too high, where only the fit tells it and something is unexplained."""
    if d.replicates.enough or not has_rest(d):
        return ""
    return (
        "the noise floor is the fit's own, so errors of a form that was not tried count as noise; repeated poses would "
        "tell the instrument's"
    )


def invisible(d: Diagnosis) -> dict[str, str]:
    """Why -> effects that these poses cannot show, those of several joints gathered; claimed causes left out."""
    seen = d.isolability.effects.drop(index=[c.label for c in d.causes], errors="ignore")
    idle = seen["size_mm"] < NO_MARK
    absorbed = ~idle & (seen["absorbed"] > ABSORBED)
    weak = ~idle & ~absorbed & (seen["findable_from"] > OUT_OF_REACH)
    reasons = {
        "as nothing here brings them about (no masses in the robot file, an idle joint)": seen.index[idle],
        f"as the base model takes up {100 * ABSORBED:.0f} % or more of each in these poses": seen.index[absorbed],
        f"against this noise, unless {OUT_OF_REACH:.0f} times their usual size": seen.index[weak],
    }
    return {why: gathered(labels) for why, labels in reasons.items() if len(labels)}


def gathered(labels: Iterable[str]) -> str:
    """Labels with the joints of each effect side by side: backlash@2,3, frame_drift."""
    joints: dict[str, list[str]] = {}
    for label in map(str, labels):
        name, _, joint = label.partition("@")
        joints.setdefault(name, []).append(joint)
    return ", ".join(f"{name}@{','.join(js)}" if js[0] else name for name, js in joints.items())


def alike(d: Diagnosis) -> dict[str, str]:
    """Label of a cause -> those that this data cannot tell from it, with the share that looks alike."""
    table = d.isolability.alike
    return {
        c.label: ", ".join(
            f"{k} ({100 * float(table.loc[c.label, k]):.0f} % alike here)"  # type: ignore[arg-type]
            if c.label in table.index and k in table.columns
            else k
            for k in c.indistinguishable
        )
        for c in d.causes
        if c.indistinguishable
    }


def not_logged(d: Diagnosis) -> dict[str, str]:
    """Columns as a user writes them -> what could be judged if they were logged."""
    said = gathered_by_columns(missing_columns(d))
    logged = d.case.m.conditions
    if "temperature_degC" in logged and "time_s" not in logged:
        said["time_s"] = "how far the links lag behind temperature_degC (now taken as not at all)"
    return said


def gathered_by_columns(missing: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Columns to log, as one word group -> the effects that lack them."""
    found: dict[str, list[str]] = {}
    for label, columns in missing.items():
        found.setdefault(" with ".join(columns), []).append(label)
    return {columns: gathered(labels) for columns, labels in found.items()}


def missing_columns(d: Diagnosis) -> dict[str, tuple[str, ...]]:
    """Effect that cannot be judged -> columns to log for it, as a table names them."""
    return columns_to_log(d.missing, d.case.m.conditions)


def columns_to_log(missing: Mapping[str, Sequence[str]], logged: Container[str]) -> dict[str, tuple[str, ...]]:
    """The same from the conditions that are lacking, some of which are derived (see `conditions.derive`)."""
    warmth = ("temperature_degC",) if "time_s" in logged else ("temperature_degC", "time_s")
    words = {"progress": ("time_s",)}

    def named(condition: str) -> tuple[str, ...]:
        return warmth if condition.startswith("warmth") else words.get(condition, (condition,))

    return {label: tuple(dict.fromkeys(n for c in lacking for n in named(c))) for label, lacking in missing.items()}


def _and(words: Iterable[str]) -> str:
    *first, last = [*words] or [""]
    return f"{', '.join(first)} and {last}" if first else last


def mm(metres: float) -> str:
    """A length in millimetres."""
    return f"{1e3 * metres:.3f}" if metres >= 1e-5 else f"{1e3 * metres:.4f}"
