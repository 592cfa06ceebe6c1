"""Repeats whose rows lost their equal spacing stay repeats where they are, and it is said what keeps them apart where they are not."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from carriage import MACHINE, reference, run

from hil.diagnosis.recorded.align import aligned
from hil.diagnosis.residuals.mismatch import mismatch
from hil.machine import load_machine
from hil.recording import Channel, Recording, RecordingWarning, recording_metadata

REST = 100  # rows
WANTED = np.concatenate([np.zeros(REST), reference(0.6)])
ROWS = len(WANTED)


def exported(lost: list[int], noise_seed: int = 0, wanted: np.ndarray = WANTED, ends_early_s: float = 0.0) -> Recording:
    """Rows of another recorder than the bench, with a clock that ends a little early."""
    position, command = run(wanted, noise_seed=noise_seed)
    time = np.arange(ROWS) / MACHINE.sample_rate_Hz - ends_early_s * np.arange(ROWS) / (ROWS - 1)
    columns = {"time": ("s", time), "reference_carriage": ("m", wanted), "excitation_carriage": ("V", np.zeros(ROWS))}
    columns |= {"command_carriage": ("V", command), "position_carriage": ("m", position)}
    kept = np.delete(np.arange(ROWS), lost)
    return Recording({name: Channel(unit, values[kept]) for name, (unit, values) in columns.items()}, recording_metadata(MACHINE))


def with_reference(recording: Recording, values: np.ndarray) -> Recording:
    return Recording({**recording.channels, "reference_carriage": Channel("m", values)}, recording.metadata)


def grouped(**recordings: Recording) -> tuple[list[tuple[str, ...]], list[str]]:
    """The groups' labels, and what was warned of besides the resampling."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RecordingWarning)
        found = mismatch(MACHINE, aligned(MACHINE, recordings))
    said = [str(one.message) for one in caught if "resampled" not in str(one.message)]
    return [group.labels for group in found.groups], said


@pytest.mark.parametrize("lost", [[], [30, 31]])
def test_a_last_row_that_comes_early_does_not_part_them(lost):
    groups, said = grouped(a=exported(lost), b=exported([50], 1, ends_early_s=2e-5))
    assert groups == [("a", "b")] and not said


@pytest.mark.parametrize("rows", [ROWS - 1, int(0.92 * ROWS)])
def test_a_repeat_that_ends_early_cuts_the_others_and_it_is_said(rows):
    one, other = exported([]), exported([], 1)
    with pytest.warns(RecordingWarning, match=rf"^a: cut to the {rows} rows of b, which they repeat$"):
        even = aligned(MACHINE, {"a": one, "b": other.part(slice(rows))})
    assert [recording.rows for recording in even.values()] == [rows, rows]


def test_half_a_repeat_leaves_the_other_whole_and_it_is_said():
    half = exported([], 1).part(slice(ROWS // 2))
    even = aligned(MACHINE, {"a": exported([]), "b": half})
    assert [recording.rows for recording in even.values()] == [ROWS, ROWS // 2]
    groups, said = grouped(a=exported([]), b=half)
    assert groups == [("a",), ("b",)] and len(said) == 1 and f"it has {ROWS // 2} rows and not {ROWS}" in said[0]


@pytest.mark.parametrize("clock", ["jitters", "is fast"])
@pytest.mark.parametrize("every", [4, 5])
def test_repeats_of_another_rate_stay_repeats_however_their_rows_are_stamped(clock, every):
    """Between rows a reference is taken at each one's own stamps, which differ by ten-thousandths of a row."""

    def slower(seed: int) -> Recording:
        time = np.arange(ROWS)[::every] / MACHINE.sample_rate_Hz
        off = 1e-4 * np.random.default_rng(seed).standard_normal(len(time)) * time[1] if clock == "jitters" else 1e-6 * seed * time
        whole = exported([], seed)
        channels = {name: Channel(channel.unit, channel.values[::every]) for name, channel in whole.channels.items()}
        return Recording({**channels, "time": Channel("s", time + off - off[0])}, whole.metadata)

    groups, said = grouped(a=slower(0), b=slower(1), c=slower(2).part(slice(-1)))
    assert groups == [("a", "b", "c")] and all("c, which they repeat" in words for words in said)


@pytest.mark.parametrize("slow", ["twice as slow", "a pause"])
def test_the_same_table_at_other_times_is_another_reference(slow):
    """Each is on its own times: where one is driven half as fast, or waits in the middle."""
    every = 4
    rows = np.arange(0, ROWS, every)
    times = {"a": rows / 1000.0, "b": rows / 500.0 if slow == "twice as slow" else rows / 1000.0 + 1.0 * (rows > ROWS // 2)}
    whole = exported([])
    channels = {name: Channel(channel.unit, channel.values[::every]) for name, channel in whole.channels.items()}
    runs = {label: Recording({**channels, "time": Channel("s", time)}, whole.metadata) for label, time in times.items()}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        even = aligned(MACHINE, runs)
    for label, time in times.items():
        np.testing.assert_allclose(even[label]["reference_carriage"], np.interp(even[label].time, time, WANTED[::every]), atol=1e-15)


def test_pauses_that_are_no_whole_rows_do_not_make_a_clock_slow():
    """Before them every row stays where it was."""
    time = np.arange(ROWS) / MACHINE.sample_rate_Hz
    for number in range(5):
        time[ROWS - 50 + 10 * number :] += 9.45e-3
    whole = exported([])
    with pytest.warns(RecordingWarning, match="resampled"):
        even = aligned(MACHINE, {"a": Recording({**whole.channels, "time": Channel("s", time)}, whole.metadata)})["a"]
    np.testing.assert_allclose(even["reference_carriage"][: ROWS - 60], WANTED[: ROWS - 60], atol=1e-12)
    np.testing.assert_allclose(even["position_carriage"][: ROWS - 60], whole["position_carriage"][: ROWS - 60], atol=1e-9)


def test_rows_that_one_lost_have_the_inputs_of_the_others():
    groups, said = grouped(a=exported([]), b=exported([400, 500], 1), c=exported([30], 2))
    assert groups == [("a", "b", "c")] and not said


def test_last_digits_of_an_input_do_not_part_repeats():
    one = exported([])
    for wanted in (WANTED * (1.0 + 1e-15), WANTED + 1e-17):  # the first is zero
        other = with_reference(exported([], 1), wanted)
        assert not np.array_equal(other["reference_carriage"], WANTED)
        assert grouped(a=one, b=other) == ([("a", "b")], [])


@pytest.mark.parametrize("off", [-9e-4, 9e-4])
def test_a_clock_that_is_off_by_less_than_another_rate_leaves_every_row_with_its_tick(off):
    """Off by most of a row at the end, where one in the middle is lost."""
    fast = exported([400], 1)
    time = Channel("s", fast.time * (1.0 + off))
    groups, said = grouped(a=exported([]), b=Recording({**fast.channels, "time": time}, fast.metadata))
    assert groups == [("a", "b")] and not said


def test_few_rows_that_differ_in_their_inputs_are_said():
    moved = WANTED.copy()
    moved[[400, 500]] += 1e-6
    groups, said = grouped(a=exported([]), b=with_reference(exported([], 1), moved), c=exported([30], 2))
    assert groups == [("a", "c"), ("b",)]
    assert len(said) == 1
    assert said[0].startswith("b: no repeat of a: its inputs differ in 2 rows, the first reference_carriage in row 400 (0.4 s);")


def test_another_experiment_is_no_repeat_and_nothing_is_said_of_it():
    other = np.concatenate([np.zeros(REST), reference(0.6, seed=1)])
    assert grouped(a=exported([]), b=exported([30], 1, other)) == ([("a",), ("b",)], [])


MOTOR = load_machine("laas_anti_cogging")


def driven(lost: list[int], seed: int = 0, rows: int = ROWS, begins: float = 0.0, command: np.ndarray | None = None) -> Recording:
    """Of a motor without a controller, whose command is its input."""
    random = np.random.default_rng(seed)
    wanted = np.random.default_rng(7).standard_normal(rows) if command is None else command
    position = begins * np.exp(-np.arange(rows) / 500.0) + 1e-4 * random.standard_normal(rows)
    columns = {"time": ("s", np.arange(rows) / MOTOR.sample_rate_Hz), "command_rotor": ("A", wanted), "position_rotor": ("rad", position)}
    kept = np.delete(np.arange(rows), lost)
    return Recording({name: Channel(unit, values[kept]) for name, (unit, values) in columns.items()}, recording_metadata(MOTOR))


def test_a_row_that_an_open_loop_lost_has_the_command_of_its_repeat():
    even = aligned(MOTOR, {"a": driven([]), "b": driven([500, 600], 1)})
    np.testing.assert_array_equal(even["b"]["command_rotor"], even["a"]["command_rotor"])


def test_free_motions_from_elsewhere_are_not_cut_to_each_other():
    runs = {"a": driven([], 0, 2000, 1.0, np.zeros(2000)), "b": driven([], 1, 1850, 2.0, np.zeros(1850))}
    assert [recording.rows for recording in aligned(MOTOR, runs).values()] == [2000, 1850]
    runs["c"] = driven([], 2, 1900, 2.0, np.zeros(1900))
    with pytest.warns(RecordingWarning, match="^c: cut to the 1850 rows of b"):
        assert [recording.rows for recording in aligned(MOTOR, runs).values()] == [2000, 1850, 1850]
