"""What runs of parameters as states tell together: tables of convergence, of what follows along the runs, and of robustness."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from hil.calibration.parameter_states.drawn_runs import Conditions
from hil.calibration.parameter_states.filter_model import SwingingMachine
from hil.calibration.parameter_states.study import CONDITIONS, Draw, by_model, converged, curve, falling, held_out, side_by_side, under

PARTS = 8
"""Parts of a run that are told apart."""

MOVES_rad = 1e-2
"""An axis that moves by less stands still."""


def convergence_table(start: SwingingMachine, made: Sequence[Draw], conditions: Conditions, is_drawn: bool) -> dict[str, Any]:
    """Return held-out errors after every image, every parameter beside its model-based fit, and how true the stated deviations are.

    Parameters
    ----------
    start : SwingingMachine
    made : sequence of Draw
        Of the same conditions.
    conditions : Conditions
    is_drawn : bool
        Every run is of another machine; else of the same, and its parameters are told.
    """
    held = curve(list(made), conditions.reach_rad)
    median, count = np.median(held, axis=0), held.shape[1]
    names, p = made[0].found.names, len(start.chain.names)
    models = [(by_model(start, each.run), each) for each in made]
    fits = [(model, each.true.chain) for model, each in models if model is not None]
    fitted = np.array([held_out(true, model, conditions.reach_rad) for model, true in fits]).reshape(-1, 2)
    nees = np.array([each.nees() for each in made])
    errors = np.array([[each.found.values[i] - each.target for i in range(count)] for each in made])  # (runs, images + 1, names)
    stated = np.array([each.found.deviations[:count] for each in made])
    parameters = {}
    for k, name in enumerate(names):
        entry: dict[str, Any] = {
            "unit": start.chain.units[k] if k < p else "-",
            "start": float(start.chain.values[k]) if k < p else 0.0,
            "error_mean": float(errors[:, -1, k].mean()),
            "error_rms": _rms(errors[:, -1, k]),
            "stated": _rms(stated[:, -1, k]),
        }
        if not is_drawn:
            entry["true"] = float(made[0].target[k])
        if k < p and fits:
            entry["model_error_rms"] = _rms(np.array([model.values[k] - true.values[k] for model, true in fits]))
        parameters[name] = entry
    return {
        "runs": len(made),
        "images": count - 1,
        "converged": converged(median, conditions),
        "convergence": [
            {"images": k, "held_out_m": float(median[k, 0]), "held_out_rad": float(median[k, 1]), "worst_m": float(held[:, k, 0].max())}
            for k in range(count)
        ],
        "model_based": dict(zip(("held_out_m", "held_out_rad"), np.median(fitted, axis=0).tolist(), strict=True)) if fits else None,
        "parameters": parameters,
        "curves": {
            name: {
                "error_mean": errors[:, :, k].mean(axis=0).tolist(),
                "error_std": errors[:, :, k].std(axis=0).tolist(),
                "stated": stated[:, :, k].mean(axis=0).tolist(),
            }
            for k, name in enumerate(names[:4])
        },
        "nees": {
            "chain": float(nees[:, 0].mean()),
            "dynamic": float(nees[:, 1].mean()),
            "poses": float(np.concatenate([each.gaps[1] for each in made]).mean()),
        },
        "refused": sum(len(each.found.refused) for each in made),
        "widened": sum(each.found.widened > 0 for each in made),
    }


def along_table(made: Sequence[Draw], conditions: Conditions, drift: float) -> list[dict[str, float]]:
    """Return how far poses and frequencies are off in each part of the runs; `drift`: share by which frequencies fall over a run."""
    fall = falling(drift, conditions.seconds)
    gaps = [each.gaps for each in made]
    rows = []
    for first, stop in pairwise(np.linspace(0.0, conditions.seconds, PARTS + 1)):
        place, stated, squares, wrong, still = ([] for _ in range(5))
        for each, (gap, square) in zip(made, gaps, strict=True):
            at, m = np.array(each.found.at_s), each.true.modes
            part = np.flatnonzero((at >= first) & (at < stop))
            place.append(np.sum(gap[part, 3:6] ** 2, axis=1))
            stated.append([np.trace(each.found.covariances[k][3:6, 3:6]) for k in part])
            squares.append(square[part])
            told = np.array([each.found.dynamic[k][:m] for k in part]).reshape(-1, m)
            since_end = np.log([fall(t) / fall(float(each.run.time_s[-1])) for t in at[part]])[:, None]
            true = each.target[len(each.true.chain.names) :][:m] + since_end
            wrong.append(np.expm1(told - true).ravel())
            still.append(np.expm1(-true).ravel())
        rows.append(
            {
                "from_s": float(first),
                "to_s": float(stop),
                "phantom_m": float(np.sqrt(np.concatenate(place).mean())),
                "stated_m": float(np.sqrt(np.concatenate(stated).mean())),
                "nees": float(np.concatenate(squares).mean()),
                "frequency_share": _rms(np.concatenate(wrong)),
                "frequency_start_share": _rms(np.concatenate(still)),
            }
        )
    return rows


def robustness_rows(
    start: SwingingMachine, true: SwingingMachine | None, conditions: Conditions, draws: int, seed: int, jobs: int | None = None
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each condition's name and row, medians of its runs; `true`: the machine, else one is drawn for each run."""
    m, p = start.modes, len(start.chain.names)
    for name, changes in CONDITIONS.items():
        made = list(side_by_side(partial(under, start, true, conditions=conditions, changes=changes), range(seed, seed + draws), jobs))
        reach = np.where(np.ptp(made[0].run.encoder, axis=0) > MOVES_rad, np.max(conditions.reach_rad), 0.0)
        held, everywhere = curve(made, reach), curve(made, conditions.reach_rad)[:, -1, 0]
        nees = np.array([each.nees() for each in made])
        off = [np.abs(np.expm1(each.found.values[-1][p : p + m] - each.target[p : p + m])).max() for each in made]
        yield (
            name,
            {
                "held_out_m": float(np.median(held[:, -1, 0])),
                "worst_m": float(held[:, -1, 0].max()),
                "everywhere_m": float(np.median(everywhere)),
                "converged": converged(np.median(held, axis=0), conditions),
                "nees_chain": float(np.median(nees[:, 0])),
                "nees_dynamic": float(np.median(nees[:, 1])),
                "nees_poses": float(np.median([each.gaps[1].mean() for each in made])),
                "frequency_share": float(np.median(off)),
                "refused": sum(len(each.found.refused) for each in made),
                "widened": sum(each.found.widened > 0 for each in made),
            },
        )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
