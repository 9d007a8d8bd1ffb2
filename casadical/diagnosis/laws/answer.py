"""Result of a search for laws (expressions of an unlisted effect), and its report in all forms."""

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
from casadical.diagnosis.laws.candidates import Round, ScoredLaw, typical_size
from casadical.diagnosis.laws.forms import SMOOTH_FORM
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.refit import refit
from casadical.diagnosis.result import Diagnosis, Unlisted
from casadical.diagnosis.settings import SETTINGS
from casadical.effects import Effect
from casadical.effects.formula_effect import SEAMS, Law
from casadical.identification.result import Identification
from casadical.measurements.measurements import Noise
from casadical.robot.effect_tables import effects_toml
from casadical.robot.robot import Robot
from casadical.robot.robot_file import robot_files

# Unit in reports, and factor from SI to it, by SI unit of a law's factor.
REPORT_UNITS = {"rad": ("urad", 1e6), "m": ("um", 1e6), "kg/kg": ("%", 1e2)}
# Words for a model in reports, by its name in `Discovery.gap`.
_MODEL_WORDS = {
    "base": "base model",
    "causes": "with listed causes",
    "law": "with the law",
    "described": "with the description",
    "smooth": "with smooth forms",
}


# Names of the models that are compared on held-out poses (see `Discovery.gap`).
KeptModel = Literal["law", "described", "smooth", "causes", "base"]


@dataclass(frozen=True, eq=False)
class Discovery(Result):
    """Laws (symbolic expressions of unlisted effects) found in the residuals of a diagnosis.

    diagnosis : diagnosis of the same data
    rounds : rankings of laws with their rivals, each given the laws of the rounds before; () where no
        state variable varies over the poses
    case : linear problem with the laws among its candidates, on the searched poses
    laws : the claimed laws; causes : listed effects in the model with the laws
    description : where none is claimed, the law that best describes the error by a state variable
    noise : most probable noise given laws and causes, or the description, else the diagnosis' noise
    values : (value, standard error, unit) [SI] of the factors of laws or description, by "law.name"
    gap : mean held-out error [m] by model: "base", "causes" (those of the diagnosis), "law" (laws
        and `causes`), "described" (causes and description), "smooth" (causes and smooth forms); only
        models that exist
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
    description: ScoredLaw | None
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
            "described": (*self.diagnosis.effects(), *([self.description.law] if self.description else [])),
            "smooth": self.diagnosis.effects(unlisted=self.smooth),
            "causes": self.diagnosis.effects(),
        }
        return effects.get(self.best_model, ())

    def refit(self) -> Identification:
        """Return the identification of the base model together with `effects`.

        Raises ConvergenceError: Ipopt finds no optimum.
        """
        noise = self.noise if self.best_model in ("law", "described") else self.diagnosis.noise
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
    def described(self) -> str:
        """Return the description in words: where the error is, what it follows, its size; or ""."""
        about = self.description_json()
        if self.description is None or about is None:
            return ""
        s, f, value = self.description, self.description.candidate.function, self._described
        along = value @ np.linalg.svd(value, full_matrices=False)[2][0]
        order = np.corrcoef(np.argsort(np.argsort(along)), np.argsort(np.argsort(f.x)))[0, 1]
        of_one = f.form.name != SMOOTH_FORM or bool(f.form.settings)
        unit, factor = REPORT_UNITS[about["rms"]["unit"]]
        low, high = (factor * bound for bound in about["rms"]["interval"])
        return (
            f"the error of {s.law.place} {'grows with' if of_one and abs(order) > 0.9 else 'depends on'} the "
            f"{s.variable.words}, {factor * about['rms']['value']:.3g} {unit} rms "
            f"(95 %: {low:.3g} to {high:.3g}; probability of this driver {about['probability']:.2f})"
        )

    @property
    def _described(self) -> Array:
        """Return the description at the poses, less its mean, shape (n, components) [SI]."""
        s = self.description
        assert s is not None
        amplitude = np.array([*_factor_values(self, s).values()]).reshape(len(s.candidate.function.form.parts), -1)
        value = s.candidate.function.values(s.settings[None])[:, :, 0].T @ amplitude
        return np.asarray(value - value.mean(axis=0))

    def description_json(self) -> dict[str, Any] | None:
        """Return place, driver, its probability and size (rms, SI) of the description, or None."""
        s = self.description
        if s is None:
            return None
        drivers = {v.words: round(p, 4) for v, p in self.rounds[-1].drivers.items()}
        rms = float(np.sqrt((self._described**2).sum(axis=1).mean()))
        # A factor on the whole function: its likelihood at zero is lower by the evidence.
        half = 1.96 / np.sqrt(2 * max(s.evidence, 0.5))
        interval = [rms * max(1 - half, 0.0), rms * (1 + half)]
        return {
            "place": s.law.place,
            "driver": s.variable.words,
            "probability": drivers.pop(s.variable.words),
            "rms": {"value": rms, "interval": interval, "unit": SEAMS[s.law.seam].unit},
            "other_drivers": dict([*drivers.items()][:3]),
        }

    @property
    def in_words(self) -> str:
        """Return a sentence with the claimed laws and held-out errors, or why none is claimed."""
        if not self.laws:
            why = f"{self.described}; " if self.description else ""
            return f"{why}no form is claimed: {self.why_not}"
        errors = f"{mm(self.gap['base'])} -> {mm(self.gap['law'])} mm on held-out poses"
        return f"{'; '.join(self.lines)}; {errors} (casadical diagnose --laws --out DIR has it in a robot file)"

    @property
    def why_not(self) -> str:
        """Return why no law is claimed, as a clause."""
        if not self.rounds:
            return "nothing that a law may follow varies over the poses"
        r = self.rounds[-1]
        if r.alias:
            alike = f"correlation above {SETTINGS.min_alias_correlation}"
            return f"the best one is {', '.join(r.alias)} by another name ({alike})"
        if np.isfinite(r.further):
            return f"given the best one something further is probable ({1 - r.further:.2f})"
        rival, p = next(iter(r.rivals.items()), ("nothing", r.ranking.none))
        return f"all forms of one driver together have probability {r.probability:.2g}, {rival} {p:.2g}"

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
        alias = any(r.alias for r in self.rounds[:1])
        verdict = "law" if self.laws else "alias" if alias else "described" if self.description else "none"
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

        Keys are laws, gap_mm (by model), shrink, best_model and, where they apply, described, why (no
        law is claimed) and poses.
        """
        shrink = self.shrink and {"share": round(self.shrink[0], 4), "interval": [round(x, 4) for x in self.shrink[1]]}
        return {
            "laws": [_law(self, s, line) for s, line in zip(self.laws, self.lines, strict=True)],
            "gap_mm": {model: round(1e3 * value, 5) for model, value in self.gap.items()},
            "shrink": shrink,
            "best_model": self.best_model,
            **({"described": {"line": self.described, **about}} if (about := self.description_json()) else {}),
            **({} if self.laws else {"why": self.why_not}),
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
        texts = robot_files(folder / "discovered.robot.toml", refit.robot, comment, kinds, reproducible=True)
        if self.best_model == "law":
            laws = tuple(s.law for s in self.laws)
            texts[folder / "law.effect.toml"] = effects_toml(refit.robot, laws, comment, reproducible=True)
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
    return f"{law.place} += {text}".replace("+ -", "- ")


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


def _table(r: Round, title: str) -> Table:
    """Return the table of the best laws of a round and their rivals, with probabilities."""
    best = ((s, f"{s.law.place} by the {s.variable.words}") for s in (r.best, *r.indistinguishable))
    rows = [
        (f"{r.ranking.probability[s.candidate.label]:.2g}", words if s.form == SMOOTH_FORM else line_of(s.law), s.form)
        for s, words in best
    ]
    rivals = [("nothing", r.ranking.none), *[*r.rivals.items()][:3]]
    rows += [(f"{p:.2g}", label, "") for label, p in rivals]
    count = 1 + len(r.indistinguishable)
    return Table(
        title,
        ("probability", "law", "form"),
        rows,
        frozenset({0}),
        frozenset({0}) if r.claimed else frozenset(),
        faint=frozenset(range(count, len(rows))),
    )


def _law(d: Discovery, s: ScoredLaw, line: str) -> dict[str, Any]:
    """Return a law with factors [SI], settings and score [nats] as plain data for JSON.

    line : its text, as of `line_of`
    """
    c = s.candidate
    names = zip(c.function.form.settings, s.settings, s.errors, strict=True)
    own, keys = {n: d.values[f"{s.law.label}.{n}"] for n in s.law.sizes()}, ("value", "std_error", "unit")
    return {
        "line": line,
        **s.law.to_dict(),
        "factors": {n: dict(zip(keys, values, strict=True)) for n, values in own.items()},
        "form": s.form,
        "driver": c.function.driver,
        "family": s.variable.family,
        "form_settings": {n: {"value": float(v), "std_error": float(e)} for n, v, e in names},
        "score": round(s.score, 2),
    }


def _round(r: Round) -> dict[str, Any]:
    """Return a round's laws and rivals with probabilities as plain data for JSON."""
    p = r.ranking.probability
    return {
        "claimed": r.claimed,
        "best": {"line": line_of(r.best.law), "form": r.best.form, "score": round(r.best.score, 2)},
        "probability": round(r.probability, 4),
        "further": None if np.isnan(r.further) else round(1 - r.further, 4),
        "not_distinguished": [
            {"line": line_of(s.law), "behind": round(r.best.score - s.score, 2)} for s in r.indistinguishable
        ],
        "within": SETTINGS.indistinguishable_law_margin,
        "nothing": round(r.ranking.none, 4),
        "rivals": {label: round(p[label], 4) for label in [*r.rivals][:5]},
        "drivers": {v.words: round(q, 4) for v, q in [*r.drivers.items()][:5]},
        "alias_of": list(r.alias),
        **({"noise_ar_coefficient": round(r.form.ar_coefficient, 4)} if r.form.ar_coefficient else {}),
    }


def _figure(d: Discovery, s: ScoredLaw, line: str, residuals: Array, name: str) -> Figure:
    """Return the figure of a law over its driver, along the direction in which it acts most.

    line : title; residuals : residuals of the fit with the law, shape (n, 3) [m]
    name : name of the figure
    """
    unit, factor = REPORT_UNITS[SEAMS[s.law.seam][1]]
    f, x = s.candidate.function, s.candidate.function.x
    amplitude = np.array([*_factor_values(d, s).values()]).reshape(len(f.form.parts), -1)
    _, _, direction = np.linalg.svd(amplitude)
    towards = direction[0]
    grid = np.linspace(x.min(), x.max(), 400)
    # Other names of the form are at their means along the line.
    means = {name: np.full(len(grid), value.mean()) for name, value in f.names.items()}
    at_poses, along = (
        (amplitude @ towards) @ f.values(s.settings[None], at, names)[:, :, 0]
        for at, names in ((x, f.names), (grid, means))
    )
    column = s.candidate.unit @ towards / typical_size(s.candidate.place)
    seen = at_poses + (column * residuals).sum(axis=1) / (column**2).sum(axis=1)
    weight = np.linalg.norm(column, axis=1)
    size, tip = (3 + 5 * weight / weight.max()).round(1), f"%{{y:.3g}} {unit} at %{{x:.4g}}"
    poses = Series("points", x.round(5), (factor * seen).round(2), name="poses", colour="grey", size=size, tip=tip)
    caption = (
        "Line: the law. Points: for each pose the value that its own residual asks for at this place, given all else "
        "in the model, fitted to all poses; the further a pose can see the place, the less its point scatters."
    )
    law = Series("line", grid.round(5), (factor * along).round(2), name="law", tip=tip)
    return Figure(name, line, [poses, law], Axis(f.driver), Axis(unit), caption=caption)
