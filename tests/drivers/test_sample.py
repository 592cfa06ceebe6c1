"""A sample's arrays lie in one block of memory: each has its own place in it, and what is forgotten of it is what devices answer."""

from __future__ import annotations

import numpy as np

from drivers.interface import ANSWERED_BYTES, VALUES, Sample
from drivers.sample_memory import imus_in, values_in

ANSWERED = ("position", "link_position", "effort", "statusword", "position_late", "link_late")
KNOWN = ("commanded", "age_s", "temperature_degC", "brakes_open", "imu", "bus_imu")


def filled() -> tuple[Sample, dict[str, list[float]]]:
    sample, given = Sample(3), {}
    for number, name in enumerate((*ANSWERED, *KNOWN)):
        values = getattr(sample, name)
        of_bits = number % len(values) == np.arange(len(values))  # of those that are true or false, each another one is true
        values[:] = of_bits if values.dtype == bool else np.arange(len(values)) + 10 * number + 1
        given[name] = values.tolist()
    return sample, given


def test_no_array_of_a_sample_overwrites_another() -> None:
    sample, given = filled()
    assert {name: getattr(sample, name).tolist() for name in given} == given
    assert {name: values_in(sample.memory)[name].tolist() for name in (*ANSWERED, *KNOWN[:4])} == {
        n: given[n] for n in (*ANSWERED, *KNOWN[:4])
    }
    assert imus_in(sample.memory).tolist() == given["imu"] + given["bus_imu"]


def test_answers_are_forgotten_and_nothing_else() -> None:
    sample, given = filled()
    sample.forget_answers()
    fresh = Sample(3)
    for name in ANSWERED:
        np.testing.assert_array_equal(getattr(sample, name), getattr(fresh, name))
    assert {name: getattr(sample, name).tolist() for name in KNOWN} == {name: given[name] for name in KNOWN}


def test_what_is_forgotten_ends_where_what_is_known_beside_begins() -> None:
    assert VALUES.fields is not None
    assert VALUES.fields[KNOWN[0]][1] == ANSWERED_BYTES
