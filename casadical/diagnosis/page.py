"""HTML page of a diagnosis: statements, tables and figures in the order of questions."""

from collections.abc import Iterable, Iterator, Sequence

import pandas as pd

from casadical.core.reporting.blocks import Block, Page, Section, Table, Tile, Words, figures_named, mm
from casadical.core.reporting.figure import Figure
from casadical.diagnosis.cause_table import CauseRow, cause_rows, layer_rows
from casadical.diagnosis.details import Details
from casadical.diagnosis.figures import diagnosis_figures
from casadical.diagnosis.joint_curves import CURVE_COLUMNS
from casadical.diagnosis.localisation import Localisation
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.statements import Statement, floor_of, noiseless_errors, statements
from casadical.identification.accuracy import summarise
from casadical.identification.figures import correlated, parameter_tables, unidentifiable_table


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
        lines = [tuple(cell.replace("+-", "±") for cell in row) for row in more.curves.rows()]
        curves = [Table("Curves", CURVE_COLUMNS, lines, frozenset({1, 2}))]
    sections = [
        Section(
            "Verdict",
            [*_said(said, "VERDICT", "PRIOR", "GAP", "NOISE", "ASSUMED", "GRAVITY", "UNKNOWN", "LAW", "OUT")],
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
                *_said(said, "SET"),
                *figures_named(figures, "shrink"),
                *figures_named(figures, "causes"),
            ],
        ),
        Section("Joint error curves", [*figures_named(figures, "curves"), *curves]),
        *([more.laws.section()] if more.laws else []),
        Section("What these poses cannot tell", [*_said(said, "CANNOT", "MISSING")]),
        Section("Replayed in a simulator", replayed),
        Section("Parameters of the base model", [*_parameters(d, figures_named(figures, "parameters"))]),
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


def _parameters(d: Diagnosis, figures: Iterable[Figure]) -> Iterator[Block]:
    """Yield figures and tables of the base model's parameters."""
    yield Words(
        "With priors from the robot file, outliers excluded, and without the causes. Bars are 95 % intervals. Base "
        "and tool frames are in the table only.",
        "note",
    )
    yield from figures
    yield from parameter_tables(d.identification, whole=True)
    yield unidentifiable_table(d.identification)
    yield from correlated(d.identification)


def _next(said: Sequence[Statement], poses: pd.DataFrame | None) -> Iterator[Block]:
    """Yield statements and table of the next poses, or that none are needed; nothing for None."""
    if poses is None:
        return
    yield from _said(said, "NEXT")
    if not len(poses):
        yield Words("Nothing is in question: no further poses are needed to distinguish causes.")
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
