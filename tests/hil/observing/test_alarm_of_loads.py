"""The alarm of the observer that one command makes is raised, in time, by what the design says it sees."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hil
from hil.machine import Machine, load_machine
from hil.observing import ObserverDesign, read_design, write_design
from hil.observing.held_to_truth import errors_and_variances, plan_of
from hil.observing.true_scan import true_scan
from hil.observing.unseen import SIZES, TWICE, Probe, Seen, Unseen, judged, probes
from hil.observing.usual import usual_means
from virtual_bus.settings import EffectSetting

RATE_Hz = 256.0


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("carm")


@pytest.fixture(scope="module")
def design(machine: Machine) -> ObserverDesign:
    return hil.design_observer(machine)


def load_of(design: ObserverDesign) -> Unseen:
    (load,) = (each for each in design.unseen if each.what.startswith("a load at the detector"))
    return load


def replayed(machine: Machine, design: ObserverDesign, axis: int, load_kg: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest error (N,) over what is stated in a scan of an axis with a load at the detector, and rows (N,) with an alarm."""
    loaded = machine.with_effects((*machine.added_effects, EffectSetting("payload", "detector", {"dm": load_kg})))
    alarms: list[float] = []
    scan = true_scan(loaded, plan_of(machine, axis, "quiet", None), 4100 + axis)
    error, variance, _ = errors_and_variances(loaded, scan, design.observer(), lambda each: alarms.append(each.estimate[-1]))
    places = slice(-9, -6), slice(-6, -3), slice(-3, None)
    times = np.max([np.sqrt(np.sum(error[:, at] ** 2, axis=1) / np.sum(variance[:, at], axis=1)) for at in places], axis=0)
    return times, np.array(alarms)[-len(times) :] > 0.5


@pytest.mark.slow
def test_a_load_that_the_design_says_it_sees_raises_the_alarm_within_a_second_of_the_error(
    machine: Machine, design: ObserverDesign
) -> None:
    load = load_of(design)
    assert load.size <= load.in_time < 10.0
    passings = 0
    for axis in (0, 1):
        times, alarm = replayed(machine, design, axis, 1.2 * load.in_time)  # that is known to first order, and with other noise
        assert alarm.any()
        passed = np.flatnonzero(times > TWICE)
        passings += len(passed) > 0
        assert not len(passed) or alarm[: passed[0] + round(RATE_Hz)].any()
        _, alarm = replayed(machine, design, axis, 0.1 * load.size)
        assert not alarm.any()
    assert passings


@pytest.mark.slow
def test_a_design_says_in_its_notes_and_in_its_file_what_its_alarm_does_not_see(design: ObserverDesign, tmp_path: Path) -> None:
    load = load_of(design)
    assert load.note in design.notes
    assert f"the alarm sees a load at the detector that the file does not know from {load.size:.3g} kg on" in load.note
    assert f"up to {1e3 * load.error_m:.2g} mm off" in load.note
    write_design(design, tmp_path / "made.npz")
    read = read_design(tmp_path / "made.npz")
    assert read.unseen == design.unseen
    assert np.array_equal(read.noise.usual, design.noise.usual)
    with np.load(tmp_path / "made.npz") as file:
        older = {name: values for name, values in file.items() if not name.startswith("unseen_") and name != "noise_usual"}
    np.savez(tmp_path / "older.npz", **older)
    earlier = read_design(tmp_path / "older.npz")
    assert earlier.unseen == ()
    assert earlier.noise.usual.size == 0
    assert earlier.observer().channels == design.observer().channels


def test_what_is_never_seen_and_what_is_seen_at_once_are_said_so() -> None:
    never = Unseen("a delay", float("nan"), "ms", 3.6e-4, 1.2, float("nan"))
    assert never.note == "the alarm does not see a delay: focal spot or isocentre are up to 0.36 mm off, 1.2 times what is stated"
    tried = replace(never, tried=39.0625).note
    assert tried == "the alarm does not see a delay up to 39.1 ms: focal spot or isocentre are up to 0.36 mm off, 1.2 times what is stated"
    late = replace(never, what="a load", size=9.3, unit="kg", in_time=14.0)
    assert late.note.startswith("the alarm sees a load from 9.3 kg on: with less,")
    assert late.note.endswith("within 1 s of passing twice what is stated, from 14 kg on")
    assert replace(late, in_time=float("nan")).note.endswith("within 1 s of passing twice what is stated, of no size for certain")


def test_with_less_the_estimate_is_at_most_so_far_off_in_any_scan_that_is_not_alarmed() -> None:
    """One scan is alarmed from size 100 on after large errors, the other from 150 on with tiny ones."""
    place, yes = np.arange(len(SIZES)), [True] * len(SIZES)
    early = Seen((place >= 100).tolist(), yes, (1e-5 * place).tolist(), (0.1 * place).tolist())
    late = Seen((place >= 150).tolist(), yes, [1e-6] * len(SIZES), [0.2] * len(SIZES))
    found = judged(Probe("a load", 4.0, "kg", ()), [early, late])
    assert found.size == found.in_time == 4.0 * SIZES[150]
    assert found.error_m == pytest.approx(9.9e-4)
    assert found.times == pytest.approx(9.9)
    assert found.tried == pytest.approx(40.0)
    at_once = judged(Probe("a load", 4.0, "kg", ()), [Seen(yes, yes, early.error_m, early.times)])
    assert at_once.size == 4.0 * SIZES[0]
    assert at_once.error_m == early.error_m[0]


def test_what_a_machine_cannot_have_is_not_asked_of_it(machine: Machine) -> None:
    asked = {probe.what for probe in probes(machine, 1, "imu")}
    assert "a softer mount of the detector" in asked
    bodies = tuple(
        replace(body, joint=replace(body.joint, stiffness=0.0)) if body.name == "detector" and body.joint else body
        for body in machine.plant.tree.bodies
    )
    rigid = replace(machine, plant=replace(machine.plant, tree=replace(machine.plant.tree, bodies=bodies)))
    assert {probe.what for probe in probes(rigid, 1, "imu")} == asked - {"a softer mount of the detector"}


def test_ellipsoids_of_white_innovations_are_left_about_once_in_an_hour() -> None:
    generator = np.random.default_rng(8)
    white = [generator.standard_normal((2000, 3, 16)) for _ in range(48)]
    usual = usual_means(white, RATE_Hz)
    longer = generator.standard_normal((round(600 * RATE_Hz), 3, 16))
    assert (np.sum(longer**2 / usual, axis=2) > 1.0).any(axis=1).sum() <= 1
    assert (np.sum((longer[:1000] + 2.5) ** 2 / usual, axis=2) > 1.0).any(axis=1).mean() > 0.9
