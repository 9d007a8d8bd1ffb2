"""Independent tasks on all cores, or on a given executor; results come in the order of completion.

This module loads nothing heavy, so that a new worker can be limited to one thread before it loads
NumPy.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from signal import SIG_IGN, SIGINT, signal
from typing import Any, TypeVar

from casadical.core.subprocesses import one_thread

Result = TypeVar("Result")


def start_worker() -> None:
    """Limit a worker to one thread, as there is one worker for each core, and ignore Ctrl-C in it.

    The process that started the workers handles Ctrl-C.
    """
    signal(SIGINT, SIG_IGN)
    one_thread()


@contextmanager
def workers(executor: Executor | None, count: int | None = None) -> Iterator[Executor]:
    """Yield the given executor, which stays open, or a new one that is shut down at the end.

    executor : None: a new one; count : number of its processes, None: one per core
    """
    if executor is not None:
        yield executor
        return
    own = ProcessPoolExecutor(count or os.cpu_count(), mp_context=get_context("spawn"), initializer=start_worker)
    try:
        yield own
    except BaseException:
        own.shutdown(wait=False, cancel_futures=True)
        raise
    own.shutdown()


def completed(
    executor: Executor, function: Callable[..., Result], tasks: Iterable[tuple[Any, ...]]
) -> Iterator[Result]:
    """Yield the results of a function for each task's arguments, in the order of completion.

    An error in one task is raised and ends them all. When the caller stops, tasks that have not
    begun are cancelled.

    tasks : arguments of each call
    """
    futures: list[Future[Result]] = [executor.submit(function, *task) for task in tasks]
    try:
        for future in as_completed(futures):
            yield future.result()
    finally:
        for future in futures:
            future.cancel()
