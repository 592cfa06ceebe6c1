"""The emulated physics: plant, effects and sensors, stepped by one sample. It knows no bus."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import repeat
from typing import TYPE_CHECKING

import numpy as np

from virtual_bus.effects.scatter import drawn
from virtual_bus.linear.plant import LinearPlant, linearised
from virtual_bus.linear.sampled import SampledPlant, sampled
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.plant.drives import DRIVE_STATES
from virtual_bus.plant.statics import holding_effort, resting_state
from virtual_bus.sensors.measure import noise_rms
from virtual_bus.sensors.sensing import Latched, Sensing
from virtual_bus.settings import PlantSettings

if TYPE_CHECKING:
    import control

NOISE_BLOCK = 256  # samples of noise drawn at once, since a call of a generator costs more than its numbers


class Physics:
    """One emulated machine's physics in time.

    Parameters
    ----------
    settings : PlantSettings
        The machine, effects included.
    seed : int
        Of the sensors' noise and of what scatters from run to run. Every channel draws from its own stream, so a further channel changes
        no other.
    noise : bool
        False: no noise at all, and effects at their stated strengths; everything else is unchanged.
    """

    def __init__(self, settings: PlantSettings, seed: int = 0, noise: bool = True) -> None:
        if noise:
            settings = replace(settings, effects=drawn(settings.effects, seed, settings))
        self.settings = settings
        self.axes = tuple(drive.axis for drive in settings.drives)
        self.plant = compile_plant(settings)
        self.model = self.plant.model()
        axes, imus = len(self.axes), len(settings.imus)
        self._state = np.zeros(self.plant.state_size)
        self._effort, self._brakes = np.zeros(axes), np.zeros(axes)
        self._work = self.plant.new_work()
        acting = self._effort, self._brakes, self.model, self._work
        # nothing to compute, and nothing to compile: without drive effects targets are currents, after low passes IMUs read the state
        self._read_imus = self._find_currents = None
        self._currents, imu_motion = self._effort, self._state[self.plant.filtered]
        if self.model["has_drive_effects"][0]:
            self._currents = np.zeros(axes)
            self._find_currents = partial(self.plant.drive_currents, self._state, self._effort, self.model, self._currents)
        if not self.plant.filters_all(self.model):
            imu_motion = np.zeros(6 * imus)
            self._read_imus = partial(self.plant.imu_reading, self._state, *acting, imu_motion)
        self._sensing = Sensing(settings, self._state, self._currents, imu_motion)
        self._step = partial(self.plant.advance, self._state, *acting)
        self._noise = _Noise(settings, seed) if noise else None
        self._no_noise = np.zeros(axes + 6 * imus)
        self._rows_of_noise = repeat(self._no_noise) if self._noise is None else self._noise.rows()
        self._drawn: np.ndarray | None = None  # the noise of this sample, once something has been measured with it
        self._prepared: tuple[bytes, bytes] | None = None  # effort and brakes for which this sample is measured already
        self.place(np.zeros(axes))

    @property
    def time_s(self) -> float:
        """Time since the machine was placed, counted in whole samples."""
        return self._samples * self.settings.sample_period_s

    def place(self, axis_positions: np.ndarray) -> None:
        """Place the actuated joints at these positions (axes,) [rad or m], still and in elastic equilibrium.

        Brakes are closed and drives off. Time and the motor side's counts start at zero; windings are as cold as the room. An axis without
        a brake starts to fall.

        Raises
        ------
        PlantError
            There is no such equilibrium.
        """
        self._state[:] = resting_state(self.plant, self.model, np.asarray(axis_positions, dtype=float), held_by_brakes=True)
        self._effort[:] = 0.0
        self._brakes[:] = 1.0
        self._samples = 0
        self._sensing.start()
        self.latch_exactly()
        self._sensing.count_from_here()

    def hold(self, effort: np.ndarray) -> None:
        """Let the drives carry the load with this effort (axes,), as if they always had.

        Delays and low passes of the drives have settled, and the brakes are open. `place` leaves the drives off and the brakes closed.
        """
        self._effort[:] = effort
        self._brakes[:] = 0.0
        n = self.plant.joints
        self._state[3 * n : 4 * n] = 0.0
        drive_states = self._state[self.plant.first_drive_state :][: len(self.axes) * DRIVE_STATES].reshape(len(self.axes), DRIVE_STATES)
        drive_states[:] = self._effort[:, None]
        drive_states[:, 1] = 0.0  # the currents' rates

    def set_brakes(self, closed: np.ndarray) -> None:
        """Close or open the brakes (axes,). A closed brake is Coulomb friction of the joint's `brake_effort`."""
        self._brakes[:] = np.asarray(closed, dtype=bool)

    def set_brake_shares(self, share: np.ndarray) -> None:
        """Let each brake hold this share of its effort (axes,): 1 as when it is closed, 0 as when it is open, between them one at fault."""
        self._brakes[:] = share

    @property
    def joint_positions(self) -> np.ndarray:
        """True joint positions (n,) [rad or m] of this instant; a view that changes with time."""
        return self._state[: self.plant.joints]

    @property
    def joint_speeds(self) -> np.ndarray:
        """True joint speeds (n,) [rad/s or m/s] of this instant; a view that changes with time."""
        return self._state[self.plant.joints : 2 * self.plant.joints]

    def apply(self, effort: np.ndarray) -> None:
        """Set the effort on the motors from the present time on (axes,), in the drives' units.

        It is the effort as the drives have quantised and limited it.
        """
        self._effort[:] = effort

    def latch(self) -> Latched:
        """Return the sensors' readings at this instant. Every call draws new noise."""
        if self._prepared is None or self._prepared != (self._effort.tobytes(), self._brakes.tobytes()):
            self._measure(next(self._rows_of_noise) if self._drawn is None else self._drawn)
        self._drawn = self._prepared = None
        return self._sensing.latched

    def prepare(self, effort: np.ndarray) -> None:
        """Measure in advance what `latch` returns if this effort (axes,) acts by then.

        If another effort does, `latch` measures anew. The readings are the same either way, noise included; only the time when they are
        computed is not.
        """
        acting = self._effort.copy()
        self._effort[:] = effort
        if self._drawn is None:
            self._drawn = next(self._rows_of_noise)
        self._measure(self._drawn)
        self._prepared = self._effort.tobytes(), self._brakes.tobytes()
        self._effort[:] = acting

    def latch_exactly(self) -> Latched:
        """Return the sensors' readings without noise; no noise is drawn.

        Bias, low passes and lattices are included.
        """
        self._prepared = None
        return self._measure(self._no_noise)

    def seen_by_imu(self) -> np.ndarray:
        """Return what the first IMU sees at the latched instant (6,): effects and bias, no noise and no lattice."""
        return self._sensing.seen_by_imu()

    def read_by_imu(self, seen: np.ndarray) -> np.ndarray:
        """Return a reading of the first IMU beside the rows' (6,), where it sees this (6,): with noise of its own, on its lattice."""
        value = seen if self._noise is None else seen + self._noise.of_a_message()
        return self._sensing.on_lattice_of_imu(value)

    def _measure(self, noise: np.ndarray) -> Latched:
        if self._read_imus is not None:
            self._read_imus()
        if self._find_currents is not None:
            self._find_currents()
        self._sensing.read(noise)
        return self._sensing.latched

    def advance(self) -> None:
        """Let one sample period pass."""
        self._prepared = None
        if self._find_currents is not None:
            self._find_currents()
        self._step()
        self._sensing.advance()
        self._samples += 1

    def truth(self) -> dict[str, np.ndarray]:
        """Return what only an emulator knows of this instant.

        Joint positions, speeds and friction efforts of the last step are (n,). `pose_<body>` of each watched body is (12,): the position
        of the body's frame in the world, then its rotation by rows.
        """
        n = self.plant.joints
        poses = self.plant.body_poses(self.model, self._state[:n])
        truth = {
            "joint_position": self._state[:n].copy(),
            "joint_speed": self._state[n : 2 * n].copy(),
            "friction_effort": self._state[3 * n : 4 * n].copy(),
        }
        return truth | {f"pose_{body}": pose for body, pose in zip(self.settings.watched_bodies, poses, strict=True)}

    def holding_effort(self, axis_positions: np.ndarray) -> np.ndarray:
        """Return the drive efforts (axes,) in the drives' units that hold the machine at rest at these positions (axes,)."""
        return holding_effort(self.plant, self.model, np.asarray(axis_positions, dtype=float))

    def linear(self, axis_positions: np.ndarray) -> LinearPlant:
        """Return the machine as a linear system about rest at these axis positions (axes,), with its effects and what it leaves out.

        Actuated joints are free, brakes open.
        """
        return linearised(self.plant, np.asarray(axis_positions, dtype=float))

    def sampled(self, axis_positions: np.ndarray, outputs: Sequence[str]) -> SampledPlant:
        """Return the same as the sample loop meets it: from command k to these channels of the rows after it, delays included."""
        return sampled(self.linear(axis_positions), self.settings.sample_period_s, outputs)

    def linearise(self, axis_positions: np.ndarray) -> control.StateSpace:
        """Return `linear` for python-control: continuous, so without the drives' delays and the sensors' ages."""
        return self.linear(axis_positions).state_space()


class _Noise:
    """White noise of every channel, each from its own stream."""

    def __init__(self, settings: PlantSettings, seed: int) -> None:
        rms = noise_rms(settings)
        self._rms = np.array(list(rms.values()))
        self._streams = [np.random.default_rng([seed, zlib.crc32(name.encode())]) for name in rms]
        self._block = np.zeros((NOISE_BLOCK, len(rms)))
        self._imu_rms = self._rms[len(settings.drives) :][:6]
        self._messages = np.random.default_rng([seed, zlib.crc32(b"messages of the IMU")])

    def of_a_message(self) -> np.ndarray:
        """Return the noise (6,) of a reading of the first IMU between rows."""
        drawn: np.ndarray = self._imu_rms * self._messages.standard_normal(6)
        return drawn

    def rows(self) -> Iterator[np.ndarray]:
        """Draw the noise (channels,) of one sample after another, in the channels' units."""
        rows = list(self._block)
        while True:
            for column, stream in enumerate(self._streams):
                self._block[:, column] = self._rms[column] * stream.standard_normal(NOISE_BLOCK)
            yield from rows
