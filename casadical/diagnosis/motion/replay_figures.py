"""Figures of a replay: errors before and after over time, joint by joint and as a map, friction, hysteresis."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from casadical.core.arrays import Array
from casadical.core.telling.figure import Axis, Figure, Panel, Series

if TYPE_CHECKING:
    from casadical.diagnosis.motion.replay import Replay

# Points of a line, cells of a map over time, and parts of the speeds of a friction curve.
POINTS, CELLS, SPEEDS = 700, 120, 24
# Height of a panel [px]; a part of the speeds with fewer samples is not drawn.
PANEL, FEW = 200, 15


def replay_figures(replay: Replay) -> Iterator[Figure]:
    """Of the run whose readings were farthest from their commands, and the map of all runs."""
    run = max(range(len(replay.runs)), key=lambda k: float(np.nanmean(replay.left(k, before=True) ** 2)))
    yield _panels(
        replay, "replay/errors", f"{replay.runs[run].source}: reading less command, and less prediction", "time [s]",
        "mrad", lambda j, panel: _errors(replay, run, j, panel),
    )  # fmt: skip
    yield from _maps(replay)
    yield _panels(
        replay, "replay/friction", "Friction: what the servo gives beyond load and inertia, against speed",
        "speed [rad/s]", "N m", lambda j, panel: _friction(replay, j, panel),
    )  # fmt: skip
    yield _panels(
        replay, "replay/hysteresis", f"{replay.runs[run].source}: hysteresis, reading less command over the command",
        "command [rad]", "mrad", lambda j, panel: _loop(replay, run, j, panel),
    )  # fmt: skip


def _panels(replay: Replay, name: str, title: str, x: str, y: str, drawn: Callable[[int, int], list[Series]]) -> Figure:
    """A panel for each joint that moves, two in a row."""
    joints = [j for j in range(len(replay.before)) if replay.moves[j]]
    series = [s for panel, j in enumerate(joints) for s in drawn(j, panel)]
    panels = [
        Panel(k // 2 + 1, k % 2 + 1, replay.runs[0].joints[j], Axis(x if k >= len(joints) - 2 else ""), Axis(y))
        for k, j in enumerate(joints)
    ]
    return Figure(name, title, series, height=180 + PANEL * ((len(joints) + 1) // 2), panels=panels)


def _few(*columns: Array) -> list[Array]:
    every = max(1, len(columns[0]) // POINTS)
    return [column[::every].round(4) for column in columns]


def _errors(replay: Replay, run: int, j: int, panel: int) -> list[Series]:
    t = replay.runs[run].time - replay.runs[run].time[0]
    t, before, after = _few(t, *(1e3 * replay.left(run, before=b)[:, j] for b in (True, False)))
    return [
        Series("line", t, before, name="before: less command", colour="grey", width=1, listed=not panel, panel=panel),
        Series(
            "line", t, after, name="after: less prediction", colour="blue", width=1.4, listed=not panel, panel=panel
        ),
    ]


def _loop(replay: Replay, run: int, j: int, panel: int) -> list[Series]:
    log = replay.runs[run]
    assert log.command is not None
    own = log.command[:, j]
    c, read, said = _few(own, 1e3 * (log.position[:, j] - own), 1e3 * (replay.predicted[run][:, j] - own))
    return [
        Series("line", c, read, name="reading", colour="grey", width=1, listed=not panel, panel=panel),
        Series("line", c, said, name="prediction", colour="blue", width=1.4, listed=not panel, panel=panel),
    ]


def _friction(replay: Replay, j: int, panel: int) -> list[Series]:
    """Band from the 10 to the 90 per cent of the samples of each speed, and the law that was found."""
    v, torque = replay.friction_samples
    v, torque = v[:, j], torque[:, j]
    most = float(np.quantile(np.abs(v), 0.99)) + 1e-6
    edges = np.linspace(-most, most, SPEEDS + 1)
    parts = [torque[(v >= a) & (v < b)] for a, b in pairwise(edges)]
    kept = [k for k, part in enumerate(parts) if len(part) >= FEW]
    middle = (edges[1:] + edges[:-1])[kept] / 2
    low, high = (np.array([np.quantile(parts[k], share) for k in kept]) for share in (0.1, 0.9))
    r = replay.response
    ends = np.array([-most, -1e-9, 1e-9, most])
    law = r.friction[j] * np.sign(ends) + r.damping[j] * ends
    band = np.concatenate([middle, middle[::-1]]).round(4), np.concatenate([high, low[::-1]]).round(4)
    return [
        Series("area", *band, name="samples, 10 to 90 %", colour="grid", listed=not panel, panel=panel),
        Series("line", ends.round(4), law.round(4), name="found", colour="blue", listed=not panel, panel=panel),
    ]


def _maps(replay: Replay) -> Iterator[Figure]:
    """Rms of each joint over the time of all runs, before and after, on one scale."""
    time, cells = replay.by_time(CELLS)
    most = float(np.nanmax(cells[0])) * 1e3
    joints = replay.runs[0].joints
    for what, values in zip(("before", "after"), cells, strict=True):
        yield Figure(
            f"replay/map/{what}", f"Where and when the readings are off, {what} [mrad rms, one scale]",
            [Series("map", time.round(1), list(range(len(joints))), (1e3 * values.T).round(2), size=most)],
            x=Axis("time, run by run [s]"), rows=joints, height=90 + 28 * len(joints),
        )  # fmt: skip
