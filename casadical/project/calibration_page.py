"""The HTML report of a calibration: sentences, tables and figures, as a reader asks for them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from casadical.compensator.trainers.registry import network_methods
from casadical.core.reporting.blocks import Block, Page, Section, Tile, Words, figures_named, mm
from casadical.core.reporting.figure import Axis, Figure, Series
from casadical.identification.accuracy import errors, residual_mm
from casadical.identification.figures import fit_figures, fit_quality, parameter_figures, parameter_tables
from casadical.identification.pose_errors import (
    SET_TITLES,
    ModelErrors,
    PoseErrors,
    Style,
    error_distribution,
    errors_by_pose,
    image_plane,
    workspace,
)
from casadical.identification.result import Identification, LeftOut
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements, Noise
from casadical.project import outcome
from casadical.project.networks import Networks
from casadical.project.problem import Problem
from casadical.robot.robot import Robot

if TYPE_CHECKING:  # diagnoses take a third of the time of all imports
    from casadical.diagnosis.localisation import Localisation

# Maximum number of poses that localise the residual error; of more, a random draw is taken.
MAX_LOCALISED_POSES = 5_000
# Styles (colour, symbol, dash) of the network methods in figures, in the order of their trainers;
# they repeat if there are many plug-ins.
NETWORK_STYLES: tuple[Style, ...] = (
    ("pink", "triangle-up", "dot"),
    ("green", "diamond", "solid"),
    ("sky", "triangle-down", "dashdot"),
    ("muted", "cross", "longdash"),
    ("red", "star", "dash"),
    ("pink", "hexagon", "longdashdot"),
    ("green", "triangle-left", "dashdot"),
)
# Method -> its identification.
Identifications = Mapping[str, Identification]


def pose_errors(problem: Problem, results: Identifications, networks: Networks | None = None) -> dict[str, PoseErrors]:
    """Return set -> its errors before (base and tool fitted), by each method and each network.

    The poses are those on which all methods are judged; outliers are listed apart. Refused networks
    are included as they were trained, marked as refused.

    results : identifications by method
    """
    order, robot = list(SET_TITLES), list(results.values())[-1].robot
    by_name = {}
    whole, used = dict(problem.parts()), problem.used_poses(results)
    for name in sorted(used, key=lambda name: order.index(name.split("/")[0])):
        m, every = used[name], whole[name]
        out = np.flatnonzero(~np.isin(every.row, m.row))
        left_out = tuple(LeftOut(every.source, int(every.row[k]), float(errors(robot, every)[k])) for k in out)
        models = tuple(_models(m, problem, results, networks))
        by_name[name] = PoseErrors(name, name.startswith("report"), m.row, m.q, m.position, models, m.source, left_out)
    return by_name


def _models(
    m: Measurements, problem: Problem, results: Identifications, networks: Networks | None
) -> Iterator[ModelErrors]:
    """Yield the errors at the poses m: nominal robot, base and tool fitted; methods; networks."""
    yield _errors_of("before", list(results.values())[-1].placed, m)
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
    """Return one robot's errors at the poses m, with vectors where positions were measured."""
    vector = None if m.position is None else 1e-3 * residual_mm(robot, m)
    return ModelErrors(model, errors(robot, m), vector)


def network_style(method: str) -> Style:
    """Return colour, symbol and dash of a network method."""
    return NETWORK_STYLES[list(network_methods()).index(method) % len(NETWORK_STYLES)]


def residual_localisation(result: Identification) -> Localisation | None:
    """Return the residual error's localisation; None unless one table of positions was fitted."""
    from casadical.diagnosis.linear_problem import make_case
    from casadical.diagnosis.localisation import localise_residual

    if len(result.measurements) != 1 or result.measurements[0].position is None:
        return None
    if len(m := result.measurements[0]) > MAX_LOCALISED_POSES:
        # Direction of approach and progress are derived from all poses, so before the draw.
        m, _ = derive(m, [*(f"approach{i}" for i in range(1, result.given.n + 1)), "progress"])
        some = (m[np.sort(np.random.default_rng(0).choice(len(m), MAX_LOCALISED_POSES, replace=False))],)
        result = replace(result, measurements=some, outliers=(), problem=replace(result.problem, sets=some))
    return localise_residual(make_case(result, ()), Noise(result.sigmas[0][0], 0.0), np.zeros(0, dtype=np.int64))


def calibration_figures(
    problem: Problem, results: Identifications, networks: Networks | None, where: Localisation | None
) -> Iterator[Figure]:
    """Yield every figure of a calibration for which there are data.

    where : localisation of the residual, as of `residual_localisation`

    The figures are errors/SET and distribution/SET for each set of poses; workspace;
    image, of a camera's poses; where/TABLE, of measured positions (see `where_figures`);
    parameters/lengths, /angles, /compliance; fit/residuals, /coverage, /pairs; training.
    """
    last, poses = list(results.values())[-1], pose_errors(problem, results, networks)
    trained = networks.results.values() if networks else ()
    legend_caption = "Before: with base and tool fitted. Click a name in the legend to show or hide it."
    outlier_caption = " Crosses: poses left out as outliers; no figure of this report counts them."
    more = legend_caption + (outlier_caption if any(p.left_out for p in poses.values()) else "")
    refused_caption = " Refused networks are drawn as they were trained; they are not in use."
    more += refused_caption if any(r.compensator and not r.helps for r in trained) else ""
    # Captions of the figures of each set, to which `more` is appended.
    caption_of_set = {
        "report": "No model saw these poses.",
        "identify": "Poses that identified the parameters; errors here are smaller than on new poses.",
        "train": "Poses that the networks learnt from.",
        "choose": "Poses by which the networks were kept or refused.",
    }
    for name, of_set in poses.items():
        caption = f"{caption_of_set.get(name.split('/')[0], '')} {more}"
        yield errors_by_pose(of_set, f"errors/{name}", caption)
        yield error_distribution(
            of_set, f"distribution/{name}", "The farther left, the better; grey lines at 50 and 95 %."
        )
    spatial = next((p for p in poses.values() if p.position is not None), None)
    if spatial is not None:
        yield workspace(spatial, last.robot)
    if (seen := last.problem.sets[0]).noise:
        robots = {"before": last.placed, **{method: r.robot for method, r in results.items()}}
        yield image_plane(seen, robots, "Of the poses that identified. Errors of depth are in the tooltips.")
    if where:
        from casadical.diagnosis.page import where_figures

        yield from where_figures(where)
    yield from parameter_figures(last)
    yield from fit_figures(last, {SET_TITLES.get(name, name): parts for name, parts in problem.sets.items()})
    if networks and any(r.compensator for r in trained):
        yield training_history(networks)


def training_history(networks: Networks) -> Figure:
    """Return the figure of training loss [mm^2] (paper, eq. 14) over the progress of training.

    The steps of different trainers cost differently, so the axis is the share of each training that
    is done; the tooltip names the step.
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
                    "linked",
                    share,
                    history[:, 1],
                    name=words,
                    colour=colour,
                    symbol=symbol,
                    size=5,
                    width=1.8,
                    dash=dash,
                    facts=history[:, 0],
                    tip=f"<b>{name}</b><br>{tip}",
                )
            )
    x, y = Axis("share of the training done [%]", (-2, 102)), Axis("loss on the training poses [mm²]", log=True)
    training_caption = (
        "A low loss on the training poses alone is no proof: the poses that each network was "
        "judged on decide. Trainers that choose a penalty on the weights may end at a greater loss "
        "on purpose."
    )
    return Figure("training", "Training history", series, x, y, 380, training_caption)


def calibration_page(
    problem: Problem,
    results: Identifications,
    accuracies: outcome.Accuracies,
    networks: Networks | None,
    figures: Mapping[str, Figure],
    camera: Sequence[Words] = (),
) -> Page:
    """Return the report page of one calibrated problem.

    results : identifications by method
    accuracies : accuracies by method, set and state
    figures : figures by name; camera : sentences on the camera, where one measured the poses
    """
    from casadical.project.reporting import problem_files

    last = list(results.values())[-1]
    errors = outcome.error_tables(problem, accuracies, networks)
    errors = [*outcome.outlier_table(problem, results), *errors]
    paper = outcome.paper_tables(problem.paper, accuracies, networks)
    each = [figure for name, figure in figures.items() if name.startswith(("errors/", "distribution/report"))]
    kinds = ", ".join(sorted({m.kind for parts in problem.sets.values() for m in parts}))
    no_map = f"The data are of the kind {kinds}: they do not say where each point is, so there is no map."
    diagnosis_note = (
        "A calibration does not ask which unmodelled effects cause the remaining error. A diagnosis "
        "does, given the poses in the order of measuring, with payload and temperature where they "
        "were logged:"
    )
    diagnosis_arguments = "CAMPAIGN.csv --report diagnosis.html"
    sections = [
        Section("Verdict", [*_verdict(problem, results, accuracies, networks)]),
        Section("Errors before and after", [*errors, *paper]),
        Section("Error of each pose", each),
        Section("In the workspace", figures_named(figures, "workspace") or [Words(no_map, "note")]),
        Section("Arm or camera", [*camera, *figures_named(figures, "image")]),
        Section("Where the gap lies", [*_where(figures_named(figures, "where"), last)]),
        Section(
            "Which causes", [Words(diagnosis_note, code=f"casadical diagnose {problem.folder} {diagnosis_arguments}")]
        ),
        Section(
            "Parameters",
            [
                Words(f"Of {last.method}. Bars are 95 % intervals. Base and tool frames: table only.", "note"),
                *figures_named(figures, "parameters"),
                *parameter_tables(last, whole=True),
            ],
        ),
        Section("Can the fit be trusted", figures_named(figures, "fit")),
        Section(
            "Training of the networks",
            [*outcome.network_tables(networks), *figures_named(figures, "training")] if networks else [],
        ),
        Section("What to measure next", [*_next(problem, last)]),
    ]
    badges = ["synthetic data"] if problem.data == "synthetic" else []
    subtitle = f"{problem.robot.name}, {problem.origin}"
    method, before, after, held_out = outcome.judged_on(accuracies)
    poses = f"{after.n} held-out poses" if held_out else f"{after.n} poses, not held out"
    fitted = outcome.before_in_words(problem, accuracies)
    tiles = [
        Tile("Mean error before", mm(before.mean), "mm", fitted),
        Tile(f"Mean error after {method}", mm(after.mean), "mm", poses),
        Tile("95 % of the poses below", mm(after.p95), "mm", f"{method}; before {mm(before.p95)} mm"),
        Tile("Largest error", mm(after.max), "mm", f"{method}; before {mm(before.max)} mm"),
    ]
    return Page("Calibration", problem.title, subtitle, sections, tiles, badges, problem_files(problem))


def _verdict(
    problem: Problem, results: Identifications, accuracies: outcome.Accuracies, networks: Networks | None
) -> Iterator[Block]:
    """Yield the sentences of the section "Verdict": accuracy, fit, networks, notes of the robot."""
    yield from outcome.report_blocks(problem, accuracies, block="verdict")
    for result in results.values():
        bad = result.at_bounds or "DOES NOT FIT" in result.verdict
        yield Words(result.verdict, "warning" if bad else "text")
    yield fit_quality(list(results.values())[-1])
    trained = [r for r in networks.results.values() if r.compensator] if networks else []
    yield from (Words(r.verdict) for r in trained if r.helps)
    if refused := [r.method for r in trained if not r.helps]:
        yield Words(f"Networks that make other poses worse or no better, and were refused: {', '.join(refused)}.")
    yield from (Words(note, "note") for note in problem.robot.notes)


def _where(figures: Iterable[Figure], result: Identification) -> Iterator[Block]:
    """Yield the figures that localise the residual error of a result, or why there are none."""
    if not figures:
        yield Words("Localising the gap needs exactly one set of measured positions.", "note")
        return
    most = MAX_LOCALISED_POSES
    poses = "the poses" if len(result.measurements[0]) <= most else f"{most} of the poses"
    yield Words(f"Of what {result.method} leaves at {poses} it was identified from. Bars are 95 % intervals.", "note")
    yield from figures


def _next(problem: Problem, result: Identification) -> Iterator[Words]:
    """Yield which parameters' intervals include the nominal value, and the command for a plan."""
    identified = result.shown[result.shown.status == "identified"]
    unsure = identified[(identified.low - identified.nominal) * (identified.high - identified.nominal) < 0]
    if len(unsure):
        yield Words(
            f"{len(unsure)} of {len(identified)} identified parameters do not differ from nominal "
            f"for certain: {', '.join(unsure.name)}."
        )
    yield Words(
        "Poses that would add most to what these data tell, and the accuracy to expect of them:",
        code=f"casadical plan {problem.folder} -n 20 --measured MEASURED.csv --out next.csv",
    )
