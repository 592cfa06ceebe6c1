"""A bench that compiles while its nodes wait is silent for seconds, and every node takes its master for dead."""

from __future__ import annotations

import gc
from pathlib import Path

import numpy as np
import pytest
from bench_machines import edited
from numba.core.dispatcher import Dispatcher

from controllers.feedback import Feedback
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.experiments import Static
from hil.machine import machine_from_text

POSE = {"roll": 0.0, "propeller": 0.0}


def machine_codes() -> int:
    return sum(len(one.signatures) for one in gc.get_objects() if issubclass(type(one), Dispatcher))


@pytest.mark.slow
@pytest.mark.parametrize("feedforward", ["false", "true"])
def test_a_bench_that_is_open_compiles_nothing_more(tmp_path: Path, feedforward: str) -> None:
    machine = machine_from_text(edited("^gravity_feedforward = false", f"gravity_feedforward = {feedforward}"))
    (plan,) = Static(0.5, POSE).plans(machine)
    assert not plan.reference.flags.writeable, "rows that may not be written to are what had machine code of their own"
    with open_bench(machine, BenchOptions("lockstep:"), plan.start_pose) as bench:
        before = machine_codes()
        bench.run(plan, tmp_path / "run.mf4")
        assert machine_codes() == before


def test_the_feedback_has_one_machine_code_whatever_may_be_written_to() -> None:
    machine = machine_from_text(edited("^gravity_feedforward = false", "gravity_feedforward = true"))
    free, kept = np.zeros(2), np.zeros(2)
    kept.flags.writeable = False
    feedback = Feedback(machine.controllers)
    before = machine_codes()
    for rows in ((free, free, free, free), (kept, free, kept, kept), (kept, kept, kept, kept)):
        assert feedback.step(*rows, np.zeros(2)) == 0
    assert machine_codes() == before
