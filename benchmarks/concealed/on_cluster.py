"""Cases as jobs of a fleet's engine: `--scheduler URL`, or `--scheduler local` for a cluster of this computer."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from on_engine import LOCAL, each

from concealed.making import Places
from hil.fleet.child import function_of

__all__ = ["LOCAL", "each_on_cluster"]


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
    cases = ({**what, "number": number} for number in numbers)
    for argument, row in each(case, cases, scheduler, jobs=jobs, named=lambda argument: f"case {argument['number']}", say=say):
        then(argument["number"], row)


def case(task: str, options: dict[str, Any], seeds: str, work: str, number: int) -> Any:
    """Do a task for one case."""
    called: Callable[..., Any] = function_of(task)
    return called(Places(Path(work), seeds), number, **options)
