"""Joint error curves and their lines, as rows and as plain data."""

from typing import Any

import numpy as np

from casadical.diagnosis.line_search import Line
from casadical.diagnosis.spectrum import JointCurve, Spectrum

COLUMNS = ("joint", "rms [urad]", "share", "lines: cycles a turn (amplitude in urad)")
# Lines of a joint, and suggestions, that are shown; JSON has them all.
MOST_SHOWN, MOST_SUGGESTED = 4, 3
# A curve is seen from so many standard errors on; a line of which more other frequencies explain as much has none.
CERTAIN, MOST_RIVALS = 2.0, 2


def curve_rows(s: Spectrum) -> list[tuple[str, str, str, str]]:
    """A row for each joint under `COLUMNS`, the greatest share first."""
    return [
        (str(c.joint), _size(c), f"{100 * c.share:.0f} %", lines_of(c))
        for c in sorted(s.joints, key=lambda c: -c.share)
    ]


def _size(c: JointCurve) -> str:
    """The curve's rms with its standard error; how large it may be where it is not seen."""
    rms, error = 1e6 * c.rms, 1e6 * c.rms_error
    return f"{rms:.0f} +- {error:.0f}" if seen(c) else f"< {rms + CERTAIN * error:.0f}"


def lines_of(c: JointCurve) -> str:
    """A joint's lines in words; where none stands out, what there is instead."""
    if not seen(c):
        return "nothing seen in these readings"
    if not c.lines:
        k = c.scan.strongest
        strongest = "" if k is None else f"; strongest near {c.scan.frequency[k]:.1f} ({1e6 * c.scan.amplitude[k]:.0f})"
        return f"no line stands out{strongest}, half of it from {c.middle[0]:.0f} to {c.middle[1]:.0f}"
    more = len(c.lines) - MOST_SHOWN
    return ", ".join(map(_line, c.lines[:MOST_SHOWN])) + (f" and {more} more" if more > 0 else "")


def seen(c: JointCurve) -> bool:
    """Whether the readings show anything of a joint's curve."""
    return bool(c.lines) or (c.lost > 0 and c.rms > CERTAIN * c.rms_error)


def _line(line: Line) -> str:
    size = f"({1e6 * line.amplitude:.0f} +- {1e6 * line.amplitude_error:.0f})"
    if len(line.rivals) > MOST_RIVALS:
        low, *_, high = sorted((line.frequency, *line.rivals))
        return f"one of {1 + len(line.rivals)} frequencies from {low:.1f} to {high:.1f} {size}"
    rivals = "".join(f" or {f:.1f}" for f in line.rivals)
    return f"{line.frequency:.{decimals_of(line)}f}{rivals}{_relation(line)} {size}"


def decimals_of(line: Line) -> int:
    return 2 if line.frequency_error < 0.05 else 1


def _relation(line: Line) -> str:
    if line.multiple_of is None:
        return ""
    return f" = {line.factor:.0f} x" if line.factor > 1 else f" = 1/{1 / line.factor:.0f}"


def as_json(s: Spectrum) -> dict[str, Any]:
    """Curves and lines as plain data; angles in degrees, errors in urad."""
    return {
        "harmonics": s.orders,
        "joints": [
            {
                "joint": c.joint,
                "rms_urad": _urad(c.rms),
                "rms_error_urad": _urad(c.rms_error),
                "share": round(c.share, 4),
                "log_evidence_lost": round(c.lost, 2),
                "covered_deg": [[round(float(np.rad2deg(v)), 1) for v in part] for part in covered_parts(c)],
                **_strongest(c),
                "middle_half_cycles": list(c.middle),
                "lines": [_line_as_json(line) for line in c.lines],
            }
            for c in s.joints
        ],
        "suggestions": list(s.suggestions),
    }


def _strongest(c: JointCurve) -> dict[str, float]:
    """The one sine that explains most, a line or not."""
    k = c.scan.strongest
    if k is None:
        return {}
    return {
        "strongest_cycles": round(float(c.scan.frequency[k]), 2),
        "strongest_urad": _urad(float(c.scan.amplitude[k])),
    }


def _line_as_json(line: Line) -> dict[str, Any]:
    return {
        "cycles": round(line.frequency, 3),
        "cycles_error": round(line.frequency_error, 3),
        "amplitude_urad": _urad(line.amplitude),
        "amplitude_error_urad": _urad(line.amplitude_error),
        "phase_deg": round(float(np.rad2deg(line.phase)), 1),
        "phase_error_deg": round(float(np.rad2deg(line.phase_error)), 1),
        "p": float(f"{line.p:.3g}"),
        "rivals": [round(f, 2) for f in line.rivals],
        **({} if line.multiple_of is None else {"multiple_of": round(line.multiple_of, 3), "factor": line.factor}),
    }


def covered_parts(c: JointCurve) -> list[tuple[float, float]]:
    """Stretches of a turn near which there are readings [rad]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], c.covered, [False]])))
    return [(float(c.angle[a]), float(c.angle[b - 1])) for a, b in edges.reshape(-1, 2)]


def _urad(value: float) -> float:
    return round(1e6 * value, 2)
