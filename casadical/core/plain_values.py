"""The one gate for numbers and texts of files and options: what no quantity or name can be is refused by its place."""

import math
import unicodedata
from collections.abc import Iterator
from typing import Any

# Sizes that arithmetic of doubles bears, squares and products included; smaller ones are taken for mistakes, too.
LARGEST, SMALLEST = 1e100, 1e-100
LONGEST, DEEPEST = 10_000, 50


def number_fault(value: float) -> str:
    """What is wrong with a number; nothing for a usable one."""
    if not -LARGEST <= value <= LARGEST:  # also an integer that is no double, and what is not a number
        return f"allowed: finite numbers up to {LARGEST:g}"
    return f"allowed: zero, or at least {SMALLEST:g}" if 0 < abs(value) < SMALLEST else ""


def text_fault(text: str) -> str:
    """What is wrong with a name or title; nothing for a usable one."""
    if len(text) > LONGEST:
        return f"has {len(text)} characters; allowed: up to {LONGEST}"
    bad = next((c for c in text if unicodedata.category(c) in ("Cc", "Cs") and c not in "\n\t"), None)
    return "" if bad is None else f"holds the control character {bad!a}; remove it"


def unusable(value: Any, place: str = "", depth: int = 0) -> Iterator[tuple[str, str]]:
    """Places of unusable numbers and texts in nested tables and lists, each with what is wrong."""
    if depth > DEEPEST:
        yield place[:60], "is nested too deeply"
    elif isinstance(value, dict):
        for key, inner in value.items():
            fault = text_fault(key)
            if fault:
                yield f"{place} key {ascii(key)[:60]}".strip(), fault
            yield from unusable(inner, f"{place}.{key}".lstrip("."), depth + 1)
    elif isinstance(value, list):
        for k, inner in enumerate(value, 1):
            yield from unusable(inner, f"{place}[{k}]", depth + 1)
    elif isinstance(value, str) and text_fault(value):
        yield f"{place} = {ascii(value)[:60]}", text_fault(value)
    elif isinstance(value, float) and not math.isfinite(value):
        return  # the schema says so, beside what else is wrong
    elif isinstance(value, int | float) and not isinstance(value, bool) and number_fault(value):
        yield f"{place} = {_short(value)}", number_fault(value)


def _short(value: float) -> str:
    if isinstance(value, int) and abs(value) > LARGEST:
        return f"an integer of {value.bit_length()} bits"
    return f"{value:g}" if isinstance(value, float) and math.isfinite(value) else str(value)
