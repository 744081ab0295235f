"""Who does the jobs of a replay: this process, all cores of this machine, or the workers of a Dask cluster.

A job that fails is a result like any other; one that takes its worker down with it is found out and reported.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Any

from bms_ukf.errors import ConfigError
from bms_ukf.replay.batch import Done, Job, work

CONNECT_S = 10
DIED = "the process that ran it died, which happens when memory runs out"


def cores() -> int:
    """Of this machine, as far as this process may use them."""
    return len(os.sched_getaffinity(0))


def here(jobs: Sequence[Job], processes: int, do: Callable[[Job], Done] = work) -> Iterator[Done]:
    """Results as they come, in order, from so many processes of this machine; one process: from this one."""
    if processes == 1 or len(jobs) == 1:
        yield from map(do, jobs)
        return
    pending = list(jobs)
    while pending:
        # Forked processes would share the locks of a compiler that runs threads.
        pool = ProcessPoolExecutor(min(processes, len(pending)), mp_context=get_context("spawn"))
        with pool:
            try:
                for future in [pool.submit(do, job) for job in pending]:
                    yield future.result()
                    del pending[0]
            except BrokenProcessPool:
                if processes == 1:  # then it was the one that ran
                    yield Done(pending[0].recording, None, f"{pending[0].recording}: {DIED}")
                    del pending[0]
        processes = 1


def cluster(jobs: Sequence[Job], address: str, do: Callable[[Job], Done] = work) -> Iterator[Done]:
    """Results in the order they are ready from the workers of the Dask scheduler at `address`.

    The workers must see the same files under the same names, and have this version installed. A job is given to
    another worker when its own is lost. Raises ConfigError if there is no such scheduler.
    """
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise ConfigError("--scheduler", value=address, expected="pip install 'bms-ukf[fleet]'") from None
    try:
        connect: Callable[..., Any] = Client
        client = connect(address, timeout=CONNECT_S)
    except (OSError, ValueError, TypeError) as error:
        reason = str(error).partition("\n")[0]
        raise ConfigError("--scheduler", value=address, expected=f"a Dask scheduler that answers ({reason})") from None
    with client:
        doing: dict[Any, Job] = {client.submit(do, job, pure=False): job for job in jobs}
        completed: Callable[..., Iterator[Any]] = as_completed
        for future in completed(doing):
            recording, failure = doing[future].recording, future.exception()
            yield future.result() if failure is None else Done(recording, None, f"{recording}: {_line(failure)}")


def _line(error: BaseException) -> str:
    return DIED if type(error).__name__ == "KilledWorker" else f"{type(error).__name__}: {error}"
