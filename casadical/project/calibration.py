"""Calibration of a problem by its methods: identified robots, networks, accuracies and files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from casadical.compensator.saving import compensator_text
from casadical.core.basics import ConvergenceError, InputError, Show, silent
from casadical.core.files import claimed, json_text, write_together
from casadical.core.reporting.blocks import Block, Page, Words, mm, next_step
from casadical.core.reporting.figure import Figure
from casadical.core.reporting.plain import Key, plain
from casadical.core.reporting.result import Result, html, plain_text
from casadical.identification.accuracy import Accuracy
from casadical.identification.arm_or_camera import ArmOrCamera, arm_or_camera
from casadical.identification.figures import fit_quality, parameter_tables
from casadical.identification.identification import (
    AnyPriors,
    calibrated,
    calibrated_without_outliers,
    identify,
    lacks_declared_compliance,
    prepare,
    with_all_joints_compliant,
    with_compliance_if_supported,
)
from casadical.identification.misfit import misfit_of
from casadical.identification.plausibility import check_against
from casadical.identification.remaining_errors import learn_remaining
from casadical.identification.residuals import ALL_LOSSES
from casadical.identification.result import Identification
from casadical.identification.solver import Progress
from casadical.measurements.measurements import Measurements, without_poses
from casadical.project import outcome
from casadical.project.calibration_page import calibration_figures, calibration_page, residual_localisation
from casadical.project.hand_eye import HandEye, hand_eye_of
from casadical.project.networks import Networks, train_networks
from casadical.project.outcome import Accuracies, error_tables, judged_on, network_tables, paper_tables
from casadical.project.problem import Carried, Problem, error_groups, nothing_carried, read_problem
from casadical.project.problem_file import BASE_METHODS, CameraErrorsTable, all_methods, base_methods
from casadical.robot.robot import Robot
from casadical.robot.robot_file import robot_files

if TYPE_CHECKING:
    from casadical.diagnosis.localisation import Localisation


@dataclass(frozen=True, eq=False)
class Calibration(Result):
    """The result of a calibration: identified robots, their accuracies, trained networks.

    problem : the calibrated problem with its measurements
    identifications : identifications by method (KM, SKCM); the last one is the result; SKCM is
        absent where an undeclared compliance does not show in the data (see `_identified`)
    accuracies : error statistics by method, by set (of several tables SET/KIND over all tables of
        the kind, and SET/KIND/FILE of each of them), by state: "nominal", "placed" (base and tool
        fitted), "calibrated"
    networks : networks trained on the residual of SKCM, None where the problem lists none
    without_prior : accuracy of the last method on the held-out poses if identified without the
        prior; None without a prior, held-out poses or enough poses
    refitted : by method, identifications from all poses of the tables, which are written where the
        problem says so (`refit`); accuracies, figures and sentences are of `identifications`, which
        have not seen the held-out poses
    corrected : judgement by which errors of the camera were taken off all poses; None where none of
        them was sure

    Examples
    --------
    >>> figures = calibration.accuracies["KM"]["report"]
    >>> round(1e3 * figures["placed"].mean, 2), round(1e3 * figures["calibrated"].mean, 4)  # mm
    (1.7, 0.0254)
    >>> print(calibration)  # doctest: +ELLIPSIS
    Planar arm of two links, to be read in five minutes
    Planar arm of two links; synthetic data
    On 15 poses that were held out, the mean position error falls from 1.696 mm to
    ...
    >>> len(calibration.brief()) <= len(calibration.blocks())
    True
    >>> sorted(calibration.to_json())[:3]
    ['data', 'kinds', 'methods']
    >>> sorted(path.name for path in calibration.files("results"))
    ['KM.parameters.csv', 'KM.robot.toml', 'result.json']
    >>> calibration.write("results")
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("problem", "problem.folder.name"),
        Key("title", "problem.title"),
        Key("data", "problem.data"),
        Key("robot", "problem.robot.name"),
        Key("tables", "problem.tables"),
        Key("kinds", "_kinds"),
        Key("methods", lambda c: {method: c._method(method) for method in c.identifications}),
        Key("compliance_tried", "identification.tried", omit_none=True),
        Key("hand_eye", omit_none=True),
        Key("hand_eye_nominal", omit_none=True),
        Key("arm_or_camera", omit_none=True),
        Key("refit_poses", lambda c: sum(map(len, c.problem.whole)) if c.refitted else None, omit_none=True),
        Key("trained_on", "networks.trained_on", omit_none=True),
        Key("networks", "networks.results", omit_none=True),
        Key("prior", "_prior", omit_none=True),
        Key("paper", "problem.paper", omit_none=True),
    )

    problem: Problem
    identifications: Mapping[str, Identification]
    accuracies: Accuracies
    networks: Networks | None = None
    without_prior: Accuracy | None = None
    refitted: Mapping[str, Identification] = field(default_factory=dict)
    corrected: ArmOrCamera | None = None

    @property
    def written(self) -> Mapping[str, Identification]:
        """Return the identifications that are written, by method: refitted ones where there are."""
        return self.refitted or self.identifications

    @property
    def identification(self) -> Identification:
        """Return the identification by the last method, which is the calibration's result."""
        return list(self.identifications.values())[-1]

    @property
    def robot(self) -> Robot:
        """Return the robot calibrated by the last method, without the held-out poses."""
        return self.identification.robot

    @property
    def written_robot(self) -> Robot:
        """Return the last method's robot of `written`: with a refit, fitted to all poses."""
        return list(self.written.values())[-1].robot

    @cached_property
    def hand_eye(self) -> HandEye | None:
        """Return the hand-eye transform that is written, or None (see `hand_eye_of`)."""
        return hand_eye_of(list(self.written.values())[-1])

    @cached_property
    def hand_eye_nominal(self) -> HandEye | None:
        """Return the hand-eye transform for the nominal arm, or None (see `hand_eye_of`)."""
        return hand_eye_of(list(self.written.values())[-1], nominal=True)

    @cached_property
    def arm_or_camera(self) -> ArmOrCamera | None:
        """Return `corrected`, else which of arm and camera is wrong by the written fit, or None."""
        return self.corrected or arm_or_camera(list(self.written.values())[-1])

    @property
    def worse(self) -> str:
        """Return why errors of held-out poses have grown by more than chance, and the remedy.

        Empty where they have not, or no poses were held out.
        """
        _, before, after, held_out = judged_on(self.accuracies)
        return outcome.worse_than_before(self.identification, before, after) if held_out else ""

    def next_command(self, source: Path, tables: Sequence[Path] = (), *, written: bool = True) -> Words:
        """Return the command to run next; it plans more poses where held-out errors have grown.

        source : problem folder or robot file
        tables : tables that were given after it
        written : whether the result has been written to a folder
        """
        _, before, after, held_out = judged_on(self.accuracies)
        if held_out and after.mean > before.mean:
            from casadical.project.planning import more_poses

            return more_poses(source, self.problem.sets["identify"][0])
        if not written:
            return next_step("to keep the result", "calibrate", source, *tables, "--out", "results")
        return next_step("to learn the cause of the remaining error", "diagnose", source, *tables)

    def brief(self) -> Sequence[Block]:
        """Return the main results in about 20 lines: title, notes on the input, verdict, errors."""
        return self._report_blocks(brief=True)

    def blocks(self) -> Sequence[Block]:
        """Return the full report as text blocks and tables."""
        return self._report_blocks(brief=False)

    def _report_blocks(self, **more: Any) -> list[Block]:
        """Return the blocks of the report, by calibration.j2; more : its further values."""
        problem, last, networks = self.problem, self.identification, self.networks
        parameters = [
            fit_quality(last),
            *outcome.outlier_table(self.problem, self.identifications),
            *error_tables(problem, self.accuracies, networks),
            *(network_tables(networks) if networks else []),
            *paper_tables(problem.paper, self.accuracies, networks),
            *parameter_tables(last),
        ]
        return outcome.report_blocks(
            problem,
            self.accuracies,
            it=self,
            last=last,
            networks=networks,
            without_prior=self.without_prior,
            parameters=parameters,
            tables=error_tables(problem, self.accuracies, networks),
            things=outcome.things_to_know(problem, last, networks, self.accuracies),
            **more,
        )

    @property
    def _line(self) -> str:
        """Return the summary in the repr: robot, mean errors before and after, number of poses."""
        method, before, after, held_out = judged_on(self.accuracies)
        poses = f"{after.n} {'held-out poses' if held_out else 'poses, not held out'}"
        change = f"{mm(before.mean)} -> {mm(after.mean)} mm with {method}"
        return f" of {self.problem.robot.name!r}: {change}, mean of {poses}"

    def bars(self) -> Sequence[tuple[str, float]]:
        """Return (label, error [m]) of the bars of the notebook view, before and after."""
        method, before, after, _ = judged_on(self.accuracies)
        return [("before, mean", before.mean), (f"{method}, mean", after.mean), (f"{method}, 95 %", after.p95)]

    def _repr_html_(self) -> str:
        """Return the HTML of a notebook: verdict, errors before and after, things to know."""
        return html(self.brief(), self.bars())

    def __str__(self) -> str:
        return plain_text(self.blocks())

    @cached_property
    def where(self) -> Localisation | None:
        """Return the localisation of the residual error; None unless of one table of positions."""
        return residual_localisation(self.identification)

    def figures(self) -> dict[str, Figure]:
        """Return all figures by name: errors, workspace, localisation, parameters, fit."""
        every = calibration_figures(self.problem, self.identifications, self.networks, self.where)
        return {figure.name: figure for figure in every}

    def page(self) -> Page:
        """Return the report's page as `casadical calibrate --report` writes it."""
        found = (self.hand_eye, self.hand_eye_nominal, self.arm_or_camera)
        camera = [Words(each.in_words()) for each in found if each]
        of = (self.problem, self.identifications, self.accuracies, self.networks)
        return calibration_page(*of, self.figures(), camera)

    def _method(self, method: str) -> dict[str, Any]:
        """Return a method's results for JSON: the keys of its identification, and `sets`.

        `sets` has for each set the errors after and before, and, of sets that were not fitted, the
        outliers, which are in none of the errors.
        """
        by_set = self.problem.outliers_by_set(self.identification)
        out = {name: rows for name, (_, rows) in by_set.items()}
        groups = {name: [row for n in names for row in out[n]] for name, names in error_groups(out).items()}
        sets = {
            name: {
                **plain(states["calibrated"]),
                "before_nominal": states["nominal"],
                "before_placed": states["placed"],
                **({"left_out": groups[name]} if groups.get(name) else {}),
            }
            for name, states in self.accuracies[method].items()
        }
        return {**plain(self.written[method]), "sets": sets}

    @property
    def _prior(self) -> dict[str, Any] | None:
        """Return the prior by its JSON keys (`Prior.to_json`); None without one.

        `without_mean_mm` is the mean error of held-out poses identified without it [mm].
        """
        if not self.problem.prior:
            return None
        figures = self.problem.prior.to_json([m for _, m in self.problem.parts()])
        alone = self.without_prior
        return figures if alone is None else {**figures, "without_mean_mm": 1e3 * alone.mean}

    @property
    def _kinds(self) -> dict[str, str]:
        """Return the kind of measurement of each set, by the names in `accuracies`."""
        kinds = {name: m.kind for name, m in self.problem.parts()}
        return {name: kinds[names[0]] for name, names in error_groups(kinds).items()}

    def files(self, folder: str | Path) -> dict[Path, str | bytes]:
        """Return path -> content of the files in a folder of results.

        They are result.json, by method the robot (also as URDF if it was one) and parameters,
        compensators, and hand-eye transforms where a camera measured poses.
        """
        folder, problem = Path(folder), self.problem
        texts: dict[Path, str | bytes] = {folder / "result.json": json_text(self.to_json())}
        for name, found in {"hand_eye.calib": self.hand_eye, "hand_eye_nominal.calib": self.hand_eye_nominal}.items():
            if found:
                texts[folder / name] = found.calib_text(problem.folder.name)
        for name, trained in (self.networks.results if self.networks else {}).items():
            if trained.compensator is not None:
                texts[folder / f"{name}.compensator.json"] = compensator_text(trained.compensator)
        for name, result in self.written.items():
            origin = f"Calibrated by casadical, method {name}, from {problem.title} ({problem.origin})."
            robot = with_knowledge(result)
            made = outcome.report_blocks(problem, self.accuracies, block="made_readings")
            said = [b.text for b in made if isinstance(b, Words) and b.text not in robot.notes]
            noted = replace(robot, notes=(*robot.notes, *said))
            comment = f"{origin}\n{result.verdict}"
            texts |= robot_files(folder / f"{name}.robot.toml", noted, comment, reproducible=True)
            if problem.urdf:
                texts[folder / f"{name}.robot.urdf"] = problem.calibrated_urdf(result.robot)
            texts[folder / f"{name}.parameters.csv"] = result.parameters.to_csv(index=False)
        return texts

    def write(self, folder: str | Path) -> None:
        """Write `files`, all of them or none. Raises InputError where one cannot be written."""
        with claimed([folder]):
            write_together(self.files(folder))


def with_knowledge(found: Identification) -> Robot:
    """Return the calibrated robot with its covariance and, if poses suffice, its remaining errors.

    Robots with effects have their covariance already; to others it is added here, with its misfit
    factor.
    """
    robot = found.robot
    if not robot.effects:
        robot = replace(robot, knowledge=replace(found.knowledge, misfit=misfit_of(found)))
    with suppress(InputError):
        return replace(robot, remaining=learn_remaining(found))
    return robot


def calibrate(
    problem: str | Path | Problem,
    tables: str | Path | Sequence[str | Path] = (),
    *,
    method: str | None = None,
    loss: str | None = None,
    seed: int | None = None,
    carried: Carried | None = None,
    show: Show = silent,
) -> Calibration:
    """Identify a problem's robot by each of its methods, and train its networks on the residual.

    problem : problem folder, robot file with tables, or what `read_problem` returned
    tables : measured poses in place of the folder's own, or for a robot file (see `read_problem`)
    method : method in place of the problem's own; a network method needs SKCM, which is then
        identified too
    loss : loss in place of the problem's own
    seed : seed of the split into sets and of the networks; refused, as are `tables` and `carried`,
        where `problem` is a `Problem`
    carried : function that puts the prior of another campaign into the robot, as `carry_over` does
    show : called with each line of progress
    Raises InputError: a file of the problem is not usable, a method or loss does not exist;
        ConvergenceError: Ipopt finds no optimum of a method.

    Examples
    --------
    >>> calibration = casadical.calibrate("problems/planar")
    >>> calibration.identification.method
    'KM'
    >>> casadical.calibrate("problems/planar/robot.toml", "data/planar/planar.csv")
    <Calibration of 'Planar arm of two links': 1.680 -> 0.0242 mm with KM, mean of 12 held-out
    poses>
    """
    tables = (tables,) if isinstance(tables, (str, Path)) else tuple(tables)
    if method is not None and method not in all_methods():
        raise InputError(f"--method {method}: unknown; allowed: {', '.join(all_methods())}")
    if loss is not None and loss not in ALL_LOSSES:
        raise InputError(f"--loss {loss}: unknown; allowed: {', '.join(ALL_LOSSES)}")
    plain = None
    if not isinstance(problem, Problem):
        folder = problem
        problem = read_problem(folder, seed, carried or nothing_carried, tables)
        plain = read_problem(folder, seed, tables=tables) if problem.prior else None
    elif seed is not None:
        raise InputError(f"seed {seed}: this problem is split into sets already; give the seed to read_problem")
    elif carried is not None or tables:
        raise InputError("prior, tables: this problem is read already; give them with its folder")
    if loss is not None:
        problem = replace(problem, loss=loss)
    if method is not None:
        networks = () if method in BASE_METHODS else (method,)
        problem = replace(problem, methods=base_methods([method]), networks=networks)
    parts = problem.parts()
    for fault in (*problem.unfitted, problem.unnamed_targets):
        if fault:
            raise InputError(fault)
    # Held-out poses are checked like the others, as the accuracy is stated of them.
    check_against(problem.robot, *(m for _, m in parts))
    problem, corrected = _without_camera_errors(problem)
    results = _identified(problem, show, count := len(problem.methods) + len(problem.networks))
    used = problem.used_poses(results)
    sets = error_groups(used).items()
    accuracies = {k: {to: r.accuracy(*(used[n] for n in names)) for to, names in sets} for k, r in results.items()}
    refitted = _refitted(problem, results, show)
    alone = accuracy_without_prior(plain, results, used) if plain else None
    trained = None
    if problem.networks:

        def progress(text: str) -> None:
            part = count - len(problem.networks) + 1 + problem.networks.index(text.split()[0])
            show(f"part {part} of {count}: {text}")

        skcm, names = results["SKCM"], problem.networks
        inlier_sets = iter(used.values())
        inliers = replace(
            problem, sets={k: tuple(next(inlier_sets) for _ in parts) for k, parts in problem.sets.items()}
        )
        trained = train_networks(inliers, skcm, names, seed=problem.seed, show=progress)
    return Calibration(problem, results, accuracies, trained, alone, refitted, corrected)


def _without_camera_errors(problem: Problem) -> tuple[Problem, ArmOrCamera | None]:
    """Return the problem without its camera's sure errors, and what found them; or it and None."""
    sets = problem.sets["identify"]
    if len(sets) > 1 or not sets[0].camera or "camera_errors" in problem.tables[0]:
        return problem, None
    priors: AnyPriors = "auto" if problem.geometry_prior else False
    prepared = prepare(problem.robot, sets, problem.prior, method="KM")
    found = arm_or_camera(calibrated(prepared, loss=problem.loss, priors=priors))
    if not (found and found.sure):
        return problem, None
    middle = 1e3 * np.array(found.ratios.point)
    return problem.without_errors(CameraErrorsTable(**found.sure._asdict(), middle_mm=middle.tolist())), found


def _refitted(problem: Problem, results: Mapping[str, Identification], show: Show) -> dict[str, Identification]:
    """Return the identifications from all poses, by method; {} without refit, or with networks."""
    if not problem.whole or problem.networks:
        return {}
    whole = replace(
        problem, whole=(), sets={"identify": problem.whole}, methods=tuple(m for m in problem.methods if m in results)
    )
    refitted = _identified(whole, lambda text: show(f"of all poses, {text}"), len(results))
    return {method: refitted.get(method, list(refitted.values())[-1]) for method in results}


def _identified(problem: Problem, show: Show, count: int) -> dict[str, Identification]:
    """Return the identification by each method; the last one decides on outliers and compliance.

    Where the robot file declares no compliance and the data show none, SKCM is omitted if another
    method is left and no networks learn its residual. With a later refit to all poses, compliance
    that only all poses show counts, too.
    """
    robot, sets, (*others, last) = problem.robot, problem.sets["identify"], problem.methods
    priors: AnyPriors = "auto" if problem.geometry_prior else False
    parts = iter(range(1, count + 1))

    def progress_of(method: str) -> Progress:
        part = next(parts)
        return lambda iteration, cost: show(f"part {part} of {count}: {method} iteration {iteration}, cost {cost:.6g}")

    by = partial(
        identify, method=last, loss=problem.loss, priors=priors, prior=problem.prior, progress=progress_of(last)
    )
    final = by(robot, sets)
    # The fitted poses may be too few to show a compliance that all poses show.
    if problem.whole and lacks_declared_compliance(robot) and not (final.tried and final.tried.kept):
        tried = with_compliance_if_supported(prepare(robot, problem.whole, problem.prior, method="SKCM")).tried
        if tried and tried.kept:
            with suppress(InputError, ConvergenceError):
                final = replace(by(with_all_joints_compliant(robot, sets)[0], sets), tried=tried)
    results: dict[str, Identification] = {}
    for method in others:
        prepared = prepare(robot, sets, problem.prior, method=method)
        result = calibrated_without_outliers(
            prepared, final.outliers, final.loss, priors=priors, progress=progress_of(method)
        )
        results[method] = replace(result, tried=final.tried)
    rigid = lacks_declared_compliance(robot) and not (final.tried and final.tried.kept)
    if results and rigid and not problem.networks:
        return results
    return {**results, last: final}


def accuracy_without_prior(
    plain: Problem, results: Mapping[str, Identification], used: Mapping[str, Measurements]
) -> Accuracy | None:
    """Return the last method's accuracy on held-out poses if identified without the prior.

    They are those of the first kind of measurement. None where nothing was held out, or the poses
    are too few without a prior.

    plain : problem without the prior; results : identifications with it, by method
    used : poses that are judged, by set
    """
    method, last = list(results.items())[-1]
    parts = {name: m for name, m in used.items() if name.startswith("report")}
    if not parts:
        return None
    inliers = without_poses(plain.sets["identify"], last.outliers)
    try:
        alone = identify(plain.robot, inliers, method="KM" if method == "KM" else "SKCM", loss=last.loss, screen=False)
    except InputError:
        return None
    return alone.accuracy(*(parts[name] for name in next(iter(error_groups(parts).values()))))["calibrated"]
