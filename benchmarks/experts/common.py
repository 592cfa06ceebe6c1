"""What all baselines share: where the recordings are, the error, and the result file."""

from __future__ import annotations

import argparse
import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

RESULTS = Path(__file__).resolve().parents[1] / "results" / "experts"

DIFFERENCE = 1e-4  # step of a parameter for a derivative, as a fraction of its scale: large beside rounding, small beside any curvature


def data_folder() -> Path:
    """Return the folder of recordings: ISOCENTER_DATA, or shared/data beside the checkout.

    Raises
    ------
    SystemExit
        There is no such folder.
    """
    folder = Path(os.environ.get("ISOCENTER_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
    if not folder.is_dir():
        raise SystemExit(f"{folder}: no such folder; set ISOCENTER_DATA to where the recordings are, which are not part of the project")
    return folder


def nrmse(model: Sequence[np.ndarray] | np.ndarray, measured: Sequence[np.ndarray] | np.ndarray) -> float:
    """Return rms(model - measured) over rms(measured - mean), pooled over recordings or windows of any length."""
    one, other = (np.concatenate([np.ravel(part) for part in parts]) for parts in (model, measured))
    return float(np.sqrt(np.mean((one - other) ** 2) / np.mean((other - other.mean()) ** 2)))


def fit_simulations(
    residuals: Callable[[np.ndarray], np.ndarray], start: Sequence[float] | np.ndarray, scale: Sequence[float] | np.ndarray, **options: Any
) -> tuple[np.ndarray, float]:
    """Return the least-squares parameters (n,) of a simulation and their cost; `options` go to SciPy's `least_squares`.

    `residuals` takes (sets, n) parameters and returns (sets, rows): it simulates all sets side by side, so a Jacobian takes little longer
    than one simulation. `scale` is a typical size of every parameter.
    """
    unit = np.asarray(scale, dtype=float)

    def one(point: np.ndarray) -> np.ndarray:
        return np.asarray(residuals((point * unit)[None])[0])

    def jacobian(point: np.ndarray) -> np.ndarray:
        values = residuals(np.vstack([point, point + DIFFERENCE * np.eye(len(point))]) * unit)
        return np.asarray((values[1:] - values[0]) / DIFFERENCE).T

    found = least_squares(one, np.asarray(start, dtype=float) / unit, jac=jacobian, **options)
    return found.x * unit, float(found.cost)


def run(name: str, description: str | None, splits: Callable[[], Mapping[str, Any]]) -> None:
    """Measure all splits of a set, print them as a table and write the result file that `--json` names."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--json", type=Path, default=RESULTS / f"{name}.json", metavar="FILE", help="result file (%(default)s)")
    arguments = parser.parse_args()
    result: dict[str, Any] = {"set": name, "splits": dict(splits())}
    for split, found in result["splits"].items():
        print(f"{name}, {split}: {found['metric']}")
        for channel, stages in found["channels"].items():
            numbers = ", ".join(
                f"{stage} {errors['train']:.4g} train, {errors['held_out']:.4g} held out" for stage, errors in stages.items()
            )
            print(f"  {channel}: {numbers}")
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    innermost = re.compile(r"\{\s+([^{}]*?)\s+\}")  # on one line each: half the size, and easier to read
    lines = innermost.sub(lambda found: "{" + re.sub(r"\n\s*", " ", found[1]) + "}", json.dumps(result, indent=1))
    arguments.json.write_text(lines + "\n")
