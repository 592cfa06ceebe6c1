"""What the bench asks of its host: a real-time scheduler for a while, and where the emulator on this host has its ports."""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from hil.cli.running import RunOptions, stepped_over
from hil.emulated.card import EmulatorCard, find, published
from hil.processes.private_folder import private_folder
from hil.processes.real_time import BEHIND_THE_LOOP, FIFO_PRIORITY, behind_the_loop, real_time

BUS = "udp:239.74.163.77"


@pytest.fixture(autouse=True)
def own_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def test_an_emulators_ports_are_found_by_its_bus_as_long_as_it_lives() -> None:
    card = EmulatorCard(BUS, os.getpid(), "/dev/pts/7", "tcp:127.0.0.1:5020")
    assert find(BUS) is None
    with published(card):
        assert find(BUS) == card
        assert find("udp:239.74.163.78") is None
    assert find(BUS) is None


def test_the_card_of_an_emulator_that_was_killed_is_not_believed_whoever_has_its_number() -> None:
    card = EmulatorCard(BUS, os.getpid(), "/dev/pts/7", "")
    words = "import os, sys; from hil.emulated.card import *; held = published(card_from_text(sys.argv[1])); held.__enter__(); os._exit(0)"
    subprocess.run([sys.executable, "-c", words, json.dumps(asdict(card))], check=True)
    assert list(private_folder().glob("*.json"))
    assert find(BUS) is None
    with published(card):
        assert find(BUS) == card


def test_ticks_lost_on_an_emulated_machine_are_told_to_who_observes_it(tmp_path: Path) -> None:
    run = RunOptions(tmp_path / "r.mf4", bus=BUS, observer=tmp_path / "observer.npz")
    assert stepped_over(run, 3) == (), "a real machine moves on"
    with published(EmulatorCard(BUS, os.getpid(), "", "")):
        (line,) = stepped_over(run, 3)
        assert line.startswith("the observer stepped over 3 lost ticks, in which the emulated machine waited")
        assert stepped_over(run, 0) == () == stepped_over(replace(run, observer=None), 3)


def test_a_damaged_card_is_no_card(tmp_path: Path) -> None:
    with published(EmulatorCard(BUS, os.getpid(), "", "")):
        (path,) = tmp_path.glob("*/*.json")
        path.write_text('{"bus": 1')
        assert find(BUS) is None


def test_real_time_is_given_back_and_garbage_is_collected_again() -> None:
    before = os.sched_getscheduler(0)
    with real_time() as granted:
        assert not gc.isenabled()
        assert str(granted).startswith(("SCHED_FIFO 50", "default scheduler"))
        assert (os.sched_getscheduler(0) == os.SCHED_FIFO) == (granted.scheduler == "SCHED_FIFO 50")
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
    assert os.sched_getscheduler(0) == before


def test_what_the_loop_waits_for_is_behind_it_and_before_all_that_is_not_real_time() -> None:
    words = "import gc, os; from hil.processes.real_time import behind_the_loop; behind_the_loop();"
    words += "print(gc.get_freeze_count() > 0, os.sched_getscheduler(0), os.sched_getparam(0).sched_priority)"
    told = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True)
    with real_time() as granted:
        is_given = granted.scheduler != "default scheduler"
    assert told.stdout.split() == ["True", *map(str, (os.SCHED_FIFO, BEHIND_THE_LOOP) if is_given else (os.SCHED_OTHER, 0))]
    assert BEHIND_THE_LOOP < FIFO_PRIORITY


def test_what_the_loop_waits_for_is_never_before_a_loop_without_real_time(monkeypatch: pytest.MonkeyPatch) -> None:
    granted: list[int] = []

    def at_most_40(_: int, scheduler: int, parameters: os.sched_param) -> None:
        if parameters.sched_priority > 40:
            raise PermissionError
        granted.append(parameters.sched_priority)

    monkeypatch.setattr(os, "sched_setscheduler", at_most_40)
    with real_time() as loop:
        behind_the_loop()
        gc.unfreeze()
    assert loop.scheduler == "default scheduler"
    assert not granted


def test_real_time_that_is_not_wanted_is_not_asked_for() -> None:
    with real_time(wanted=False) as granted:
        assert granted.scheduler == "default scheduler"
        assert not granted.memory_locked


def test_a_loop_that_fails_gives_everything_back_too() -> None:
    with pytest.raises(ZeroDivisionError), real_time():
        _ = 1 / 0
    assert gc.isenabled()
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
