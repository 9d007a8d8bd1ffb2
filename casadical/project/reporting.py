"""The functions `plot` and `report`: the figures and the HTML report of any result."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeAlias, overload

from casadical.core.basics import InputError
from casadical.core.reporting.blocks import Page
from casadical.core.reporting.drawing import dark as darkened
from casadical.core.reporting.drawing import draw
from casadical.core.reporting.figure import Figure
from casadical.core.reporting.page import html_of
from casadical.diagnosis.page import diagnosis_figures
from casadical.diagnosis.result import Diagnosis
from casadical.identification.figures import identification_figures
from casadical.identification.result import Identification
from casadical.project.problem import Problem
from casadical.project.problem_file import problem_file

if TYPE_CHECKING:
    from casadical.core.reporting.drawing import Picture
    from casadical.diagnosis.details import Details


class WithFigures(Protocol):
    """A result that has figures by name."""

    def figures(self) -> Mapping[str, Figure]:
        """Return every figure by name."""
        ...


class WithPage(Protocol):
    """A result that has a report page."""

    def page(self) -> Page:
        """Return the report page."""
        ...


# Any result that has figures.
Result: TypeAlias = WithFigures | Identification | Diagnosis


@overload
def plot(result: Result, name: None = None, more: Details | None = None, *, dark: bool = ...) -> dict[str, Picture]: ...
@overload
def plot(result: Result, name: str, more: Details | None = None, *, dark: bool = ...) -> Picture: ...
def plot(
    result: Result, name: str | None = None, more: Details | None = None, *, dark: bool = False
) -> Picture | dict[str, Picture]:
    """Return the figures of a report, drawn by plotly: one by its name, or all of them by name.

    result : result of `calibrate`, `identify`, `diagnose`, `compare_files` or `run_fleet`
    name : name of a figure, such as "errors/report"; None: all figures
    more : what `casadical.diagnosis.analyse` computed for a diagnosis
    dark : whether the colours are for a dark notebook or page
    Raises InputError: a name that the result does not have, or plotly is not installed.

    Examples
    --------
    >>> sorted(casadical.plot(calibration))[:3]
    ['distribution/identify', 'distribution/report', 'errors/identify']
    """
    figures: Iterable[Figure]
    if isinstance(result, Diagnosis):
        figures = diagnosis_figures(result, more)
    else:
        figures = identification_figures(result) if isinstance(result, Identification) else result.figures().values()
    by_name = {figure.name: figure for figure in figures}
    if name is not None and name not in by_name:
        raise InputError(f"plot: {name!r} is no figure of this result; there are {', '.join(by_name)}")
    wanted = by_name if name is None else {name: by_name[name]}
    pictures = {key: darkened(draw(figure)) if dark else draw(figure) for key, figure in wanted.items()}
    return pictures if name is None else pictures[name]


def report(results: Sequence[WithPage | Page], command: Sequence[str] = ()) -> str:
    """Return one self-contained HTML file of one or several results of a kind.

    results : results, or their pages, as `casadical.diagnosis.page.diagnosis_page` makes one of a
        diagnosis
    command : command line as it was typed, for the provenance
    Raises InputError: plotly is not installed, or a file is gone.

    Examples
    --------
    >>> casadical.report([calibration])[:15]
    '<!doctype html>'
    >>> from casadical.diagnosis.page import diagnosis_page
    >>> page = diagnosis_page(diagnosis, "made up")
    >>> casadical.report([page])[:15]
    '<!doctype html>'
    """
    return html_of([result if isinstance(result, Page) else result.page() for result in results], command)


def problem_files(problem: Problem) -> list[Path]:
    """Return the files that a problem was read from: problem.toml, robot file and tables."""
    path = problem.folder / "problem.toml"
    names = [problem.robot_file, *(problem.folder / table["file"] for table in problem.tables)]
    return [*([path] if path.is_file() else []), *map(_short, names)]


def campaign_files(source: Path, campaigns: Sequence[Path]) -> list[Path]:
    """Return the files that a diagnosis was read from: problem.toml, robot file and tables.

    source : problem folder or robot file; campaigns : tables
    """
    if source.is_file():
        return [source, *campaigns]
    return [source / "problem.toml", _short(source / problem_file(source).of_campaigns), *campaigns]


def _short(path: Path) -> Path:
    """Return the resolved path, relative to the working directory if it is below it."""
    whole = path.resolve()
    return whole.relative_to(Path.cwd()) if whole.is_relative_to(Path.cwd()) else whole
