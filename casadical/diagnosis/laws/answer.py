"""The result of a search for laws, and its report as text, tables, figures, JSON and files."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from casadical.core.basics import Array
from casadical.core.files import json_text
from casadical.core.reporting.blocks import Block, Page, Section, Table, mm
from casadical.core.reporting.figure import Axis, Figure, Series
from casadical.core.reporting.result import Result, plain_text
from casadical.core.statistics import best_of
from casadical.diagnosis.cross_validation import new_fit
from casadical.diagnosis.laws.problem import (
    Round,
    ScoredLaw,
)
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.refit import refit
from casadical.diagnosis.result import Diagnosis, Unlisted
from casadical.diagnosis.settings import SETTINGS
from casadical.effects import Effect
from casadical.effects.formula_effect import DEFAULT_TARGET_DIRECTION, SEAMS, STATION_SEAMS, Law
from casadical.identification.result import Identification
from casadical.measurements.measurements import Noise
from casadical.robot.effect_tables import effects_toml
from casadical.robot.robot import Robot
from casadical.robot.robot_file import robot_files

# Unit in reports, and factor from SI to it, by SI unit of a law's factor.
REPORT_UNITS = {"rad": ("urad", 1e6), "m": ("um", 1e6), "kg/kg": ("%", 1e2), "": ("of the peak torque", 1.0)}
# Words for a model in reports, by its name in `Discovery.gap`.
_MODEL_WORDS = {
    "base": "base model",
    "causes": "with listed causes",
    "law": "with the law",
    "smooth": "with smooth forms",
}


# Names of the models that are compared on held-out poses (see `Discovery.gap`).
KeptModel = Literal["law", "smooth", "causes", "base"]


@dataclass(frozen=True, eq=False)
class Discovery(Result):
    """Laws (symbolic expressions of unlisted effects) found in the residuals of a diagnosis.

    diagnosis : diagnosis of the same data
    rounds : comparisons of laws with their rivals, each given the laws of the rounds before
    case : linear problem with the laws among its candidates, on the searched poses
    laws : the claimed laws; causes : listed effects in the model with the laws
    noise : most probable noise given both
    values : factors of the laws: (value, standard error, unit) [SI] by name of the parameter
    gap : mean held-out error [m] by model: "base", "causes" (those of the diagnosis), "law" (laws
        and `causes`), "smooth" (causes and smooth forms); only models that exist
    shrink : fraction, up to 1, by which the gap falls with the laws, and its 95 % interval;
        settings are chosen again in each fold; None without laws
    smooth : description of an unlisted cause by smooth forms, None without one

    Examples
    --------
    >>> discovery = casadical.discover(found, effects=["backlash"])
    >>> discovery.best_model, discovery.laws, discovery.effects
    ('base', (), ())
    >>> discovery.refit().is_optimal(), discovery.apply().effects_in_words
    (True, '')
    """

    report: ClassVar[str] = "laws.j2"

    diagnosis: Diagnosis
    rounds: tuple[Round, ...]
    case: Case
    laws: tuple[ScoredLaw, ...]
    causes: tuple[Effect, ...]
    noise: Noise
    values: dict[str, tuple[float, float, str]]
    gap: dict[KeptModel, float]
    shrink: tuple[float, tuple[float, float]] | None
    smooth: Unlisted | None

    @property
    def best_model(self) -> KeptModel:
        """Return the name of the model in `gap` that predicts held-out poses best."""
        return best_of(self.gap, lambda name: -self.gap[name])

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Return the effects of the model that predicts held-out poses best; () for the base."""
        laws = tuple(s.law for s in self.laws)
        effects = {
            "law": (*self.causes, *laws),
            "smooth": self.diagnosis.effects(unlisted=self.smooth),
            "causes": self.diagnosis.effects(),
        }
        return effects.get(self.best_model, ())

    def refit(self) -> Identification:
        """Return the identification of the base model together with `effects`.

        Raises ConvergenceError: Ipopt finds no optimum.
        """
        noise = self.noise if self.best_model == "law" else self.diagnosis.noise
        return refit(self.case.with_inliers(self.diagnosis.case.inliers), self.effects, noise)

    @property
    def thinned(self) -> tuple[int, int] | None:
        """Return the numbers of searched poses and of all inliers; None where they are equal."""
        searched, inliers = (int(c.inliers.sum()) for c in (self.case, self.diagnosis.case))
        return None if searched == inliers else (searched, inliers)

    def apply(self) -> Robot:
        """Return the calibrated robot with the effects that predict held-out poses best."""
        return self.refit().robot

    @property
    def lines(self) -> list[str]:
        """Return each claimed law as a line of text (see `line_of`)."""
        return [line_of(s.law, _factor_values(self, s)) for s in self.laws]

    @property
    def in_words(self) -> str:
        """Return a sentence with the claimed laws and held-out errors, or why none is claimed."""
        if not self.laws:
            why = _why_not(self.rounds[0])
            return f"no law is claimed: {why[0].lower()}{why[1:]}"
        errors = f"{mm(self.gap['base'])} -> {mm(self.gap['law'])} mm on held-out poses"
        return f"{'; '.join(self.lines)}; {errors} (casadical diagnose --laws --out DIR has it in a robot file)"

    def blocks(self) -> list[Block]:
        """Return the report: laws with factors, rivals, held-out errors and the best model."""
        several = len(self.rounds) > 1
        title = "Laws that compete"
        each = [_table(r, f"{title}, round {k}" if several else title) for k, r in enumerate(self.rounds, 1)]
        shares = [f"{r.form.ar_coefficient:.2g}" for r in self.rounds]
        gaps = [(_MODEL_WORDS[name], mm(value)) for name, value in self.gap.items()]
        return self._report_blocks(
            laws=list(zip(self.laws, self.lines, strict=True)),
            effects=self.causes if self.laws else self.diagnosis.effects(),
            factors=_factors,
            why_not=_why_not,
            tables=each,
            shares=shares if len(set(shares)) > 1 else shares[:1],
            gaps=Table("Held-out error [mm]", ("model", "mean"), gaps, frozenset({1})),
            model=_MODEL_WORDS[self.best_model],
        )

    @cached_property
    def remainder(self) -> Array:
        """Return the residuals of a fit with laws and causes, shape (n, 3) [m].

        They are those of the n searched poses.
        """
        columns = [self.case.columns[e] for e in self.causes] + [self.case.columns[s.law] for s in self.laws]
        fit = new_fit(self.case.evidence, np.unique(np.concatenate(columns)), self.noise)
        return fit.residual(fit.x)

    def figures(self) -> list[Figure]:
        """Return a figure of each claimed law over its driver."""
        return [
            _figure(self, s, line, self.remainder, f"law{k}")
            for k, (s, line) in enumerate(zip(self.laws, self.lines, strict=True))
        ]

    def section(self) -> Section:
        """Return the section of a page: each law over its driver, and all rivals."""
        return Section("The missing law", [*self.figures(), *self.blocks()])

    def page(self, name: str, files: Sequence[Path] = ()) -> Page:
        """Return the page of a report.

        name : name of the campaign; files : the files from which it was made
        """
        robot = self.diagnosis.identification.given.name
        return Page("Discovery", f"Laws of {name}", robot, [self.section()], files=files)

    def to_json(self, name: str = "") -> dict[str, Any]:
        """Return the result as plain data for JSON in rad, m and nats (gaps in mm).

        Keys are campaign, verdict, those of `laws_json`, causes, diagnosis and rounds.
        name : name of the campaign, by default that of its table
        """
        first = self.rounds[0]
        verdict = (
            "law" if self.laws else "alias" if first.alias and first.best.score >= SETTINGS.min_law_score else "none"
        )
        return {
            "campaign": name or self.case.m.source,
            "verdict": verdict,
            **self.laws_json(),
            "causes": [e.label for e in (self.causes if self.laws else self.diagnosis.effects())],
            "diagnosis": self.diagnosis.verdict,
            "rounds": [_round(r) for r in self.rounds],
        }

    def laws_json(self) -> dict[str, Any]:
        """Return the laws and held-out errors as plain data for JSON.

        Keys are laws, gap_mm (by model), shrink, best_model and, where they apply, why
        (no law is claimed) and poses.
        """
        shrink = self.shrink and {"share": round(self.shrink[0], 4), "interval": [round(x, 4) for x in self.shrink[1]]}
        return {
            "laws": [_law(self, s, line) for s, line in zip(self.laws, self.lines, strict=True)],
            "gap_mm": {model: round(1e3 * value, 5) for model, value in self.gap.items()},
            "shrink": shrink,
            "best_model": self.best_model,
            **({} if self.laws else {"why": _why_not(self.rounds[0])}),
            **({"poses": {"searched": self.thinned[0], "all": self.thinned[1]}} if self.thinned else {}),
        }

    def files(self, folder: str | Path, name: str = "") -> dict[Path, str | bytes]:
        """Return the text of each file of `casadical diagnose --laws --out`, by path.

        They are robot, laws, JSON and report. folder : folder of the files; name : name of the
        campaign. Raises ConvergenceError.
        """
        refit, folder, name = self.refit(), Path(folder), name or self.case.m.source
        comment = "\n".join([f"Discovered by casadical from {name}.", *self.lines, refit.verdict])
        kinds = [type(e) for e in refit.robot.effects]
        texts = robot_files(folder / "discovered.robot.toml", refit.robot, comment, kinds, known_alone=True)
        if self.best_model == "law":
            laws = tuple(s.law for s in self.laws)
            texts[folder / "law.effect.toml"] = effects_toml(refit.robot, laws, comment, known_alone=True)
        texts[folder / "discovery.json"] = json_text(self.to_json(name))
        texts[folder / "discovery.txt"] = plain_text(self.blocks(), 100)
        return texts


def line_of(law: Law, values: Mapping[str, float] | None = None) -> str:
    """Return a law as a line of text: joint 2 += 84 urad * max(0, |tau3| - 0.3).

    values : values of its factors, by short name [SI]; None: the names are shown
    """
    unit, factor = REPORT_UNITS[SEAMS[law.seam][1]]

    def shown(name: str) -> str:
        """Return a factor as text: its value in the unit of reports, or its name."""
        if values is not None and law.seam == "joints":
            each = (factor * values[f"{name}{j}"] for j in range(1, law.count + 1))
            return f"[{', '.join(f'{v:.3g}' for v in each)}]"
        return name if values is None or name not in values else f"{factor * values[name]:.3g}"

    def vector(found: re.Match[str]) -> str:
        """Return a vector of factors as text."""
        inside = ", ".join(shown(n) for n in found[1].split(", "))
        return f"[{inside}]{'' if values is None else f' {unit}'} * "

    def scalar(found: re.Match[str]) -> str:
        """Return a single factor as text."""
        return f"{found[1]}{shown(found[2])}{'' if values is None else f' {unit}'} * "

    text = re.sub(r"\[(\w(?:, \w){2})\]\*", vector, law.formula)
    if SEAMS[law.seam][0] == 1:
        text = re.sub(r"(^| \+ )([a-z])\*", scalar, text)
    text = re.sub(r"abs\(([^()]*)\)", r"|\1|", text)
    beam = f" (instrument at {_point(law.station)} m)" if law.seam in STATION_SEAMS else ""
    if law.towards != DEFAULT_TARGET_DIRECTION:
        beam = beam.replace(")", f"; the target looks along {_point(law.towards)} of the flange)")
    return f"{law.place} += {text}{beam}".replace("+ -", "- ")


def _point(of: tuple[float, float, float]) -> str:
    """Return the components of a point or direction as text, separated by commas."""
    return ", ".join(f"{v:g}" for v in of)


def _factor_values(d: Discovery, s: ScoredLaw) -> dict[str, float]:
    """Return the identified values of a law's factors, by short name [SI]."""
    return {name: d.values[f"{s.law.label}.{name}"][0] for name in s.law.sizes()}


def _factors(d: Discovery, s: ScoredLaw) -> str:
    """Return a law's factors with standard errors as text, in the units of `REPORT_UNITS`."""
    unit, factor = REPORT_UNITS[SEAMS[s.law.seam][1]]
    each = {name: d.values[f"{s.law.label}.{name}"] for name in s.law.sizes()}
    return "; ".join(
        f"{n} = {factor * value:.3g} +/- {factor * error:.2g} {unit}" for n, (value, error, _) in each.items()
    )


def _why_not(r: Round) -> str:
    """Return a sentence on why the best law of a round is not claimed."""
    enough = r.best.score >= SETTINGS.min_law_score
    if r.alias and enough:
        names = ", ".join(r.alias)
        return f"The best one is {names} by another name (correlation above {SETTINGS.min_alias_correlation})."
    best = f"The best one has {r.best.score:.1f} nats"
    if enough:
        name, score = r.rival
        return f"{best}, {name} {score:.1f}; {SETTINGS.min_law_margin:g} more are needed."
    return f"{best} after the price of the search; {SETTINGS.min_law_score:g} are needed."


def _table(r: Round, title: str) -> Table:
    """Return the table of the best laws of a round and their rivals, with scores [nats]."""
    rows = [(f"{s.score:.1f}", line_of(s.law), s.tried.form.name) for s in (r.best, *r.alike)]
    rivals = (("listed", r.listed), ("on no list", r.smooth), ("noise", r.noise))
    rows += [(f"{score:.1f}", f"{kind}: {label}", "") for kind, (label, score) in rivals]
    count = 1 + len(r.alike)
    return Table(
        title,
        ("nats", "law", "form"),
        rows,
        frozenset({0}),
        frozenset({0}) if r.claimed else frozenset(),
        faint=frozenset(range(count, len(rows))),
    )


def _law(d: Discovery, s: ScoredLaw, line: str) -> dict[str, Any]:
    """Return a law with factors [SI], settings and score [nats] as plain data for JSON.

    line : its text, as of `line_of`
    """
    names = zip(s.tried.form.settings, s.settings, s.errors, strict=True)
    own, keys = {n: d.values[f"{s.law.label}.{n}"] for n in s.law.sizes()}, ("value", "std_error", "unit")
    return {
        "line": line,
        **s.law.to_dict(),
        "factors": {n: dict(zip(keys, values, strict=True)) for n, values in own.items()},
        "form": s.tried.form.name,
        "driver": s.tried.driver.text,
        "family": s.tried.driver.family,
        "form_settings": {n: {"value": float(v), "std_error": float(e)} for n, v, e in names},
        "score": round(s.score, 2),
    }


def _round(r: Round) -> dict[str, Any]:
    """Return a round's laws and rivals with scores [nats] as plain data for JSON."""
    rivals = {"listed": r.listed, "smooth": r.smooth, "noise": r.noise}
    return {
        "claimed": r.claimed,
        "best": {"line": line_of(r.best.law), "form": r.best.tried.form.name, "score": round(r.best.score, 2)},
        "not_distinguished": [{"line": line_of(s.law), "behind": round(r.best.score - s.score, 2)} for s in r.alike],
        "within": SETTINGS.indistinguishable_law_margin,
        **{kind: {"label": label, "score": round(score, 2)} for kind, (label, score) in rivals.items()},
        "alias_of": list(r.alias),
        **({"noise_ar_coefficient": round(r.form.ar_coefficient, 4)} if r.form.ar_coefficient else {}),
    }


def _figure(d: Discovery, s: ScoredLaw, line: str, residuals: Array, name: str) -> Figure:
    """Return the figure of a law over its driver, along the direction in which it acts most.

    line : title; residuals : residuals of the fit with the law, shape (n, 3) [m]
    name : name of the figure
    """
    unit, factor = REPORT_UNITS[SEAMS[s.law.seam][1]]
    seam, x = s.tried.seams[s.seam], s.tried.x[s.seam]
    amplitude = np.array([*_factor_values(d, s).values()]).reshape(len(s.tried.form.parts), -1)
    _, _, direction = np.linalg.svd(amplitude)
    towards = direction[0]
    grid = np.linspace(x.min(), x.max(), 400)
    at_poses, along = (
        (amplitude @ towards) @ s.tried.form.values(places, s.settings[None])[:, :, 0] for places in (x, grid)
    )
    column = seam.columns @ towards
    seen = at_poses + (column * residuals).sum(axis=1) / (column**2).sum(axis=1)
    weight = np.linalg.norm(column, axis=1)
    size, tip = (3 + 5 * weight / weight.max()).round(1), f"%{{y:.3g}} {unit} at %{{x:.4g}}"
    poses = Series("points", x.round(5), (factor * seen).round(2), name="poses", colour="grey", size=size, tip=tip)
    caption = (
        "Line: the law. Points: for each pose the value that its own residual asks for at this place, beside all else "
        "in the model, fitted to all poses; the further a pose can see the place, the less its point scatters."
    )
    law = Series("line", grid.round(5), (factor * along).round(2), name="law", tip=tip)
    return Figure(name, line, [poses, law], Axis(s.tried.driver.text), Axis(unit), caption=caption)
