"""Timing of a sample loop: when a tick began, and what it spent on answers, on its own computing, and on writing its commands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class LoopTiming:
    """Timing of the loop over one run."""

    ticks: int
    missed: int
    unanswered: int  # recorded all the same, without positions
    lateness_s: np.ndarray
    work_time_s: np.ndarray
    answer_time_s: np.ndarray
    write_time_s: np.ndarray
    notes: tuple[str, ...] = ()
    judged: tuple[str, ...] = ()  # sensors that were not to be believed, with which the run went on; a line each

    def summary(self) -> dict[str, float]:
        """Return counts of ticks, and percentiles [us] of lateness and work time, and of its parts: answers, computing, writing.

        The loop's own work is computing and writing together.
        """
        table: dict[str, float] = {"ticks": self.ticks, "missed": self.missed, "unanswered": self.unanswered}
        measured = {"lateness": self.lateness_s, "work_time": self.work_time_s, "answer_time": self.answer_time_s}
        measured["own_work_time"] = self.work_time_s - self.answer_time_s
        measured |= {"compute_time": self.compute_time_s, "write_time": self.write_time_s}
        for name, values in measured.items():
            if values.size:
                p50, p99, p999 = np.percentile(values, [50.0, 99.0, 99.9]) * 1e6
                table |= {f"{name}_p50_us": p50, f"{name}_p99_us": p99, f"{name}_p99.9_us": p999, f"{name}_max_us": values.max() * 1e6}
        return table

    @property
    def compute_time_s(self) -> np.ndarray:
        """Time (ticks,) between the last answer and the moment when the command is ready [s]."""
        computing: np.ndarray = self.work_time_s - self.answer_time_s - self.write_time_s
        return computing
