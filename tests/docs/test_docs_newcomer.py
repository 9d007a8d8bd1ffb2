"""A newcomer's path: every command and code block of the README and of the pages runs as it stands, offline."""

import re
import shlex
import shutil
import tomllib
from pathlib import Path

import pytest
from walk import ROOT, Block, blocks, run, walk

PAGES = sorted((ROOT / "docs").glob("*.md"))
# Its blocks are run, and their output looked at, by tests/diagnosis.
ELSEWHERE = {"diagnosis.md"}


def needs(page: Path) -> str:
    """A tool that the page's commands call and that is not here."""
    commands = " ".join(block.text for block in blocks(page) if block.language == "sh")
    return "gcc" if re.search(r"\bgcc\b|export c", commands) and not shutil.which("gcc") else ""


RUNNABLE = [
    page for page in PAGES if page.name not in ELSEWHERE and {b.language for b in blocks(page)} & {"sh", "python"}
]
NUMBER = re.compile(r"(?<![\w@])\d+(?:\.\d+)?(?:e-?\d+)?")


@pytest.mark.slow
@pytest.mark.parametrize("page", RUNNABLE, ids=lambda p: p.name)
def test_every_block_runs(page: Path, tmp_path: Path) -> None:
    if tool := needs(page):
        pytest.skip(f"no {tool} on this machine")
    for block, done in walk(page, tmp_path):
        assert done.returncode == 0, f"{block.text}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"


def test_what_the_pages_show_is_known_to_these_tests() -> None:
    """No block in a language that nothing here looks at."""
    known = {"", "sh", "python", "toml", "csv", "c", "console", "synopsis", "text", "{eval-rst}", "json"}
    strange = {(p.name, b.language) for p in (*PAGES, ROOT / "README.md") for b in blocks(p) if b.language not in known}
    assert strange == set()


def alike(shown: str, printed: str) -> bool:
    """The same words, and figures within a fifth; probabilities that are as good as zero are all alike."""
    if NUMBER.sub("#", " ".join(shown.split())) != NUMBER.sub("#", " ".join(printed.split())):
        return False
    pairs = [(float(a), float(b)) for a, b in zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True)]
    return all(abs(a - b) <= 0.2 * max(a, b) or max(a, b) < 1e-20 for a, b in pairs)


@pytest.mark.slow
def test_the_readmes_console_shows_what_is_printed() -> None:
    """Lines may be left out."""
    (block,) = [b for b in blocks(ROOT / "README.md") if b.language == "console"]
    command, *shown = block.text.splitlines()
    printed = run(Block("sh", command.removeprefix("$ ")), ROOT)
    assert printed.returncode == 0, printed.stderr
    lines = printed.stdout.splitlines()
    assert [line for line in shown if not any(alike(line, other) for other in lines)] == []


def test_alike_is_no_more_than_alike() -> None:
    assert alike("GAP 0.071 mm (P = 1e-113)", "GAP   0.070 mm (P = 6e-114)")
    assert not alike("GAP 0.071 mm", "GAP 0.050 mm")
    assert not alike("backlash@5 0.99", "backlash@4 0.99")


@pytest.mark.parametrize("folder", sorted((ROOT / "problems").iterdir()), ids=lambda f: f.name)
def test_a_problems_readme_names_its_own_command(folder: Path) -> None:
    """The command itself is run, with its figures, by tests/problems."""
    found = [shlex.split(b.text) for b in blocks(folder / "README.md") if b.text.startswith("casadical")]
    verb = "diagnose" if "[logs]" in (folder / "problem.toml").read_text(encoding="utf-8") else "calibrate"
    assert found == [["casadical", verb, f"problems/{folder.name}"]]


def test_the_problem_file_shown_is_one() -> None:
    from casadical.project.problem_file import ProblemFile

    page = ROOT / "docs" / "problem-folder.md"
    (text,) = [b.text for b in blocks(page) if b.language == "toml" and "casadical = 1" in b.text]
    assert ProblemFile.model_validate(tomllib.loads(text)).measurements[0].separation


def test_the_figures_on_networks_are_those_of_the_studies() -> None:
    """Every number of compensator.md's results occurs in what a study printed, to the digits shown."""
    page = (ROOT / "docs" / "compensator.md").read_text(encoding="utf-8")
    results = page[page.index("## What the numbers say: on robots") : page.index("## Slips in the paper")]
    studies = ("trainers", "twin_networks", "real_networks")
    printed = " ".join((ROOT / "docs" / "studies" / f"{name}.txt").read_text(encoding="utf-8") for name in studies)
    known = {float(number) for number in re.findall(r"\d+(?:\.\d+)?", printed)}
    # The paper's figures, its 40 poses, what `casadical calibrate problems/hh800` prints (tutorial 3 asserts it), and
    # how many residuals `trainers.py` holds out.
    known |= {14.6, 35.0, 40.0, 0.417, 1000.0}
    shown = re.findall(r"(?<![\w-])[+-]?(\d*\.\d+|\d+)(?=[\s,;:)|%]|$)", results)
    assert len(shown) > 100
    digits = {number: len(number.partition(".")[2]) for number in shown}
    assert [n for n, d in digits.items() if not any(abs(float(n) - k) < 0.51 * 10**-d for k in known)] == []


def test_every_study_named_has_its_output_beside_it() -> None:
    """`docs/studies/NAME.py` or .txt named in a page: both are there, unless the script is no study that prints."""
    makers = {
        "acting",
        "architecture",
        "certify",
        "diagnosis_tables",
        "licences",
        "picture",
        "planar",
        "real_data",
        "synthetic",
    }
    texts = [page.read_text(encoding="utf-8") for page in (*PAGES, ROOT / "README.md")]
    named = {name for text in texts for name in re.findall(r"studies/(\w+)\.(?:py|txt)", text)}
    assert len(named) > 8
    for name in named - makers:
        printed = ROOT / "docs" / "studies" / f"{name}.txt"
        assert printed.exists(), name
        made = (ROOT / "docs" / "studies" / f"{name}.py").exists()
        assert made or "    casadical " in printed.read_text(encoding="utf-8"), name  # its command stands in it
