"""A machine along one recording: which efforts a motion takes, which ones the drives gave, and what the sensors should have read."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.integrate
import scipy.optimize

from hil.diagnosis.observed.rows import Observed
from hil.diagnosis.residuals.smoothing import Smoothed, smoothed
from hil.errors import BadAnswerError
from virtual_bus.effects.effect import FRICTION, SHARED_FRICTION
from virtual_bus.effects.places import imu_channel_names
from virtual_bus.effects.registry import effects as known_effects
from virtual_bus.inverse_dynamics import along_module
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.plant.drives import DRIVE_STATES
from virtual_bus.plant.statics import resting_state
from virtual_bus.sensors.effects import act_on_sensors, channel_names, new_memory
from virtual_bus.sensors.measure import new_readings, sensor_model, with_effects
from virtual_bus.settings import EffectSetting

FAR = 1e3
"""Of what was read: how far off a simulation counts that ran away."""
FINE = 4
"""Steps of the base motion in a row: with one, springs that swing at a tenth of the sample rate would give 5 % of their effort wrong; with
two, an IMU on such a spring would read 2e-4 of its acceleration wrong."""
SLIGHTLY = 1e-3
"""Relative change of efforts, of which a slope is taken."""
ROWS_OF_A_SHARE = 500
"""Over which a share of efforts is a mean: to a few per cent, as good as a law."""
LEAST_PASSED = 0.05
"""Share of efforts: a gear that loses more is none."""
OF_FRICTION = frozenset({"friction_first", "friction_rows", "shared_count", "shared_rows", "shared_joints", "share"})
OF_DRIVES = frozenset(
    {
        "effort_gain", "has_drive_effects", "drive_ratio", "limit_rows", "ripple_rows", "delay_samples", "is_lagging", "lag_transition",
        "lag_mean",
    }
)  # fmt: skip
OF_IMUS = frozenset({"filter_weights", "is_filtered", "filter_lag", "second_weights"})
OF_TERMS = frozenset(
    {
        "effort_count", "effort_rows", "effort_joint", "effort_ratio", "pair_count", "pair_rows", "pair_joints", "pair_ratio",
        "pair_is_spring", "reaction_count", "reaction_rows", "reaction_joint", "reacts",
    }
)  # fmt: skip
OF_JOINTS = frozenset({"stiffness", "passive_stiffness", "damping", "rest_position"})
OF_STEPS = frozenset({"inner_steps"})
"""Parts of a plant's record: what a motion takes, what drives give and what IMUs read depend on some of them each."""
PHASE_OF_A_STEP = 0.25
"""Largest product of a Runge-Kutta step and the fastest mode's frequency: the phase error of a step is its fifth power over 120."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Positions, speeds and accelerations (N, n) of all joints, and how unsure the speeds are (N, n)."""

    position: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    speed_deviation: np.ndarray

    def every(self, rows: int) -> Motion:
        """Return one row of so many."""
        return Motion(*(np.ascontiguousarray(each[::rows]) for each in vars(self).values()))


@dataclass(frozen=True, eq=False)
class Signals:
    """What a machine with some numbers and effects does along a motion.

    Attributes
    ----------
    needed : (N, n) array
        Efforts on the joints that the motion takes.
    given : (N, n) array
        Mean efforts of the drives on the joints from each row to the next, less those of dry friction.
    currents : (N, axes) array
        In the drives at the rows.
    readings : (N, m) array
        Of the recorded channels, without noise or lattice.
    model : record
    driven, flowing : (N, n), (N, axes) arrays
        Efforts of the drives with those of dry friction, and currents before their sensors.
    imus : (N, 6 imus) array
        What IMUs feel, behind their low passes.
    """

    needed: np.ndarray
    given: np.ndarray
    currents: np.ndarray
    readings: np.ndarray
    model: np.ndarray
    driven: np.ndarray
    flowing: np.ndarray
    imus: np.ndarray


class Trajectory:
    """The plant of a machine along one recording's motion.

    Parameters
    ----------
    observed : Observed

    Attributes
    ----------
    known : tuple of EffectSetting
        Physics that the machine has by name, in all that is computed here.
    """

    def __init__(self, observed: Observed) -> None:
        self.observed = observed
        self.settings = observed.settings
        self.known = self.settings.effects
        self.plant = compile_plant(self.settings)
        self.fine_plant = compile_plant(replace(self.settings, sample_period_s=observed.period_s / FINE))
        self._module = along_module(self.plant)
        self._work = self.plant.new_work()
        self.joints = [joint.name for joint in self.settings.tree.joints]
        names = channel_names(self.settings)
        self._columns = [names.index(channel) for channel in observed.channels]
        sensors = sensor_model(self.settings, ())
        lattices = ("position_resolution", "link_resolution", "speed_resolution", "effort_resolution")
        self._sensors = sensors._replace(
            imu_resolution=np.zeros_like(sensors.imu_resolution), **{name: 0.0 * getattr(sensors, name) for name in lattices}
        )
        self.smooth = self._smoothed()
        self.imposed = [self.joints.index(drive.joint) for drive in self.settings.drives if drive.axis in observed.imposed]
        self.begins = self._begins()

    def of(self, observed: Observed) -> Trajectory:
        """Return the same with another recording of the same experiment, whose motion is taken from this one."""
        other = copy.copy(self)
        other.observed = observed
        return other

    def model(self, values: np.ndarray | None = None, effects: Sequence[EffectSetting] = (), *, fine: bool = False) -> np.ndarray:
        """Return the record of the plant, or of the fine one, with these numbers (None: the file's), what is known of it and effects."""
        return (self.fine_plant if fine else self.plant).model(values, (*self.known, *effects))

    @property
    def measured_currents(self) -> np.ndarray:
        """Measured currents (N, axes); NaN where they are what is taken for the targets."""
        return np.where(self.observed.are_measured, np.nan, self.observed.currents)

    def _smoothed(self) -> dict[int, Smoothed]:
        """Return the smoothed motion of every joint that an encoder follows: its own, or one of joints the others of which are followed.

        Springs are not followed by what two encoders differ by: they seldom give way by more than a few steps of a lattice.
        """
        found: dict[int, Smoothed] = {}
        observed = self.observed
        finest = sorted(self.settings.encoders, key=lambda encoder: (len(encoder.joints), encoder.resolution))
        for encoder in finest:
            joints = [self.joints.index(name) for name in encoder.joints]
            further = [joint for joint in joints if joint not in found]
            if len(further) != 1 or encoder.channel not in observed.channels:
                continue
            if len(joints) > 1 and self.settings.tree.joints[further[0]].stiffness > 0.0:
                continue
            samples = observed.readings[:, observed.channels.index(encoder.channel)]
            for joint in joints:
                samples = samples - found[joint].position if joint in found else samples
            found[further[0]] = smoothed(observed.time, samples, encoder.resolution, observed.time)
        return found

    @property
    def followed(self) -> np.ndarray:
        """Which joints (n,) an encoder of their own follows."""
        return np.array([joint in self.smooth for joint in range(len(self.joints))])

    def _begins(self) -> np.ndarray:
        """Return how joints without an encoder begin (4, n): position beside rest, speed, and how unsure both are.

        A recording of the bench begins at rest. In others, joints on springs swing about rest by as much as the others move; those without
        springs begin as comes nearest to all readings and to the drives' efforts, in the first tenth and then in all rows. What that leaves
        counts as one reading: errors of equations go together.
        """
        observed, found, driven = self.observed, np.zeros((4, len(self.joints))), self.plant.driven_joints
        unknown = np.setdiff1d(self.plant.free_joints, list(self.smooth))
        if not len(unknown) or "start_pose" in observed.recording.experiment or observed.recording.metadata.get("initial"):
            return found
        is_sprung = np.array([joint.stiffness > 0.0 for joint in self.settings.tree.joints])
        for row, name in ((2, "position"), (3, "speed")):
            found[row, unknown] = max((float(np.std(getattr(one, name))) for one in self.smooth.values()), default=0.0)
        unknown = unknown[~is_sprung[unknown]]
        if not len(unknown):
            return found
        model, fine = self.model(), self.model(fine=True)
        told = [joint for joint in driven if joint in self.smooth and joint not in self.imposed]

        def off(states: np.ndarray, rows: int) -> np.ndarray:
            found[:2, unknown] = states.reshape(2, -1)
            try:
                signals = self.signals(self.base(fine, found[:2]).every(FINE), model)
            except BadAnswerError:  # it runs away from there
                return np.full(rows * (observed.readings.shape[1] + len(told)), FAR)
            left = np.hstack([observed.readings - signals.readings, (signals.given - signals.needed)[:, told]])
            size = np.append(np.nanstd(observed.readings, axis=0), signals.given[:, told].std(axis=0))
            return np.nan_to_num(left / np.where(size > 0.0, size, np.inf))[:rows].ravel()

        states = np.zeros(2 * len(unknown))
        for rows in (observed.rows // 10, observed.rows):
            best = scipy.optimize.least_squares(off, states, args=(rows,), x_scale="jac")
            states = best.x
        unsure = np.sqrt(2.0 * best.cost * np.diag(np.linalg.pinv(best.jac.T @ best.jac, hermitian=True)))
        found[:, unknown] = np.vstack([states, unsure]).reshape(4, -1)
        return found

    def base(self, model: np.ndarray, begins: np.ndarray | None = None) -> Motion:
        """Return the slow part of the recorded motion on FINE steps a row, with the other joints carried along by the equations.

        It is what the equations are linearised about. It has no faster part since a motion must be smooth between the rows, too.
        `model` is of `fine_plant`; `begins` (2, n) are other positions and speeds than `begins` in row 0.

        Raises
        ------
        BadAnswerError
            The carried joints leave all bounds.
        """
        rows, n = (self.observed.rows - 1) * FINE + 1, len(self.joints)
        q, v, a, u = (np.zeros((rows, n)) for _ in range(4))
        for joint, motion in self.smooth.items():
            whole = np.column_stack([motion.position, motion.speed, motion.acceleration, motion.speed_deviation])
            finer = _finer(whole if joint in self.imposed else motion.slow, self.observed.period_s)
            q[:, joint], v[:, joint], a[:, joint], u[:, joint] = finer.T
        carried = ~self.followed
        if carried.any():
            state = resting_state(self.plant, model, q[0, self.plant.driven_joints], held_by_brakes=False)
            begins = self.begins[:2] if begins is None else begins
            q[0, carried] = (state[: self.plant.joints] + begins[0])[carried]
            v[0, carried] = begins[1][carried]
            substeps = max(1, int(np.ceil(float(model["inner_steps"][0]) / PHASE_OF_A_STEP)))
            if not self._module.carry(model, self._work, carried, substeps, q, v, a):
                raise BadAnswerError(f"{self.observed.name}: joints without an encoder leave all bounds under the recorded motion")
        return Motion(q, v, a, u)

    def along_base(self, motion: Motion, model: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the efforts (N, n) that a fine motion takes at each row and just before the next, and the IMUs' readings (N, 6 imus).

        The efforts are those of the straight line that comes closest to the course in between.
        """
        needed = np.zeros_like(motion.position)
        self._module.efforts(model, self._work, motion.position, motion.speed, motion.acceleration, needed)
        imus = np.zeros((len(needed), len(imu_channel_names(self.settings))))
        if imus.shape[1]:
            self._module.readings(model, self._work, motion.position, motion.speed, motion.acceleration, imus)
        rows = self.observed.rows
        inside = np.stack([needed[k : (rows - 1) * FINE + k : FINE] for k in range(FINE + 1)])  # (FINE + 1, N - 1, n)
        steps = np.linspace(0.0, 1.0, FINE + 1)
        mean = scipy.integrate.simpson(inside, x=steps, axis=0)
        moment = scipy.integrate.simpson((inside - mean) * (steps - 0.5)[:, None, None], x=steps, axis=0)
        last = needed[-1:]
        return np.vstack([mean - 6.0 * moment, last]), np.vstack([mean + 6.0 * moment, last]), imus[::FINE]

    def signals(
        self, motion: Motion, model: np.ndarray, effects: Sequence[EffectSetting] = (), imus: np.ndarray | None = None,
        nearby: Signals | None = None,
    ) -> Signals:  # fmt: skip
        """Return what the machine does along a motion; `model` is of the same effects.

        `imus` are their readings where they are known. What another machine does along the same motion, `nearby`, is not computed again as
        far as the two are alike.
        """
        effects = (*self.known, *effects)
        rows, axes = self.observed.rows, len(self.settings.drives)
        if nearby is not None and _alike(model, nearby.model, OF_FRICTION | OF_DRIVES | OF_IMUS):
            needed = nearby.needed
        else:
            needed = self.needed(motion, model)
        if nearby is not None and _alike(model, nearby.model, OF_FRICTION | OF_IMUS | OF_TERMS):
            driven, flowing = nearby.driven, nearby.flowing
        else:
            driven, flowing = self._driven(motion, model)
        if imus is None and nearby is not None and _alike(model, nearby.model, OF_FRICTION | OF_DRIVES | OF_TERMS | OF_JOINTS):
            imus = nearby.imus
        elif imus is None:
            imus = np.zeros((rows, len(imu_channel_names(self.settings))))
            if imus.shape[1]:
                self._module.readings(model, self._work, motion.position, motion.speed, motion.acceleration, imus)
        given = self._with_friction(motion, model, effects, driven)
        if not imus.shape[1] and not act_on_sensors(effects):
            return Signals(needed, given, flowing, self._plain_readings(motion), model, driven, flowing, imus)
        out = np.zeros((rows, 4 * axes + imus.shape[1]))
        self._module.sense(
            motion.position, motion.speed, flowing, np.ascontiguousarray(imus), self.plant.new_state(motion.position[0]), np.zeros(axes),
            np.zeros(axes + imus.shape[1]), with_effects(self._sensors, self.settings, effects), new_memory(self.settings),
            new_readings(self.settings), out,
        )  # fmt: skip
        currents = np.nan_to_num(out[:, 2 * axes : 3 * axes])
        return Signals(needed, given, currents, out[:, self._columns], model, driven, flowing, imus)

    def needed(self, motion: Motion, model: np.ndarray) -> np.ndarray:
        """Return the efforts (N, n) on the joints that a motion takes."""
        needed = np.zeros_like(motion.position)
        self._module.efforts(model, self._work, motion.position, motion.speed, motion.acceleration, needed)
        return needed

    def given(self, motion: Motion, model: np.ndarray, effects: Sequence[EffectSetting] = ()) -> np.ndarray:
        """Return the mean efforts (N, n) of the drives along a motion, less those of dry friction, as `signals` does."""
        return self._with_friction(motion, model, (*self.known, *effects), self._driven(motion, model)[0])

    def _with_friction(self, motion: Motion, model: np.ndarray, effects: Sequence[EffectSetting], driven: np.ndarray) -> np.ndarray:
        if any(known_effects()[each.name].kind in (FRICTION, SHARED_FRICTION) for each in effects):
            driven = driven - self._rubbed(motion, model, driven)[0]
        return driven

    def unknown_friction(self, motion: Motion, model: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the variances (N, n) of efforts of friction that stay, and of such as are others in every row.

        Friction is unknown where nothing says which way a joint moves. Where it sticks, it stays. A smoothed motion begins and ends before
        and after the joint does by as long as the smoother looks: around a reversal, the effort of a few rows is anything.
        """
        given = self._driven(motion, model)[0]
        unsure = motion.speed_deviation.copy()
        for joint, one in self.smooth.items():
            unsure[:, joint] = np.hypot(unsure[:, joint], np.abs(motion.acceleration[:, joint]) * one.memory_s(self.observed.period_s))
        stays = self._rubbed(motion, model, given)[1]
        in_all = self._rubbed(replace(motion, speed_deviation=unsure), model, given)[1]
        return stays, np.maximum(in_all - stays, 0.0)

    def passed_by_friction(self, motion: Motion, model: np.ndarray) -> np.ndarray:
        """Return the share (n,) of a change of the drives' efforts that friction lets pass: 1, unless it grows with them."""
        if model[0]["friction_first"][-1] == 0 and model[0]["shared_count"] == 0:
            return np.ones(len(self.joints))
        rows = slice(None, None, max(1, self.observed.rows // ROWS_OF_A_SHARE))
        efforts = np.zeros_like(motion.position[rows])
        for axis, joint in enumerate(self.plant.driven_joints):
            efforts[:, joint] += model[0]["effort_gain"][axis] * self.observed.targets[rows, axis]
        parts = (np.ascontiguousarray(each[rows]) for each in (motion.position, motion.speed, motion.speed_deviation))
        position, speed, deviation = parts
        less, more, unused = (np.zeros_like(efforts) for _ in range(3))
        self._module.rub(model, self._work, position, speed, deviation, efforts, less, unused)
        self._module.rub(model, self._work, position, speed, deviation, (1.0 + SLIGHTLY) * efforts, more, unused)
        taken = np.sum((more - less) * efforts, axis=0) / SLIGHTLY / np.maximum(np.sum(efforts**2, axis=0), 1e-300)
        passed: np.ndarray = np.maximum(1.0 - taken, LEAST_PASSED)
        return passed

    def _driven(self, motion: Motion, model: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the drives' mean efforts on the joints (N, n), and currents (N, axes)."""
        targets = self.observed.targets
        state = self.plant.new_state(motion.position[0])
        for axis in range(targets.shape[1]):
            first = self.plant.first_drive_state + axis * DRIVE_STATES
            state[first] = state[first + 2 : first + DRIVE_STATES] = targets[0, axis]
        given, currents = np.zeros_like(motion.position), np.zeros_like(targets)
        self._module.drive(model, self._work, targets, motion.position, motion.speed, motion.acceleration, state, currents, given)
        return given, currents

    def _rubbed(self, motion: Motion, model: np.ndarray, given: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean efforts of friction (N, n), against the motion, and their variances."""
        mean, variances = np.zeros_like(given), np.zeros_like(given)
        self._module.rub(model, self._work, motion.position, motion.speed, motion.speed_deviation, given, mean, variances)
        return mean, variances

    def _plain_readings(self, motion: Motion) -> np.ndarray:
        """Return what encoders and speed sensors (N, m) without errors read."""
        out = np.zeros((len(motion.position), len(self.observed.channels)))
        for sensor in self.settings.joint_sensors:
            if sensor.channel in self.observed.channels:
                values = motion.speed if sensor in self.settings.speeds else motion.position
                joints = [self.joints.index(joint) for joint in sensor.joints]
                out[:, self.observed.channels.index(sensor.channel)] = values[:, joints].sum(axis=1)
        return out

    def linearised(self, motion: Motion, model: np.ndarray, stride: int) -> tuple[np.ndarray, ...]:
        """Return inverse inertias, stiffnesses, dampings (L, n, n), and what IMUs feel (L, channels, n) of all three."""
        q, v, a = (np.ascontiguousarray(each[::stride]) for each in (motion.position, motion.speed, motion.acceleration))
        count, n, channels = len(q), len(self.joints), len(imu_channel_names(self.settings))
        squares = [np.zeros((count, n, n)) for _ in range(3)]
        gradients = [np.zeros((count, channels, n)) for _ in range(3)]
        self._module.linearise(model, self._work, q, v, a, *squares, *gradients)
        return (*squares, *gradients)


def _alike(model: np.ndarray, other: np.ndarray, but: frozenset[str]) -> bool:
    """Return whether the records of two machines are the same, some parts aside."""
    names = [name for name in model.dtype.names or () if name not in but | OF_STEPS]
    return all(model[name].tobytes() == other[name].tobytes() for name in names)


def _finer(slow: np.ndarray, period_s: float) -> np.ndarray:
    """Return position, speed, acceleration (linear in between) and the speed's deviation (N, 4) on FINE steps a row."""
    fine = np.zeros(((len(slow) - 1) * FINE + 1, 4))
    fine[::FINE] = slow
    q, v, a = slow[:-1, :3].T
    jerk = np.diff(slow[:, 2]) / period_s
    for k in range(1, FINE):
        t = period_s * k / FINE
        fine[k::FINE, 0] = q + t * (v + t * (0.5 * a + t * jerk / 6.0))
        fine[k::FINE, 1] = v + t * (a + 0.5 * t * jerk)
        fine[k::FINE, 2] = a + t * jerk
        fine[k::FINE, 3] = slow[:-1, 3]
    return fine
