"""Rows of a long study in a file of JSON lines, so that it can end and go on later."""

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from casadical.core.basics import ConvergenceError

Row = dict[str, Any]
T = TypeVar("T")


def add_options(parser: argparse.ArgumentParser, name: str) -> None:
    parser.add_argument("--keep", type=Path, default=Path(f"{name}.jsonl"), help="rows that are there are not redone")
    parser.add_argument("--seconds", type=float, default=1e9, help="begin nothing after so much processor time")
    parser.add_argument("--table", action="store_true", help="compute nothing, print what is there")


def named(entries: Iterable[T]) -> list[tuple[str, T]]:
    """Entries with their names, of which a row's begins with its scene."""
    return [("/".join(map(str, entry)), entry) for entry in entries]


def rows_of(todo: Sequence[tuple[str, T]], judged: Callable[[T], Row], given: argparse.Namespace) -> list[Row]:
    """The row of each entry (its name, and what it is), from the file where it is there; none if it finds no rest."""
    kept: dict[str, Row] = {}
    if given.keep.exists():
        kept = {row["name"]: row for row in map(json.loads, given.keep.read_text().splitlines())}
    for name, entry in todo:
        if given.table or time.process_time() > given.seconds:
            break
        if name not in kept:
            try:
                kept[name] = {"name": name, **judged(entry)}
            except ConvergenceError as error:
                print(f"{name}: {error}", file=sys.stderr)
                continue
            with given.keep.open("a") as file:
                file.write(json.dumps(kept[name]) + "\n")
    return [kept[name] for name, _ in todo if name in kept]
