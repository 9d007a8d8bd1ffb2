"""The repository's own files, as git tracks them."""

import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]


def tracked() -> list[Path]:
    """Every tracked file, relative to the root."""
    listed = subprocess.run(
        ["git", "-c", "safe.directory=*", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    return [Path(name) for name in listed.split("\0") if name and (ROOT / name).exists()]


def fenced(markdown: Path, language: str) -> list[str]:
    """The contents of a Markdown file's code blocks in one language."""
    blocks, inside = [], False
    for line in markdown.read_text(encoding="utf-8").splitlines():
        if line.startswith("```"):
            inside = not inside and line == f"```{language}"
            if inside:
                blocks.append("")
        elif inside:
            blocks[-1] += line + "\n"
    return blocks
