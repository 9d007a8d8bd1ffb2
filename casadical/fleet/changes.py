"""Result of a comparison of campaigns: the changes found, and their words, tables and figures."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from casadical.core.basics import Array
from casadical.core.reporting.blocks import Block, Page, Section, Table, Tile, Words, figures_named, mm, next_step
from casadical.core.reporting.figure import Axis, Figure, Series
from casadical.core.reporting.plain import WRITTEN, Key, plain, written
from casadical.core.reporting.result import Result
from casadical.core.statistics import best_of, ranked
from casadical.fleet.estimates import MIN_FREEDOM, Estimate, exceeds_by_chance
from casadical.fleet.evidence import ANOTHER_ROBOT, Candidate, Course
from casadical.identification.prior import probability_of_change

# Smallest Bayes factor of any change against none for which a change is reported. For a robot that
# does not change this happens with a probability of 1/100 at most over its whole life (Ville 1939).
MIN_ODDS_OF_CHANGE = 100.0
# Words of a report for each course of a change; the label of the campaign follows them.
COURSE_WORDS: dict[Course, str] = {
    "jump": "a jump since",
    "drift": "a drift that shows since",
    "season": "comes again every year since",
    "once": "only in",
}
# Caption of the figure of each campaign's residuals.
_RESIDUALS_CAPTION = (
    "What nothing explains, of one coordinate. A campaign that stands out was measured or prepared differently."
)
# Probability that a ratio above 1.2 is reported by chance, over all campaigns together.
FALSE_ALARM_PROBABILITY = 0.01
# Smallest probability of a possible cause that is listed; the most probable one always is.
MIN_PROBABILITY_SHOWN = 0.005


@dataclass(frozen=True, eq=False)
class Amount:
    """Change of one parameter, with its standard error; for a drift, per year or per 12 campaigns.

    name : name of the parameter
    value, std_error : change and its standard error, in `unit`
    unit : readable unit, such as mm, deg or um/m
    """

    name: str = field(metadata=written("parameter"))
    value: float = field(metadata=written("change"))
    std_error: float = field(metadata=WRITTEN)
    unit: str = field(metadata=WRITTEN)


@dataclass(frozen=True, eq=False)
class Rival:
    """One possible cause of a change.

    label : label of the cause, such as joint_zero@2
    course : most probable course of the cause
    since : index of the first campaign that shows it, from 0
    probability : probability of the cause, given that something changed
    """

    label: str = field(metadata=written("cause"))
    course: Course = field(metadata=WRITTEN)
    since: int
    probability: float = field(metadata=written(digits=5))


@dataclass(frozen=True, eq=False)
class Change:
    """One change between campaigns.

    cause, course : most probable cause and course
    since : index of the first campaign that shows the change, from 0
    between : indices of the first and the last campaign that may be `since`, with 95 % probability
    probability : probability of the cause, given that something changed
    p_course : probability of the course, given the cause
    log_odds : natural logarithm of the odds of some change against none
    rivals : possible causes in the order of their probability, `cause` included
    amounts : change of each parameter of the cause
    course_of : size of the change in each campaign alone relative to the first one, divided by the
        whole change, and its standard error, shape (n, 2)
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
        """Return the technical meaning of the change, in words."""
        return MEANINGS[self.course][self.cause.kind].format(joint=self.cause.joint, label=self.cause.effect)

    @property
    def main(self) -> int:
        """Return the index in `amounts` of the greatest ratio of change to standard error.

        For a season only the sine terms count.
        """
        return best_of(range(len(self.cause.sizes)), lambda k: _sureness(self.amounts[k]))

    @property
    def named(self) -> bool:
        """Return whether the data distinguish this cause from all others (probability 0.95 or more)."""
        return self.probability >= 0.95


@dataclass(frozen=True, eq=False)
class Comparison(Result):
    """Several campaigns of one robot, and what changed between them.

    campaigns : estimates of the campaigns in the order of time
    names : parameters that all campaigns have and that may change
    changes : accepted changes in the order in which they were found
    log_odds : natural logarithm of the odds of an additional change against none
    seen_from : (cause, size, unit) of the smallest jump of each joint's zero and stiffness before
        the last campaign that would be detected; the size is infinite where none would be
    placements : ("tool" or "base", text): how they moved before the last campaign, where they were
        fitted again
    notes : sentences on what was assumed of the campaigns
    name : name of the robot that its user gave; empty: that of its type
    sources : problem folder or robot file, then table, from which the last campaign can be
        calibrated; empty: none

    Examples
    --------
    >>> comparison
    <Comparison of 2 campaigns of 'Planar arm of two links': lengths>
    >>> print(casadical.core.reporting.result.plain_text(comparison.blocks()))  # doctest: +ELLIPSIS
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
        Key("sure_from_log_odds", lambda _: np.log(MIN_ODDS_OF_CHANGE), digits=3),
        Key("changes", lambda found: [_as_plain(c, [e.label for e in found.campaigns]) for c in found.changes]),
        Key("placements", lambda found: dict(found.placements)),
        Key(
            "seen_from",
            lambda found: [dict(zip(("cause", "size", "unit"), row, strict=True)) for row in found.seen_from],
        ),
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
        """Return whether any change was found."""
        return bool(self.changes)

    @property
    def unexplained(self) -> tuple[str, ...]:
        """Return sentences on campaigns whose residuals are unusual, or whose poses are too few.

        Residuals are unusual if they exceed those of the others, or those of any calibrated robot.
        """
        fitted = [(c, c.sigma, c.freedom) for c in self.campaigns if c.sigma is not None and c.freedom is not None]
        said = []
        # End of a sentence on unusual residuals.
        unexplained = "no listed cause explains it: another instrument, wrong rows, or an error that the model lacks"
        for k, (c, sigma, freedom) in enumerate(fitted):
            others = [(s, f) for _, s, f in fitted[:k] + fitted[k + 1 :]]
            # A calibrated robot's residual sigma of a coordinate is a smaller share of its reach.
            if sigma > 0.003 * c.robot.reach:
                share = f"{100 * sigma / c.robot.reach:.2g} % of the reach, which is no calibrated robot's error"
                said.append(f"{c.label} leaves {mm(sigma)} mm per coordinate, {share}; {unexplained}")
            elif usual := exceeded_residual((sigma, freedom), others, FALSE_ALARM_PROBABILITY / len(fitted)):
                said.append(f"{c.label} leaves {mm(sigma)} mm per coordinate, the others {mm(usual)}; {unexplained}")
            elif freedom < MIN_FREEDOM and not others:
                said.append(
                    f"{c.label} has {c.poses} poses, too few to compare with a robot file; give the problem "
                    "folder of the calibration, or measure more poses"
                )
        return tuple(said)

    @property
    def dated(self) -> bool:
        """Return whether every campaign has a date; if not, campaigns are numbered from 1."""
        return all(c.date for c in self.campaigns)

    @property
    def span(self) -> str:
        """Return the number of campaigns and the first and the last day or label, as text."""
        first, last = (c.date or c.label for c in (self.campaigns[0], self.campaigns[-1]))
        return f"{len(self.campaigns)} campaigns, {first} to {last}"

    def blocks(self) -> list[Block]:
        """Return the report as blocks of text and tables."""
        # Text for a size that is not detectable (see `comparison._detectable_sizes`).
        rows = [
            (name, f"{v:.2g} {unit}" if np.isfinite(v) else "not below 30 times its usual size")
            for name, v, unit in self.seen_from
        ]
        seen = Table("A jump before the last campaign would be seen from", ("cause", "size"), rows, folded=True)
        functions = (in_words, times_in_words, probability_of_change)
        named = {function.__name__: function for function in functions}
        lines = []
        for c, at in zip(self.campaigns, _places(self), strict=True):
            sigma = "" if c.sigma is None else mm(c.sigma)
            lines.append((c.label, str(at), str(c.poses), sigma, f"{c.misfit:.2f}", "; ".join(c.notes)))
        head = ("campaign", "day" if self.dated else "number", "poses", "residual [mm]", "misfit", "")
        campaigns = Table("Campaigns", head, lines, frozenset({2, 3, 4}))
        return self._report_blocks(tables=[campaigns, seen], tables_of=_tables_of, **named)

    @property
    def next(self) -> tuple[Words, ...]:
        """Return the suggested next command in a tuple of one.

        It is empty if the last campaign is no table, or there is neither a change nor an
        unexplained residual.
        """
        if self.sources and self.changed:
            return (next_step("to calibrate it as it is now", "calibrate", *self.sources, "--out", "results"),)
        if self.sources and self.unexplained:
            return (next_step("to learn what the model lacks", "diagnose", *self.sources),)
        return ()

    def figures(self) -> dict[str, Figure]:
        """Return the figures by name: change/CAUSE for each change, "left" for the residuals."""
        step = None if self.dated else 1 + len(self.campaigns) // 12  # between the ticks
        figures = [_course(self, change, step) for change in self.changes]
        if any(c.sigma is not None for c in self.campaigns):
            sigmas = [None if c.sigma is None else 1e3 * c.sigma for c in self.campaigns]
            life = (self.campaigns[0].robot.name, _places(self), sigmas, False)
            figures.append(residuals_figure("left", [life], step, height=260, caption=_RESIDUALS_CAPTION))
        return {figure.name: figure for figure in figures}

    def page(self, files: Sequence[Path] = ()) -> Page:
        """Return the report of `casadical compare --report` as a page; files : what was read."""
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


def exceeded_residual(own: tuple[float, float], others: Sequence[tuple[float, float]], alarms: float) -> float:
    """Return the pooled residual of other campaigns if a campaign significantly exceeds it; else 0.

    `exceeds_by_chance` decides whether the ratio exceeds 1.2. The result is in the unit of
    `others`; it is 0 without others.

    own : residual sigma of a coordinate of the campaign, and its degrees of freedom
    others : the same pair for each of the other campaigns
    alarms : level of significance, the probability of a false alarm
    """
    if not others:
        return 0.0
    sigmas, free = np.array(others).T
    usual = float(np.sqrt(np.average(sigmas**2, weights=free)))
    return usual if exceeds_by_chance(own, (usual, free.sum()), 1.2) <= alarms else 0.0


def in_words(found: Comparison, change: Change) -> str:
    """Return a change in words: its cause, course, first campaign and, for a named cause, size.

    The size is that of its most significant parameter, for another robot the number of clear ones.

    found : comparison to which the change belongs
    """
    since = found.campaigns[change.since].label
    if not change.named:
        cumulative = np.cumsum([r.probability for r in change.rivals])
        rivals = " or ".join(r.label for r in change.rivals[: 1 + int(np.searchsorted(cumulative, 0.95))])
        return f"{rivals}, which these poses do not distinguish, {COURSE_WORDS[change.course]} {since}"
    # Smallest difference at which a parameter of another robot counts as different [standard
    # errors].
    min_clear_sigmas = 3
    if change.cause.kind == ANOTHER_ROBOT:
        moved = sum(abs(a.value) > min_clear_sigmas * a.std_error for a in change.amounts)
        of = f"{moved} of {len(change.amounts)} parameters differ by more than {min_clear_sigmas} standard errors"
        return f"{change.cause.label}, {COURSE_WORDS[change.course]} {since}: {of}"
    main = best_of(change.amounts, _sureness)
    size = f"{main.name} {main.value:+.3g} {main.unit}{_per(found, change)} +/- {main.std_error:.2g}"
    return f"{change.cause.label}, {COURSE_WORDS[change.course]} {since}: {size}"


def _sureness(amount: Amount) -> float:
    """Return the absolute ratio of a parameter's change to its standard error."""
    return abs(amount.value) / max(amount.std_error, 1e-300)


def _per(found: Comparison, change: Change) -> str:
    """Return the unit of time of a drift: " a year" or " in 12 campaigns"; "" for other courses."""
    return "" if change.course != "drift" else " a year" if found.campaigns[0].day is not None else " in 12 campaigns"


def _tables_of(found: Comparison, change: Change) -> list[Table]:
    """Return two tables of a change: its possible causes, and the changes of its parameters."""
    # The table holds the first cause, and of the next three those that are probable enough.
    rows = [(r.label, r.course, found.campaigns[r.since].label, f"{r.probability:.3f}") for r in change.rivals[:4]]
    rows = [row for k, row in enumerate(rows) if k == 0 or change.rivals[k].probability >= MIN_PROBABILITY_SHOWN]
    causes = Table("Causes", ("cause", "course", "since", "probability"), rows, frozenset({3}), strong=frozenset({0}))
    amounts: Sequence[Amount] = change.amounts
    # Largest number of parameters in the table of a change.
    max_amounts_shown = 8
    if len(amounts) > max_amounts_shown:
        amounts = [amounts[k] for k in ranked([_sureness(a) for a in amounts])[:max_amounts_shown]]
    per = _per(found, change)
    cells = [(a.name, f"{a.value:+.3g}", f"{a.std_error:.2g}", a.unit + per) for a in amounts]
    return [causes, Table("By how much", ("parameter", "change", "std error", "unit"), cells, frozenset({1, 2}))]


def times_in_words(log_odds: float) -> str:
    """Return the odds of a change as text, such as 1e12; log_odds : their natural logarithm."""
    # Largest power of ten of the odds that is reported as a number; greater ones are "more than"
    # it.
    max_odds_exponent = 100
    if log_odds > max_odds_exponent * np.log(10):
        return f"more than 1e{max_odds_exponent}"
    return f"{np.exp(log_odds):.3g}" if log_odds < 20 else f"1e{log_odds / np.log(10):.0f}"


def _places(found: Comparison) -> list[Any]:
    """Return the abscissa of each campaign in figures: its ISO date, or its number from 1.

    Dates are used only if all campaigns have one.
    """
    return [c.date if found.dated else k for k, c in enumerate(found.campaigns, 1)]


def _course(found: Comparison, change: Change, step: int | None) -> Figure:
    """Return the figure of a change's size over the campaigns, with 95 % intervals.

    step : distance between ticks of a numbered axis; None: automatic
    """
    x, main = _places(found), change.amounts[change.main]
    size, error = main.value * change.course_of[:, 0], abs(main.value) * change.course_of[:, 1]
    # Title of the axis of a change's size, by the kind of its cause; others have the parameter's
    # name.
    axis_titles = {
        "joint_zero": "zero of joint {joint}",
        "joint_stiffness": "compliance of joint {joint}",
        "lengths": "all lengths",
    }
    what = axis_titles.get(change.cause.kind, main.name).format(joint=change.cause.joint)
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
    shaded = None if change.course == "season" else (x[max(first - 1, 0)], x[last])
    # Caption of the figure of a change over the campaigns.
    course_caption = (
        "Change since the first campaign, as each campaign alone shows it, with its 95 % interval. "
        "Of several parameters the one that moved most surely is drawn; the others move with it. "
        "Shaded: where it began, with 95 % probability."
    )
    return Figure(
        f"change/{change.cause.label}",
        f"{change.cause.label}: {COURSE_WORDS[change.course]} {found.campaigns[change.since].label}",
        [sizes],
        Axis("campaign", step=step),
        Axis(f"{what} [{main.unit}]"),
        caption=course_caption,
        shaded=shaded,
    )


def residuals_figure(
    name: str,
    lives: Iterable[tuple[str, Sequence[Any], Sequence[float | None], bool]],
    step: int | None = None,
    **figure: Any,
) -> Figure:
    """Return the figure of the residuals of each campaign, with one line per robot.

    lives : (name, abscissae, residual sigmas of a coordinate [mm], whether it changed) of each
        robot; robots that changed are red
    step : distance between ticks of the axis; None: automatic
    figure : further fields of the `Figure`
    """
    series = [
        Series(
            "linked",
            x,
            list(sigmas),
            colour="red" if changed else "grey",
            width=2 if changed else 1,
            facts=[robot] * len(sigmas),
            tip="<b>%{customdata}</b>, %{x}<br>%{y:.4f} mm",
        )
        for robot, x, sigmas, changed in lives
    ]
    x, y = Axis("campaign", step=step), Axis("one sigma [mm]", begins=True)
    return Figure(name, "Left in each campaign", series, x, y, **figure)


def _as_plain(c: Change, labels: list[str]) -> dict[str, Any]:
    """Return a change as plain data for the JSON file, with labels in place of campaign indices."""
    course = [{"campaign": n, "size": s, "std_error": e} for n, (s, e) in zip(labels, c.course_of, strict=True)]
    rivals = [{**plain(r), "since": labels[r.since]} for r in c.rivals if r.probability >= MIN_PROBABILITY_SHOWN]
    between = [labels[k] for k in c.between]
    return {**plain(c), "since": labels[c.since], "between": between, "rivals": rivals, "course_of": course}


# Technical meaning of a change in words, by its course and the kind of its cause.
MEANINGS: dict[Course, dict[str, str]] = {
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
        ANOTHER_ROBOT: "this looks like another robot than before: its parameters of all kinds differ, "
        "by as much as robots of one type do; look at the serial numbers and at the names of the tables",
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
        ANOTHER_ROBOT: "this looks like another robot than before and after: its parameters of all kinds differ, "
        "by as much as robots of one type do; look at its serial number and at the name of the table",
    },
}
