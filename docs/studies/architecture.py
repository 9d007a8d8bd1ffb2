"""The floor plan of the package, drawn from its imports: python docs/studies/architecture.py [--check]

Nothing of the package is imported. It writes docs/images/architecture.svg and the
tables between the markers of docs/architecture.md. `--check` writes nothing and ends in 1 if the page is out of date:
other rooms, imports or circles, or a figure that differs by more than a tenth.

A room is an entry of the package's folder: a folder or a module. An arrow from room A to room B means that a module of
A imports one of B, anywhere in the file: also inside functions and under TYPE_CHECKING.
"""

from __future__ import annotations

import ast
import re
import sys
from statistics import median

from floor_plan import ROOT, floors, picture
from imports_of_package import House
from parameter_walk import Walk

PAGE = ROOT / "docs" / "architecture.md"
PICTURE = ROOT / "docs" / "images" / "architecture.svg"
TOLERANCE = 0.1
# Ways of parameters that the page counts: module, function, parameters.
WAYS = (
    ("project.calibration", "calibrate", ("problem",)),
    ("diagnosis.diagnose", "diagnose", ("robot",)),
    ("export.controller.commands", "export_c", ("sources",)),
)


def figures(house: House) -> dict[str, str]:
    """Return what is measured, as a name and a value."""
    files = sorted(m.lines for m in house.modules.values())
    nodes = [n for m in house.modules.values() for n in m.nodes]
    functions = sorted(n.end_lineno - n.lineno + 1 for n in nodes if isinstance(n, ast.FunctionDef))
    templates = (p for p in house.folder.rglob("*") if p.suffix in (".c", ".h", ".st", ".html", ".js", ".j2", ".toml"))
    found = {
        "rooms": str(len(house.rooms)),
        "import arrows between rooms": str(len(house.arrows)),
        "Python files": str(len(files)),
        "Python lines": str(sum(files)),
        "template lines": str(sum(len(p.read_text(encoding="utf-8").splitlines()) for p in templates)),
        "file length, median and 90 %": _median_and_90(files),
        "function length, median and 90 %": _median_and_90(functions),
    }
    for module, function, parameters in WAYS:
        way = Walk(house).follow(module, function, *parameters)
        found[f"`{parameters[0]}` in {function}: stations, climbs"] = f"{way.stations}, {way.climbs}"
    return found


def _median_and_90(lengths: list[int]) -> str:
    return f"{median(lengths):.0f} and {lengths[int(0.9 * len(lengths))]} lines"


def imports_table(house: House) -> str:
    """Return of each room, top floor first, the rooms that it imports."""
    order = [room for storey in floors() for room in storey]
    rows = ["| room | imports |", "|---|---|"]
    for room in order:
        below = [other for other in order if (room, other) in house.arrows]
        rows.append(f"| `{room}` | {', '.join(f'`{b}`' for b in below) or 'nothing of the package'} |")
    circle = ", ".join(f"`{name}`" for name in house.circle)
    return "\n".join([*rows, "", f"Modules that import each other in a circle: {circle or 'none'}."])


def figures_table(house: House) -> str:
    return "\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in figures(house).items())])


def filled(text: str, house: House) -> str:
    """Return the page with new tables between their markers."""
    for name, table in (("imports", imports_table(house)), ("figures", figures_table(house))):
        between = re.compile(rf"(?<=<!-- {name} -->\n).*?(?=<!-- end of {name} -->)", re.DOTALL)
        text = between.sub(lambda _, t=table: f"\n{t}\n\n", text)
    return text


def out_of_date(house: House) -> list[str]:
    """Return what of the committed page and picture no longer holds, a line each."""
    page = PAGE.read_text(encoding="utf-8")
    found = [] if imports_table(house) in page else ["the table of imports"]
    if not PICTURE.exists() or PICTURE.read_text(encoding="utf-8") != picture(house):
        found.append("the picture")
    for name, value in figures(house).items():
        row = next((line for line in page.splitlines() if line.startswith(f"| {name} |")), "")
        then, now = (list(map(float, re.findall(r"\d+", v))) for v in (row.removeprefix(f"| {name} |"), value))
        if len(now) != len(then) or any(abs(a - b) > max(TOLERANCE * b, 2) for a, b in zip(now, then, strict=True)):
            found.append(f"a figure: {name} {value}")
    return found


def main() -> int:
    """Write the page and the picture, or check them."""
    house = House(ROOT / "casadical")
    if "--check" in sys.argv:
        stale = out_of_date(house)
        print("\n".join(f"out of date: {what}" for what in stale) or "up to date")
        return int(bool(stale))
    PICTURE.write_text(picture(house), encoding="utf-8")
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), house), encoding="utf-8")
    print(f"wrote {PICTURE.relative_to(ROOT)} and the tables of {PAGE.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
