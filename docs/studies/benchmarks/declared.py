"""What a contender's file declares (NEEDS, VARIANTS), read without importing it or the package it needs."""

import ast
from pathlib import Path


def declared(path: Path) -> dict:
    """Module-level literals of a Python file, by name."""
    found = {}
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            try:
                found[node.targets[0].id] = ast.literal_eval(node.value)
            except ValueError:
                continue  # not a literal
    return found
