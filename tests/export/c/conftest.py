"""Shared exports: each is made once a session, and the double one of each test is the fast one."""

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
    """Return folders of exports by (product, real), each written when it is first asked for."""

    class Folders(dict):
        def __missing__(self, key):
            folder = tmp_path_factory.mktemp("_".join(key))
            product = network if key[0] == "network" else command
            write_c(product, folder, name="arm", real=key[1], vectors=1_000)
            self[key] = folder
            return folder

    return Folders()


@pytest.fixture(scope="session")
def kernels(exported):
    """Return the exports loaded again from their folders, by (product, real)."""

    class Kernels(dict):
        def __missing__(self, key):
            self[key] = load(exported[key])
            return self[key]

    return Kernels()
