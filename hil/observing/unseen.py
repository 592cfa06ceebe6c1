"""What the observer's alarm does not see: how large something wrong may be before it shows, and how far off the estimate is until then.

A load, a softer mount or a sensor's false scale bends the estimate in a direction that the sensors hardly see, where a model is taken at
its word: at rest it looks like an IMU that sits askew. So the emulated machine makes a scan of each axis with and without it, with the
same noise. To first order the difference of the mean innovations and of the published geometry grows with its size, which tells the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from controllers.models.modal import ModalModel
from controllers.observers.consistency import means
from controllers.observers.modal_observer import ModalObserver
from hil.machine import Machine
from hil.observing.held_to_truth import SEED, SKIPPED_s, errors_and_variances, plan_of, whitened_into
from hil.observing.noise import effort_gain
from hil.observing.true_scan import true_scan
from virtual_bus.effects.places import spring_at
from virtual_bus.settings import EffectSetting

SIZES = np.geomspace(0.001, 10.0, 190)
"""Over that of the probe: 5 % from one to the next, as far as what is of first order may be taken for the whole."""

GEOMETRY = (slice(-9, -6), slice(-6, -3), slice(-3, None))
"""Focal spot, isocentre and orientation among the published values."""

TWICE = 2.0
"""An error that passes so many stated deviations should raise the alarm."""

IN_TIME_s = 1.0
"""Of that."""


@dataclass(frozen=True)
class Probe:
    """Something wrong, as large as is thought of."""

    what: str
    size: float
    unit: str
    effects: tuple[EffectSetting, ...]


@dataclass(frozen=True)
class Unseen:
    """What is not seen of something wrong."""

    what: str
    """In words."""
    size: float
    """From which on every scan raises the alarm, in `unit`; no number where none of `SIZES` does."""
    unit: str
    error_m: float
    """Largest error of focal spot or isocentre of any smaller one, in a scan without an alarm [m]."""
    times: float
    """By which the error of focal spot, isocentre or orientation is then larger than stated, at most."""
    in_time: float
    """From which on every alarm is raised within `IN_TIME_s` of the error's passing twice what is stated, in `unit`; or no number."""
    tried: float = float("nan")
    """The largest that was tried, in `unit`; no number where that is not known."""

    @property
    def note(self) -> str:
        """Return it in words."""
        most = f"up to {1e3 * self.error_m:.2g} mm off, {self.times:.2g} times what is stated"
        if not np.isfinite(self.size):
            tried = f" up to {self.tried:.3g} {self.unit}" if np.isfinite(self.tried) else ""
            return f"the alarm does not see {self.what}{tried}: focal spot or isocentre are {most}"
        known = f"from {self.in_time:.3g} {self.unit} on" if np.isfinite(self.in_time) else "of no size for certain"
        when = f"within {IN_TIME_s:g} s of passing twice what is stated, {known}"
        return f"the alarm sees {self.what} from {self.size:.3g} {self.unit} on: with less, focal spot or isocentre are {most}; {when}"


def probes(machine: Machine, axis: int, imu: str) -> Iterator[Probe]:
    """Yield what may be wrong with a machine and an IMU at its detector while an axis moves; what it cannot have is left out."""
    detector, units = machine.geometry.detector_body, machine.units[axis]  # type: ignore[union-attr]
    body = next(body for body in machine.plant.tree.bodies if body.name == detector)
    if body.mass_kg > 0.0:
        load = 0.25 * body.mass_kg
        yield Probe("a load at the detector that the file does not know", load, "kg", (EffectSetting("payload", detector, {"dm": load}),))
    spring = spring_at(detector, machine.plant) if body.joint is not None else None
    if spring is not None:
        stiffness = next(joint.stiffness for joint in machine.plant.tree.joints if joint.name == spring)
        softer = {"c": 0.25 / stiffness, "d": 0.0}
        yield Probe("a softer mount of the detector", 25.0, "% of its compliance", (EffectSetting("joint_compliance", detector, softer),))
    effort = 0.1 * float(machine.plant.drives[axis].limit * effort_gain(machine)[axis])
    unit = "Nm" if units.position == "rad" else "N"
    yield Probe("friction of a moving axis", effort, unit, (EffectSetting("coulomb_friction", machine.axes[axis], {"Fc": effort}),))
    nothing = dict.fromkeys(("sx", "sy", "sz", "bx", "by", "bz", "sg", "bg"), 0.0)
    biased = EffectSetting("imu_scale_bias", imu, nothing | {"bx": 0.1, "by": 0.1, "bz": 0.1})
    yield Probe("a bias of the detector's accelerometers", 0.1, "m/s^2", (biased,))
    scaled = EffectSetting("imu_scale_bias", imu, nothing | {"sx": 0.01, "sy": 0.01, "sz": 0.01, "sg": 0.01})
    yield Probe("a false scale of the detector's IMU", 1.0, "%", (scaled,))
    delay_s = 1.0 / machine.sample_rate_Hz
    yield Probe("a delay of a moving axis's drive", 1e3 * delay_s, "ms", (EffectSetting("delay", machine.axes[axis], {"Td": delay_s}),))


def unseen(machine: Machine, observer: ModalObserver, seed: int = 0, told: Callable[[int], None] = lambda done: None) -> tuple[Unseen, ...]:
    """Return what the alarm of an observer does not see.

    Parameters
    ----------
    machine : Machine
        As its file says.
    observer : ModalObserver
        Fresh, with what is usual in its noise.
    seed : int
    told : callable
        Told how many scans are done.
    """
    found: dict[str, tuple[Probe, list[Seen]]] = {}
    imu, done = detector_imu(observer.model), 0
    for axis in range(len(machine.axes)):
        without = _scanned(machine, observer, axis, (), seed)
        told(done := done + 1)
        for probe in probes(machine, axis, imu):
            with_it = _scanned(machine, observer, axis, probe.effects, seed)
            found.setdefault(probe.what, (probe, []))[1].append(_seen(without, with_it, observer.noise.usual, machine.sample_rate_Hz))
            told(done := done + 1)
    return tuple(judged(*each) for each in found.values())


def scans_of(machine: Machine, model: ModalModel) -> int:
    """Return how many scans `unseen` makes."""
    return sum(1 + len(list(probes(machine, axis, detector_imu(model)))) for axis in range(len(machine.axes)))


def detector_imu(model: ModalModel) -> str:
    """Return the name of the IMU at the detector, the first that the model looks at."""
    return model.sensors[0].channels[0].removesuffix("_x")


@dataclass(frozen=True)
class _Scanned:
    """Mean innovations (N, windows, measurements), errors (N, values) and stated variances (N, values) of a scan."""

    means: np.ndarray
    error: np.ndarray
    variance: np.ndarray


def _scanned(machine: Machine, observer: ModalObserver, axis: int, effects: tuple[EffectSetting, ...], seed: int) -> _Scanned:
    wrong = machine.with_effects((*machine.added_effects, *effects))
    whitened: list[np.ndarray] = []
    scan = true_scan(wrong, plan_of(machine, axis, "quiet", None), SEED + seed)
    error, variance, _ = errors_and_variances(wrong, scan, observer, whitened_into(whitened))
    first = round(SKIPPED_s * machine.sample_rate_Hz)
    return _Scanned(means(np.array(whitened), machine.sample_rate_Hz)[first:], error, variance)


@dataclass(frozen=True)
class Seen:
    """One scan with something wrong of each of `SIZES`: whether it is alarmed, and in time, and the largest errors as `Unseen` has them."""

    alarmed: list[bool] = field(default_factory=list)
    in_time: list[bool] = field(default_factory=list)
    error_m: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)


def _seen(without: _Scanned, with_it: _Scanned, usual: np.ndarray, rate_Hz: float) -> Seen:
    found = Seen()
    stated = np.array([np.sqrt(np.sum(without.variance[:, at], axis=1)) for at in GEOMETRY])
    for size in SIZES:
        means_of_it = without.means + size * (with_it.means - without.means)
        error = without.error + size * (with_it.error - without.error)
        alarm = (np.sum(means_of_it**2 / usual, axis=2) > 1.0).any(axis=1)
        off = np.array([np.sqrt(np.sum(error[:, at] ** 2, axis=1)) for at in GEOMETRY])
        times = np.max(off / stated, axis=0)
        passed, raised = np.flatnonzero(times > TWICE), np.flatnonzero(alarm)
        found.alarmed.append(bool(len(raised)))
        found.error_m.append(float(off[:2].max()))
        found.times.append(float(times.max()))
        found.in_time.append(not len(passed) or bool(len(raised) and raised[0] <= passed[0] + IN_TIME_s * rate_Hz))
    return found


def judged(probe: Probe, scans: list[Seen]) -> Unseen:
    """Return what is not seen in scans with something wrong."""
    from_alarmed = _from(np.all([scan.alarmed for scan in scans], axis=0))
    from_in_time = max(_from(np.all([scan.in_time for scan in scans], axis=0)), from_alarmed)
    smaller = slice(0, max(from_alarmed, 1))
    unseen_by = ~np.array([scan.alarmed[smaller] for scan in scans])
    counts = unseen_by if unseen_by.any() else np.ones_like(unseen_by)
    error_m, times = (float(np.array([getattr(scan, of)[smaller] for scan in scans])[counts].max()) for of in ("error_m", "times"))
    sizes, tried = np.append(probe.size * SIZES, np.nan), float(probe.size * SIZES[-1])
    return Unseen(probe.what, float(sizes[from_alarmed]), probe.unit, error_m, times, float(sizes[from_in_time]), tried)


def _from(is_so: np.ndarray) -> int:
    """Return from which size on something is so of all; how many there are where it is not so of the largest."""
    isnt = np.flatnonzero(~is_so)
    return int(isnt[-1]) + 1 if len(isnt) else 0
