"""The report of a calibration in sentences and tables: accuracy, outliers, doubts, success."""

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from casadical.core.basics import shown
from casadical.core.reporting.blocks import Block, Table, Words, mm
from casadical.core.reporting.template import template_blocks
from casadical.identification.accuracy import Accuracy, errors
from casadical.identification.gravity import in_words
from casadical.identification.result import PRIOR_ONLY_REASON, Identification, LeftOut, rows_in_words
from casadical.identification.sessions import undetermined
from casadical.measurements.columns import Source
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.vocabulary import UNITS
from casadical.project.check.plausible import coverage
from casadical.project.networks import Networks
from casadical.project.problem import Problem
from casadical.project.problem_file import Paper

# Method -> set -> state ("nominal", "placed", "calibrated") -> statistics of the errors.
Accuracies = Mapping[str, Mapping[str, Mapping[str, Accuracy]]]


def judged_on(accuracies: Accuracies) -> tuple[str, Accuracy, Accuracy, bool]:
    """Return the last method, its errors before and after, and whether these are held-out poses'.

    Before means the nominal robot with base and tool fitted.
    """
    method, states = list(accuracies.items())[-1]
    name = _judging_set(states)
    return method, states[name]["placed"], states[name]["calibrated"], name.startswith("report")


def before_in_words(problem: Problem, accuracies: Accuracies) -> str:
    """Return what was fitted before; KM omits the compliance that a robot file declares."""
    soft = any(j.compliance is not None for j in problem.robot.joints)
    return f"{'rigid, ' if soft and [*accuracies][-1] == 'KM' else ''}base and tool fitted"


def _judging_set(states: Iterable[str]) -> str:
    """Return the set by which a method is judged: one that was held out, else the first."""
    names = list(states)
    return next((name for name in names if name.startswith("report")), names[0])


def report_blocks(
    problem: Problem | None,
    accuracies: Accuracies,
    *,
    block: str = "",
    it: Any = None,
    brief: bool = False,
    **more: Any,
) -> list[Block]:
    """Return the sentences and tables that calibration.j2, or one block of it, makes.

    block : name of the block, empty for all; it : object of the template; brief : whether the short
        report is wanted
    more : further values that the block needs
    """
    path = Path(__file__).with_name("calibration.j2")
    return template_blocks(
        path, it, block, problem=problem, accuracies=accuracies, brief=brief, **_TEMPLATE_FUNCTIONS, **more
    )


def things_to_know(
    problem: Problem, last: Identification, networks: Networks | None, accuracies: Accuracies
) -> list[Block]:
    """Return at most three warnings or notes that a reader must know, the most important first.

    last : identification by the last method, which is the result
    """
    return report_blocks(problem, accuracies, block="things", last=last, networks=networks)[:3]


def error_tables(problem: Problem, accuracies: Accuracies, networks: Networks | None = None) -> list[Table]:
    """Return a table of the errors of positions or lengths [mm] for each set, held-out poses first.

    Rows are the errors before, and after every method and every network in use. Columns are
    statistics over the poses; where orientations were measured, those of their errors [deg], too.

    accuracies : by method, set and state
    """
    last = list(accuracies.values())[-1]
    used = [r for r in networks.results.values() if r.helps] if networks else []
    trained = networks is not None and any(r.compensator for r in networks.results.values())
    tables = []
    for name in sorted(last, key=lambda name: not name.startswith("report")):
        if name.count("/") > 1:  # one table of several: it is a row of its kind's table
            continue
        states = last[name]
        turned = states["placed"].turn is not None
        before = f"before, {before_in_words(problem, accuracies)}"
        # With the two columns of orientations the label has to be shorter.
        rows = [(before.replace("base and tool", "frames") if turned else before, states["placed"])]
        # Nominal errors this many times larger than those with base and tool fitted only show that
        # the base was unknown.
        if states["nominal"].mean < 20 * states["placed"].mean:
            rows.insert(0, ("before, as given", states["nominal"]))
        rows += [(f"after {method}", by_set[name]["calibrated"]) for method, by_set in accuracies.items()]
        first = len(rows) - 1
        rows += [(f"after {r.method}", r.errors[name]) for r in used if name in r.errors]
        single = {n.split("/", 2)[2]: a["calibrated"] for n, a in last.items() if n.startswith(f"{name}/")}
        rows += [(f"after {list(accuracies)[-1]}, {file}", a) for file, a in single.items()]
        use = {"train": "networks learn", "choose": "networks are judged"}.get(name.split("/")[0]) if trained else None
        use = use or ("used" if name.startswith("identify") else "held out")
        cells = [
            (label, *(mm(v) for v in (a.mean, a.max, a.std, a.rms, a.p95)), *(_angles(a) if turned else ()))
            for label, a in rows
        ]
        title = f"{name} ({use}), {states['nominal'].n} poses: {_error_kind(problem, name)} [mm]"
        title += ", of orientation [deg]" if turned else ""
        columns = ("model", "mean", "max", "std", "rms", "95 %", *(("deg: mean", "95 %") if turned else ()))
        numbers = frozenset(range(1, len(columns)))
        tables.append(Table(title, columns, cells, numbers, frozenset(range(first, len(rows)))))
    return tables


def _angles(a: Accuracy) -> tuple[str, str]:
    """Return mean and 95th percentile of orientation errors as texts [deg]; dashes if unknown."""
    return ("-", "-") if a.turn is None else (mm(1e-3 * np.rad2deg(a.turn.mean)), mm(1e-3 * np.rad2deg(a.turn.p95)))


def _error_kind(problem: Problem, name: str) -> str:
    """Return the quantity whose errors a set has, as text such as "position error"."""
    of_kind = {m.kind for part, m in problem.parts() if f"{part}/".startswith(f"{name}/")}
    kinds = {"position" if find_kind(kind).lengths == 3 else kind.replace("_", " ") for kind in of_kind}
    return "position error" if kinds == {"position"} else f"error of {' and '.join(sorted(kinds))}"


def network_tables(networks: Networks) -> list[Table | Words]:
    """Return a table of mean errors [mm] without and with each trained network, and a sentence.

    The table is absent where none was trained; the sentence states on which poses, or why none was.
    """
    rows: list[tuple[str, ...]] = []
    for name, result in networks.results.items():
        c = result.compensator
        if c is None:
            continue
        trained, judged, report = (
            f"{mm(1e-3 * x.before.mean_mm)}>{mm(1e-3 * x.after.mean_mm)}" if x else "-"
            for x in (c.training, c.choice, c.validation)
        )
        gain = f"{100 * c.choice.gain:+.0f} +/- {100 * c.choice.gain_error:.0f} %"
        rows.append((name, trained, judged, gain, report, "kept" if c.helps else "refused"))
    title = "Mean error without > with each network as trained, mm, and what became of it"
    columns = ("network", "trained on", "judged on", "gain there", "report", "")
    strong = frozenset(k for k, row in enumerate(rows) if row[-1] == "kept")
    table = Table(title, columns, rows, frozenset(range(1, 5)), strong)
    return [*([table] if rows else []), Words(networks.trained_on)]


def paper_tables(paper: Paper | None, accuracies: Accuracies, networks: Networks | None = None) -> list[Table | Words]:
    """Return tables of our mean, max, std of errors [mm] next to published ones; [] without paper.

    The table of the calibration has the poses that each method was fitted to, that of the
    validation the set report.
    """
    if paper is None:
        return []
    blocks: list[Table | Words] = []
    for name, published in (("calibration", paper.calibration), ("validation", paper.validation)):
        rows = []
        for method, of_set, ours in _paper_rows(name, accuracies, networks):
            theirs = [f"{v:.4f}" for v in published[method]] if method in published else ["-"] * 3
            refused = networks and method in networks.results and not networks.results[method].helps
            rows.append((method + ("*" if refused else ""), of_set, *(f"{v:.4f}" for v in ours), *theirs))
        columns = ("", "set", "mean", "max", "std", "paper: mean", "max", "std")
        title = f"Beside the paper: {name} [mm]; our std is the sample's (n - 1)"
        blocks.append(Table(title, columns, rows, frozenset(range(2, 8))))
    star = " * refused: it makes held-out poses worse or no better; SKCM stays in use." if networks else ""
    return [*blocks, Words(f"Paper: {paper.source}.{star}")]


def _paper_rows(
    name: str, accuracies: Accuracies, networks: Networks | None
) -> Iterator[tuple[str, str, tuple[float, float, float]]]:
    """Yield method, set and our (mean, max, std) of errors [mm] for a table of the paper.

    Networks are as trained, also refused ones.

    name : "calibration" or "validation"
    """
    base = "identify" if name == "calibration" else "report"
    rows = list(accuracies.items())
    for method, states in [("before", rows[-1][1]), *rows]:
        a = states.get(base, {}).get("placed" if method == "before" else "calibrated")
        if a:
            yield method, base, (1e3 * a.mean, 1e3 * a.max, 1e3 * a.std)
    for result in networks.results.values() if networks else ():
        c = result.compensator
        share = c and (c.training if name == "calibration" else c.validation)
        if share:
            e = share.after
            of_set = "train" if name == "calibration" else base
            yield result.method, of_set, (e.mean_mm, e.max_mm, e.std_mm)


def outlier_table(problem: Problem, identifications: Mapping[str, Identification]) -> list[Table]:
    """Return a table of all outliers, which are in no figure, with their errors [mm]; or [].

    identifications : by method; the last one judges held-out rows
    """
    rows: dict[tuple[str, int], dict[str, str]] = {}
    columns: dict[tuple[str, int], str] = {}
    methods = list(identifications)
    for method, result in identifications.items():
        for out in (*result.left_out, *(held_out_outliers(problem, result) if method == methods[-1] else ())):
            rows.setdefault((out.source, out.row), {})[method] = mm(out.error)
            columns[out.source, out.row] = out.column
    if not rows:
        return []
    cells = [
        (source, str(row), columns[source, row], *(used.get(m, "") for m in methods))
        for (source, row), used in rows.items()
    ]
    title = "Rows left out of the fit and of the figures as outliers: error [mm]"
    return [Table(title, ("file", "row", "in column", *methods), cells, frozenset({1, *range(3, 3 + len(methods))}))]


def held_out_outliers(problem: Problem, last: Identification) -> list[LeftOut]:
    """Return all outliers among poses that were not fitted, the one with the largest error first."""
    outliers = (out for _, some in problem.outliers_by_set(last).values() for out in some)
    return sorted(outliers, key=lambda out: -out.error)


def chance_of(before: Accuracy, after: Accuracy) -> float:
    """Return twice the standard error of the difference of two mean errors [m]; 0 for one pose."""
    return float(2 * np.hypot(before.std, after.std) / np.sqrt(after.n)) if after.n > 1 else 0.0


def poses_to_tell(before: Accuracy, after: Accuracy) -> int:
    """Return the number of held-out poses from which a difference of two mean errors is no chance.

    It exceeds the number of poses where the difference may be one of chance (`chance_of`), and is
    at most 1e9.
    """
    off = abs(after.mean - before.mean)
    return int(min(np.ceil(after.n * (chance_of(before, after) / max(off, 1e-12)) ** 2), 1e9))


def open_error(last: Identification) -> float:
    """Return the rms uncertainty of modelled positions [m], at about 200 fitted poses a table."""
    some = [m[:: -(-len(m) // 200)] for m in last.used]
    covariances = np.concatenate([last.predict(m.q, m.conditions)[1] for m in some])
    return float(np.sqrt(np.trace(covariances, axis1=1, axis2=2).mean()))


def worse_methods(accuracies: Accuracies) -> Iterator[tuple[str, Accuracy, Accuracy]]:
    """Yield (method, errors before, errors after) of methods that worsen held-out poses.

    The last method is not judged; worse means by more than chance (`chance_of`).
    """
    *others, (_, last) = accuracies.items()
    for method, states in others:
        name = _judging_set(states)
        if name.startswith("report"):  # the start of `last`, as the start of KM has no compliance
            before, after = last[name]["placed"], states[name]["calibrated"]
            if after.mean > before.mean + chance_of(before, after):
                yield method, before, after


def worse_than_before(result: Identification, before: Accuracy, after: Accuracy) -> str:
    """Return the reason and the remedy, where held-out poses have become worse by more than chance.

    Chance is twice the standard error of the difference of the two means: a robot that was
    calibrated before, perhaps with these very poses, is not called worse because of it. Returns ""
    where they are not worse.
    """
    if after.mean <= before.mean + chance_of(before, after):
        return ""
    text = f"held-out poses are worse after the calibration, {mm(after.mean)} mm, than before, {mm(before.mean)} mm"
    # A fitted pose is far off if its error exceeds four times the median.
    e = [(m, errors(result.robot, m)) for m in result.used]
    far = ((m, k, e) for m, e in e for k in np.flatnonzero(e > 4 * np.median(e)))
    worst = sorted((LeftOut(m.source, int(m.row[k]), float(e[k])) for m, k, e in far), key=lambda out: -out.error)
    if worst and result.loss == "linear":
        cause = f"rows that nothing explains draw the fit ({rows_in_words(worst, 4, result.sources)})"
        return f"{text}: {cause}; use --loss huber, or name them in leave_out"
    if result.degrees_of_freedom < 2 * len(result.names):
        return f"{text}: {len(result.names)} parameters from few poses; measure more, or free fewer parameters"
    if worst:
        return f"{text}; check these rows first: {rows_in_words(worst, 4, result.sources)}"
    return f"{text}: measure more poses"


def _payload_is_ignored(problem: Problem) -> bool:
    """Return whether a payload above 0 was logged, but a robot with compliant joints has none."""
    payloads = [m.conditions["payload_kg"] for _, m in problem.parts() if "payload_kg" in m.conditions]
    gives = problem.robot.payload is None and any(j.compliance is not None for j in problem.robot.joints)
    return gives and any(np.any(p != 0) for p in payloads)


def changed_readings(problem: Problem) -> list[str]:
    """Return the joint readings that problem.toml reverses, scales or shifts, in words."""
    changed, columns = [], dict[str, Any]()
    for table in problem.tables:
        columns |= table.get("columns", {})
    for name, made in sorted(columns.items()):
        if re.fullmatch(r"q\d+(_\w+)?", name) and isinstance(made, Mapping):
            source = Source.read(made)
            # These factors convert units; all others reverse a reading or scale it.
            factors = [*(factor for _, factor in UNITS.values()), np.pi / 180, 180 / np.pi, 1e3, 1e-3]
            unit_alone = np.isclose(source.times, factors, rtol=1e-6).any()
            if not unit_alone or source != Source(source.name, source.times):
                changed.append(f"{name.partition('_')[0]} = {source.words}")
    return changed


def unused_columns(problem: Problem) -> dict[str, str]:
    """Return column that the calibration does not use -> name of its table."""
    used = {*problem.robot.conditions, "pose", "time_s", "point", problem.set_column}
    unused = {name: m.source for _, m in problem.parts() for name in (*m.conditions, *m.unused) if name not in used}
    return {shown(name): table for name, table in unused.items() if not name.startswith(("tool_", "session_"))}


# Name in the template calibration.j2 -> function that it calls.
_TEMPLATE_FUNCTIONS: dict[str, Any] = {
    "judged_on": judged_on,
    "before_in_words": before_in_words,
    "chance_of": chance_of,
    "poses_to_tell": poses_to_tell,
    "open_error": open_error,
    # The robot with the effects of its file alone, without those of a prior.
    "with_own_effects": lambda problem: problem.robot.with_only(
        e for e in problem.robot.effects if e.label not in (problem.prior.labels if problem.prior else ())
    ),
    "weighs_nothing": _payload_is_ignored,
    "changed_readings": changed_readings,
    "unused_columns": unused_columns,
    "error_of": lambda problem, accuracies: _error_kind(problem, _judging_set(list(accuracies.values())[-1])),
    "in_words": in_words,
    "worse_methods": worse_methods,
    "rows_in_words": rows_in_words,
    "held_out_outliers": held_out_outliers,
    "undetermined": undetermined,
    "reports": lambda problem: any(name.startswith("report") for name in problem.sets),
    "fitted_mean": lambda last: np.concatenate([errors(last.robot, m) for m in last.used]).mean(),
    "narrow_joints": lambda problem: [
        c.joint for c in coverage(problem.robot, problem.sets["identify"][0]) if c.share < 0.5
    ],
    "as_before": lambda last: int(
        (last.parameters["reason"] == PRIOR_ONLY_REASON)[last.parameters["name"].isin(last.identified)].sum()
    ),
}
