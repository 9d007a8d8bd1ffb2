"""One thread for linear algebra: the matrices are small, and threads that wait for each other take most of the time."""

import os

# numpy's library reads them once, when it is loaded.
_NAMES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread() -> None:
    """Let linear algebra use one thread, unless the environment says how many; to be called before numpy is loaded."""
    if not any(name in os.environ for name in _NAMES):
        os.environ.update(dict.fromkeys(_NAMES, "1"))
