"""Measured poses simulated in MuJoCo: nominal, with geometry, and with the causes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from casadical.core.blocks import Table, Words, mm
from casadical.core.errors import ConvergenceError, InputError
from casadical.export.mjcf.equilibrium import load_mujoco
from casadical.export.mjcf.replay import Replay, ReplayedModel, replay_diagnosis
from casadical.report.page import Block, Drawing
from casadical.report.style import BLUE, GREEN, GREY, INK, Figure, new_figure, plain

if TYPE_CHECKING:
    from casadical.diagnosis.result import Diagnosis

DRAWS = 1000
NAMES = ("nominal, placed", "calibrated")


def replay_blocks(d: Diagnosis) -> Iterator[Block]:
    """Figure and table of the replay; a sentence where MuJoCo is missing or cannot follow."""
    try:
        load_mujoco()
    except InputError:
        yield Words(
            "MuJoCo is not installed, so the poses were not driven again in it; it comes with the extra `mujoco`: pip "
            "install 'casadical[mujoco]'.",
            "note",
        )
        return
    try:
        found = replay_diagnosis(d)
    except (InputError, ConvergenceError) as error:
        yield Words(f"MuJoCo could not drive these poses again: {error}", "warning")
        return
    shown = _shown(found)
    first, last = shown[0], shown[-1]
    yield Words(
        f"{len(last.errors)} poses driven again in MuJoCo with models whose values were identified from the others. "
        "Geometry, masses, springs and loops, and the causes that it has a counterpart of, are the engine's own; what "
        "the instrument does (a frame that drifts, say) is added to its point. As "
        f"drawn, the robot misses the measured points by {mm(first.accuracy.mean)} mm on average, as "
        f"{'diagnosed' if len(shown) > 2 else 'calibrated'} by {mm(last.accuracy.mean)} mm."
    )
    if lacking := found.stages[-1].lacking:
        yield Words(f"MuJoCo has no counterpart of {' and '.join(lacking)}: not in its model.", "warning")
    yield Drawing("replay", replay_figure(found, d.gap.floor), _CAPTION)
    yield _table(found)


def _shown(found: Replay) -> tuple[ReplayedModel, ...]:
    """The stages; the last one only if anything of the causes is in it."""
    last = found.stages[-1]
    causes = found.diagnosis.effects() if found.diagnosis else ()
    return found.stages[:2] if set(last.lacking) >= {e.label for e in causes} else found.stages


_CAPTION = (
    "Nominal: the drawing, with base and tool fitted; calibrated: geometry and joint stiffness. Mean over poses that "
    "had no part in the values, with a 95 % interval, on a logarithmic axis: other poses than those of the gap. Noise "
    "alone: as there."
)


def replay_figure(found: Replay, floor: float) -> Figure:
    """Mean distance of the engine's point from the measured one [mm], stage by stage; floor : of the noise [m]."""
    rng = np.random.default_rng(0)
    stages, names = _shown(found), stage_names(found)
    mean = [1e3 * s.accuracy.mean for s in stages]
    quantiles = []
    for s in stages:
        drawn = s.errors[rng.integers(0, len(s.errors), (DRAWS, len(s.errors)))].mean(axis=1)
        quantiles.append(1e3 * np.quantile(drawn, [0.025, 0.975]))
    low, high = np.transpose(quantiles)
    axis = np.log10([0.7 * min(1e3 * floor, *low), 1.1 * max(high)])
    figure = new_figure("Poses replayed in MuJoCo", "mean position error [mm]", height=150 + 40 * len(names))
    figure.add_scatter(
        x=mean,
        y=list(range(len(names))),
        mode="markers",
        marker={"size": 11, "color": [GREY, GREY, BLUE][: len(names)]},
        error_x={"type": "data", "symmetric": False, "array": high - mean, "arrayminus": mean - low, "color": GREY,
                 "thickness": 2, "width": 0},
        customdata=[[plain(n), a, b] for n, a, b in zip(names, low, high, strict=True)],
        hovertemplate="<b>%{customdata[0]}</b><br>%{x:.4f} mm, 95 %: %{customdata[1]:.4f} to %{customdata[2]:.4f}"
        "<extra></extra>",
        showlegend=False,
    )  # fmt: skip
    for place, (value, end) in enumerate(zip(mean, high, strict=True)):
        figure.add_annotation(x=np.log10(end), y=place, text=f"{value:.3f} mm", xanchor="left", xshift=8,
                              showarrow=False, font={"color": INK, "size": 12})  # fmt: skip
    figure.add_vline(x=1e3 * floor, line={"color": GREEN, "width": 2, "dash": "dot"})
    figure.add_annotation(x=np.log10(1e3 * floor), y=1, yref="y domain", text=f"noise alone {1e3 * floor:.3f} mm",
                          yanchor="bottom", showarrow=False, font={"color": GREEN, "size": 12})  # fmt: skip
    figure.update_layout(margin_r=76)
    figure.update_xaxes(type="log", range=list(axis), **_ticks(*axis))
    words = [plain(n).replace(" and ", "<br>and ") for n in names]
    ends = [len(names) - 0.4, -0.6]
    return figure.update_yaxes(tickvals=list(range(len(names))), ticktext=words, range=ends, showgrid=False)


def _ticks(low: float, high: float) -> dict[str, list[float] | list[str]]:
    """Few marks of a logarithmic axis between two powers of ten: whole decades, or 1, 2, 5 where it is short."""
    steps = (1,) if high - low > 1 else (1, 2, 5)
    values = [m * 10.0**e for e in range(int(np.floor(low)), int(np.ceil(high))) for m in steps]
    return {"tickvals": values, "ticktext": [f"{v:g}" for v in values]}


def _micrometres(metres: float) -> str:
    return f"{1e6 * metres:.0f}" if metres > 1e-5 else f"{1e6 * metres:.2g}"


def stage_names(found: Replay) -> list[str]:
    """What each stage's model holds."""
    without = (f", without {' and '.join(s.lacking)}" if s.lacking else "" for s in _shown(found)[2:])
    return [*NAMES, *(f"with {s.name}{w}" for s, w in zip(_shown(found)[2:], without, strict=True))]


def _table(found: Replay) -> Table:
    rows = [
        (name, str(s.accuracy.n), *(mm(v) for v in (s.accuracy.mean, s.accuracy.max, s.accuracy.rms, s.accuracy.p95)),
         _micrometres(float(s.apart.max())))
        for name, s in zip(stage_names(found), _shown(found), strict=True)
    ]  # fmt: skip
    columns = ("model in MuJoCo", "n", "mean", "max", "rms", "95 %", "apart um")
    title = "Errors in mm; apart: largest distance between the engine's point and casadical's own"
    return Table(title, columns, rows, frozenset(range(1, 7)), frozenset({len(rows) - 1}))
