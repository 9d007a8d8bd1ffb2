"""Count the committed blind check again: python docs/studies/blind_check.py (seconds)

Writes docs/studies/blind_check.txt, data/withheld/score.json, the picture, and the tables of docs/blind-check.md. The
answers themselves were made by the commands on that page (hours of one core).
"""

import io
import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from casadical.files import write_whole
from casadical.withheld.report import draw, report
from casadical.withheld.score import Score, in_common, score

ROOT = Path(__file__).parents[2]
DATA, PAGE = ROOT / "data" / "withheld", ROOT / "docs" / "blind-check.md"
SECOND = DATA / "second"
METHODS = ("diagnosis", "f-test", "bic", "gp")


def answered(method: str) -> Score:
    return score(DATA, DATA, DATA / f"answers.{method}.jsonl")


def markdown(scores: Sequence[Score], heads: Sequence[str]) -> str:
    """Figures side by side, each with its interval."""
    rows = [f"| | {' | '.join(heads)} | target |", "|---" * (len(heads) + 2) + "|"]
    for figures in zip(*(s.figures for s in scores), strict=True):
        cells = " | ".join(str(r.figure).replace("  (", " (") for r in figures)
        rows.append(f"| {figures[0].name} | {cells} | {figures[0].target} |")
    return "\n".join(rows)


def main() -> None:
    first = answered("diagnosis")
    sound = replace(first, trials=tuple(t for t in first.trials if "backlash" not in t.effects))
    runs = {"first run": first, "without backlash": sound}
    if SECOND.exists():
        runs["second run"] = score(SECOND, SECOND, SECOND / "answers.diagnosis.jsonl")
    beside = in_common([answered(m) for m in METHODS if (DATA / f"answers.{m}.jsonl").exists()])
    text = io.StringIO()
    Console(file=text, width=260).print(report([first]))
    write_whole(ROOT / "docs" / "studies" / "blind_check.txt", re.sub(r" +$", "", text.getvalue(), flags=re.MULTILINE))
    write_whole(DATA / "score.json", json.dumps(first.as_json(), indent=1, allow_nan=False) + "\n")
    draw(first, ROOT / "docs" / "images" / "blind_check_confusion.png")
    page = PAGE.read_text(encoding="utf-8")
    tables = {
        "figures": markdown(list(runs.values()), [f"{name}, {len(s.trials)} campaigns" for name, s in runs.items()]),
        "beside": markdown(beside, [f"{s.head.by}, {len(s.trials)} campaigns" for s in beside]),
    }
    for name, table in tables.items():
        page = re.sub(f"(?s)(<!-- {name} -->\n).*?(\n<!-- end -->)", lambda m, t=table: m[1] + t + m[2], page)
    write_whole(PAGE, page)


if __name__ == "__main__":
    main()
