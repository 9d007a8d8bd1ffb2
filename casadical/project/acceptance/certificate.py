"""Calibration certificate data: what was measured, how, with which uncertainty, and the decision.

They have the form that an auditor asks for, and never state that a laboratory is accredited.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import date
from functools import cache
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from casadical.core.basics import Array, InputError
from casadical.core.reading import load_json, load_toml
from casadical.core.reporting.blocks import Page, Section, Table, Words, mm
from casadical.core.reporting.figure import Axis, Figure, Series
from casadical.core.reporting.page import provenance_of
from casadical.core.reporting.pdf import pdf_of
from casadical.core.reporting.plain import WRITTEN, Key, written
from casadical.core.reporting.result import Result
from casadical.core.schema import LENGTH, WHOLE_NUMBER, TomlTable, check
from casadical.identification.accuracy import errors
from casadical.identification.plausibility import check_against
from casadical.identification.result import LeftOut, rows_in_words
from casadical.project.acceptance.budget import Budget, budget_of, repeats_of
from casadical.project.acceptance.iso9283 import Iso9283
from casadical.project.acceptance.verification import iso9283 as iso9283_test
from casadical.project.acceptance.verification import problem_of
from casadical.project.calibration import calibrate, with_knowledge
from casadical.project.problem import Problem, read_problem
from casadical.project.problem_file import result_in
from casadical.robot.robot_file import read_robot

# A text of certificate.toml that fits on the page.
Text = Annotated[str, Field(max_length=300)]
# A number of certificate.toml, zero or positive.
Positive = Annotated[float, Field(ge=0.0, le=1e6)]


class InstrumentTable(TomlTable):
    """[instrument] of certificate.toml: the instrument, one sigma of its noise [m] and scale."""

    name: Text = ""
    serial: Text = ""
    calibrated: Text = ""
    traceability: Text = ""
    noise: Annotated[float | None, LENGTH] = None
    scale_um_per_m: Positive = 0.0


class ConditionsTable(TomlTable):
    """[conditions] of certificate.toml; `range_K` is half the range of temperatures in use."""

    place: Text = ""
    temperature_degC: Annotated[float | None, Field(ge=-273.15, le=1e4)] = None
    range_K: Positive = 0.0
    expansion_um_per_m_K: Positive = 12.0
    repeatability: Annotated[float | None, LENGTH] = None


class DecisionTable(TomlTable):
    """[decision] of certificate.toml: the tolerance of the rms position error [m], or None."""

    tolerance: Annotated[float | None, LENGTH] = None


class Details(TomlTable):
    """The contents of certificate.toml."""

    casadical: Annotated[Literal[1], WHOLE_NUMBER]
    language: Literal["en", "de"] = "en"
    number: Text = ""
    issued: Text = ""
    issuer: Text = ""
    customer: Text = ""
    operator: Text = ""
    robot_serial: Text = ""
    measured_on: Text = ""
    remarks: Annotated[list[Text], Field(max_length=6)] = Field(default_factory=list)
    instrument: InstrumentTable = Field(default_factory=InstrumentTable)
    conditions: ConditionsTable = Field(default_factory=ConditionsTable)
    decision: DecisionTable = Field(default_factory=DecisionTable)

    @property
    def stated_uncertainties(self) -> dict[str, float]:
        """Return the stated standard uncertainties by their names in `budget_of` [SI], 0 if not stated.

        The temperature range is the half-width of a rectangular distribution. Raises InputError for
        a value of zero or less.
        """
        c, i = self.conditions, self.instrument
        stated = {"instrument.noise": i.noise, "conditions.repeatability": c.repeatability}
        for name, value in {**stated, "decision.tolerance": self.decision.tolerance}.items():
            if value is not None and value <= 0:
                raise InputError(f"{name}_mm = {1e3 * value:g}: it must be above zero, or left out")
        # Uncertainties in um/m, as a share.
        per_million = 1e-6
        growth = per_million * c.expansion_um_per_m_K * c.range_K / np.sqrt(3)
        noise, scale = i.noise or 0.0, per_million * i.scale_um_per_m
        return {"noise": noise, "scale": scale, "repeatability": c.repeatability or 0.0, "growth": float(growth)}


@dataclass(frozen=True, eq=False)
class Certificate(Result):
    """Certificate data of a robot's calibration.

    problem : calibrated problem
    method : method by which the robot was calibrated
    details : what the operator stated
    before : uncertainty budget of the nominal robot, base and tool fitted
    after : uncertainty budget of the calibrated robot
    places : held-out positions in the robot's base frame, shape (n, 3) [m]
    files_ : paths of the files from which it was made
    iso9283 : figures of a test by ISO 9283, None without one
    refit : number of poses to which the robot file was fitted once it was judged; 0: the file's
        robot is the one that was judged
    left_out : held-out rows that the calibration called outliers; they are in no figure
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("certificate", "details.number"),
        Key("robot", "problem.robot.name"),
        Key("data", "problem.data"),
        Key("decision"),
        Key("missing"),
    )

    problem: Problem
    method: str = field(metadata=WRITTEN)
    details: Details = field(metadata=WRITTEN)
    before: Budget = field(metadata=WRITTEN)
    after: Budget = field(metadata=WRITTEN)
    places: Array
    files_: tuple[Path, ...]
    iso9283: Iso9283 | None = field(default=None, metadata=WRITTEN)
    refit: int = field(default=0, metadata=written("refit_poses"))
    left_out: tuple[LeftOut, ...] = field(default=(), metadata=WRITTEN)

    report: ClassVar[str] = "certificate.j2"

    @property
    def decision(self) -> Literal["", "conforms", "open", "fails"]:
        """Return the decision with guard band: conforms, fails or open; "" without a tolerance.

        The robot conforms where E + U is within the tolerance, and fails where E is resolved and
        E - U is beyond it.
        """
        tolerance, after = self.details.decision.tolerance, self.after
        if tolerance is None:
            return ""
        if after.error + after.expanded <= tolerance:
            return "conforms"
        return "fails" if after.resolved and after.error - after.expanded > tolerance else "open"

    @property
    def missing(self) -> list[str]:
        """Return the names of statements that are missing, such as "traceability".

        For each, the words of the certificate have a sentence, `no_NAME`.
        """
        d = self.details
        stated = {line.source: line.stated for line in self.after.lines}
        given = {
            "traceability": d.instrument.traceability,
            "calibrated": d.instrument.calibrated,
            "noise": stated["instrument"] or stated["repeatability"],
            "repeatability": stated["repeatability"],
            "temperature": d.conditions.temperature_degC is not None,
            "tolerance": d.decision.tolerance is not None,
        }
        return [key for key, value in given.items() if not value]

    def pages(self) -> list[Page]:
        """Return the two pages of the certificate."""
        w, d = words_of(self.details.language), self.details
        badge = (w["data"], f"casadical, {w['number']} {d.number or '-'}")
        both = (("before", self.before), ("after", self.after))
        errors = [(w[name], b.stated, mm(b.rms), mm(b.worst), str(b.n)) for name, b in both]
        head = ("", w["error"], w["rms"], w["worst"], "n")
        results = Table("", head, errors, frozenset({2, 3, 4}), frozenset({1}))
        first = (
            Section(w["object"], [self._fields(w)]),
            Section(w["results"], [results, Words(w["measurand"]), *self._refit(w)]),
            Section(w["decided"], self._decided(w)),
            Section(w["unstated"], [Words(w[f"no_{key}"], "warning") for key in self.missing] or [Words(w["all"])]),
        )
        figures = [self._picture(w, k) for k in (0, 1)]
        factor, freedom = f"{self.after.factor:.2f}", _many(self.after.freedom)
        expanded = w["expanded"].format(k=factor, freedom=freedom)
        second = [
            Section(w["budget"], [self.budget_table(w), Words(w["formula"]), Words(expanded)]),
            Section(w["pictures"], figures),
        ]
        if iso := self.iso9283:
            drift = f"dAP = {mm(iso.drift[0])} mm, dRP = {mm(iso.drift[1])} mm. " if iso.drift else ""
            model_note = "" if iso.model is None else w["iso_model"].format(model=mm(iso.model))
            iso_blocks: list[Words | Table] = [replace(iso.table(), title=""), Words(drift + model_note + w["iso"])]
            second.append(Section("ISO 9283:1998", iso_blocks))
        files = provenance_of(self.files_)["files"]
        rows = [(Path(path).name, code[:32]) for path, code in files.items()]
        second.append(Section(w["files"], [Table("", (w["file"], "SHA-256 (32)"), rows)]))
        title = f"{w['title']}: {self.problem.robot.name}"
        return [
            Page("Certificate", heading, w["about"], sections, badges=badge)
            for heading, sections in ((title, first), (w["second"], second))
        ]

    def pdf(self) -> bytes:
        """Return the PDF file of the two pages. Raises InputError for an invalid date of issue."""
        day = None
        if self.details.issued:
            try:
                day = date.fromisoformat(self.details.issued)
            except ValueError:
                raise InputError(f"issued = {self.details.issued!r}: write the day as 2026-03-14") from None
        return pdf_of(self.pages(), language=self.details.language, day=day)

    @property
    def findings(self) -> list[Words | Table]:
        """Return the decision, the budget and the missing statements, in English."""
        w = words_of("en")
        missing = [Words(w[f"no_{key}"], "warning") for key in self.missing]
        return [*self._refit(w), *self._decided(w), self.budget_table(w), *missing]

    def _fields(self, w: Mapping[str, str]) -> Table:
        """Return the table of certificate number, robot, operator, instrument, place and method."""
        d, c, i = self.details, self.details.conditions, self.details.instrument
        degrees = "" if c.temperature_degC is None else f"{c.temperature_degC:g} °C, +- {c.range_K:g} K"
        made_by = f"casadical {provenance_of(())['versions']['casadical']}"
        method = f"{self.method} ({w[self.method] if self.method in w else w['other']}), {made_by}"
        low, high = 1e3 * self.places.min(axis=0), 1e3 * self.places.max(axis=0)
        span = ", ".join(f"{c} {a + 0.0:.0f} .. {b:.0f}" for c, a, b in zip("xyz", low, high, strict=True))
        rows = [
            (w["number"], d.number),
            (w["issued"], d.issued),
            (w["issuer"], d.issuer),
            (w["customer"], d.customer),
            (w["robot"], f"{self.problem.robot.name}, {w['serial']} {d.robot_serial or '-'}"),
            (w["measured"], f"{d.measured_on}, {d.operator}".strip(", ")),
            (w["origin"], w[self.problem.data or "unstated_origin"]),
            (w["instrument"], f"{i.name or w['not_stated']}, {w['serial']} {i.serial or '-'}"),
            (w["calibrated"], i.calibrated),
            (w["traceability"], i.traceability),
            (w["place"], c.place),
            (w["temperature"], degrees),
            (w["method"], method),
            (w["space"], w["space_of"].format(n=self.after.n, span=span)),
            *((w["remark"], text) for text in d.remarks),
        ]
        return Table("", ("", ""), [(name, text or w["not_stated"]) for name, text in rows])

    def _refit(self, w: Mapping[str, str]) -> list[Words]:
        """Return notes on outliers among the held-out rows and on the later fit to all poses."""
        rows = rows_in_words(self.left_out).replace("row", w["row"])
        out = [Words(w["left_out"].format(rows=rows), "warning")] if self.left_out else []
        return [*out, *([Words(w["refit"].format(n=self.refit))] if self.refit else [])]

    def _decided(self, w: Mapping[str, str]) -> list[Words | Table]:
        """Return sentences on the decision and its rule, or that there is no tolerance."""
        if not self.decision:
            return [Words(w["no_decision"])]
        tolerance = mm(self.details.decision.tolerance or 0.0)
        given = {"T": tolerance, "U": mm(self.after.expanded), "E": mm(self.after.error)}
        return [Words(w[self.decision].format(**given), "verdict"), Words(w["rule"].format(**given))]

    def budget_table(self, w: Mapping[str, str]) -> Table:
        """Return the uncertainty budget as a table, one row for each source.

        A row has the contribution to E^2 [mm^2], its standard uncertainty [mm^2], degrees of
        freedom, and its share in u(E) [mm].

        w : words of the certificate's language
        """
        after = self.after
        rows = [(w["mean_square"], "", f"{1e6 * after.rms**2:.4g}", "", "", "")]
        rows += [
            (
                w[f"of_{line.source}"] + (f" ({w['not_stated']})" if not line.stated else ""),
                line.kind,
                f"{1e6 * line.square:+.3g}" if line.square else "0",
                f"{1e6 * line.u:.2g}",
                _many(line.freedom),
                mm(after.u(line)) if after.resolved else "-",
            )
            for line in after.lines
        ]
        square, u_square = f"{1e6 * after.square:.4g}", f"{1e6 * after.u_square:.2g}"
        u = mm(after.u()) if after.resolved else "-"
        factor, error = f"k = {after.factor:.2f}", f"E = {mm(after.error)} mm"
        rows += [
            ("E, u(E)", "", square, u_square, _many(after.freedom), u),
            ("E, U = k u(E)", factor, error, "", "", mm(after.expanded)),
        ]
        head = (w["source"], w["type"], w["adds"], w["u_square"], w["freedom"], w["share"])
        return Table("", head, rows, frozenset({2, 3, 4, 5}), frozenset({len(rows) - 1}))

    def _picture(self, w: Mapping[str, str], k: int) -> Figure:
        """Return a figure of the held-out poses in the base frame, coloured by error over rms.

        They are seen from the side, or from above where their heights are equal.
        """
        e, most = (self.before, self.after)[k].errors, (1.0, 2.0, 3.0)
        rms = float(np.sqrt(np.mean(e**2)))
        roles = ("sky", "blue", "orange", "red")
        colour = [roles[int(np.searchsorted(most, v / rms))] for v in e]
        x, y, z = self.places.T
        # Poses whose heights differ by less than this share of their extent are shown from above.
        flat = np.ptp(z) < 0.02 * np.ptp(self.places)
        r, up = (x, y) if flat else (np.hypot(x, y), z)
        order = np.argsort(e)
        series = Series("points", 1e3 * r[order], 1e3 * up[order], colour=[colour[i] for i in order])
        name = w[("before", "after")[k]]
        title = f"{name}: rms {mm(rms)} mm"
        across, height = ("x [mm]", "y [mm]") if flat else (w["distance"], w["height"])
        return Figure(name, title, [series], Axis(across), Axis(height), caption=w["caption"])


@cache
def words_of(language: Literal["en", "de"]) -> Mapping[str, str]:
    """Return the words and sentences of a certificate in a language, by their keys."""
    text = Path(__file__).with_name("certificate_words.toml").read_text(encoding="utf-8")
    words: dict[str, dict[str, str]] = tomllib.loads(text)
    return words[language]


def _many(freedom: float) -> str:
    """Return degrees of freedom as text, "> 1000" for many."""
    return f"{freedom:.0f}" if freedom < 1000 else "> 1000"


def certificate(
    results: str | Path,
    details: str | Path | None = None,
    *,
    problem: str | Path | None = None,
    iso9283: str | Path | None = None,
) -> Certificate:
    """Return certificate data of a calibration's results.

    results : folder as `casadical calibrate --out` writes it, or the robot file in it
    details : certificate.toml; None: nothing is stated
    problem : folder that was calibrated; None: as result.json names it (see `problem_of`)
    iso9283 : table of a test, as `casadical plan --iso9283` plans it
    Raises InputError: results and measurements that do not belong together, no held-out positions,
        details that cannot be.
    """
    place = result_in(Path(results))
    said = Details(casadical=1) if details is None else check(Details, load_toml(details), str(details))
    folder = Path(problem) if problem is not None else problem_of(place)
    if folder is None:
        raise InputError(f"{place}: the problem folder that was calibrated is not beside it; name it with --problem")
    stated = load_json(place.parent / "result.json")
    calibrated, robot, method = read_problem(folder), read_robot(place), place.name.removesuffix(".robot.toml")
    figures = dict(stated.get("methods", {}).get(method, {}).get("sets", {}))
    out = [
        LeftOut(str(row["source"]), int(row["row"]), 1e-3 * float(row["error_mm"]), str(row["column"]))
        for row in figures.get("report", {}).get("left_out", ())
    ]
    sets = [m.positions_alone() for m in calibrated.sets.get("report", ()) if m.position is not None]
    wrong = {(row.source, row.row) for row in out}
    sets = [m[[k for k, row in enumerate(m.row) if (m.source, int(row)) not in wrong]] for m in sets]
    if not sets:
        raise InputError(f"{folder}: no measured positions were held out; a certificate needs [sets] report")
    refit = int(stated.get("refit_poses", 0))
    if refit:  # the file's robot has seen the held-out poses: the one before the refit is judged
        robot = with_knowledge(calibrate(replace(calibrated, whole=()), method=method).identification)
    report = figures.get("report", {})
    n, mean = report.get("n"), report.get("mean_mm")
    held_out = np.concatenate([errors(robot, m) for m in sets])
    # The mean errors of results and measurements of the same calibration agree to rounding.
    if not isinstance(mean, int | float) or (
        n == len(held_out) and abs(1e3 * held_out.mean() - mean) > 1e-3 * mean + 1e-5
    ):
        given = f"{mean:.4f}" if isinstance(mean, int | float) else "none"
        raise InputError(
            f"{place.parent / 'result.json'}: its held-out poses have a mean error of {given} mm, "
            f"the measurements give {1e3 * held_out.mean():.4f} mm: they were measured, split "
            "(--seed) or calibrated otherwise (--loss, --prior); calibrate again as problem.toml says"
        )
    if n != len(held_out):
        path = place.parent / "result.json"
        raise InputError(f"{path}: {n} held-out poses, the problem has {len(held_out)}")
    for m in sets:
        check_against(calibrated.robot, m)
    every = [m for parts in calibrated.sets.values() for m in parts]
    repeats, stated = repeats_of(robot, every), said.stated_uncertainties
    nominal = budget_of(calibrated.robot, sets, repeats, ("base", "tool"), **stated)
    own = budget_of(robot, sets, repeats, ("base",), **stated)
    p = np.concatenate([m.position for m in sets if m.position is not None])
    T = robot.base.T
    iso = iso9283_test(place, [iso9283]) if iso9283 else None
    tables = [path for t in calibrated.tables if (path := folder / str(t["file"])).is_file()]
    files = (place, place.parent / "result.json", *tables, *(Path(p) for p in (details, iso9283) if p))
    return Certificate(
        calibrated, method, said, nominal, own, (p - T[:3, 3]) @ T[:3, :3], files, iso, refit, tuple(out)
    )
