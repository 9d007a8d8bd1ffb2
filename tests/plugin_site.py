"""Plug-ins as an installer leaves them, and the command that finds them."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import command_line
import pytest

ROOT = Path(__file__).parents[1]


def installed(folder: Path, group: str, point: str, text: str) -> Path:
    """The folder, with a module and its metadata: one entry point `name = module:Class` of a group."""
    module = point.partition("=")[2].partition(":")[0].strip()
    (folder / f"{module}.py").write_text(text, encoding="utf-8")
    about = folder / f"{module}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module.replace('_', '-')}\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[{group}]\n{point}\n")
    return folder


def run(site: Path, *arguments: object, program: str = "") -> subprocess.CompletedProcess[str]:
    """The command with arguments, or a Python program, in a fresh process that finds packages in `site`."""
    path = os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    program = program or "from casadical.cli import main; main()"
    if arguments[:2] == ("export", "c"):
        few = f"write_c.__kwdefaults__['vectors'] = {command_line.FEW}"
        program = f"from casadical.export import write_c; {few}; {program}"
    command = [sys.executable, "-c", program, *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": path, "COLUMNS": "400"}
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, env=environment)


def run_here(
    monkeypatch: pytest.MonkeyPatch, known: Any, site: Path, *arguments: object
) -> subprocess.CompletedProcess[str]:
    """The command in the process of the test, where what it finds in `site` is faulty or not there."""
    with found_in(monkeypatch, known, site):
        return command_line.run(*arguments, width=400)


@contextmanager
def found_in(monkeypatch: pytest.MonkeyPatch, known: Any, site: Path) -> Iterator[None]:
    """The process of the test with the plug-ins in `site`; known : cached function that gives those of the family."""
    modules = [path.stem for path in site.glob("*.py")]
    monkeypatch.syspath_prepend(site)
    known.cache_clear()
    try:
        yield
    finally:
        known.cache_clear()
        for module in modules:
            sys.modules.pop(module, None)
