"""The checks that CI calls (.ci/checks.py, .ci/concepts.py) find what they are there for."""

import importlib.util
import json
import subprocess
from pathlib import Path
from types import ModuleType

import pytest
from command_line import ROOT

PAGE = """# A page

[a](gone.md) [b](page.md#nowhere) [c](page.md#a-page) `docs:gone.md` `gone.py` `parts.Joint.gone` `parts.Joint.lower`
`no_such_name` `lower_rad` `parts.gone` `casadical calibrate arm --gone` `casadical gone` `casadical calibrate --out`
""".replace(":", "/")  # else the repository itself had a dead reference
MODULE = '''"""See `parts.nothing`."""

class Joint:
    lower: float

def lower_rad(q):
    """Return a file."""
    if not q:
        raise InputError("nothing")
    return open(max(q, key=abs))
'''


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / ".ci" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def git(folder: Path, *words: str) -> None:
    who = ("-c", "user.name=t", "-c", "user.email=t@example.org")
    subprocess.run(["git", *who, *words], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    files = {"docs/page.md": PAGE, "casadical/core/parts.py": MODULE, "casadical/fleet/parts2.py": MODULE}
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", "-A")
    return tmp_path


def test_dead_references_are_found(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checks = script("checks")
    monkeypatch.setattr(checks, "ROOT", repository)
    assert sorted(checks.dead_links()) == [
        "docs/page.md: `docs:gone.md`".replace(":gone", "/gone"),
        "docs/page.md: `gone.py`",
        "docs/page.md: link to gone.md",
        "docs/page.md: link to page.md#nowhere",
    ]
    assert [fault.split("`")[1] for fault in checks.dead_names()] == [
        *("parts.Joint.gone", "no_such_name", "parts.gone", "parts.nothing", "parts.nothing"),
    ]
    assert sorted(fault.partition(": ")[2] for fault in checks.dead_options()) == [
        *("--gone", "casadical calibrate --gone", "casadical gone"),
    ]


def test_layout_files_and_ties_are_checked(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checks = script("checks")
    monkeypatch.setattr(checks, "ROOT", repository)
    (repository / "extra").write_text("/" + "home/me/file")
    git(repository, "add", "-A")
    faults = list(checks.layout())
    assert [fault for fault in faults if fault.startswith("extra")] == [
        "extra: not agreed at the top of the repository",
        "extra: names a registry or a machine's path: /" + "home/m",
    ]
    assert {fault.partition(":")[0] for fault in faults} == {"extra", "casadical/core", "casadical/fleet"}
    assert len(list(checks.files_opened())) == len(list(checks.errors_untold())) == 2
    assert [fault.partition(":")[0] for fault in checks.ties()] == ["casadical/fleet/parts2.py"]


def test_a_figure_that_rises_needs_a_reason(
    repository: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    concepts = script("concepts")
    monkeypatch.setattr(concepts, "ROOT", repository)
    (repository / ".ci").mkdir()
    held = repository / concepts.COMMITTED
    held.write_text("{}")

    def run(*words: str) -> int:
        monkeypatch.setattr("sys.argv", ["concepts.py", *words])
        return concepts.main()

    def commit(*message: str) -> None:
        git(repository, "add", "-A")
        git(repository, "commit", "-q", *(word for text in message for word in ("-m", text)))

    git(repository, "commit", "-q", "-m", "Files")
    assert run("--raise") == 0
    commit("Figures")
    assert json.loads(held.read_text())["functions"] == 2
    (repository / "casadical/core/parts.py").write_text(MODULE + "FIRST, SECOND = 1, 2\n\ndef more(): ...\n")
    assert run("--write") == 1
    assert json.loads(held.read_text())["functions"] == 2
    printed = capsys.readouterr().out
    assert "functions, public functions without a docstring" in printed
    assert "module constants, module constants of one word, statements that assign several constants" in printed
    assert run("--raise") == 0
    commit("More")
    assert run() == 1
    assert "without a body" in capsys.readouterr().out
    git(repository, "commit", "-q", "--amend", "-m", "More", "-m", "It replaces something.")
    assert run() == 0
    (repository / "casadical/core/parts.py").write_text(MODULE)
    assert run("--write") == 0
    assert json.loads(held.read_text())["functions"] == 2
