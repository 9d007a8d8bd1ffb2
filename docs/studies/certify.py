"""Write problems/*/certified.toml: `python docs/studies/certify.py [NAME...]`; tests/project holds these figures.

A certified figure is what casadical finds with the problem's own seed and methods, so a changed one means that the
program or the data changed: look why before you certify again. `git diff problems` shows what moved.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from casadical import Calibration, Problem, calibrate, diagnose
from casadical.identification.accuracy import errors
from casadical.measurements.logs.findings import quantum
from casadical.project.diagnosis import read_logs
from casadical.project.problem_file import problem_file

PROBLEMS = Path(__file__).parents[2] / "problems"
TOLERANCE_MM = 0.002  # what another machine's rounding and solver build may move
# Robots whose joints' own error curves are certified as well, learnt from so many poses.
CURVE, WITH_CURVES, POSES = "joint_error_curve", ("ur5", "ur10", "ur10_grid", "ur10_joints"), 150


def figures(calibration: Calibration) -> dict[str, Any]:
    """Figures of a calibration by method and set, rounded to the last digit that is held."""
    found: dict[str, Any] = {}
    for method, result in calibration.identifications.items():
        found[method] = {
            "identified": len(result.names),
            "not_identifiable": [*result.identifiability.unidentifiable],
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
    name = calibration.problem.folder.name
    return found | ({CURVE: curves(calibration.problem)} if name in WITH_CURVES else {})


def curves(problem: Problem) -> dict[str, Any]:
    """Figures with each joint's error curve, learnt from some poses, on those of the report.

    The curve is the only cause asked for, since a draw of poses has no order from which others would follow.
    """
    ((given,), (report,)) = (problem.sets[name] for name in ("identify", "report"))
    draw = np.random.default_rng(problem.seed).permutation(len(given))[:POSES]
    found = diagnose(problem.robot, given[np.sort(draw)], [CURVE])
    before, after = (1e3 * errors(r, report) for r in (found.identification.robot, found.apply()))
    return {
        "poses": POSES,
        "causes": [c.label for c in found.causes],
        "report": {
            "n": len(report),
            "calibrated_mm": round(float(before.mean()), 4),
            "mean_mm": round(float(after.mean()), 4),
            "max_mm": round(float(after.max()), 4),
        },
    }


def figures_of_logs(folder: Path) -> dict[str, Any]:
    """Figures of joint logs by set: what they are, and how far readings are from commands, joint by joint."""
    found: dict[str, Any] = {}
    campaign = read_logs(folder)
    assert campaign is not None
    for name, paths in (("identify", campaign.logs), ("report", campaign.withheld)):
        logs = [campaign.log(path) for path in paths]
        far = np.concatenate([log.position - log.command for log in logs])
        found[name] = {
            "logs": len(logs),
            "rows": sum(map(len, logs)),
            "seconds": round(float(sum(log.time[-1] - log.time[0] for log in logs)), 2),
            "rate_Hz": round(1 / float(np.median([log.step for log in logs])), 3),
            "quantum_mrad": round(1e3 * float(np.median([quantum(log.position[:, 1]) for log in logs])), 4),
            "rms_mrad": [round(1e3 * float(v), 3) for v in np.sqrt((far**2).mean(axis=0))],
        }
    return found


def certified(comment: str, content: dict[str, Any]) -> str:
    """The text of a problem's certified.toml."""
    document = tomlkit.document()
    document.add(tomlkit.comment(f"{comment}; made by docs/studies/certify.py, held by the tests."))
    for name, value in content.items():
        document.add(name, tomlkit.item(value))
    return tomlkit.dumps(document)


def main(names: list[str]) -> None:
    for name in names or sorted(p.parent.name for p in PROBLEMS.glob("*/problem.toml")):
        if problem_file(PROBLEMS / name).logs:
            text = certified("Joint logs, readings less commands", figures_of_logs(PROBLEMS / name))
        else:
            found = {"tolerance_mm": TOLERANCE_MM, **figures(calibrate(PROBLEMS / name))}
            text = certified("Position errors after calibration", found)
        (PROBLEMS / name / "certified.toml").write_text(text, encoding="utf-8")
        print(f"problems/{name}/certified.toml")


if __name__ == "__main__":
    main(sys.argv[1:])
