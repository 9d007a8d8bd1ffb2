"""What is odd about the clock of a table: it goes back, or jumps; what follows time is then judged by a wrong order."""

from __future__ import annotations

import numpy as np

from casadical.measurements.measurements import Measurements

COLUMN = "time_s"
# A clock was set where it jumps by more than a week [s] and by so many times the usual step.
LONG, TIMES = 7 * 86400.0, 100.0
# Where more of the steps go back, the rows are not in the order of measuring.
SHUFFLED = 0.1


def clock_faults(m: Measurements) -> tuple[str, ...]:
    """Sentences about `time_s`, each with rows and values; none without that column, or for rows in another order."""
    if COLUMN not in m.conditions or len(m) < 3:
        return ()
    time, row = m.conditions[COLUMN], m.row
    by_row = np.argsort(row, kind="stable")
    time, row = time[by_row], row[by_row]
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0)
    if len(back) > max(1, SHUFFLED * len(steps)):
        return ()
    usual = float(np.median(np.abs(steps)))
    far = np.flatnonzero(steps > max(LONG, TIMES * usual))
    said = []
    for at, what in ((back, "goes back"), (far, "jumps")):
        if len(at):
            where = ", ".join(f"from {time[k]:.10g} to {time[k + 1]:.10g} s at row {row[k + 1]}" for k in at[:3])
            more = f" and {len(at) - 3} times more" if len(at) > 3 else ""
            said.append(
                f"{m.source}: {COLUMN} {what} {where}{more}: a clock was set or started again; correct the column or "
                "leave it out, else what follows time or temperature is judged by it"
            )
    return tuple(said)
