"""Each tutorial runs, and asserts its own numbers; its page says how long it took."""

import shutil
from pathlib import Path

import pytest
from site_of_docs import TUTORIALS

pytestmark = pytest.mark.slow  # of the built docs


@pytest.mark.parametrize("name", TUTORIALS)
def test_it_runs_in_the_docs(name: str, site) -> None:
    if name.startswith("tutorial_4") and not shutil.which("gcc"):
        pytest.skip("no gcc on this machine (apt-get install gcc)")
    assert name in site.tutorials, site.log[-3000:]
    assert site.tutorials[name] == ""
    page = site.folder / "gallery" / f"{Path(name).stem}.html"
    assert "Total running time of the script" in page.read_text(encoding="utf-8")
