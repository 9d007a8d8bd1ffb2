"""Shared exports: each is made once a session."""

import export_models as models
import pytest

from casadical.export import load, write_c
from casadical.export.c.kernel import compilers


@pytest.fixture(scope="session")
def network():
    return models.network_function()


@pytest.fixture(scope="session")
def command(network):
    return models.command(network)


@pytest.fixture(scope="session")
def compiler():
    found = compilers()
    if not found:
        pytest.skip("no C compiler (gcc, clang, cc) on this machine")
    return found[0]


@pytest.fixture(scope="session")
def exported(tmp_path_factory, compiler, network, command):
    """Folders of written exports by (product, real)."""
    folders = {}
    for key, product in (("network", network), ("command", command)):
        for real in ("float", "double"):
            folder = tmp_path_factory.mktemp(f"{key}_{real}")
            write_c(product, folder, name="arm", real=real, vectors=5_000)
            folders[key, real] = folder
    return folders


@pytest.fixture(scope="session")
def kernels(exported):
    """The exports loaded again from their folders, by (product, real)."""
    return {key: load(folder) for key, folder in exported.items()}
