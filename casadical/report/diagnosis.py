"""The report of a diagnosis: its figures, and the part of a page that they make with words and tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..diagnosis.answer import SIGNATURES
from ..diagnosis.gap import held_out_errors, left_by_fit, random_folds
from ..transforms import Array
from .calibration import where_drawings
from .cause_figures import gap_ladder, posteriors, shrinks
from .error_figures import before_after
from .look import mm
from .page import Block, Drawing, Part, Section, Table, Tile, Words
from .parameter_figures import parameter_figures
from .parameter_tables import confounded, correlated, parameter_table
from .pose_errors import BEFORE, Left, PoseErrors
from .share_figures import where_figure
from .workspace import workspace

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

    from ..diagnosis.result import Cause, Diagnosis

WITH = "with causes"
PARTITIONS = 5
NEXT = 15


def diagnosis_figures(d: Diagnosis) -> dict[str, go.Figure]:
    """Every figure of a diagnosis' report, by name.

    gap; errors (held out, pose by pose); workspace; where/TABLE as `Diagnosis.where` names them; causes/STEP;
    shrink (where a cause was found); parameters/lengths, /angles, /compliance. Raises InputError without plotly.
    """
    poses = held_out_poses(d)
    found = {
        "gap": gap_ladder(d),
        "errors": before_after(poses, d.gap.floor),
        "workspace": workspace(fitted_poses(d), d.identification.robot),
    }
    found |= {f"where/{name}": where_figure(name, table) for name, table in d.where.tables()}
    found |= {f"causes/{k + 1}": posteriors(d, k) for k in range(len(d.rankings))}
    if d.causes:
        found["shrink"] = shrinks(d)
    return found | {f"parameters/{k}": f for k, f in parameter_figures(d.identification).items()}


def held_out_poses(d: Diagnosis) -> PoseErrors:
    """Held-out error of every pose that is no outlier: base model, and with the causes in it."""
    e = d.case.evidence
    folds = [random_folds(len(e.r), d.seed + k) for k in range(PARTITIONS)]

    def errors(columns: Array, noise: object) -> Array:
        return np.asarray(np.mean([held_out_errors(e, columns, noise, f) for f in folds], axis=0))  # type: ignore[arg-type]

    none, columns = np.zeros(0, dtype=np.int64), _columns(d)
    models = [Left(BEFORE, errors(none, d.rankings[0].noise[""]))]
    if columns.size:
        models.append(Left(WITH, errors(columns, d.noise)))
    return _poses(d, tuple(models), "Held-out poses")


def fitted_poses(d: Diagnosis) -> PoseErrors:
    """What a fit to all poses leaves at each, as vectors: base model, and with the causes in it."""
    k, columns = d.case.kept, _columns(d)
    base = d.case.evidence.r
    models = [Left("base model", np.linalg.norm(base, axis=1), base)]
    if columns.size:
        rest = left_by_fit(d.case.whole, columns, d.noise, k)[k]
        models.append(Left(WITH, np.linalg.norm(rest, axis=1), rest))
    return _poses(d, tuple(models), "All poses fitted")


def _columns(d: Diagnosis) -> Array:
    """Columns of all causes together."""
    parts = [d.case.group(c.effects) for c in d.causes if c.effects]
    return np.unique(np.concatenate(parts)) if parts else np.zeros(0, dtype=np.int64)


def _poses(d: Diagnosis, models: tuple[Left, ...], name: str) -> PoseErrors:
    m, k = d.case.m, d.case.kept
    assert m.position is not None
    return PoseErrors(name, name.startswith("Held"), m.row[k], m.q[k], m.position[k], models)


def diagnosis_part(d: Diagnosis, name: str) -> Part:
    """One campaign's part of a page; name : of the campaign. Raises InputError where plotly is not installed."""
    figures = diagnosis_figures(d)
    sections = [
        Section("Verdict", [*_verdict(d)]),
        Section("Errors before and after", [Drawing("gap", figures["gap"], _GAP), _error_table(d)]),
        Section("Error of each pose", [Drawing("errors", figures["errors"], _EACH)]),
        Section("In the workspace", [Drawing("workspace", figures["workspace"], _SPACE)]),
        Section("Where the gap lies", [*_where_blocks(d, figures)]),
        Section("Which causes, and how sure", [*_cause_blocks(d, figures)]),
        Section("Parameters of the base model", [*_parameter_blocks(d, figures)]),
        Section("What to measure next", [*_next_blocks(d)]),
    ]
    return Part(f"Diagnosis of {name}", d.identification.given.name, sections, [*_tiles(d)])


_GAP = (
    "Mean over poses that the fit did not see (5-fold, 5 partitions). Noise alone: what a perfect model would leave, "
    "simulated through the same fit."
)
_EACH = "Every pose is judged by a fit to others; outliers are left out. Click a name in the legend to show or hide it."
_SPACE = (
    "Turn it with the mouse; point at the dot that ends a vector for its error. Each line runs from the measured point in the "
    "direction of the error (measured less computed), after a fit to all poses, and is longer by the factor in the legend."
)
_WORDS = {
    "none": "What is left is noise: no cause can be claimed.",
    "explained": "The gap is explained.",
    "ambiguous": "Something is there, but these data cannot tell between causes that look alike.",
    "unknown": "Something is there that no listed cause explains.",
}


def _verdict(d: Diagnosis) -> Iterator[Block]:
    change = "" if not d.causes else f"; with the causes in the model {mm(d.gap.after)} mm"
    yield Words(
        f"{_WORDS[d.verdict]} The calibrated base model leaves {mm(d.gap.before)} mm on held-out poses{change}; noise "
        f"alone would leave {mm(d.gap.floor)} mm.",
        "verdict",
    )
    for c in d.causes:
        low, high = (100 * v for v in c.shrink_interval)
        signature = SIGNATURES.get(c.effect) or (c.effects[0].physics if c.effects else "")
        yield Words(
            f"{c.label}: {signature}. Probability {c.confidence:.3f}; alone it shrinks the gap by {100 * c.shrink:.0f} % "
            f"(95 %: {low:.0f} to {high:.0f} %)."
        )
        if c.indistinguishable:
            yield Words(f"These data cannot tell {c.label} from {', '.join(c.indistinguishable)}.", "warning")
    if d.unknown_rest > 0.05:
        yield Words(f"{100 * d.unknown_rest:.0f} % of the gap lies above the noise and is not explained.", "warning")
    if d.outliers:
        rows = ", ".join(map(str, d.outliers[:12])) + (" ..." if len(d.outliers) > 12 else "")
        yield Words(f"{len(d.outliers)} poses were left out as outliers: rows {rows}.")
    if d.missing:
        columns = sorted({c for lacking in d.missing.values() for c in lacking})
        yield Words(f"Not logged: {', '.join(columns)}. Nothing can be said about {', '.join(sorted(d.missing))}.", "note")


def _tiles(d: Diagnosis) -> Iterator[Tile]:
    yield Tile("Gap, held out", mm(d.gap.before), "mm", f"mean of {int(d.case.kept.sum())} poses")
    if d.causes:
        yield Tile("With the causes", mm(d.gap.after), "mm", f"{100 * (1 - d.gap.after / d.gap.before):.0f} % less")
    yield Tile("Noise alone", mm(d.gap.floor), "mm", f"instrument {mm(d.noise.sigma)} mm a coordinate")
    if d.causes:
        first = d.causes[0]
        yield Tile("Leading cause", first.label, "", f"probability {first.confidence:.3f}")


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


def _where_blocks(d: Diagnosis, figures: Mapping[str, go.Figure]) -> Iterator[Block]:
    yield Words("Of what the base model leaves at the poses it was fitted to. Bars are 95 % intervals.", "note")
    worst = d.where.worst.head(8)
    if len(worst):
        rows = [
            (f"{r.by}: {r.part}", str(r.poses), f"{r.rms_mm:.3f}", f"{100 * r.share:.0f} %", f"{r.excess:.1f}")
            for r in worst.itertuples()
        ]
        columns = ("poses", "n", "rms mm", "squared error", "times its share")
        yield Table("Surely worse than the rest", columns, rows, frozenset({1, 2, 3, 4}))
    yield from where_drawings({k.partition("/")[2]: f for k, f in figures.items() if k.startswith("where/")})


def _cause_blocks(d: Diagnosis, figures: Mapping[str, go.Figure]) -> Iterator[Block]:
    if "shrink" in figures:
        yield Drawing("shrink", figures["shrink"], "On held-out poses, each cause alone in the model; they may overlap.")
        rows = [row for c in d.causes for row in _estimates(c)]
        if rows:
            yield Table("Size of the causes", ("cause", "parameter", "value", "std error", "unit"), rows, frozenset({2, 3}))
    for name, figure in figures.items():
        if name.startswith("causes/"):
            first = name == "causes/1"
            caption = "All candidates compete with nothing at all and with smooth errors of no listed cause."
            yield Drawing(name, figure, caption if first else "Once the causes so far are in the model.")


_READABLE = {"rad": ("µrad", 1e6), "m": ("mm", 1e3), "rad/K": ("µrad/K", 1e6), "": ("", 1.0)}


def _estimates(c: Cause) -> Iterator[tuple[str, ...]]:
    for name, (value, error, unit) in (c.estimates or {}).items():
        shown, factor = _READABLE.get(unit, (unit, 1.0))
        yield c.label, name, f"{factor * value:.4g}", f"{factor * error:.2g}", shown


def _parameter_blocks(d: Diagnosis, figures: Mapping[str, go.Figure]) -> Iterator[Block]:
    yield Words(
        "With priors from the robot file, outliers held back, and without the causes. Bars are 95 % intervals. Base and "
        "tool frames are in the table only.",
        "note",
    )
    yield from (Drawing(name, figure) for name, figure in figures.items() if name.startswith("parameters/"))
    yield parameter_table(d.identification)
    yield confounded(d.identification)
    yield correlated(d.identification)


def _next_blocks(d: Diagnosis) -> Iterator[Block]:
    poses = d.next_poses(NEXT)
    if not len(poses):
        yield Words("Nothing is in question: no further poses are needed to tell causes apart.")
        return
    yield Words(
        f"These {len(poses)} poses would best tell {' from '.join(d.in_question)}. Separation is the expected log Bayes "
        "factor in favour of the truth, of a pose and those before it; 3 is strong. `--next FILE.csv` writes them."
    )
    yield _pose_table(poses)


def _pose_table(poses: pd.DataFrame) -> Table:
    shown = poses.dropna(axis="columns", how="all")
    columns = [str(c) for c in shown]
    rows = [tuple(f"{v:.1f}" if isinstance(v, float) else str(v) for v in row) for row in shown.itertuples(index=False)]
    numbers = frozenset(k for k, c in enumerate(columns) if c not in ("state", "repeats"))
    return Table("Next poses", columns, rows, numbers)
