"""HTML page of a diagnosis: statements, tables and figures in the order of questions.

Figures show the gap and its causes, its localisation, and joint error curves.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from casadical.core.reporting.blocks import Block, Page, Section, Table, Tile, Words, figures_named, mm
from casadical.core.reporting.drawing import LEGEND_HEIGHT_PX, TITLE_HEIGHT_PX
from casadical.core.reporting.figure import Axis, Figure, Note, Panel, Rule, Series
from casadical.diagnosis.details import Details
from casadical.diagnosis.held_out_gap import NetworkGap
from casadical.diagnosis.joint_curves import CURVE_COLUMNS, JointCurve, curve_rows
from casadical.diagnosis.localisation import Localisation
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.settings import SETTINGS
from casadical.diagnosis.statements import (
    CauseRow,
    Statement,
    cause_rows,
    floor_of,
    layer_rows,
    noiseless_errors,
    statements,
)
from casadical.effects.plugins import signature_of
from casadical.identification.accuracy import summarise
from casadical.identification.figures import (
    banded,
    fit_figures,
    intervals,
    parameter_figures,
    parameter_tables,
)
from casadical.identification.pose_errors import errors_by_pose, workspace


def diagnosis_page(d: Diagnosis, name: str, more: Details | None = None, replayed: Sequence[Block] = ()) -> Page:
    """Return the HTML page of the diagnosis of one campaign.

    name : name of the campaign; more : result of `analyse`, None for the diagnosis alone
    replayed : blocks on a replay in a simulator
    """
    more = more or Details()
    figures = {figure.name: figure for figure in diagnosis_figures(d, more)}
    said = statements(d, more)
    rows, layered = cause_rows(d), []
    if layers := layer_rows(d, floor_of(d, more)):
        columns = ("layer, added to those above", "mean", "95 %", "fifths of time excluded", "rms without noise")
        layered = [Table("Layer by layer: errors on held-out poses, mm", columns, layers, frozenset(range(1, 5)))]
    curves: list[Block] = []
    if more.curves:
        lines = [tuple(cell.replace("+-", "±") for cell in row) for row in curve_rows(more.curves)]
        curves = [Table("Curves", CURVE_COLUMNS, lines, frozenset({1, 2}))]
    sections = [
        Section(
            "Verdict",
            [*_said(said, "VERDICT", "CHECK", "PRIOR", "GAP", "NOISE", "ASSUMED", "GRAVITY", "UNKNOWN", "LAW", "OUT")],
        ),
        Section("Errors before and after", [figures["gap"], *layered, _errors(d), *_said(said, "AFTER")]),
        Section("Error of each pose", [figures["errors"]]),
        Section("In the workspace", [figures["workspace"]]),
        Section(
            "Where the gap lies",
            [*_said(said, "WHERE"), *(_where(more.where, figures_named(figures, "where")) if more.where else [])],
        ),
        Section(
            "Which causes, and how sure",
            [
                *_said(said, "WHICH"),
                *_causes(rows),
                *_said(said, "SET", "MORE"),
                *figures_named(figures, "shrink"),
                *figures_named(figures, "causes"),
            ],
        ),
        Section("Joint error curves", [*figures_named(figures, "curves"), *curves]),
        *([more.laws.section()] if more.laws else []),
        Section("What these poses cannot tell", [*_said(said, "CANNOT", "MISSING")]),
        Section("Replayed in a simulator", replayed),
        Section(
            "Parameters of the base model",
            [
                Words(
                    "With priors from the robot file, outliers excluded, and without the causes. "
                    "Bars are 95 % intervals. Base and tool frames are in the table only.",
                    "note",
                ),
                *figures_named(figures, "parameters"),
                *parameter_tables(d.identification, whole=True),
            ],
        ),
        Section("Can the fit be trusted", figures_named(figures, "fit")),
        Section("What to measure next", [*_next(said, more.poses)]),
    ]
    return Page("Diagnosis", f"Diagnosis of {name}", d.identification.given.name, sections, [*_tiles(d, more)])


def _said(said: Sequence[Statement], *about: str) -> Iterator[Words]:
    """Yield the statements about some topics as sentences, in the order of the topics.

    about : topics, see `Statement`
    """
    for topic in about:
        for s in (s for s in said if s.about == topic):
            text = s.sentence.replace("->", "→")
            yield Words(text, "verdict" if topic == "VERDICT" else "warning" if s.doubtful else "text")


def _tiles(d: Diagnosis, more: Details) -> Iterator[Tile]:
    """Yield the key figures at the page's top: errors [mm], leading cause, unexplained part."""
    yield Tile("Gap, held out", mm(d.gap.without_outliers), "mm", f"mean of {int(d.case.inliers.sum())} poses")
    if d.effects():
        yield Tile(
            "With the causes", mm(d.gap.after), "mm", f"{100 * (1 - d.gap.after / d.gap.without_outliers):.0f} % less"
        )
    yield Tile("Noise alone", mm(floor_of(d, more)), "mm", f"instrument {mm(d.noise.sigma)} mm per coordinate")
    if d.effects():
        first = next(c for c in d.causes if c.effects)
        # A browser may break a long name at a zero-width space.
        yield Tile("Leading cause", first.label.replace("_", "_\u200b"), "", f"probability {first.confidence:.3f}")
    if d.has_rest:
        before, after, share = noiseless_errors(d)
        yield Tile(
            "Without a named cause", mm(1e-3 * after), "mm rms", f"{100 * share:.0f} % of {before:.3f}, noise off"
        )


def _errors(d: Diagnosis) -> Table:
    """Return the table of held-out error statistics [mm], without and with the causes."""
    summed = [(one.model, summarise(one.length)) for one in d.held_out.models]
    rows = [(name, str(a.n), *map(mm, (a.mean, a.max, a.std, a.rms, a.p95))) for name, a in summed]
    columns = ("held-out poses, outliers excluded", "n", "mean", "max", "std", "rms", "95 %")
    return Table("Errors in mm", columns, rows, frozenset(range(1, 7)), frozenset({len(rows) - 1}))


def _where(where: Localisation, figures: Iterable[Figure]) -> Iterator[Block]:
    """Yield the localisation: the worst parts of the data as a table, and the figures."""
    yield Words("Of what the base model leaves at the poses it was fitted to. Bars are 95 % intervals.", "note")
    rows = [
        (
            f"{r['by']}: {r['part']}",
            str(r["poses"]),
            f"{r['rms_mm']:.3f}",
            f"{100 * r['share']:.0f} %",
            f"{r['excess']:.1f}",
        )
        for r in where.worst.head(8).to_dict("records")
    ]
    if rows:
        columns = ("poses", "n", "rms mm", "squared error", "times its share")
        yield Table("Surely worse than the rest", columns, rows, frozenset({1, 2, 3, 4}))
    yield from figures


def _causes(rows: Sequence[CauseRow]) -> Iterator[Table]:
    """Yield the tables of the causes and of their parameters; nothing without causes."""
    if not rows:
        return
    cells = [(r.named, r.shown, f"{r.cause.confidence:.3f}", r.gap.replace("->", "→"), r.shrinks) for r in rows]
    columns = ("cause", "signature", "posterior", "gap if added, mm", "shrinks by, 95 %")
    yield Table("Causes", columns, cells, frozenset({2, 3, 4}))
    every = [(r.cause.label, figures) for r in rows if r.cause.effects for figures in r.parameters]
    sizes = [(label, name, value, error or "chosen", unit) for label, (name, value, error, unit) in every]
    if sizes:
        head = ("cause", "parameter", "value", "std error", "unit")
        yield Table("Size of the causes", head, sizes, frozenset({2, 3}))


def _next(said: Sequence[Statement], poses: pd.DataFrame | None) -> Iterator[Block]:
    """Yield statements and table of the next poses, or that none are needed; nothing for None."""
    if poses is None:
        return
    yield from _said(said, "NEXT")
    if not len(poses):
        yield Words("There are no two listed causes that further poses would tell apart.")
        return
    yield Words(
        "P(correct) is the probability that the more probable of the two causes is the true one, now and with these "
        "poses measured. Separation is the expected log Bayes factor in favour of the truth, of a pose and those "
        "before it. The option --next FILE.csv writes the poses.",
        "note",
    )
    given = poses.dropna(axis="columns", how="all")
    columns = [str(c) for c in given]
    rows = [tuple(f"{v:.1f}" if isinstance(v, float) else str(v) for v in row) for row in given.itertuples(index=False)]
    numbers = frozenset(k for k, c in enumerate(columns) if c not in ("state", "repeats"))
    yield Table("Next poses", columns, rows, numbers)


# Title and caption of the figure of a table of `Localisation`, by the name of the table.
_WHERE = {
    "joints": (
        "Gap by joint",
        "Share of the gap that smooth errors of each joint would account for; all sum to 100 %.",
    ),
    "links": ("Gap by link and frame", "The same for links, loop, base and tool frame."),
    "directions": (
        "Gap by direction",
        "Each frame's three directions sum to 100 %, noise included; evenly spread would be 33 % each.",
    ),
    "regions": (
        "Error by region",
        "Poses in thirds of each joint's readings, of the distance from joint 1 and of the height.",
    ),
}


def diagnosis_figures(d: Diagnosis, more: Details | None = None) -> Iterator[Figure]:
    """Yield every figure of a diagnosis.

    Their names are: gap; errors (held out, pose by pose); workspace; where/TABLE with the names of
    `Localisation`; curves/angles; causes/STEP; shrink (if a cause was found); parameters/lengths,
    /angles, /compliance; fit/residuals, /coverage, /pairs.
    more : result of `analyse`, for the figures where/ and curves/ and the networks in gap
    """
    more = more or Details()
    floor = floor_of(d, more)
    yield gap_course(d, more.networks or (), floor)
    hint = "Poses are judged by fits to others, without outliers. Click a name in the legend to show or hide it."
    yield errors_by_pose(d.held_out, caption=hint, floor=floor)
    yield workspace(d.fitted, d.identification.robot, "After a fit to all poses.")
    if more.where:
        yield from where_figures(more.where)
    if more.curves:
        yield curve_figure(more.curves)
    yield from (posteriors(d, k) for k in range(len(d.rankings)))
    if d.effects():
        yield shrinks(d)
    yield from parameter_figures(d.identification)
    measured = d.case.evidence.measured
    residual = d.residual if measured is None else d.residual[measured]
    poses = {"poses of the campaign": (d.case.m[d.case.inliers],)}
    yield from fit_figures(d.identification, poses, residual / float(np.sqrt((residual**2).mean())))


def where_figures(where: Localisation) -> Iterator[Figure]:
    """Yield a figure for each table of a localisation that is not empty."""
    for name, table in where.tables():
        title, caption = _WHERE.get(name, (f"Error by {name}", ""))
        yield (_by_data if "poses" in table else _by_parts)(f"where/{name}", title, table, caption)


def _by_parts(name: str, title: str, table: pd.DataFrame, caption: str) -> Figure:
    """Return the figure of the fractions [%] of the squared gap by part or by direction."""
    by = table["frame"] if "frame" in table else pd.Series("", index=table.index)
    words = {"base": "base frame", "axis": "about joint 1", "tool": "tool frame"}
    labels = [f"{words.get(f, f)}: {p}" if f else str(p) for f, p in zip(by, table["part"], strict=True)]
    ends = (0.0, max(50.0, min(104.0, 108 * float(table["high"].max()))))
    share, low, high = (100 * table[column] for column in ("share", "low", "high"))
    return intervals(
        name,
        title,
        Axis("share of squared gap [%]", ends),
        labels,
        share,
        low,
        high,
        [f"{v:.3f} mm rms" for v in table["rms_mm"]],
        "%{x:.0f} %",
        ["grey" if label.endswith("elsewhere") else "blue" for label in labels],
        caption=caption,
    )


def _by_data(name: str, title: str, table: pd.DataFrame, caption: str) -> Figure:
    """Return the figure of the rms error [mm] in each region or circumstance, and in all poses."""
    notes = [
        f"{n} poses, {100 * s:.0f} % of the squared error" for n, s in zip(table["poses"], table["share"], strict=True)
    ]
    first = table[table["by"] == table["by"].iloc[0]]
    every = float(((first["rms_mm"] ** 2 * first["poses"]).sum() / first["poses"].sum()) ** 0.5)
    x = Axis("rms error [mm]", (0.0, 1.05 * float(table["rms_high_mm"].max())))
    labels = [str(p).replace("..", "to").replace("degC", "°C") for p in table["part"]]
    by = [str(b).replace("approach of joint", "joint") for b in table["by"]]
    # The quantity that divides the poses is named only if there are several.
    if len(set(by)) > 1:
        labels = [f"{b}: {label}" for b, label in zip(by, labels, strict=True)]
    return intervals(
        name,
        title,
        x,
        labels,
        table["rms_mm"],
        table["rms_low_mm"],
        table["rms_high_mm"],
        notes,
        "%{x:.3f} mm",
        caption=caption,
        marks=[Rule("x", every, text="all poses", dash="dot")],
    )


def posteriors(d: Diagnosis, step: int = 0) -> Figure:
    """Return the figure of the candidates' probabilities at one step of the search (0: the first).

    Unlisted forms are summed up as one; the probability of no cause is shown as "nothing".
    """
    ranking = d.rankings[step]
    listed = {c.label for c in d.case.candidates if c.listed}
    # At most eight listed candidates are drawn.
    rows = [(label, ranking.probability[label], "blue") for label in ranking.order if label in listed][:8]
    unknown = sum(p for label, p in ranking.probability.items() if label not in listed)
    rows += [("something on no list", unknown, "orange"), ("nothing", ranking.none, "grey")]
    labels, chances, colours = zip(*rows, strict=True)
    shown = [f"{p:.3f}" if 0.001 <= p <= 0.999 else "< 0.001" if p < 0.001 else "> 0.999" for p in chances]
    bars = Series(
        "bars",
        chances,
        range(len(rows)),
        colour=colours,
        width=0.62,
        text=shown,
        facts=[[label, signature_of(label.split("@")[0])] for label in labels],
        tip="<b>%{customdata[0]}</b>: %{x:.3g}<br>%{customdata[1]}",
    )
    title, caption = f"Probability of a further cause, step {step + 1}", "Once the causes so far are in the model."
    if step == 0:
        title = "Probability of each cause"
        caption = "All candidates compete with nothing at all and with smooth errors of no listed cause."
        caption += f" A name has {1 - SETTINGS.look_alike:g} of it: another may look like it."
    x = Axis("probability", (0, 1), ticks=[0, 0.25, 0.5, 0.75, 1])
    height = 110 + 30 * len(rows)
    return Figure(f"causes/{step + 1}", title, [bars], x, height=height, caption=caption, rows=labels, right=64)


def gap_course(d: Diagnosis, networks: Sequence[NetworkGap] = (), floor: float | None = None) -> Figure:
    """Return the figure of the mean held-out error [mm] as causes are added.

    The 95 % intervals are by bootstrap over poses; outliers are excluded.
    networks : gaps with a network instead of the causes, and after them
    floor : held-out error by noise alone [m], by default `Gap.floor`
    """
    rows = [
        ("base model" if r.model == "base" else str(r.model), r.gap_mm, r.low_mm, r.high_mm, "blue" if k else "grey")
        for k, r in enumerate(d.course.itertuples())
    ]
    words = ("network instead", "network on the rest") if d.effects() else ("network",)
    for name, net in zip(words, networks, strict=False):
        note = ", refused" if net.refused else ""
        # Networks are trained on one partition only; so their ratio there scales the gap of all
        # partitions.
        alone = 1e3 * (d.gap.after if name.endswith("rest") else d.gap.without_outliers) * net.used / net.before
        rows.append((name + note, alone, alone, alone, "orange"))
    alone = 1e3 * (d.gap.floor if floor is None else floor)
    rows.append(("noise alone", alone, alone, alone, "green"))
    names, values, low, high, colours = zip(*rows, strict=True)
    bars = Series(
        "bars",
        values,
        range(len(rows)),
        colour=colours,
        width=0.6,
        less=np.subtract(values, low),
        more=np.subtract(high, values),
        facts=[list(row) for row in zip(names, low, high, strict=True)],
        tip="<b>%{customdata[0]}</b><br>%{x:.4f} mm, 95 %: %{customdata[1]:.4f} to %{customdata[2]:.4f}",
    )
    notes = [Note(f"{value:.3f} mm", high[k], k, gap=8) for k, value in enumerate(values)]
    return Figure(
        "gap",
        "Gap on held-out poses",
        [bars],
        Axis("mean position error [mm]", (0, max(high))),
        rows=names,
        height=112 + 36 * len(rows),
        marks=notes,
        right=76,
        caption="The gap, here and everywhere in this report: mean distance of measured from computed positions over "
        f"poses that the fit did not see (in fifths, {SETTINGS.partitions} partitions), outliers excluded, with a 95 % "
        "interval over poses. Noise alone: what a perfect model would leave, simulated through the same fit.",
    )


def shrinks(d: Diagnosis) -> Figure:
    """Return the figure of how much each cause but outliers shrinks the held-out gap alone [%]."""
    causes = [c for c in d.causes if c.effects]
    low, high = ([100 * c.shrink_interval[k] for c in causes] for k in (0, 1))
    return intervals(
        "shrink",
        "Gap shrinks by, each cause alone",
        Axis("share of the held-out gap [%]", (min(0.0, *low), 100)),
        [c.label for c in causes],
        [100 * c.shrink for c in causes],
        low,
        high,
        [f"probability {c.confidence:.3f}" for c in causes],
        "%{x:.0f} %",
        caption="On held-out poses, each cause alone in the model; they may overlap.",
    )


def curve_figure(curves: Sequence[JointCurve]) -> Figure:
    """Return the figure of each joint's error curve over a turn, with its 95 % band."""
    reached = (((np.abs(c.value) + 1.96 * c.error)[c.covered].max(initial=0.0)) for c in curves if c.seen)
    most = 1e6 * float(max(reached, default=1e-4))
    x = Axis(ends=(-180, 180), ticks=[-180, -90, 0, 90, 180], labels=["", "-90", "0", "90", ""])
    y = Axis(ends=(-most, most), count=5)
    titles = (f"{100 * c.share:.0f} %" if c.seen else "not seen" for c in curves)
    panels = [
        Panel(k // 2 + 1, k % 2 + 1, f"joint {c.joint}: {title}", x, y)
        for k, (c, title) in enumerate(zip(curves, titles, strict=True))
    ]
    return Figure(
        name="curves/angles",
        title="Error of each joint over its own angle",
        series=[series for k, c in enumerate(curves) for series in _curve(c, k, most)],
        x=Axis("reading [deg]"),
        y=Axis("error [urad]"),
        caption="With the base model, all other causes and the curves of the other joints in the model. Shaded: angles "
        "near which there are readings; elsewhere the curve is not measured, and the band is that of its prior. Shares "
        "are of the log evidence that is lost without a joint's curve.",
        shared="xy",
        height=150 * -(-len(panels) // 2) + TITLE_HEIGHT_PX + LEGEND_HEIGHT_PX,
        panels=panels,
    )


def _curve(c: JointCurve, panel: int, most: float) -> Iterator[Series]:
    """Yield the series of one joint: angles with readings, band and curve [deg, urad].

    panel : index of the panel; most : limit of the error axis [urad]
    """
    angle, value, band = np.rad2deg(c.angle), 1e6 * c.value, 1.96e6 * c.error
    x: list[float | None] = []
    y: list[float | None] = []
    for low, high in c.covered_parts:
        x += [*np.rad2deg([low, low, high, high]).round(1), None]
        y += [-most, most, most, -most, None]
    place: dict[str, Any] = {"panel": panel, "listed": panel == 0}
    yield Series("area", x, y, name="angles with readings", colour="line", opacity=0.3, group="readings", **place)
    low, high = np.clip([value - band, value + band], -most, most).round(1)
    yield banded(angle.round(1), low, high, name="95 % band", opacity=0.3, group="band", **place)
    yield Series(
        "line",
        angle.round(1),
        value.round(1),
        name="curve",
        width=1.6,
        facts=band.round(0),
        group="curve",
        **place,
        tip=f"<b>joint {c.joint}</b>, %{{x:.0f}} deg: %{{y:.0f}} ± %{{customdata:.0f}} urad",
    )
