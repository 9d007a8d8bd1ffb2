"""Many independent tasks on all cores, or on whatever executor is handed in; results come as they are done.

This module loads nothing heavy, so that a new worker can be limited to one thread before numpy is loaded.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from signal import SIG_IGN, SIGINT, signal
from typing import Any, TypeVar

Result = TypeVar("Result")

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def begin_work() -> None:
    """A worker uses one thread, for workers share the cores by being many; it leaves Ctrl-C to who started it."""
    signal(SIGINT, SIG_IGN)
    for name in _THREADS:
        os.environ.setdefault(name, "1")


@contextmanager
def workers(executor: Executor | None, count: int | None = None) -> Iterator[Executor]:
    """The executor that was handed in, left open; else processes of our own, one a core."""
    if executor is not None:
        yield executor
        return
    own = ProcessPoolExecutor(count or os.cpu_count(), mp_context=get_context("spawn"), initializer=begin_work)
    try:
        yield own
    except BaseException:
        own.shutdown(wait=False, cancel_futures=True)
        raise
    own.shutdown()


def results(executor: Executor, function: Callable[..., Result], tasks: Iterable[tuple[Any, ...]]) -> Iterator[Result]:
    """What the function makes of each task's arguments, in the order in which they are done.

    An error in one ends them all; when the caller stops listening, what has not begun is cancelled.
    """
    futures: list[Future[Result]] = [executor.submit(function, *task) for task in tasks]
    try:
        for future in as_completed(futures):
            yield future.result()
    finally:
        for future in futures:
            future.cancel()
