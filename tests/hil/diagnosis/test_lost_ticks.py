"""Runs that skipped ticks, and recordings without a channel: time stays right, repeats stay repeats, and what is missing is named."""

from __future__ import annotations

import numpy as np
import pytest
from carriage import MACHINE, reference, run

from hil.diagnosis.recorded.align import aligned
from hil.diagnosis.residuals.mismatch import mismatch
from hil.errors import RecordingError
from hil.recording import Channel, Recording, recording_metadata

WANTED = reference(0.6)
ROWS = len(WANTED)


def of_the_bench(lost: slice | int | list[int] = slice(0), noise_seed: int = 0, **experiment: object) -> Recording:
    """A run that lost some ticks, its rows one after the other with the time of those that are there."""
    position, command = run(WANTED, noise_seed=noise_seed)
    columns = {"time": ("s", np.arange(ROWS) / MACHINE.sample_rate_Hz), "reference_carriage": ("m", WANTED)}
    columns |= {"excitation_carriage": ("V", np.zeros(ROWS)), "command_carriage": ("V", command), "position_carriage": ("m", position)}
    kept = np.delete(np.arange(ROWS), lost)
    channels = {name: Channel(unit, values[kept]) for name, (unit, values) in columns.items()}
    metadata = recording_metadata(MACHINE, experiment={"start_pose": [0.0]} | experiment, bench={"bus": "socketcan:can0"})
    return Recording(channels, metadata)


def without(recording: Recording, name: str) -> Recording:
    return Recording({other: channel for other, channel in recording.channels.items() if other != name}, recording.metadata)


def emptied(recording: Recording, name: str) -> Recording:
    empty = Channel(recording.channel(name).unit, np.full(recording.rows, np.nan))
    return Recording({**recording.channels, name: empty}, recording.metadata)


def test_repeats_that_lost_different_ticks_are_repeats_and_stay_in_time():
    clean = mismatch(MACHINE, aligned(MACHINE, {"a": of_the_bench(), "b": of_the_bench(noise_seed=1)}))
    lossy = {"a": of_the_bench([100, 101, 400]), "b": of_the_bench([102, 250], noise_seed=1)}
    found = mismatch(MACHINE, aligned(MACHINE, lossy))
    assert [group.repeats for group in found.groups] == [2]
    (group,), (whole,) = found.groups, clean.groups
    np.testing.assert_array_equal(group.simulated, whole.simulated)
    missing = np.isnan(group.measured[:, :, 0])
    assert [np.flatnonzero(row).tolist() for row in missing] == [[100, 101, 400], [102, 250]]
    np.testing.assert_array_equal(group.measured[~np.isnan(group.measured)], whole.measured[~np.isnan(group.measured)])


def test_what_all_of_them_lost_does_not_part_them():
    lossy = {"a": of_the_bench([100, 101]), "b": of_the_bench([101, 102], noise_seed=1), "c": of_the_bench(101, noise_seed=2)}
    assert [group.repeats for group in mismatch(MACHINE, aligned(MACHINE, lossy)).groups] == [3]


def test_a_period_that_was_lost_whole_is_none():
    stalled = of_the_bench(slice(190, 410), period_samples=200, settle_periods=0)  # all of the second period
    (group,) = mismatch(MACHINE, aligned(MACHINE, {"a": stalled})).groups
    assert group.labels == ("a period 1", "a period 2") and [window.start for window in group.windows] == [0, 400]
    assert np.isfinite(group.mean).all()


@pytest.mark.parametrize(("change", "said"), [(without, "is not in it"), (emptied, "misses 100% of its samples")])
def test_a_held_out_recording_without_a_channel_is_named(change, said):
    train = mismatch(MACHINE, {"a": of_the_bench(), "b": of_the_bench(noise_seed=1)})
    held_out = {"other": change(of_the_bench(noise_seed=2), "position_carriage")}
    with pytest.raises(RecordingError, match=rf"^other: position_carriage {said}"):
        mismatch(MACHINE, held_out, channels=train.channels, noise=train.noise)
