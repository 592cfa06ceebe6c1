"""Long work on the fleet's engine: seeds, draws and steps of a sweep, one after the other here or as jobs of a Dask cluster.

A benchmark that maps a function over arguments has the flag `--scheduler`: a cluster's URL, or `local` for one of this computer. Arguments
and answers are of JSON's types, so the answer is the same with and without it, to the last digit. Workers elsewhere are started with this
folder on their `PYTHONPATH`.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from hil.fleet.job import Job, Needs

LOCAL = "local"
NEEDS = Needs(memory_GB=4.0, threads=1, time_s=3600.0)
"""A case of the concealed benchmark has 900 s for its diagnosis, and is made and simulated besides; all else takes less."""


def add_scheduler(parser: argparse.ArgumentParser) -> None:
    """Add the flag."""
    parser.add_argument("--scheduler", metavar="URL", help="a Dask scheduler, or `local`, to work on; without it this process does all")


def answers(function: Callable[..., Any], arguments: Iterable[dict[str, Any]], scheduler: str | None) -> list[Any]:
    """Return `function(**argument)` of each argument, in their order; SystemExit where one has no answer."""
    arguments = list(arguments)
    found = {json.dumps(argument): answer for argument, answer in each(function, arguments, scheduler)}
    if missing := len(arguments) - len(found):
        raise SystemExit(f"{missing} of {len(arguments)} jobs gave no answer; what kept them stands above")
    return [found[json.dumps(argument)] for argument in arguments]


def each(
    function: Callable[..., Any],
    arguments: Iterable[dict[str, Any]],
    scheduler: str | None,
    *,
    jobs: int | None = None,
    named: Callable[[dict[str, Any]], str] = json.dumps,
    say: Callable[[str], None] = print,
) -> Iterator[tuple[dict[str, Any], Any]]:
    """Yield each argument with `function(**argument)`, as they end: in their order without a scheduler.

    A job that fails is said and the others go on; without a scheduler its error is raised.

    Parameters
    ----------
    function : callable
        At the top of a module, which a worker imports.
    arguments : iterable of dict
        Of JSON's types.
    scheduler : str or None
        As the flag says it.
    jobs : int, optional
        Workers of a local cluster; one per processor unless given.
    named : callable
        A name for each argument.
    say : callable
        Told of failures, and of what becomes of the cluster.
    """
    if scheduler is None:
        for argument in arguments:
            yield argument, json.loads(json.dumps(function(**argument)))
        return
    from hil.fleet.cluster import on_cluster  # needs the extra `fleet`

    called, by_name = {"function": _name_of(function)}, {named(argument): argument for argument in arguments}
    calls = (Job(name, f"{__name__}:call", {**called, "argument": argument}, NEEDS) for name, argument in by_name.items())
    engine = on_cluster(None if scheduler == LOCAL else scheduler, jobs or os.cpu_count() or 1, [NEEDS], say)
    for outcome in engine(calls, threading.Event()):
        if outcome.failure:
            say(f"{outcome.name}: {outcome.failure}")
        else:
            yield by_name[outcome.name], outcome.value


def _name_of(function: Callable[..., Any]) -> str:
    module = function.__module__
    if module == "__main__":
        module = Path(sys.modules[module].__file__ or "").stem
    return f"{module}:{function.__name__}"


def call(argument: dict[str, Any]) -> Any:
    """Do a job."""
    from hil.fleet.child import function_of

    function: Callable[..., Any] = function_of(argument["function"])
    return function(**argument["argument"])
