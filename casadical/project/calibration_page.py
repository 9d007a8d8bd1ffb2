"""A calibration as a page: its words, tables and figures in the order in which a reader asks."""

from collections.abc import Iterable, Iterator, Mapping

from casadical.core.telling.blocks import Block, Page, Section, Tile, Words, mm, shown
from casadical.core.telling.figure import Figure
from casadical.identification.result import Identification
from casadical.identification.tables import correlated, held_table, how_sure, parameter_tables
from casadical.project import remaining_errors
from casadical.project.networks import Networks
from casadical.project.outcome import left_out_table
from casadical.project.problem import Problem
from casadical.project.remaining_errors import Identifications
from casadical.project.sources import problem_files
from casadical.project.tables import Accuracies, error_tables, judged_on, network_tables, paper_tables, verdict


def calibration_page(
    problem: Problem,
    results: Identifications,
    accuracies: Accuracies,
    networks: Networks | None,
    figures: Mapping[str, Figure],
) -> Page:
    """One problem's page; results, accuracies : by method; figures : by name."""
    last = list(results.values())[-1]
    errors = [*left_out_table(results), *error_tables(problem, accuracies, networks)]
    sections = [
        Section("Verdict", [*_verdict(problem, results, accuracies, networks)]),
        Section("Errors before and after", [*errors, *paper_tables(problem.paper, accuracies, networks)]),
        Section("Error of each pose", [*_each(figures)]),
        Section("In the workspace", shown(figures, "workspace") or [_no_map(problem)]),
        Section("Where the gap lies", [*_where(shown(figures, "where"), last)]),
        Section("Which causes", [_causes(problem)]),
        Section("Parameters", [*_parameters(shown(figures, "parameters"), last)]),
        Section("Can the fit be trusted", shown(figures, "fit")),
        Section(
            "Training of the networks",
            [*network_tables(networks), *shown(figures, "training")] if networks else [],
        ),
        Section("What to measure next", [*_next(problem, last)]),
    ]
    badges = ["synthetic data"] if problem.data == "synthetic" else []
    subtitle = f"{problem.robot.name}, {problem.origin}"
    tiles = [*_tiles(accuracies)]
    return Page("Calibration", problem.title, subtitle, sections, tiles, badges, problem_files(problem))


def _tiles(accuracies: Accuracies) -> Iterator[Tile]:
    method, before, after, held = judged_on(accuracies)
    poses = f"{after.n} held-out poses" if held else f"{after.n} poses, not held out"
    yield Tile("Mean error before", mm(before.mean), "mm", "base and tool fitted")
    yield Tile(f"Mean error after {method}", mm(after.mean), "mm", poses)
    yield Tile("95 % of the poses below", mm(after.p95), "mm", f"{method}; before {mm(before.p95)} mm")
    yield Tile("Largest error", mm(after.max), "mm", f"{method}; before {mm(before.max)} mm")


def _verdict(
    problem: Problem, results: Identifications, accuracies: Accuracies, networks: Networks | None
) -> Iterator[Words]:
    yield from verdict(problem, accuracies)
    for result in results.values():
        bad = result.at_bounds or "DOES NOT FIT" in result.verdict
        yield Words(result.verdict, "warning" if bad else "text")
    yield how_sure(list(results.values())[-1])
    trained = [r for r in networks.results.values() if r.compensator] if networks else []
    yield from (Words(r.verdict) for r in trained if r.helps)
    if refused := [r.method for r in trained if not r.helps]:
        yield Words(f"Networks that make other poses worse or no better, and were refused: {', '.join(refused)}.")
    yield from (Words(note, "note") for note in problem.robot.notes)


def _each(figures: Mapping[str, Figure]) -> Iterator[Figure]:
    """The errors of every set, and how those of held-out poses are distributed."""
    for name, figure in figures.items():
        if name.startswith(("errors/", "distribution/report")):
            yield figure


def _no_map(problem: Problem) -> Words:
    kinds = ", ".join(sorted({m.kind for parts in problem.sets.values() for m in parts}))
    return Words(f"The data are of the kind {kinds}: they do not say where each point is, so there is no map.", "note")


def _where(figures: Iterable[Figure], result: Identification) -> Iterator[Block]:
    if not figures:
        yield Words("Localising the gap needs exactly one set of measured positions.", "note")
        return
    most = remaining_errors.MOST_LOCATED
    poses = "the poses" if len(result.measurements[0]) <= most else f"{most} of the poses"
    yield Words(f"Of what {result.method} leaves at {poses} it was identified from. Bars are 95 % intervals.", "note")
    yield from figures


def _causes(problem: Problem) -> Words:
    return Words(
        "A calibration does not ask which unmodelled effects are behind what is left. A diagnosis does, given the "
        "poses in the order of measuring, with payload and temperature where they were logged:",
        code=f"casadical diagnose {problem.folder} CAMPAIGN.csv --report diagnosis.html",
    )


def _parameters(figures: Iterable[Figure], result: Identification) -> Iterator[Block]:
    yield Words(f"Of {result.method}. Bars are 95 % intervals. Base and tool frames are in the table only.", "note")
    yield from figures
    yield from parameter_tables(result, whole=True)
    if result.at_bounds:
        bounds = ", ".join(result.at_bounds)
        yield Words(f"At a bound: {bounds}. Widen the bounds or doubt the model; no interval can be given.", "warning")
    yield held_table(result)
    yield from correlated(result)


def _next(problem: Problem, result: Identification) -> Iterator[Words]:
    known = result.shown[result.shown.status == "identified"]
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
