"""The feedback of all axes is the sum of its filters, never leaves its limits, and starts and restarts where it was."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from controllers import loop_shaping
from controllers.errors import DesignError
from controllers.feedback import Feedback
from controllers.settings import AxisController

RATE_HZ = 256.0
ERROR_FILTER = loop_shaping.cascade(loop_shaping.gain(200.0), loop_shaping.lead(4.0, 50.0, RATE_HZ), loop_shaping.lag(0.0, 0.4, RATE_HZ))
FROM_POSITION = loop_shaping.pid(100.0, 30.0, 4.0, 40.0, RATE_HZ)
FROM_REFERENCE = loop_shaping.pid(80.0, 30.0, 0.0, 40.0, RATE_HZ)


def make(limit: float = 8.0) -> Feedback:
    return Feedback(
        [
            AxisController("propeller", ERROR_FILTER, None, limit, False),
            AxisController("roll", FROM_POSITION, FROM_REFERENCE, limit, False),
        ]
    )


def run(
    feedback: Feedback,
    reference: np.ndarray,
    position: np.ndarray,
    excitation: np.ndarray | None = None,
    feedforward: np.ndarray | None = None,
) -> np.ndarray:
    zeros = np.zeros_like(reference)
    out, rows = np.zeros(reference.shape[1]), []
    for r, y, w, f in zip(
        reference, position, zeros if excitation is None else excitation, zeros if feedforward is None else feedforward, strict=True
    ):
        feedback.step(r, y, w, f, out)
        rows.append(out.copy())
    return np.array(rows)


def signals(seed: int, scale: float = 0.01, rows: int = 300) -> np.ndarray:
    return np.random.default_rng(seed).normal(scale=scale, size=(rows, 2))


def test_the_command_is_the_filters_sum_plus_excitation_and_feedforward() -> None:
    r, y, w, f = signals(1), signals(2), signals(3), signals(4)
    command = run(make(limit=1e9), r, y, w, f)
    expected_propeller = scipy.signal.sosfilt(ERROR_FILTER, (r - y)[:, 0]) + w[:, 0] + f[:, 0]
    expected_roll = scipy.signal.sosfilt(FROM_REFERENCE, r[:, 1]) - scipy.signal.sosfilt(FROM_POSITION, y[:, 1]) + w[:, 1] + f[:, 1]
    assert np.array_equal(command, np.column_stack([expected_propeller, expected_roll]))


def test_the_command_is_saturated_and_the_filters_go_on() -> None:
    r, y = signals(1, scale=1.0), signals(2, scale=1.0)
    free, limited = run(make(limit=1e9), r, y), run(make(limit=5.0), r, y)
    assert np.abs(free).max() > 5.0
    assert np.array_equal(limited, np.clip(free, -5.0, 5.0))


def test_a_standstill_is_held_from_the_first_sample() -> None:
    feedback, position, holding = make(), np.array([0.3, -1.2]), np.array([1.7, -0.9])
    feedback.preload(holding, position)
    command = run(feedback, np.tile(position, (600, 1)), np.tile(position, (600, 1)))
    np.testing.assert_allclose(command, np.tile(holding, (600, 1)), atol=1e-9)


def test_a_position_missing_in_the_very_first_sample_is_answered_with_the_holding_effort() -> None:
    feedback, out, holding = make(), np.zeros(2), np.array([1.7, -0.9])
    feedback.preload(holding, np.zeros(2))
    assert feedback.step(np.zeros(2), np.full(2, np.nan), np.zeros(2), np.zeros(2), out) == 0b11
    assert np.array_equal(out, holding)


def test_feedforward_brings_its_part_of_the_holding_effort() -> None:
    feedback = Feedback([AxisController("propeller", loop_shaping.gain(50.0), None, 8.0, True)])
    feedback.preload(np.array([1.7]), np.array([0.3]), feedforward=np.array([1.7]))
    held = run(feedback, np.full((3, 1), 0.3), np.full((3, 1), 0.3), feedforward=np.full((3, 1), 1.7))
    assert held[:, 0] == pytest.approx(1.7)
    with pytest.raises(DesignError, match=r"propeller.*1\.7.*no integrator"):
        feedback.preload(np.array([1.7]), np.array([0.3]))


def test_more_than_the_limit_is_not_preloaded() -> None:
    with pytest.raises(DesignError, match=r"propeller.*9.*limit is 8"):
        make().preload(np.array([9.0, 0.0]), np.zeros(2))


def test_states_carry_over_exactly() -> None:
    r, y = signals(5), signals(6)
    whole = run(make(), r, y)
    first, second = make(), make()
    run(first, r[:100], y[:100])
    second.load_states({axis: {name: values.tolist() for name, values in table.items()} for axis, table in first.states.items()})
    assert np.array_equal(run(second, r[100:], y[100:]), whole[100:])


@pytest.mark.parametrize(
    ("states", "says"),
    [({"propeller": {"position": [[0.0, 0.0]]}}, "shape"), ({"roll": {}}, "propeller.position is missing")],
)
def test_states_of_another_controller_are_refused(states: dict[str, dict[str, list[list[float]]]], says: str) -> None:
    with pytest.raises(DesignError, match=says):
        make().load_states(states)


def test_a_missing_position_repeats_the_last_filter_output_and_is_flagged() -> None:
    feedback, out, zeros = make(), np.zeros(2), np.zeros(2)
    run(feedback, signals(1), signals(2))
    before = feedback.states
    assert feedback.step(zeros, np.array([0.01, 0.01]), zeros, zeros, out) == 0
    last = out.copy()
    assert feedback.step(zeros, np.array([np.nan, 0.01]), np.array([0.5, 0.0]), zeros, out) == 0b01
    assert out[0] == last[0] + 0.5
    assert not np.array_equal(feedback.states["roll"]["position"], before["roll"]["position"])
    frozen = feedback.states["propeller"]["position"]
    assert feedback.step(zeros, np.array([np.nan, np.nan]), zeros, zeros, out) == 0b11
    assert np.array_equal(feedback.states["propeller"]["position"], frozen)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_no_input_makes_the_command_anything_but_a_number_within_the_limit(value: float) -> None:
    bad = np.full(2, value)
    for place in range(4):
        feedback, out = make(limit=2.0), np.zeros(2)
        inputs = [np.zeros(2) for _ in range(4)]
        inputs[place] = bad
        assert feedback.step(*inputs, out) == 0b11
        assert np.isfinite(out).all()
        assert (np.abs(out) <= 2.0).all()


@pytest.mark.parametrize("sections", [np.zeros((1, 5)), np.empty((0, 6)), np.array([[1.0, 0, 0, 2.0, 0, 0]]), np.full((1, 6), np.nan)])
def test_rows_that_are_no_sections_are_refused(sections: np.ndarray) -> None:
    with pytest.raises(DesignError, match="roll"):
        Feedback([AxisController("roll", sections, None, 1.0, False)])
