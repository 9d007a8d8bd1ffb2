"""The report of a discovery: each law over its driver, with what each pose says of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.cross_validation import new_fit
from casadical.diagnosis.laws.answer import READABLE, blocks_of, lines_of
from casadical.effects.formula_effect import SEAMS
from casadical.report.page import Drawing, Part, Section, report_html
from casadical.report.provenance import campaign_files, provenance_of
from casadical.report.style import BLUE, GREY, Figure, new_figure

if TYPE_CHECKING:
    from casadical.diagnosis.laws.discovery import Discovery
    from casadical.diagnosis.laws.problem import Scored

_CAPTION = (
    "Line: the law. Points: for each pose the value that its own residual asks for at this place, beside all else in "
    "the model, fitted to all poses; the further a pose can see the place, the less its point scatters."
)


def discovery_report(folder: Path, campaign: Path, found: Discovery, command: Sequence[str] = ()) -> str:
    """One HTML file. Raises InputError where plotly or jinja2 is not installed, or a file is gone."""
    part = Part(f"Laws of {campaign.stem}", found.diagnosis.identification.given.name, [law_section(found)])
    return report_html("Discovery", [part], provenance_of(campaign_files(folder, [campaign]), command))


def law_section(found: Discovery) -> Section:
    """The section of a diagnosis: laws with all that competes, and each over its driver."""
    drawings = [Drawing(f"law{k}", f, _CAPTION) for k, f in enumerate(law_figures(found))]
    return Section("The missing law", [*drawings, *blocks_of(found)])


def law_figures(found: Discovery) -> list[Figure]:
    """A figure of each claimed law."""
    columns = [found.case.columns[e] for e in found.causes] + [found.case.columns[s.law] for s in found.laws]
    if not found.laws:
        return []
    whole = np.unique(np.concatenate(columns))
    fit = new_fit(found.case.evidence, whole, found.noise)
    left = fit.left(fit.x)
    return [_figure(found, s, line, left) for s, line in zip(found.laws, lines_of(found), strict=True)]


def _figure(found: Discovery, s: Scored, line: str, left: Array) -> Figure:
    """Along the direction in which the law acts most."""
    unit, factor = READABLE[SEAMS[s.law.seam][1]]
    seam, x = s.tried.seams[s.seam], s.tried.x[s.seam]
    own = np.array([found.values[f"{s.law.label}.{n}"][0] for n in s.law.sizes()])
    amplitude = own.reshape(len(s.tried.form.parts), -1)
    _, _, direction = np.linalg.svd(amplitude)
    towards = direction[0]
    grid = np.linspace(x.min(), x.max(), 400)
    at_poses, along = (_law(s, v, amplitude @ towards) for v in (x, grid))
    column = seam.columns @ towards
    seen = at_poses + (column * left).sum(axis=1) / (column**2).sum(axis=1)
    figure = new_figure(line, s.tried.driver.text, unit)
    weight = np.linalg.norm(column, axis=1)
    figure.add_scatter(
        x=x.round(5), y=(factor * seen).round(2), mode="markers", name="poses",
        marker={"color": GREY, "size": (3 + 5 * weight / weight.max()).round(1)},
    )  # fmt: skip
    figure.add_scatter(
        x=grid.round(5), y=(factor * along).round(2), mode="lines", line={"color": BLUE, "width": 2}, name="law"
    )
    return figure


def _law(s: Scored, x: Array, amplitude: Array) -> Array:
    values = s.tried.form.values(x, s.settings[None])[:, :, 0]
    return np.asarray(amplitude @ values)
