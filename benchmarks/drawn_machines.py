"""Machines drawn within the ranges that `carm-real.toml` states beside its levels, and the machine of their root mean squares.

A size that lies between two levels is drawn evenly over the logarithm, from zero evenly; its sign and its phases are drawn, too. Machines
of one set are a Latin hypercube (McKay, Beckman, Conover 1979): each size is drawn once from every equal part of its range, so that the
root mean squares of a few machines are those of many. A file without effects leaves nothing to draw but the sensors' noise.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from hil.machine import Machine
from virtual_bus.settings import EffectSetting

ARCMIN_rad = np.radians(1.0 / 60.0)
J_kg_m2 = 150.0
"""Inertia in the damping of the bristles: sigma1 = sqrt(sigma0 J)."""

Range = tuple[float, float]

RANGES: dict[str, dict[str, Range]] = {
    "presliding_hysteresis": {"Fc": (27.0, 45.0), "break_away": (0.3, 1.0), "bristle": (0.05e-3, 1e-3), "vs": (0.002, 0.05)},
    "temperature_dependent_friction": {"Fv0": (0.0, 30.0), "a": (0.01, 0.05), "R": (0.5, 5.0), "tau": (600.0, 3600.0)},
    "backlash": {"b": (0.05 * ARCMIN_rad, 0.5 * ARCMIN_rad), "flank": (0.0, 0.2e-3)},
    "transmission_error": {"e1": (5e-6, 1e-4), "second": (0.0, 0.5)},
    "cable_spring": {"kc": (2.0, 50.0), "cubic": (0.0, 0.2)},
    "thermal_bending": {"bend": (2e-5, 5e-4), "warm_for": (0.0, 3600.0)},
    "creep": {"k1": (4e5, 4e6), "tau": (10.0, 3600.0)},
    "imu_misalignment": {"r": (4e-3, 8e-3)},
    "imu_scale_bias": {"s": (5e-4, 5e-3), "b": (5e-3, 5e-2), "bg": (1e-4, 3e-3)},
    "encoder_eccentricity": {"a": (1e-5, 2e-4), "motor": (4e-7, 1e-5)},
}
"""Per effect: sizes as the file's comments give them. Joints' friction of Table: 0.9 to 1.5 rad/s times 30 Nm s/rad."""


class Drawing:
    """Draws one machine of a set."""

    def __init__(self, number: int, of: int, seed: int) -> None:
        self.number, self.of, self.seed, self.drawn = number, of, seed, 0

    def share(self) -> float:
        """Return a number from 0 to 1, each call of its own quantity."""
        self.drawn += 1
        strata = np.random.default_rng([self.seed, self.drawn])
        return float((strata.permutation(self.of) + strata.random(self.of))[self.number] / self.of)

    def size(self, between: Range) -> float:
        """Return a size from a range."""
        low, high = between
        share = self.share()
        return float(low * (high / low) ** share) if low > 0.0 else share * high

    def signed(self, between: Range) -> float:
        """Return a size of either sign."""
        return self.size(between) * (1.0 if self.share() < 0.5 else -1.0)

    def phase(self) -> float:
        """Return a phase [rad]."""
        return float(np.pi * (2.0 * self.share() - 1.0))


class Typical(Drawing):
    """Returns root mean squares instead."""

    def __init__(self) -> None:
        super().__init__(0, 1, 0)

    def size(self, between: Range) -> float:
        """Return the root mean square of a range."""
        low, high = between
        return float(np.sqrt((high**2 - low**2) / (2.0 * np.log(high / low)))) if low > 0.0 else high / np.sqrt(3.0)

    def signed(self, between: Range) -> float:
        """Return the same."""
        return self.size(between)


def drawn(machine: Machine, number: int, of: int, seed: int = 0) -> Machine:
    """Return machine `number`, from 0, of a set of so many, whose effects lie somewhere in their ranges."""
    return _with(machine, Drawing(number, of, seed))


def typical(machine: Machine) -> Machine:
    """Return the machine whose effects are the root mean squares of those drawn, which is what is known of one before it is measured."""
    return _with(machine, Typical())


def _with(machine: Machine, of: Drawing) -> Machine:
    effects = tuple(
        dataclasses.replace(effect, parameters=effect.parameters | _parameters(effect, of), scatter=0.0) for effect in machine.plant.effects
    )
    return dataclasses.replace(machine, plant=dataclasses.replace(machine.plant, effects=effects), own_effects=effects)


def _parameters(effect: EffectSetting, of: Drawing) -> dict[str, float]:
    ranges = RANGES.get(effect.name, {})
    if effect.name == "presliding_hysteresis":
        level, bristle = of.size(ranges["Fc"]), of.size(ranges["bristle"])
        stiffness = level / bristle
        return {
            "Fc": level, "Fs_minus_Fc": level * of.size(ranges["break_away"]), "vs": of.size(ranges["vs"]),
            "sigma0": stiffness, "sigma1": float(np.sqrt(stiffness * J_kg_m2)),
        }  # fmt: skip
    if effect.name == "transmission_error":
        first = of.size(ranges["e1"])
        return {"e1": first, "e2": first * of.size(ranges["second"]), "phi1": of.phase(), "phi2": of.phase()}
    if effect.name == "cable_spring":
        level = of.size(ranges["kc"])
        return {"kc": level, "kc3": level * of.size(ranges["cubic"]), "theta0": of.signed((0.1, 0.5))}
    if effect.name == "thermal_bending" and effect.at != "detector":  # of the thesis: 10 um within 4 to 8 s
        return {"bend": effect.parameters["bend"] * of.signed((0.7, 1.3)), "tau": of.size((4.0, 8.0))}
    if effect.name == "thermal_bending":
        tau, longest = effect.parameters["tau"], ranges["warm_for"][1]
        if isinstance(of, Typical):  # as long as gives the root mean square of the warmth over all times
            x = longest / tau
            warmth = np.sqrt(1.0 + (2.0 * np.expm1(-x) - 0.5 * np.expm1(-2.0 * x)) / x)
            return {"bend": of.size(ranges["bend"]), "warm_for": float(-tau * np.log1p(-warmth))}
        return {"bend": of.signed(ranges["bend"]), "warm_for": of.size(ranges["warm_for"])}
    if effect.name == "imu_misalignment":
        return {name: of.signed(ranges["r"]) for name in ("rx", "ry", "rz")}
    if effect.name == "imu_scale_bias":
        scales = {name: of.signed(ranges["s"]) for name in ("sx", "sy", "sz", "sg")}
        return scales | {name: of.signed(ranges["b"]) for name in ("bx", "by", "bz")} | {"bg": of.signed(ranges["bg"])}
    if effect.name == "encoder_eccentricity":
        if effect.at.startswith("link_"):
            return {"a": of.size(ranges["a"]), "phi": of.phase()}
        return {"b": of.size(ranges["motor"]), "phi": of.phase()}
    return {name: of.size(between) for name, between in ranges.items() if name in effect.parameters}
