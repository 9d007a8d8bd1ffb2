"""Faults of the instrument that wrote a joint log: its clock, lost or repeated samples, a current without sign."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from casadical.diagnosis.motion.arm import Arm
from casadical.measurements.logs.log import JointLog

# A rate that is off by this share; shares of samples that are lost or repeated which every log has.
CLOCK, USUAL_LOST, USUAL_REPEATED = 0.01, 0.01, 0.02
# A gap is longer than so many steps; a joint moves by more than so many quanta a step.
GAP, MOVES = 1.6, 3.0


@dataclass(frozen=True)
class Fault:
    """A fault of the instrument. name : by which answers name it; sentence : what was found; remedy : what to do"""

    name: str
    sentence: str
    remedy: str


def faults_of(log: JointLog, arm: Arm, reference: JointLog | None) -> Iterator[Fault]:
    """What is wrong with the log itself."""
    rate = arm.log_rate or (1 / reference.step if reference else None)
    if rate and abs((factor := log.step * rate) - 1) > CLOCK:
        yield Fault(
            "clock_scale",
            f"the clock of the log runs wrong by a factor of {factor:.3f} ({1 / log.step:.4g} rows a second, "
            f"{rate:.4g} are known)",
            f"Divide time_s by {factor:.3f}, or state the true rate as log_rate_Hz in [drive].",
        )
    steps = np.diff(log.time)[np.diff(log.run) == 0] / max(log.step, 1e-12)
    lost = float(np.round(steps[steps > GAP] - 1).sum() / max(steps.sum(), 1.0))
    repeated = _repeated_share(log)
    if lost > USUAL_LOST or repeated > USUAL_REPEATED:
        yield Fault(
            "lost_samples",
            f"samples are missing ({100 * lost:.1f} %) or repeated ({100 * repeated:.1f} %)",
            "Log over a wired link, at a rate that the link carries; rows that are missing are interpolated here.",
        )
    if log.signs_lost:
        yield Fault(
            "unsigned_current",
            f"the {log.signs_lost} is logged without its sign",
            "Until it has one, friction and load are told by the response to commands.",
        )


def _repeated_share(log: JointLog) -> float:
    """Share of the rows in which all joints read as before although some move by many quanta a step around them."""
    step = np.abs(np.diff(log.position, axis=0))
    step[np.diff(log.run) != 0] = np.nan
    smallest = np.where(step > 0, step, np.inf).min(axis=0)
    usual = np.array([np.convolve(np.nan_to_num(column), np.ones(9) / 9, "same") for column in step.T]).T
    moving = (usual > MOVES * np.where(np.isfinite(smallest), smallest, np.inf)).any(axis=1)
    same = (step == 0).all(axis=1)
    return float((same & moving).sum() / moving.sum()) if moving.sum() >= 10 else 0.0
