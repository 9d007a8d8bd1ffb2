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
from casadical.identification.identification import identify
from casadical.identification.result import LeftOut, rows_in_words
from casadical.identification.sessions import with_sessions
from casadical.measurements.kinds.registry import find_kind
from casadical.project.check.targets import recognised
from casadical.project.problem import read_campaign
from casadical.project.target_names import names_in
from casadical.robot.robot_file import read_robot

POSITION = "position"
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

    robot : file as `casadical calibrate --out` writes it; table : measured poses, of any kind
    promised_mm : rms error [mm] of this kind; None: of the held-out poses, see `promised_rms`

    With `found` of c n - k degrees of freedom, c numbers a pose (3 of a position), k those of base, tool and unknown
    points, its limit is the 99 % quantile of chi-squared (Wilson and Hilferty 1931). Base and tool may stand elsewhere
    in each session. Raises InputError.
    """
    place = Path(robot)
    arm = read_robot(place)
    m = read_campaign(place, table, arm, later=True, words=True)
    kind = m.kind if m.position is None else POSITION
    promised = 1e-3 * promised_mm if promised_mm is not None else promised_rms(place, kind)
    if arm.targets and not names_in(m):  # the tool is fitted again, whichever it was
        arm = replace(arm, targets=(), tool_name="")
    if (several := recognised(arm, m)) and several.turning:
        raise InputError(several.in_words(m.source))
    m = m.positions_alone() if m.position is not None else m
    arm, sessions = with_sessions(arm, [m])
    groups = [g for g in ("base", "tool", *sessions) if g in arm.parameters.groups]
    numbers = find_kind(m.kind).lengths
    points = 3 * len(set(find_kind(m.kind).point_names(m.arrays)))
    k = len(arm.parameters.select(groups)) if groups else 0
    freedom = numbers * len(m) - points - k
    if freedom < 6:
        raise InputError(
            f"{table}: {len(m)} poses; base and tool have {k} numbers{f', the points {points}' if points else ''}: "
            f"measure {-(-(k + points + 6) // numbers)} or more"
        )
    placed = arm
    if groups:
        fitted = identify(arm, m, groups)
        placed, k = fitted.robot, len(fitted.names)  # contacts do not tell where the base is
    e = errors(placed, m)
    shared = points + k
    found, limit = _scatter(e, k, numbers * len(m) - shared), _limit(promised, numbers * len(m) - shared)
    far = [LeftOut(m.source, int(m.row[i]), float(e[i])) for i in np.argsort(-e) if e[i] > FAR * promised]
    without = None
    if found > limit and groups:  # a few gross errors draw base and tool, and so all others, towards themselves
        robust = identify(arm, m, groups, loss="huber")
        if 0 < len(robust.outliers) <= len(m) // 3:
            kept = robust.used[0]
            far, without = list(robust.left_out), _scatter(errors(robust.robot, kept), k, numbers * len(kept) - shared)
    return Verification(arm.name, promised, found, limit, len(m), tuple(far[: len(m) // 3]), without, m.lost)


def _scatter(e: Array, k: int, freedom: int) -> float:
    """Rms of errors of which k numbers were fitted, the fit's own share made up for [m]; freedom : what is left."""
    return float(np.sqrt(np.mean(e**2) * (freedom + k) / freedom))


def _limit(promised: float, freedom: int) -> float:
    """What `found` may be by chance [m]."""
    share = 1 - 2 / (9 * freedom) + QUANTILE * np.sqrt(2 / (9 * freedom))
    return float(promised * share**1.5)


def promised_rms(robot: Path, kind: str = POSITION) -> float:
    """Rms error of held-out poses [m] that the file beside METHOD.robot.toml or diagnosed.robot.toml states.

    kind : of measurement; full poses are judged by their positions

    Of result.json it is that of the report set, without poses that were far off; diagnosis.json and discovery.json
    state a mean, which is taken for that of normally distributed errors. Raises InputError.
    """
    for name, stated in (("diagnosed", "diagnosis"), ("discovered", "discovery")):
        if robot.name == f"{name}.robot.toml" and (mean := _mean_of(robot.parent / f"{stated}.json")) is not None:
            return RMS_OF_MEAN * 1e-3 * mean
    path = robot.parent / "result.json"
    remedy = "give the promised rms error with --promised-mm"
    try:
        stated = json.loads(path.read_text(encoding="utf-8"))
        methods = stated["methods"]
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(f"{path}: no figures of a calibration; {remedy}") from None
    sets: Mapping[str, Any] = methods.get(robot.name.removesuffix(".robot.toml"), {}).get("sets", {})
    held = [
        figures
        for name, figures in sets.items()
        if name.split("/")[0] == "report" and stated.get("kinds", {}).get(name, kind) in _alike(kind)
    ]
    if not held:
        raise InputError(f"{path}: no held-out poses of {robot.name} (kind {kind}); {remedy}")
    return 1e-3 * float(held[0].get("without_far_off", held[0])["rms_mm"])


def _alike(kind: str) -> tuple[str, ...]:
    return (POSITION, "pose", "position_covariance") if kind == POSITION else (kind,)


def _mean_of(path: Path) -> float | None:
    """Mean held-out error [mm] of the model that was kept, as a diagnosis or a discovery states it."""
    try:
        stated = json.loads(path.read_text(encoding="utf-8"))
        return float(stated["gap_mm"][stated.get("kept", "after")])
    except (OSError, ValueError, KeyError, TypeError):
        return None
