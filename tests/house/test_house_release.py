"""What is released: wheel and sdist, their versions and bounds, and that the base install runs without the extras."""

import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import packages_distributions, version
from pathlib import Path

import pytest
from command_line import ROOT

import casadical
from casadical.core.reporting import drawing

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
REPORTED = ("urdf", "xlsx", "plots", "report", "withheld", "mujoco")
LEFT_OUT = ("plotly", "matplotlib", "yourdfpy", "openpyxl", "mujoco", "sklearn", "fpdf")
# Runs the program as often as there are lines, in a process in which the extras cannot be imported.
PROGRAM = f"""
import sys
sys.modules.update(dict.fromkeys({LEFT_OUT}))
import casadical
assert casadical.__file__.startswith(sys.argv[1]), casadical.__file__
from casadical.cli import main
for line in sys.argv[2:]:
    sys.argv = ["casadical", *line.split()]
    try:
        main()
    except SystemExit as end:
        print("exit", end.code or 0)
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """A folder with wheel and sdist, built without a network."""
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-d", folder], cwd=ROOT, check=True, capture_output=True
    )
    return folder


@pytest.mark.slow
def test_wheel_and_sdist_hold_the_package_and_nothing_great(built) -> None:
    (wheel,), (sdist,) = built.glob("*.whl"), built.glob("*.tar.gz")
    tracked = ["git", "-c", "safe.directory=*", "ls-files", "casadical"]
    expected = {*subprocess.run(tracked, cwd=ROOT, check=True, capture_output=True, text=True).stdout.splitlines()}
    with zipfile.ZipFile(wheel) as z:
        held = {name for name in z.namelist() if ".dist-info/" not in name}
    assert held == expected
    with tarfile.open(sdist) as t:
        names = {name.partition("/")[2] for name in t.getnames()}
    assert expected | {"pyproject.toml", "README.md", "LICENSE"} <= names
    assert wheel.stat().st_size < 1.4e6
    assert sdist.stat().st_size < 1.2e6


@pytest.mark.slow
def test_the_wheel_alone_takes_a_new_user_to_a_calibrated_robot(built, tmp_path) -> None:
    (wheel,) = built.glob("*.whl")
    with zipfile.ZipFile(wheel) as z:
        z.extractall(tmp_path / "site")
    lines = ("new arm --example -q", "calibrate arm --out results", "certificate results -q",
             "calibrate arm -q --report r.html", "certificate results -q --out c.pdf")  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(tmp_path / "site"), *lines], cwd=tmp_path, capture_output=True, text=True,
        env={"PYTHONPATH": str(tmp_path / "site"), "HOME": str(tmp_path), "PATH": ""}, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert re.findall(r"^exit (\d+)$", done.stdout, re.MULTILINE) == ["0", "0", "0", "2", "2"]
    assert (tmp_path / "results/SKCM.robot.toml").is_file()
    assert "pip install 'casadical[report]'" in " ".join(done.stderr.split())
    assert "pip install 'casadical[certificate]'" in " ".join(done.stderr.split())


def test_citation_and_changelog_have_the_version() -> None:
    assert "version" in PROJECT["dynamic"]
    release = casadical.__version__
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {release}\n" in citation
    assert f"\n## {release} " in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def requirements() -> dict[str, tuple[tuple[int, ...], tuple[int, ...]]]:
    """Every dependency of base and extras that users install -> the least version, and the first that is refused."""
    lines = [*PROJECT["dependencies"], *(r for e in REPORTED for r in PROJECT["optional-dependencies"][e])]
    found = {}
    for line in lines:
        name, low, high = re.fullmatch(r"([\w-]+)>=([\d.]+),<([\d.]+)", line).groups()
        found[name.lower()] = numbers(low), numbers(high)
    return found


def numbers(text: str) -> tuple[int, ...]:
    return tuple(int(n) for n in re.findall(r"\d+", text)[:3])


def test_constraints_are_of_versions_that_are_allowed_and_no_newer_major_is() -> None:
    lines = (ROOT / ".ci/constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = {name.lower(): numbers(at) for name, _, at in (x.partition("==") for x in lines if not x.startswith("#"))}
    for name, (low, high) in requirements().items():
        assert low <= pins[name] < high, name
        assert high == (pins[name][0] + 1,), f"{name}: allowed below {high}, tried with {pins[name]} only"
        assert numbers(version(name)) < high, f"{name}: the tests run with a version that is not allowed"


def test_every_dependency_has_an_upper_bound() -> None:
    for line in (*PROJECT["dependencies"], *(x for extra in PROJECT["optional-dependencies"].values() for x in extra)):
        assert "<" in line or line.startswith("casadical["), line


def test_messages_name_the_smallest_extra_with_the_missing_module() -> None:
    """Each call of `optional`: the extra that its message names has the module's distribution, and little more."""
    given = {extra: {re.split("[<>=]", x)[0] for x in xs} for extra, xs in PROJECT["optional-dependencies"].items()}
    given, distributions = {k: v for k, v in given.items() if k not in ("dev", "docs")}, packages_distributions()
    for path in (ROOT / "casadical").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        hints = dict(re.findall(r"^ *(\w+) = (f?\".*\")$", text, re.MULTILINE))
        calls = re.findall(r"(?<!def )\boptional\(\s*\"([\w.]+)\",\s*(\w+\b(?!\")|f?\".*?\")\s*\)", text)
        assert len(calls) == len(re.findall(r"(?<!def )\boptional\(", text)), path
        for module, said in calls:
            hint = hints.get(said) or (drawing.MISSING_PLOTLY if said == "MISSING_PLOTLY" else said)
            names = {name.lower() for name in distributions[module.partition(".")[0]]}
            sizes = {extra: len(has) for extra, has in given.items() if names & has}
            extra = "".join(re.findall(r"casadical\[(\w+)\]", hint))
            told = all(x in hint for x in given[extra]) if sizes else f"pip install {names.pop()}" in hint
            assert told or sizes[extra] == min(sizes.values()), (path, module, hint)
