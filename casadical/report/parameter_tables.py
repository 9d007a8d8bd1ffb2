"""Parameters with their intervals, those that cannot be told, and those that can hardly be told apart."""

from __future__ import annotations

from casadical.identification.identification import Identification
from casadical.report.calibration_text import PLACED, was_placed
from casadical.report.page import Block, Table, Words

STATUS = {"identified": "", "at bound": "AT BOUND", "not identifiable": "not identifiable", "held": "held"}


def parameter_table(result: Identification) -> Table:
    """Every parameter: nominal, value, standard error, 95 % interval, unit; bold at a bound, grey if held."""
    rows, strong, faint = [], set(), set()
    for k, r in enumerate(result.parameters.to_dict("records")):
        sure = r["std_error"] == r["std_error"]
        interval = (f"{r['std_error']:.2g}", f"{r['low']:.4f}", f"{r['high']:.4f}") if sure else ("", "", "")
        rows.append(
            (
                r["name"],
                r["group"],
                f"{r['nominal']:.4f}",
                f"{r['value']:.4f}",
                *interval,
                r["unit"],
                STATUS[r["status"]],
            )
        )
        if r["status"] == "at bound":
            strong.add(k)
        elif r["status"] != "identified":
            faint.add(k)
    columns = ("parameter", "group", "nominal", "value", "std error", "95 % low", "high", "unit", "")
    title = f"All parameters of {result.method}" + (f"; {PLACED}" if was_placed(result) else "")
    return Table(title, columns, rows, frozenset({2, 3, 4, 5, 6}), frozenset(strong), frozenset(faint), folded=True)


def confounded(result: Identification) -> Block:
    """What could not be identified, why, and with what it is confounded."""
    held = result.identifiability.held
    if not held:
        return Words("Every parameter could be identified.")
    rows = [(u.name, u.reason, ", ".join(u.confounded_with)) for u in held]
    return Table("Not identifiable, held at nominal", ("parameter", "why", "confounded with"), rows)


def correlated(result: Identification, most: int = 12) -> Block:
    """Pairs of estimates that are correlated above 0.95."""
    pairs = result.correlations()
    if not len(pairs):
        return Words("No two estimates are correlated by more than 0.95.")
    rows = [(a, b, f"{c:+.3f}") for a, b, c in pairs.head(most).itertuples(index=False)]
    title = "Hardly told apart: estimates correlated above 0.95" + (
        f" (the strongest {most} of {len(pairs)})" if len(pairs) > most else ""
    )
    return Table(title, ("parameter", "with", "correlation"), rows, frozenset({2}))
