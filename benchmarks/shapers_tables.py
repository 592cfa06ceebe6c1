"""Chapter 7 of the thesis in numbers: Tables 7.1 and 7.2, Fig. 7.13 and Example 7.3, with the corrected and with the printed plant.

    python benchmarks/shapers_tables.py --json benchmarks/results/shapers_tables.json

Table 7.2: the thesis's gains beside those that solve (7.33) for the plant as it is printed in Sec. 7.4 and for the one that gives the
table. Fig. 7.13: the largest error of the response to (7.40) once the transient is over, for the nominal plant and as the worst over
changes of the second natural frequency, of the third forcing frequency and of both by up to 10 percent. Example 7.3: rms error
over whole periods of the triangular and of the block wave.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from shapers_figures import CORRECTED, NONE, PRINTED, SixthOrder, second_order_plant, sixth_order_plant

from controllers.errors import DesignError
from controllers.shapers.conditions import residuals
from controllers.shapers.delays import DelayFilter
from controllers.shapers.harmonic_time_delay import harmonic, harmonic_conditions
from controllers.shapers.shortest_delays import shortest_delays
from hil.shaping.response import shaped_response, sinusoids

FORCING_rad_s, AMPLITUDES = (0.7, 1.7, 2.2), (1.0, -1.2, 1.9)  # (7.40)
DELAY_s = 0.75
NORMAL_7_2 = (0.202, -0.175, 0.377, -0.486, 0.469, -0.627, 0.384, -0.513, 0.238, -0.187, 0.099, 1.008)
ROBUST_7_2 = (
    0.687, -0.976, 2.623, -3.442, 5.328, -5.967, 6.999, -6.608, 6.494, -4.838, 4.113, -2.194, 1.536, -0.470, 0.235, -0.004,
)  # fmt: skip
GAINS_7_1 = (-0.1774, -1.8344, -1.1593, -1.7812, -3.4102, -2.8815, -3.0575, -2.4794, -2.1592, -2.2547, -0.7430)
DELAY_7_1_s = 1.0910
FORCING_7_3_rad_s = (1.0, 3.0, 5.0, 7.0, 11.0)
SHARES = np.linspace(-0.1, 0.1, 11)
LOOKED_AT_s, POINTS = 40.0, 400


def conditions_of(numbers: SixthOrder, robust: bool) -> list[Any]:
    """Return the conditions of the normal or of the robust filter of Table 7.2 for a plant."""
    plant, _ = sixth_order_plant(numbers)
    second = [pole for pole in plant.poles if abs(abs(pole) - numbers.frequencies_rad_s[1]) < 0.1] if robust else []
    return harmonic_conditions(plant, FORCING_rad_s, robust_poles=second, robust_forcing_rad_s=[2.2] if robust else [])


def worst_error(numbers: SixthOrder, shaper: DelayFilter, pole_shares: np.ndarray, forcing_shares: np.ndarray) -> float:
    """Return the largest error after the transient over all pairs of changes."""
    times = shaper.transient_s + np.linspace(0.0, LOOKED_AT_s, POINTS)
    worst = 0.0
    for moved in pole_shares:
        plant, _ = sixth_order_plant(numbers, 1.0 + moved)
        for share in forcing_shares:
            reference = sinusoids(AMPLITUDES, (*FORCING_rad_s[:2], FORCING_rad_s[2] * (1.0 + share)))
            worst = max(worst, float(np.abs(shaped_response(plant, shaper, reference, times) - reference.at(times)).max()))
    return worst


def errors(numbers: SixthOrder, shaper: DelayFilter) -> dict[str, float]:
    """Return a row of Fig. 7.13 in numbers."""
    still, reference = np.zeros(1), sinusoids(AMPLITUDES, FORCING_rad_s)
    before = np.linspace(0.0, shaper.transient_s, POINTS) if shaper.transient_s else np.linspace(0.0, LOOKED_AT_s, POINTS)
    plant, _ = sixth_order_plant(numbers)
    return {
        "transient_s": shaper.transient_s,
        "during_transient": float(np.abs(shaped_response(plant, shaper, reference, before) - reference.at(before)).max()),
        "nominal": worst_error(numbers, shaper, still, still),
        "natural_frequency": worst_error(numbers, shaper, SHARES, still),
        "forcing_frequency": worst_error(numbers, shaper, still, SHARES),
        "both": worst_error(numbers, shaper, SHARES, SHARES),
    }


def table_7_2() -> tuple[dict[str, Any], dict[str, Any]]:
    """Return gains, a row each, and errors, a row for every filter on every plant."""
    gains: dict[str, dict[str, float]] = {}
    rows: dict[str, dict[str, float]] = {}
    for kind, table, robust in (("normal", NORMAL_7_2, False), ("robust", ROBUST_7_2, True)):
        for plant_name, numbers in (("corrected", CORRECTED), ("printed", PRINTED)):
            conditions, (_, tail) = conditions_of(numbers, robust), sixth_order_plant(numbers)
            solved = harmonic(conditions, DELAY_s, tail=tail)
            thesis = DelayFilter(solved.delays_s, np.array(table), tail)
            rows[f"{kind}, {plant_name} plant"] = errors(numbers, solved)
            rows[f"{kind}, {plant_name} plant, the thesis's gains"] = errors(numbers, thesis) | {
                "largest_residual": float(np.abs(residuals(conditions, thesis)).max())
            }
            for number, (ours, theirs) in enumerate(zip(solved.gains, table, strict=True)):
                gains.setdefault(f"{kind} A{number}", {"thesis": theirs})[plant_name] = float(ours)
    for plant_name, numbers in (("corrected", CORRECTED), ("printed", PRINTED)):
        rows[f"no filter, {plant_name} plant"] = errors(numbers, NONE)
    return gains, rows


def printed_robust() -> dict[str, dict[str, float]]:
    """Return by how much the thesis's robust gains miss each condition on the corrected plant, and what rounding them makes of it (rms)."""
    conditions, (_, tail) = conditions_of(CORRECTED, robust=True), sixth_order_plant(CORRECTED)
    delays_s = DELAY_s * np.arange(len(ROBUST_7_2))

    def missed(gains: np.ndarray) -> np.ndarray:
        return residuals(conditions, DelayFilter(delays_s, gains, tail))

    weights = np.array([missed(one) for one in np.eye(len(delays_s))]) - missed(np.zeros(len(delays_s)))
    rounding = 1e-3 / np.sqrt(12.0) * np.linalg.norm(weights, axis=0)  # of three decimals
    found = zip(conditions, missed(np.array(ROBUST_7_2)), rounding, strict=True)
    return {condition.what: {"missed": float(abs(by)), "rounding": float(rms)} for condition, by, rms in found}


def example_7_3() -> dict[str, Any]:
    """Return the rms tracking error of both waves after the transient, a row per filter."""
    plant = second_order_plant()
    conditions = harmonic_conditions(plant, FORCING_7_3_rad_s)
    filters = {"no filter": NONE, "linear, 12 taps, T = 0.315 s": harmonic(conditions, 0.315)}
    try:
        shortest = shortest_delays(conditions, 1.5, gain_sum_limit=100.0)[0]
        filters[f"shortest, 11 taps, T = {shortest.delays_s[1]:.4f} s"] = shortest
    except DesignError as error:
        print(error)
    filters["Table 7.1 as printed, 11 taps, T = 1.091 s"] = DelayFilter(DELAY_7_1_s * np.arange(11), np.array(GAINS_7_1))
    k = np.arange(60)
    waves = {
        "triangle": sinusoids(8.0 / np.pi**2 * (-1.0) ** k / (2 * k + 1) ** 2, 2 * k + 1),  # (7.37)
        "block": sinusoids(4.0 / np.pi / (2 * k + 1), 2 * k + 1),  # (7.38)
    }
    rows: dict[str, Any] = {}
    for name, shaper in filters.items():
        times = shaper.transient_s + np.arange(1600) * (4.0 * 2.0 * np.pi / 1600)
        row = {"transient_s": shaper.transient_s, "gain_sum": shaper.gain_sum}
        for wave, reference in waves.items():
            row[wave] = float(np.sqrt(np.mean((shaped_response(plant, shaper, reference, times) - reference.at(times)) ** 2)))
        rows[name] = row
    for row in rows.values():
        row |= {f"{wave}_over_none": row[wave] / rows["no filter"][wave] for wave in waves}
    return rows


def main() -> None:
    """All of it, as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, default=None)
    path = parser.parse_args().json
    gains, rows = table_7_2()
    text = json.dumps({"table_7_2": gains, "printed_robust": printed_robust(), "fig_7_13": rows, "example_7_3": example_7_3()}, indent=2)
    if path is not None:
        path.write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
