"""Figures 7.2 to 7.14 of the thesis redrawn, with the corrections.

    python benchmarks/shapers_figures.py --out figures/

Table 7.1 cannot be reproduced, so Fig. 7.10 shows a design of its own for the same five frequencies. Figs 7.12 to 7.14 are drawn twice:
for the plant that gives the gains of Table 7.2, and for the plant that Sec. 7.4 prints. `shapers_tables.py` has their numbers.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from controllers.errors import DesignError
from controllers.shapers.closed_form_htdf import second_order
from controllers.shapers.delays import DelayFilter
from controllers.shapers.dynamics import Dynamics
from controllers.shapers.harmonic_time_delay import harmonic, harmonic_conditions, tap_count
from controllers.shapers.point_to_point import zv
from hil.shaping.response import Sinusoids, shaped_reference, shaped_response, sinusoids

NATURAL, DAMPING = np.sqrt(2.0), 0.02
NONE = DelayFilter(np.zeros(1), np.ones(1))
BLUE, RED, GREEN, BLACK = "#0072B2", "#D55E00", "#009E73", "black"
Curves = list[tuple[str, DelayFilter, str, str]]  # label, filter, colour, line style


class SixthOrder(NamedTuple):
    """Numbers of (7.39)."""

    frequencies_rad_s: tuple[float, float, float]
    dampings: tuple[float, float, float]
    alpha: float = 5e-4
    beta: float = 1.7


CORRECTED = SixthOrder((float(np.sqrt(2.0)), 2.5, 3.0), (0.002, 0.005, 0.003))  # gives the normal gains of Table 7.2
PRINTED = SixthOrder((float(np.sqrt(2.0)), 3.0, 4.0), (0.02, 0.05, 0.03))  # Sec. 7.4


def second_order_plant() -> Dynamics:
    """(7.15)."""
    return Dynamics.from_modes([(NATURAL, DAMPING, 1.0)])


def sixth_order_plant(numbers: SixthOrder = CORRECTED, shift: float = 1.0) -> tuple[Dynamics, Dynamics]:
    """(7.39), its second frequency times `shift`, and the tail of (7.33)."""
    w, zeros = np.array(numbers.frequencies_rad_s) * (1.0, shift, 1.0), np.array([1.0, numbers.alpha, numbers.beta])
    denominator = np.ones(1)
    for frequency, damping in zip(w, numbers.dampings, strict=True):
        denominator = np.polymul(denominator, [1.0, 2.0 * damping * frequency, frequency**2])
    gain = np.prod(w**2)
    return Dynamics.from_polynomials(gain * zeros, denominator), Dynamics.from_polynomials([1.0], gain * zeros)


def responses(plant: Dynamics, reference: Sinusoids, curves: Curves, times: np.ndarray) -> Figure:
    """Responses above, errors below (Figs 7.2, 7.6, 7.10, 7.13)."""
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    wanted = reference.at(times)
    upper.plot(times, wanted, color=BLACK, linewidth=0.9, label="reference")
    for label, shaper, colour, style in curves:
        output = shaped_response(plant, shaper, reference, times)
        upper.plot(times, output, style, color=colour, linewidth=0.9, label=label)
        lower.plot(times, output - wanted, style, color=colour, linewidth=0.9)
    limit = 3.0 * np.abs(wanted).max()
    upper.set(ylabel="Position", ylim=(-limit, limit))
    lower.set(xlabel="Time [s]", ylabel="Error", ylim=(-limit, limit))
    upper.legend(fontsize="small")
    return figure


def bode(plant: Dynamics, curves: Curves, frequencies: np.ndarray) -> Figure:
    """|P|, |G| and |H| and their phases, a column per filter (Figs 7.4, 7.7, 7.14)."""
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    grid = figure.subplots(2, len(curves), sharex=True, squeeze=False)
    s = 1j * frequencies
    p = plant.response(s)
    for column, (label, shaper, _, _) in enumerate(curves):
        g = shaper.response(s)
        for name, values, colour in (("P", p, BLUE), ("G", g, RED), ("H = P G", p * g, BLACK)):
            grid[0, column].loglog(frequencies, np.abs(values), color=colour, linewidth=0.9, label=name)
            grid[1, column].semilogx(frequencies, np.degrees(np.angle(values)), color=colour, linewidth=0.9)
        grid[0, column].set(title=label, ylim=(1e-3, 1e2))
        grid[1, column].set(xlabel="Frequency [rad/s]")
    grid[0, 0].set_ylabel("Magnitude")
    grid[1, 0].set_ylabel("Phase [°]")
    grid[0, 0].legend(fontsize="small")
    return figure


def errors_over(curves: list[tuple[str, str, list[float]]], shares: np.ndarray, label: str) -> Figure:
    """Errors over a change (Figs 7.8, 7.9): per curve one for every share."""
    figure = Figure(figsize=(6.0, 4.0), layout="constrained")
    axes = figure.subplots()
    for name, colour, errors in curves:
        axes.plot(100.0 * shares, errors, color=colour, linewidth=1.0, label=name)
    axes.set(xlabel=f"Change of {label} [%]", ylabel="Error", ylim=(0.0, None))
    axes.legend(fontsize="small")
    return figure


def steady(plant: Dynamics, shaper: DelayFilter, forcing: float) -> float:
    """|H - 1| at the forcing frequency."""
    return abs(complex(plant.response(1j * forcing) * shaper.response(1j * forcing)) - 1.0)


def largest(plant: Dynamics, shaper: DelayFilter, forcing: float) -> float:
    """Largest error in the 20 s after the transient: what is left of the vibration adds to the steady error."""
    reference, times = sinusoids([1.0], [forcing]), shaper.transient_s + np.linspace(0.0, 20.0, 400)
    return float(np.abs(shaped_response(plant, shaper, reference, times) - reference.at(times)).max())


def example_7_1(out: Path) -> None:
    """Figs 7.2 to 7.6."""
    plant, times = second_order_plant(), np.linspace(0.0, 40.0, 1600)
    point_to_point, shaper = zv(NATURAL, DAMPING), second_order(NATURAL, DAMPING, 0.7)
    curves: Curves = [("unshaped", NONE, BLUE, "-"), ("ZV", point_to_point, BLACK, "-."), ("hTDF", shaper, RED, "--")]
    reference = sinusoids([1.0], [0.7])
    responses(plant, reference, curves, times).savefig(out / "fig_7_02.png", dpi=130)
    figure = Figure(figsize=(7.0, 3.5), layout="constrained")
    axes = figure.subplots()
    for label, each, colour, style in curves:
        axes.plot(times, shaped_reference(each, reference, times), style, color=colour, linewidth=0.9, label=label)
    axes.set(xlabel="Time [s]", ylabel="Input u", xlim=(0.0, 20.0))
    axes.legend(fontsize="small")
    figure.savefig(out / "fig_7_03.png", dpi=130)
    bode(plant, curves[1:], np.geomspace(0.1, 10.0, 1500)).savefig(out / "fig_7_04.png", dpi=130)
    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.subplots()
    forcing = np.linspace(0.02, 4.5 * NATURAL, 1500)
    gains = np.full((len(forcing), 3), np.nan)
    for row, frequency in zip(gains, forcing, strict=True):
        try:
            row[:] = second_order(NATURAL, DAMPING, frequency).gains
        except DesignError:
            continue  # on the pole
    for k, colour in enumerate((BLUE, RED, BLACK)):
        axes.plot(forcing, gains[:, k], color=colour, linewidth=0.9, label=f"$A_{k}$")
    axes.set(xlabel="Forcing frequency [rad/s]", ylabel="Gain", ylim=(-10.0, 10.0))
    axes.legend()
    figure.savefig(out / "fig_7_05.png", dpi=130)
    beyond: Curves = [("unshaped", NONE, BLUE, "-"), ("hTDF", second_order(NATURAL, DAMPING, 3.0), RED, "--")]
    responses(plant, sinusoids([1.0], [3.0]), beyond, np.linspace(0.0, 20.0, 1600)).savefig(out / "fig_7_06.png", dpi=130)


def first_order_and_robustness(out: Path) -> None:
    """Figs 7.7 to 7.9."""
    plant, shares = Dynamics.from_polynomials([1.0], [1.0, 1.0]), np.linspace(-0.1, 0.1, 81)
    without, cancelled = (harmonic(harmonic_conditions(plant, [0.7], poles), 0.8) for poles in ((), None))
    curves: Curves = [("pole left", without, RED, "--"), ("pole cancelled", cancelled, BLUE, "-")]
    bode(plant, curves, np.geomspace(0.05, 5.0, 800)).savefig(out / "fig_7_07.png", dpi=130)
    rows = [(label, colour, [steady(plant, shaper, 0.7 * (1.0 + share)) for share in shares]) for label, shaper, colour, _ in curves]
    errors_over(rows, shares, "the forcing frequency").savefig(out / "fig_7_08.png", dpi=130)
    plant = second_order_plant()
    poles, T = plant.poles, 1.0
    filters = [
        ("plain", BLACK, harmonic(harmonic_conditions(plant, [0.7]), T)),
        ("poles", RED, harmonic(harmonic_conditions(plant, [0.7], robust_poles=poles), T)),
        ("forcing", GREEN, harmonic(harmonic_conditions(plant, [0.7], robust_forcing_rad_s=[0.7]), T)),
        ("both", BLUE, harmonic(harmonic_conditions(plant, [0.7], robust_poles=poles, robust_forcing_rad_s=[0.7]), T)),
    ]
    rows = [(label, colour, [steady(plant, shaper, 0.7 * (1.0 + share)) for share in shares]) for label, colour, shaper in filters]
    errors_over(rows, shares, "the forcing frequency").savefig(out / "fig_7_09_left.png", dpi=130)
    moved = [Dynamics.from_modes([(NATURAL * (1.0 + share), DAMPING, 1.0)]) for share in shares]
    rows = [(label, colour, [largest(each, shaper, 0.7) for each in moved]) for label, colour, shaper in filters]
    errors_over(rows, shares, "the natural frequency").savefig(out / "fig_7_09_right.png", dpi=130)


def example_7_3(out: Path) -> None:
    """Fig. 7.10."""
    plant = second_order_plant()
    shaper = harmonic(harmonic_conditions(plant, [1.0, 3.0, 5.0, 7.0, 11.0]), 0.315)
    k, times = np.arange(60), np.linspace(0.0, 20.0, 1200)
    curves: Curves = [("unshaped", NONE, BLUE, "-"), ("hTDF", shaper, RED, "--")]
    triangle = sinusoids(8.0 / np.pi**2 * (-1.0) ** k / (2 * k + 1) ** 2, 2 * k + 1)
    block = sinusoids(4.0 / np.pi / (2 * k + 1), 2 * k + 1)
    responses(plant, triangle, curves, times).savefig(out / "fig_7_10a.png", dpi=130)
    responses(plant, block, curves, times).savefig(out / "fig_7_10b.png", dpi=130)


def design_case(out: Path) -> None:
    """Figs 7.12 to 7.14, of both plants; Fig. 7.11 is a photograph."""
    for numbers, ending in ((CORRECTED, ""), (PRINTED, "_printed")):
        practical_design(out, numbers, ending)


def practical_design(out: Path, numbers: SixthOrder, ending: str) -> None:
    """Figs 7.12 to 7.14 of one plant."""
    plant, tail = sixth_order_plant(numbers)
    forcing, amplitudes = (0.7, 1.7, 2.2), (1.0, -1.2, 1.9)
    second = [pole for pole in plant.poles if abs(abs(pole) - numbers.frequencies_rad_s[1]) < 0.1]
    normal = harmonic_conditions(plant, forcing)
    robust = harmonic_conditions(plant, forcing, robust_poles=second, robust_forcing_rad_s=[2.2])
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    for axes, conditions, label in zip(figure.subplots(2, 1, sharex=True), (normal, robust), ("normal", "robust"), strict=True):
        delays = np.arange(0.3, 1.5, 0.005)
        gains = np.full((len(delays), tap_count(conditions)), np.nan)
        for row, delay in zip(gains, delays, strict=True):
            try:
                row[:] = harmonic(conditions, delay, tail=tail).gains
            except DesignError:
                continue  # gains so large that rounding is all that is left
        axes.plot(delays, gains, linewidth=0.8)
        axes.set(ylabel=f"Gains, {label}", ylim=(-20.0, 20.0))
        axes.axvline(0.75, color=BLACK, linewidth=0.6, linestyle=":")
    axes.set_xlabel("Delay T [s]")
    figure.savefig(out / f"fig_7_12{ending}.png", dpi=130)
    filters = [("normal", harmonic(normal, 0.75, tail=tail)), ("robust", harmonic(robust, 0.75, tail=tail))]
    reference, times = sinusoids(amplitudes, forcing), np.linspace(0.0, 40.0, 1000)
    figure = Figure(figsize=(10.0, 6.0), layout="constrained")
    grid = figure.subplots(2, 2, sharex=True)
    for column, (label, shaper) in enumerate(filters):
        changed = []
        for share in (-0.1, -0.05, 0.05, 0.1):
            other = sinusoids(amplitudes, (0.7, 1.7, 2.2 * (1.0 + share)))
            changed.append(shaped_response(plant, shaper, other, times) - other.at(times))
            changed.append(shaped_response(sixth_order_plant(numbers, 1.0 + share)[0], shaper, reference, times) - reference.at(times))
        output = shaped_response(plant, shaper, reference, times)
        grid[0, column].plot(times, output, color=BLUE, linewidth=0.9, label="shaped")
        grid[0, column].plot(times, reference.at(times), "--", color=BLACK, linewidth=0.9, label="reference")
        grid[0, column].set(title=label, ylim=(-12.0, 12.0))
        grid[1, column].fill_between(times, np.min(changed, axis=0), np.max(changed, axis=0), color="#BBBBBB", linewidth=0, label="±10 %")
        grid[1, column].plot(times, output - reference.at(times), color=BLUE, linewidth=0.9, label="error")
        grid[1, column].set(xlabel="Time [s]", ylim=(-12.0, 12.0))
    grid[0, 0].legend(fontsize="small")
    grid[1, 0].legend(fontsize="small")
    figure.savefig(out / f"fig_7_13{ending}.png", dpi=130)
    curves: Curves = [(label, shaper, BLUE, "-") for label, shaper in filters]
    bode(plant, curves, np.geomspace(0.2, 6.0, 2500)).savefig(out / f"fig_7_14{ending}.png", dpi=130)


def main() -> None:
    """All of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    for draw in (example_7_1, first_order_and_robustness, example_7_3, design_case):
        draw(out)
    print("\n".join(str(path) for path in sorted(out.glob("fig_7_*.png"))))


if __name__ == "__main__":
    main()
