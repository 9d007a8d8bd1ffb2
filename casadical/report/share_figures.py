"""Where the gap lies, as dots with their intervals: by part of the robot, by direction, by part of the data."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd

from casadical.core.arrays import Array
from casadical.report.page import Drawing
from casadical.report.style import BLUE, GREY, MUTED, Figure, new_figure, plain

Values = Sequence[float] | Array | pd.Series
ROW = 26
TITLES = {
    "joints": "Gap by joint",
    "links": "Gap by link and frame",
    "directions": "Gap by direction",
    "regions": "Error by region",
    "payload": "Error by payload",
    "temperature": "Error by temperature",
    "time": "Error by time",
    "approach": "Error by approach",
}


def where_figure(name: str, table: pd.DataFrame) -> Figure:
    """A table of `Localisation` as a figure; name : of the table (joints, regions, ...)."""
    title = TITLES.get(name, f"Error by {name}")
    return _of_data(title, table) if "poses" in table else _of_parts(title, table)


def where_drawings(figures: Mapping[str, Figure]) -> Iterator[Drawing]:
    """Figures of where the gap lies, each with how to read it."""
    captions = {
        "joints": "Share of the gap that smooth errors of each joint would account for; all sum to 100 %.",
        "links": "The same for links, loop, base and tool frame.",
        "directions": "Each frame's three directions sum to 100 %, noise included; evenly spread would be 33 % each.",
        "regions": "Poses in thirds of each joint's readings, of the distance from joint 1 and of the height.",
    }
    for name, figure in figures.items():
        yield Drawing(f"where/{name}", figure, captions.get(name, ""))


def _of_parts(title: str, table: pd.DataFrame) -> Figure:
    """Shares of the squared gap; of directions, a colour for each frame."""
    by = table["frame"] if "frame" in table else pd.Series("", index=table.index)
    words = {"base": "base frame", "axis": "about joint 1", "tool": "tool frame"}
    labels = [f"{words.get(f, f)}: {p}" if f else str(p) for f, p in zip(by, table["part"], strict=True)]
    figure = intervals(title, "share of squared gap [%]", labels, 100 * table["share"], 100 * table["low"],
                   100 * table["high"], [f"{v:.3f} mm rms" for v in table["rms_mm"]], "%{x:.0f} %")  # fmt: skip
    return figure.update_xaxes(range=[0, max(50.0, min(104.0, 108 * float(table["high"].max())))])


def _of_data(title: str, table: pd.DataFrame) -> Figure:
    """Root mean square error of the poses in each part; the line is that of all poses."""
    labels = part_labels(table)
    notes = [
        f"{n} poses, {100 * s:.0f} % of the squared error" for n, s in zip(table["poses"], table["share"], strict=True)
    ]
    low, high = table["rms_low_mm"], table["rms_high_mm"]
    figure = intervals(title, "rms error [mm]", labels, table["rms_mm"], low, high, notes, "%{x:.3f} mm")
    first = table[table["by"] == table["by"].iloc[0]]
    every = float(((first["rms_mm"] ** 2 * first["poses"]).sum() / first["poses"].sum()) ** 0.5)
    figure.add_vline(x=every, line={"color": MUTED, "width": 1, "dash": "dot"})
    figure.add_annotation(
        text="all poses", x=every, y=1, yref="y domain", yanchor="bottom", showarrow=False,
        font={"size": 11, "color": MUTED},
    )  # fmt: skip
    return figure.update_xaxes(range=[0, 1.05 * float(table["rms_high_mm"].max())])


def part_labels(table: pd.DataFrame) -> list[str]:
    """How a reader calls the parts of the data; what they are divided by only where that differs."""
    parts = [str(p).replace("..", "to").replace("degC", "°C") for p in table["part"]]
    by = [str(b).replace("approach of joint", "joint") for b in table["by"]]
    return parts if len(set(by)) == 1 else [f"{b}: {p}" for b, p in zip(by, parts, strict=True)]


def intervals(
    title: str,
    x: str,
    labels: Sequence[str],
    value: Values,
    low: Values,
    high: Values,
    notes: Sequence[str],
    shown: str,
) -> Figure:
    """A row for each label: a dot with the interval low .. high; shown : the value in the tooltip, as plotly's %{x}."""
    figure = new_figure(title, x, height=118 + ROW * len(labels))
    places = list(range(len(labels)))
    figure.add_scatter(
        x=np.round(value, 5),
        y=places,
        mode="markers",
        marker={"size": 9, "color": [GREY if name.endswith("elsewhere") else BLUE for name in labels]},
        error_x={
            "type": "data",
            "symmetric": False,
            "array": np.maximum(np.subtract(high, value), 0).round(5),
            "arrayminus": np.maximum(np.subtract(value, low), 0).round(5),
            "color": GREY,
            "thickness": 2,
            "width": 0,
        },
        customdata=[[plain(n), lo, hi, plain(note)] for n, lo, hi, note in zip(labels, low, high, notes, strict=True)],
        hovertemplate=f"<b>%{{customdata[0]}}</b><br>{shown}, 95 %: %{{customdata[1]:.3g}} to "
        "%{customdata[2]:.3g}<br>%{customdata[3]}<extra></extra>",
        showlegend=False,
    )
    figure.update_yaxes(
        tickvals=places, ticktext=[plain(n) for n in labels], range=[len(labels) - 0.4, -0.6], showgrid=False
    )
    return figure
