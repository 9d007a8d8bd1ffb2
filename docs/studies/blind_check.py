"""Count the committed blind checks again: python docs/studies/blind_check.py (seconds)

A run is a folder with withheld.json, key.json and answers.METHOD.jsonl, where `casadical withheld` wrote them; those
of the third and fourth are packed by xz when they are found unpacked. Of the large runs this writes the whole print
beside this file and score.json beside the answers; of all of them the tables of docs/blind-check.md; of the last large
one the picture. The answers themselves were made by the commands on that page (hours of one core).
"""

import io
import json
import lzma
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from diagnosis_scores import power
from rich.console import Console

from casadical.blind_check import metrics
from casadical.blind_check.metrics import Estimate, sign_tests
from casadical.blind_check.protocol import XZ, stored
from casadical.blind_check.scoring import Score, draw_confusion, in_common, score
from casadical.core.files import write_whole
from casadical.core.telling.result import terminal

ROOT = Path(__file__).parents[2]
DATA, PAGE, HERE = ROOT / "data" / "withheld", ROOT / "docs" / "blind-check.md", ROOT / "docs" / "studies"
RUNS = {"first run": DATA, "second run": DATA / "second", "third run": DATA / "third", "fourth run": DATA / "fourth"}
# Whose print and score.json are kept.
LARGE, PRINT = ("first run", "third run", "fourth run"), HERE / "blind_check.txt"
METHODS = ("diagnosis", "f-test", "bic", "ebic", "gp")


def answered(run: str) -> list[Score]:
    """The score of every method whose answers a run has, the diagnosis first; none where the run is not there."""
    folder = RUNS[run]
    files = [folder / f"answers.{method}.jsonl" for method in METHODS]
    return [score(folder, folder, path) for path in files if stored(path).exists()]


def packed(folder: Path) -> None:
    for path in (folder / "key.json", *folder.glob("answers.*.jsonl")):
        if path.exists():
            # The same content gives the same bytes.
            packed = lzma.compress(path.read_bytes(), preset=9 | lzma.PRESET_EXTREME)
            path.with_name(path.name + XZ).write_bytes(packed)
            path.unlink()


def columns(found: dict[str, list[Score]]) -> dict[str, Score]:
    """The diagnosis' figures to stand side by side."""
    first = found["first run"][0]
    sound = replace(first, outcomes=tuple(t for t in first.outcomes if "backlash" not in t.effects))
    return {"first run": first, "without backlash": sound, **{run: s[0] for run, s in found.items()}}


def cells(words: Sequence[str]) -> str:
    return f"| {' | '.join(words)} |"


def head(words: Sequence[str]) -> list[str]:
    return [cells(words), "|---" * len(words) + "|"]


def told(figure: Estimate) -> str:
    return str(figure).replace("  (", " (")


def markdown(scores: dict[str, Score]) -> str:
    """Figures side by side, each with its interval."""
    rows = head(["", *(f"{name}, {len(s.outcomes)} campaigns" for name, s in scores.items()), "target"])
    for row in zip(*(s.metrics for s in scores.values()), strict=True):
        rows.append(cells([row[0].name, *(told(r.estimate) for r in row), row[0].target]))
    return "\n".join(rows)


def limits(found: dict[str, Score]) -> str:
    """Detection beside what a test could detect that knows the signature and the noise; see diagnosis_scores.power."""
    rows = head(["", *(f"{name}: detected" for name in found), *(f"{name}: could be" for name in found)])
    bands = {
        "signal >= .5": (metrics.STRONG, np.inf, 0.0),
        "signal .35 to .5": (metrics.DETECTABLE, metrics.STRONG, 0.0),
        "signal .2 to .35": (metrics.FAINT, metrics.DETECTABLE, 0.0),
        "any signal that such a test detects at least 99 times in 100": (0.0, np.inf, 0.99),
    }
    for name, (low, high, least) in bands.items():
        there = [
            [t for t in s.outcomes if t.kind != "none" and low <= t.signal < high and power(t.signal, t.poses) >= least]
            for s in found.values()
        ]
        seen = [told(metrics.detection(part, 0.0)) for part in there]
        could = [f"{np.mean([power(t.signal, t.poses) for t in part]):.3f}" if part else "-" for part in there]
        rows.append(cells([name, *seen, *could]))
    return "\n".join(rows)


def beside(found: dict[str, list[Score]]) -> str:
    """All methods on the campaigns that all of them answered, in the last run that has others than the diagnosis."""
    run = [run for run, scores in found.items() if len(scores) > 1][-1]
    scores = in_common(found[run])
    first, *others = scores
    asked = [sign_tests(first.outcomes, s.outcomes) for s in others]
    rows = head(["right on the same campaign", *(f"{first.head.by} alone : {s.head.by} alone" for s in others)])
    rows += [cells([row[0].name, *map(str, row)]) for row in zip(*asked, strict=True)]
    which = (
        f"The {run}, the {len(first.outcomes)} of its {len(first.key.campaigns)} campaigns that all of these answered:"
    )
    return "\n\n".join([which, markdown({s.head.by: s for s in scores}), "\n".join(rows)])


def made(found: dict[str, list[Score]]) -> str:
    """Every run: where it lies, by which command and versions it was made and answered, and its key's hash."""
    rows = head(["run", "lies in", "made by", "versions", "SHA-256 of the key", "whole print"])
    for run, (s, *_) in found.items():
        command = f"`casadical withheld make --n {len(s.key.campaigns)} --seed {s.key.seed}`"
        versions = ", ".join(f"{name} {number}" for name, number in (s.key.versions | s.head.versions).items())
        folder = f"`{RUNS[run].relative_to(ROOT).as_posix()}`"
        whole = f"[{PRINT.name}](studies/{PRINT.name})" if run in LARGE else "-"
        rows.append(cells([run, folder, command, versions, f"`{s.head.key_sha256}`", whole]))
    return "\n".join(rows)


def filled(page: str, tables: dict[str, str]) -> str:
    """The page with every marked place written again."""
    for name, table in tables.items():
        mark = re.compile(f"(?s)(<!-- {name} -->\n).*?(\n<!-- end -->)")
        assert mark.search(page), name
        page = mark.sub(lambda m, t=table: m[1] + t + m[2], page)
    return page


def main() -> None:
    for run in ("third run", "fourth run"):
        packed(RUNS[run])
    found = {run: scores for run in RUNS if (scores := answered(run))}
    prints = []
    for run in LARGE:
        if run in found:
            text = io.StringIO()
            Console(file=text, width=260).print(terminal(found[run][0].blocks()))
            prints.append(f"THE {run.upper()}\n\n" + re.sub(r" +$", "", text.getvalue(), flags=re.MULTILINE))
            whole = json.dumps(found[run][0].to_json(), indent=1, allow_nan=False)
            write_whole(RUNS[run] / "score.json", whole + "\n")
            draw_confusion(found[run][0], ROOT / "docs" / "images" / "blind_check_confusion.png")
    write_whole(PRINT, "\n\n".join(prints))
    tables = {
        "runs": made(found),
        "figures": markdown(columns(found)),
        "limits": limits({run: s[0] for run, s in found.items()}),
        "beside": beside(found),
    }
    write_whole(PAGE, filled(PAGE.read_text(encoding="utf-8"), tables))


if __name__ == "__main__":
    main()
