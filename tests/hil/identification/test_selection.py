"""Claims of the automatic choice of orders and windows."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_loop import SAMPLE_RATE_HZ, experiment, plant_response, two_mode_loop

from hil.identification import IdentificationError, LocalModel, PeriodicRecords, PoseModel, fast_local, nd_local, periodic_records
from hil.identification.lpm_lrm.order_selection import Candidate, select_local_model

PERIOD, LINES = 1024, np.arange(1, 200)
MODELS = [Candidate(LocalModel(n, 2, d, plant_window=w)) for n, d in ((1, 0), (2, 0), (4, 0), (1, 1), (2, 1)) for w in (8, 12, 20)]


def records_of(rng: np.random.Generator, damping: float, noise: float, pose: float = 0.0) -> tuple[PeriodicRecords, np.ndarray]:
    loop = two_mode_loop(frequencies_Hz=(3.0 + 0.1 * pose, 7.0), damping=(damping, damping))
    data = experiment(
        loop, rng, realisations=1, experiments=1, periods=8, period=PERIOD, lines=LINES, noise=np.array((1.0, 0.1, 0.1)) * noise
    )
    return periodic_records(**data, period_samples=PERIOD, sample_rate_Hz=SAMPLE_RATE_HZ, pose=(pose,)), plant_response(
        loop, LINES * SAMPLE_RATE_HZ / PERIOD
    )


def true_error(candidate: Candidate, records: list[PeriodicRecords], truth: np.ndarray, unit: np.ndarray) -> float:
    if candidate.over_poses.windows:
        made = np.stack([response.G for response in nd_local(records, candidate.model, candidate.over_poses)])
    else:
        made = np.stack([fast_local(each, candidate.model).G for each in records])
    return np.mean(np.abs(made - truth) ** 2 / unit)


@pytest.mark.slow
@pytest.mark.parametrize(("damping", "noise"), [(0.02, 0.03), (0.05, 0.5), (0.5, 0.5)])
def test_the_chosen_model_errs_little_more_than_the_best_one_on_fresh_data(damping: float, noise: float) -> None:
    rng = np.random.default_rng(40)
    records, truth = records_of(rng, damping, noise)
    found = select_local_model([records], MODELS)
    fresh = [records_of(rng, damping, noise)[0] for _ in range(4)]
    unit = fast_local(fresh[0], LocalModel(2, 2, 1, plant_window=8)).standard_deviation("noise") ** 2
    errors = {candidate: np.mean([true_error(candidate, [each], truth, unit) for each in fresh]) for candidate in found.candidates}
    assert errors[found.chosen] < 1.25 * min(errors.values())
    assert max(errors.values()) > 1.5 * min(errors.values())


def test_neighbouring_poses_are_used_where_they_help() -> None:
    rng = np.random.default_rng(41)
    made = [records_of(rng, 0.5, 0.5, pose) for pose in np.linspace(-1.0, 1.0, 5)]
    model = LocalModel(2, 2, 1, plant_window=8)
    found = select_local_model([records for records, _ in made], [Candidate(model), Candidate(model, PoseModel((1,), (1,), (2,)))])
    assert found.chosen.over_poses.windows == (2,)


def test_neighbouring_poses_are_left_alone_where_they_mislead() -> None:
    rng = np.random.default_rng(42)
    made = [records_of(rng, 0.02, 0.03, pose) for pose in np.linspace(-20.0, 20.0, 5)]  # the mode moves by many of its widths
    model = LocalModel(2, 2, 1, plant_window=8)
    found = select_local_model([records for records, _ in made], [Candidate(model), Candidate(model, PoseModel((1,), (1,), (2,)))])
    assert found.chosen.over_poses.windows == ()


def test_models_the_data_cannot_carry_are_refused_with_the_reason() -> None:
    records, _ = records_of(np.random.default_rng(43), 0.5, 0.5)
    found = select_local_model([records], [Candidate(LocalModel(plant_window=1)), MODELS[0]])
    assert found.chosen == MODELS[0]
    assert "no degree of freedom" in found.refused[0][1]
    with pytest.raises(IdentificationError, match="none of 1 candidates fits the data: plant_window = 1"):
        select_local_model([records], [Candidate(LocalModel(plant_window=1))])


def test_without_candidates_it_brings_its_own() -> None:
    records, truth = records_of(np.random.default_rng(44), 0.05, 0.1)
    found = select_local_model([records])
    response = fast_local(records, found.chosen.model)
    assert found.chosen.model.denominator > 0
    assert np.median(np.abs(response.G - truth) / np.abs(truth)) < 0.05
