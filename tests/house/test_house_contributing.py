"""The files for contributors and code hosts are valid, and what they say of this repository is true."""

import os
import re
import tomllib

import pytest
from repository import ROOT, fenced

import casadical

yaml = pytest.importorskip("yaml")
GITHUB = ROOT / ".github"
FORMS = sorted(path for path in (GITHUB / "ISSUE_TEMPLATE").glob("*.yml") if path.name != "config.yml")


def read(path):
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def test_the_citation_agrees_with_the_package() -> None:
    """Keys and types as the Citation File Format 1.2.0 wants them."""
    citation = read(ROOT / "CITATION.cff")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert citation["cff-version"] == "1.2.0"
    assert citation["type"] == "software"
    assert citation["message"]
    assert citation["title"].split(":")[0] == project["name"]
    assert citation["version"] == casadical.__version__.partition(".post")[0]
    assert citation["authors"] == project["authors"]
    assert (ROOT / "LICENSE").read_text(encoding="utf-8").startswith(f"{citation['license']} License")
    (paper,) = citation["references"]
    assert paper["type"] == "article"
    assert all(paper[key] for key in ("title", "authors"))
    assert project["urls"]["Paper"] == f"https://doi.org/{paper['doi']}"
    page = " ".join((ROOT / "docs" / "the-paper.md").read_text(encoding="utf-8").split())
    assert f"{paper['journal']} {paper['year']}, {paper['volume']}({paper['issue']}), {paper['start']}" in page
    assert paper["title"] in page


def test_the_hooks_are_the_house_rules() -> None:
    from test_house_style import COMMANDS

    repositories = read(ROOT / ".pre-commit-config.yaml")["repos"]
    assert [r["repo"] for r in repositories] == ["local"]  # no remote host
    hooks = repositories[0]["hooks"]
    assert [h["entry"] for h in hooks] == COMMANDS
    assert all({"id", "name", "entry", "language"} <= set(h) and h["language"] == "system" for h in hooks)
    assert len({h["id"] for h in hooks}) == len(hooks)


def test_the_workflow_calls_the_ci_script() -> None:
    workflow = read(GITHUB / "workflows" / "ci.yml")
    assert set(workflow[True]) == {"push", "pull_request"}  # YAML 1.1 reads the key `on` as true
    (job,) = workflow["jobs"].values()
    assert job["steps"][-1] == {"run": "bash .ci/run"}
    assert os.access(ROOT / ".ci" / "run", os.X_OK)


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.stem)
def test_issue_forms_are_valid(path) -> None:
    form = read(path)
    assert set(form) <= {"name", "description", "title", "labels", "assignees", "body"}
    assert form["name"]
    assert form["description"]
    assert all(part["type"] in ("textarea", "input", "dropdown", "checkboxes", "markdown") for part in form["body"])
    assert all(re.fullmatch(r"[\w-]+", part["id"]) and part["attributes"]["label"] for part in form["body"])
    assert len({part["id"] for part in form["body"]}) == len(form["body"])
    assert any(part["validations"]["required"] is True for part in form["body"])


def test_there_is_a_form_for_each_purpose() -> None:
    assert [path.stem for path in FORMS] == ["bug", "new_effect", "question"]


def test_the_test_commands_of_the_guide_name_existing_tests() -> None:
    page = GITHUB / "CONTRIBUTING.md"
    paths = re.findall(r"tests/[\w/.]+", "".join(fenced(page, "sh")))
    assert paths
    assert [p for p in paths if not (ROOT / p).exists()] == []
