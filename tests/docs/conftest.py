"""The built docs, once a run."""

import importlib.util

import pytest
from site_of_docs import Site, built


@pytest.fixture(scope="session")
def site(tmp_path_factory) -> Site:
    for name in ("sphinx", "myst_parser", "sphinx_gallery", "furo", "matplotlib"):
        if importlib.util.find_spec(name) is None:
            pytest.skip(f"{name} is not installed (pip install -e '.[docs]')")
    return built(tmp_path_factory.mktemp("site"))
