"""Deviations of a C-arm's geometry from its drawing at rest, as parameters: the quasi-static part M_qs of (5.37), linear in small offsets.

Offsets are placed where the chain can be wrong: the mount against the phantom, between the axes, detector and focal spot at the chain's
end. Bending by gravity follows its direction in the detector's frame; the mount's compliance follows where the masses hang. Several
parameters look alike in the images of two axes; the filter's prior separates them. Therefore compare poses, never parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.errors import UnusableInputError
from hil.imaging.nominal import imaging_geometry, nominal_beam
from hil.machine import Machine

PLACE_M, TURN_RAD = 2e-3, 2e-3
"""Standard deviation of an offset before any image: errors of assembly and of a phantom placed by hand."""

SAG_PLACE_M, SAG_TURN_RAD = 1e-3, 3e-3
"""Of bending by gravity: a detector of some 40 kg on a mount with a mode at 14 Hz."""

YIELD_PLACE_M, YIELD_TURN_RAD = 50e-6, 50e-6
"""Of how much the mount yields as the masses swing around."""

MOVED_M, MOVED_RAD = 0.3e-3, 0.3e-3
"""How far the mount may have moved since the last scan: a bump."""

AGED = 0.01
"""Share of every other offset's prior deviation that it may have changed by since the last scan."""

HEATED_M = 20e-6
"""How far the focal spot may stand from where it stood in the last scan."""

PLATE_M, PLATE_RAD = 1e-3, 5e-3
"""How far a marker plate may stand from where its mounting says, as it shows in the source's place."""

AXES = "xyz"


@dataclass(frozen=True)
class QuasiStatic:
    """The parameters of one machine.

    Attributes
    ----------
    names, units : tuples of str
    prior : (p,) array
        Standard deviations before any image [m, rad].
    between_scans : (p,) array
        What each may change by from one scan to the next.
    """

    machine: Machine
    names: tuple[str, ...]
    units: tuple[str, ...]
    prior: np.ndarray
    between_scans: np.ndarray

    @classmethod
    def of(cls, machine: Machine) -> QuasiStatic:
        """Return the parameters of a machine with axes about which the detector turns.

        Raises
        ------
        UnusableInputError
            No [geometry], or an axis that is not revolute.
        """
        imaging_geometry(machine)
        for units in machine.units:
            if units.position != "rad":
                raise UnusableInputError(
                    f"{machine.name}: axis {units.axis} is in {units.position}; data-driven calibration knows turning axes"
                )
        names, prior, between = [], [], []

        def add(where: str, place: float, turn: float | None, changes: tuple[float, float] | None = None) -> None:
            for size, kind, by in ((place, "place", 0), (turn, "turn", 1)):
                if size is None:
                    continue
                for axis in AXES:
                    names.append(f"{where}_{kind}_{axis}")
                    prior.append(size)
                    between.append(changes[by] if changes else AGED * size)

        add("mount", PLACE_M, TURN_RAD, (MOVED_M, MOVED_RAD))
        for moved in ("cos", "sin"):
            add(f"mount_yield_{moved}", YIELD_PLACE_M, YIELD_TURN_RAD)
        for inner in machine.axes[:-1]:
            add(f"after_{inner}", PLACE_M, TURN_RAD)
        add("detector", PLACE_M, TURN_RAD)
        for g in AXES:
            add(f"detector_sag_g{g}", SAG_PLACE_M, SAG_TURN_RAD)
        add("source", PLACE_M, None, (HEATED_M, 0.0))
        for g in AXES:
            add(f"source_sag_g{g}", SAG_PLACE_M, None)
        add("plate", PLATE_M, PLATE_RAD)
        of_each = tuple("m" if "_place_" in name else "rad" for name in names)
        return cls(machine, tuple(names), of_each, np.array(prior), np.array(between))

    def rows(self, positions: np.ndarray, load: np.ndarray) -> np.ndarray:
        """Return the change of the nine deviations with each parameter, (N, 9, p).

        At axis positions (N, axes) under a load (N, 3). The load is what bends: gravity less acceleration, in the world, over gravity
        (`ObservedBeam.load`).
        """
        machine = self.machine
        positions = np.atleast_2d(positions)
        beam = nominal_beam(machine, positions)
        panel = beam.rotation  # (N, 3, 3): the panel's axes in the world
        center, source = beam.detector_in_phantom_m, beam.source_in_phantom_m
        down = np.einsum("nij,ni->nj", panel, load)
        parts = [screw(panel, center, source, np.broadcast_to(np.eye(3), panel.shape), both=True)]
        first = positions[:, 0, None, None]
        still = nominal_beam(machine, np.zeros((1, len(machine.axes)))).rotation[0]
        parts += [parts[0] * np.cos(first), parts[0] * np.sin(first)]
        for k in range(1, len(machine.axes)):
            held = positions.copy()
            held[:, k:] = 0.0
            parts.append(screw(panel, center, source, nominal_beam(machine, held).rotation @ still.T, both=True))
        at_panel = panel_twist(panel, center, source)
        parts += [at_panel, *(at_panel * down[:, g, None, None] for g in range(3))]
        at_source = np.zeros((len(positions), 9, 3))
        at_source[:, :3] = np.eye(3)
        parts += [at_source, *(at_source * down[:, g, None, None] for g in range(3))]
        parts.append(np.zeros((len(positions), 9, 6)))
        return np.concatenate(parts, axis=2)

    def marker_rows(self, rows: np.ndarray) -> np.ndarray:
        """Return the change (N, 6, p) of what a marker plate on the tube shows, from `rows` (N, 9, p).

        Source (u, v, distance) in the panel's frame, and the plate's turn against the panel: of the parameters that turn the panel only
        those of its own mount turn it against the tube.
        """
        own = np.array([name.startswith("detector") for name in self.names])
        result = marker_view(rows)
        result[:, 3:] *= own
        first = self.names.index("plate_place_x")
        result[:, :, first : first + 6] += np.eye(6)
        return result


def marker_view(deviation: np.ndarray) -> np.ndarray:
    """Return focal_u, focal_v, focal_length, theta_x, theta_y, theta_z (N, 6, ...) from changes (N, 9, ...), tube at rest."""
    return np.concatenate([deviation[:, :2], -deviation[:, 2:3], -deviation[:, 6:9]], axis=1)


def screw(panel: np.ndarray, center: np.ndarray, source: np.ndarray, frame: np.ndarray, both: bool) -> np.ndarray:
    """Return the change of the nine deviations (N, 9, 6) by a shift and a turn about the isocentre.

    They are along the axes of `frame` (N, 3, 3). panel (N, 3, 3), center (N, 3) and source (N, 3) are the panel's orientation and centre
    and the focal spot in the world. `both`: tube and panel move together, else the panel alone.
    """
    result = np.zeros((len(panel), 9, 6))
    to_panel = np.swapaxes(panel, 1, 2)
    for j in range(3):
        along = frame[:, :, j]
        for column, shift, turn in ((j, along, np.zeros_like(along)), (3 + j, np.zeros_like(along), along)):
            of_center = shift + np.cross(turn, center)
            of_source = shift + np.cross(turn, source) if both else np.zeros_like(shift)
            moved = np.stack([of_source - of_center - np.cross(turn, source - center), -of_center + np.cross(turn, center), turn], axis=1)
            result[:, :, column] = np.einsum("nij,nkj->nki", to_panel, moved).reshape(-1, 9)
    return result


def panel_twist(panel: np.ndarray, center: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Return the change of the nine deviations (N, 9, 6) by a shift of the panel's centre and a turn about it.

    Both are along the panel's own axes.
    """
    result = screw(panel, center, source, panel, both=False)
    about_isocenter = result[:, :, 3:].copy()
    for j in range(3):
        # about the centre: about the isocentre, less the shift that gives the centre
        shift = -np.einsum("nji,nj->ni", panel, np.cross(panel[:, :, j], center))
        result[:, :, 3 + j] = about_isocenter[:, :, j] + np.einsum("nki,ni->nk", result[:, :, :3], shift)
    return result
