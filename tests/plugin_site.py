"""Plug-ins as an installer leaves them, and the command in a fresh process that finds them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def installed(folder: Path, group: str, point: str, module: str) -> Path:
    """A module `toy` and its metadata, with one entry point (`name = toy:Class`) of a group, in a folder."""
    (folder / "toy.py").write_text(module, encoding="utf-8")
    about = folder / "toy-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: toy\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[{group}]\n{point}\n")
    return folder


def run(site: Path, *arguments: object, program: str = "") -> subprocess.CompletedProcess[str]:
    """The command with arguments, or a Python program, where packages in `site` are found."""
    path = os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    environment = {**os.environ, "PYTHONPATH": path, "COLUMNS": "400"}
    command = [sys.executable, "-c", program or "from casadical.cli import main; main()", *map(str, arguments)]
    return subprocess.run(command, cwd=site, capture_output=True, text=True, check=False, env=environment)
