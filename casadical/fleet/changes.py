"""What a comparison of campaigns found, and its words, tables and plain data."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.special import fdtrc

from casadical.core.basics import Array
from casadical.core.statistics import best_of, ranked
from casadical.core.telling.blocks import Block, Page, Section, Table, Tile, Words, figures_named, mm, next_step
from casadical.core.telling.figure import Axis, Figure, Series, Span
from casadical.core.telling.plain import WRITTEN, Key, plain, written
from casadical.core.telling.result import Result
from casadical.fleet.estimates import Estimate
from casadical.fleet.evidence import ROBOT, Candidate, Course
from casadical.identification.prior import probability_of_change

# A change is said to be there where the data are so many times more probable with one; by chance that happens once in
# so many lives at most.
SURE = 100.0
# Of another robot those parameters are counted that differ by more than so many standard errors.
CLEAR = 3
HOW: dict[Course, str] = {
    "jump": "a jump since",
    "drift": "a drift that shows since",
    "season": "comes again every year since",
    "once": "only in",
}
AXES = {
    "joint_zero": "zero of joint {joint}",
    "joint_stiffness": "compliance of joint {joint}",
    "lengths": "all lengths",
}
_COURSE = (
    "Change since the first campaign, as each campaign alone shows it, with its 95 % interval. Of several parameters "
    "the one that moved most surely is drawn; the others move with it. Shaded: where it began, with 95 % probability."
)
_LEFT = "What nothing explains, of one coordinate. A campaign that stands out was measured or prepared differently."
# So many rivals and parameters are shown of a change.
RIVALS, AMOUNTS = 4, 8
# What a campaign leaves may differ so many times from day to day; more is named, by chance in so many cases at most.
USUAL, ALARMS = 1.2, 0.01
# Share of the reach that no calibrated robot is off by.
GAP = 0.003
UNKNOWN = "no cause that is known here explains it: another instrument, wrong rows, or an error that the model lacks"
# Degrees of freedom from which on a campaign tells its own noise.
FEWEST = 6
# Rivals below this probability are not shown.
SMALL = 0.005
# Data are said to be so many times more probable, as a power of ten, at most.
MOST = 100
_SEEN = ("cause", "size", "unit")
# In place of a size, see `casadical.fleet.comparison._seen_from`.
NOT_SEEN = "not below 30 times its usual size"


@dataclass(frozen=True, eq=False)
class Amount:
    """How far one parameter moved, with its standard error; of a drift, in a year or in 12 campaigns [unit]."""

    name: str = field(metadata=written("parameter"))
    value: float = field(metadata=written("change"))
    std_error: float = field(metadata=WRITTEN)
    unit: str = field(metadata=WRITTEN)


@dataclass(frozen=True, eq=False)
class Rival:
    """One cause that explains a change, as joint_zero@2: its most probable course, first campaign and probability."""

    label: str = field(metadata=written("cause"))
    course: Course = field(metadata=WRITTEN)
    since: int
    probability: float = field(metadata=written(digits=5))


@dataclass(frozen=True, eq=False)
class Change:
    """One change between campaigns; cause, course : the most probable ones.

    since : first campaign that shows it, from 0; between : those at which it may have begun, with 95 % probability
    probability : of the cause, if something changed; p_course : of the course, given the cause
    log_odds : of the data with some change against none
    rivals : causes in the order of their probability, the first one included; amounts : how far each parameter moved
    course_of : Array, shape (n, 2): what each campaign alone says of the size, in units of the whole change, with
        standard error
    """

    derived: ClassVar[tuple[Key, ...]] = (Key("cause", "cause.label"), Key("named"), Key("words"))

    cause: Candidate
    course: Course = field(metadata=WRITTEN)
    since: int
    between: tuple[int, int]
    probability: float = field(metadata=written(digits=5))
    p_course: float = field(metadata=written("course_probability", digits=5))
    log_odds: float = field(metadata=written(digits=3))
    rivals: tuple[Rival, ...]
    amounts: tuple[Amount, ...] = field(metadata=WRITTEN)
    course_of: Array

    @property
    def words(self) -> str:
        """What it means, with its likely cause."""
        return MEANT[self.course][self.cause.kind].format(joint=self.cause.joint, label=self.cause.effect)

    @property
    def main(self) -> int:
        """Place of the parameter in `amounts` that moved most surely, of a season in its first wave."""
        return best_of(range(len(self.cause.sizes)), lambda k: _sureness(self.amounts[k]))

    @property
    def named(self) -> bool:
        """Whether the data distinguish this cause from all others."""
        # One cause is named where it is so probable among all.
        return self.probability >= 0.95


@dataclass(frozen=True, eq=False)
class Comparison(Result):
    """Several campaigns of one robot, and what changed between them.

    campaigns : in the order of time
    names : parameters that they share
    changes : what changed, the surest first
    log_odds : how much more probable the data are with one change more than with these; of the first change if there is
        none
    seen_from : (cause, size, unit): what a change between the last two campaigns would have to be to be seen
    placements : (what, how) of base and tool, which were fitted again
    notes : what was assumed of the campaigns
    name : of the robot as its user knows it; empty: that of its type
    sources : what the last campaign can be calibrated from: a problem folder or robot file, and its table

    Examples
    --------
    >>> comparison
    <Comparison of 2 campaigns of 'Planar arm of two links': lengths>
    >>> print(casadical.core.telling.result.plain_text(comparison.blocks()))  # doctest: +ELLIPSIS
    CHANGED: lengths...
    >>> comparison.to_json()["changes"][0]["since"]
    'March'
    """

    line: ClassVar[str] = (
        " of {{ it.campaigns | length }} campaigns of {{ it.campaigns[0].robot.name | repr }}: "
        "{{ it.changes | map(attribute='cause.label') | join(', ') or 'nothing changed' }}"
    )

    report: ClassVar[str] = "changes.j2"
    derived: ClassVar[tuple[Key, ...]] = (
        Key("robot", lambda found: found.campaigns[0].robot.name),
        Key("changed"),
        Key("unexplained"),
        Key("next", "commands"),
        Key("sure_from_log_odds", lambda _: np.log(SURE), digits=3),
        Key("changes", lambda found: [_as_plain(c, [e.label for e in found.campaigns]) for c in found.changes]),
        Key("placements", lambda found: dict(found.placements)),
        Key("seen_from", lambda found: [dict(zip(_SEEN, row, strict=True)) for row in found.seen_from]),
    )

    campaigns: tuple[Estimate, ...] = field(metadata=WRITTEN)
    names: tuple[str, ...]
    changes: tuple[Change, ...]
    log_odds: float = field(metadata=written("log_odds_of_one_more", digits=3))
    seen_from: tuple[tuple[str, float, str], ...]
    placements: tuple[tuple[str, str], ...]
    notes: tuple[str, ...] = field(default=(), metadata=WRITTEN)
    name: str = field(default="", metadata=WRITTEN)
    sources: tuple[Path, ...] = ()

    @property
    def changed(self) -> bool:
        """Whether anything changed that has a name."""
        return bool(self.changes)

    @property
    def unexplained(self) -> tuple[str, ...]:
        """Sentences of campaigns that leave more than the others, or than any calibrated robot does, or too little."""
        left = [(c, c.sigma, c.freedom) for c in self.campaigns if c.sigma is not None and c.freedom is not None]
        said = []
        for k, (c, sigma, freedom) in enumerate(left):
            others = [(s, f) for _, s, f in left[:k] + left[k + 1 :]]
            if sigma > GAP * c.robot.reach:
                share = f"{100 * sigma / c.robot.reach:.2g} % of the reach, which is no calibrated robot's error"
                said.append(f"{c.label} leaves {mm(sigma)} mm a coordinate, {share}; {UNKNOWN}")
            elif usual := leaves_more((sigma, freedom), others, ALARMS / len(left)):
                said.append(f"{c.label} leaves {mm(sigma)} mm a coordinate, the others {mm(usual)}; {UNKNOWN}")
            elif freedom < FEWEST and not others:
                said.append(
                    f"{c.label} has {c.poses} poses, too few beside a robot file; give the problem folder of the "
                    "calibration, or measure more poses"
                )
        return tuple(said)

    @property
    def dated(self) -> bool:
        """Whether all campaigns have a day; else they are counted."""
        return all(c.date for c in self.campaigns)

    @property
    def span(self) -> str:
        """How many campaigns, and from when to when."""
        first, last = (c.date or c.label for c in (self.campaigns[0], self.campaigns[-1]))
        return f"{len(self.campaigns)} campaigns, {first} to {last}"

    def blocks(self) -> list[Block]:
        rows = [(name, f"{v:.2g} {unit}" if np.isfinite(v) else NOT_SEEN) for name, v, unit in self.seen_from]
        seen = Table("A jump before the last campaign would be seen from", ("cause", "size"), rows, folded=True)
        functions = (in_words, times_in_words, probability_of_change)
        named = {function.__name__: function for function in functions}
        return self._report_blocks(tables=[_campaigns(self), seen], tables_of=_tables_of, **named)

    @property
    def next(self) -> tuple[Words, ...]:
        """What to do now, where the last campaign is a table, or nothing changed."""
        if self.sources and self.changed:
            return (next_step("to calibrate it as it is now", "calibrate", *self.sources, "--out", "results"),)
        if self.sources and self.unexplained:
            return (next_step("to learn what the model lacks", "diagnose", *self.sources),)
        return ()

    def figures(self) -> dict[str, Figure]:
        """By name: change/CAUSE for each change, and left, the scatter of each campaign."""
        step = None if self.dated else 1 + len(self.campaigns) // 12  # between the ticks
        figures = [_course(self, change, step) for change in self.changes]
        if any(c.sigma is not None for c in self.campaigns):
            left = [None if c.sigma is None else 1e3 * c.sigma for c in self.campaigns]
            life = (self.campaigns[0].robot.name, _places(self), left, False)
            figures.append(left_figure("left", [life], step, height=260, caption=_LEFT))
        return {figure.name: figure for figure in figures}

    def page(self, files: Sequence[Path] = ()) -> Page:
        """Words, tables and figures as `casadical compare --report` writes them; files : what was read."""
        figures, blocks = self.figures(), self.blocks()
        end = next(k for k, b in enumerate(blocks) if isinstance(b, Table) and b.title == "Campaigns")
        sections = [
            Section("What changed", blocks[:end]),
            Section("Over the life of the robot", figures_named(figures, "change")),
            Section("Campaigns", [*figures_named(figures, "left"), *blocks[end:]]),
        ]
        kind = self.campaigns[0].robot.name
        name, read = self.name or kind, [path for path in files if path.is_file()]
        causes, sigma = [c.cause.label for c in self.changes], self.campaigns[-1].sigma
        tiles = [Tile("Changes", str(len(causes)), "", ", ".join(causes) or "none")]
        tiles += [] if sigma is None else [Tile("Left, last campaign", mm(sigma), "mm", "of one coordinate")]
        return Page(f"{name}: what changed", name, f"{kind}: {self.span}", sections, tiles, files=read)


def leaves_more(own: tuple[float, float], others: Sequence[tuple[float, float]], alarms: float) -> float:
    """What other campaigns leave, where one leaves more than that and `USUAL` and chance explain; else 0.

    own, others : scatter and its degrees of freedom; alarms : how often that is to be said of one where nothing changed
    """
    if not others:
        return 0.0
    left, free = np.array(others).T
    usual = float(np.sqrt(np.average(left**2, weights=free)))
    chance = fdtrc(own[1], free.sum(), (own[0] / (USUAL * usual)) ** 2)
    return usual if chance <= alarms else 0.0


def in_words(found: Comparison, change: Change) -> str:
    """What changed, how, since when, and by how much where it has one name."""
    since = found.campaigns[change.since].label
    if not change.named:
        held = np.cumsum([r.probability for r in change.rivals])
        rivals = " or ".join(r.label for r in change.rivals[: 1 + int(np.searchsorted(held, 0.95))])
        return f"{rivals}, which these poses do not distinguish, {HOW[change.course]} {since}"
    if change.cause.kind == ROBOT:
        moved = sum(abs(a.value) > CLEAR * a.std_error for a in change.amounts)
        of = f"{moved} of {len(change.amounts)} parameters differ by more than {CLEAR} standard errors"
        return f"{change.cause.label}, {HOW[change.course]} {since}: {of}"
    main = best_of(change.amounts, _sureness)
    size = f"{main.name} {main.value:+.3g} {main.unit}{_per(found, change)} +/- {main.std_error:.2g}"
    return f"{change.cause.label}, {HOW[change.course]} {since}: {size}"


def _sureness(amount: Amount) -> float:
    return abs(amount.value) / max(amount.std_error, 1e-300)


def _per(found: Comparison, change: Change) -> str:
    """What time a change is counted by."""
    return "" if change.course != "drift" else " a year" if found.campaigns[0].day is not None else " in 12 campaigns"


def _tables_of(found: Comparison, change: Change) -> list[Table]:
    """Return the causes that explain a change, and by how much each parameter moved."""
    rows = [(r.label, r.course, found.campaigns[r.since].label, f"{r.probability:.3f}") for r in change.rivals[:RIVALS]]
    rows = [row for k, row in enumerate(rows) if k == 0 or change.rivals[k].probability >= SMALL]
    causes = Table("Causes", ("cause", "course", "since", "probability"), rows, frozenset({3}), strong=frozenset({0}))
    amounts: Sequence[Amount] = change.amounts
    if len(amounts) > AMOUNTS:
        amounts = [amounts[k] for k in ranked([_sureness(a) for a in amounts])[:AMOUNTS]]
    per = _per(found, change)
    cells = [(a.name, f"{a.value:+.3g}", f"{a.std_error:.2g}", a.unit + per) for a in amounts]
    return [causes, Table("By how much", ("parameter", "change", "std error", "unit"), cells, frozenset({1, 2}))]


def times_in_words(log_odds: float) -> str:
    if log_odds > MOST * np.log(10):
        return f"more than 1e{MOST}"
    return f"{np.exp(log_odds):.3g}" if log_odds < 20 else f"1e{log_odds / np.log(10):.0f}"


def _campaigns(found: Comparison) -> Table:
    rows = [
        (c.label, str(at), str(c.poses), "" if c.sigma is None else mm(c.sigma), f"{c.misfit:.2f}", "; ".join(c.notes))
        for c, at in zip(found.campaigns, _places(found), strict=True)
    ]
    head = ("campaign", "day" if found.dated else "number", "poses", "left [mm]", "misfit", "")
    return Table("Campaigns", head, rows, frozenset({2, 3, 4}))


def _places(found: Comparison) -> list[Any]:
    """Where each campaign stands on the axis: its day, or its number, from 1, where not all have a day."""
    return [c.date if found.dated else k for k, c in enumerate(found.campaigns, 1)]


def _course(found: Comparison, change: Change, step: int | None) -> Figure:
    x, main = _places(found), change.amounts[change.main]
    size, error = main.value * change.course_of[:, 0], abs(main.value) * change.course_of[:, 1]
    what = AXES.get(change.cause.kind, main.name).format(joint=change.cause.joint)
    sizes = Series(
        "linked",
        x,
        size,
        width=1,
        shape="hvh" if change.course == "jump" else "linear",
        size=8,
        more=1.96 * error,
        facts=[c.label for c in found.campaigns],
        tip="<b>%{customdata}</b><br>%{y:.3g} " + main.unit,
    )
    first, last = change.between
    spans = [] if change.course == "season" else [Span(x[max(first - 1, 0)], x[last])]
    return Figure(
        f"change/{change.cause.label}",
        f"{change.cause.label}: {HOW[change.course]} {found.campaigns[change.since].label}",
        [sizes],
        Axis("campaign", step=step),
        Axis(f"{what} [{main.unit}]"),
        caption=_COURSE,
        marks=spans,
    )


def left_figure(
    name: str,
    lives: Iterable[tuple[str, Sequence[Any], Sequence[float | None], bool]],
    step: int | None = None,
    **figure: Any,
) -> Figure:
    """What nothing explains in each campaign; lives : (name, places on the axis, left [mm], changed) of robots."""
    series = [
        Series(
            "linked",
            x,
            list(left),
            colour="red" if changed else "grey",
            width=2 if changed else 1,
            facts=[robot] * len(left),
            tip="<b>%{customdata}</b>, %{x}<br>%{y:.4f} mm",
        )
        for robot, x, left, changed in lives
    ]
    x, y = Axis("campaign", step=step), Axis("one sigma [mm]", begins=True)
    return Figure(name, "Left in each campaign", series, x, y, **figure)


def _as_plain(c: Change, labels: list[str]) -> dict[str, Any]:
    """Return a change as plain data, campaigns by their labels."""
    course = [{"campaign": n, "size": s, "std_error": e} for n, (s, e) in zip(labels, c.course_of, strict=True)]
    rivals = [{**plain(r), "since": labels[r.since]} for r in c.rivals if r.probability >= SMALL]
    between = [labels[k] for k in c.between]
    return {**plain(c), "since": labels[c.since], "between": between, "rivals": rivals, "course_of": course}


MEANT: dict[Course, dict[str, str]] = {
    "jump": {
        "joint_zero": "the zero of joint {joint} is another: a crash, a slipped belt or a lost reference",
        "joint_stiffness": "joint {joint} bends by another amount under load: a belt or screws that came loose or were "
        "tightened, or damage of the gear",
        "joint_curve": "the error curve of joint {joint} over its own angle is another: damage of the gear, or its "
        "encoder was mounted again",
        "gear": "zero, stiffness and error curve of joint {joint} changed together: another gear",
        "link": "the geometry before joint {joint} is another: a bent link or a screw joint that slipped",
        "loop": "bars of four-bar {joint} have other lengths: a crash, or a bar was replaced",
        "lengths": "all lengths grew or shrank by one share: another temperature, or another scale of the instrument",
        "tool": "the measured point on the flange is elsewhere: another tool, or the same one mounted again",
        "foot": "the robot's foot moved in the measuring frame: a crash, or the robot was mounted again",
        "effect": "{label} has other values",
        ROBOT: "this looks like another robot than before: its parameters of all kinds differ, by as much as robots of "
        "one type do; look at the serial numbers and at the names of the tables",
    },
    "drift": {
        "joint_zero": "the zero of joint {joint} moves little by little: a belt that stretches, wear of the gear, or "
        "an encoder or a fastening that works loose",
        "joint_stiffness": "joint {joint} bends by another amount under load, little by little: a belt or screws that "
        "loosen, or wear of the gear",
        "joint_curve": "the error curve of joint {joint} over its own angle changes little by little: wear of the gear",
        "lengths": "all lengths grow or shrink by one share: a temperature or a scale of the instrument that drifts",
        "foot": "the robot's foot creeps in the measuring frame: ground that settles, or anchors that loosen",
    },
    "season": {"lengths": "all lengths grow and shrink by one share over the year: the temperature of the hall"},
    "once": {
        ROBOT: "this looks like another robot than before and after: its parameters of all kinds differ, by as much as "
        "robots of one type do; look at its serial number and at the name of the table",
    },
}
