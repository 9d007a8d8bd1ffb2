"""The page that a person reads: verdict, gap, where, which, cannot tell, unknown, what to measure next."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

import pandas as pd
from rich.console import RenderableType
from rich.text import Text

from casadical.diagnosis.advice import kinds, told_apart
from casadical.diagnosis.json_answer import Extras, settings
from casadical.diagnosis.network import NetworkGap
from casadical.diagnosis.phrases import (
    alike,
    has_rest,
    headline,
    invisible,
    left_over,
    not_logged,
    resembles,
    unsure_floor,
)
from casadical.diagnosis.phrases import mm as _mm
from casadical.diagnosis.refit import Check
from casadical.diagnosis.result import Cause, Diagnosis
from casadical.diagnosis.shrink_course import of_time
from casadical.effects.plugins import signature_of

WIDTH = 112
LABEL = 8
TIED = "\u00a0"
READABLE = {"rad": (1e6, "urad"), "m": (1e6, "um"), "m/m": (1e6, "um/m"), "rad/rad": (1e6, "urad/rad")}
READABLE |= {"rad/K": (1e6, "urad/K"), "1/K": (1e6, "1e-6/K"), "1/m": (1e6, "um/m^2"), "kg/kg": (1e2, "%")}
# Of a signature in the table of causes.
COLUMN = 62


def report(d: Diagnosis, title: str, extras: Extras | None = None) -> RenderableType:
    """The page, its title underlined."""
    page = Text(f"{title}\n", style="bold underline", no_wrap=True)
    page.append(Text(page_of(d, extras), style="not bold not underline"))
    return page


def page_of(d: Diagnosis, extras: Extras | None = None) -> str:
    """The page as plain text, at most `WIDTH` characters wide."""
    e = extras or Extras()
    lines = [
        *_block("VERDICT", headline(d)),
        *_gap(d),
        *_where(d),
        *_which(d),
        *_how_far(d, e),
        *_cannot_tell(d),
        *_unknown(d),
        *_outliers(d),
    ]
    return "\n".join([*lines, *_not_logged(d), *_next(d, e)])


def _block(label: str, text: str) -> list[str]:
    """A label and its text beside it, wrapped."""
    return _wrapped(text, f"{label:<{LABEL}}", " " * LABEL)


def _wrapped(text: str, first: str, further: str) -> list[str]:
    lines = textwrap.wrap(text, WIDTH, initial_indent=first, subsequent_indent=further, break_on_hyphens=False)
    return [line.replace(TIED, " ") for line in lines]


def _tied(item: str) -> str:
    """An item that is not broken over two lines."""
    return item.replace(" ", TIED)


def _gap(d: Diagnosis) -> Iterator[str]:
    r = d.replicates
    source = f"from {r.poses} repeated poses" if r.enough else "by the fit; too few poses are repeated"
    there = "nothing detected" if d.verdict == "none" else "detected"
    yield from _block(
        "GAP",
        f"{_mm(d.gap.before)} mm mean on poses held out; noise floor {_mm(d.gap.floor)} ({source}); "
        f"{int(d.case.kept.sum())} poses; {there}, P(nothing) = {d.rankings[0].none:.2g}{_chance(d.p_nothing)}",
    )
    base = d.course.iloc[0]
    yield from _block(
        "",
        f"without the noise the model is wrong by {base['model_mm']:.3f} mm rms "
        f"({base['model_low_mm']:.3f} to {base['model_high_mm']:.3f})",
    )


def _chance(p: float | None) -> str:
    """A bootstrap's p-value."""
    if p is None:
        return ""
    return f", p < {p:.1g}" if p < 1e-3 else f", p = {p:.2g}"


def _where(d: Diagnosis) -> Iterator[str]:
    parts = pd.concat([d.where.joints, d.where.links])
    great = parts[(parts["share"] >= 0.05) & (parts["part"] != "elsewhere")].sort_values("share", ascending=False)
    shares = [
        _tied(f"{row['part']}: {100 * row['share']:.0f} % ({100 * row['low']:.0f}-{100 * row['high']:.0f})")
        for _, row in great.head(5).iterrows()
    ]
    if d.verdict == "none":
        yield from _block("WHERE", "nowhere in particular: what is left is noise")
        return
    yield from _block("WHERE", "   ".join(shares) or "spread over all parts")
    worst = d.where.worst.head(3)
    if len(worst):
        regions = [f"{row['by']} {row['part']} ({row['rms_mm']:.3f} mm rms)" for _, row in worst.iterrows()]
        yield from _block("", f"larger than elsewhere: {', '.join(regions)}")


def _which(d: Diagnosis) -> Iterator[str]:
    if not d.causes:
        yield from _block("WHICH", "no cause can be named")
        return
    order = "; the largest shrink first" if len(d.causes) > 1 else ""
    yield f"{'WHICH':<{LABEL}}each cause alone beside the base model{order}"
    yield f"   {'signature':<{COLUMN}} {'posterior':>9} {'gap if added':>16} {'shrinks by, 95 %':>18}"
    for k, c in enumerate(d.causes, 1):
        words, _ = signature(c)
        first, *more = textwrap.wrap(words, COLUMN)
        low, high = (100 * v for v in c.shrink_interval)
        row = " -> ".join(map(_mm, if_added(d, c)))
        yield f"{k:>2} {first:<{COLUMN}} {c.confidence:>9.2f} {row:>16} {f'{low:.0f} to {high:.0f} %':>18}"
        yield from (f"   {line}" for line in more)
        yield from _beneath(d, c)


def if_added(d: Diagnosis, c: Cause) -> tuple[float, float]:
    """The gap without and with one cause [m]: outliers beside all poses, an effect beside those that are kept."""
    if c.effect == "outliers":
        return d.gap.before, d.gap.before * (1 - c.shrink)
    before = 1e-3 * float(d.course.iloc[0]["gap_mm"])
    alone = sum(bool(k.effects) for k in d.causes) == 1
    return before, d.gap.after if alone else before * (1 - c.shrink)


def _beneath(d: Diagnosis, c: Cause) -> Iterator[str]:
    """The name by which the cause goes, what it may be mechanically, and its parameters."""
    _, mechanical = signature(c)
    may_be = f"; may be {mechanical}" if mechanical else ""
    yield from _wrapped(f"{c.label}{may_be}", "     ", "     ")
    values = [f"{name} {value:.3g}" for e in c.effects for name, value in settings(e).items()]
    values += [_estimate(name, *given) for name, given in (c.estimates or {}).items()]
    if c.effect == "outliers":
        values = [f"rows {', '.join(str(o.row) for o in d.outliers[:10])}{' ...' if len(d.outliers) > 10 else ''}"]
    if values:
        yield from _wrapped(", ".join(map(_tied, values)), "     ", "     ")


def signature(c: Cause) -> tuple[str, str]:
    """What the data show, and the mechanical causes that share it."""
    words = "single points that are wrong" if c.effect == "outliers" else signature_of(c.effect)
    if c.effects:
        words = words or c.effects[0].signature or c.effects[0].physics
    shown, _, causes = words.partition(" (")
    if c.joint != 2:
        causes = causes.replace("; balancer on joint 2", "")
    joint = "" if c.joint is None else f", joint {c.joint}"
    return shown + joint, causes.rstrip(")")


def _estimate(name: str, value: float, error: float, unit: str) -> str:
    factor, word = readable(unit, max(abs(value), error))
    return f"{name} {factor * value:.3g} +- {factor * error:.2g} {word}".rstrip()


def readable(unit: str, size: float) -> tuple[float, str]:
    """Factor and unit in which a parameter of this size is shown; lengths of a millimetre and more in mm."""
    return (1e3, "mm") if unit == "m" and size >= 1e-3 else READABLE.get(unit, (1.0, unit))


def _how_far(d: Diagnosis, e: Extras) -> Iterator[str]:
    steps = [c for c in d.causes if c.effects]
    if steps:
        last, added = d.course.iloc[-1], "with it" if len(steps) == 1 else "with all of them"
        yield from _block(
            "AFTER",
            f"{last['gap_mm']:.3f} mm {added} ({last['low_mm']:.3f} to {last['high_mm']:.3f}), poses left out one by "
            f"one {last['loo_mm']:.3f}; noise floor {_mm(d.gap.floor)}",
        )
        before, after, share = left_over(d)
        yield from _block(
            "",
            f"without the noise the model is then wrong by {after:.3f} mm rms ({last['model_low_mm']:.3f} to "
            f"{last['model_high_mm']:.3f}), {100 * share:.0f} % of the {before:.3f} before",
        )
        if any(of_time(c.effects) for c in steps):
            first = d.course.iloc[0]
            yield from _block(
                "", f"with fifths of the time left out: {first['blocks_mm']:.3f} -> {last['blocks_mm']:.3f} mm"
            )
    if e.check:
        yield from _block("", refitted(e.check))
    if e.networks:
        yield from _networks(e.networks, bool(steps))


def refitted(check: Check) -> str:
    """What the nonlinear refit says; it is tried on one partition into fifths, the gap is the mean over several."""
    off = 100 * (check.refit / check.linearised - 1)
    said = "they agree" if check.agree else "they DISAGREE"
    return (
        f"refitted by Ipopt, nonlinear: {_mm(check.refit)} mm on the first partition into fifths, {abs(off):.0f} % "
        f"{'above' if off >= 0 else 'below'} the linearised model there; {said}"
    )


def _networks(networks: tuple[NetworkGap, NetworkGap], steps: bool) -> Iterator[str]:
    for net, what in zip(networks[: 1 + steps], ("instead", "on the rest"), strict=False):
        refused = f", refused in {net.refused} of 5 trainings" if net.refused else ""
        yield from _block(
            "",
            f"6-5-3 network {what if steps else 'on the gap'}: {_mm(net.before)} -> {_mm(net.used)} mm{refused}"
            + (f" (used all the same: {_mm(net.forced)})" if net.refused else ""),
        )


def _cannot_tell(d: Diagnosis) -> Iterator[str]:
    for label, others in alike(d).items():
        yield from _block("CANNOT", f"tell {label} from {others}")
    for why, labels in invisible(d).items():
        yield from _block("CANNOT", f"see, {why}: {labels}")


def _unknown(d: Diagnosis) -> Iterator[str]:
    if has_rest(d):
        more = [words for words in (resembles(d), unsure_floor(d)) if words]
        yield from _block(
            "UNKNOWN", "; ".join([f"{left_over(d)[1]:.3f} mm rms that no cause named here explains", *more])
        )


def _outliers(d: Diagnosis) -> Iterator[str]:
    if d.outliers:
        shown = [f"row {o.row} ({1e3 * o.distance:.2f} mm)" for o in d.outliers[:6]]
        more = f" and {len(d.outliers) - 6} more" if len(d.outliers) > 6 else ""
        count = (
            "1 pose left out as an outlier" if len(d.outliers) == 1 else f"{len(d.outliers)} poses left out as outliers"
        )
        yield from _block("OUT", f"{count}: {', '.join(shown)}{more}")


def _not_logged(d: Diagnosis) -> Iterator[str]:
    for columns, what in not_logged(d).items():
        yield from _block("MISSING", f"{columns}: not logged; it would show {what}")


def _next(d: Diagnosis, e: Extras) -> Iterator[str]:
    if e.poses is None or not len(e.poses):
        return
    before, after = told_apart(d, e.poses)
    where = f" -> {e.file}" if e.file else ""
    yield from _block(
        "NEXT",
        f"measure {len(e.poses)} poses{where} ({kinds(d.case, e.poses)}) to tell {' from '.join(d.in_question)}: "
        f"P(correct) {before:.2f} -> {after:.2f}",
    )
