"""Robots on a Dask cluster, the machine's own or another one: a row of each as it is done, few in flight at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import islice
from time import monotonic, sleep
from typing import Any

from casadical.core.errors import InputError, optional

# Tasks that each worker has or waits for.
AHEAD = 4
# A task whose worker dies is given to another one so often.
RETRIES = 2
# A scheduler is given up when it has not answered for so many seconds.
PATIENCE = 10.0
_GONE = "the scheduler no longer answers"
_NEEDED = "a fleet needs dask, distributed and pyarrow; install them: pip install 'casadical[fleet]'"


class SchedulerLostError(InputError):
    """The scheduler no longer answers."""


@contextmanager
def client_of(scheduler: str | None, workers: int | None) -> Iterator[Any]:
    """A client of a scheduler, or of processes of this machine, one core each. Raises InputError."""
    distributed = optional("distributed", _NEEDED)
    dask = optional("dask", _NEEDED)
    with ExitStack() as stack:
        stack.enter_context(dask.config.set({"distributed.comm.timeouts.connect": "10s"}))
        try:
            if scheduler is None:
                cluster = distributed.LocalCluster(
                    n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs=50
                )
                stack.enter_context(cluster)
                yield stack.enter_context(distributed.Client(cluster))
            else:
                yield stack.enter_context(distributed.Client(scheduler, timeout="10s"))
        except (OSError, TimeoutError) as error:
            raise SchedulerLostError(f"{scheduler or 'local cluster'}: no scheduler answers: {error}") from None


def results(
    client: Any, function: Callable[..., dict[str, Any]], tasks: Sequence[tuple[Any, ...]]
) -> Iterator[tuple[tuple[Any, ...], dict[str, Any] | Exception]]:
    """Each task with its result in the order of completion, or with the exception that ended it.

    Raises SchedulerLostError when the scheduler dies; what was given until then is good.
    """
    distributed = optional("distributed", _NEEDED)
    waiting = iter(tasks)
    of: dict[str, tuple[Any, ...]] = {}
    working = distributed.as_completed(with_results=False, raise_errors=False)

    def submit(count: int) -> None:
        for task in islice(waiting, count):
            future = client.submit(function, *task, pure=False, retries=RETRIES)
            of[future.key] = task
            working.add(future)

    submit(AHEAD * max(1, len(client.scheduler_info(n_workers=-1)["workers"])))
    while of:
        _wait(client, working)
        future = next(working)
        if future.status in ("cancelled", "lost"):
            raise SchedulerLostError(_GONE)
        try:
            found = future.exception(timeout="30s") if future.status == "error" else future.result(timeout="30s")
        except (OSError, TimeoutError, distributed.CancelledError) as error:
            raise SchedulerLostError(f"{_GONE}: {error}") from None
        task = of.pop(future.key)
        submit(1)
        yield task, found


def _wait(client: Any, working: Any) -> None:
    """Until a task is done. Raises SchedulerLostError where the scheduler has not answered for a while."""
    heard = monotonic()
    while not working.has_ready():
        if client.status == "running":
            heard = monotonic()
        elif client.status == "closed" or monotonic() - heard > PATIENCE:
            raise SchedulerLostError(_GONE)
        sleep(0.05)
