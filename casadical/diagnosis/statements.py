"""What a diagnosis says: the statements and rows that the terminal and the page of HTML both show."""

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
import pandas as pd

from casadical.diagnosis.changes import NEW
from casadical.diagnosis.details import Details
from casadical.diagnosis.held_out_gap import Check, NetworkGap, of_time
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.next_poses import discrimination_probability
from casadical.diagnosis.result import Cause, Diagnosis
from casadical.effects import Effect
from casadical.effects.plugins import signature_of
from casadical.measurements.measurements import unmeasured

# An effect is invisible if the base absorbs so much of it, or if it must be so many times its usual size to be found.
ABSORBED, OUT_OF_REACH = 0.98, 5.0
# Effects below this rms [mm] move nothing.
NO_MARK = 1e-6
# From this share of the gap on, what lies above the noise floor and has no named cause is reported.
REST = 0.05
# Torque of this share of a great one counts as none.
IDLE = 0.15
# Stands between words of an item that is not broken over two lines.
TIED = "\u00a0"
READABLE = {"rad": (1e6, "urad"), "m": (1e6, "um"), "m/m": (1e6, "um/m"), "rad/rad": (1e6, "urad/rad")}
READABLE |= {"rad/K": (1e6, "urad/K"), "1/K": (1e6, "1e-6/K"), "1/m": (1e6, "um/m^2"), "kg/kg": (1e2, "%")}


@dataclass(frozen=True)
class Statement:
    """One statement.

    about : VERDICT, PRIOR, GAP, WHERE, WHICH (then come the causes, see `cause_rows`), AFTER, CANNOT, UNKNOWN, OUT,
        MISSING, NEXT
    doubtful : whether it is a warning
    """

    about: str
    text: str
    doubtful: bool = False


@dataclass(frozen=True)
class CauseRow:
    """One cause in words.

    shown : what the data show; named : its label, and what it may be mechanically
    gap : without it and with it alone, "0.127 -> 0.071"; shrinks : by what share, a 95 % interval
    parameters : (name, value, standard error, unit); no standard error of what was chosen
    """

    cause: Cause
    shown: str
    named: str
    gap: str
    shrinks: str
    parameters: tuple[tuple[str, str, str, str], ...]


def statements(d: Diagnosis, more: Details | None = None) -> list[Statement]:
    """All statements in the order in which a reader wants them."""
    more = more or Details()
    parts = [
        _verdict(d),
        _prior(d),
        _gap(d),
        _where(d, more),
        _which(d),
        _after(d, more),
        _cannot(d, more),
        _unknown(d, more),
    ]
    return [s for part in (*parts, _outliers(d), _missing(d), _next(d, more)) for s in part]


def cause_rows(d: Diagnosis) -> list[CauseRow]:
    """A row for each cause, the largest shrink first."""
    rows = []
    for c in d.causes:
        shown, mechanical = _signature(c)
        low, high = (100 * v for v in c.shrink_interval)
        parameters = [(name, f"{value:.3g}", "", "") for e in c.effects for name, value in settings(e).items()]
        parameters += [_estimate(name, *given) for name, given in (c.estimates or {}).items()]
        if c.effect == "outliers":
            few = ", ".join(str(o.row) for o in d.outliers[:10])
            parameters = [("rows", few + (" ..." if len(d.outliers) > 10 else ""), "", "")]
        rows.append(
            CauseRow(
                c,
                shown,
                f"{c.label}; may be {mechanical}" if mechanical else c.label,
                " -> ".join(map(mm, _gap_if_added(d, c))),
                f"{low:.0f} to {high:.0f} %",
                tuple(parameters),
            )
        )
    return rows


def _verdict(d: Diagnosis) -> Iterator[Statement]:
    yield Statement("VERDICT", headline(d))


def _prior(d: Diagnosis) -> Iterator[Statement]:
    """What another campaign told, and what of it changed."""
    if d.prior is None:
        return
    yield Statement("PRIOR", d.prior.in_words([d.case.m]).removeprefix("Prior "))
    for c in d.changes:
        where = c.effect if c.joint is None or "@" in c.effect else f"{c.effect}, joint {c.joint}"
        new = c.probability >= NEW
        text = f"{where}: changed since then with probability {c.probability:.2f}"
        yield Statement("PRIOR", f"{text}; taken as new, its earlier values are not used" if new else text, new)


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


def _gap(d: Diagnosis) -> Iterator[Statement]:
    r = d.replicates
    source = f"from {r.poses} repeated poses" if r.enough else "by the fit; too few poses are repeated"
    there = "nothing detected" if d.verdict == "none" else "detected"
    p = d.p_nothing
    chance = "" if p is None else f", p < {p:.1g}" if p < 1e-3 else f", p = {p:.2g}"
    yield Statement(
        "GAP",
        f"{mm(d.gap.before)} mm mean on poses held out; noise floor {mm(d.gap.floor)} ({source}); "
        f"{int(d.case.kept.sum())} poses; {there}, P(nothing) = {d.rankings[0].none:.2g}{chance}",
    )
    base = d.course.iloc[0]
    yield Statement(
        "GAP",
        f"without the noise the model is wrong by {base['model_mm']:.3f} mm rms "
        f"({base['model_low_mm']:.3f} to {base['model_high_mm']:.3f})",
    )


def _where(d: Diagnosis, more: Details) -> Iterator[Statement]:
    if d.verdict == "none":
        yield Statement("WHERE", "nowhere in particular: what is left is noise")
        return
    if more.where is None:
        return
    parts = pd.concat([more.where.joints, more.where.links])
    great = parts[(parts["share"] >= 0.05) & (parts["part"] != "elsewhere")].sort_values("share", ascending=False)
    shares = [
        _tied(f"{row['part']}: {100 * row['share']:.0f} % ({100 * row['low']:.0f}-{100 * row['high']:.0f})")
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


def _gap_if_added(d: Diagnosis, c: Cause) -> tuple[float, float]:
    """The gap without and with one cause [m]: outliers beside all poses, an effect beside those that are kept."""
    if c.effect == "outliers":
        return d.gap.before, d.gap.before * (1 - c.shrink)
    before = 1e-3 * float(d.course.iloc[0]["gap_mm"])
    alone = sum(bool(k.effects) for k in d.causes) == 1
    return before, d.gap.after if alone else before * (1 - c.shrink)


def _signature(c: Cause) -> tuple[str, str]:
    """What the data show, and the mechanical causes that share it."""
    words = "single points that are wrong" if c.effect == "outliers" else signature_of(c.effect)
    if c.effects:
        words = words or c.effects[0].signature or c.effects[0].physics
    shown, _, causes = words.partition(" (")
    if c.joint != 2:
        causes = causes.replace("; balancer on joint 2", "")
    joint = "" if c.joint is None else f", joint {c.joint}"
    return shown + joint, causes.rstrip(")")


def settings(effect: Effect) -> dict[str, float]:
    """Values of an effect in which it is not linear (cycles, knee, lag, time of a step)."""
    values = {f.name: getattr(effect, f.name) for f in fields(effect)}
    return {name: value for name, value in values.items() if isinstance(value, float)}


def _estimate(name: str, value: float, error: float, unit: str) -> tuple[str, str, str, str]:
    """Name, value, standard error and unit as they are shown; lengths of a millimetre and more in mm."""
    size = max(abs(value), error)
    factor, word = (1e3, "mm") if unit == "m" and size >= 1e-3 else READABLE.get(unit, (1.0, unit))
    return name, f"{factor * value:.3g}", f"{factor * error:.2g}", word


def _after(d: Diagnosis, more: Details) -> Iterator[Statement]:
    steps = [c for c in d.causes if c.effects]
    if steps:
        last, added = d.course.iloc[-1], "with it" if len(steps) == 1 else "with all of them"
        yield Statement(
            "AFTER",
            f"{last['gap_mm']:.3f} mm {added} ({last['low_mm']:.3f} to {last['high_mm']:.3f}), poses left out one by "
            f"one {last['loo_mm']:.3f}; noise floor {mm(d.gap.floor)}",
        )
        before, after, share = left_over(d)
        yield Statement(
            "AFTER",
            f"without the noise the model is then wrong by {after:.3f} mm rms ({last['model_low_mm']:.3f} to "
            f"{last['model_high_mm']:.3f}), {100 * share:.0f} % of the {before:.3f} before",
        )
        if any(of_time(c.effects) for c in steps):
            first = d.course.iloc[0]
            yield Statement(
                "AFTER", f"with fifths of the time left out: {first['blocks_mm']:.3f} -> {last['blocks_mm']:.3f} mm"
            )
    if more.check:
        yield _refitted(more.check)
    if more.networks:
        yield from _networks(more.networks, bool(steps))


def _refitted(check: Check) -> Statement:
    """What the nonlinear refit says; it is tried on one partition into fifths, the gap is the mean over several."""
    off = 100 * (check.refit / check.linearised - 1)
    said = "they agree" if check.agree else "they DISAGREE"
    return Statement(
        "AFTER",
        f"refitted by Ipopt, nonlinear: {mm(check.refit)} mm on the first partition into fifths, {abs(off):.0f} % "
        f"{'above' if off >= 0 else 'below'} the linearised model there; {said}",
        doubtful=not check.agree,
    )


def _networks(networks: tuple[NetworkGap, NetworkGap], steps: bool) -> Iterator[Statement]:
    for net, what in zip(networks[: 1 + steps], ("instead", "on the rest"), strict=False):
        refused = f", refused in {net.refused} of 5 trainings" if net.refused else ""
        yield Statement(
            "AFTER",
            f"6-5-3 network {what if steps else 'on the gap'}: {mm(net.before)} -> {mm(net.used)} mm{refused}"
            + (f" (used all the same: {mm(net.forced)})" if net.refused else ""),
        )


def _cannot(d: Diagnosis, more: Details) -> Iterator[Statement]:
    for label, others in _alike(d, more).items():
        yield Statement("CANNOT", f"tell {label} from {others}", doubtful=True)
    for why, labels in _invisible(d, more).items():
        yield Statement("CANNOT", f"see, {why}: {labels}")


def _alike(d: Diagnosis, more: Details) -> dict[str, str]:
    """Label of a cause -> those that this data cannot tell from it, with the share that looks alike."""
    table = more.isolability.alike if more.isolability else pd.DataFrame()
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


def _invisible(d: Diagnosis, more: Details) -> dict[str, str]:
    """Why -> effects that these poses cannot show, those of several joints gathered; claimed causes left out."""
    if more.isolability is None:
        return {}
    seen = more.isolability.effects.drop(index=[c.label for c in d.causes], errors="ignore")
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


def _unknown(d: Diagnosis, more: Details) -> Iterator[Statement]:
    if has_rest(d):
        words = [f"{left_over(d)[1]:.3f} mm rms that no cause named here explains", _resembles(d, more)]
        if not d.replicates.enough:
            words.append(
                "the noise floor is the fit's own, so errors of a form that was not tried count as noise; repeated "
                "poses would tell the instrument's"
            )
        yield Statement("UNKNOWN", "; ".join(w for w in words if w), doubtful=True)


def _resembles(d: Diagnosis, more: Details) -> str:
    """The form on no list that the rest looks most like; empty where a listed cause comes first."""
    ranking, listed = d.rankings[-1], {c.label for c in d.case.candidates if c.listed}
    best = ranking.order[0] if ranking.order else ""
    if not best or best in listed or ranking.probability[best] < 0.5:
        return ""
    rare = any(c.label == best and c.name != "unknown" for c in d.case.candidates)
    words = f"most like {best} ({ranking.probability[best]:.2f})" + (", see --effects extended" if rare else "")
    u = more.unlisted
    if u is None:
        return words
    low, high = (100 * x for x in u.shrink_interval)
    return (
        f"{words}; with {', '.join(u.labels[:-1])}{' and ' if u.labels[1:] else ''}{u.labels[-1]} in the model, causes "
        f"or not, {1e3 * u.before:.3f} -> {1e3 * u.after:.3f} mm on poses "
        f"held out, {low:.0f} to {high:.0f} % less (--out DIR --unlisted has them in a robot file)"
    )


def _outliers(d: Diagnosis) -> Iterator[Statement]:
    if d.outliers:
        shown = [f"row {o.row} ({1e3 * o.distance:.2f} mm)" for o in d.outliers[:6]]
        more = f" and {len(d.outliers) - 6} more" if len(d.outliers) > 6 else ""
        count = (
            "1 pose left out as an outlier" if len(d.outliers) == 1 else f"{len(d.outliers)} poses left out as outliers"
        )
        yield Statement("OUT", f"{count}: {', '.join(shown)}{more}")


def _missing(d: Diagnosis) -> Iterator[Statement]:
    for columns, what in not_logged(d).items():
        yield Statement("MISSING", f"{columns}: not logged; it would show {what}")


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
    """The same from the conditions that are lacking, some of which are derived (see `derived_columns.derive`)."""
    warmth = ("temperature_degC",) if "time_s" in logged else ("temperature_degC", "time_s")
    words = {"progress": ("time_s",)}

    def named(condition: str) -> tuple[str, ...]:
        return warmth if condition.startswith("warmth") else words.get(condition, (condition,))

    return {label: tuple(dict.fromkeys(n for c in lacking for n in named(c))) for label, lacking in missing.items()}


def _next(d: Diagnosis, more: Details) -> Iterator[Statement]:
    poses = more.poses
    if poses is None or not len(poses):
        return
    before, after = discrimination_probability(d, poses)
    where = f" -> {more.file}" if more.file else ""
    yield Statement(
        "NEXT",
        f"measure {len(poses)} poses{where} ({_kinds(d.case, poses)}) to tell {' from '.join(d.in_question)}: "
        f"P(correct) {before:.2f} -> {after:.2f}",
    )


def _kinds(case: Case, poses: pd.DataFrame) -> str:
    """What kind of poses they are, in words."""
    found = []
    if repeats := int((poses["repeats"] != "").sum()):
        found.append(f"{repeats} repeat earlier ones in other circumstances")
    masses, counts = np.unique(poses.get("payload_kg", []), return_counts=True)
    if len(masses) > 1:
        found.append(", ".join(f"{n} with {mass:g} kg" for mass, n in zip(masses, counts, strict=True)))
    for name in (c for c in map(str, poses) if c.startswith("approach")):
        rising = int((poses[name] > 0).sum())
        found.append(f"joint {name[8:]} approached rising in {rising}, falling in {len(poses) - rising}")
    if "state" in poses:
        found.append(f"{int((poses['state'] == 'warm').sum())} warm, {int((poses['state'] == 'cold').sum())} cold")
    if wider := int(poses["new"].str.contains("range of").sum()):
        found.append(f"{wider} beyond the ranges so far")
    return "; ".join([*found, *_idle(case, poses)])


def _idle(case: Case, poses: pd.DataFrame) -> list[str]:
    """Joints whose gravity torque is near zero in more of the poses than of the campaign's."""
    robot = case.given
    units = [("deg", np.pi / 180) if j.kind == "revolute" else ("mm", 1e-3) for j in robot.joints]
    q = np.stack([poses[f"q{k}_{u}"].to_numpy() * f for k, (u, f) in enumerate(units, 1)], axis=1)
    conditions = {"payload_kg": poses["payload_kg"].to_numpy()} if "payload_kg" in poses else {}
    new = unmeasured(q, conditions)
    idle = []
    for m in (new, case.m):
        w = m.condition_matrix(robot.conditions, robot.declared)
        tau = robot.model.function("torque", ("tau",)).map(len(m))(m.q.T, w.T, case.values).full()
        idle.append((np.abs(tau) < IDLE * robot.torque_scale[:, None]).mean(axis=1))
    more = np.flatnonzero(idle[0] > np.minimum(2 * idle[1], idle[1] + 0.3))
    return [f"{round(idle[0][j] * len(q))} with joint {j + 1} near zero torque" for j in more[:2]]


def _and(words: Iterable[str]) -> str:
    *first, last = [*words] or [""]
    return f"{', '.join(first)} and {last}" if first else last


def _tied(item: str) -> str:
    return item.replace(" ", TIED)


def mm(metres: float) -> str:
    """A length in millimetres."""
    return f"{1e3 * metres:.3f}" if metres >= 1e-5 else f"{1e3 * metres:.4f}"
