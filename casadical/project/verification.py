"""Whether a calibrated robot still is as accurate as it was said to be, from a few poses measured later."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from casadical.core.arrays import Array
from casadical.core.blocks import Table, Words, mm
from casadical.core.errors import InputError
from casadical.identification.accuracy import errors
from casadical.identification.identification import LeftOut, identify, rows_in_words
from casadical.measurements.raw_table import read_table
from casadical.project.check.targets import recognised
from casadical.project.problem import read_campaign
from casadical.project.target_names import names_in
from casadical.robot.robot_file import read_robot

# A robot that keeps its promise is said to break it once in a hundred checks.
QUANTILE = 2.326
# A pose with more than so many times the promised error is named.
FAR = 4.0
# Of the length of a normally distributed error in three coordinates.
RMS_OF_MEAN = float(np.sqrt(3 * np.pi / 8))


@dataclass(frozen=True)
class Verification:
    """What a check says.

    promised : rms position error on held-out poses of the calibration [m]; found : now, base and tool fitted again, the
    fit's own share made up for [m]; limit : what `found` may be by chance [m]; n : poses; far : those far off
    lost : rows in which a cell is no number; without : `found` without the far ones, where it is not valid with them
    """

    robot: str
    promised: float
    found: float
    limit: float
    n: int
    far: tuple[LeftOut, ...]
    without: float | None = None
    lost: tuple[int, ...] = ()

    @property
    def valid(self) -> bool:
        """Whether the error still is what was promised."""
        return self.found <= self.limit

    def blocks(self) -> list[Words | Table]:
        """In words."""
        times = self.found / self.promised
        verdict = "STILL VALID" if self.valid else "NO LONGER VALID"
        text = (
            f"{verdict}: {mm(self.found)} mm rms on {self.n} poses, promised {mm(self.promised)} mm ({times:.2f} times)"
        )
        found = [
            Words(text, "verdict"),
            Words(
                f"Up to {mm(self.limit)} mm would be chance. Base and tool were fitted again; their share in the error "
                "is made up for."
            ),
        ]
        if self.far:
            text = f"Far off: {rows_in_words(self.far)}"
            if self.without is not None:
                text += f"; without them it is {mm(self.without)} mm{', as promised' * (self.without <= self.limit)}"
            found.append(Words(f"{text}. Measure these poses again first.", "warning"))
        if self.lost:
            listed = ", ".join(map(str, self.lost))
            found.append(Words(f"Left out, a cell is no number: row {listed}.", "warning"))
        if not self.valid and (self.without is None or self.without > self.limit):
            found.append(Words("Calibrate again, or ask casadical diagnose what changed.", "warning"))
        return list(found)

    def to_json(self) -> dict[str, Any]:
        """The same as plain data."""
        return {
            "robot": self.robot,
            "valid": self.valid,
            "promised_rms_mm": 1e3 * self.promised,
            "found_rms_mm": 1e3 * self.found,
            "limit_mm": 1e3 * self.limit,
            "poses": self.n,
            "without_far_mm": None if self.without is None else 1e3 * self.without,
            "left_out": list(self.lost),
            "far": [{"row": out.row, "error_mm": 1e3 * out.error} for out in self.far],
        }


def verify(robot: str | Path, table: str | Path, promised_mm: float | None = None) -> Verification:
    """Check a calibrated robot by poses that were measured later; base and tool are fitted again.

    robot : file as `casadical calibrate --out` writes it; table : measured positions
    promised_mm : rms position error [mm]; None: of the held-out poses, see `promised_rms`

    With `found` of 3 n - k degrees of freedom, k numbers of base and tool, its limit is the 99 % quantile of
    chi-squared (Wilson and Hilferty 1931). Raises InputError.
    """
    place = Path(robot)
    arm = read_robot(place)
    promised = 1e-3 * promised_mm if promised_mm is not None else promised_rms(place)
    m = read_campaign(place, table, arm, later=True)
    if arm.targets and not names_in(m):  # the tool is fitted again, whichever it was
        arm = replace(arm, targets=(), tool_name="")
    if (several := recognised(arm, m)) and several.turning:
        raise InputError(several.in_words(m.source))
    lost = tuple(row for row in read_table(table).line if row not in {*m.row.tolist(), *m.copies})
    if m.position is None:
        raise InputError(f"{table}: kind {m.kind}; a check needs measured positions")
    groups = [g for g in ("base", "tool") if g in arm.parameters.groups]
    k = len(arm.parameters.select(groups)) if groups else 0
    freedom = 3 * len(m) - k
    if freedom < 6:
        raise InputError(f"{table}: {len(m)} poses; base and tool have {k} numbers: measure {-(-(k + 6) // 3)} or more")
    placed = identify(arm, m, groups).robot if groups else arm
    e = errors(placed, m)
    found, limit = _scatter(e, k), _limit(promised, 3 * len(m) - k)
    far = [LeftOut(m.source, int(m.row[i]), float(e[i])) for i in np.argsort(-e) if e[i] > FAR * promised]
    without = None
    if found > limit and groups:  # a few gross errors draw base and tool, and so all others, towards themselves
        robust = identify(arm, m, groups, loss="huber")
        if 0 < len(robust.outliers) <= len(m) // 3:
            kept = robust.used[0]
            far, without = list(robust.left_out), _scatter(errors(robust.robot, kept), k)
    return Verification(arm.name, promised, found, limit, len(m), tuple(far[: len(m) // 3]), without, lost)


def _scatter(e: Array, k: int) -> float:
    """Rms of errors of which k numbers were fitted, the fit's own share made up for [m]."""
    return float(np.sqrt(3 * np.sum(e**2) / (3 * len(e) - k)))


def _limit(promised: float, freedom: int) -> float:
    """What `found` may be by chance [m]."""
    share = 1 - 2 / (9 * freedom) + QUANTILE * np.sqrt(2 / (9 * freedom))
    return float(promised * share**1.5)


def promised_rms(robot: Path) -> float:
    """Rms error of held-out poses [m] that the file beside METHOD.robot.toml or diagnosed.robot.toml states.

    Of result.json it is that of the report set, without poses that were far off; diagnosis.json and discovery.json
    state a mean, which is taken for that of normally distributed errors. Raises InputError.
    """
    for name, stated in (("diagnosed", "diagnosis"), ("discovered", "discovery")):
        if robot.name == f"{name}.robot.toml" and (mean := _mean_of(robot.parent / f"{stated}.json")) is not None:
            return RMS_OF_MEAN * 1e-3 * mean
    path = robot.parent / "result.json"
    remedy = "give the promised rms error with --promised-mm"
    try:
        methods = json.loads(path.read_text(encoding="utf-8"))["methods"]
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(f"{path}: no figures of a calibration; {remedy}") from None
    sets: Mapping[str, Any] = methods.get(robot.name.removesuffix(".robot.toml"), {}).get("sets", {})
    held = [figures for name, figures in sets.items() if name.split("/")[0] == "report"]
    if not held:
        raise InputError(f"{path}: no held-out poses of {robot.name}; {remedy}")
    return 1e-3 * float(held[0].get("without_far_off", held[0])["rms_mm"])


def _mean_of(path: Path) -> float | None:
    """Mean held-out error [mm] of the model that was kept, as a diagnosis or a discovery states it."""
    try:
        stated = json.loads(path.read_text(encoding="utf-8"))
        return float(stated["gap_mm"][stated.get("kept", "after")])
    except (OSError, ValueError, KeyError, TypeError):
        return None
