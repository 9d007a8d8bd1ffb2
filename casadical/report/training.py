"""Training of the networks: the loss of the best weights so far, step by step."""

import numpy as np

from casadical.project.networks import Networks
from casadical.report.style import Figure, log_ticks, new_figure, plain, style


def training_history(networks: Networks) -> Figure:
    """Loss on the training poses [mm^2] (paper, eq. 14) against the share of each training that is done, logarithmic.

    Steps of different trainers cost differently, so the axis is each one's own; the tooltip tells the step.
    """
    figure = new_figure(
        "Training history", "share of the training done [%]", "loss on the training poses [mm²]", height=380
    )
    for name, result in networks.results.items():
        history = np.array(result.compensator.history if result.compensator else (), dtype=float).reshape(-1, 2)
        if not len(history):
            continue
        colour, marker, dash = style(name)
        figure.add_scatter(
            x=100 * history[:, 0] / max(history[-1, 0], 1),
            y=history[:, 1],
            mode="lines+markers",
            name=f"{plain(name)}" + ("" if result.helps else ", refused"),
            line={"color": colour, "dash": dash, "width": 1.8},
            marker={"symbol": marker, "size": 5, "color": colour},
            customdata=history[:, 0],
            hovertemplate=f"<b>{plain(name)}</b><br>step %{{customdata:d}}: %{{y:.4g}} mm²<extra></extra>",
        )
    figure.update_xaxes(range=[-2, 102])
    return figure.update_yaxes(log_ticks())
