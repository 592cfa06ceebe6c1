"""How large places and frequencies may be beforehand, against the evidence that they are to stand for."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.integrate
from carriage import MACHINE, repeats

from hil.diagnosis.fitting.coordinates import Coordinates, Point
from hil.diagnosis.fitting.information import information_of
from hil.diagnosis.fitting.refit import Fitted, refit
from hil.diagnosis.fitting.visited import Travel, Visited
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import EffectAt
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns
from hil.diagnosis.tuning.retune import retune
from hil.machine import load_machine
from hil.recording import Channel, Recording, recording_metadata
from virtual_bus.effects.registry import effects

STOP, CABLE = EffectAt("end_stop", "arm"), EffectAt("cable_spring", "arm")
NONE = SimpleNamespace(at=lambda offset: offset)


def described(effect: EffectAt, visited: Visited, **values: float):
    """The parameters of a fit that stands at these values, by name, and its coordinates."""
    own = np.array([values.get(p.name, 0.0) for p in effects()[effect.effect].parameters])
    fit, at = Coordinates(NONE, (effect,), (own,), visited), Point(np.zeros(0), (own,))
    return {one.parameter.name: one for one in fit.described(at)}, fit, at


def size(effect: EffectAt, parameter: str, visited: Visited, **values: float) -> float:
    return described(effect, visited, **values)[0][parameter].size


@pytest.mark.parametrize("zero", [0.0, 0.3, -4.0])
def test_a_place_costs_what_a_range_around_it_does_wherever_zero_is(zero):
    """The log of the mean likelihood over a range of 2 rad of a place that is known with 0.01 rad, less that of the likeliest place."""
    known = 0.01
    visited = Visited(10.0, {"arm": Travel(zero - 1.0, zero + 1.0)})
    place = described(STOP, visited, K=50.0, at_position=zero + 0.2)[0]["at_position"]
    (information,) = information_of(np.array([[1.0, 0.0], [0.0, (place.size / known) ** 2]]), 1, [place])
    whole, _ = scipy.integrate.quad(lambda q: np.exp(-0.5 * ((q - 0.2) / known) ** 2) / 2.0, -1.0, 1.0, points=[0.2])
    assert 0.5 * np.log1p(information) == pytest.approx(-np.log(whole), abs=1e-3)


def test_a_stop_is_where_recordings_go_and_a_cable_slack_where_the_joint_may_go():
    few_degrees = Visited(10.0, {"arm": Travel(-0.05, 0.05, 1.0, -1.5, 1.5)})
    stop, cable = size(STOP, "at_position", few_degrees, K=1.0), size(CABLE, "theta0", few_degrees, kc=1.0)
    assert cable / stop == pytest.approx(3.0 / 0.1)
    unlimited, slide = Visited(10.0, {"arm": Travel(0.2, 0.3)}), Visited(10.0, {"arm": Travel(0.2, 0.3, turns=False)})
    assert size(CABLE, "theta0", unlimited, kc=1.0) == pytest.approx(stop * 2.0 * np.pi / 0.1)
    assert size(CABLE, "theta0", slide, kc=1.0, theta0=0.25) == pytest.approx(stop)


@pytest.mark.parametrize("corner", [59.0, 50.0, 20.0, 70.0])
def test_a_low_pass_in_place_of_the_files_costs_what_a_delay_that_does_the_same_costs(corner):
    """A strength that removes this energy: what of the lag was in the machine file before is not found by the fit."""
    removed, own = 400.0, 60.0
    low_pass = described(EffectAt("imu_bandwidth", "imu"), Visited(10.0, low_passes_Hz={"imu": own}), fc=corner)[0]["fc"]
    delay = described(EffectAt("clock_offset", "imu"), Visited(10.0), t0=1e-3)[0]["t0"]
    seen = removed / (corner * (1.0 / corner - 1.0 / own)) ** 2  # per share of the lag
    priced = [information_of(np.diag([1.0, each]), 1, [one])[0] for each, one in ((seen, low_pass), (removed, delay))]
    assert priced == pytest.approx([removed, removed])
    unfiltered = described(EffectAt("imu_bandwidth", "imu"), Visited(10.0), fc=corner)[0]["fc"]
    assert information_of(np.diag([1.0, removed]), 1, [unfiltered])[0] == pytest.approx(removed)


def test_one_limit_is_a_limit():
    assert Travel(0.2, 0.3, lower=-1.0).where_it_may_go() == pytest.approx((-1.0, 2.0 * np.pi - 1.0))
    assert Travel(0.2, 0.3, upper=1.0, turns=False).where_it_may_go() == pytest.approx((0.2, 1.0))


def test_fits_look_for_a_cable_s_slack_where_the_joint_may_go_and_for_a_stop_where_recordings_go():
    visited = Visited(10.0, {"arm": Travel(0.0, 1.0, 1.0, -0.5, 1.5)})
    for effect, place, ends in (
        (CABLE, "theta0", (-0.5, 1.5)),
        (STOP, "at_position", (0.0, 1.0)),
    ):
        found, fit, at = described(effect, visited, **{place: 0.4})
        assert (found[place].parameter.low, found[place].parameter.high) == pytest.approx(ends)
        number = [p.name for p in effects()[effect.effect].parameters].index(place)
        for step, end in zip(fit.reach(at, 10.0), ends, strict=True):
            assert fit.moved(at, step).values[0][number] == pytest.approx(end)
        outside = np.array([-7.0 if p.name == place else 1.0 for p in effects()[effect.effect].parameters])
        assert fit.point(np.zeros(0), (outside,)).values[0][number] == pytest.approx(ends[0])
        ranges = dict(zip(found, fit.ranges(), strict=True))
        assert ranges[place] == pytest.approx(ends[1] - ends[0])  # of an interval where recordings do not show it


@pytest.mark.parametrize(("low", "high"), [(100.0, 200.0), (-200.0, -100.0)])
def test_a_place_may_be_where_its_joint_goes_beyond_the_catalogue_s_bounds(low, high):
    place = described(STOP, Visited(10.0, {"arm": Travel(low, high)}), K=50.0, at_position=0.5 * (low + high))[0]["at_position"]
    assert place.size == pytest.approx(100.0 / np.sqrt(2.0 * np.pi))
    assert (place.parameter.low, place.parameter.high) == pytest.approx((low, high))


@pytest.mark.parametrize("at", [0.0, 1e4])
def test_where_an_axis_stood_still_differences_of_a_place_are_numbers(at):
    _, fit, point = described(STOP, Visited(10.0, {"arm": Travel(at, at)}), K=50.0, at_position=at)
    for (e, k), (to, by) in zip(fit.free, fit.moves(point), strict=True):
        assert by != 0.0 and to.values[e][k] != point.values[e][k]
    for to_one_side, to_the_other, apart in fit.around(point, np.full(len(fit.free), 1e-3)):
        assert apart > 0.0 and to_one_side.values[0] != pytest.approx(to_the_other.values[0], rel=1e-15, abs=0.0)


def test_what_was_visited_is_each_axis_s_own():
    shipped = load_machine("carm")
    angle, slide = shipped.limits[0], replace(shipped.limits[1], unit="m")
    drives = [SimpleNamespace(ratio=500.0), SimpleNamespace(ratio=20.0)]
    machine = SimpleNamespace(
        limits=(angle, slide),
        plant=SimpleNamespace(drives=drives, imus=[SimpleNamespace(name="imu", accelerometer_bandwidth_Hz=0.0, gyro_bandwidth_Hz=60.0)]),
    )
    first = np.array([[0.1, -0.2], [0.4, -0.3], [0.2, 0.3]])
    times = np.array([0.0, 1.0, 2.0]), np.array([0.0, 9.0])
    groups = [SimpleNamespace(position=q, time_s=t) for q, t in zip((first, first[:2] + 1.0), times, strict=True)]
    visited = Visited.by(SimpleNamespace(sets={TRAIN: SimpleNamespace(groups=groups)}, machine=machine))
    assert visited.low_passes_Hz == {"imu": 60.0}
    one, other = visited.travels.values()
    assert tuple(visited.travels) == ("propeller", "roll")
    assert (one.lower, one.upper, one.ratio, one.turns) == (angle.lower, angle.upper, 500.0, True)
    assert (other.lower, other.upper, other.ratio, other.turns) == (slide.lower, slide.upper, 20.0, False)
    assert angle.upper != slide.upper
    assert visited.time_s == 9.0 and (one.low, one.high, other.low, other.high) == pytest.approx((0.1, 1.4, -0.3, 0.8))


def test_a_fit_moves_a_place_that_starts_at_zero():
    _, fit, at = described(CABLE, Visited(10.0, {"arm": Travel(-1.0, 1.0, turns=False)}), kc=1.0)
    low, high = (fit.moved(at, step).values[0][2] for step in fit.reach(at, 1.0))
    assert (low, high) == pytest.approx((-1.0, 1.0))


def test_the_search_of_a_mode_s_frequency_is_paid_once():
    """Modes a bandwidth of 2 % apart are counted; the frequency is what it is within one of them: a range of 0.02 of itself."""
    mode = described(EffectAt("structural_mode", "arm"), Visited(10.0, {"arm": Travel(-1.0, 1.0)}), J=1.0, f=8.0, zeta=0.03)[0]["f"]
    (information,) = information_of(np.diag([1.0, 1e6]), 1, [mode])  # known to a thousandth
    assert 0.5 * np.log(information) == pytest.approx(np.log(0.02 / (np.sqrt(2.0 * np.pi) * 1e-3)))


def fits(recordings: dict[str, Recording], *starts: tuple[EffectAt, list[float]]) -> tuple[list[Fitted], Visited]:
    found = mismatch(MACHINE, recordings)
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        return refit(runs, retune(runs), runs.measured(), [((e,), (np.array(v),)) for e, v in starts]), Visited.by(runs)


def moved(recording: Recording, by: float) -> Recording:
    """The same machine with its position counted from elsewhere."""
    counted = [name for name in recording.channels if name.startswith(("reference", "position"))]
    there = {name: Channel("m", recording.channels[name].values + by) for name in counted}
    return Recording({**recording.channels, **there}, recording_metadata(MACHINE, experiment={"start_pose": [by]}))


@pytest.mark.parametrize("by", [0.0, 100.0])
def test_a_stop_is_found_wherever_positions_are_counted_from(by):
    """Mass, damper, motor constant and stop scaled alike are the same machine: what the recordings tell is the stiffness per mass."""
    stopped = repeats(3, 2.0, at=lambda x: -3e4 * max(x - 0.03, 0.0))
    found = mismatch(MACHINE, {n: moved(r, by) for n, r in stopped.items()})
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        tuning = retune(runs)
        start = ((EffectAt("end_stop", "carriage"),), (np.array([1e4, 0.0, 0.02 + by, 1.0]),))
        (stop,) = refit(runs, tuning, runs.measured(), [start])
        mass = [parameter.name for parameter in runs.parameters].index("carriage.mass_kg")
        scale = tuning.at(stop.offset)[mass] / runs.nominal[mass]
    K, _, at_position, _ = stop.values[0]
    assert pytest.approx(3e4, rel=0.06) == K / scale and at_position - by == pytest.approx(0.03, abs=1e-3)
