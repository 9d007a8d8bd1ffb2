"""The docs build without a warning, every link in them leads somewhere, and nothing is loaded from a network."""

import json
import re

import command_line
import pytest
from site_of_docs import ROOT, TUTORIALS

pytestmark = pytest.mark.slow  # the docs are built, with all tutorials


def external(link: str) -> bool:
    return bool(re.match(r"[a-z]+:|//", link))


def test_the_documented_command_builds_without_a_warning(site) -> None:
    assert site.returncode == 0, site.log[-5000:]
    assert site.log == ""
    assert "python -m sphinx -W --keep-going -b html docs build/docs" in (ROOT / "docs" / "README.md").read_text()


def test_no_page_loads_anything_from_a_network(site) -> None:
    assert [f"{path.name}: {link}" for path, page in site.pages.items() for link in page.loaded if external(link)] == []


def test_every_tutorial_is_a_notebook_that_runs_where_the_repository_is(site) -> None:
    books = {path.stem: path for path in (site.folder / "_downloads").rglob("*.ipynb")}
    assert set(books) == {name.removesuffix(".py") for name in TUTORIALS}
    cells = json.loads(books["tutorial_1_planar_arm"].read_text(encoding="utf-8"))["cells"]
    program = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    done = command_line.python(program, ROOT)
    assert done.returncode == 0, done.stderr
    assert "mm after" in done.stdout
