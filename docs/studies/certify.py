"""Write problems/*/certified.toml: `python docs/studies/certify.py [NAME...]`; tests/project holds these figures.

A certified figure is what casadical finds with the problem's own seed and methods, so a changed one means that the
program or the data changed: look why before you certify again. `git diff problems` shows what moved.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import tomlkit

from casadical import Calibration, calibrate

PROBLEMS = Path(__file__).parents[2] / "problems"
TOLERANCE_MM = 0.002  # what another machine's rounding and solver build may move


def figures(calibration: Calibration) -> dict[str, Any]:
    """Figures of a calibration by method and set, rounded to the last digit that is held."""
    found: dict[str, Any] = {}
    for method, result in calibration.identifications.items():
        found[method] = {
            "identified": len(result.names),
            "not_identifiable": [u.name for u in result.identifiability.held],
            "outliers": len(result.outliers),
        }
        for name, states in calibration.accuracies[method].items():
            a = states["calibrated"]
            found[method][name.replace("/", "_")] = {
                "n": a.n,
                "mean_mm": round(1e3 * a.mean, 4),
                "max_mm": round(1e3 * a.max, 4),
                "std_mm": round(1e3 * a.std, 4),
            }
    return found


def certified(calibration: Calibration) -> str:
    """The text of a problem's certified.toml."""
    document = tomlkit.document()
    document.add(
        tomlkit.comment("Position errors after calibration; made by docs/studies/certify.py, held by the tests.")
    )
    document.add("tolerance_mm", tomlkit.item(TOLERANCE_MM))
    for method, content in figures(calibration).items():
        document.add(method, tomlkit.item(content))
    return tomlkit.dumps(document)


def main(names: list[str]) -> None:
    for name in names or sorted(p.parent.name for p in PROBLEMS.glob("*/problem.toml")):
        text = certified(calibrate(PROBLEMS / name))
        (PROBLEMS / name / "certified.toml").write_text(text, encoding="utf-8")
        print(f"problems/{name}/certified.toml")


if __name__ == "__main__":
    main(sys.argv[1:])
