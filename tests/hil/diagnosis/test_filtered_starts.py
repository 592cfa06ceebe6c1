"""Orders of waves and frequencies of base motions and modes by the matched filter, on an arm whose gear errs by less than it counts."""

from __future__ import annotations

import numpy as np
import pytest
from places import CONCEALED_MACHINES

from hil.diagnosis.recorded.align import aligned
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.starting.filtered_starts import with_filtered_starts
from hil.diagnosis.starting.motion import Motion
from hil.diagnosis.starting.through_the_loop import ThroughTheLoop
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns, Trial
from hil.diagnosis.tuning.projection import Projection
from hil.diagnosis.tuning.retune import retune
from hil.machine import Machine, load_machine
from hil.recording import Channel, Recording, recording_metadata
from hil.simulation import simulate

MACHINES = CONCEALED_MACHINES
ARM = load_machine(MACHINES / "tilted_arm.toml")
ROTOR = load_machine("laas_anti_cogging")
ROWS = 2000
NOISE = {
    "position_cart": 1e-5,
    "position_carriage": 1e-5,
    "effort_carriage": 0.01,
    "link_position_cart": 1e-5,
    "position_arm": 1e-5,
    "link_position_arm": 1e-5,
    "current_arm": 0.01,
    "gyro_y": 1e-3,
    "imu_x": 0.01,
    "imu_z": 0.01,
}
CYCLE = 2.0 * np.pi / 1.1 / 100.0
"""One per travel, at the motor."""
COUNT_rad = 2.0 * np.pi / (4096 * 100)
WAVES = {
    "transmission_error": np.array([0.25, 0.7 * COUNT_rad, 0.4, 0.15 * COUNT_rad, 1.0]),
    "cogging": np.array([0.25, 0.02, 0.4, 0.01, 1.0]),
    "torque_ripple": np.array([0.25, 0.005, 0.4, 0.002, 1.0]),
}


def runs_of(machine: Machine, **inputs: Channel):
    """Three repeats of a simulation, with noise."""
    random, time_s = np.random.default_rng(3), np.arange(ROWS) / machine.sample_rate_Hz
    channels = {"time": Channel("s", time_s), **inputs}
    answer = simulate(machine, Recording(channels, recording_metadata(machine))).channels

    def repeat() -> Recording:
        noisy = {
            name: Channel(own.unit, own.values + NOISE.get(name, 1e-3) * random.standard_normal(ROWS))
            for name, own in answer.items()
            if name not in channels and not (name.startswith("command_") and machine.controllers)
        }
        planned = {name: own for name, own in answer.items() if name.startswith("feedforward_")}
        return Recording(channels | noisy | planned, recording_metadata(machine))

    return mismatch(machine, aligned(machine, {f"repeat {k}": repeat() for k in range(3)}))


@pytest.fixture(scope="module")
def arm():
    time_s = np.arange(ROWS) / ARM.sample_rate_Hz
    way = 0.5 * np.sin(2.0 * np.pi * 0.25 * time_s) * np.minimum(time_s, 1.0) + 0.1 * np.sin(2.0 * np.pi * 0.9 * time_s)
    found = runs_of(ARM, reference_arm=Channel("rad", way), excitation_arm=Channel("A", np.zeros(ROWS)))
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        yield runs, retune(runs)


@pytest.fixture(scope="module")
def shaken():
    """The arm under noise up to 40 Hz, a fifth of an ampere."""
    lines = np.fft.rfft(np.random.default_rng(4).standard_normal(ROWS)) * (np.fft.rfftfreq(ROWS, 1.0 / ARM.sample_rate_Hz) < 40.0)
    noise = np.fft.irfft(lines, ROWS)
    found = runs_of(ARM, reference_arm=Channel("rad", np.zeros(ROWS)), excitation_arm=Channel("A", 0.2 * noise / noise.std()))
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        yield runs, retune(runs)


@pytest.fixture(scope="module")
def slider():
    """A carriage that goes to and fro over 0.6 m."""
    machine = load_machine(MACHINES / "slider.toml")
    time_s = np.arange(ROWS) / machine.sample_rate_Hz
    way = 0.28 * np.sin(2.0 * np.pi * 0.25 * time_s) * np.minimum(time_s, 1.0) + 0.03 * np.sin(2.0 * np.pi * 0.9 * time_s)
    found = runs_of(machine, reference_carriage=Channel("m", way), excitation_carriage=Channel("V", np.zeros(ROWS)))
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        yield runs, retune(runs)


@pytest.fixture(scope="module")
def rotor():
    """Nothing holds it."""
    command = 0.05 + 0.3 * np.sin(20.0 * np.arange(ROWS) / ROTOR.sample_rate_Hz)
    found = runs_of(ROTOR, **{f"command_{ROTOR.axes[0]}": Channel("A", command)})
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        yield runs, retune(runs)


@pytest.fixture(scope="module")
def cart():
    """Two masses on springs, swung by a force over some centimetres."""
    machine = load_machine(MACHINES / "spring_mass.toml")
    time_s = np.arange(ROWS) / machine.sample_rate_Hz
    force = 24.0 * np.sin(2.0 * np.pi * 0.6 * time_s) + 12.0 * np.sin(2.0 * np.pi * 1.1 * time_s)
    found = runs_of(machine, command_cart=Channel("N", force * np.minimum(time_s, 1.0)))
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        yield runs, retune(runs)


def smooth(random: np.random.Generator, rows: int) -> np.ndarray:
    return np.cumsum(random.standard_normal(rows))


@pytest.mark.nightly
@pytest.mark.parametrize("machine", ["arm", "rotor"])
def test_efforts_behind_a_record_have_its_products_with_their_responses(machine, request):
    runs, tuning = request.getfixturevalue(machine)
    loop, random = ThroughTheLoop(runs, TRAIN, tuning), np.random.default_rng(1)
    joints = [joint for joint in range(len(runs.machine.plant.tree.joints) + len(runs.machine.axes)) for _ in range(3)]
    efforts = [[(joint, smooth(random, len(group.time_s))) for joint in joints] for group in runs.sets[TRAIN].groups]
    responses, record = loop.responses(efforts), random.standard_normal(len(tuning.predicted))
    behind = loop.efforts_behind(record)
    products = [sum(own[k][1] @ back[:, own[k][0]] for own, back in zip(efforts, behind, strict=True)) for k in range(len(joints))]
    assert products == pytest.approx(responses @ record, rel=1e-6, abs=1e-6 * np.linalg.norm(responses, axis=1).max())


@pytest.mark.nightly
def test_a_rotor_that_nothing_holds_has_one_loop_however_far_it_turns(rotor):
    """Its answers last as long as the record: poses may not be mixed under them."""
    runs, tuning = rotor
    assert np.ptp(runs.sets[TRAIN].groups[0].position) > 1.0
    (loop,) = ThroughTheLoop(runs, TRAIN, tuning).loops
    assert len(loop.poses) == 1


def offered(arm, name: str, values: np.ndarray, at: str = "arm", load: float = 0.0) -> tuple[list[np.ndarray], float]:
    """Starts where this wave is missing in noise, and maybe a load, and the wave's own energy beyond what re-tuning imitates."""
    runs, tuning = arm
    wave, pull = Candidate(EffectAt(name, at), (values,)), Candidate(EffectAt("constant_load", "arm"), ())
    change, pulled = (
        runs.run_one(Trial(tuning.values, (one.setting(own),))) - tuning.predicted
        for one, own in ((wave, values), (pull, np.array([load])))
    )
    residual = change + pulled + np.random.default_rng(5).standard_normal(len(change))
    group = runs.sets[TRAIN].groups[0]
    motion = Motion(runs.machine, tuning.values, group, runs.sets[TRAIN].channels)
    (found,) = with_filtered_starts(ThroughTheLoop(runs, TRAIN, tuning), [Candidate(wave.effect, ())], [motion], residual)
    left = Projection.of(tuning).left(change)
    return list(found.starts), float(left @ left)


@pytest.mark.nightly
@pytest.mark.parametrize("name", WAVES)
def test_a_wave_starts_at_its_order_amplitude_and_phase(arm, name):
    values = WAVES[name]
    starts, _ = offered(arm, name, values)
    assert abs(starts[0][0] - values[0]) < 0.15 * CYCLE
    assert starts[0][[1, 3]] == pytest.approx(values[[1, 3]], rel=0.1)
    assert np.exp(1j * starts[0][[2, 4]]) == pytest.approx(np.exp(1j * values[[2, 4]]), abs=0.1)


@pytest.mark.nightly
@pytest.mark.parametrize("name", WAVES)
def test_a_wave_of_ten_deviations_starts_at_its_order_among_all_that_are_asked(arm, name):
    """Chance gains 36 in the best of all orders."""
    _, energy = offered(arm, name, WAVES[name])
    weak = WAVES[name].copy()
    weak[[1, 3]] *= np.sqrt(100.0 / energy)
    starts, left = offered(arm, name, weak)
    assert left == pytest.approx(100.0, rel=0.1)
    assert abs(starts[0][0] - weak[0]) < 0.5 * CYCLE
    assert starts[0][1] == pytest.approx(weak[1], rel=0.3)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "amplitude", "order", "seed"),
    [
        *(
            ("cogging", 1e-2, 20.94, seed) for seed in (0, 1, 3)
        ),  # missed where neither the slowest are asked nor the median's end is as what is next to it
        *(("transmission_error", 1e-6, 16.0, seed) for seed in (3, 4)),  # missed where the slowest are not asked
        ("transmission_error", 1e-6, 12.0, 3),
        *(("transmission_error", 1e-6, 9.5, seed) for seed in (1, 2)),  # of less than a cycle: missed where it must stand out
    ],
)
def test_a_wave_of_one_or_two_cycles_per_travel_is_found_among_thousands_of_quick_ones(slider, name, amplitude, order, seed):
    """Of 7.5 deviations: chance gives one of 1300 orders more of the power around it than this one has, which are as slow."""
    runs, tuning = slider
    wave = Candidate(EffectAt(name, "carriage"), ())
    values = np.array([order, amplitude, 1.3, 0.3 * amplitude, 2.3])
    change = runs.run_one(Trial(tuning.values, (wave.setting(values),))) - tuning.predicted
    residual = 7.5 * change / np.linalg.norm(Projection.of(tuning).left(change)) + np.random.default_rng(seed).standard_normal(len(change))
    motion = Motion(runs.machine, tuning.values, runs.sets[TRAIN].groups[0], runs.sets[TRAIN].channels)
    (found,) = with_filtered_starts(ThroughTheLoop(runs, TRAIN, tuning), [wave], [motion], residual)
    assert min(abs(start[0] - order) for start in found.starts) < 0.25 * 2.0 * np.pi / 0.6


@pytest.mark.nightly
def test_an_order_is_found_though_its_second_harmonic_shows_more(arm):
    values = np.array([0.2, 0.3 * COUNT_rad, 0.4, 0.7 * COUNT_rad, 1.0])
    alone = [offered(arm, "transmission_error", np.where(np.arange(5) == k, 0.0, values))[1] for k in (3, 1)]
    assert alone[1] > 3.0 * alone[0]
    starts, _ = offered(arm, "transmission_error", values)
    assert starts[0][0] == pytest.approx(values[0], abs=0.01)
    assert starts[0][3] > starts[0][1]


def test_a_ripple_that_passes_fast_at_the_usual_speed_starts_at_its_order(cart):
    """2200 rad/m pass at 60 Hz: a loop that holds efforts for a sample gives them half a sample late, a third of a cycle there."""
    runs, tuning = cart
    ripple = Candidate(EffectAt("torque_ripple", "cart"), ())
    values = np.array([2200.0, 0.02, 0.4, 0.005, 1.0])
    change = runs.run_one(Trial(tuning.values, (ripple.setting(values),))) - tuning.predicted
    left = Projection.of(tuning).left(change)
    deviations = float(np.sqrt(left @ left))
    residual = 12.0 / deviations * change + np.random.default_rng(5).standard_normal(len(change))
    motion = Motion(runs.machine, tuning.values, runs.sets[TRAIN].groups[0], runs.sets[TRAIN].channels)
    (found,) = with_filtered_starts(ThroughTheLoop(runs, TRAIN, tuning), [ripple], [motion], residual)
    assert found.starts[0][0] == pytest.approx(values[0], rel=0.01)
    assert found.starts[0][1] == pytest.approx(12.0 / deviations * values[1], rel=0.3)


SHAKES = np.array([0.02, 7.37, -2.3])
LINE_Hz = ARM.sample_rate_Hz / ROWS


@pytest.mark.nightly
@pytest.mark.parametrize("deviations", [30.0, 10.0])
@pytest.mark.parametrize("place", ["arm", "boom"])
def test_a_base_motion_starts_at_its_frequency_amplitude_and_phase(arm, place, deviations):
    """At the drive and behind its spring; chance gains 30 in the best of all frequencies."""
    _, energy = offered(arm, "base_motion", SHAKES, at=place)
    amplitude = SHAKES[0] * deviations / np.sqrt(energy)
    starts, left = offered(arm, "base_motion", np.array([amplitude, *SHAKES[1:]]), at=place)
    assert left == pytest.approx(deviations**2, rel=0.1)
    assert abs(starts[0][1] - SHAKES[1]) < 0.3 * LINE_Hz
    assert starts[0][0] == pytest.approx(amplitude, rel=4.0 / deviations)
    middle_s = 0.5 / LINE_Hz  # where the phase is known best
    phases = [2.0 * np.pi * f * middle_s + phase for _, f, phase in (starts[0], SHAKES)]
    assert np.exp(1j * phases[0]) == pytest.approx(np.exp(1j * phases[1]), abs=6.0 / deviations)


@pytest.mark.nightly
@pytest.mark.parametrize("load", [0.05, 0.3])
def test_a_load_that_is_missing_too_does_not_hide_a_base_motion(arm, load):
    """What the load has done before the record stands in one row of the efforts behind it, in all frequencies alike."""
    _, energy = offered(arm, "base_motion", SHAKES)
    weak = np.array([SHAKES[0] * 15.0 / np.sqrt(energy), *SHAKES[1:]])
    starts, _ = offered(arm, "base_motion", weak, load=load)
    assert abs(starts[0][1] - SHAKES[1]) < 0.3 * LINE_Hz


@pytest.mark.nightly
@pytest.mark.parametrize("damping", [0.003, 0.03])
@pytest.mark.parametrize("deviations", [30.0, 10.0])
def test_a_light_mode_starts_at_its_frequency_and_mass(shaken, deviations, damping):
    """The free run's own mode, with its loop, against a filter that takes the motion as it was recorded."""
    swings = np.array([1e-4, 12.37, damping])
    _, energy = offered(shaken, "structural_mode", swings)
    mass = swings[0] * deviations / np.sqrt(energy)
    starts, left = offered(shaken, "structural_mode", np.array([mass, *swings[1:]]))
    assert left == pytest.approx(deviations**2, rel=0.2)
    assert starts[0][1] == pytest.approx(swings[1], rel=max(0.5 * damping, 0.005))
    assert starts[0][0] == pytest.approx(mass, rel=0.5)


@pytest.mark.nightly
def test_nothing_is_added_to_what_is_no_wave(arm):
    runs, tuning = arm
    friction = Candidate(EffectAt("coulomb_friction", "arm"), (np.array([1.0]),))
    assert with_filtered_starts(ThroughTheLoop(runs, TRAIN, tuning), [friction], [], np.zeros(len(tuning.predicted))) == [friction]
