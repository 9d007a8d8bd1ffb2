"""What a diagnosis says: the statements and rows that the terminal and the page of HTML both show."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from casadical.diagnosis.candidates import columns_to_log, gathered, gathered_by_columns
from casadical.diagnosis.cause_table import joints_of, listed, mm, wires_at_fault
from casadical.diagnosis.changes import NEW
from casadical.diagnosis.details import Details
from casadical.diagnosis.held_out_gap import of_time
from casadical.diagnosis.isolability import cannot_tell, indistinguishable, invisible
from casadical.diagnosis.next_poses import discrimination_probability, kinds_of_poses
from casadical.diagnosis.noise_account import Rule
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.thresholds import CLAIM, DETECT, DETECT_FURTHER, SET_CLAIM
from casadical.identification.gravity import in_words as gravity_in_words

# Of the probability that a decision stands on: it is said to be just above or below its threshold where the odds
# against it are at most so many times those of the threshold, or the reverse.
NEAR = 1.5
# Poses that raise the probability of a right choice by less tell nothing.
LITTLE = 0.1
# Words before what is said about something, where it is a sentence of its own; the most important first.
SUBJECTS = {
    "CHECK": "", "NOISE": "", "SET": "", "MORE": "", "PRIOR": "Prior: ", "CANNOT": "These data cannot ",
    "UNKNOWN": "Left: ", "LAW": "Law: ", "AFTER": "", "OUT": "", "WHERE": "Where: ", "RULED": "Ruled ",
    "NEXT": "Next: ", "MISSING": "", "GRAVITY": "In the model: ", "ASSUMED": "Assumed: ",
}  # fmt: skip


@dataclass(frozen=True)
class Statement:
    """One statement.

    about : VERDICT, PRIOR, GAP, NOISE, ASSUMED, GRAVITY, CHECK, WHERE, WHICH (then come the causes, see `cause_rows`),
        SET, MORE, AFTER, LAYERS (then come these, see `layer_rows`), CANNOT, RULED, UNKNOWN, LAW, OUT, MISSING, NEXT
    doubtful : whether it is a warning
    """

    about: str
    text: str
    doubtful: bool = False

    @property
    def sentence(self) -> str:
        """It without its label, as pages and the short answer have it."""
        text = SUBJECTS.get(self.about, "") + self.text.replace("   ", ", ")
        text = f"{text[0].upper()}{text[1:]}" if text.split()[0].strip(":,").isalpha() else text  # no column's name
        return text if text.endswith((".", ")")) else f"{text}."


def statements(d: Diagnosis, more: Details | None = None) -> list[Statement]:
    """All statements in the order in which a reader wants them."""
    more = more or Details()
    return [
        Statement("VERDICT", headline(d, more)),
        *_prior(d),
        *_gap(d, more),
        *_taken(d),
        *_where(d, more),
        *_which(d),
        *_after(d, more),
        *_cannot(d, more),
        *_unknown(d, more),
        *_left_out(d),
        *_next(d, more),
    ]


def _prior(d: Diagnosis) -> Iterator[Statement]:
    """What another campaign told, and what of it changed."""
    if d.prior is None:
        return
    twice = d.prior.learnt_from([d.case.m])
    yield Statement("PRIOR", d.prior.in_words([d.case.m]).removeprefix("Prior "), twice)
    for c in d.changes:
        where = c.effect if c.joint is None or "@" in c.effect else f"{c.effect}, joint {c.joint}"
        new = c.probability >= NEW
        text = f"{where}: changed since then with probability {c.probability:.2f}"
        yield Statement("PRIOR", f"{text}; taken as new, its earlier values are not used" if new else text, new)


def headline(d: Diagnosis, more: Details | None = None) -> str:
    """The verdict in a sentence: causes, and how much of the gap they leave without a cause."""
    named, floor = members(d), mm(floor_of(d, more))
    if d.verdict == "none":
        return f"none: what is left is {_noise(d)}; no cause can be claimed"
    if d.verdict == "ambiguous" and not d.causes:
        return "ambiguous: something is there, but no cause that is certain makes the gap smaller on poses held out"
    if d.verdict == "ambiguous":
        words, sets = f"ambiguous: {named}", d.cause_set
        if sets and not sets.names and sets.one_more > SET_CLAIM:
            words += f"; one more cause is there with probability {sets.one_more:.2f}, and these data do not tell which"
        left = f"{mm(d.gap.kept)} -> {mm(d.gap.after)} mm, noise alone would leave {floor}"
        return f"{words}; {_rest(d) if d.has_rest else left}"
    if d.verdict == "unknown":
        rest = f"{mm(d.account.structure)} mm a coordinate of structure without a form" if _hidden(d) else _rest(d)
        words = f"unknown: something is there that no listed cause explains; {rest}"
        return f"{words}; named: {named}" if named else words
    if d.has_rest:
        return f"explained in part only: {named}; yet {_rest(d)}"
    after = f"{mm(d.gap.kept)} -> {mm(d.gap.after)} mm" if d.effects() else f"the other poses: {mm(d.gap.kept)} mm"
    return f"explained: {named}; {after}, noise alone would leave {floor}"


def _noise(d: Diagnosis) -> str:
    """What the remainder of a campaign without causes is."""
    known = {
        Rule.REPEATS: ", as large as repeated poses say", Rule.DECLARED: ", as large as declared",
        Rule.SHEET: ", no larger than the data sheet allows",
    }  # fmt: skip
    return (d.account.form or "noise") + known.get(d.account.rules, ", or a form that was not tried")


def _hidden(d: Diagnosis) -> bool:
    """Whether more of the remainder is structure that was taken as noise than lies beyond the noise."""
    beyond = 1e-3 * left_over(d)[1] / np.sqrt(3)
    return d.account.excess > 0 or (d.account.is_structure and d.account.structure > beyond)


def members(d: Diagnosis) -> str:
    """The causes; one that these data do not tell from others with all their names, each with its probability."""
    at = {c.label: f" ({joints_of(c)})" for c in d.causes if c.joint is None and len(c.effects) > 1 and joints_of(c)}
    each = [names_of(d, c.label) + at.get(c.label, "") for c in d.causes]
    return "; ".join(each) if d.cause_set and d.cause_set.names else listed(each)


def names_of(d: Diagnosis, label: str) -> str:
    """A cause's label, or all its names."""
    names = d.cause_set.names.get(label, {}) if d.cause_set else {}
    return " or ".join(f"{k} ({p:.2f})" for k, p in names.items()) or label


def floor_of(d: Diagnosis, more: Details | None) -> float:
    """What noise alone would leave beside the best model that is told [m]."""
    return d.gap.floor if more is None or more.floor is None else more.floor


def left_over(d: Diagnosis) -> tuple[float, float, float]:
    """Error of the model without the noise, rms [mm]: of the base model, with all causes, and the share left of it."""
    before, after = float(d.course.iloc[0]["model_mm"]), float(d.course.iloc[-1]["model_mm"])
    return before, after, after / before if before > 0 else 0.0


def _rest(d: Diagnosis) -> str:
    before, after, share = left_over(d)
    of = f" of {before:.3f}" if d.effects() else ""
    return f"{after:.3f}{of} mm rms beyond the noise{f' ({100 * share:.0f} %)' if of else ''} has no named cause"


def readings_of(d: Diagnosis) -> str:
    """Of how many readings the error of a pose is the norm, where several tables have readings of one pose."""
    most = d.case.observations.stops.most
    return f", of each the norm over up to {most} readings" if most > 1 else ""


def _gap(d: Diagnosis, more: Details) -> Iterator[Statement]:
    r = d.replicates
    source = f"from {r.poses} repeated poses" if r.enough else "by the fit; too few poses are repeated"
    there = "nothing detected" if d.verdict == "none" else "detected"
    if d.verdict == "unknown" and d.law and d.rankings[0].none > DETECT:
        there = "detected by a law; without laws"
    p = d.p_nothing
    chance = "" if p is None else f", p < {p:.1g}" if p < 1e-3 else f", p = {p:.2g}"
    out = f", {len(d.outliers)} outliers left out" if d.outliers else ""
    yield Statement(
        "GAP",
        f"{mm(d.gap.kept)} mm mean on poses held out{readings_of(d)}{out}; noise floor "
        f"{mm(floor_of(d, more))} ({source}); {int(d.case.kept.sum())} poses; "
        f"{there}{' ' if there.endswith('laws') else ', '}P(nothing) = {d.rankings[0].none:.2g}{chance}",
    )
    rms, low, high = (d.course.iloc[0][name] for name in ("model_mm", "model_low_mm", "model_high_mm"))
    yield Statement("GAP", f"without the noise the model is wrong by {rms:.3f} mm rms ({low:.3f} to {high:.3f})")


def _taken(d: Diagnosis) -> Iterator[Statement]:
    """What was taken as noise and what of it is structure, what for granted, and what to do about the instrument."""
    yield Statement("NOISE", d.account.in_words())
    if form := d.rankings[-1].noise_form:
        text = f"what is left is more like {form} than like noise that is independent and alike everywhere"
        yield Statement("NOISE", text)
    if structure := d.account.structure_in_words():
        yield Statement("NOISE", structure, doubtful=True)
    yield from (Statement("ASSUMED", text) for text in assumptions(d))
    if text := gravity_in_words(d.identification):
        yield Statement("GRAVITY", text)
    if faults := [c for c in d.causes if c.of_instrument]:
        which = listed(dict.fromkeys(w for c in faults for w in wires_at_fault(d, c)))
        what = f"{which}, calibrate without" if which else "it"
        yield Statement(
            "CHECK",
            f"the instrument, not the robot, shows {listed(c.label for c in faults)}: check {what}, or go on with "
            "diagnosed.robot.toml (--out DIR), which has it identified beside the robot",
            doubtful=True,
        )


def assumptions(d: Diagnosis) -> tuple[str, ...]:
    """What a missing column or a declared value was taken for, and what of its uncertainty is in the comparison."""
    logged, robot = d.identification.measurements[0].conditions, d.identification.given
    missing = [j for j in robot.numbers if f"approach{j}" not in logged]
    said = []
    if missing:
        said.append(
            f"approach{','.join(map(str, missing))}: the direction from the pose before, as if the robot went straight "
            "from one to the next; play that the load alone takes up is compared too"
        )
    if "temperature_degC" not in logged:
        said.append("temperature_degC: not known; a warm-up that nobody measured is compared, but never named")
    if robot.payload and "payload_kg" not in logged:
        said.append(f"payload_kg: {robot.payload.mass:g} kg, as declared, at every pose")
    if copies := d.identification.measurements[0].copies_in_words:
        said.append(copies)
    said += d.case.assumed
    if d.case.free:
        width = robot.body_width
        origin = ", estimated from the reach" if robot.masses == "estimated" else ""
        said.append(
            f"masses of links{origin}: part of the base model, within {100 * width.share:.0f} % and "
            f"{1e3 * width.centre:.0f} mm"
        )
    return tuple(said)


def _where(d: Diagnosis, more: Details) -> Iterator[Statement]:
    if d.verdict == "none":
        yield Statement("WHERE", f"nowhere in particular: what is left is {_noise(d)}")
        return
    if more.where is None:
        return
    parts = pd.concat([more.where.joints, more.where.links])
    great = parts[(parts["share"] >= 0.05) & (parts["part"] != "elsewhere")].sort_values("share", ascending=False)
    shares = [
        f"{row['part']}: {100 * row['share']:.0f} % ({100 * row['low']:.0f}-{100 * row['high']:.0f})"
        for _, row in great.head(5).iterrows()
    ]
    yield Statement("WHERE", "   ".join(shares) or "spread over all parts")
    worst = more.where.worst.head(3)
    if len(worst):
        regions = [f"{row['by']} {row['part']} ({row['rms_mm']:.3f} mm rms)" for _, row in worst.iterrows()]
        yield Statement("WHERE", f"larger than elsewhere: {', '.join(regions)}")


def _which(d: Diagnosis) -> Iterator[Statement]:
    order = "; the largest shrink first" if len(d.causes) > 1 else ""
    yield Statement("WHICH", f"each cause alone beside the base model{order}" if d.causes else "no cause can be named")
    if d.cause_set:
        each = ", ".join(f"{names_of(d, label)} {p:.2f}" for label, p in d.cause_set.members.items())
        yield Statement(
            "SET",
            f"exactly these causes with probability {d.cause_set.probability:.2f}; {each}; one more "
            f"{d.cause_set.one_more:.2f}",
        )
        if d.cause_set.probability < SET_CLAIM and d.cause_set.others:
            sets = [f"{' + '.join(labels) or 'none of them'} {p:.2f}" for labels, p in d.cause_set.others]
            yield Statement("SET", f"instead: {', '.join(sets)}", d.verdict != "explained")
    if d.cause_set and d.cause_set.further:
        names = " or ".join(f"{k} ({p:.2f})" for k, p in d.cause_set.further.items())
        text = (
            f"one more cause is there with probability {d.cause_set.one_more:.2f}, and is not claimed: {names}; with "
            f"the first {d.gap.after * 1e3:.3f} -> {d.cause_set.further_gap * 1e3:.3f} mm on poses held out"
        )
        yield Statement("MORE", text, doubtful=True)
    yield from _near_threshold(d)


def _near_threshold(d: Diagnosis) -> Iterator[Statement]:
    """Decisions that stand on a probability that is hardly above or below their threshold."""
    members, claimed = d.cause_set.members if d.cause_set else {}, d.verdict in ("explained", "ambiguous")
    judged = {c.label: members.get(c.label, c.confidence) for c in d.causes if claimed}
    ranking, listed = d.rankings[-1], {c.label for c in d.case.candidates if c.listed}
    dropped = {k: ranking.probability[k] for k in ranking.order[:1] if k in listed and k not in judged}
    for label, p in {**judged, **dropped}.items():
        if (side := _beside(p, CLAIM)) and (label in judged or side == "below"):
            text = f"{label} is just {side} what is claimed: probability {p:.3f}, claimed from {CLAIM:g} on"
            yield Statement("SET", text, doubtful=True)
    detected = (
        (d.p_nothing is None, "anything", "nothing", d.rankings[0].none, DETECT),
        (bool(d.effects()), "something further", "no further one", d.rankings[-1].none, DETECT_FURTHER),
    )
    for asked, what, name, none, least in detected:
        if asked and (side := _beside(1 - none, 1 - least)):
            there = f"P({name}) = {none:.3f}, something from {least:g} down"
            yield Statement("SET", f"that {what} is there is just {side} what is said: {there}", doubtful=True)


def _beside(probability: float, threshold: float) -> str:
    """Whether a probability is just above or below a threshold; empty where it is far from it."""
    times = (1 - threshold) * probability / max(threshold * (1 - probability), 1e-300)
    return "above" if 1 <= times < NEAR else "below" if 1 / NEAR < times < 1 else ""


def _after(d: Diagnosis, more: Details) -> Iterator[Statement]:
    steps = [c for c in d.causes if c.effects]
    if steps:
        last, added = d.course.iloc[-1], "with it" if len(steps) == 1 else "with all of them"
        yield Statement(
            "AFTER",
            f"{last['gap_mm']:.3f} mm {added} ({last['low_mm']:.3f} to {last['high_mm']:.3f}), poses left out one by "
            f"one {last['loo_mm']:.3f}; noise floor {mm(floor_of(d, more))}",
        )
        before, after, share = left_over(d)
        yield Statement(
            "AFTER",
            f"without the noise the model is then wrong by {after:.3f} mm rms ({last['model_low_mm']:.3f} to "
            f"{last['model_high_mm']:.3f}), {100 * share:.0f} % of the {before:.3f} before",
        )
        if any(of_time(c.effects) for c in steps):
            blocks = f"{d.course.iloc[0]['blocks_mm']:.3f} -> {last['blocks_mm']:.3f} mm"
            yield Statement("AFTER", f"with fifths of the time left out: {blocks}")
    if check := more.check:  # tried on one partition into fifths, so that its own gap is not shown
        ratio = check.refit / check.linearised
        beside = "as the linearised model" if abs(ratio - 1) < 0.005 else f"{change(ratio)} than the linearised model"
        said = "they agree" if check.agree else "they DISAGREE"
        words = f"refitted by Ipopt, nonlinear, and each fifth left out of that: {beside}; {said}"
        yield Statement("AFTER", words, doubtful=not check.agree)
    for net, what in zip((more.networks or ())[: 1 + bool(steps)], ("instead", "on the rest"), strict=False):
        words = f"6-5-3 network {what if steps else 'on the gap'}: {change(net.used / net.before)}"
        if net.refused:
            all_the_same = f"(used all the same: {change(net.forced / net.before)})"
            words += f", refused in {net.refused} of 5 trainings {all_the_same}"
        yield Statement("AFTER", words)
    if steps:
        yield Statement("LAYERS", "mm on poses held out, each cause beside those above it")


def change(ratio: float) -> str:
    """An error beside another one on the same poses."""
    return f"{abs(100 * (ratio - 1)):.0f} % {'more' if ratio > 1 else 'less'}"


def _cannot(d: Diagnosis, more: Details) -> Iterator[Statement]:
    yield from (Statement("CANNOT", text, doubtful=True) for text in cannot_tell(d))
    for label, others in indistinguishable(d, more.isolability).items():
        yield Statement("CANNOT", f"tell {label} from {others}", doubtful=True)
    for why, labels in invisible(d, more.isolability).items():
        yield Statement("CANNOT", f"see, {why}: {labels}")
    parts = [
        f"from {'' if times == '1' else f'{times} times '}its usual size {gathered(labels)}"
        for times, labels in more.ruled_out.items()
    ]
    if parts:
        yield Statement("RULED", f"out, as these poses would show it: {'; '.join(parts)}")


def _unknown(d: Diagnosis, more: Details) -> Iterator[Statement]:
    if d.has_rest:
        left = f"{left_over(d)[1]:.3f} mm rms that no cause named here explains"
        words = ["" if _hidden(d) else left, _resembles(d, more)]
        if not d.account.anchored:
            words.append(
                "the noise floor is the fit's own, so errors of a form that was not tried count as noise; repeated "
                "poses would tell the instrument's"
            )
            sets = d.case.observations.sets
            if len(sets) > 1 and any(m.sigma is None for m in sets):
                words.append("so are the tables' noises, by which they are weighed: declare sigma_mm of each")
    else:
        words = [_resembles(d, more)] if d.verdict == "unknown" else []
    if any(words):
        yield Statement("UNKNOWN", "; ".join(w for w in words if w), doubtful=True)
    if more.laws:
        yield Statement("LAW", more.laws.in_words)


def _resembles(d: Diagnosis, more: Details) -> str:
    """The form on no list that the rest looks most like; empty where a listed cause comes first."""
    ranking, on_list = d.rankings[-1], {c.label for c in d.case.candidates if c.listed}
    best = ranking.order[0] if ranking.order else ""
    if not best or best in on_list or ranking.probability[best] < 0.5:
        return ""
    rare = any(c.label == best and c.name != "unknown" for c in d.case.candidates)
    words = f"most like {best} ({ranking.probability[best]:.2f})" + (", see --effects extended" if rare else "")
    u = more.unlisted
    if u is None:
        return words
    forms, (low, high) = listed(u.labels), u.shrink_interval
    if low <= 0:
        return f"{words}; with {forms} in the model the error on poses held out is not surely smaller"
    return (
        f"{words}; with {forms} in the model, causes or not, {1e3 * u.before:.3f} -> {1e3 * u.after:.3f} mm on poses "
        f"held out, {100 * low:.0f} to {100 * high:.0f} % less (--out DIR --unlisted writes them)"
    )


def _left_out(d: Diagnosis) -> Iterator[Statement]:
    """Poses and columns that are not there."""
    if n := len(d.outliers):
        shown = [f"row {o.row} ({1e3 * o.distance:.2f} mm)" for o in d.outliers[:6]]
        more = f" and {n - 6} more" if n > 6 else ""
        count = "1 pose left out as an outlier" if n == 1 else f"{n} poses left out as outliers"
        yield Statement("OUT", f"{count}: {', '.join(shown)}{more}")
    if joint := d.joint_of_outliers:
        text = f"they err along the motion of joint {joint}, as a joint that is wrong in few places makes them:"
        yield Statement("OUT", f"{text} no listed cause, and no single points", doubtful=True)
    for columns, what in not_logged(d).items():
        yield Statement("MISSING", f"{columns}: not logged; it would show {what}")


def not_logged(d: Diagnosis) -> dict[str, str]:
    """Columns as a user writes them -> what could be judged if they were logged."""
    said = gathered_by_columns(missing_columns(d))
    logged = d.case.m.conditions
    if "temperature_degC" in logged and "time_s" not in logged:
        said["time_s"] = "how far the links lag behind temperature_degC (now taken as not at all)"
    return said


def missing_columns(d: Diagnosis) -> dict[str, tuple[str, ...]]:
    """Effect that cannot be judged -> columns to log for it, as a table names them."""
    return columns_to_log(d.missing, d.case.m.conditions)


def gain_of(d: Diagnosis, poses: pd.DataFrame) -> float:
    """How much more probable the right answer becomes by poses of `next_poses`."""
    before, after = discrimination_probability(d, poses)
    return after - before


def _next(d: Diagnosis, more: Details) -> Iterator[Statement]:
    poses = more.poses
    if poses is None or not len(poses):
        return
    before, after = discrimination_probability(d, poses)
    words = f"{len(poses)} more poses of this robot would hardly tell"
    if after - before >= LITTLE:
        where = f" -> {more.file}" if more.file else ""
        words = f"measure {len(poses)} poses{where} ({kinds_of_poses(d.case, poses)}) to tell"
    yield Statement("NEXT", f"{words} {' from '.join(d.in_question)}: P(correct) {before:.2f} -> {after:.2f}")
