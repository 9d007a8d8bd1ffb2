"""The errors left after a calibration: of every model at every pose, where they lie, and their figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from casadical.compensator.trainers.known import network_methods
from casadical.core.telling.figure import Axis, Figure, Series
from casadical.diagnosis.figures import where_figures
from casadical.diagnosis.linear_problem import make_case
from casadical.diagnosis.localisation import Localisation, localise_residual
from casadical.identification.accuracy import errors, residual_mm
from casadical.identification.figures import fit_figures, parameter_figures
from casadical.identification.pose_errors import (
    SETS,
    ModelErrors,
    PoseErrors,
    Style,
    error_distribution,
    errors_by_pose,
    workspace,
)
from casadical.identification.result import Identification, LeftOut, without_poses
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements
from casadical.measurements.noise import Noise
from casadical.project.networks import Networks
from casadical.project.problem import Problem
from casadical.robot.robot import Robot

BEFORE = "before"
# Of more poses than this, drawn at random, where the gap lies is told.
MOST_LOCATED = 5_000
# Colour, symbol and dash of networks, in the order of their trainers; those of many plug-ins share some.
NETWORK_STYLES: tuple[Style, ...] = (
    ("pink", "triangle-up", "dot"),
    ("green", "diamond", "solid"),
    ("sky", "triangle-down", "dashdot"),
    ("muted", "cross", "longdash"),
    ("red", "star", "dash"),
    ("pink", "hexagon", "longdashdot"),
    ("green", "triangle-left", "dashdot"),
)
_CAPTIONS = {
    "report": "No model saw these poses.",
    "identify": "Poses that identified the parameters; errors here are smaller than on new poses.",
    "train": "Poses that the networks learnt from.",
    "choose": "Poses by which the networks were kept or refused.",
}
_EACH = "Before: with base and tool fitted. Click a name in the legend to show or hide it."
_OUT = " Crosses: poses left out as outliers; no figure of this report counts them."
_REFUSED = " Refused networks are drawn as they were trained; they are not in use."
_SHARE = "The farther left, the better; grey lines at 50 and 95 %."
_SPACE = (
    "Turn it with the mouse; point at the dot that ends a vector for its error. Each line runs from the measured point "
    "in the direction of the error (measured less computed), longer than it by the factor in the legend."
)
_TRAINING = (
    "A low loss on the training poses alone is no proof: the poses that each network was judged on decide. Trainers "
    "that choose a penalty on the weights may end at a greater loss on purpose."
)
Identifications = Mapping[str, Identification]


def used_poses(problem: Problem, results: Identifications) -> dict[str, Measurements]:
    """Every set by name, without the poses that any method left out: all methods are judged on the same poses."""
    kept = iter(without_poses(problem.sets["identify"], {p for r in results.values() for p in r.outliers}))
    return {name: next(kept) if name.split("/")[0] == "identify" else m for name, m in problem.parts()}


def pose_errors(problem: Problem, results: Identifications, networks: Networks | None = None) -> dict[str, PoseErrors]:
    """For every set of a problem, report first: what placement, each method and each network leave at its poses.

    Of the poses by which all methods are judged. Refused networks are there as they were trained, and say so.
    """
    order, robot = list(SETS), list(results.values())[-1].robot
    told = {}
    whole, used = dict(problem.parts()), used_poses(problem, results)
    for name in sorted(used, key=lambda name: order.index(name.split("/")[0])):
        m, every = used[name], whole[name]
        out = ~np.isin(every.row, m.row)
        rows = zip(every.row[out], errors(robot, every)[out], strict=True)
        left_out = tuple(LeftOut(every.source, int(row), float(e)) for row, e in rows)
        models = tuple(_models(m, problem, results, networks))
        told[name] = PoseErrors(name, name.startswith("report"), m.row, m.q, m.position, models, m.source, left_out)
    return told


def _models(
    m: Measurements, problem: Problem, results: Identifications, networks: Networks | None
) -> Iterator[ModelErrors]:
    yield _errors_of(BEFORE, list(results.values())[-1].placed, m)
    for method, result in results.items():
        yield _errors_of(method, result.robot, m)
    paper = problem.paper
    published = {*paper.calibration, *paper.validation} if paper else set()
    for trained in networks.results.values() if networks else ():
        network = trained.compensator.trained if trained.compensator else None
        if network and m.position is not None:
            rest = 1e-3 * (residual_mm(results["SKCM"].robot, m) - network.output_mm(m.q))
            note, name = "" if trained.helps else "refused", trained.method
            length, shown = np.linalg.norm(rest, axis=1), trained.helps or trained.method in published
            yield ModelErrors(name, length, rest, note, shown, network_style(name))


def _errors_of(model: str, robot: Robot, m: Measurements) -> ModelErrors:
    vector = None if m.position is None else 1e-3 * residual_mm(robot, m)
    return ModelErrors(model, errors(robot, m), vector)


def network_style(method: str) -> Style:
    """Colour, symbol and dash of a network."""
    return NETWORK_STYLES[list(network_methods()).index(method) % len(NETWORK_STYLES)]


def where_left(result: Identification) -> Localisation | None:
    """Where the error that an identification left lies; None unless it is of one set of measured positions."""
    if len(result.measurements) != 1 or result.measurements[0].position is None:
        return None
    if len(m := result.measurements[0]) > MOST_LOCATED:
        # How a pose was approached, and when it was measured, follows from all of them.
        m, _ = derive(m, [*(f"approach{i}" for i in range(1, result.given.n + 1)), "progress"])
        some = (m[np.sort(np.random.default_rng(0).choice(len(m), MOST_LOCATED, replace=False))],)
        result = replace(result, measurements=some, outliers=(), problem=replace(result.problem, sets=some))
    return localise_residual(make_case(result, ()), Noise(result.sigmas[0][0], 0.0), np.zeros(0, dtype=np.int64))


def calibration_figures(
    problem: Problem, results: Identifications, networks: Networks | None, where: Localisation | None
) -> Iterator[Figure]:
    """Every figure of a calibration: what the data do not hold is not there; where : as of `where_left`.

    errors/SET and distribution/SET for each set of poses; workspace; where/TABLE as `Diagnosis.where` names them (of
    measured positions); parameters/lengths, /angles, /compliance; fit/residuals, /coverage, /pairs; training.
    """
    last, poses = list(results.values())[-1], pose_errors(problem, results, networks)
    trained = networks.results.values() if networks else ()
    more = _EACH + (_OUT if any(p.left_out for p in poses.values()) else "")
    more += _REFUSED if any(r.compensator and not r.helps for r in trained) else ""
    for name, of_set in poses.items():
        caption = f"{_CAPTIONS.get(name.split('/')[0], '')} {more}"
        yield errors_by_pose(of_set, f"errors/{name}", caption)
        yield error_distribution(of_set, f"distribution/{name}", _SHARE)
    spatial = next((p for p in poses.values() if p.position is not None), None)
    if spatial is not None:
        yield workspace(spatial, last.robot, _SPACE)
    if where:
        yield from where_figures(where)
    yield from parameter_figures(last)
    yield from fit_figures(last, {SETS.get(name, name): parts for name, parts in problem.sets.items()})
    if networks and any(r.compensator for r in trained):
        yield training_history(networks)


def training_history(networks: Networks) -> Figure:
    """Loss on the training poses [mm^2] (paper, eq. 14) against the share of each training that is done, logarithmic.

    Steps of different trainers cost differently, so the axis is each one's own; the tooltip tells the step.
    """
    series = []
    for name, result in networks.results.items():
        history = np.array(result.compensator.history if result.compensator else (), dtype=float).reshape(-1, 2)
        if len(history):
            colour, symbol, dash = network_style(name)
            share = 100 * history[:, 0] / max(history[-1, 0], 1)
            words, tip = name + ("" if result.helps else ", refused"), "step %{customdata:d}: %{y:.4g} mm²"
            series.append(
                Series(
                    "linked", share, history[:, 1], name=words, colour=colour, symbol=symbol, size=5, width=1.8,
                    dash=dash, facts=history[:, 0], tip=f"<b>{name}</b><br>{tip}",
                )
            )  # fmt: skip
    x, y = Axis("share of the training done [%]", (-2, 102)), Axis("loss on the training poses [mm²]", log=True)
    return Figure("training", "Training history", series, x, y, 380, _TRAINING)
