"""Robots on a Dask cluster, the machine's own or another one: a row of each as it is done, few in flight at a time."""

import re
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from math import ceil
from pydoc import locate
from time import monotonic, sleep
from typing import Any

from casadical import __version__
from casadical.core.basics import InputError, optional, shown

# Tasks that each worker has or waits for.
AHEAD = 4
# A task whose worker dies is given to another one so often.
RETRIES = 2
# Dask keeps the call stacks of each second of the last hour, in workers and in the scheduler: hundreds of megabytes.
_SETTINGS = {
    "distributed.comm.timeouts.connect": "10s",
    "distributed.worker.profile.enabled": False,
    "distributed.worker.preload": [__name__],
}
# Processes of this machine listen here alone; by default Dask would serve its pages on all interfaces.
LOOPBACK = "127.0.0.1"
LAST_PORT = 65535
_GONE = "the scheduler no longer answers"
NEEDED = "a fleet needs dask, distributed and pyarrow; install them: pip install 'casadical[fleet]'"


@dataclass(frozen=True)
class Limits:
    """What a cluster is taken for.

    workers : that the scheduler keeps busy with robots one by one; with more, a task is several robots
    patience, lonely : seconds without an answer, and without a worker, after which a scheduler is given up
    """

    workers: float = 40
    patience: float = 10.0
    lonely: float = 60.0


USUAL = Limits()


class SchedulerLostError(InputError):
    """The scheduler no longer answers."""


@contextmanager
def client_of(scheduler: str | None, workers: int | None) -> Iterator[Any]:
    """A client of a scheduler, or of processes of this machine, one core each. Raises InputError."""
    distributed = optional("distributed", NEEDED)  # first: its own settings must not take the place of these
    dask = optional("dask", NEEDED)
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(_SETTINGS))
        yield _connected(distributed, stack, scheduler, workers)


def _connected(distributed: Any, stack: ExitStack, scheduler: str | None, workers: int | None) -> Any:
    try:
        if scheduler is not None:
            _refuse_address(scheduler)
            client = stack.enter_context(distributed.Client(scheduler, timeout="10s"))
            _refuse_other_versions(client, scheduler)
            return client
        cluster = distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host=LOOPBACK,
            dashboard_address=f"{LOOPBACK}:0",
            silence_logs=50,
        )
        return stack.enter_context(distributed.Client(stack.enter_context(cluster)))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"--scheduler {shown(scheduler or '')}: {error}; an address is tcp://host:8786") from None
    except (OSError, TimeoutError) as error:
        raise SchedulerLostError(f"{scheduler or 'local cluster'}: no scheduler answers: {error}") from None


def _refuse_address(scheduler: str) -> None:
    """Raises InputError for what is no address of a scheduler that this command can talk to."""
    if scheduler.startswith("tls://"):
        raise InputError(
            f"--scheduler {shown(scheduler)}: an encrypted one asks for certificates, which this command cannot give; "
            "start the scheduler with tcp:// on a network that you trust, or reach it through an SSH tunnel"
        )
    parts = re.fullmatch(r"(tcp://)?(\[[0-9a-fA-F:.]+\]|[\w.-]+):(\d{1,5})", scheduler)
    if not parts or int(parts[3]) > LAST_PORT:
        raise InputError(f"--scheduler {shown(scheduler)}: is no address; an address is tcp://host:8786")


def _refuse_other_versions(client: Any, scheduler: str) -> None:
    """Raises InputError where there are no workers, or one with another casadical."""
    versions = client.run(locate, "casadical.__version__")
    if not versions:
        raise InputError(f"{scheduler}: no worker is connected; start one there: dask worker {scheduler}")
    for worker, version in versions.items():
        if version != __version__:
            raise InputError(
                f"worker {worker} has {f'casadical {version}' if version else 'no casadical'}; this is casadical "
                f"{__version__}: install the same one there, and start the worker again"
            )


def dask_setup(_worker: Any) -> None:
    """Called by Dask in each process of this machine: Ctrl-C is for the command, which ends them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def results(
    client: Any, function: Callable[..., dict[str, Any]], tasks: Sequence[tuple[Any, ...]], limits: Limits = USUAL
) -> Iterator[tuple[tuple[Any, ...], dict[str, Any] | Exception]]:
    """Each task with its result in the order of completion, or with the exception that ended it.

    Of very many workers several are handed out together; if that ends in an exception, one by one. Raises
    SchedulerLostError when the scheduler dies; what was given until then is good.
    """
    distributed = optional("distributed", NEEDED)
    waiting = iter(tasks)
    of: dict[Any, list[tuple[Any, ...]]] = {}
    workers = max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
    size = max(1, min(ceil(workers / limits.workers), len(tasks) // (AHEAD * workers)))
    # Results are fetched by Dask, which computes one again whose worker left before that.
    working = distributed.as_completed(with_results=True, raise_errors=False)

    def submit(some: list[tuple[Any, ...]]) -> None:
        if some:
            future = client.submit(_in_turn, function, some, pure=False, retries=RETRIES)
            of[future] = some
            working.add(future)

    for _ in range(AHEAD * workers):
        submit(list(islice(waiting, size)))
    while of:
        _wait(client, working, of, limits)
        future, row = next(working)
        if future.cancelled():
            raise SchedulerLostError(_GONE)
        some = of.pop(future)
        if future.status == "error" and len(some) > 1:
            for task in some:
                submit([task])
            continue
        submit(list(islice(waiting, size)))
        yield from zip(some, [row[1]] if future.status == "error" else row, strict=True)


def _in_turn(function: Callable[..., dict[str, Any]], tasks: Sequence[tuple[Any, ...]]) -> list[dict[str, Any]]:
    return [function(*task) for task in tasks]


def _wait(client: Any, working: Any, of: Iterable[Any], limits: Limits) -> None:
    """Until a task is done. Raises SchedulerLostError where the scheduler or all workers have been gone for a while."""
    heard = asked = staffed = monotonic()
    while not working.has_ready():
        now = monotonic()
        if client.status == "running":
            heard = now
        elif client.status == "closed" or now - heard > limits.patience:
            raise SchedulerLostError(_GONE)
        if any(future.cancelled() for future in of):
            raise SchedulerLostError(_GONE)
        if heard == now and now - asked > limits.patience:
            asked = now
            with suppress(OSError):
                staffed = now if client.scheduler_info(n_workers=1)["workers"] else staffed
        if now - staffed > limits.lonely:
            raise SchedulerLostError(f"the scheduler has had no worker for {limits.lonely:.0f} s")
        sleep(0.05)
