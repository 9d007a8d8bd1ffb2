"""Measured poses simulated in MuJoCo, as words, figure and table of a diagnosis' page."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from casadical.core.errors import ConvergenceError, InputError
from casadical.core.telling.blocks import Block, Table, Words, mm
from casadical.core.telling.figure import Axis, Figure, Note, Rule, Series, ticks_of_decades
from casadical.diagnosis.result import Diagnosis
from casadical.export.mjcf.equilibrium import load_mujoco
from casadical.export.mjcf.replay import Replay, ReplayedModel, replay_diagnosis

NAMES = ("nominal, placed", "calibrated")
_CAPTION = (
    "Nominal: the drawing, with base and tool fitted; calibrated: geometry and joint stiffness. Mean over poses that "
    "had no part in the values, with a 95 % interval, on a logarithmic axis: other poses than those of the gap. Noise "
    "alone: as there."
)


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
        replayed = replay_diagnosis(d)
    except (InputError, ConvergenceError) as error:
        yield Words(f"MuJoCo could not drive these poses again: {error}", "warning")
        return
    stages = _shown(replayed)
    first, last = stages[0], stages[-1]
    yield Words(
        f"{len(last.errors)} poses driven again in MuJoCo with models whose values were identified from the others. "
        "Geometry, masses, springs and loops, and the causes that it has a counterpart of, are the engine's own; what "
        "the instrument does (a frame that drifts, say) is added to its point. As "
        f"drawn, the robot misses the measured points by {mm(first.accuracy.mean)} mm on average, as "
        f"{'diagnosed' if len(stages) > 2 else 'calibrated'} by {mm(last.accuracy.mean)} mm."
    )
    if lacking := replayed.stages[-1].lacking:
        yield Words(f"MuJoCo has no counterpart of {' and '.join(lacking)}: not in its model.", "warning")
    yield replay_figure(replayed, d.gap.floor)
    yield _table(replayed)


def _shown(replayed: Replay) -> tuple[ReplayedModel, ...]:
    last = replayed.stages[-1]
    causes = replayed.diagnosis.effects() if replayed.diagnosis else ()
    return replayed.stages[:2] if set(last.lacking) >= {e.label for e in causes} else replayed.stages


def replay_figure(replayed: Replay, floor: float) -> Figure:
    """Mean distance of the engine's point from the measured one [mm], stage by stage; floor : of the noise [m]."""
    stages, names = _shown(replayed), stage_names(replayed)
    mean, noise = [1e3 * s.accuracy.mean for s in stages], 1e3 * floor
    low, high = 1e3 * np.transpose([s.interval for s in stages])
    ends = (0.7 * min(noise, *low), 1.1 * max(high))
    ticks = ticks_of_decades(*ends, steps=(1,) if ends[1] > 10 * ends[0] else (1, 2, 5))
    dots = Series(
        "points", mean, range(len(names)), size=11, colour=["grey", "grey", "blue"][: len(names)], less=mean - low,
        more=high - mean, facts=[list(row) for row in zip(names, low, high, strict=True)],
        tip="<b>%{customdata[0]}</b><br>%{x:.4f} mm, 95 %: %{customdata[1]:.4f} to %{customdata[2]:.4f}",
    )  # fmt: skip
    notes = [Note(f"{value:.3f} mm", end, k, gap=8) for k, (value, end) in enumerate(zip(mean, high, strict=True))]
    return Figure(
        "replay", "Poses replayed in MuJoCo", [dots], Axis("mean position error [mm]", ends, log=True, ticks=ticks),
        rows=[name.replace(" and ", "\nand ") for name in names], height=150 + 40 * len(names), caption=_CAPTION,
        marks=[*notes, Rule("x", noise, "green", width=2, text=f"noise alone {noise:.3f} mm")], right=76,
    )  # fmt: skip


def _micrometres(metres: float) -> str:
    return f"{1e6 * metres:.0f}" if metres > 1e-5 else f"{1e6 * metres:.2g}"


def stage_names(replayed: Replay) -> list[str]:
    stages = _shown(replayed)[2:]
    without = (f", without {' and '.join(s.lacking)}" if s.lacking else "" for s in stages)
    return [*NAMES, *(f"with {s.name}{w}" for s, w in zip(stages, without, strict=True))]


def _table(replayed: Replay) -> Table:
    rows = [
        (name, str(s.accuracy.n), *(mm(v) for v in (s.accuracy.mean, s.accuracy.max, s.accuracy.rms, s.accuracy.p95)),
         _micrometres(float(s.apart.max())))
        for name, s in zip(stage_names(replayed), _shown(replayed), strict=True)
    ]  # fmt: skip
    columns = ("model in MuJoCo", "n", "mean", "max", "rms", "95 %", "apart um")
    title = "Errors in mm; apart: largest distance between the engine's point and casadical's own"
    return Table(title, columns, rows, frozenset(range(1, 7)), frozenset({len(rows) - 1}))
