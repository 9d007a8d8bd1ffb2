"""The report of a diagnosis: its figures, and the part of a page that they make with words and tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from casadical.core.blocks import Table, Words, mm
from casadical.diagnosis.advice import kinds, told_apart
from casadical.diagnosis.json_answer import NEXT, Extras, settings
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
from casadical.diagnosis.text import readable, refitted, signature
from casadical.diagnosis.thresholds import PARTITIONS
from casadical.identification.tables import correlated, held_table, parameter_tables
from casadical.project.remaining_errors import BEFORE
from casadical.report.figures_of_diagnosis import diagnosis_figures, held_out_poses
from casadical.report.page import Block, Drawing, Part, Section, Tile, report_html
from casadical.report.provenance import campaign_files, provenance_of
from casadical.report.replay_blocks import replay_blocks
from casadical.report.where_blocks import where_drawings

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

    from casadical.diagnosis.result import Cause, Diagnosis


def diagnosis_report(
    folder: Path, answered: Sequence[tuple[Path, Diagnosis, Extras | None]], command: Sequence[str] = ()
) -> str:
    """One HTML file of one or several diagnoses of a problem's robot.

    folder : the problem's; answered : (campaign's file, diagnosis, what takes longer, if it was computed); command : as
    it was typed. Raises InputError where plotly or jinja2 is not installed, or a file is gone.
    """
    parts = [diagnosis_part(d, path.stem, extras) for path, d, extras in answered]
    return report_html("Diagnosis", parts, provenance_of(campaign_files(folder, [a[0] for a in answered]), command))


def diagnosis_part(d: Diagnosis, name: str, extras: Extras | None = None) -> Part:
    """One campaign's part of a page; name : of the campaign. Raises InputError where plotly is not installed."""
    e = extras or Extras()
    figures = diagnosis_figures(d, e)
    sections = [
        Section("Verdict", [*_verdict(d)]),
        Section("Errors before and after", [Drawing("gap", figures["gap"], _GAP), _error_table(d), *_refit(e)]),
        Section("Error of each pose", [Drawing("errors", figures["errors"], _EACH)]),
        Section("In the workspace", [Drawing("workspace", figures["workspace"], _SPACE)]),
        Section("Where the gap lies", [*_where_blocks(d, figures)]),
        Section("Which causes, and how sure", [*_cause_blocks(d, figures)]),
        Section("What these poses cannot tell", [*_cannot_blocks(d)]),
        Section("Replayed in a simulator", [*replay_blocks(d)]),
        Section("Parameters of the base model", [*_parameter_blocks(d, figures)]),
        Section("What to measure next", [*_next_blocks(d, e)]),
    ]
    return Part(f"Diagnosis of {name}", d.identification.given.name, sections, [*_tiles(d)])


# Where a long name may be broken.
BREAK = "\u200b"
_GAP = (
    f"Mean over poses that the fit did not see (in fifths, {PARTITIONS} partitions), with a 95 % interval over poses. "
    "Noise alone: what a perfect model would leave, simulated through the same fit."
)
_EACH = "Every pose is judged by a fit to others; outliers are left out. Click a name in the legend to show or hide it."
_SPACE = (
    "Turn it with the mouse; point at the dot that ends a vector for its error. Each line runs from the measured point "
    "in the direction of the error (measured less computed), after a fit to all poses, longer than it by the factor in "
    "the legend."
)


def _verdict(d: Diagnosis) -> Iterator[Block]:
    sentence = headline(d)
    yield Words(f"{sentence[0].upper()}{sentence[1:]}.".replace("->", "→"), "verdict")
    detected = "Nothing was detected" if d.verdict == "none" else "Something was detected"
    chance = (
        f", and noise alone looks as much like a cause {_how_often(d.p_nothing)}" if d.p_nothing is not None else ""
    )
    yield Words(
        f"The calibrated base model leaves {mm(d.gap.before)} mm on held-out poses; noise alone would leave "
        f"{mm(d.gap.floor)} mm. {detected}: the probability that nothing is there is {d.rankings[0].none:.2g}{chance}."
    )
    for c in d.causes:
        low, high = (100 * v for v in c.shrink_interval)
        shown, mechanical = signature(c)
        yield Words(
            f"{c.label}: {shown}{f'; may be {mechanical}' if mechanical else ''}. Probability {c.confidence:.3f}; "
            f"alone it shrinks the gap by {100 * c.shrink:.0f} % (95 %: {low:.0f} to {high:.0f} %)."
        )
    if has_rest(d):
        likeness = [words for words in (resembles(d), unsure_floor(d)) if words]
        if likeness:
            yield Words(f"The rest of {left_over(d)[1]:.3f} mm rms: {'; '.join(likeness)}.", "warning")
    if d.outliers:
        rows = ", ".join(f"{o.row} ({mm(o.distance)} mm)" for o in d.outliers[:12]) + (
            " ..." if len(d.outliers) > 12 else ""
        )
        count = "1 pose was" if len(d.outliers) == 1 else f"{len(d.outliers)} poses were"
        yield Words(f"{count} left out as outliers: rows {rows}.")


def _how_often(p: float) -> str:
    return f"in {'less than ' if p < 1e-3 else ''}{100 * p:.2g} % of all draws (bootstrap, p-value)"


def _cannot_blocks(d: Diagnosis) -> Iterator[Block]:
    """What looks alike, what stays hidden, what was not logged."""
    for label, others in alike(d).items():
        yield Words(f"These data cannot tell {label} from {others}.", "warning")
    hidden, lost = invisible(d), not_logged(d)
    yield from (Words(f"Cannot be seen, {why}: {labels}.") for why, labels in hidden.items())
    yield from (Words(f"Not logged: {columns}. It would show {what}.") for columns, what in lost.items())
    if not hidden and not lost:
        yield Words("At its usual size every effect of the list would show in these poses.")


def _tiles(d: Diagnosis) -> Iterator[Tile]:
    yield Tile("Gap, held out", mm(d.gap.before), "mm", f"mean of {int(d.case.kept.sum())} poses")
    if d.causes:
        yield Tile("With the causes", mm(d.gap.after), "mm", f"{100 * (1 - d.gap.after / d.gap.before):.0f} % less")
    yield Tile("Noise alone", mm(d.gap.floor), "mm", f"instrument {mm(d.noise.sigma)} mm a coordinate")
    if d.causes:
        first = d.causes[0]
        yield Tile("Leading cause", first.label.replace("_", f"_{BREAK}"), "", f"probability {first.confidence:.3f}")
    if has_rest(d):
        before, after, share = left_over(d)
        yield Tile(
            "Without a named cause", mm(1e-3 * after), "mm rms", f"{100 * share:.0f} % of {before:.3f}, noise off"
        )


def _error_table(d: Diagnosis) -> Table:
    rows = []
    for left in held_out_poses(d).models:
        e = left.length
        figures = (e.mean(), e.max(), e.std(ddof=1), np.sqrt((e**2).mean()), np.quantile(e, 0.95))
        words = "base model" if left.model == BEFORE else "with the causes"
        rows.append((words, str(len(e)), *(mm(float(v)) for v in figures)))
    columns = ("held-out poses, outliers left out", "n", "mean", "max", "std", "rms", "95 %")
    strong = frozenset({len(rows) - 1})
    return Table("Errors in mm", columns, rows, frozenset(range(1, 7)), strong)


def _refit(e: Extras) -> Iterator[Block]:
    if e.check:
        words = refitted(e.check)
        yield Words(f"{words[0].upper()}{words[1:]}.", "text" if e.check.agree else "warning")


def _where_blocks(d: Diagnosis, figures: Mapping[str, go.Figure]) -> Iterator[Block]:
    yield Words("Of what the base model leaves at the poses it was fitted to. Bars are 95 % intervals.", "note")
    worst = d.where.worst.head(8)
    if len(worst):
        rows = [
            (
                f"{r['by']}: {r['part']}",
                str(r["poses"]),
                f"{r['rms_mm']:.3f}",
                f"{100 * r['share']:.0f} %",
                f"{r['excess']:.1f}",
            )
            for r in worst.to_dict("records")
        ]
        columns = ("poses", "n", "rms mm", "squared error", "times its share")
        yield Table("Surely worse than the rest", columns, rows, frozenset({1, 2, 3, 4}))
    yield from where_drawings({k.partition("/")[2]: f for k, f in figures.items() if k.startswith("where/")})


def _cause_blocks(d: Diagnosis, figures: Mapping[str, go.Figure]) -> Iterator[Block]:
    if "shrink" in figures:
        yield Drawing(
            "shrink", figures["shrink"], "On held-out poses, each cause alone in the model; they may overlap."
        )
        rows = [row for c in d.causes for row in _estimates(c)]
        if rows:
            yield Table(
                "Size of the causes", ("cause", "parameter", "value", "std error", "unit"), rows, frozenset({2, 3})
            )
    for name, figure in figures.items():
        if name.startswith("causes/"):
            first = name == "causes/1"
            caption = "All candidates compete with nothing at all and with smooth errors of no listed cause."
            yield Drawing(name, figure, caption if first else "Once the causes so far are in the model.")


def _estimates(c: Cause) -> Iterator[tuple[str, ...]]:
    for effect in c.effects:
        yield from ((c.label, name, f"{value:.4g}", "chosen", "") for name, value in settings(effect).items())
    for name, (value, error, unit) in (c.estimates or {}).items():
        factor, shown = readable(unit, max(abs(value), error))
        yield c.label, name, f"{factor * value:.4g}", f"{factor * error:.2g}", shown


def _parameter_blocks(d: Diagnosis, figures: Mapping[str, go.Figure]) -> Iterator[Block]:
    yield Words(
        "With priors from the robot file, outliers held back, and without the causes. Bars are 95 % intervals. Base "
        "and tool frames are in the table only.",
        "note",
    )
    yield from (Drawing(name, figure) for name, figure in figures.items() if name.startswith("parameters/"))
    yield from parameter_tables(d.identification, whole=True)
    yield held_table(d.identification)
    yield from correlated(d.identification)


def _next_blocks(d: Diagnosis, e: Extras) -> Iterator[Block]:
    poses = d.next_poses(NEXT) if e.poses is None else e.poses
    if not len(poses):
        yield Words("Nothing is in question: no further poses are needed to distinguish causes.")
        return
    before, after = told_apart(d, poses)
    yield Words(
        f"Measure these {len(poses)} poses to distinguish {' from '.join(d.in_question)}: the probability of the "
        f"correct cause rises from {before:.2f} to {after:.2f}. {kinds(d.case, poses)}. The option "
        "--next FILE.csv writes them. "
        "Separation is the expected log Bayes factor in favour of the truth, of a pose and those before it."
    )
    yield _pose_table(poses)


def _pose_table(poses: pd.DataFrame) -> Table:
    shown = poses.dropna(axis="columns", how="all")
    columns = [str(c) for c in shown]
    rows = [tuple(f"{v:.1f}" if isinstance(v, float) else str(v) for v in row) for row in shown.itertuples(index=False)]
    numbers = frozenset(k for k, c in enumerate(columns) if c not in ("state", "repeats"))
    return Table("Next poses", columns, rows, numbers)
