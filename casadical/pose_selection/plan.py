"""A measuring plan: poses to measure with the expected accuracy, as text, data and files."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from casadical.core.files import json_text
from casadical.core.reporting.blocks import Block, Table
from casadical.core.reporting.plain import Key
from casadical.core.reporting.result import Result
from casadical.core.statistics import thirds
from casadical.measurements.measurements import Noise
from casadical.pose_selection.instruments import Instrument
from casadical.pose_selection.pose_search import Forecast
from casadical.pose_selection.selection import Selection, travel


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
            more |= {
                "travel": np.rad2deg(travel(plan.robot, plan.q)),
                "tables": [*_errors(plan, True), _map(plan), *_errors(plan, False)],
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


def _map(plan: Selection) -> Table:
    """Return the table of expected rms errors [mm] by thirds of height and of distance.

    Both are of the task's points in the robot's base frame; the distance is from its z axis.
    """
    assert plan.task.position is not None
    local = (plan.task.position - plan.robot.base.T[:3, 3]) @ plan.robot.base.T[:3, :3]
    error = plan.expected_error()
    height, _ = thirds(local[:, 2])
    distance, _ = thirds(np.hypot(local[:, 0], local[:, 1]))
    rows = []
    for k, name in ((2, "high"), (1, "middle"), (0, "low")):
        cells = [error[(height == k) & (distance == i)] for i in range(3)]
        rows.append((name, *(f"{1e3 * np.sqrt(np.mean(c**2)):.4f}" if len(c) else "-" for c in cells)))
    return Table("Expected error [mm]", ("point", "near", "middle", "far"), rows, frozenset({1, 2, 3}))


def _errors(plan: Selection, of_effects: bool) -> list[Table]:
    """Return one table of expected standard errors, or reasons where there are none; or [].

    of_effects : whether the parameters are those of effects, or all others
    """
    pairs = zip((plan.robot.parameters[name] for name in plan.names), plan.standard_errors, strict=True)
    rows = [(p.name, f"{p.readable(error):.3g}", p.readable_unit) for p, error in pairs]
    rows += [(u.name, "-", f"not identifiable: {u.reason}") for u in plan.unidentifiable]
    rows = [row for row in rows if row[0] in plan.robot.shown and ("." in row[0]) == of_effects]
    title = f"Expected standard errors{' of effects' if of_effects else ''}"
    return [Table(title, ("parameter", "std error", "unit"), rows, frozenset({1}))] if rows else []
