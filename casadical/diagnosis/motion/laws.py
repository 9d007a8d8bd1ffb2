"""The law that is missing in a joint log: at which joint's torque or response, by what, in which form.

Forms, prices and refinement are those of laws of poses (see `diagnosis.laws`); here a law acts in windows, whose noise
follows itself. It is claimed where it is large, true of runs that were not fitted, and above all rivals.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import best_of, first_of_best, ranked
from casadical.core.telling.blocks import Table, Words
from casadical.diagnosis.cross_validation import likely_noise
from casadical.diagnosis.laws.answer import line_of
from casadical.diagnosis.laws.forms import BUMP, FORMS, LEAST_SPREAD, Driver, Form
from casadical.diagnosis.laws.problem import ABOVE, Problem, Scored, Screen, Seam, Tried, log_mean, scale_of, scaled
from casadical.diagnosis.laws.search import refined
from casadical.diagnosis.motion.base import Look
from casadical.diagnosis.motion.problem import MotionCase, columns_of, with_candidates
from casadical.diagnosis.motion.search import MARGIN, UNLISTED, WITHOUT_TORQUE, Found, Outcome, judged
from casadical.diagnosis.motion.search import columns_of as of_found
from casadical.diagnosis.posterior import rank
from casadical.effects.formula import NUMERIC, parse
from casadical.effects.formula_effect import Law
from casadical.effects.motion import Cause, motion_effects
from casadical.robot.effect_tables import effects_toml
from casadical.robot.robot import Robot

# Laws whose evidence is computed exactly and refined; that are told.
EXACT, JUDGED = 6, 3
# What is less is none, in the units of drivers.
LEAST = 1e-9


@dataclass(frozen=True, eq=False)
class _InLog(Tried):
    """Laws of a driver and a form at one row of a log, whose values are those of its samples."""

    look: Look
    case: MotionCase

    def column(self, seam: int, settings: Array) -> tuple[Law, Array]:
        values = self.form.values(self.x[seam], settings[None])
        texts = self.form.texts(self.driver.text, settings.tolist())
        law = self.seams[seam].with_formula(texts, [float(s) for s in scale_of(values)[:, 0]])
        made = columns_of(self.look, law)
        out = np.zeros((*self.case.r.shape, len(made)))
        for k, column in enumerate(made):
            for row, windows in column.items():
                out[: len(windows), row, k] = windows
        return law, self.case.noise.white(out, self.case.first)


@dataclass(frozen=True, eq=False)
class LogLaws:
    """Laws of a log, the best first.

    laws : with their scores; found : the best as a cause, judged on runs that were not fitted
    values : of its factors, in shares of the great torque or rad; listed, smooth : label and evidence of best rivals
    """

    laws: tuple[Scored, ...]
    found: Found
    values: Mapping[str, float]
    listed: tuple[str, float]
    smooth: tuple[str, float]
    least: float

    @property
    def claimed(self) -> bool:
        """Whether the best law is large, true of what was not fitted, and above all rivals."""
        best, score = self.found, self.laws[0].score
        rivals = score >= max(self.listed[1] + MARGIN, self.smooth[1] + ABOVE, self.least)
        return best.share >= 1 and best.true and rivals

    @property
    def line(self) -> str:
        """The best law with its values."""
        return line_of(self.laws[0].law, self.values)

    def blocks(self) -> Iterator[Words | Table]:
        """As `casadical diagnose ARM LOG --laws` prints it."""
        if self.claimed:
            yield Words(f"LAW  {self.line}", "verdict")
            yield Words(f"It gains {sum(self.found.held_out):.0f} nats on runs that were not fitted.")
        else:
            yield Words(f"No law is claimed; the best is {self.line}.", "verdict")
        compete = [*((line_of(s.law), s.score) for s in self.laws)]
        compete += [(f"best of the list: {self.listed[0]}", self.listed[1]), self.smooth]
        rows = [(law, f"{nats:.0f}") for law, nats in compete]
        title = "Laws that compete, in nats above none, less the price of the search"
        yield Table(title, ("law", "nats"), rows, frozenset({1}))

    def to_json(self) -> dict[str, Any]:
        return {
            "claimed": self.claimed,
            "laws": [{"formula": s.law.formula, "place": s.law.place, "score": s.score} for s in self.laws],
            "line": self.line,
            "held_out": list(self.found.held_out),
            "rivals": {"listed": self.listed, "smooth": self.smooth},
        }

    def files(self, folder: Path, robot: Robot) -> Mapping[Path, str]:
        """law.effect.toml, for --effects; of a law that is claimed."""
        if not self.claimed:
            return {}
        law = self.laws[0].law
        values = {f"{law.label}.{name}": value for name, value in self.values.items()}
        made = replace(robot, effects=(law,), effect_values=values, knowledge=None)
        return {folder / "law.effect.toml": effects_toml(made, (law,), f"Found in a joint log: {self.line}")}


def laws_of(looks: Sequence[Look], outcome: Outcome, own: Sequence[Cause] = ()) -> LogLaws | None:
    """The laws of what the causes of a log leave; None where nothing varies that one could follow.

    looks : the log, and its reference behind it; own : causes beside those of the list
    """
    look, case = looks[0], outcome.case
    chosen = of_found(case, outcome.found)
    laws = _searched(look, case, chosen)
    if not laws:
        return None
    more = with_candidates(case, look, [*motion_effects().values(), *own, *(s.law for s in laws)])
    chosen, best = of_found(more, outcome.found), laws[0].law
    own_columns = more.group(best.label, 0)
    columns = np.union1d(chosen, own_columns)
    more = more.renewed(columns)  # beside the best law the noise is another
    inside = frozenset(f.label for f in outcome.found)
    ranking = rank(more, chosen, inside)
    laws = [replace(s, score=s.score - s.evidence + ranking.log_factor[s.law.label]) for s in laws]
    # What is smooth in the law's own driver is no rival, but the same without a form.
    others = {*(s.law.label for s in laws), _smooth_of(laws[0])}
    rivals = [(k, gain) for k, gain in ranking.log_factor.items() if k not in others]
    by_list = [[rival for rival in rivals if more.by_label[rival[0]].listed == kind] for kind in (True, False)]
    listed, unlisted = (best_of(some or [("none", 0.0)], itemgetter(1), logs=True) for some in by_list)
    theta = more.fitted(columns)[1][np.isin(columns, own_columns)]
    values = {n: float(v) * size for (n, (size, _)), v in zip(best.sizes().items(), theta, strict=True)}
    least = UNLISTED * (1.0 if more.unit else WITHOUT_TORQUE)
    found = judged(more, outcome.found, ranking, best.label)
    return LogLaws(tuple(laws), found, values, listed, unlisted, least)


def _smooth_of(s: Scored) -> str:
    """Label of the smooth function of a law's driver at its place, as of `problem.with_candidates`."""
    law, text = s.law, s.tried.driver.text
    names = {"t": "time", f"load{law.joint}": "load", f"slip{law.joint}*q{law.joint}": "q and direction"}
    return f"smooth {law.seam} of joint {law.joint} by {names.get(text, text)}"


def _drivers(look: Look, joint: int) -> Iterator[Driver]:
    """What the torque or response of one joint may follow."""
    for i in range(1, look.arm.joints + 1):
        yield Driver(f"q{i}", "angle", "angle")
        yield Driver(f"v{i}", "signed", "speed")
        yield Driver(f"slip{i}", "play", "direction")
        yield Driver(f"load{i}", "signed", "load")
    yield Driver("t", "time", "time")
    yield Driver(f"rest{joint}", "positive", "history")
    for product in ("slip{0}*abs(load{0})", "slip{0}*q{0}", "slip{0}*t", "v{0}*t"):
        yield Driver(product.format(joint), "linear", "product")
    if "tau" in look.names:
        yield Driver(f"tau{joint}", "signed", "torque")
    if "heat" in look.names:
        yield Driver(f"heat{joint}", "positive", "temperature")
        yield from (Driver(f"{own}{joint}*heat{joint}", "linear", "product") for own in ("slip", "v"))


def _values(look: Look, driver: Driver) -> Array:
    """Of a driver at all samples, shape (n,)."""
    known = {k: v[:, 0] for k, v in look.names.items() if k == "t"}
    for k in range(look.arm.joints):
        known |= {f"{stem}{k + 1}": values[:, k] for stem, values in look.names.items()}
    formula = parse(driver.text)
    values = np.asarray(formula.values({name: known[name] for name in formula.names}, NUMERIC)[0])
    return np.where(np.abs(values) < LEAST, 0.0, values)


def _searched(look: Look, case: MotionCase, chosen: Array) -> list[Scored]:
    """The best laws of all rows, drivers and forms, refined, the best first."""
    base = case.judged.with_base(chosen)
    problem = Problem(replace(base, E=np.zeros((*base.r.shape, 1)), held=None))
    screen = Screen.at_rho(problem.evidence, 0)
    n, rough = look.arm.joints, dict[tuple[int, str], tuple[float, float, _InLog, Array]]()
    instances = 0
    for row in range(case.r.shape[1]):
        joint = row % n + 1
        place = Seam(Law(joint, "torque" if row < n else "response", "a"), np.zeros(0))
        # A bump of a joint's own angle, for each direction of its motion.
        parts = tuple(f"max(0, {way}slip{joint})*{BUMP.parts[0]}" for way in ("", "-"))
        slip = {f"slip{joint}": look.names["slip"][:, joint - 1]}
        one_way = Form("bump by direction", parts, BUMP.settings, BUMP.grid, slip)
        for driver in _drivers(look, joint):
            x = _values(look, driver)
            if np.ptp(x) < LEAST_SPREAD:
                continue
            instances += 1
            for form in (*FORMS[driver.kind], *([one_way] if driver.text == f"q{joint}" else [])):
                tried = _InLog((place,), driver, form, (x,), look, case)
                gains = _screened(tried, row, screen)
                k, mean = first_of_best(gains, logs=True), float(log_mean(gains) - np.log(len(gains)))
                price = float(np.log(1 + len(FORMS[driver.kind])))
                one = mean - price, float(gains[k]) - mean + price, tried, tried.settings[0][k]
                both = rough.get((row, driver.text), one), one
                rough[row, driver.text] = both[first_of_best([each[0] for each in both], logs=True)]
    laws, of_each = [], list(rough.values())
    for _, price, tried, settings in (of_each[k] for k in ranked([each[0] for each in of_each], logs=True)[:EXACT]):
        law, columns = tried.column(0, settings)
        if not columns.any():
            continue
        grids = problem.grids([columns])
        evidence = float(problem.over_none(grids)[0])
        s = Scored(
            law, tried, 0, settings, evidence - price - float(np.log(instances)), evidence, columns,
            likely_noise(grids[0], problem.evidence.sigmas), np.full(len(settings), np.nan),
        )  # fmt: skip
        laws.append(refined(problem, s))
    return [laws[k] for k in ranked([s.score for s in laws], logs=True)[:JUDGED]]


def _screened(tried: _InLog, row: int, screen: Screen) -> Array:
    """Log evidence over none of a form with each of its settings, shape (K,)."""
    case, settings = tried.case, tried.settings[0]
    functions = scaled(tried.form.values(tried.x[0], settings))
    parts = []
    for part in functions:
        windows = np.zeros((len(case.r), 1, part.shape[1]))
        averaged = tried.look.motion.averaged(part)
        windows[: len(averaged), 0] = averaged
        parts.append(tried.seams[0].size * case.noise.row(row).white(windows, case.first)[:, 0])
    seen = [screen.Q[:, row].T @ part for part in parts]
    G = np.array([
        [(a * b).sum(axis=0) - (p * q).sum(axis=0) for b, q in zip(parts, seen, strict=True)]
        for a, p in zip(parts, seen, strict=True)
    ]).transpose(2, 0, 1)  # fmt: skip
    b = np.stack([part.T @ screen.y[:, row] for part in parts], axis=1)
    return screen.gains(G, b)
