"""The error table of a report, from the same figures that `casadical calibrate` prints."""

from __future__ import annotations

from collections.abc import Mapping

from casadical.identification.accuracy import Accuracy
from casadical.project.networks import Networks
from casadical.report.calibration_text import SetAccuracies
from casadical.report.page import Table
from casadical.report.style import mm

COLUMNS = ("model", "mean", "max", "std", "rms", "95 %")
NUMBERS = frozenset(range(1, len(COLUMNS)))
USES = {
    "identify": "used to identify",
    "train": "networks learn",
    "choose": "networks are judged",
    "report": "held out",
}


def figures(a: Accuracy) -> tuple[str, ...]:
    """Mean, max, std, rms, 95 % [mm]."""
    return tuple(mm(v) for v in (a.mean, a.max, a.std, a.rms, a.p95))


def error_tables(errors: Mapping[str, SetAccuracies], networks: Networks | None = None) -> list[Table]:
    """A table for each set, held-out poses first: errors before, and after every method and network."""
    last = list(errors.values())[-1]
    order = sorted(last, key=lambda name: not name.startswith("report"))
    return [_of_set(name, errors, networks) for name in order]


def _of_set(name: str, errors: Mapping[str, SetAccuracies], networks: Networks | None) -> Table:
    states = list(errors.values())[-1][name]
    rows = [
        ("before: as given", *figures(states["nominal"])),
        ("before: base and tool fitted", *figures(states["placed"])),
        *((f"after {method}", *figures(by_set[name]["calibrated"])) for method, by_set in errors.items()),
    ]
    strong = {len(rows) - 1}
    faint = {0}
    for result in networks.results.values() if networks else ():
        if result.compensator is None or name not in result.errors:
            continue
        # A refused network corrects nothing; its line would repeat that of SKCM.
        if result.helps:
            strong.add(len(rows))
            rows.append((f"after {result.method}", *figures(result.errors[name])))
    use = USES.get(name.split("/")[0], "")
    return Table(
        f"{name}: {states['nominal'].n} poses, {use}, errors in mm",
        COLUMNS,
        rows,
        NUMBERS,
        frozenset(strong),
        frozenset(faint),
    )


def network_table(networks: Networks) -> Table | None:
    """What each trained network does to the mean error, also where it was refused."""
    rows: list[tuple[str, ...]] = []
    strong: set[int] = set()
    for name, result in networks.results.items():
        c = result.compensator
        if c is None:
            continue
        if c.helps:
            strong.add(len(rows))
        pairs = (
            f"{mm(1e-3 * x.before.mean_mm)} → {mm(1e-3 * x.after.mean_mm)}" if x else "-"
            for x in (c.training, c.choice, c.validation)
        )
        trained, judged, report = pairs
        gain = f"{100 * c.choice.gain:+.1f} ± {100 * c.choice.gain_error:.1f} %"
        rows.append((name, "kept" if c.helps else "refused", trained, judged, gain, report))
    columns = ("network", "", "trained on", "judged on", "gain there", "report")
    return Table("Mean error without → with each network as trained, mm", columns, rows, frozenset({2, 3, 4, 5}),
                 frozenset(strong)) if rows else None  # fmt: skip
