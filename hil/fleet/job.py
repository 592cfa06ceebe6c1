"""A piece of work that is computed apart: which function, of what, with which needs; and what became of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

GB = 1e9


@dataclass(frozen=True)
class Needs:
    """What a job takes at most.

    Attributes
    ----------
    memory_GB : float
        Resident memory; a job that needs more is ended.
    threads : int
    time_s : float
        Time on the wall clock; a job that takes longer is ended.
    """

    memory_GB: float
    threads: int
    time_s: float


@dataclass(frozen=True)
class Job:
    """A call of `function(argument)`.

    Attributes
    ----------
    name : str
        Unique among the jobs of a run.
    function : str
        As `package.module:function`.
    argument : dict
        Of JSON's types, as is what the function returns: what is sent between processes is text, and nothing of it is unpickled.
    """

    name: str
    function: str
    argument: dict[str, Any]
    needs: Needs


@dataclass(frozen=True)
class Outcome:
    """What became of a job: a value, or a failure in a line that is no answer of the function, such as a killed process; and how long."""

    name: str
    value: Any = None
    failure: str = ""
    wall_s: float = field(default=0.0, compare=False)
