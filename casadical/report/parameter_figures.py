"""Difference of each parameter from its nominal value, with its interval."""

import numpy as np

from casadical.identification.result import Identification
from casadical.report.share_figures import intervals
from casadical.report.style import MUTED, RED, Figure, plain

KINDS = {"mm": ("lengths", "Lengths"), "deg": ("angles", "Angles"), "urad/(N m)": ("compliance", "Joint compliance")}


def parameter_figures(result: Identification) -> dict[str, Figure]:
    """Identified value less nominal with its 95 % interval, a figure for each unit; base and tool frames are left out.

    Their departures tell how the robot was set up, and are so much greater that they would hide the others.
    """
    table = result.shown
    table = table[table.status.isin(["identified", "at bound"]) & ~table.group.isin(["base", "tool"])]
    found = {}
    units = sorted(
        set(table["unit"]), key=lambda unit: (list(KINDS).index(unit) if unit in KINDS else len(KINDS), unit)
    )
    for unit in units:
        rows = table[table["unit"] == unit]
        name, words = KINDS.get(unit, (unit, f"Parameters in {unit}"))
        value, low, high = (np.nan_to_num((rows[c] - rows["nominal"]).to_numpy()) for c in ("value", "low", "high"))
        sure = rows["std_error"].notna().to_numpy()
        low, high = np.where(sure, low, value), np.where(sure, high, value)
        notes = [
            f"{r.nominal:.5g} -> {r.value:.6g} {unit}" + ("" if r.status == "identified" else ", AT BOUND")
            for r in rows.itertuples()
        ]
        figure = intervals(
            f"{words}: departure from nominal", f"value less nominal [{unit}]", list(rows["name"]), value.tolist(),
            low.tolist(), high.tolist(), notes, f"%{{x:+.4g}} {plain(unit)}",
        )  # fmt: skip
        colours = [RED if s == "at bound" else c for s, c in zip(rows.status, figure.data[0].marker.color, strict=True)]
        figure.data[0].marker.color = colours
        figure.update_xaxes(zeroline=True, zerolinewidth=1.5, zerolinecolor=MUTED)
        found[name] = figure
    return found
