"""The report of a diagnosis: its figures, and the part of a page that they make with words and tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from casadical.core.blocks import Table, Words, mm
from casadical.diagnosis.cause_table import CauseRow, cause_rows
from casadical.diagnosis.layers import layer_rows
from casadical.diagnosis.spectrum_report import COLUMNS as CURVE_COLUMNS
from casadical.diagnosis.spectrum_report import curve_rows
from casadical.diagnosis.statements import has_rest, left_over, statements
from casadical.diagnosis.thresholds import PARTITIONS
from casadical.identification.tables import correlated, held_table, parameter_tables
from casadical.report.figures_of_diagnosis import diagnosis_figures, held_out_poses
from casadical.report.fit_figures import fit_drawings
from casadical.report.laws import law_section
from casadical.report.page import Block, Drawing, Part, Section, Tile, report_html
from casadical.report.provenance import campaign_files, provenance_of
from casadical.report.replay_blocks import replay_blocks
from casadical.report.share_figures import where_drawings
from casadical.report.style import Figure

if TYPE_CHECKING:
    import pandas as pd

    from casadical.diagnosis.details import Details
    from casadical.diagnosis.result import Diagnosis
    from casadical.diagnosis.statements import Statement


def diagnosis_report(
    folder: Path, answered: Sequence[tuple[Path, Diagnosis, Details | None]], command: Sequence[str] = ()
) -> str:
    """One HTML file of one or several diagnoses of a problem's robot.

    Parameters
    ----------
    folder : Path
        the problem's
    answered : Sequence[tuple[Path, Diagnosis, Details | None]]
        (campaign's file, diagnosis, what `analyse` computed of it)
    command : Sequence[str], default ()
        as it was typed

    Returns
    -------
    str
        HTML

    Raises
    ------
    InputError
        plotly or jinja2 is not installed, or a file is gone

    Examples
    --------
    >>> file = Path("problems/planar/../../data/planar/planar.csv")
    >>> html = casadical.report.diagnosis_report(Path("problems/planar"), [(file, diagnosis, None)])
    >>> html[:15]
    '<!doctype html>'
    """
    parts = [diagnosis_part(d, path.stem, more) for path, d, more in answered]
    return report_html("Diagnosis", parts, provenance_of(campaign_files(folder, [a[0] for a in answered]), command))


def diagnosis_part(d: Diagnosis, name: str, more: Details | None = None) -> Part:
    """One campaign's part of a page; name : of the campaign. Raises InputError where plotly is not installed."""
    figures = diagnosis_figures(d, more)
    said = statements(d, more)
    rows = cause_rows(d)
    sections = [
        Section("Verdict", [*_said(said, "VERDICT", "PRIOR", "GAP", "ASSUMED", "GRAVITY", "UNKNOWN", "LAW", "OUT")]),
        Section(
            "Errors before and after",
            [Drawing("gap", figures["gap"], _GAP), *_layers(d), _error_table(d), *_said(said, "AFTER")],
        ),
        Section("Error of each pose", [Drawing("errors", figures["errors"], _EACH)]),
        Section("In the workspace", [Drawing("workspace", figures["workspace"], _SPACE)]),
        Section("Where the gap lies", [*_said(said, "WHERE"), *_where_blocks(more, figures)]),
        Section(
            "Which causes, and how sure",
            [*_said(said, "WHICH"), *_cause_tables(rows), *_said(said, "SET"), *_cause_figures(figures)],
        ),
        *_curve_sections(more, figures),
        *([law_section(more.laws)] if more and more.laws else []),
        Section("What these poses cannot tell", [*_said(said, "CANNOT", "MISSING")]),
        Section("Replayed in a simulator", [*replay_blocks(d)]),
        Section("Parameters of the base model", [*_parameter_blocks(d, figures)]),
        Section("Can the fit be trusted", [*fit_drawings(figures)]),
        Section("What to measure next", [*_next_blocks(said, more)]),
    ]
    return Part(f"Diagnosis of {name}", d.identification.given.name, sections, [*_tiles(d)])


# Where a long name may be broken.
BREAK = "\u200b"
_GAP = (
    "The gap, here and everywhere in this report: mean distance of measured from computed positions over poses that "
    f"the fit did not see (in fifths, {PARTITIONS} partitions), outliers left out, with a 95 % interval over poses. "
    "Noise alone: what a perfect model would leave, simulated through the same fit."
)
_EACH = "Every pose is judged by a fit to others; outliers are left out. Click a name in the legend to show or hide it."
_CURVES = (
    "With the base model, all other causes and the curves of the other joints in the model. Shaded: angles near which "
    "there are readings; elsewhere the curve is not measured, and the band is that of its prior. Shares are of the log "
    "evidence that is lost when a joint's curve is left out."
)
_LINES = (
    "What one sine of a joint's reading explains by itself, at each frequency, with a 95 % band. A line (dot, with a "
    "95 % interval) stands out of the noise and of the rest of the curve; a broad spectrum without dots is a curve "
    "that is no sum of a few sines. Dotted: what a line needs beside the curve as it is; side lobes of a larger sine "
    "may cross it."
)
_SPACE = (
    "Turn it with the mouse; point at the dot that ends a vector for its error. Each line runs from the measured point "
    "in the direction of the error (measured less computed), after a fit to all poses, longer than it by the factor in "
    "the legend."
)


def _said(said: Sequence[Statement], *about: str) -> Iterator[Words]:
    """The statements about something, as sentences."""
    for topic in about:
        for s in (s for s in said if s.about == topic):
            text = f"cannot {s.text}" if topic == "CANNOT" else s.text
            if text.split()[0].strip(":,").isalpha():  # no name of a column
                text = text[0].upper() + text[1:]
            text = text.replace("->", "→").replace("   ", ", ")
            yield Words(f"{text}.", "verdict" if topic == "VERDICT" else "warning" if s.doubtful else "text")


def _tiles(d: Diagnosis) -> Iterator[Tile]:
    yield Tile("Gap, held out", mm(d.gap.kept), "mm", f"mean of {int(d.case.kept.sum())} poses")
    if d.effects():
        yield Tile("With the causes", mm(d.gap.after), "mm", f"{100 * (1 - d.gap.after / d.gap.kept):.0f} % less")
    yield Tile("Noise alone", mm(d.gap.floor), "mm", f"instrument {mm(d.noise.sigma)} mm a coordinate")
    if d.effects():
        first = next(c for c in d.causes if c.effects)
        yield Tile("Leading cause", first.label.replace("_", f"_{BREAK}"), "", f"probability {first.confidence:.3f}")
    if has_rest(d):
        before, after, share = left_over(d)
        yield Tile(
            "Without a named cause", mm(1e-3 * after), "mm rms", f"{100 * share:.0f} % of {before:.3f}, noise off"
        )


def _layers(d: Diagnosis) -> Iterator[Table]:
    """The errors layer by layer, from the calibrated robot to the noise, where there is a layer to take off."""
    if rows := layer_rows(d):
        columns = ("layer, beside those above", "mean", "95 %", "fifths of the time left out", "rms without the noise")
        yield Table("Layer by layer: errors on held-out poses, mm", columns, rows, frozenset(range(1, 5)))


def _error_table(d: Diagnosis) -> Table:
    rows = []
    for left in held_out_poses(d).models:
        e = left.length
        figures = (e.mean(), e.max(), e.std(ddof=1), np.sqrt((e**2).mean()), np.quantile(e, 0.95))
        rows.append((left.model, str(len(e)), *(mm(float(v)) for v in figures)))
    columns = ("held-out poses, outliers left out", "n", "mean", "max", "std", "rms", "95 %")
    strong = frozenset({len(rows) - 1})
    return Table("Errors in mm", columns, rows, frozenset(range(1, 7)), strong)


def _where_blocks(more: Details | None, figures: Mapping[str, Figure]) -> Iterator[Block]:
    if more is None or more.where is None:
        return
    yield Words("Of what the base model leaves at the poses it was fitted to. Bars are 95 % intervals.", "note")
    worst = more.where.worst.head(8)
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


def _cause_tables(rows: Sequence[CauseRow]) -> Iterator[Block]:
    if not rows:
        return
    cells = [(r.named, r.shown, f"{r.cause.confidence:.3f}", r.gap.replace("->", "→"), r.shrinks) for r in rows]
    columns = ("cause", "signature", "posterior", "gap if added, mm", "shrinks by, 95 %")
    yield Table("Causes", columns, cells, frozenset({2, 3, 4}))
    sizes = [
        (r.cause.label, name, value, error or "chosen", unit)
        for r in rows
        if r.cause.effects
        for name, value, error, unit in r.parameters
    ]
    if sizes:
        head = ("cause", "parameter", "value", "std error", "unit")
        yield Table("Size of the causes", head, sizes, frozenset({2, 3}))


def _cause_figures(figures: Mapping[str, Figure]) -> Iterator[Block]:
    if "shrink" in figures:
        caption = "On held-out poses, each cause alone in the model; they may overlap."
        yield Drawing("shrink", figures["shrink"], caption)
    for name, figure in figures.items():
        if name.startswith("causes/"):
            first = name == "causes/1"
            caption = "All candidates compete with nothing at all and with smooth errors of no listed cause."
            yield Drawing(name, figure, caption if first else "Once the causes so far are in the model.")


def _curve_sections(more: Details | None, figures: Mapping[str, Figure]) -> Iterator[Section]:
    """Joint error curves, where there are any."""
    if more is None or more.curves is None:
        return
    rows = [tuple(cell.replace("+-", "±") for cell in row) for row in curve_rows(more.curves)]
    yield Section(
        "Joint error curves",
        [
            Drawing("curves/angles", figures["curves/angles"], _CURVES),
            Drawing("curves/lines", figures["curves/lines"], _LINES),
            Table("Curves and their lines", CURVE_COLUMNS, rows, frozenset({1, 2})),
            *(Words(f"{text[0].upper()}{text[1:]}.", "note") for text in more.curves.suggestions),
        ],
    )


def _parameter_blocks(d: Diagnosis, figures: Mapping[str, Figure]) -> Iterator[Block]:
    yield Words(
        "With priors from the robot file, outliers held back, and without the causes. Bars are 95 % intervals. Base "
        "and tool frames are in the table only.",
        "note",
    )
    yield from (Drawing(name, figure) for name, figure in figures.items() if name.startswith("parameters/"))
    yield from parameter_tables(d.identification, whole=True)
    yield held_table(d.identification)
    yield from correlated(d.identification)


def _next_blocks(said: Sequence[Statement], more: Details | None) -> Iterator[Block]:
    if more is None or more.poses is None:
        return
    yield from _said(said, "NEXT")
    if not len(more.poses):
        yield Words("Nothing is in question: no further poses are needed to distinguish causes.")
        return
    yield Words(
        "P(correct) is the probability that the more probable of the two causes is the true one, now and with these "
        "poses measured. Separation is the expected log Bayes factor in favour of the truth, of a pose and those "
        "before it. The option --next FILE.csv writes the poses.",
        "note",
    )
    yield _pose_table(more.poses)


def _pose_table(poses: pd.DataFrame) -> Table:
    shown = poses.dropna(axis="columns", how="all")
    columns = [str(c) for c in shown]
    rows = [tuple(f"{v:.1f}" if isinstance(v, float) else str(v) for v in row) for row in shown.itertuples(index=False)]
    numbers = frozenset(k for k, c in enumerate(columns) if c not in ("state", "repeats"))
    return Table("Next poses", columns, rows, numbers)
