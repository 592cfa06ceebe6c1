"""Repeats whose rows lost their equal spacing stay repeats where they are, and it is said what keeps them apart where they are not."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from carriage import MACHINE, reference, run

from hil.diagnosis.recorded.align import aligned
from hil.diagnosis.residuals.mismatch import mismatch
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


def test_half_a_repeat_leaves_the_other_whole():
    even = aligned(MACHINE, {"a": exported([]), "b": exported([], 1).part(slice(ROWS // 2))})
    assert [recording.rows for recording in even.values()] == [ROWS, ROWS // 2]


def test_rows_that_one_lost_have_the_inputs_of_the_others():
    groups, said = grouped(a=exported([]), b=exported([400, 500], 1), c=exported([30], 2))
    assert groups == [("a", "b", "c")] and not said


def test_last_digits_of_an_input_do_not_part_repeats():
    one = exported([])
    other = with_reference(exported([], 1), WANTED * (1.0 + 1e-15))
    assert not np.array_equal(other["reference_carriage"], WANTED)
    assert grouped(a=one, b=other) == ([("a", "b")], [])


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
