"""Commands and their options are a contract: what changes here is named in the changelog, with old and new."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from typer.main import get_command

from casadical.cli import app

CONTRACT = Path(__file__).with_name("contract.txt")


def lines(command: Any, name: str = "") -> Iterator[str]:
    """A line for each option: its names, whether it is needed or may be repeated, its default and limits."""
    for key, part in getattr(command, "commands", {}).items():
        yield from lines(part, f"{name} {key}".strip())
    for p in () if hasattr(command, "commands") else command.params:
        facts = [fact for fact in ("required", "multiple", "is_eager") if getattr(p, fact)]
        facts += [f"{k}={v}" for k in ("default", "min", "max") if (v := getattr(p, k)) is not None]
        facts += [f"nargs={p.nargs}"] * (p.nargs != 1)
        yield " ".join([name, "/".join([*p.opts, *p.secondary_opts]), *facts])


def test_options_defaults_and_limits_are_those_that_were_promised() -> None:
    promised = CONTRACT.read_text(encoding="utf-8").splitlines()
    assert [*lines(get_command(app))] == promised
