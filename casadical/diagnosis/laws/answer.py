"""A discovery as words for a terminal or a page, as JSON, and as files."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from casadical.core.blocks import Table, Words, mm, plain_text
from casadical.core.files import json_text
from casadical.diagnosis.laws.discovery import Discovery
from casadical.diagnosis.laws.problem import Scored
from casadical.diagnosis.laws.rivals import CORRELATION
from casadical.diagnosis.laws.round import ABOVE, ALIKE, CLAIMED, Round
from casadical.effects.formula_effect import SEAMS
from casadical.effects.law import Law
from casadical.robot.effect_file import effects_toml
from casadical.robot.robot_file import to_toml

# Unit of a factor -> (in words, its size).
READABLE = {"rad": ("urad", 1e6), "m": ("um", 1e6), "kg/kg": ("%", 1e2)}
NATS = (
    "Nats measure evidence: the natural logarithm of how many times more probable the data are with the law, less the "
    "price of the search; 3 nats are 20 times."
)
_MODELS = {"base": "base model", "causes": "with listed causes", "law": "with the law", "smooth": "with smooth forms"}


def line_of(law: Law, values: Mapping[str, float] | None = None) -> str:
    """A law as a line: joint 2 += 84 urad * max(0, |tau3| - 0.3). values : of its factors, by short name [SI]"""
    unit, factor = READABLE[SEAMS[law.seam][1]]

    def shown(name: str) -> str:
        if values is not None and law.seam == "joints":
            each = (factor * values[f"{name}{j}"] for j in range(1, law.count + 1))
            return f"[{', '.join(f'{v:.3g}' for v in each)}]"
        return name if values is None or name not in values else f"{factor * values[name]:.3g}"

    def vector(found: re.Match[str]) -> str:
        inside = ", ".join(shown(n) for n in found[1].split(", "))
        return f"[{inside}]{'' if values is None else f' {unit}'} * "

    def scalar(found: re.Match[str]) -> str:
        return f"{found[1]}{shown(found[2])}{'' if values is None else f' {unit}'} * "

    text = re.sub(r"\[(\w(?:, \w){2})\]\*", vector, law.formula)
    if SEAMS[law.seam][0] == 1:
        text = re.sub(r"(^| \+ )([a-z])\*", scalar, text)
    text = re.sub(r"abs\(([^()]*)\)", r"|\1|", text)
    beam = f" (instrument at {', '.join(f'{v:g}' for v in law.station)} m)" if law.seam == "beam" else ""
    return f"{law.place} += {text}{beam}".replace("+ -", "- ")


def _own(d: Discovery, s: Scored) -> dict[str, float]:
    return {name: d.values[f"{s.law.label}.{name}"][0] for name in s.law.sizes()}


def lines_of(d: Discovery) -> list[str]:
    """Each claimed law as a line."""
    return [line_of(s.law, _own(d, s)) for s in d.laws]


def blocks_of(d: Discovery) -> list[Words | Table]:
    """What the terminal and a page show."""
    found: list[Words | Table] = []
    for s, line in zip(d.laws, lines_of(d), strict=True):
        found.append(Words(f"LAW  {line}", "verdict"))
        found.append(Words(f"{_factors(d, s)}{_settings(s)}"))
    if not d.laws:
        found.append(Words(f"No law is claimed. {_why_not(d.rounds[0])}", "verdict"))
    causes = ", ".join(e.label for e in (d.causes if d.laws else d.diagnosis.effects()))
    if causes:
        found.append(Words(f"Listed effects in the model: {causes}."))
    for number, r in enumerate(d.rounds, 1):
        found.append(_table(r, "Laws that compete" if len(d.rounds) == 1 else f"Laws that compete, round {number}"))
    if d.thinned:
        found.append(Words("Laws were searched on {} of {} poses.".format(*d.thinned), "note"))
    found.append(Words(NATS, "note"))
    found.append(_gaps(d))
    if d.shrink:
        low, high = d.shrink[1]
        shares = f"{_share(d.shrink[0])} ({_share(low)} to {_share(high)})"
        found.append(Words(f"Held out, settings chosen again in each fold, the error is {shares} smaller."))
    found.append(Words(f"In the model that is kept: {_MODELS[d.kept]}, which predicts held-out poses best.", "note"))
    return found


def page_of(d: Discovery, width: int = 100) -> str:
    """The same as text."""
    return plain_text(blocks_of(d), width)


def law_in_words(d: Discovery) -> str:
    """The laws that were claimed and what they leave, in a sentence; why there is none, else."""
    if not d.laws:
        why = _why_not(d.rounds[0])
        return f"no law is claimed: {why[0].lower()}{why[1:]}"
    left = f"{mm(d.gap['base'])} -> {mm(d.gap['law'])} mm on poses held out"
    return f"{'; '.join(lines_of(d))}; {left} (casadical discover --out DIR has it in a robot file)"


def _share(value: float) -> str:
    return f"{100 * value:.0f} %"


def _factors(d: Discovery, s: Scored) -> str:
    unit, factor = READABLE[SEAMS[s.law.seam][1]]
    parts = []
    for name in s.law.sizes():
        value, error, _ = d.values[f"{s.law.label}.{name}"]
        parts.append(f"{name} = {factor * value:.3g} +/- {factor * error:.2g} {unit}")
    return "; ".join(parts)


def _settings(s: Scored) -> str:
    names = zip(s.tried.form.settings, s.settings, s.errors, strict=True)
    return "".join(f"; {name} = {value:.4g} +/- {error:.2g}" for name, value, error in names)


def _why_not(r: Round) -> str:
    if r.alias and r.best.score >= CLAIMED:
        return f"The best one is {', '.join(r.alias)} by another name (correlation above {CORRELATION})."
    if r.best.score >= CLAIMED:
        name, score = r.rival
        return f"The best one has {r.best.score:.1f} nats, {name} {score:.1f}; {ABOVE:g} more are needed."
    return f"The best one has {r.best.score:.1f} nats after the price of the search; {CLAIMED:g} are needed."


def _table(r: Round, title: str) -> Table:
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


def _gaps(d: Discovery) -> Table:
    rows = [(_MODELS[name], mm(value)) for name, value in d.gap.items()]
    return Table("Held-out error [mm]", ("model", "mean"), rows, frozenset({1}))


def as_json(d: Discovery, name: str) -> dict[str, Any]:
    """All figures; name : of the campaign. Angles in rad, lengths in m, gaps in mm, scores in nats."""
    first = d.rounds[0]
    verdict = "law" if d.laws else "alias" if first.alias and first.best.score >= CLAIMED else "none"
    return {
        "campaign": name,
        "verdict": verdict,
        **laws_as_json(d),
        "causes": [e.label for e in (d.causes if d.laws else d.diagnosis.effects())],
        "diagnosis": d.diagnosis.verdict,
        "rounds": [_round(r) for r in d.rounds],
    }


def laws_as_json(d: Discovery) -> dict[str, Any]:
    """The laws that were claimed, what each model leaves [mm], and the model that is kept."""
    shrink = d.shrink and {"share": round(d.shrink[0], 4), "interval": [round(x, 4) for x in d.shrink[1]]}
    return {
        "laws": [_law(d, s, line) for s, line in zip(d.laws, lines_of(d), strict=True)],
        "gap_mm": {model: round(1e3 * value, 5) for model, value in d.gap.items()},
        "shrink": shrink,
        "kept": d.kept,
        **({"poses": {"searched": d.thinned[0], "all": d.thinned[1]}} if d.thinned else {}),
    }


def _law(d: Discovery, s: Scored, line: str) -> dict[str, Any]:
    names = zip(s.tried.form.settings, s.settings, s.errors, strict=True)
    return {
        "line": line,
        **s.law.to_dict(),
        "factors": {n: _factor(*d.values[f"{s.law.label}.{n}"]) for n in s.law.sizes()},
        "form": s.tried.form.name,
        "driver": s.tried.driver.text,
        "family": s.tried.driver.family,
        "form_settings": {n: {"value": float(v), "std_error": float(e)} for n, v, e in names},
        "score": round(s.score, 2),
    }


def _factor(value: float, error: float, unit: str) -> dict[str, Any]:
    return {"value": value, "std_error": error, "unit": unit}


def _round(r: Round) -> dict[str, Any]:
    return {
        "claimed": r.claimed,
        "best": {"line": line_of(r.best.law), "form": r.best.tried.form.name, "score": round(r.best.score, 2)},
        "not_distinguished": [{"line": line_of(s.law), "behind": round(r.best.score - s.score, 2)} for s in r.alike],
        "within": ALIKE,
        "listed": {"label": r.listed[0], "score": round(r.listed[1], 2)},
        "smooth": {"label": r.smooth[0], "score": round(r.smooth[1], 2)},
        "noise": {"label": r.noise[0], "score": round(r.noise[1], 2)},
        "alias_of": list(r.alias),
    }


def files_of(d: Discovery, folder: Path, name: str) -> Iterator[tuple[Path, str]]:
    """What `casadical discover --out` writes: the robot with what is kept, the laws alone, figures and page.

    name : of the campaign. Raises ConvergenceError.
    """
    refit = d.refit()
    comment = "\n".join([f"Discovered by casadical from {name}.", *lines_of(d), refit.verdict])
    yield folder / "discovered.robot.toml", to_toml(refit.robot, comment, [type(e) for e in refit.robot.effects])
    if d.kept == "law":
        laws = tuple(s.law for s in d.laws)
        yield folder / "law.effect.toml", effects_toml(refit.robot, laws, comment)
    yield folder / "discovery.json", json_text(as_json(d, name))
    yield folder / "discovery.txt", page_of(d)
