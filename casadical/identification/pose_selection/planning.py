"""The next poses to measure with the forecast beyond them, of positions, wires or sockets."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pandas as pd

from casadical.core.basics import Array, InputError, Show, silent
from casadical.core.files import json_text
from casadical.core.reporting.blocks import Block, Table
from casadical.core.reporting.plain import Key
from casadical.core.reporting.result import Result
from casadical.core.statistics import thirds
from casadical.effects import Effect, Session
from casadical.identification.identification import identify
from casadical.identification.pose_selection.candidates import Circumstances
from casadical.identification.pose_selection.instruments import Instrument, usual_places
from casadical.identification.pose_selection.pose_search import (
    Forecast,
    forecast,
    place_instrument,
    select_poses,
    select_with_places,
)
from casadical.identification.pose_selection.selection import Selection, travel
from casadical.identification.pose_selection.workspace import Workspace, read_workspace
from casadical.identification.prior import Prior
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements, Noise
from casadical.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class MeasurementPlan(Result):
    """Poses to measure, and the accuracy to expect of them and of additional ones.

    forecast : expected error against the number of poses
    selection : the poses in measuring order; None: there is the forecast alone
    target : required rms position error over the task [m]; None: none
    checked_for_obstacles : whether a workspace file limited the poses
    instrument : what is read in place of positions, with the chosen places
    noise : assumed noise; None: the default one
    """

    report: ClassVar[str] = "plan.j2"
    derived: ClassVar[tuple[Key, ...]] = (
        Key("poses", lambda plan: plan.selection and len(plan.selection), omit_none=True),
        Key("expected_error", "selection.accuracy", "mm", omit_none=True),
        Key("expected_reading", "selection.reading_error", "mm", omit_none=True),
        Key("forecast", lambda plan: plan.forecast.table.to_dict("list")),
        Key("wires", lambda plan: plan.places_of("wires"), omit_none=True),
        Key("sockets", lambda plan: plan.places_of("sockets"), omit_none=True),
    )

    forecast: Forecast
    selection: Selection | None = None
    target: float | None = None
    checked_for_obstacles: bool = False
    instrument: Instrument | None = None
    noise: Noise | None = None

    def blocks(self) -> list[Block]:
        """Return the measuring plan as text and tables."""
        plan, forecast = self.selection, self.forecast
        more: dict[str, Any] = {"shown": np.unique(np.linspace(0, len(forecast.poses) - 1, 6).astype(int))}
        if plan is not None:
            assert plan.m.position is not None
            height = ((plan.m.position - plan.robot.base.T[:3, 3]) @ plan.robot.base.T[:3, :3])[:, 2]
            more |= {"below": int((height < 0).sum()), "lowest": -height.min()}
            assert plan.task.position is not None
            local = (plan.task.position - plan.robot.base.T[:3, 3]) @ plan.robot.base.T[:3, :3]
            error = plan.expected_error()
            height, _ = thirds(local[:, 2])
            distance, _ = thirds(np.hypot(local[:, 0], local[:, 1]))
            rows = []
            for k, name in ((2, "high"), (1, "middle"), (0, "low")):
                cells = [error[(height == k) & (distance == i)] for i in range(3)]
                rows.append((name, *(f"{1e3 * np.sqrt(np.mean(c**2)):.4f}" if len(c) else "-" for c in cells)))
            more |= {
                "travel": np.rad2deg(travel(plan.robot, plan.q)),
                "tables": [
                    *_errors(plan, True),
                    Table("Expected error [mm]", ("point", "near", "middle", "far"), rows, frozenset({1, 2, 3})),
                    *_errors(plan, False),
                ],
            }
        return self._report_blocks(**more)

    def places_of(self, kind: str) -> list[list[float]] | None:
        """Return the places of the instrument in the measuring frame, n lists of 3 numbers [mm].

        None is returned for an instrument of another kind, or none.

        kind : "wires" or "sockets"
        """
        if self.instrument is None or self.instrument.kind != kind:
            return None
        places: list[list[float]] = (1e3 * self.instrument.places).round(3).tolist()
        return places

    def files(self, folder: str | Path) -> dict[Path, str]:
        """Return the texts of the plan's files by path: poses, standard errors, error map, data.

        They are FILE.csv, FILE.expected.csv, FILE.map.csv and FILE.json, with wires or sockets also
        FILE.places.csv. A forecast alone has FILE.csv with its table.

        folder : path of FILE.csv, or a folder, in which FILE is "plan"; nothing is written
        """
        plan, path = self.selection, Path(folder)
        path = path if path.suffix else path / "plan.csv"
        if plan is None:
            return {path: self.forecast.table.to_csv(index=False, float_format="%.6g")}
        texts = {
            path: plan.table.to_csv(index=False, float_format="%.10g"),
            path.with_suffix(".expected.csv"): plan.parameters.to_csv(index=False, float_format="%.6g"),
            path.with_suffix(".map.csv"): plan.error_map.to_csv(index=False, float_format="%.6g"),
            path.with_suffix(".json"): json_text(self.to_json()),
        }
        if self.instrument is not None:
            where = pd.DataFrame((1e3 * self.instrument.places).round(1), columns=["x_mm", "y_mm", "z_mm"])
            texts[path.with_suffix(".places.csv")] = where.to_csv(index=False, float_format="%.6g")
        return texts


def _errors(plan: Selection, of_effects: bool) -> list[Table]:
    """Return one table of expected standard errors, or reasons where there are none; or [].

    of_effects : whether the parameters are those of effects, or all others
    """
    pairs = zip((plan.robot.parameters[name] for name in plan.names), plan.standard_errors, strict=True)
    rows = [(p.name, f"{p.readable(error):.3g}", p.readable_unit) for p, error in pairs]
    rows += [(name, "-", f"not identifiable: {why}") for name, why in plan.unidentifiable.items()]
    rows = [row for row in rows if row[0] in plan.robot.shown and ("." in row[0]) == of_effects]
    title = f"Expected standard errors{' of effects' if of_effects else ''}"
    return [Table(title, ("parameter", "std error", "unit"), rows, frozenset({1}))] if rows else []


@dataclass(frozen=True, eq=False)
class Places:
    """Draw wires or sockets to plan for: their number, and where they may be.

    kind : wires (distances to anchors) or sockets (touched points)
    count : number of places to choose
    candidates : candidate places in the measuring frame, shape (K, 3) [m]; None: the usual ones
        (see `usual_places`)
    surveyed : whether the places will be measured, too
    """

    kind: Literal["wires", "sockets"]
    count: int
    candidates: Array | None = None
    surveyed: bool = False

    def candidates_for(self, robot: Robot) -> Array:
        """Return the candidate places in the measuring frame, shape (K, 3) [m]."""
        return usual_places(robot, self.kind) if self.candidates is None else self.candidates


def plan(
    robot: Robot,
    n: int | None,
    effects: Sequence[Effect] = (),
    *,
    workspace: Workspace | None = None,
    circumstances: Circumstances | None = None,
    measured: Measurements | None = None,
    noise: Noise | None = None,
    min_distance: float = 0.0,
    order: bool = True,
    target: float | None = None,
    seed: int = 0,
    places: Places | None = None,
    prior: Prior | None = None,
    show: Show = silent,
) -> MeasurementPlan:
    """Return the next poses to measure, in order, and the forecast of the accuracy beyond them.

    robot : robot whose parameters are to be identified
    n : number of poses; None: the stopping rule alone, the accuracy to expect of up to 100 poses
        more
    effects : effects to identify, in addition to the accuracy over the task
    measured : poses measured already
    order : whether the poses are ordered for little travel
    target : wanted accuracy [m]
    places : wires or sockets, in place of positions
    prior : prior of the robot, which has its values (see `carry_over`)
    show : called with each line of progress

    Other arguments are as of `select_poses`. Raises InputError.
    """
    if places is not None and measured is not None:
        raise InputError(
            f"poses measured before are counted with positions alone, not with {places.kind}: plan "
            "with the robot file that calibrate --out wrote"
        )
    more = [e for e in effects if e.label not in {own.label for own in robot.effects}]
    robot = robot.with_effect(*more) if more else robot
    # The robot's other effects are fixed at their values.
    free = ("kinematic", "compliance", *dict.fromkeys(e.label for e in effects), *(prior.free if prior else ()))
    if measured is not None:
        show("calibrating with the poses measured so far")
        measured, missing = derive(measured, robot.conditions, robot.loads)
        if lost := [name for name in missing if name != "payload_kg"]:
            raise InputError(f"{measured.source}: column {lost[0]!r} is missing, which the effects to plan for need")
        result = identify(robot, measured, free, prior=prior)  # of the last session, if several
        robot, noise = result.robot, noise or Noise(result.sigmas[0][0])
        free = (*free, *(e.label for e in robot.effects if isinstance(e, Session)))
    # Poses are planned for the first target alone.
    others = [] if measured is None else [t.column for t in robot.targets if t.column in measured.conditions]
    if measured is not None and others:
        first = ~measured.condition_matrix(others, np.zeros(len(others))).any(axis=1)
        measured = measured[np.flatnonzero(first)] if first.any() else None
    robot = replace(robot, targets=(), tool_name="")
    circumstances = circumstances or Circumstances()
    # If effects are to be identified, payloads that were mounted before can be mounted again.
    mounted = np.unique(measured.conditions["payload_kg"]) if measured and "payload_kg" in measured.conditions else ()
    if effects and len(mounted) > 1 and not circumstances.payloads:
        circumstances = replace(circumstances, payloads=tuple(mounted))
    common: dict[str, Any] = {"workspace": workspace, "free": free, "noise": noise, "seed": seed}
    known: dict[str, Any] = {"circumstances": circumstances, "measured": measured, "prior": prior}
    at: dict[str, Any] = {}
    if places is not None:
        at = {"kind": places.kind, "count": places.count, "surveyed": places.surveyed}
        at["places"] = places.candidates_for(robot)
    chosen = instrument = None
    if n is not None:
        show("choosing poses")
        how = {"n": n, "interest": [e.label for e in effects], "min_distance": min_distance, **common, **known}
        chosen = select_with_places(robot, **at, **how) if at else select_poses(robot, None, **how)
        chosen = chosen.ordered() if order else chosen
        instrument = chosen.instrument
    elif at:
        instrument = place_instrument(robot, **at, **common)
    show("accuracy of further poses")
    total = (0 if measured is None else len(measured)) + (0 if chosen is None else len(chosen))
    most = total + (100 if n is None else max(20, total // 2))
    ahead = forecast(robot, most, instrument=instrument, **common, **known)
    return MeasurementPlan(ahead, chosen, target, workspace is not None, instrument, noise or Noise())


def poses_of_changes(
    robot: Robot, n: int, prior: Prior, noise: Noise, room: Path | None, measured: Measurements | None, seed: int
) -> pd.DataFrame:
    """Return the poses that determine best how a calibrated robot has changed, a row each.

    n : number of poses to choose, in addition to the measured ones
    prior : of the parameters that may change, about the robot's values
    room : file of a workspace, None without one
    measured : poses of the same day, whose information is taken into account
    Raises InputError where the workspace allows too few poses.
    """
    known: dict[str, Any] = {"measured": measured, "free": prior.free, "prior": prior}
    known |= {"workspace": read_workspace(room, robot) if room else None, "seed": seed}
    return select_poses(robot, None, n, min_distance=0.05, noise=noise, **known).table
