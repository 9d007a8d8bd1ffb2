"""Errors of held-out poses: `python docs/studies/picture.py` draws docs/images/held_out.png.

Every dot is a pose that the fit never saw, at its distance from the model before (base and tool fitted, nothing else)
and after calibration, for every real robot and, set apart, the synthetic HH800.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.offsetbox import AnnotationBbox, HPacker, TextArea
from matplotlib.patheffects import withStroke

from casadical import calibrate
from casadical.identification.accuracy import errors

ROOT = Path(__file__).parents[2]
ROWS = {
    "ur10_grid": "UR10, grid\nlaser tracker",
    "ur10_joints": "UR10, joint configurations\nlaser tracker",
    "ur10": "UR10, random poses\nlaser tracker",
    "ur5": "UR5, random poses\nlaser tracker",
    "wam": "Barrett WAM, random poses\nlaser tracker",
    "panda_1": "Panda 1\nball in sockets",
    "panda_3": "Panda 3\nball in sockets",
    "fr3_camera": "Franka Research 3\nhand camera",
    "hh800": "HH800, synthetic twin\nsimulated laser tracker",
}
BEFORE, AFTER, INK, SOFT, FAINT = "#b3ada2", "#0f766e", "#23262b", "#5c6068", "#e7e3da"
HALO = withStroke(linewidth=3, foreground="white")
SHOWN = 600  # dots of one cloud


def held_out(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Errors [mm] of the held-out poses before and after the problem's last method."""
    calibration = calibrate(ROOT / "problems" / name)
    result, poses = calibration.identification, calibration.problem.sets["report"][0]
    return 1e3 * errors(result.placed, poses), 1e3 * errors(result.robot, poses)


def cloud(axes: Axes, values: np.ndarray, height: float, colour: str, rng: np.random.Generator) -> None:
    """Poses as dots, as thick as they are dense, and their mean as a line with its figure."""
    logs = np.log10(values)
    middles, width = np.linspace(logs.min() - 0.1, logs.max() + 0.1, 300), 0.045
    density = np.exp(-0.5 * ((middles[:, None] - logs) / width) ** 2).sum(axis=1)
    shown = rng.choice(logs, min(SHOWN, len(logs)), replace=False)
    spread = 0.17 * np.interp(shown, middles, density / density.max())
    size, alpha = (6, 0.5) if len(shown) > 200 else (15, 0.75)
    y = height + spread * rng.uniform(-1, 1, len(shown))
    axes.scatter(10**shown, y, s=size, color=colour, alpha=alpha, linewidths=0)
    mean = values.mean()
    axes.plot([mean, mean], [height - 0.21, height + 0.21], color=INK, linewidth=1.5, solid_capstyle="round")
    label = f"{mean:.2f}" if mean < 10 else f"{mean:.1f}"
    axes.text(mean, height + 0.235, label, ha="center", va="bottom", fontsize=8.5, color=INK, path_effects=[HALO])


def main() -> None:
    rng = np.random.default_rng(0)
    plt.rcParams["font.family"] = "DejaVu Sans"
    figure, axes = plt.subplots(figsize=(9.6, 9.4), dpi=160)
    figure.subplots_adjust(left=0.235, right=0.97, top=0.89, bottom=0.067)
    step = 1.12
    heights = {name: -step * k - (0.35 if name == "hh800" else 0) for k, name in enumerate(ROWS)}
    for name, height in heights.items():
        before, after = held_out(name)
        cloud(axes, before, height + 0.24, BEFORE, rng)
        cloud(axes, after, height - 0.3, AFTER, rng)
        axes.text(-0.02, height - 0.03, ROWS[name], transform=axes.get_yaxis_transform(), ha="right", va="center",
                  fontsize=9.5, color=INK, linespacing=1.35)  # fmt: skip
    line = (heights["fr3_camera"] + heights["hh800"]) / 2
    axes.axhline(line, color="#cfc9bd", linewidth=0.8, linestyle=(0, (4, 4)))
    for y, word in ((heights["ur10_grid"] + 0.62, "REAL ROBOTS"), (line - 0.2, "SYNTHETIC")):
        axes.text(-0.279, y, word, transform=axes.get_yaxis_transform(), fontsize=7.5, color="#8d877c", va="center")
    axes.set_xscale("log")
    axes.set_xlim(0.03, 30)
    axes.set_ylim(min(heights.values()) - 0.7, 0.75)
    axes.set_xticks([0.03, 0.1, 0.3, 1, 3, 10, 30], ["0.03", "0.1", "0.3", "1", "3", "10", "30 mm"])
    axes.tick_params(axis="x", length=0, labelsize=9, colors=SOFT, pad=6)
    axes.minorticks_off()
    axes.grid(axis="x", color=FAINT, linewidth=0.9)
    axes.set_axisbelow(True)
    axes.set_yticks([])
    for side in axes.spines.values():
        side.set_visible(False)
    figure.text(0.03, 0.96, "Position error on poses that were held out", fontsize=15, fontweight="bold", color=INK)
    parts = [
        TextArea(text, textprops={"fontsize": 10.5, "color": colour, "fontweight": weight})
        for text, colour, weight in (
            ("before", "#8d877c", "bold"),
            (" (base and tool fitted) and ", SOFT, "normal"),
            ("after calibration", AFTER, "bold"),
            ("; a dot is a pose, a bar the mean", SOFT, "normal"),
        )
    ]
    packed = HPacker(children=parts, align="baseline", pad=0, sep=0)
    figure.add_artist(
        AnnotationBbox(packed, (0.03, 0.93), xycoords="figure fraction", frameon=False, box_alignment=(0, 0.5), pad=0)
    )
    figure.savefig(ROOT / "docs" / "images" / "held_out.png", facecolor="white")


if __name__ == "__main__":
    main()
