"""Result of a fleet: a row per robot, outliers, trends, common deviations of each type."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from casadical.core.reporting.blocks import Block, Page, Section, Table, Tile, Words, cut, figures_named, next_step
from casadical.core.reporting.figure import Axis, Figure, Note, Series
from casadical.core.reporting.plain import WRITTEN, Key, plain
from casadical.core.reporting.result import Result
from casadical.fleet.changes import FALSE_ALARM_PROBABILITY, exceeded_residual, residuals_figure
from casadical.fleet.estimates import date_text
from casadical.fleet.hierarchy import MIN_ROBOTS_PER_TYPE, Common, common_of, correction, drawings_of
from casadical.project.problem import read_problem_robot
from casadical.robot.robot import Robot
from casadical.robot.robot_file import to_toml

# Largest number of rows in a table on the terminal.
MAX_ROWS_SHOWN = 12


@dataclass(frozen=True, eq=False)
class Fleet(Result):
    """All robots of a fleet, and what they have in common.

    robots : a row per robot, as in the store (see `casadical.fleet.run.EMPTY_ROW`)
    commons : what robots of one type have in common, for types with five robots or more
    outliers : names of robots whose error is an outlier among those of their type
    notes : sentences on what was assumed of the robots
    drawings : nominal robots of the types whose files can be read, by type, as of `drawings_of`
    computed : number of robots that were computed in this run, while the others come from the
        store; None: unknown

    Examples
    --------
    >>> fleet = casadical.run_fleet(["problems/planar"], "fleet.parquet", workers=1, with_diagnosis=False)
    >>> fleet
    <Fleet of 1 robots: 1 ok, 0 failed, 0 changed>
    >>> [type(block).__name__ for block in fleet.blocks()][:2]
    ['Words', 'Table']
    >>> fleet.to_json()["robots"][0]["robot"]
    'planar'
    >>> fleet.prior_files("priors")  # of five robots of one type or more
    {}
    >>> fleet.grown  # of several campaigns
    {}
    """

    report: ClassVar[str] = "fleet.j2"
    line: ClassVar[str] = (
        " of {{ it.robots | length }} robots: {{ it.good | length }} ok, "
        "{{ (it.robots | length) - (it.good | length) }} failed, "
        "{{ (it.robots['changes'] != '').sum() }} changed"
    )
    derived: ClassVar[tuple[Key, ...]] = (
        Key("fleet", lambda fleet: len(fleet.robots)),
        Key("robots", "_listed"),
        Key(
            "types",
            lambda fleet: [
                {**plain(c), "corrections": {name: fleet._correction(c, name) for name, _, _ in c.faults}}
                for c in fleet.commons
            ],
        ),
        Key("next", "commands"),
    )

    robots: pd.DataFrame
    commons: tuple[Common, ...]
    outliers: tuple[str, ...] = field(metadata=WRITTEN)
    notes: tuple[str, ...] = field(default=(), metadata=WRITTEN)
    drawings: Mapping[str, tuple[Robot, bool | None]] = field(default_factory=dict)
    computed: int | None = field(default=None, metadata=WRITTEN)

    @property
    def good(self) -> pd.DataFrame:
        """Return the rows of robots that were calibrated."""
        return self.robots[self.robots["status"] == "ok"]

    @property
    def grown(self) -> dict[str, str]:
        """Return a sentence on each robot whose residuals grew in its last campaign, by its name."""
        some = self.good[self.good["campaigns"] > 1]
        words_of = {
            r["robot"]: grown(r["left_mm"], r.get("left_free"), FALSE_ALARM_PROBABILITY / len(some))
            for r in records(some)
        }
        return {name: words for name, words in words_of.items() if words}

    def blocks(self) -> list[Block]:
        """Return the report as blocks of text and tables."""
        bad = self.robots[self.robots["status"] != "ok"]
        failed = [(r["robot"], r["status"], cut(r["error"])) for r in records(bad.head(MAX_ROWS_SHOWN))]
        title = f"Not calibrated ({len(bad)})"
        others = [Table(title, ("robot", "status", "why"), failed)] if failed else []
        return self._report_blocks(findings=[*self._faults(), *self._types(), *self._to_look_at(), *others])

    @property
    def next(self) -> tuple[Words, ...]:
        """Return the next command, for the first robot to check, in a tuple of one or none."""
        return tuple(
            next_step(f"for {r['robot']}", "compare" if r["changes"] else "diagnose", r["folder"])
            for r in records(self._first().head(1))
            if r["status"] == "ok"
        )

    def figures(self) -> dict[str, Figure]:
        """Return the figures by name: "map" (accuracies), "trends", "common/TYPE" for each type."""
        figures = [accuracy_map(self.good, self.outliers)] if len(self.good) else []
        figures += [trends(self.good, self.grown)] if (self.good["campaigns"] > 1).any() else []
        return {figure.name: figure for figure in (*figures, *map(common_departures, self.commons))}

    def page(self) -> Page:
        """Return the report of `casadical fleet --report` as a page."""
        figures = self.figures()
        few = Words("Five robots of one type are needed to learn what they have in common.", "note")
        alike: list[Block] = [b for c in self.commons for b in (figures[f"common/{c.type}"], common_table(c))]
        sections = [
            Section("What to check first", self.blocks()),
            Section("Map of accuracies", figures_named(figures, "map")),
            Section("Trends", figures_named(figures, "trends")),
            Section("What robots of one type have in common", alike or [few]),
            Section("All robots", [self._all()]),
        ]
        return Page("Fleet", "Fleet", f"{len(self.robots)} robots", sections, [*self._tiles()])

    def _tiles(self) -> Iterator[Tile]:
        """Yield the tiles of the page: robots calibrated, median error, changed, outliers."""
        good = self.good
        yield Tile("Calibrated", str(len(good)), "", f"of {len(self.robots)} robots")
        if len(good):
            before, after = good["before_mm"].median(), good["after_mm"].median()
            yield Tile("After, median", f"{after:.3f}", "mm", f"{before:.3f} before")
        yield Tile("Changed", str(int((self.robots["changes"] != "").sum())), "", "robots")
        yield Tile("Stand out", str(len(self.outliers)), "", "robots")

    def _all(self) -> Table:
        """Return the table of all robots on the page, at most 2000 of them."""
        rows = []
        most = 2000
        for r in records(self.robots.head(most)):
            errors = (f"{v:.4f}" if np.isfinite(v) else "" for v in (r["before_mm"], r["after_mm"]))
            # An error message is cut to 60 letters.
            figures = (cut(r["error"], 60), *errors, str(r["poses"]), str(r["campaigns"]))
            rows.append((r["robot"], r["type_name"], r["status"], *figures, _found_in(r), r["changes"]))
        head = ("robot", "type", "status", "error", "before", "after", "poses", "campaigns", "diagnosis", "changed")
        title = f"Mean errors of held-out poses [mm]{f'; the first {most}' if len(self.robots) > most else ''}"
        return Table(title, head, rows, frozenset({4, 5, 6, 7}), folded=len(rows) > 50)

    def prior_files(self, folder: str | Path) -> dict[Path, str]:
        """Return for each type of `commons` the text of a robot file, by its path TYPE.robot.toml.

        The file is the prior of a robot that is still to be measured: it has the mean of the type's
        robots, and as covariance the variance between them plus that of the mean (`prior_of`).

        folder : folder of the paths; nothing is written
        """
        texts = {}
        for c in self.commons:
            drawn = read_problem_robot(self.good.loc[self.good["type"] == c.type, "folder"].iloc[0])
            comment = f"What {c.count} robots of one fleet have in common, as the prior of another one of this type."
            prior = replace(c.prior_of(drawn), name=c.name)
            assert prior.knowledge is not None
            if unnamed := [b.names[0] for b in prior.knowledge.covariance if b.names[0] not in c.names]:
                comment += f"\nHeld as drawn, for the robots' poses do not determine them: {', '.join(unnamed)}."
            texts[Path(folder) / f"{c.type}.robot.toml"] = to_toml(prior, comment, reproducible=True)
        return texts

    def _correction(self, common: Common, name: str) -> str:
        """Return the text of a parameter's correction in a type's robot file, as of `correction`.

        It is empty if no file was read.
        """
        if common.type not in self.drawings:
            return ""
        return correction(common, name, *self.drawings[common.type])

    def _faults(self) -> Iterator[Words]:
        """Yield a warning on faults of the drawing, for each type with any, with their corrections.

        Faults of compliances have a warning of their own.
        """
        remedies = {
            False: "correct the drawing, or the set-up of the instrument",
            True: "their joints yield otherwise than it says; correct the compliances in the robot file",
        }
        for c in self.commons:
            faults = [(name, *c.readable(name, mean, error)) for name, mean, error in c.faults]
            for soft, remedy in remedies.items():
                own = [fault for fault in faults if fault[-1].endswith(("/(N m)", "/N")) == soft]
                if own:
                    first, *more = (f"{size:+.3g} {unit} +/- {sigma:.1g}" for _, size, sigma, unit in own)
                    names = [name for name, *_ in own]
                    said = [f"{names[0]} is {first}", *map(" ".join, zip(names[1:], more, strict=True))]
                    words = f"all {c.count} robots of the type {c.name}: {', '.join(said)} from the drawing: {remedy}."
                    places = filter(None, (self._correction(c, name) for name in names))
                    yield Words(words, "warning", "\n".join(places))

    def _types(self) -> Iterator[Table]:
        """Yield one table of robot types with the median of their robots' mean errors [mm].

        It has the errors before and after calibration, and the 95 % quantile of the latter where a
        type has enough robots. Without calibrated robots there is no table.
        """
        rows, types = [], self.good.groupby("type", sort=False)
        # Smallest number of robots of a type whose 95 % quantile is reported; with fewer it would
        # simply be the worst of them.
        min_robots_for_quantile = 20
        large = bool((types.size() >= min_robots_for_quantile).any())
        for kind, some in types:
            after = some["after_mm"]
            figures = [f"{v:.4f}" for v in (some["before_mm"].median(), after.median())]
            figures += [f"{after.quantile(0.95):.4f}" if len(some) >= min_robots_for_quantile else ""] if large else []
            rows.append((some["type_name"].iloc[0], str(kind), str(len(some)), *figures))
        head = ("type", "drawing", "robots", "before", "after", *(["95 % below"] if large else []))
        if rows:
            yield Table("Types: median of the mean errors of their robots [mm]", head, rows, frozenset({2, 3, 4, 5}))

    def _first(self) -> pd.DataFrame:
        """Return the rows of all robots to check, the greatest error first.

        They are outliers, or have grown residuals, changes, parameters at bounds, unused campaigns
        or a cause that the diagnosis found.
        """
        # Notes with "is left out:" name campaigns that were not used.
        some = self.robots[
            self.robots["robot"].isin([*self.outliers, *self.grown])
            | (self.robots["changes"] != "")
            | (self.robots["at_bounds"] != "")
            | self.robots["notes"].str.contains("is left out:", regex=False)
            | ~self.robots["verdict"].isin(["", "none"])
        ]
        return some.sort_values("after_mm", ascending=False)

    def _to_look_at(self) -> Iterator[Table]:
        """Yield the tables, unless empty, of robots to check first and of notes on the others."""
        more, some, rows = self.grown, self._first(), []
        for r in records(some.head(MAX_ROWS_SHOWN)):
            said = ["error stands out"] if r["robot"] in self.outliers else []
            said += [more[r["robot"]]] if r["robot"] in more else []
            said += [f"at bounds: {r['at_bounds']}"] if r["at_bounds"] else []
            said += [r["notes"]] if r["notes"] else []
            rows.append((r["robot"], f"{r['after_mm']:.4f}", _found_in(r), r["changes"], ", ".join(said)))
        if rows:
            title = f"Robots to check first ({len(some)}, the greatest errors [mm])"
            yield Table(title, ("robot", "after", "diagnosis", "changed", "note"), rows, frozenset({1}))
        others = self.good[~self.good["robot"].isin(some["robot"])]
        # Many campaigns have poses left out as outliers.
        odd = {
            r["robot"]: [note for note in r["notes"].split("; ") if note and not note.endswith("left out as outliers")]
            for r in records(others)
        }
        noted = [(name, cut("; ".join(notes))) for name, notes in odd.items() if notes]
        if noted:
            yield Table(f"Odd about the campaigns of others ({len(noted)})", ("robot", "note"), noted[:MAX_ROWS_SHOWN])

    @property
    def _listed(self) -> list[dict[str, Any]]:
        """Return the rows of all robots as dictionaries by column for the JSON file, without lists."""
        columns = "robot folder status error type type_name method verdict causes changes at_bounds notes"
        words = [*columns.split(), "poses", "campaigns", "before_mm", "after_mm", "seconds"]
        return records(self.robots[words])


def records(robots: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of a table as dictionaries from column to value."""
    return [{str(k): v for k, v in r.items()} for r in robots.to_dict("records")]


def _found_in(row: Mapping[str, Any]) -> str:
    """Return verdict and causes of a robot's diagnosis as text; empty without a diagnosis."""
    return " ".join(filter(None, (row["verdict"], row["causes"])))


def grown(sigmas: Sequence[float], freedom: Sequence[float] | float | None, alarms: float) -> str:
    """Return a sentence if the last campaign has significantly greater residuals than those before.

    Else the text is empty. Campaigns without a residual or degrees of freedom do not count.

    sigmas : residual sigma of a coordinate in each campaign [mm]
    freedom : its degrees of freedom; None: unknown
    alarms : level of significance, the probability of a false alarm
    """
    both = np.array(np.broadcast_arrays(sigmas, np.array(freedom, dtype=float)))
    finite, free = both[:, np.isfinite(both).all(axis=0)]
    pairs = [*zip(finite.tolist(), free.tolist(), strict=True)]
    before = exceeded_residual(pairs[-1], pairs[:-1], alarms) if pairs else 0.0
    return f"the last campaign leaves {finite[-1]:.3f} mm per coordinate, those before {before:.3f}" if before else ""


def fleet_of(robots: pd.DataFrame, notes: Sequence[str] = (), computed: int | None = None) -> Fleet:
    """Return the result of a fleet from the rows of a store.

    notes : sentences on the robots; computed : number of robots computed in this run
    """
    names = {kind: name_of_type(list(some)) for kind, some in robots.groupby("type")["type_name"]}
    robots = robots.assign(type_name=robots["type"].map(names))
    good = robots[robots["status"] == "ok"]
    types = [some for _, some in good.groupby("type", sort=False) if len(some) >= MIN_ROBOTS_PER_TYPE]
    outliers = [name for some in types for name in _outliers(some)]
    drawings, commons = drawings_of(good), []
    for some in types:
        common = common_of(records(some))
        joints = drawings[common.type][0].joints if common.type in drawings else ()
        sliding = frozenset(f"c{k}" for k, joint in enumerate(joints, 1) if joint.kind != "revolute")
        commons.append(replace(common, name=some["type_name"].iloc[0], sliding=sliding))
    return Fleet(robots, tuple(commons), tuple(outliers), tuple(notes), drawings, computed)


def name_of_type(names: Sequence[str]) -> str:
    """Return one name for robots of one type, from the name of each: the most frequent one.

    At a tie it is the words with which all of the most frequent begin, or the first of them in the
    order of the alphabet.
    """
    times = Counter(names)
    most = sorted(name for name, count in times.items() if count == max(times.values()))
    words = zip(*(name.split() for name in most), strict=False)
    return " ".join(word for word, *_ in takewhile(lambda some: len(set(some)) == 1, words)) or most[0]


def _outliers(some: pd.DataFrame) -> list[str]:
    """Return the names of robots of one type whose error after calibration is an outlier."""
    logs = np.log(some["after_mm"].to_numpy())
    middle = np.median(logs)
    spread = max(1.4826 * float(np.median(np.abs(logs - middle))), 0.02)
    # An outlier is more than four scaled median absolute deviations above the median.
    return [str(name) for name in some["robot"][logs > middle + 4.0 * spread]]


# Largest number of robots or parameters that a figure names.
MAX_LABELS = 12
# Smallest distance between two names in a figure, as a fraction of its ordinate's range.
MIN_LABEL_DISTANCE = 0.07


def accuracy_map(good: pd.DataFrame, outliers: Collection[str]) -> Figure:
    """Return the figure of the mean errors before and after calibration of every robot, by type.

    good : rows of robots that were calibrated
    outliers : names of robots that are drawn in orange
    """
    good = good.sort_values(["type_name", "after_mm"])
    x, names = np.arange(len(good)), [str(name) for name in good["robot"]]
    after = ["orange" if name in outliers else "blue" for name in names]
    series = [
        Series(
            "points",
            x,
            good[f"{state}_mm"],
            name=state,
            size=size,
            colour=colour,
            facts=names,
            tip="<b>%{customdata}</b><br>%{y:.4f} mm",
        )
        for state, colour, size in (("before", "grey", 4), ("after", after, 7))
    ]
    axis, marks = Axis("robot, by type and error"), []
    if len(good) <= 30:
        axis = Axis("robot, by type and error", ticks=x, labels=names)
    else:  # names do not fit on the axis
        far = good.assign(x=x)[good["robot"].isin(outliers).to_numpy()].nlargest(MAX_LABELS, "after_mm")
        rows = zip(far["robot"], far["x"], far["after_mm"], strict=True)
        marks = [Note(name, at, error, side="left", gap=8, colour="muted", size=12.5) for name, at, error in rows]
    # Caption of the figure of `accuracy_map`.
    map_caption = (
        "Mean error of held-out poses, a point a robot, on a logarithmic axis: grey before, blue "
        "after calibration, orange where it stands out from its type (four scaled median absolute "
        "deviations); the worst of these are named."
    )
    return Figure("map", "Every robot", series, axis, Axis("mean error [mm]", log=True), 380, map_caption, marks=marks)


def trends(good: pd.DataFrame, grown: Collection[str]) -> Figure:
    """Return the figure of residuals over the campaigns of robots with several, at most 60.

    Robots that changed or are in `grown` come first.

    good : rows of robots that were calibrated
    grown : robots whose last campaign has greater residuals than those before
    """
    several = good[good["campaigns"] > 1]
    striking = (several["changes"] != "") | several["robot"].isin(list(grown))
    several = several.assign(striking=striking).sort_values("striking", ascending=False, kind="stable").head(60)
    dated = any(np.isfinite(days).sum() > 1 for days in several["days"])
    lives: list[tuple[str, list[object], list[float], bool]] = []
    for r in records(several):  # by day or, where no robot has days, by number: not both on one axis
        points = zip([date_text(day) if dated else k + 1 for k, day in enumerate(r["days"])], r["left_mm"], strict=True)
        drawn = [(x, sigmas) for x, sigmas in points if x]
        lives.append((r["robot"], [x for x, _ in drawn], [sigmas for _, sigmas in drawn], bool(r["changes"])))
    named = [life for life in lives if life[2] and np.isfinite(life[2][-1])]
    if len(named) > MAX_LABELS:
        named = [life for life in named if life[3] or life[0] in grown]
    first = sorted(named, key=lambda life: (not life[3], -life[2][-1]))[:MAX_LABELS]
    named = sorted(first, key=lambda life: -life[2][-1])
    most = max((v for _, _, sigmas, _ in lives for v in sigmas if np.isfinite(v)), default=1.0)
    heights = _apart([life[2][-1] for life in named], MIN_LABEL_DISTANCE * most)
    notes = [
        Note(name, 1, y, "x", colour="red" if changed else "muted", size=12.5)
        for (name, _, _, changed), y in zip(named, heights, strict=True)
    ]
    right = 12 + 8 * max((min(len(life[0]), 20) for life in named), default=0)
    by_change = sorted(lives, key=lambda life: life[3])  # what changed is on top
    # Caption of the figure of `trends`.
    trend_caption = (
        "What nothing explains in each campaign of a robot, of one coordinate; orange where "
        "something changed. Of many robots those are named that changed or whose last campaign "
        "leaves more than those before; point at a line to see which it is. Beside campaigns with "
        "a day, one without is not drawn."
    )
    return residuals_figure("trends", by_change, height=340, caption=trend_caption, marks=notes, right=right)


def _apart(heights: Sequence[float], gap: float) -> list[float]:
    """Return the ordinates of labels, given from the top down, moved so that no two overlap."""
    moved: list[float] = []
    for y in heights:
        moved.append(min(y, moved[-1] - gap) if moved else y)
    # Those that came below the axis push the others up.
    for k in range(len(moved) - 1, -1, -1):
        moved[k] = max(moved[k], moved[k + 1] + gap if k + 1 < len(moved) else 0.0)
    return moved


def common_departures(c: Common) -> Figure:
    """Return the figure of a type's mean deviations from the drawing and their significance.

    The abscissa is the deviation [mm or mrad; compliances: units of scale], the ordinate its ratio
    to the standard error.
    """
    sure = np.abs(c.mean) / np.maximum(c.std_error, 1e-12)
    bad = {name for name, _, _ in c.faults}
    named = sorted(bad, key=lambda name: -sure[c.names.index(name)])[:MAX_LABELS]
    words = [[name, f"{mean:+.4g} {unit} +/- {error:.1g}"] for name, mean, error, _, unit in c.rows]
    compliant = [n.startswith("c") and n[1:].isdigit() for n in c.names]
    dots = Series(
        "points",
        c.mean * np.where(compliant, 1.0, 1e3 * c.scale),
        sure,
        size=8,
        colour=["red" if n in bad else "grey" for n in c.names],
        text=[n if n in named else "" for n in c.names],
        facts=words,
        tip="<b>%{customdata[0]}</b><br>%{customdata[1]} from the drawing",
    )
    x, y = Axis("common departure [mm or mrad]"), Axis("in standard errors")
    # Caption of the figure of `common_departures`.
    common_caption = (
        "How far all robots of the type are from the drawing, in standard errors, over the size of "
        "the departure; of compliances, what they yield under the joint's greatest torque. Red: a "
        "fault of the drawing, or of the instrument's set-up; the surest are named."
    )
    return Figure(f"common/{c.type}", f"{c.name}: {c.count} robots", [dots], x, y, caption=common_caption)


def common_table(c: Common) -> Table:
    """Return the table of a robot type's parameters in readable units.

    It has the mean deviation from the nominal value, its standard error, and the standard deviation
    between the robots (spread).
    """
    rows = [(name, f"{m:+.4f}", f"{error:.2g}", f"{spread:.3g}", unit) for name, m, error, spread, unit in c.rows]
    strong = frozenset(k for k, n in enumerate(c.names) if n in {name for name, _, _ in c.faults})
    head = ("parameter", "common", "std error", "spread", "unit")
    return Table(f"{c.name}, drawing {c.type}", head, rows, frozenset({1, 2, 3}), strong, folded=True)
