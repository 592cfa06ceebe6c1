"""A sensor that was not to be believed fails the step of a commissioning, and is warned of after a motion that is not recorded."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest

import hil.verbs.commission
import hil.verbs.run
from hil.bench.bench import Bench
from hil.bench.timing import LoopTiming
from hil.machine import load_machine
from hil.recording import RecordingWarning

FROZEN = "imu: rate x has not changed for 8 packets"


def with_a_frozen_imu(monkeypatch: pytest.MonkeyPatch, module: ModuleType, *, recorded: bool) -> None:
    """Let the judge find it in the motions that are recorded, or in those that are not."""
    actual: Callable[..., contextlib.AbstractContextManager[Bench]] = module.open_bench

    @contextlib.contextmanager
    def opened(*arguments: object) -> Iterator[Bench]:
        with actual(*arguments) as bench:
            run: Callable[..., LoopTiming] = bench.run
            unrecorded: dict[str, Callable[..., object]] = {"commission": bench.commission, "move": bench.move}

            def ran(*given: object) -> LoopTiming:
                return dataclasses.replace(run(*given), judged=(FROZEN,) if recorded else ())

            def moved(name: str, *given: object) -> object:
                found = unrecorded[name](*given)
                bench.judged = () if recorded else (FROZEN,)
                return found

            monkeypatch.setattr(bench, "run", ran)
            for name in unrecorded:
                monkeypatch.setattr(bench, name, functools.partial(moved, name))
            yield bench

    monkeypatch.setattr(module, "open_bench", opened)


@pytest.mark.parametrize(("recorded", "last", "where"), [(False, "home", "on the way home"), (True, "record", "still")])
def test_a_commissioning_ends_with_the_step_in_which_a_sensor_was_not_to_be_believed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, recorded: bool, last: str, where: str
) -> None:
    with_a_frozen_imu(monkeypatch, hil.verbs.commission, recorded=recorded)
    found = hil.verbs.commission.commission(load_machine("turntable"), "lockstep:", tmp_path)
    assert not found.ok
    assert (found.steps[-1].name, found.steps[-1].ok) == (last, False)
    assert all(step.ok for step in found.steps[:-1])
    assert found.steps[-1].said == (f"{where}: a sensor is not to be believed: {FROZEN}",)
    assert [path.name for path in found.steps[-1].files] == (["still.mf4"] if recorded else [])
    assert not list(tmp_path.glob("*.npz"))


def test_homing_and_moves_warn_of_sensors_that_were_not_to_be_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    with_a_frozen_imu(monkeypatch, hil.verbs.run, recorded=False)
    machine = hil.open_machine("turntable")
    with pytest.warns(RecordingWarning, match=f"home: a sensor is not to be believed: {FROZEN}") as warned:
        assert machine.home("lockstep:")
    assert [each.filename for each in warned] == [__file__]
    with pytest.warns(RecordingWarning, match=f"move: a sensor is not to be believed: {FROZEN}"):
        machine.move({"turn": 0.01}, "lockstep:")
