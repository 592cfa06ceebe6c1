"""The data-driven calibration during a run: geometry at every row from what is known then, images taken in as they arrive.

The filter is that of `parameter_filter` behind the observer. Its state belongs to the exposure of the last image that came; from there to
the present row its parameters stay and the error of the displacement fades, so a late image counts as if it had come in time. Offline, the
observer's slow part is removed by smoothing without delay, which needs later rows. Here it is removed as far as an earlier calibration
found it to follow the pose, and a first-order high-pass removes the rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from controllers.observers.modal_observer import ModalObserver
from hil.calibration.data_driven.data_file import DataFile
from hil.calibration.data_driven.levelled import NOT_OFFSETS
from hil.calibration.data_driven.live_kernel import chain_of, deviation_from_nominal, pose_rows, published
from hil.calibration.data_driven.observed_beam import FLOOR_M, FLOOR_RAD, SLOW_Hz
from hil.calibration.data_driven.parameter_filter import STRAYS_S, DataDrivenFilter, displacement_columns, place_sigma, take_in
from hil.calibration.data_driven.quasi_static import QuasiStatic, marker_view
from hil.calibration.data_driven.values import CHANGE, REFUSED, USED
from hil.errors import UnusableInputError
from hil.imaging.geometry import DEVIATIONS
from hil.imaging.mailbox import KINDS, Sighting
from hil.machine import Machine
from hil.recording.channels import imu_channels

CHANNELS = (
    *((f"deviation_{name}", "m" if k < 6 else "rad") for k, name in enumerate(DEVIATIONS)),
    *((f"deviation_{name}_variance", "m^2" if k < 6 else "rad^2") for k, name in enumerate(DEVIATIONS)),
    ("deviation_images", ""),
)
"""Columns of a recording: deviations from the nominal geometry at the observer's link sides, their variances, images taken in so far."""


class Inbox(Protocol):
    """Source of images' measurements; it is told where the axes are."""

    def tell(self, row: int, time_s: float, positions: np.ndarray) -> None:
        """Tell where the axes are, NaN if unknown; every row is told."""

    def collect(self, row: int) -> list[Sighting]:
        """Return what arrives in this row."""


@dataclass(frozen=True)
class Arrival:
    """A sighting, the row it arrived in, and what became of it: used, change, refused, late or withdrawn."""

    row: int
    sighting: Sighting
    fate: str


class LiveCalibration:
    """A calibration that runs with the loop.

    Parameters
    ----------
    machine : Machine
    start : DataFile
        An earlier calibration, made with the observer that runs along.
    observer : ModalObserver
        That runs along.
    inbox : Inbox
    until_m : float
        Images of the phantom are withdrawn once the isocentre's place is known to this; 0: never.
    poses : (M, axes) array
        Where that is asked.

    Attributes
    ----------
    channels : list of (name, unit)
    values : (19,) array
        Of the channels; overwritten by every step.
    arrivals : list of Arrival
    used : int
        Images taken in.
    withdrawn_after : int or None
        Phantom images it took until they were withdrawn.
    positions, fast, live, covariance : arrays over the plan's rows
        Link sides (rows, axes); of the nine deviations the observer's fast part, what was published, and its covariance (rows, 9, 9).

    Raises
    ------
    UnusableInputError
        The earlier calibration is another machine's, or was made without an observer.
    """

    def __init__(self, machine: Machine, start: DataFile, observer: ModalObserver, inbox: Inbox, until_m: float, poses: np.ndarray) -> None:
        self.model = QuasiStatic.of(machine)
        self._start = start.parameters(self.model).aged(self.model)
        if not start.static.any():
            raise UnusableInputError("the calibration was made without an observer; make it with isocenter calibrate data --design")
        self.machine, self._inbox, self.until_m, self.poses, self.static = machine, inbox, until_m, poses, start.static
        self._period_s = 1.0 / machine.sample_rate_Hz
        self._chain = chain_of(machine)
        gravity = machine.plant.tree.gravity_m_s2
        self.gravity = gravity / np.linalg.norm(gravity)
        names, measured = [name for name, _ in observer.channels], observer.model.channels()
        wanted = imu_channels(machine.plant.imus[0].name) if machine.plant.imus else []
        if not wanted or any(name not in measured for name in wanted):
            raise UnusableInputError(f"{machine.name}: the observer does not look at the detector's IMU, which offsets turn back")
        self._imu_at = np.array([measured.index(name) for name in wanted])
        self._link = np.array([names.index(f"estimate_link_position_{axis}") for axis in machine.axes])
        self._nine = slice(names.index("estimate_source_x"), names.index("estimate_source_x") + 9)
        self._twist = displacement_columns(self.model)
        self._offsets = np.where([name.startswith(NOT_OFFSETS) for name in self.model.names], 0.0, start.values)
        self._orientation = machine.plant.imus[0].orientation
        self._rows, self._nominal = np.zeros((9, len(self.model.names))), np.zeros((6, 3))
        self._deviation, self._out, self._together = np.zeros(9), np.zeros(18), np.zeros((9, 9))
        self._asked = self.model.rows(poses, np.tile(self.gravity, (len(poses), 1)))[:, 3:6]
        self.channels, self.values = list(CHANNELS), np.full(len(CHANNELS), np.nan)
        self.restart(0)
        self.level(np.zeros(len(measured)))  # compiled before a tick waits for it
        pose_rows(*self._chain, self.gravity, poses[0].copy(), self._rows, self._nominal)
        deviation_from_nominal(self._chain[2], self._nominal, np.zeros(9), self._deviation)
        self._publish(0.0, np.zeros(9))
        self._rehearse()

    def restart(self, rows: int) -> None:
        """Prepare for row 0 of a plan of so many ticks."""
        self.filter = DataDrivenFilter(self.model, self._start, np.repeat([FLOOR_M, FLOOR_RAD], 3))
        self.arrivals: list[Arrival] = []
        self.withdrawn_after: int | None = None
        self._stands_s, self.used, self._phantoms, self._last = 0.0, 0, 0, -1
        self._low = np.zeros(9)
        self.positions, self.fast = np.full((rows, len(self._link)), np.nan), np.full((rows, 9), np.nan)
        self.live, self.covariance = np.full((rows, 9), np.nan), np.full((rows, 9, 9), np.nan)
        self.values[:] = np.nan

    def _rehearse(self) -> None:
        """Take an image of either kind in, so that no tick waits for what is done for the first time."""
        self.restart(2)
        self.fast[:] = 0.0
        self._last = 1
        for kind, size in zip(KINDS, (9, 6), strict=True):
            self._take(Sighting(0, 0, 0.5 * self._period_s, kind, self.poses[0], np.zeros(size), np.eye(size)))
        self.restart(0)

    def level(self, measured: np.ndarray) -> None:
        """Turn the detector's inertial reading in a row of the observer's measurements back by the offsets, in place.

        `levelled` does the same to a recording. Call it after the check for a repeated reading.
        """
        place, position = self._imu_at, measured[: len(self._link)]
        imu = measured[place]
        if np.isnan(imu).all():
            return
        if not np.isfinite(position).all():
            measured[place] = np.nan
            return
        pose_rows(*self._chain, self.gravity, position, self._rows, self._nominal)
        turn = self._rows[6:] @ self._offsets
        own = self._orientation @ imu.reshape(2, 3).T
        turned = own + np.cross(turn, own.T).T
        measured[place] = (self._orientation.T @ turned).T.ravel()

    def step(self, tick: int, estimate: np.ndarray) -> None:
        """Process one row: the tick of the plan and the observer's estimate (channels,) of it."""
        positions = estimate[self._link]
        self._inbox.tell(tick, tick * self._period_s, positions)
        if not np.isfinite(positions).all():
            self.values[:] = np.nan
            return
        now = tick * self._period_s
        pose_rows(*self._chain, self.gravity, positions, self._rows, self._nominal)
        deviation_from_nominal(self._chain[2], self._nominal, estimate[self._nine], self._deviation)
        rest = self._deviation - (self.static[0] + self._nominal[5] @ self.static[1:])
        passed = 1.0 if self._last < 0 else 1.0 - math.exp(-2.0 * math.pi * SLOW_Hz * self._period_s * (tick - self._last))
        self._low += passed * (rest - self._low)
        fast = rest - self._low
        self._last = tick
        self.positions[tick], self.fast[tick] = positions, fast
        arrived = self._inbox.collect(tick)
        for sighting in arrived:
            fate = self._take(sighting)
            self.arrivals.append(Arrival(tick, sighting, fate))
        if arrived:  # taking them in has left their own pose in the buffers
            pose_rows(*self._chain, self.gravity, positions, self._rows, self._nominal)
        self._publish(now, fast)
        self.live[tick], self.covariance[tick] = self.values[:9], self._together

    def _take(self, sighting: Sighting) -> str:
        """Take an image in at its exposure's time."""
        is_phantom = sighting.kind == "phantom"
        if is_phantom and self.withdrawn_after is not None:
            return "withdrawn"
        at, row = sighting.time_s, int(sighting.time_s / self._period_s)
        if not (at >= self._stands_s and 0 <= row < self._last):
            return "late"
        share = at / self._period_s - row
        fast = (1.0 - share) * self.fast[row] + share * self.fast[row + 1]
        if not np.isfinite(fast).all():
            return "late"
        pose_rows(*self._chain, self.gravity, sighting.positions, self._rows, self._nominal)
        rows, expected = self._rows, fast
        if not is_phantom:
            rows, expected = self.model.marker_rows(self._rows[None])[0], marker_view(fast[None])[0]
        work = self.filter
        work.predict(at - self._stands_s)
        self._stands_s = at
        work.exposed(sighting.exposure_id)
        fate = take_in(work, sighting.exposure_id, rows, rows[:, self._twist], sighting.values - expected, sighting.covariance)
        work.dropped(sighting.exposure_id)
        self.used += fate != REFUSED
        self._phantoms += is_phantom and fate != REFUSED
        if is_phantom and self.until_m > 0.0 and place_sigma(work, self._asked) < self.until_m:
            self.withdrawn_after = self._phantoms
        return fate

    def _publish(self, now: float, fast: np.ndarray) -> None:
        work, kept = self.filter, math.exp(-(now - self._stands_s) / STRAYS_S)
        renewed = (1.0 - kept**2) * work.renewed_variance
        published(self._rows, self._twist.start, work.x, work.covariance, kept, renewed, fast, self._out, self._together)
        self.values[:18] = self._out
        self.values[18] = self.used

    @property
    def summary(self) -> dict[str, Any]:
        """Return the run's images by what became of them, how old they were, and how well the isocentre's place is known in the end.

        An image's age is from the middle of its exposure to the row that took it in.
        """
        fates = [arrival.fate for arrival in self.arrivals]
        exposed_s = np.array([arrival.sighting.time_s for arrival in self.arrivals])
        taken_s = self._period_s * np.array([arrival.row for arrival in self.arrivals])
        used = np.array([fate in (USED, CHANGE) for fate in fates], dtype=bool)
        age_s = (taken_s - exposed_s)[used]
        p50, p95, oldest = np.percentile(age_s, [50.0, 95.0, 100.0]) if len(age_s) else [None] * 3
        return {
            **{fate: fates.count(fate) for fate in (USED, CHANGE, REFUSED, "late", "withdrawn")},
            "withdrawn_after": self.withdrawn_after,
            "age_s": {"p50": p50, "p95": p95, "max": oldest},
            "place_sigma_m": place_sigma(self.filter, self._asked),
        }
