"""Replay measured poses in MuJoCo: distances of the model's point from the measured ones.

There are two or three models: the nominal robot with fitted base and tool, the calibrated one, and
if any causes were found, the one with these. All are identified from one part of the poses and
replayed at the others.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
import pandas as pd

from casadical.core.basics import Array, ConvergenceError, InputError, Show, silent
from casadical.core.reporting.blocks import Block, Table, Words, mm
from casadical.core.reporting.figure import Axis, Figure, Note, Rule, Series, ticks_of_decades
from casadical.core.reporting.plain import WRITTEN, Key
from casadical.core.reporting.result import Result
from casadical.diagnosis.candidates import EffectChoice
from casadical.diagnosis.refit import refit
from casadical.diagnosis.result import Diagnosis
from casadical.export.mjcf.equilibrium import load_mujoco, positions
from casadical.export.mjcf.mjcf import MjcfExport, counterparts, mjcf
from casadical.identification.accuracy import Accuracy, predicted, summarise
from casadical.identification.identification import calibrate_base_model, calibrated, prepare
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements
from casadical.project.diagnosis import Campaign, diagnose_campaign
from casadical.robot.robot import Robot

# Fraction of the poses from which models are identified, and of those at which they are replayed.
# Their sum is 0.999: rounding must not raise it above one.
REPLAY_SHARES = {"identify": 2 / 3, "report": round(0.999 - 2 / 3, 3)}


@dataclass(frozen=True, eq=False)
class ReplayedModel:
    """One model in the simulator, with its distances from the measured points.

    name : name of the model in tables
    export : MuJoCo model of the robot
    errors : distances of the simulated points from the measured ones, shape (n,) [m]
    apart : distances of the simulated points from casadical's own predictions, shape (n,) [m]
    lacking : labels of the robot's effects that the simulator cannot represent; effects of the
        measurement are added to its points and do not count
    """

    name: str
    export: MjcfExport
    errors: Array
    apart: Array
    lacking: tuple[str, ...] = ()

    @property
    def accuracy(self) -> Accuracy:
        """Return mean, maximum and further statistics of the errors."""
        return summarise(self.errors)

    @cached_property
    def interval(self) -> Array:
        """Return the 95 % interval of the mean error, by resampling poses (bootstrap), (2,) [m]."""
        rng, n = np.random.default_rng([0, len(self.errors)]), len(self.errors)
        drawn = self.errors[rng.integers(0, n, (1000, n))].mean(axis=1)
        return np.asarray(np.quantile(drawn, [0.025, 0.975]))


@dataclass(frozen=True, eq=False)
class Replay(Result):
    """A campaign replayed at held-out poses: nominal robot, geometry, diagnosed causes if any.

    source : name of the measurements
    robot : name of the robot
    stages : replayed models: nominal, calibrated and, if there are causes, with these
    diagnosis : diagnosis whose causes, if any, the last model has; None: without one
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("stages", "table"),
        Key("written", lambda replay: replay.stages[-1].export.written),
        Key("left_out", lambda replay: replay.stages[-1].export.left_out),
    )

    source: str
    robot: str = field(metadata=WRITTEN)
    stages: tuple[ReplayedModel, ...]
    diagnosis: Diagnosis | None = None

    @property
    def table(self) -> pd.DataFrame:
        """Return a table with a row per model.

        Its columns are model, n, mean_mm, max_mm, rms_mm, p95_mm and apart_um, the maximum of
        `apart`.
        """
        rows = []
        for s in self.stages:
            a, row = s.accuracy, {"model": s.name, "n": s.accuracy.n}
            lengths = {"mean_mm": a.mean, "max_mm": a.max, "rms_mm": a.rms, "p95_mm": a.p95}
            row |= {key: 1e3 * value for key, value in lengths.items()}
            rows.append(row | {"apart_um": 1e6 * float(s.apart.max())})
        return pd.DataFrame(rows)

    def blocks(self) -> list[Words | Table]:
        """Return what `verify --mujoco` prints: the table, and what the last model omits."""
        table = self.table
        rows = [[f"{v:.4f}" if isinstance(v, float) else str(v) for v in row] for row in table.itertuples(index=False)]
        left_out = (Words(f"LEFT OUT {text}") for text in self.stages[-1].export.left_out)
        return [Table("", list(map(str, table)), rows, frozenset(range(1, table.shape[1]))), *left_out]


def replay(robot: Robot, m: Measurements, name: str = "model") -> ReplayedModel:
    """Return the replay of measured poses with a robot's model in MuJoCo.

    m : measured positions; name : name of the model in tables

    Effects of the measurement (a frame that drifts, a reflector's offset) are not in the MuJoCo
    model: they are added to the point that MuJoCo finds.

    Raises InputError: no positions, MuJoCo is not installed, or the joints are those of another
    robot; ConvergenceError: the simulator finds no equilibrium.
    """
    if m.position is None:
        raise InputError(f"{m.source}: of kind {m.kind}; positions are needed to replay")
    m, _ = derive(m, [*robot.conditions, *(f"approach{i}" for i in range(1, robot.n + 1))], robot.loads)
    export = mjcf(robot)
    without = robot.with_only(e for e in robot.effects if not e.of_measurement)
    own, of_robot = (predicted(r, m)[0] for r in (robot, without))
    there = positions(export.text, m, counterparts(robot).payload_factor) + (own - of_robot)
    apart = np.linalg.norm(there - own, axis=1)
    out = {omission.label for omission in export.omitted}
    lacking = tuple(e.label for e in robot.effects if e.label in out and not e.of_measurement)
    return ReplayedModel(name, export, np.linalg.norm(there - m.position, axis=1), apart, lacking)


def replay_campaign(
    robot: Robot, m: Measurements, effects: EffectChoice = "standard", *, seed: int = 0, show: Show = silent
) -> Replay:
    """Return the replay in MuJoCo of part of a campaign, by models found from its other poses.

    robot : nominal robot, as of `diagnose`
    m : measured positions of the campaign
    effects : effects to consider, as of `diagnose`
    seed : seed of the random choice of held-out poses
    show : function that is called with each line of progress
    Raises InputError: the measurements cannot carry a diagnosis, or MuJoCo is not installed;
        ConvergenceError: Ipopt finds no optimum, or the simulator no equilibrium.

    Examples
    --------
    >>> replay = casadical.export.replay_campaign(robot, casadical.from_table(table, 2), ["backlash"])
    >>> len(replay.stages)
    2
    """
    m, _ = derive(m, [f"approach{i}" for i in range(1, robot.n + 1)])
    m, _ = derive(m, ["progress"])
    parts = m.split(REPLAY_SHARES, seed)
    fitted, held_out = parts["identify"], parts["report"]
    diagnosed = diagnose_campaign(Campaign(robot, (fitted,)), effects, seed=seed, show=show).diagnosis
    return Replay(m.source, robot.name, _stages(robot, fitted, held_out, diagnosed, diagnosed.apply, show), diagnosed)


def replay_diagnosis(found: Diagnosis) -> Replay:
    """Return the replay of a diagnosed campaign, values identified again from part of its poses.

    Outliers are excluded. The replayed poses do not enter the fit of the values, though they did
    enter the noise and the choice of the causes; `replay_campaign` excludes them from these, too.

    found : a diagnosis
    Raises InputError: MuJoCo is not installed; ConvergenceError: Ipopt finds no optimum, or the
    simulator no equilibrium.
    """
    case, robot = found.case, found.case.given
    m, _ = derive(case.m, ["progress", *(f"approach{i}" for i in range(1, robot.n + 1))])
    m = m.positions_alone()[case.inliers]
    numbered = replace(m, row=np.arange(len(m)))
    parts = numbered.split(REPLAY_SHARES)
    fitted = np.isin(numbered.row, parts["identify"].row)

    def with_causes() -> Robot:
        """Return the robot with the diagnosed causes, fitted again to the fitted poses."""
        return refit(case, found.effects(), found.noise, fitted).robot

    return Replay(m.source, robot.name, _stages(robot, m[fitted], parts["report"], found, with_causes), found)


def _stages(
    robot: Robot,
    fitted: Measurements,
    held_out: Measurements,
    found: Diagnosis,
    with_causes: Callable[[], Robot],
    show: Show = silent,
) -> tuple[ReplayedModel, ...]:
    """Return the replayed models: nominal, calibrated, and `with_causes()` if causes have effects.

    The first two are identified from `fitted`, the nominal one, which is rigid, in base and tool
    only; all are replayed at `held_out`.

    found : diagnosis that names the causes
    with_causes : function that returns the robot with them
    """
    show("calibrating")
    rigid = robot.with_values(dict.fromkeys(robot.parameters.select(["compliance"]), 0.0))
    placed = calibrated(prepare(rigid, fitted), ["placement"], loss="huber", screen=False)
    plain = calibrate_base_model(prepare(robot, fitted))
    stages = [replay(placed.robot, held_out, "nominal"), replay(plain.robot, held_out, "geometry and stiffness")]
    show("replaying")
    named = [c.label for c in found.causes if c.effects]
    if named:
        stages.append(replay(with_causes(), held_out, " and ".join(named)))
    return tuple(stages)


def replay_blocks(d: Diagnosis) -> Iterator[Block]:
    """Yield sentences, figure and table of a diagnosis' replay, or a sentence why there is none."""
    try:
        load_mujoco()
    except InputError:
        yield Words(
            "MuJoCo is not installed, so the poses were not driven again in it; it comes with the "
            "extra `mujoco`: pip install 'casadical[mujoco]'.",
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
        f"{len(last.errors)} poses driven again in MuJoCo with models whose values were identified "
        "from the others. Geometry, masses, springs and loops, and the causes that it has a "
        "counterpart of, are the engine's own; what the instrument does (a frame that drifts, say) "
        "is added to its point. As drawn, the robot misses the measured points by "
        f"{mm(first.accuracy.mean)} mm on average, as "
        f"{'diagnosed' if len(stages) > 2 else 'calibrated'} by {mm(last.accuracy.mean)} mm."
    )
    if lacking := replayed.stages[-1].lacking:
        yield Words(f"MuJoCo has no counterpart of {' and '.join(lacking)}: not in its model.", "warning")
    yield replay_figure(replayed, d.gap.floor)
    yield _table(replayed)


def _shown(replayed: Replay) -> tuple[ReplayedModel, ...]:
    """Return the models that are shown: not that with causes if it is `lacking` all of them."""
    last = replayed.stages[-1]
    causes = replayed.diagnosis.effects() if replayed.diagnosis else ()
    return replayed.stages[:2] if set(last.lacking) >= {e.label for e in causes} else replayed.stages


def replay_figure(replayed: Replay, floor: float) -> Figure:
    """Return the figure of each shown model's mean error [mm] with its 95 % interval.

    floor : mean error that noise alone would cause [m]
    """
    stages, names = _shown(replayed), stage_names(replayed)
    mean, noise = [1e3 * s.accuracy.mean for s in stages], 1e3 * floor
    low, high = 1e3 * np.transpose([s.interval for s in stages])
    ends = (0.7 * min(noise, *low), 1.1 * max(high))
    ticks = ticks_of_decades(*ends, steps=(1,) if ends[1] > 10 * ends[0] else (1, 2, 5))
    dots = Series(
        "points",
        mean,
        range(len(names)),
        size=11,
        colour=["grey", "grey", "blue"][: len(names)],
        less=mean - low,
        more=high - mean,
        facts=[list(row) for row in zip(names, low, high, strict=True)],
        tip="<b>%{customdata[0]}</b><br>%{x:.4f} mm, 95 %: %{customdata[1]:.4f} to %{customdata[2]:.4f}",
    )
    notes = [Note(f"{value:.3f} mm", end, k, gap=8) for k, (value, end) in enumerate(zip(mean, high, strict=True))]
    return Figure(
        "replay",
        "Poses replayed in MuJoCo",
        [dots],
        Axis("mean position error [mm]", ends, log=True, ticks=ticks),
        rows=[name.replace(" and ", "\nand ") for name in names],
        height=150 + 40 * len(names),
        caption="Nominal: the drawing, with base and tool fitted; calibrated: geometry and joint stiffness. "
        "Mean over poses that had no part in the values, with a 95 % interval, on a logarithmic axis: "
        "other poses than those of the gap. Noise alone: as there.",
        marks=[*notes, Rule("x", noise, "green", width=2, text=f"noise alone {noise:.3f} mm")],
        right=76,
    )


def stage_names(replayed: Replay) -> list[str]:
    """Return the names in figure and table of the models that are shown."""
    stages = _shown(replayed)[2:]
    without = (f", without {' and '.join(s.lacking)}" if s.lacking else "" for s in stages)
    return ["nominal, placed", "calibrated", *(f"with {s.name}{w}" for s, w in zip(stages, without, strict=True))]


def _table(replayed: Replay) -> Table:
    """Return the table of the shown models: position errors [mm] and maximum of `apart` [um]."""
    rows = []
    for name, s in zip(stage_names(replayed), _shown(replayed), strict=True):
        lengths = (s.accuracy.mean, s.accuracy.max, s.accuracy.rms, s.accuracy.p95)
        apart_um = 1e6 * float(s.apart.max())
        apart = f"{apart_um:.0f}" if apart_um > 10 else f"{apart_um:.2g}"
        rows.append((name, str(s.accuracy.n), *map(mm, lengths), apart))
    columns = ("model in MuJoCo", "n", "mean", "max", "rms", "95 %", "apart um")
    title = "Errors in mm; apart: largest distance between the engine's point and casadical's own"
    return Table(title, columns, rows, frozenset(range(1, 7)), frozenset({len(rows) - 1}))
