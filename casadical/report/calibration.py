"""The report of a calibration: the parts of a page that its figures make with words and tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from casadical.identification.accuracy import Accuracy
from casadical.identification.identifiability import CONFOUNDED
from casadical.identification.identification import Identification
from casadical.project.networks import Networks
from casadical.project.problem import Problem
from casadical.report.calibration_text import NEARLY_CONFOUNDED, SetAccuracies
from casadical.report.error_tables import error_tables, network_table
from casadical.report.figures_of_calibration import Results, calibration_figures, last_of
from casadical.report.page import Block, Drawing, Part, Section, Table, Tile, Words, report_html
from casadical.report.parameter_tables import confounded, correlated, parameter_table
from casadical.report.provenance import problem_files, provenance_of
from casadical.report.style import mm
from casadical.report.where_blocks import where_drawings

if TYPE_CHECKING:
    import plotly.graph_objects as go


def calibration_report(
    runs: Sequence[tuple[Problem, Results, Mapping[str, SetAccuracies], Networks | None]], command: Sequence[str] = ()
) -> str:
    """One HTML file of one or several calibrated problems.

    runs : what `calibrate_problem` gives, and `problem_networks`; command : as it was typed. Raises InputError where
    plotly or jinja2 is not installed, or a problem's file is gone.
    """
    parts = [calibration_part(*run) for run in runs]
    files = [path for problem, *_ in runs for path in problem_files(problem.folder)]
    return report_html("Calibration", parts, provenance_of(files, command))


def calibration_part(
    problem: Problem, results: Results, errors: Mapping[str, SetAccuracies], networks: Networks | None = None
) -> Part:
    """One problem's part of a page. Raises InputError where plotly is not installed."""
    figures = calibration_figures(problem, results, networks)
    last = last_of(results)
    sections = [
        Section("Verdict", [*_verdict(problem, results, errors, networks)]),
        Section("Errors before and after", [*error_tables(errors, networks), *_paper(problem)]),
        Section("Error of each pose", [*_pose_blocks(figures, networks)]),
        Section("In the workspace", [*_space_blocks(figures, problem)]),
        Section("Where the gap lies", [*_where_blocks(figures, last)]),
        Section("Which causes", [*_cause_blocks(problem)]),
        Section("Parameters", [*_parameter_blocks(figures, last)]),
        Section("Training of the networks", [*_network_blocks(figures, networks)]),
        Section("What to measure next", [*_next_blocks(problem, last)]),
    ]
    badges = ["synthetic data"] if problem.data == "synthetic" else []
    subtitle = f"{problem.robot.name}, {problem.origin}"
    return Part(problem.title, subtitle, sections, [*_tiles(errors)], badges)


def _judged(errors: Mapping[str, SetAccuracies]) -> tuple[str, Accuracy, Accuracy, bool]:
    """Method, errors before and after on the poses by which the result is judged, and whether they were held out."""
    method, states = list(errors.items())[-1]
    held = [name for name in states if name.startswith("report")]
    of_set = states[(held or list(states))[0]]
    return method, of_set["placed"], of_set["calibrated"], bool(held)


def _tiles(errors: Mapping[str, SetAccuracies]) -> Iterator[Tile]:
    method, before, after, held = _judged(errors)
    where_ = f"{after.n} held-out poses" if held else f"{after.n} poses, not held out"
    yield Tile("Mean error before", mm(before.mean), "mm", "base and tool fitted")
    yield Tile(f"Mean error after {method}", mm(after.mean), "mm", where_)
    yield Tile("95 % of the poses below", mm(after.p95), "mm", f"{method}; before {mm(before.p95)} mm")
    yield Tile("Largest error", mm(after.max), "mm", f"{method}; before {mm(before.max)} mm")


def _verdict(
    problem: Problem, results: Results, errors: Mapping[str, SetAccuracies], networks: Networks | None
) -> Iterator[Block]:
    method, before, after, held = _judged(errors)
    change = 100 * (1 - after.mean / before.mean)
    poses = f"On {after.n} poses that were held out" if held else f"On the {after.n} poses it was identified from"
    yield Words(
        f"{poses}, the mean position error {'falls' if change > 0 else 'grows'} from {mm(before.mean)} mm to "
        f"{mm(after.mean)} mm with {method} ({abs(change):.0f} % {'less' if change > 0 else 'more'}). Before means: "
        "with only base and tool frames fitted.",
        "verdict",
    )
    if not held:
        yield Words("No poses were held out: on new poses the error will be greater.", "warning")
    if problem.data == "synthetic":
        yield Words(
            "The data are synthetic: they show that the method works, not how accurate a real robot is.", "note"
        )
    for result in results.values():
        bad = result.at_bounds or "DOES NOT FIT" in result.verdict
        yield Words(result.verdict, "warning" if bad else "text")
    yield Words(_how_sure(last_of(results)))
    for trained in networks.results.values() if networks else ():
        if trained.helps:
            yield Words(trained.verdict)
    refused = [r.method for r in networks.results.values() if r.compensator and not r.helps] if networks else []
    if refused:
        yield Words(f"Networks that make other poses worse or no better, and were refused: {', '.join(refused)}.")
    yield from (Words(note, "note") for note in problem.robot.notes)


def _how_sure(result: Identification) -> str:
    """Scatter of the residuals, condition and optimality in a sentence."""
    noise = ", ".join(f"{1e3 * sigma:.3f} mm a coordinate" for sigma, _ in result.sigmas)
    optimal = "confirmed" if result.is_optimal() else "NOT confirmed"
    return (
        f"Residual scatter {noise}; condition number {result.identifiability.condition:.0f}; optimum {optimal} by "
        f"recomputation; {result.degrees_of_freedom} degrees of freedom."
    ) + (NEARLY_CONFOUNDED if result.identifiability.condition > CONFOUNDED else "")


def _paper(problem: Problem) -> Iterator[Block]:
    if problem.paper is None:
        return
    rows = [
        (name, method, *(f"{v:.4f}" for v in row))
        for name, published in (("calibration", problem.paper.calibration), ("validation", problem.paper.validation))
        for method, row in published.items()
    ]
    columns = ("poses", "method", "mean", "max", "std")
    yield Table(f"For comparison, {problem.paper.source}, mm", columns, rows, frozenset({2, 3, 4}), folded=True)


def _pose_blocks(figures: Mapping[str, go.Figure], networks: Networks | None) -> Iterator[Block]:
    captions = {
        "report": "Held-out poses: no model saw them (Fig. 7 of the paper).",
        "identify": "Poses that identified the parameters; errors here are smaller than on new poses (Fig. 6).",
        "train": "Poses that the networks learnt from.",
        "choose": "Poses by which the networks were kept or refused.",
    }
    more = "Before: with base and tool fitted. Click a name in the legend to show or hide it."
    if networks and any(r.compensator and not r.helps for r in networks.results.values()):
        more += " Refused networks are drawn as they were trained; they are not in use."
    for name, figure in figures.items():
        kind, _, of_set = name.partition("/")
        caption = captions.get(of_set.split("/")[0], "")
        if kind == "errors":
            yield Drawing(name, figure, f"{caption} {more}")
        elif kind == "distribution" and of_set.startswith("report"):
            yield Drawing(name, figure, "The farther left, the better; grey lines at 50 and 95 %.")


def _space_blocks(figures: Mapping[str, go.Figure], problem: Problem) -> Iterator[Block]:
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


def _where_blocks(figures: Mapping[str, go.Figure], result: Identification) -> Iterator[Block]:
    found = {k.partition("/")[2]: f for k, f in figures.items() if k.startswith("where/")}
    if not found:
        yield Words("Where the gap lies can be told from one set of measured positions only.", "note")
        return
    yield Words(f"Of what {result.method} leaves at the poses it was identified from. Bars are 95 % intervals.", "note")
    yield from where_drawings(found)


def _cause_blocks(problem: Problem) -> Iterator[Block]:
    yield Words(
        "A calibration does not ask which unmodelled effects are behind what is left. A diagnosis does, given the "
        "poses in the order of measuring, with payload and temperature where they were logged:",
        code=f"casadical diagnose {problem.folder} CAMPAIGN.csv --report diagnosis.html",
    )


def _parameter_blocks(figures: Mapping[str, go.Figure], result: Identification) -> Iterator[Block]:
    yield Words(f"Of {result.method}. Bars are 95 % intervals. Base and tool frames are in the table only.", "note")
    yield from (Drawing(name, figure) for name, figure in figures.items() if name.startswith("parameters/"))
    yield parameter_table(result)
    if result.at_bounds:
        bounds = ", ".join(result.at_bounds)
        yield Words(f"At a bound: {bounds}. Widen the bounds or doubt the model; no interval can be given.", "warning")
    yield confounded(result)
    yield correlated(result)


def _network_blocks(figures: Mapping[str, go.Figure], networks: Networks | None) -> Iterator[Block]:
    if networks is None:
        return
    yield Words(networks.trained_on)
    table = network_table(networks)
    if table and "training" in figures:
        yield table
        caption = (
            "A low loss on the training poses alone is worth nothing: the poses that each network was judged on "
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
