"""Jobs for a fleet's engines: sound ones, and each kind of unsound one."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path
from typing import Any

import numpy as np

from hil.fleet.job import Job, Needs

FAILING = 13
"""Number of the case that fails."""

NEEDS = Needs(memory_GB=0.5, threads=1, time_s=60.0)


def job(name: str, argument: dict[str, Any] | None = None, needs: Needs = NEEDS, called: str = "") -> Job:
    """A job that calls a function of this module."""
    return Job(called or name, f"{__name__}:{name}", argument or {}, needs)


def thirds(argument: dict[str, Any]) -> dict[str, Any]:
    """Numbers with all their digits, on a standard output that is not the answer's."""
    print("this is not the answer")
    return {"thirds": [value / 3.0 for value in argument["of"]], "process": os.getpid()}


def hang(argument: dict[str, Any]) -> None:
    """Give no answer."""
    threading.Event().wait()


def die(argument: dict[str, Any]) -> None:
    """End the process as the kernel does."""
    os.kill(os.getpid(), signal.SIGKILL)


def die_once(argument: dict[str, Any]) -> str:
    """End the process the first time."""
    mark = Path(argument["mark"])
    if not mark.exists():
        mark.touch()
        die(argument)
    return "done"


def die_with_the_worker_once(argument: dict[str, Any]) -> str:
    """End the Dask worker whose process this one is, the first time."""
    mark = Path(argument["mark"])
    if not mark.exists():
        mark.touch()
        os.kill(os.getppid(), signal.SIGKILL)
        threading.Event().wait()
    return "done"


def fill_memory(argument: dict[str, Any]) -> None:
    """Take a gigabyte and keep it."""
    taken = bytearray(1 << 30)
    for place in range(0, len(taken), 4096):
        taken[place] = 1
    threading.Event().wait()


def fail(argument: dict[str, Any]) -> None:
    """Raise an error nobody foresaw."""
    raise RuntimeError("this was not foreseen")


def case(places: object, number: int, keep: bool) -> dict[str, Any]:
    """What a case of the concealed benchmark is told."""
    if number == FAILING:
        raise RuntimeError("this case fails")
    return {"number": number, "keep": keep, "places": repr(places)}


def draw(seed: int, scale: float) -> dict[str, Any]:
    """A draw of a Monte Carlo, with all its digits."""
    if seed == FAILING:
        raise RuntimeError("this draw fails")
    return {"seed": seed, "values": (scale * np.random.default_rng(seed).standard_normal(3)).tolist()}
