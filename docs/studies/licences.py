"""Licences of what casadical installs, with each extra alone, as the packages themselves state them.

    python docs/studies/licences.py

From the metadata of the environment that it runs in, which must have the extras of users (`dev` brings them): name,
version, licence, and the extras that bring it.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]


def licence(distribution: metadata.Distribution) -> str:
    """The SPDX expression; else the classifiers; else the first line of the free text."""
    facts = distribution.metadata
    if facts.get("License-Expression"):
        return str(facts["License-Expression"])
    classified = [c.rpartition(" :: ")[2] for c in facts.get_all("Classifier", []) if c.startswith("License :: ")]
    text = (facts.get("License") or "not stated").strip().splitlines()[0]
    return ", ".join(c for c in classified if c != "OSI Approved") or text[:60]


def needed(requirement: Requirement, seen: set[tuple[str, str]]) -> Iterator[str]:
    """Names of the packages that a requirement brings here, itself first."""
    name = re.sub(r"[-_.]+", "-", requirement.name).lower()
    for extra in ("", *sorted(requirement.extras)):
        if (name, extra) in seen:
            continue
        seen.add((name, extra))
        yield name
        for text in metadata.requires(name) or ():
            further = Requirement(text)
            if further.marker is None or further.marker.evaluate({"extra": extra}):
                yield from needed(further, seen)


def main() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    groups = {"": project["dependencies"], **project["optional-dependencies"]}
    brought: dict[str, list[str]] = {}
    for group, texts in groups.items():
        if group in ("docs", "dev"):
            continue
        seen: set[tuple[str, str]] = set()
        for name in sorted({n for text in texts for n in needed(Requirement(text), seen)}):
            if "" not in brought.setdefault(name, []):
                brought[name].append(group)
    for name, groups_of in sorted(brought.items()):
        package = metadata.distribution(name)
        by = "the base" if "" in groups_of else ", ".join(groups_of)
        print(f"{package.metadata['Name']:28} {package.version:14} {licence(package):50} {by}")


if __name__ == "__main__":
    main()
