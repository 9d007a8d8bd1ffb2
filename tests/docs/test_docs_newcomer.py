"""A newcomer's path: every command and code block of the README and of the pages runs as it stands, offline."""

import re
import shutil
import tomllib
from pathlib import Path

import command_line
import pytest
from walk import ROOT, Block, blocks, run, walk

README = ROOT / "README.md"
PAGES = sorted((ROOT / "docs").glob("*.md"))
# Its blocks are run, and their output looked at, by tests/diagnosis.
ELSEWHERE = {"diagnosis.md"}


def in_language(page: Path, language: str) -> list[str]:
    """Return the code blocks of a page in one language."""
    return [block.text for block in blocks(page) if block.language == language]


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


def alike(shown: str, printed: str) -> bool:
    """The same words, and figures within a fifth; probabilities that are as good as zero are all alike."""
    if NUMBER.sub("#", " ".join(shown.split())) != NUMBER.sub("#", " ".join(printed.split())):
        return False
    pairs = [(float(a), float(b)) for a, b in zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True)]
    return all(abs(a - b) <= 0.2 * max(a, b) or max(a, b) < 1e-20 for a, b in pairs)


@pytest.mark.slow
def test_the_readmes_console_shows_what_is_printed() -> None:
    """Lines may be left out."""
    (block,) = [b for b in blocks(README) if b.language == "console"]
    command, *shown = block.text.splitlines()
    printed = run(Block("sh", command.removeprefix("$ ")), ROOT)
    assert printed.returncode == 0, printed.stderr
    lines = printed.stdout.splitlines()
    assert [line for line in shown if not any(alike(line, other) for other in lines)] == []


def test_alike_is_no_more_than_alike() -> None:
    assert alike("GAP 0.071 mm (P = 1e-113)", "GAP   0.070 mm (P = 6e-114)")
    assert not alike("GAP 0.071 mm", "GAP 0.050 mm")
    assert not alike("backlash@5 0.99", "backlash@4 0.99")


def test_the_problem_file_shown_is_one() -> None:
    from casadical.project.problem_file import ProblemFile

    (text,) = [b for b in in_language(ROOT / "docs" / "problem-folder.md", "toml") if "casadical = 1" in b]
    assert ProblemFile.model_validate(tomllib.loads(text)).measurements[0].separation


def test_the_figures_on_networks_are_those_of_the_studies() -> None:
    """Every number of compensator.md's results occurs in what a study printed, to the digits shown."""
    page = (ROOT / "docs" / "compensator.md").read_text(encoding="utf-8")
    results = page[page.index("## What the numbers say: on robots") :]
    studies = ("twin_networks", "real_networks")
    printed = " ".join((ROOT / "docs" / "studies" / f"{name}.txt").read_text(encoding="utf-8") for name in studies)
    known = {float(number) for number in re.findall(r"\d+(?:\.\d+)?", printed)}
    # The paper's figures, what `casadical calibrate problems/hh800` prints (tutorial 3 asserts it), and the year of a
    # source.
    known |= {14.6, 35.0, 0.417, 2006}
    shown = re.findall(r"(?<![\w-])[+-]?(\d*\.\d+|\d+)(?=[\s,;:)|%]|$)", results)
    assert len(shown) > 40
    digits = {number: len(number.partition(".")[2]) for number in shown}
    assert [n for n, d in digits.items() if not any(abs(float(n) - k) < 0.51 * 10**-d for k in known)] == []


@pytest.mark.slow
def test_the_calibrate_command_runs() -> None:
    """Its last part, in this process; .ci/run makes a fresh environment by the second command."""
    name, *arguments = in_language(README, "sh")[0].strip().split(" && ")[-1].split()
    assert Path(name).name == "casadical"
    done = command_line.run(*arguments)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("report (held out)") == 2
    assert done.stdout.count("are not identifiable.") == 2


def test_a_robot_in_the_docs_is_one(tmp_path: Path) -> None:
    from casadical import read_robot

    six_axis = (ROOT / "problems" / "hh800" / "robot.toml").read_text().replace("casadical = 1", "")
    for k, text in enumerate(in_language(ROOT / "docs" / "robot-file.md", "toml")):
        if "[[joint]]" not in text:  # what a robot may have besides: in the file of one
            head, first, rest = text.partition("[[")
            text = head + six_axis + "\n" + first + rest
        (tmp_path / f"{k}.toml").write_text(text)
        read_robot(tmp_path / f"{k}.toml")
