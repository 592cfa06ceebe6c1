"""Where a mismatch is said to be, against mismatches that were put there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.diagnosis.locating.location import locate, locate_outcome
from hil.diagnosis.recorded.dropout import Dropout
from hil.diagnosis.recorded.lattice import Lattice
from hil.diagnosis.residuals.mismatch import Mismatch, mismatch
from hil.machine import load_machine
from hil.recording import Channel, Recording, recording_metadata

MACHINE = load_machine("emps")
RATE_Hz = MACHINE.sample_rate_Hz
ROWS = 8000
TIME = np.arange(ROWS) / RATE_Hz
REFERENCE = 0.1 - 0.1 * np.cos(2.0 * np.pi * 0.5 * TIME)  # to and fro over 0.2 m, 0.31 m/s
NOISE = {"command_carriage": 2e-3, "position_carriage": 1e-7}


def mismatch_of(added, offset=0.0) -> Mismatch:
    """Four repeats of the nominal simulation with white noise and `added` (a mapping of channel to (N,) values), whose encoders' zeros
    differ by such offsets, rms.
    """
    from hil.simulation import simulate

    experiment = {"start_pose": [0.0]}
    still = Channel("V", np.zeros(ROWS))
    driven = Recording(
        {"time": Channel("s", TIME), "reference_carriage": Channel("m", REFERENCE), "excitation_carriage": still},
        recording_metadata(MACHINE, experiment=experiment),
    )
    clean = simulate(MACHINE, driven)
    repeats = {}
    for number in range(4):
        random = np.random.default_rng(number)
        channels = dict(driven.channels)
        for name, rms in NOISE.items():
            values = clean[name] + rms * random.standard_normal(ROWS) + added.get(name, 0.0)
            values = values + (offset * random.standard_normal() if name == "position_carriage" else 0.0)
            channels[name] = Channel(clean.channel(name).unit, values)
        repeats[f"repeat {number}"] = Recording(channels, driven.metadata)
    return mismatch(MACHINE, repeats)


def overlap(spans, low: float, high: float) -> float:
    """Intersection over union of intervals with one interval."""
    inside = sum(max(0.0, min(b, high) - max(a, low)) for a, b in spans)
    return inside / (sum(b - a for a, b in spans) + (high - low) - inside)


def test_a_burst_is_found_in_its_channel_and_its_time():
    envelope = np.where((TIME > 3.0) & (TIME < 4.0), np.sin(np.pi * (TIME - 3.0)) ** 2, 0.0)
    burst = 0.05 * np.sin(2.0 * np.pi * 40.0 * TIME) * envelope
    location = locate(mismatch_of({"command_carriage": burst}))
    assert location.channels["command_carriage"] > 0.99
    assert sum(location.channels.values()) == pytest.approx(1.0)
    assert overlap(location.time_s["repeat 0"], 3.0, 4.0) > 0.8
    assert overlap(np.log(location.frequency_hz), np.log(36.0), np.log(44.5)) > 0.5


def test_the_share_of_a_span_is_of_all_power_above_noise():
    """A burst of 4.7 s of noise's power, and 0.72 of it all the time, too little to be marked: 5.8 s."""
    envelope = np.where((TIME > 3.0) & (TIME < 4.0), np.sin(np.pi * (TIME - 3.0)) ** 2, 0.0)
    added = 0.01 * np.sin(2.0 * np.pi * 40.0 * TIME) * envelope + 1.2 * NOISE["command_carriage"] * np.sin(2.0 * np.pi * 70.0 * TIME)
    location = locate(mismatch_of({"command_carriage": added}))
    burst, always = 25.0 / 2.0 * 3.0 / 8.0, 1.2**2 / 2.0
    ((begin, end),) = location.time_s["repeat 0"]
    assert location.shares["time_s"]["all"] == pytest.approx((burst + always * (end - begin)) / (burst + always * 8.0), abs=0.06)


def test_of_a_constant_a_fifth_counts():
    """What a sine's half wave leaves of it beyond line 0: of it every recording has one line, and that does not say what its noise is."""
    wave, shift = NOISE["command_carriage"] * np.sin(2.0 * np.pi * 25.0 * TIME), 1.5 * NOISE["position_carriage"]
    location = locate(mismatch_of({"command_carriage": wave, "position_carriage": np.full(ROWS, shift)}))
    expected = np.array([0.5, 1.5**2 * 2.0 * (8.0 / np.pi**2) / 9.0])
    assert list(location.channels.values()) == pytest.approx(expected / expected.sum(), abs=0.05)


def test_a_mismatch_at_one_end_of_the_way_is_found_there():
    position = REFERENCE
    bump = 0.05 * np.sin(2.0 * np.pi * 60.0 * TIME) * (position > 0.15)
    location = locate(mismatch_of({"command_carriage": bump}))
    assert overlap(location.position["carriage"], 0.15, 0.2) > 0.7
    assert location.direction["carriage"] == "both"


def test_a_mismatch_in_one_direction_is_said_to_be_one_way():
    speed = np.gradient(REFERENCE, TIME)
    location = locate(mismatch_of({"command_carriage": 0.05 * np.sin(2.0 * np.pi * 60.0 * TIME) * (speed > 0.02)}))
    assert location.direction["carriage"] == "positive"
    assert overlap(location.speed["carriage"], 0.02, speed.max()) > 0.8
    assert location.shares["direction"]["carriage"] > 0.98


def test_a_mismatch_that_is_everywhere_is_not_localised_in_time_or_pose():
    location = locate(mismatch_of({"position_carriage": 2e-5 * np.sin(2.0 * np.pi * 25.0 * TIME)}))
    assert location.channels["position_carriage"] > 0.99
    assert location.time_s == {} and location.position == {} and location.speed == {}


def test_what_an_effect_adds_is_located_without_the_noise():
    found = mismatch_of({})
    effect = np.zeros((ROWS, len(found.channels)))
    effect[2000:2500, found.channels.index("position_carriage")] = 1e-6 * np.sin(2.0 * np.pi * 50.0 * TIME[2000:2500])
    location = locate(found, [effect])
    assert location.channels == {"command_carriage": 0.0, "position_carriage": 1.0}
    assert overlap(location.time_s["repeat 3"], 2.0, 2.5) > 0.6


def test_every_period_has_the_mismatch_at_its_own_time():
    burst = np.where((TIME > 3.0) & (TIME < 4.0), 0.05 * np.sin(2.0 * np.pi * 40.0 * TIME), 0.0)
    found = mismatch_of({"command_carriage": burst})
    windows = tuple(slice(number * ROWS, (number + 1) * ROWS) for number in (0, 1, 3, 4))  # the third was lost
    location = locate(replace(found, groups=(replace(found.groups[0], windows=windows),)))
    for label, begins in zip(found.groups[0].labels, (0.0, 8.0, 24.0, 32.0), strict=True):
        assert overlap(location.time_s[label], begins + 3.0, begins + 4.0) > 0.8, label


LOST = Dropout(0.02, (0.01, 0.03), 1.0, "", 5.0)


def test_what_an_imu_loses_is_in_its_channels():
    names = ("position_carriage", "imu_x", "imu_z", "gyro_y")
    plain = mismatch_of({})
    noise = replace(plain.noise, density=np.repeat(plain.noise.density[:, :1], 4, axis=1))
    found = replace(plain, channels=names, noise=noise, lost={"imu": LOST, "position_carriage": LOST})
    said = locate_outcome(found, [], [np.zeros((ROWS, 4))], named=True)
    assert said.channels == pytest.approx({"position_carriage": 0.5, "imu_x": 1 / 6, "imu_z": 1 / 6, "gyro_y": 1 / 6})


@pytest.mark.parametrize("adds", [0.0, 2e-7])
def test_lost_readings_are_located_where_they_were_lost_beside_what_effects_add(adds):
    found = mismatch_of({})
    whole, rows, command = found.groups[0], slice(1000, 1005), found.channels.index("command_carriage")
    held = whole.measured.copy()
    held[0, rows, command] += 40.0 * found.noise.std[command]
    kept = held.copy()
    kept[0, rows, command] = np.nan
    found = replace(found, groups=(replace(whole, measured=held).without(kept),), lost={"command_carriage": LOST})
    effect = np.zeros((ROWS, len(found.channels)))
    effect[2000:2500, 1 - command] = adds * np.sin(2.0 * np.pi * 50.0 * TIME[2000:2500])
    said = locate_outcome(found, [whole.simulated], [effect], named=True)
    taper = 2.0 * np.sin(np.pi * (np.arange(ROWS) + 0.5) / ROWS) ** 2
    lost, other = 5 * 40.0**2 / whole.repeats * taper[1002], float(taper @ (effect[:, 1 - command] / found.noise.std[1 - command]) ** 2)
    assert said.channels["command_carriage"] == pytest.approx(lost / (lost + other), rel=0.2)  # both noises are nearly white
    begins = [begin for begin, _ in said.time_s["repeat 1"]]
    assert begins[0] == pytest.approx(TIME[1000], abs=0.2) and len(begins) == (1 if adds == 0.0 else 2)


@pytest.mark.parametrize("offset", [0.0, 3.0, 10.0])
def test_offsets_that_repeats_differ_by_are_noise(offset):
    """In units of the encoder's noise; a wave of half the command's noise is where the mismatch is."""
    wave = 0.5 * NOISE["command_carriage"] * np.sin(2.0 * np.pi * 25.0 * TIME)
    found = mismatch_of({"command_carriage": wave}, offset * NOISE["position_carriage"])
    location = locate(found)
    assert location.channels["command_carriage"] > 0.9
    assert all(low > 10.0 for low, _ in location.frequency_hz)


def test_a_coarse_lattice_has_its_share_beside_what_effects_add():
    """A count of c has c^2/12 in every line, a wave of amplitude A on n rows has n A^2/4 in one."""
    found = mismatch_of({})
    position = found.channels.index("position_carriage")
    count = 5.0 * NOISE["position_carriage"]
    coarse = replace(found, lattices={"position_carriage": Lattice(count, (count, count), 100)})
    wave = np.zeros((ROWS, 2))
    wave[:, 1 - position] = 0.1 * NOISE["command_carriage"] * np.sin(2.0 * np.pi * 50.0 * TIME)
    assert locate_outcome(found, [], [wave], named=True).channels["command_carriage"] == 1.0
    inverse = np.interp(np.fft.rfftfreq(ROWS, 1.0 / RATE_Hz)[1:], found.noise.grid_Hz, 1.0 / found.noise.density[:, position])
    noise = np.interp(50.0, found.noise.grid_Hz, found.noise.density[:, 1 - position])
    rounding, power = count**2 / 12.0 * inverse.sum(), ROWS / 4.0 * (0.1 * NOISE["command_carriage"]) ** 2 / noise
    said = locate_outcome(coarse, [], [wave], named=True)
    assert said.channels["command_carriage"] == pytest.approx(power / (power + rounding), rel=0.2)
    assert said.frequency_hz == locate_outcome(found, [], [wave], named=True).frequency_hz  # rounding is in no band


def test_unknown_physics_beside_lost_samples_is_where_the_simulation_is_off():
    """The lost samples are the encoder's, the unknown wave is in the command."""
    wave = 0.05 * np.sin(2.0 * np.pi * 40.0 * TIME) * (TIME > 6.0)
    found = replace(mismatch_of({"command_carriage": wave}), lost={"position_carriage": LOST})
    simulated, nothing = found.groups[0].simulated, np.zeros((ROWS, 2))
    said = locate_outcome(found, [simulated], [nothing], named=True, unknown=True)
    assert said.channels["command_carriage"] > 0.99
    assert overlap(said.time_s["repeat 0"], 6.0, 8.0) > 0.8
    assert locate_outcome(found, [simulated], [nothing], named=True, unknown=False).channels["position_carriage"] == 1.0
