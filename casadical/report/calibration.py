"""The report of a calibration: the parts of a page that its figures make with words and tables."""

from collections.abc import Iterator, Mapping, Sequence

from casadical.core.blocks import Words, mm
from casadical.identification.result import Identification
from casadical.identification.tables import correlated, held_table, how_sure, parameter_tables
from casadical.project import remaining_errors
from casadical.project.calibration import Calibration
from casadical.project.networks import Networks
from casadical.project.outcome import left_out_table
from casadical.project.problem import Problem
from casadical.project.tables import error_tables, judged_on, network_tables, paper_tables, verdict
from casadical.report.figures_of_calibration import calibration_figures
from casadical.report.fit_figures import fit_drawings
from casadical.report.page import Block, Drawing, Part, Section, Tile, report_html
from casadical.report.provenance import problem_files, provenance_of
from casadical.report.share_figures import where_drawings
from casadical.report.style import Figure


def calibration_report(calibrations: Sequence[Calibration], command: Sequence[str] = ()) -> str:
    """One HTML file of one or several calibrated problems.

    Parameters
    ----------
    calibrations : Sequence[Calibration]
        of one or several problems
    command : Sequence[str], default ()
        as it was typed

    Returns
    -------
    str
        HTML

    Raises
    ------
    InputError
        plotly or jinja2 is not installed, or a problem's file is gone

    Examples
    --------
    >>> html = casadical.report.calibration_report([calibration])
    >>> html[:15]
    '<!doctype html>'
    """
    files = [path for c in calibrations for path in problem_files(c.problem)]
    return report_html("Calibration", [calibration_part(c) for c in calibrations], provenance_of(files, command))


def calibration_part(calibration: Calibration) -> Part:
    """One problem's part of a page. Raises InputError where plotly is not installed."""
    figures = calibration_figures(calibration)
    problem, last, networks = calibration.problem, calibration.identification, calibration.networks
    errors = [*left_out_table(calibration.identifications), *error_tables(calibration.accuracies, networks)]
    sections = [
        Section("Verdict", [*_verdict(calibration)]),
        Section(
            "Errors before and after",
            [
                *errors,
                *paper_tables(problem.paper, calibration.accuracies, networks),
            ],
        ),
        Section("Error of each pose", [*_pose_blocks(figures, networks)]),
        Section("In the workspace", [*_space_blocks(figures, problem)]),
        Section("Where the gap lies", [*_where_blocks(figures, last)]),
        Section("Which causes", [*_cause_blocks(problem)]),
        Section("Parameters", [*_parameter_blocks(figures, last)]),
        Section("Can the fit be trusted", [*fit_drawings(figures)]),
        Section("Training of the networks", [*_network_blocks(figures, networks)]),
        Section("What to measure next", [*_next_blocks(problem, last)]),
    ]
    badges = ["synthetic data"] if problem.data == "synthetic" else []
    subtitle = f"{problem.robot.name}, {problem.origin}"
    return Part(problem.title, subtitle, sections, [*_tiles(calibration)], badges)


def _tiles(calibration: Calibration) -> Iterator[Tile]:
    method, before, after, held = judged_on(calibration.accuracies)
    where_ = f"{after.n} held-out poses" if held else f"{after.n} poses, not held out"
    yield Tile("Mean error before", mm(before.mean), "mm", "base and tool fitted")
    yield Tile(f"Mean error after {method}", mm(after.mean), "mm", where_)
    yield Tile("95 % of the poses below", mm(after.p95), "mm", f"{method}; before {mm(before.p95)} mm")
    yield Tile("Largest error", mm(after.max), "mm", f"{method}; before {mm(before.max)} mm")


def _verdict(calibration: Calibration) -> Iterator[Block]:
    problem, networks = calibration.problem, calibration.networks
    yield from verdict(problem, calibration.accuracies)
    for result in calibration.identifications.values():
        bad = result.at_bounds or "DOES NOT FIT" in result.verdict
        yield Words(result.verdict, "warning" if bad else "text")
    yield how_sure(calibration.identification)
    for trained in networks.results.values() if networks else ():
        if trained.helps:
            yield Words(trained.verdict)
    refused = [r.method for r in networks.results.values() if r.compensator and not r.helps] if networks else []
    if refused:
        yield Words(f"Networks that make other poses worse or no better, and were refused: {', '.join(refused)}.")
    yield from (Words(note, "note") for note in problem.robot.notes)


def _pose_blocks(figures: Mapping[str, Figure], networks: Networks | None) -> Iterator[Block]:
    captions = {
        "report": "No model saw these poses.",
        "identify": "Poses that identified the parameters; errors here are smaller than on new poses.",
        "train": "Poses that the networks learnt from.",
        "choose": "Poses by which the networks were kept or refused.",
    }
    more = "Before: with base and tool fitted. Click a name in the legend to show or hide it."
    if any("left out" in str(trace.name) for figure in figures.values() for trace in figure.data):
        more += " Crosses: poses left out as outliers; no figure of this report counts them."
    if networks and any(r.compensator and not r.helps for r in networks.results.values()):
        more += " Refused networks are drawn as they were trained; they are not in use."
    for name, figure in figures.items():
        kind, _, of_set = name.partition("/")
        caption = captions.get(of_set.split("/")[0], "")
        if kind == "errors":
            yield Drawing(name, figure, f"{caption} {more}")
        elif kind == "distribution" and of_set.startswith("report"):
            yield Drawing(name, figure, "The farther left, the better; grey lines at 50 and 95 %.")


def _space_blocks(figures: Mapping[str, Figure], problem: Problem) -> Iterator[Block]:
    if "workspace" in figures:
        caption = (
            "Turn it with the mouse; point at the dot that ends a vector for its error. Each line runs from the "
            "measured point in the direction of the error (measured less computed), longer than it by the factor in "
            "the legend."
        )
        yield Drawing("workspace", figures["workspace"], caption)
    else:
        kinds = ", ".join(sorted({m.kind for parts in problem.sets.values() for m in parts}))
        yield Words(
            f"The data are of the kind {kinds}: they do not say where each point is, so there is no map.", "note"
        )


def _where_blocks(figures: Mapping[str, Figure], result: Identification) -> Iterator[Block]:
    found = {k.partition("/")[2]: f for k, f in figures.items() if k.startswith("where/")}
    if not found:
        yield Words("Localising the gap needs exactly one set of measured positions.", "note")
        return
    most = remaining_errors.MOST_LOCATED
    poses = "the poses" if len(result.measurements[0]) <= most else f"{most} of the poses"
    yield Words(f"Of what {result.method} leaves at {poses} it was identified from. Bars are 95 % intervals.", "note")
    yield from where_drawings(found)


def _cause_blocks(problem: Problem) -> Iterator[Block]:
    yield Words(
        "A calibration does not ask which unmodelled effects are behind what is left. A diagnosis does, given the "
        "poses in the order of measuring, with payload and temperature where they were logged:",
        code=f"casadical diagnose {problem.folder} CAMPAIGN.csv --report diagnosis.html",
    )


def _parameter_blocks(figures: Mapping[str, Figure], result: Identification) -> Iterator[Block]:
    yield Words(f"Of {result.method}. Bars are 95 % intervals. Base and tool frames are in the table only.", "note")
    yield from (Drawing(name, figure) for name, figure in figures.items() if name.startswith("parameters/"))
    yield from parameter_tables(result, whole=True)
    if result.at_bounds:
        bounds = ", ".join(result.at_bounds)
        yield Words(f"At a bound: {bounds}. Widen the bounds or doubt the model; no interval can be given.", "warning")
    yield held_table(result)
    yield from correlated(result)


def _network_blocks(figures: Mapping[str, Figure], networks: Networks | None) -> Iterator[Block]:
    if networks is None:
        return
    yield from network_tables(networks)
    if "training" in figures:
        caption = (
            "A low loss on the training poses alone is no proof: the poses that each network was judged on "
            "decide. Trainers that choose a penalty on the weights may end at a greater loss on purpose."
        )
        yield Drawing("training", figures["training"], caption)


def _next_blocks(problem: Problem, result: Identification) -> Iterator[Block]:
    table = result.parameters
    known = table[table.status == "identified"]
    unsure = known[(known.low - known.nominal) * (known.high - known.nominal) < 0]
    if len(unsure):
        yield Words(
            f"{len(unsure)} of {len(known)} identified parameters do not differ from nominal for certain: "
            f"{', '.join(unsure.name)}."
        )
    yield Words(
        "Poses that would add most to what these data tell, and the accuracy to expect of them:",
        code=f"casadical plan {problem.folder} -n 20 --measured MEASURED.csv --out next.csv",
    )
