"""A problem calibrated with its methods: one result, its accuracy, and its files."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from casadical.compensator import compensator_text
from casadical.core.blocks import Table, Words, mm, plain_text, terminal
from casadical.core.errors import InputError, shown
from casadical.core.files import claimed, json_text, write_together
from casadical.core.notebook import html
from casadical.identification.accuracy import Accuracy
from casadical.identification.error_bound import learn_bound
from casadical.identification.identification import Identification, identify, without_poses
from casadical.identification.misfit import misfit_of
from casadical.identification.plausibility import check_against
from casadical.identification.residuals import Loss
from casadical.identification.tables import correlated, held_table, how_sure, parameter_tables
from casadical.measurements.measurements import Measurements
from casadical.project.check.targets import unnamed_targets
from casadical.project.networks import NetworkResult, Networks, train_networks
from casadical.project.outcome import (
    chance_of,
    left_out_table,
    methods_worse,
    things_to_know,
    usual_held_out,
    worse_than_before,
)
from casadical.project.problem import Carried, Problem, as_it_is, read_problem
from casadical.project.problem_file import BASE_METHODS, PROBLEM_LOSSES, BaseMethod, all_methods, base_methods
from casadical.project.tables import Accuracies, error_tables, judged_on, network_tables, paper_tables, verdict
from casadical.project.target_names import unfitted
from casadical.robot.robot import Robot, modified_dh
from casadical.robot.robot_file import to_toml

if TYPE_CHECKING:
    from rich.console import RenderableType


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated problem.

    Parameters
    ----------
    problem : Problem
        what was calibrated, from which measurements
    identifications : Mapping[str, Identification]
        by method, in the order of the problem's methods; the last one counts
    accuracies : Accuracies
        error figures by method, by set (one of several kinds as SET/KIND), by state: "nominal", "placed" (base and
        tool fitted), "calibrated"
    networks : Networks, optional
        trained on what SKCM left, or None where the problem lists none
    without_prior : Accuracy, optional
        of the poses by which the last method is judged, had there been no prior; None without one

    Examples
    --------
    >>> figures = calibration.accuracies["KM"]["report"]
    >>> round(1e3 * figures["placed"].mean, 2), round(1e3 * figures["calibrated"].mean, 4)  # mm
    (1.7, 0.0254)
    >>> import rich
    >>> rich.print(calibration.report())  # doctest: +ELLIPSIS
    Planar arm of two links, to be read in five minutes
    Planar arm of two links; synthetic data
    On 15 poses that were held out, the mean position error falls from 1.696 mm to
    ...
    >>> len(calibration.brief()) <= len(calibration.blocks())
    True
    >>> sorted(calibration.to_json())[:3]
    ['data', 'methods', 'problem']
    >>> sorted(path.name for path in calibration.files("results"))
    ['KM.parameters.csv', 'KM.robot.toml', 'result.json']
    >>> calibration.write("results")
    """

    problem: Problem
    identifications: Mapping[str, Identification]
    accuracies: Accuracies
    networks: Networks | None = None
    without_prior: Accuracy | None = None

    @property
    def identification(self) -> Identification:
        """By the last method: the one that counts."""
        return list(self.identifications.values())[-1]

    @property
    def robot(self) -> Robot:
        """Calibrated, by the last method."""
        return self.identification.robot

    @property
    def worse(self) -> str:
        """Why held-out poses are worse than before, and what to do; nothing where they are not."""
        _, before, after, held_out = judged_on(self.accuracies)
        return worse_than_before(self.identification, before, after) if held_out else ""

    def brief(self) -> Sequence[Words | Table]:
        """What counts, in at most 20 lines of 80 columns: verdict, errors before and after, three things to know.

        Returns
        -------
        Sequence[Words | Table]
            words and tables, see `casadical.core.blocks`
        """
        problem = self.problem
        return [
            Words(problem.title, "title"),
            *_prior_words(self),
            *_held_effects(problem),
            *_payload_not_in_the_model(problem),
            *_made_readings(problem),
            *list(verdict(problem, self.accuracies))[:1],
            *error_tables(self.accuracies, self.networks)[:1],
            *methods_worse(self.accuracies),
            *things_to_know(problem, self.identification, self.networks, self.accuracies),
        ]

    def blocks(self) -> Sequence[Words | Table]:
        """All that `casadical calibrate` prints, as words and tables.

        Returns
        -------
        Sequence[Words | Table]
            words and tables, see `casadical.core.blocks`
        """
        problem, last = self.problem, self.identification
        return [
            Words(problem.title, "title"),
            Words(f"{problem.robot.name}; {problem.origin}"),
            *(Words(f"note: {note}", "note") for note in problem.robot.notes),
            *_prior_words(self),
            *_held_effects(problem),
            *_payload_not_in_the_model(problem),
            *_made_readings(problem),
            *_unused_columns(problem),
            *verdict(problem, self.accuracies),
            *(Words(result.verdict) for result in self.identifications.values()),
            *methods_worse(self.accuracies),
            how_sure(last),
            *left_out_table(self.identifications),
            *error_tables(self.accuracies, self.networks),
            *(network_tables(self.networks) if self.networks else []),
            *paper_tables(problem.paper, self.accuracies, self.networks),
            *parameter_tables(last),
            held_table(last),
            *correlated(last),
        ]

    def __repr__(self) -> str:
        method, before, after, held_out = judged_on(self.accuracies)
        poses = f"{after.n} {'held-out poses' if held_out else 'poses, not held out'}"
        change = f"{mm(before.mean)} -> {mm(after.mean)} mm with {method}"
        return f"<Calibration of {self.problem.robot.name!r}: {change}, mean of {poses}>"

    def _repr_html_(self) -> str:
        """For a notebook: verdict, errors before and after, and what must be known of them."""
        method, before, after, _ = judged_on(self.accuracies)
        bars = [("before, mean", before.mean), (f"{method}, mean", after.mean), (f"{method}, 95 %", after.p95)]
        return html(self.brief(), bars)

    def report(self) -> RenderableType:
        """What `casadical calibrate` prints, for a console of rich.

        Returns
        -------
        RenderableType
            to be printed by rich
        """
        return terminal(self.blocks())

    def __str__(self) -> str:
        return plain_text(self.blocks())

    def to_json(self) -> dict[str, Any]:
        """The same as plain data: per method and set the error figures, per parameter value, error, unit, status.

        Returns
        -------
        dict[str, Any]
            what `casadical calibrate --json` writes
        """
        problem = self.problem
        usual = {method: usual_held_out(problem, r.robot) for method, r in self.identifications.items()}
        found: dict[str, Any] = {
            "problem": problem.folder.name,
            "title": problem.title,
            "data": problem.data,
            "robot": problem.robot.name,
            "tables": [dict(table) for table in problem.tables],
            "methods": {
                method: {
                    "verdict": result.verdict,
                    "optimal": result.is_optimal(),
                    "condition": result.identifiability.condition,
                    "degrees_of_freedom": result.degrees_of_freedom,
                    "iterations": len(result.solution.history) - 1,
                    "loss": result.loss,
                    "left_out": [
                        {"source": out.source, "row": out.row, "error_mm": 1e3 * out.error} for out in result.left_out
                    ],
                    "sets": {
                        name: {
                            **_as_mm(states["calibrated"]),
                            "before_nominal": _as_mm(states["nominal"]),
                            "before_placed": _as_mm(states["placed"]),
                            **({"without_far_off": _as_mm(usual[method][name])} if name in usual[method] else {}),
                        }
                        for name, states in self.accuracies[method].items()
                    },
                    "parameters": [_parameter(row) for row in result.shown.to_dict("records")],
                    "modified_dh": modified_dh(result.robot),
                }
                for method, result in self.identifications.items()
            },
        }
        if self.networks:
            found["trained_on"] = self.networks.trained_on
            found["networks"] = {name: _network(result) for name, result in self.networks.results.items()}
        if problem.prior:
            found["prior"] = problem.prior.to_json([m for _, m in problem.parts()])
            if self.without_prior is not None:
                found["prior"]["without_mean_mm"] = 1e3 * self.without_prior.mean
        if problem.paper:
            paper = {"calibration": problem.paper.calibration, "validation": problem.paper.validation}
            found["paper"] = {"source": problem.paper.source} | {
                name: {m: dict(zip(("mean_mm", "max_mm", "std_mm"), f, strict=True)) for m, f in table.items()}
                for name, table in paper.items()
            }
        return found

    def files(self, folder: str | Path) -> dict[Path, str]:
        """What is kept, by file: all figures, of each method the robot and its parameters, or the compensator.

        Parameters
        ----------
        folder : str | Path
            where they are to be

        Returns
        -------
        dict[Path, str]
            path -> text
        """
        folder, problem = Path(folder), self.problem
        texts = {folder / "result.json": json_text(self.to_json())}
        for name, trained in (self.networks.results if self.networks else {}).items():
            if trained.compensator is not None:
                texts[folder / f"{name}.compensator.json"] = compensator_text(trained.compensator)
        for name, result in self.identifications.items():
            origin = f"Calibrated by casadical, method {name}, from {problem.title} ({problem.origin})."
            robot = with_knowledge(result)
            said = [words.text for words in _made_readings(problem) if words.text not in robot.notes]
            noted = replace(robot, notes=(*robot.notes, *said))
            texts[folder / f"{name}.robot.toml"] = to_toml(noted, f"{origin}\n{result.verdict}")
            if problem.urdf:
                texts[folder / f"{name}.robot.urdf"] = problem.calibrated_urdf(result.robot)
            texts[folder / f"{name}.parameters.csv"] = result.parameters.to_csv(index=False)
        return texts

    def write(self, folder: str | Path) -> None:
        """Write `files`: all of them or none.

        Parameters
        ----------
        folder : str | Path
            where to; made when missing

        Raises
        ------
        InputError
            where one cannot be written
        """
        with claimed([folder]):
            write_together(self.files(folder))


def with_knowledge(found: Identification) -> Robot:
    """The calibrated robot with its covariance, and the bound of the error that remains, where poses are enough."""
    robot = (
        found.robot
        if found.robot.effects
        else replace(found.robot, knowledge=replace(found.knowledge, misfit=misfit_of(found)))
    )
    with suppress(InputError):
        return replace(robot, bound=learn_bound(found))
    return robot


def calibrate(
    problem: str | Path | Problem,
    *,
    method: str | None = None,
    loss: str | None = None,
    seed: int | None = None,
    carried: Carried | None = None,
    show: Callable[[str], None] = lambda _text: None,
) -> Calibration:
    """Identify a problem's robot by each of its methods, and train its networks on what is left.

    Parameters
    ----------
    problem : str | Path | Problem
        its folder, or what `read_problem` gave
    method : str, optional
        in place of the problem's own; a network method needs SKCM, which is then identified too
    loss : str, optional
        in place of the problem's own
    seed : int, optional
        of the split into sets and of the networks; of a folder only
    carried : Carried, optional
        what puts the prior of another campaign into the robot, `lambda robot: carry_over(robot, other)`; of a folder
        only
    show : Callable[[str], None], optional
        called with a line of progress

    Returns
    -------
    Calibration
        results of all methods and networks

    Raises
    ------
    InputError
        a file of the problem is not usable, or a method does not exist
    ConvergenceError
        Ipopt finds no optimum of a method

    Examples
    --------
    >>> calibration = casadical.calibrate("problems/planar")
    >>> calibration.identification.method
    'KM'
    """
    if method is not None and method not in all_methods():
        raise InputError(f"--method {method}: not known; allowed: {', '.join(all_methods())}")
    if loss is not None and loss not in PROBLEM_LOSSES:
        raise InputError(f"--loss {loss}: not known; allowed: {', '.join(PROBLEM_LOSSES)}")
    plain = None
    if not isinstance(problem, Problem):
        folder = problem
        problem = read_problem(folder, seed, carried or as_it_is)
        plain = read_problem(folder, seed) if problem.prior else None
    elif seed is not None:
        raise InputError(f"seed {seed}: this problem is split into sets already; give the seed to read_problem")
    elif carried is not None:
        raise InputError("prior: this problem is read already; give the prior with its folder")
    if loss is not None:
        problem = replace(problem, loss=loss)
    if method is not None:
        networks = () if method in BASE_METHODS else (method,)
        problem = replace(problem, methods=base_methods([method]), networks=networks)
    for fault in (*unfitted(problem.sets), unnamed_targets(problem)):
        if fault:
            raise InputError(fault)
    for _, m in problem.parts():  # held-out poses count in the figures, so that they are checked like the others
        check_against(problem.robot, m)
    count = (problem.loss == "auto") + len(problem.methods) + len(problem.networks)
    results = _identified(problem, show, count)
    used = used_poses(problem, results)
    trained = None
    if problem.networks:

        def progress(text: str) -> None:
            part = count - len(problem.networks) + 1 + problem.networks.index(text.split()[0])
            show(f"part {part} of {count}: {text}")

        skcm, names = results["SKCM"], problem.networks
        trained = train_networks(problem, skcm, names, seed=problem.seed, show=progress, judged=used)
    accuracies = {k: {name: result.accuracy(m) for name, m in used.items()} for k, result in results.items()}
    without = _without_prior(plain, results) if plain else None
    return Calibration(problem, results, accuracies, trained, without)


def _identified(problem: Problem, show: Callable[[str], None], count: int) -> dict[str, Identification]:
    """By each method. With loss auto, the last method, which models most, says which poses are outliers.

    count : of parts of the work, for lines of progress
    Where none is, the result is the least squares of all poses, as if none had been sought.
    """
    sets, last = problem.sets["identify"], problem.methods[-1]
    parts = iter(range(1, count + 1))

    def by(method: BaseMethod, loss: Loss, among: Sequence[Measurements] = sets, screen: bool = True) -> Identification:
        part = next(parts)

        def progress(iteration: int, cost: float) -> None:
            show(f"part {part} of {count}: {method} iteration {iteration}, cost {cost:.6g}")

        return identify(
            problem.robot, among, method=method, loss=loss, prior=problem.prior, screen=screen, progress=progress
        )

    if problem.loss != "auto":
        return {method: by(method, problem.loss) for method in problem.methods}
    robust = by(last, "huber")
    if not robust.outliers:
        return {method: by(method, "linear") for method in problem.methods}
    kept = without_poses(sets, robust.outliers)
    others = {method: by(method, "huber", kept, screen=False) for method in problem.methods[:-1]}
    return {
        **{method: replace(r, measurements=sets, outliers=robust.outliers) for method, r in others.items()},
        last: robust,
    }


def _without_prior(plain: Problem, results: Mapping[str, Identification]) -> Accuracy | None:
    """Of held-out poses, by the last method, as if there were no prior; plain : the problem without it."""
    method, found = list(results.items())[-1]
    held_out = next((m for name, m in plain.parts() if name.startswith("report")), None)
    if held_out is None:
        return None
    kept = without_poses(plain.sets["identify"], found.outliers)
    alone = identify(plain.robot, kept, method="KM" if method == "KM" else "SKCM", loss=found.loss, screen=False)
    return alone.accuracy(held_out)["calibrated"]


def used_poses(problem: Problem, results: Mapping[str, Identification]) -> dict[str, Measurements]:
    """Every set by name, without the poses that any method left out: all methods are judged on the same poses."""
    out = {place for result in results.values() for place in result.outliers}
    kept = iter(without_poses(problem.sets["identify"], out))
    return {name: next(kept) if name.split("/")[0] == "identify" else m for name, m in problem.parts()}


def _prior_words(found: Calibration) -> list[Words]:
    problem, without = found.problem, found.without_prior
    if problem.prior is None:
        return []
    whole = [m for _, m in problem.parts()]
    words = [Words(problem.prior.in_words(whole), "warning" if problem.prior.learnt_from(whole) else "note")]
    if without is None:
        return words
    _, _, after, held_out = judged_on(found.accuracies)
    text = f"Without the prior the mean error {'of these held-out poses' if held_out else ''} is {mm(without.mean)} mm"
    worse = after.mean > without.mean + chance_of(without, after)
    doubt = f", with it {mm(after.mean)} mm: the robot may have changed since; leave out --prior" if worse else ""
    return [*words, Words(f"{' '.join(text.split())}{doubt}.", "warning" if worse else "note")]


def _held_effects(problem: Problem) -> list[Words]:
    text = "Effects of the robot file are in the model, held at their values:"
    carried = problem.prior.labels if problem.prior else ()
    robot = problem.robot.with_only(e for e in problem.robot.effects if e.label not in carried)
    return [Words(f"{text} {robot.effects_in_words}.", "note")] if robot.effects else []


def _payload_not_in_the_model(problem: Problem) -> list[Words]:
    """That the tables name a payload whose weight the robot file does not let into the model."""
    carried = [m.conditions["payload_kg"] for _, m in problem.parts() if "payload_kg" in m.conditions]
    gives = any(j.compliance is not None for j in problem.robot.joints)
    if problem.robot.payload is not None or not gives or not any(np.any(p != 0) for p in carried):
        return []
    text = "The tables log a payload (payload_kg), but the robot file has no [payload] with its mass centre (com_mm): "
    return [Words(f"{text}its weight is not in the model. Add it to the robot file.", "warning")]


def _made_readings(problem: Problem) -> list[Words]:
    """Joint readings that problem.toml turns round or shifts: the controller's own are others than the model's."""
    columns = {name: made for table in problem.tables for name, made in dict(table.get("columns", {})).items()}
    changed = []
    for name, made in sorted(columns.items()):
        if re.fullmatch(r"q\d+(_\w+)?", name) and isinstance(made, Mapping):
            times, plus = float(made.get("times", 1.0)), float(made.get("plus", 0.0))
            if times < 0 or plus or made.get("add"):
                of = f"{'-' if times < 0 else ''}'{shown(made['from'])}'"
                more = "".join(
                    f" {factor:+g} x '{shown(other)}'" for other, factor in dict(made.get("add", {})).items()
                )
                changed.append(f"{name.partition('_')[0]} = {of}{more}{f' {plus:+g}' if plus else ''}")
    if not changed:
        return []
    text = f"The model's readings are made by problem.toml: {', '.join(changed)}. The robot file, the C and programs"
    return [Words(f"{text} take the model's, not the controller's.", "warning")]


def _unused_columns(problem: Problem) -> list[Words]:
    """Columns that the tables have and the calibration does not use, and rows that it counts once."""
    used = {*problem.robot.conditions, "pose", "time_s", "point"}
    left = {name: m.source for _, m in problem.parts() for name in (*m.conditions, *m.unused) if name not in used}
    left = {name: source for name, source in left.items() if not name.startswith(("tool_", "session_"))}
    left.pop(problem.set_column or "", None)
    copies = [Words(text, "note") for text in dict.fromkeys(m.copies_in_words for _, m in problem.parts()) if text]
    if not left:
        return copies
    text = f"Columns that are not used: {', '.join(map(shown, left))} (in {', '.join(sorted(set(left.values())))})."
    return [Words(text, "note"), *copies]


def _network(result: NetworkResult) -> dict[str, Any]:
    """One network method: its verdict, the errors by set as it is used, and as trained even where it was refused."""
    found: dict[str, Any] = {"verdict": result.verdict, "helps": result.helps}
    c = result.compensator
    if c is None:
        return found
    parts = {"train": c.training, "choose": c.choice, "report": c.validation}
    return found | {
        "trainer": c.trainer,
        "settings": c.settings,
        "seed": c.seed,
        "chosen_by": c.chosen_by,
        "sets": {name: _as_mm(a) for name, a in result.errors.items()},
        "as_trained": {name: asdict(part) for name, part in parts.items() if part},
    }


def _as_mm(a: Accuracy) -> dict[str, float | int]:
    return {name if name == "n" else f"{name}_mm": v if name == "n" else 1e3 * v for name, v in asdict(a).items()}


def _parameter(row: dict[Any, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in row.items()}
