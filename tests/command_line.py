"""The command inside the process of a test."""

from __future__ import annotations

import sys

import pytest

from casadical import cli


def main(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run `casadical` with these arguments; its exit code."""
    monkeypatch.setattr(sys, "argv", ["casadical", *map(str, arguments)])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    return int(stopped.value.code or 0)
