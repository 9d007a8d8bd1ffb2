"""The accuracy of a calibration, as tables and sentences."""

from collections.abc import Iterator, Mapping

from casadical.core.telling.blocks import Table, Words, mm
from casadical.identification.accuracy import Accuracy
from casadical.measurements.kinds.registry import find_kind
from casadical.project.networks import Networks
from casadical.project.problem import Problem
from casadical.project.problem_file import Paper

# By method, set, and state (nominal, placed, calibrated).
Accuracies = Mapping[str, Mapping[str, Mapping[str, Accuracy]]]

# Nominal errors beyond so many times those with base and tool fitted only say that the base was not known.
ELSEWHERE = 20
_FIGURES = ("mean", "max", "std", "rms", "95 %")
_WITH_NETWORKS = {"train": "networks learn", "choose": "networks are judged"}


def judged_on(accuracies: Accuracies) -> tuple[str, Accuracy, Accuracy, bool]:
    """Last method, errors before and after on the poses by which it is judged, and whether they were held out."""
    method, states = list(accuracies.items())[-1]
    name = next((name for name in states if name.startswith("report")), next(iter(states)))
    return method, states[name]["placed"], states[name]["calibrated"], name.startswith("report")


def verdict(problem: Problem, accuracies: Accuracies) -> Iterator[Words]:
    """How much the error falls on the poses that count, and what must be known of them."""
    method, before, after, held_out = judged_on(accuracies)
    name = next((n for n in accuracies[method] if n.startswith("report")), next(iter(accuracies[method])))
    change = 100 * (1 - after.mean / before.mean)
    poses = f"{after.n} poses that were held out" if held_out else f"the {after.n} poses it was identified from"
    yield Words(
        f"On {poses}, the mean {_error(problem, name)} {'falls' if change > 0 else 'grows'} from "
        f"{mm(before.mean)} mm to {mm(after.mean)} mm with {method} ({abs(change):.0f} % "
        f"{'less' if change > 0 else 'more'}). Before means: with only base and tool frames fitted.",
        "verdict",
    )
    if not held_out:
        yield Words("No poses were held out: on new poses the error will be greater.", "warning")
    if problem.data == "synthetic":
        yield Words(
            "The data are synthetic: they show that the method works, not how accurate a real robot is.", "note"
        )


def error_tables(problem: Problem, accuracies: Accuracies, networks: Networks | None = None) -> list[Table]:
    """A table for each set, held-out poses first: errors before, and after every method and every network in use."""
    last = list(accuracies.values())[-1]
    used = [r for r in networks.results.values() if r.helps] if networks else []
    trained = networks is not None and any(r.compensator for r in networks.results.values())
    tables = []
    for name in sorted(last, key=lambda name: not name.startswith("report")):
        if name.count("/") > 1:  # one table of several, a row of the kind's
            continue
        states = last[name]
        rows = [("before, base and tool fitted", states["placed"])]
        if states["nominal"].mean < ELSEWHERE * states["placed"].mean:
            rows.insert(0, ("before, as given", states["nominal"]))
        rows += [(f"after {method}", by_set[name]["calibrated"]) for method, by_set in accuracies.items()]
        first = len(rows) - 1
        rows += [(f"after {r.method}", r.errors[name]) for r in used if name in r.errors]
        single = {n.split("/", 2)[2]: a["calibrated"] for n, a in last.items() if n.startswith(f"{name}/")}
        rows += [(f"after {list(accuracies)[-1]}, {file}", a) for file, a in single.items()]
        use = _WITH_NETWORKS.get(name.split("/")[0]) if trained else None
        use = use or ("used" if name.startswith("identify") else "held out")
        cells = [(label, *(mm(v) for v in (a.mean, a.max, a.std, a.rms, a.p95))) for label, a in rows]
        title = f"{name} ({use}), {states['nominal'].n} poses: {_error(problem, name)} [mm]"
        numbers = frozenset(range(1, 6))
        tables.append(Table(title, ("model", *_FIGURES), cells, numbers, frozenset(range(first, len(rows)))))
    return tables


def _error(problem: Problem, name: str) -> str:
    """What a set's figures are errors of; name : SET or SET/KIND, as in the accuracies."""
    of_kind = {m.kind for part, m in problem.parts() if f"{part}/".startswith(f"{name}/")}
    kinds = {"position" if find_kind(kind).lengths == 3 else kind.replace("_", " ") for kind in of_kind}
    return "position error" if kinds == {"position"} else f"error of {' and '.join(sorted(kinds))}"


def network_tables(networks: Networks) -> list[Table | Words]:
    """What each trained network does to the mean error, also where it was refused, and what it was trained on."""
    rows: list[tuple[str, ...]] = []
    strong: set[int] = set()
    for name, result in networks.results.items():
        c = result.compensator
        if c is None:
            continue
        if c.helps:
            strong.add(len(rows))
        trained, judged, report = (
            f"{mm(1e-3 * x.before.mean_mm)}>{mm(1e-3 * x.after.mean_mm)}" if x else "-"
            for x in (c.training, c.choice, c.validation)
        )
        gain = f"{100 * c.choice.gain:+.0f} +/- {100 * c.choice.gain_error:.0f} %"
        rows.append((name, trained, judged, gain, report, "kept" if c.helps else "refused"))
    title = "Mean error without > with each network as trained, mm, and what became of it"
    columns = ("network", "trained on", "judged on", "gain there", "report", "")
    table = Table(title, columns, rows, frozenset(range(1, 5)), frozenset(strong))
    return [*([table] if rows else []), Words(networks.trained_on)]


def paper_tables(paper: Paper | None, accuracies: Accuracies, networks: Networks | None = None) -> list[Table | Words]:
    """Mean, max and std [mm] beside the published ones: calibration (the poses that each was made from) and report."""
    if paper is None:
        return []
    blocks: list[Table | Words] = []
    for name, published in (("calibration", paper.calibration), ("validation", paper.validation)):
        rows = []
        for method, of_set, ours in _beside(name, accuracies, networks):
            theirs = [f"{v:.4f}" for v in published[method]] if method in published else ["-"] * 3
            refused = networks and method in networks.results and not networks.results[method].helps
            rows.append((method + ("*" if refused else ""), of_set, *(f"{v:.4f}" for v in ours), *theirs))
        columns = ("", "set", "mean", "max", "std", "paper: mean", "max", "std")
        title = f"Beside the paper: {name} [mm]; our std is the sample's (n - 1)"
        blocks.append(Table(title, columns, rows, frozenset(range(2, 8))))
    star = " * refused: it makes held-out poses worse or no better; SKCM stays in use." if networks else ""
    return [*blocks, Words(f"Paper: {paper.source}.{star}")]


def _beside(
    name: str, accuracies: Accuracies, networks: Networks | None
) -> Iterator[tuple[str, str, tuple[float, float, float]]]:
    """Method, set and our (mean, max, std) [mm]; networks as they were trained, for the paper refuses none."""
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
