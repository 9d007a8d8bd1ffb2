"""The command `casadical certificate`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from casadical.cli.options import Json, Quiet
from casadical.cli.terminal import keep, suggest, with_json, working, wrapped
from casadical.core.telling.result import terminal


def certificate(
    results: Annotated[Path, Argument(metavar="RESULTS")],
    details: Annotated[Path | None, Option(metavar="FILE.toml")] = None,
    out: Annotated[Path | None, Option(metavar="FILE.pdf")] = None,
    problem: Annotated[Path | None, Option(metavar="PROBLEM_DIR")] = None,
    iso9283: Annotated[Path | None, Option("--iso9283", metavar="TABLE.csv")] = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Print certificate data of a calibration: results with uncertainty, budget, decision; in English or German.

    The uncertainty is that of the rms position error over the held-out poses, by a budget as the GUM asks for. These
    are data for a certificate: no accreditation is stated.

    Example: casadical certificate results --details certificate.toml --out cert.pdf

    Exit codes: 0 done, 2 bad input, 3 no optimum found, 70 a bug in casadical.

    results : Folder that `casadical calibrate --out` wrote.
    details : Issuer, instrument, conditions, tolerance; default: nothing is stated, which the pages say.
    out : Two pages (needs fpdf2).
    problem : What was calibrated; default: as result.json names it.
    iso9283 : A test that `casadical plan --iso9283` planned.
    """
    from casadical.project.certificate import certificate as certified

    console = wrapped(quiet)
    with working(quiet, "uncertainty"):
        made = certified(results, details, problem=problem, iso9283=iso9283)
    console.print(terminal(made.blocks()))
    texts: dict[Path, str | bytes] = {out: made.pdf()} if out else {}
    keep(with_json(texts, json_file, made.to_json()), console)
    if out is None:
        suggest(console, "to have it as two pages", *sys.argv[1:], "--out", "certificate.pdf")
    else:
        suggest(console, "when some ten poses are measured again", "verify", results, "LATER.csv")
