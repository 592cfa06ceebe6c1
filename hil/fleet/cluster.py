"""Jobs on a Dask cluster: a local one, or any whose scheduler is named."""

from __future__ import annotations

import contextlib
import importlib.util
import ipaddress
import itertools
import logging
import os
import queue
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from hil.errors import BadAnswerError, UnusableInputError
from hil.extras import extra_package
from hil.fleet.apart import run_apart
from hil.fleet.engine import Engine
from hil.fleet.job import GB, Job, Needs, Outcome

LOOPBACK = "127.0.0.1"

LOST_WORKERS = 4
"""Rounds in which a job whose worker was lost is given to another one. In each, Dask itself tries four workers: a job that ends its own
process loses no worker, so this is hardly ever the job's fault."""

RECONNECT_S = 60.0
"""How long a scheduler may be away: a restart by a service manager takes seconds."""

IN_FLIGHT = 8
"""Batches that a cluster is given at once, for each of its threads: none waits for work, and the scheduler keeps few."""

BATCH_S, BATCH_MOST = 0.25, 64
"""Short jobs of one kind are given together, up to so long and so many: giving, scheduling and fetching takes some 10 ms, and a worker that
has the last batch alone works a quarter of a second longer than the others."""

LATE = 4.0
"""Batches may take so many times as long; what is then not begun is given anew."""

REMEMBERED = 16
"""Jobs of a kind by whose mean time the next are put together: the first ones, which load what they need, are soon forgotten."""

WORKERS_S = 30.0
"""How long the first worker may take to appear."""

RESTARTED = {"distributed.deploy.lost-worker-timeout": "1 hour"}
"""Dask's local cluster gives up a worker that is not back after 15 s, for good; on a busy computer one takes longer to start."""

NOTICED_S = 10.0
"""Period at which it is looked whether there is a worker at all."""

LOCAL_SHARE = 0.9
"""Of the computer's memory that local workers offer together."""


def on_cluster(scheduler: str | None, workers: int, needs: Iterable[Needs], say: Callable[[str], None] = lambda line: None) -> Engine:
    """Return an engine on a Dask cluster.

    Parameters
    ----------
    scheduler : str or None
        Address, as `tcp://HOST:PORT` or `tls://HOST:PORT`; None: a cluster of this computer for the length of the run.
    workers : int
        Of a local cluster.
    needs : iterable of Needs
        The most that jobs will take, which some worker must offer.
    say : callable
        Told where the dashboard is, and what is lost and found.

    Raises
    ------
    UnusableInputError
        Dask is missing, or the address is none.
    """
    distributed = extra_package("distributed", "clusters")
    if scheduler is not None and not scheduler.startswith(("tcp://", "tls://")):
        raise UnusableInputError(f"--scheduler {scheduler}: must be tcp://HOST:PORT or tls://HOST:PORT")
    if scheduler is not None and scheduler.startswith("tcp://") and not _is_loopback(scheduler):
        say(f"{scheduler}: neither encrypted nor authenticated: whoever reaches it can run programs on its workers and here; use tls://")
    wanted = tuple(needs)

    def engine(jobs: Iterable[Job], cancelled: threading.Event) -> Iterator[Outcome]:
        with _client(distributed, scheduler, workers, say) as client:
            _check_offers(client, wanted, scheduler)
            yield from _Run(distributed, client, cancelled, say).outcomes(jobs)

    return engine


def _is_loopback(address: str) -> bool:
    host = address.partition("://")[2].rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


@contextlib.contextmanager
def _client(distributed: Any, scheduler: str | None, workers: int, say: Callable[[str], None]) -> Iterator[Any]:  # noqa: ANN401
    """Connect to a scheduler, or start a local cluster whose scheduler, workers and dashboard listen on the loopback interface alone."""
    with contextlib.ExitStack() as stack:
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore")
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what it says of lost workers is said here, once
        if scheduler is not None:
            try:
                client = stack.enter_context(distributed.Client(scheduler, timeout=RECONNECT_S, set_as_default=False))
            except (OSError, TimeoutError, ValueError) as problem:
                raise UnusableInputError(f"--scheduler {scheduler}: does not answer: {' '.join(str(problem).split())}") from None
            yield client
            return
        stack.enter_context(extra_package("dask.config", "clusters").set(RESTARTED))
        has_page = importlib.util.find_spec("bokeh") is not None
        try:
            cluster = distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host=LOOPBACK,
                dashboard_address=f"{LOOPBACK}:0" if has_page else None,
                memory_limit=0,
                silence_logs=logging.CRITICAL,
                resources=_share(distributed, workers),
                preload=["hil.fleet.worker"],
            )
        except (OSError, RuntimeError, TimeoutError) as problem:
            right = 'a script does its work under `if __name__ == "__main__":`; --workers 0 (workers=0) computes without a cluster'
            raise UnusableInputError(f"the cluster of this computer did not start: {problem}; {right}") from None
        local = stack.enter_context(cluster)
        client = stack.enter_context(distributed.Client(local, set_as_default=False))
        if has_page:
            say(f"dashboard: {client.dashboard_link}")
        yield client


def _share(distributed: Any, workers: int) -> dict[str, float]:  # noqa: ANN401
    """Return what each worker of this computer offers."""
    memory: float = distributed.system.MEMORY_LIMIT
    return {"memory": LOCAL_SHARE * memory / workers, "threads": max(1.0, (os.cpu_count() or 1) / workers)}


def _check_offers(client: Any, wanted: Iterable[Needs], scheduler: str | None) -> None:  # noqa: ANN401
    """Refuse a cluster on which jobs would wait for ever.

    Raises
    ------
    UnusableInputError
        It has no workers, or none that offers what some job needs.
    """
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
    except TimeoutError:
        raise UnusableInputError(f"{scheduler or 'local cluster'}: has no worker after {WORKERS_S:g} s") from None
    offers = [worker["resources"] for worker in client.scheduler_info(n_workers=-1)["workers"].values()]
    for need in wanted:
        if any(offer.get("memory", 0.0) >= need.memory_GB * GB and offer.get("threads", 0.0) >= need.threads for offer in offers):
            continue
        most = [max((offer.get(name, 0.0) for offer in offers), default=0.0) for name in ("memory", "threads")]
        offered = f"no worker offers {need.memory_GB:g} GB and {need.threads} threads (at most {most[0] / GB:.2g} GB, {most[1]:g})"
        right = "lower [limits] or --workers" if scheduler is None else "dask worker --resources 'memory=8e9 threads=2' would be right"
        raise UnusableInputError(f"{scheduler or 'local cluster'}: {offered}; {right}")


def _kind(job: Job) -> tuple[str, Needs]:
    """Return what jobs share that take about as long and offer no worker more than another."""
    return job.function, job.needs


class _Ahead:
    """Jobs in their order, of which the next is known."""

    def __init__(self, jobs: Iterable[Job]) -> None:
        self._jobs = iter(jobs)
        self._seen: list[Job] = []

    def next(self, kind: tuple[str, Needs] | None = None) -> Job | None:
        """Return the next job; None at the end, or where it is of another kind than wanted."""
        if not self._seen:
            self._seen = list(itertools.islice(self._jobs, 1))
        if not self._seen or (kind is not None and _kind(self._seen[0]) != kind):
            return None
        return self._seen.pop()


class _Run:
    """Jobs given to a cluster, some at a time."""

    def __init__(self, distributed: Any, client: Any, cancelled: threading.Event, say: Callable[[str], None]) -> None:  # noqa: ANN401
        self._distributed, self._client, self._cancelled, self._say = distributed, client, cancelled, say
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._given: dict[Any, tuple[list[Job], int]] = {}
        self._took_s: dict[tuple[str, Needs], deque[float]] = {}
        self._attempts = itertools.count()
        self._looked_s = time.monotonic()
        self._has_workers = True

    def outcomes(self, jobs: Iterable[Job]) -> Iterator[Outcome]:
        """Yield what became of each, as they end."""
        source = _Ahead(jobs)
        room = IN_FLIGHT * max(1, sum(self._client.nthreads().values()))
        try:
            while not self._cancelled.is_set():
                while len(self._given) < room and (batch := self._batch(source)):
                    self._give(batch, 0)
                if not self._given:
                    return
                try:
                    ended = self._ended.get(timeout=0.2)
                except queue.Empty:
                    self._look()
                else:
                    yield from self._outcome(ended)
            for future in list(self._given):  # cancelled: keep what is finished
                if future.status == "finished":
                    yield from self._outcome(future)
        finally:
            with contextlib.suppress(Exception):
                self._client.cancel(list(self._given), force=True)

    def _look(self) -> None:
        """Say where there is no worker, from time to time."""
        if time.monotonic() < self._looked_s + NOTICED_S or self._client.status != "running":
            return
        self._looked_s = time.monotonic()
        had, self._has_workers = self._has_workers, bool(self._client.nthreads())
        if had and not self._has_workers:
            self._say("the cluster has no worker left; waiting for one")

    def _batch(self, source: _Ahead) -> list[Job]:
        """Return the next jobs that are computed together: one where it is not known how long its like take, none at the end."""
        if (first := source.next()) is None:
            return []
        took_s = self._took_s.get(_kind(first))
        count = 1 if not took_s else int(min(max(BATCH_S * len(took_s) / max(sum(took_s), 1e-9), 1.0), BATCH_MOST))
        batch = [first]
        while len(batch) < count and (job := source.next(_kind(first))) is not None:
            batch.append(job)
        return batch

    def _give(self, jobs: list[Job], lost: int) -> None:
        most = jobs[0].needs
        needs = {"memory": most.memory_GB * GB, "threads": most.threads}
        key = f"{jobs[0].name}-{os.getpid()}-{next(self._attempts)}"
        future = self._client.submit(run_apart, jobs, LATE * BATCH_S, key=key, resources=needs, pure=False)
        self._given[future] = (jobs, lost)
        future.add_done_callback(self._ended.put)

    def _outcome(self, future: Any) -> Iterator[Outcome]:  # noqa: ANN401
        """Yield what became of a batch, or give its jobs to the cluster again, each alone, where that was lost."""
        if future not in self._given:
            return
        jobs, lost = self._given.pop(future)
        if future.status == "finished":
            try:
                outcomes: list[Outcome] = future.result(timeout=RECONNECT_S)
            except Exception as problem:  # its worker or the scheduler was lost in between
                failure: BaseException = problem
            else:
                self._learn(jobs, outcomes)
                if left := jobs[len(outcomes) :]:
                    self._give(left, lost)
                yield from outcomes
                return
        elif future.status == "error":
            failure = future.exception()
            if not isinstance(failure, self._distributed.scheduler.KilledWorker):
                said = f"could not be given to a worker: {' '.join(repr(failure).split())}"
                yield from (Outcome(job.name, failure=said) for job in jobs)
                return
        else:
            failure = TimeoutError("scheduler lost")
            self._reconnected()
        for job in jobs:
            if lost + 1 < LOST_WORKERS:
                self._give([job], lost + 1)
            else:
                yield Outcome(job.name, failure=f"its worker was lost, {LOST_WORKERS} times in a row ({type(failure).__name__})")

    def _learn(self, jobs: list[Job], outcomes: list[Outcome]) -> None:
        took_s = self._took_s.setdefault(_kind(jobs[0]), deque(maxlen=REMEMBERED))
        took_s.extend(outcome.wall_s for outcome in outcomes)

    def _reconnected(self) -> None:
        """Wait until a scheduler that was lost is there again.

        Raises
        ------
        BadAnswerError
            It is not.
        """
        if self._client.status == "running":
            return
        self._say("scheduler lost; waiting for it to come back")
        until_s = time.monotonic() + RECONNECT_S
        while self._client.status != "running":
            if self._client.status == "closed" or time.monotonic() > until_s:
                raise BadAnswerError("the scheduler was lost and did not come back; what was finished is kept, run again for the rest")
            time.sleep(0.2)
