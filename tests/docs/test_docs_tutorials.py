"""Each tutorial runs, and asserts its own numbers; its page says how long it took."""

import ast
import shutil
from pathlib import Path

import command_line
import pytest
from site_of_docs import ROOT, TUTORIALS

pytestmark = pytest.mark.slow  # of the built docs


@pytest.mark.parametrize("name", TUTORIALS)
def test_it_runs_in_the_docs(name: str, site) -> None:
    if name.startswith("tutorial_4") and not shutil.which("gcc"):
        pytest.skip("no gcc on this machine (apt-get install gcc)")
    assert name in site.tutorials, site.log[-3000:]
    assert site.tutorials[name] == ""
    page = site.folder / "gallery" / f"{Path(name).stem}.html"
    assert "Total running time of the script" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", TUTORIALS)
def test_it_asserts_numbers_of_its_own(name: str) -> None:
    """At least four comparisons; an assert of a constant or of a bare name would hold nothing."""
    tree = ast.parse((ROOT / "docs" / "tutorials" / name).read_text(encoding="utf-8"))
    asserted = [node.test for node in ast.walk(tree) if isinstance(node, ast.Assert)]
    held = [test for test in asserted if any(isinstance(part, ast.Compare | ast.Call) for part in ast.walk(test))]
    assert len(held) >= 4


def test_it_is_a_plain_file_that_runs_anywhere(tmp_path) -> None:
    path = ROOT / "docs" / "tutorials" / "tutorial_1_planar_arm.py"
    done = command_line.python(path.read_text(encoding="utf-8"), tmp_path, file=path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "0.0249 mm" in done.stdout
