"""Cases as jobs of a fleet's engine: `--scheduler URL`, or `--scheduler local` for a cluster of this computer."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from concealed.making import Places
from hil.fleet.child import function_of
from hil.fleet.cluster import on_cluster
from hil.fleet.job import Job, Needs

LOCAL = "local"
NEEDS = Needs(memory_GB=4.0, threads=1, time_s=3600.0)
"""A case has 900 s for its diagnosis, and is made and simulated besides."""


def each_on_cluster(
    task: partial[Any], numbers: Iterable[int], scheduler: str, jobs: int, then: Callable[[int, Any], None], say: Callable[[str], None]
) -> None:
    """Do `task(number)`, a partial of a function of places, for every number; a case that fails is said and the others go on."""
    [places] = task.args
    what = {
        "task": f"{task.func.__module__}:{task.func.__name__}",
        "options": task.keywords,
        "seeds": places.seeds,
        "work": str(places.work),
    }
    engine = on_cluster(None if scheduler == LOCAL else scheduler, jobs, [NEEDS], say)
    calls = (Job(str(number), f"{__name__}:call", {**what, "number": number}, NEEDS) for number in numbers)
    for outcome in engine(calls, threading.Event()):
        if outcome.failure:
            say(f"case {outcome.name}: {outcome.failure}")
        else:
            then(int(outcome.name), outcome.value)


def call(argument: dict[str, Any]) -> Any:
    """Do a task for one case."""
    task: Callable[..., Any] = function_of(argument["task"])
    return task(Places(Path(argument["work"]), argument["seeds"]), argument["number"], **argument["options"])
