"""A plant whose equations are generated from its tree and compiled once.

Calling convention
------------------
`plant = compile_plant(settings)` writes (or finds) the generated module. Its compiled functions may be called from other numba functions
and take arrays only: float64 and C-contiguous, n joints in body order, axes in the order of the drives.

    model = plant.model(values, effects)          # (1,) record of records.model_dtype; new numbers need no compilation
    work = plant.new_work()                       # (1,) record of records.work_dtype: scratch memory, one per thread
    state = plant.new_state(joint_positions)      # (plant.state_size,) float64, at standstill
    plant.advance(state, effort, brakes, model, work)                # one sample period: model["steps"] plant steps, in place
    plant.imu_reading(state, effort, brakes, model, work, reading)   # (6 imus,) noise-free, of this instant, after the low passes
    plant.joint_acceleration(state, effort, brakes, model, work)     # (n,) of this instant, into work["acceleration"]
    plant.drive_currents(state, effort, model, currents)             # (axes,) what flows at this instant under these targets

`effort` (axes,) is in the drives' units and held over the sample; `brakes` (axes,) is 1.0 for closed and 0.0 for open.
`state` is [positions n, speeds n, accelerations at the end of the last step n, friction effort n, filtered imu channels 6 per imu, time,
drives (see drives.py), effects with a memory: two states and the last effort each, rates of change of the filtered channels
6 per imu in units of their corner].

A kernel that fuses the plant with other compiled code is a generated module too, so that numba can cache it: see `CompiledPlant.fuse`.
"""

from __future__ import annotations

import difflib
import inspect
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import ModuleType

import numpy as np

from virtual_bus.compilation import jit
from virtual_bus.compilation.generated_modules import load_generated
from virtual_bus.effects import motion, table
from virtual_bus.effects.dispatch import dispatch_sources
from virtual_bus.errors import EffectError, PlantError
from virtual_bus.plant import drives, friction, integrator, linear, reactions, readings, records, terms
from virtual_bus.plant.checks import check_plant
from virtual_bus.plant.generate import plant_text
from virtual_bus.plant.low_pass import fill_low_pass
from virtual_bus.plant.parameters import AXES, PlantParameter, plant_parameters
from virtual_bus.settings import EffectSetting, PlantSettings

# compiled into every generated plant
DEPENDENCIES = (motion, table, jit, linear, drives, terms, reactions, friction, integrator, readings, records)
FINEST_PHASE = 1.0  # largest product of inner step and spectral radius; the Taylor flow's error there is 1/9! = 3e-6 rad of phase per step
PROBED_POSES = 40  # at which the spectral radius is computed
SPECTRUM_MARGIN = 1.15  # for the poses between
SEEN = 256  # models whose inner steps are remembered
STANDSTILL_TIME_s = -1.0  # before the start, when no disturbance has begun

AT_POSES = '''"""Generated: equations of one plant at many poses; do not edit."""

from PLANT import equations, imu

from virtual_bus.compilation.jit import compiled_and_cached


@compiled_and_cached
def evaluate(model, work, positions, speeds, inertias, biases):
    joints = positions.shape[1]
    for row in range(len(positions)):
        for i in range(joints):
            work[0].query_position[i] = positions[row, i]
            work[0].query_speed[i] = speeds[row, i]
        equations(model[0], work[0])
        for i in range(joints):
            biases[row, i] = work[0].bias[i]
            for j in range(i + 1):
                inertias[row, i, j] = inertias[row, j, i] = work[0].mass[i, j]


@compiled_and_cached
def imu_motions(model, work, positions, speeds, accelerations, readings):
    joints = positions.shape[1]
    for row in range(len(positions)):
        for i in range(joints):
            work[0].query_position[i] = positions[row, i]
            work[0].query_speed[i] = speeds[row, i]
            work[0].query_acceleration[i] = accelerations[row, i]
        imu(model[0], work[0])
        for i in range(readings.shape[1]):
            readings[row, i] = work[0].reading[i]
'''


@dataclass(frozen=True)
class CompiledPlant:
    """The compiled functions of a plant, its parameters, and the makers of the arrays they take (see the module's text)."""

    settings: PlantSettings
    parameters: tuple[PlantParameter, ...]
    module: ModuleType
    derive: Callable[[list[float], np.ndarray], None]
    constant_count: int
    _of_thread: threading.local = field(default_factory=threading.local, repr=False, compare=False)

    @cached_property
    def joints(self) -> int:
        """Degrees of freedom."""
        return len(self.settings.tree.joints)

    @property
    def state_size(self) -> int:
        """Length of a state vector."""
        behind = len(self.settings.drives) * drives.DRIVE_STATES + 3 * table.MAX_REACTIONS
        return self.first_drive_state + behind + 6 * len(self.settings.imus)

    @property
    def first_drive_state(self) -> int:
        """Where in a state vector the drives' part begins; the time [s] stands before it."""
        return 4 * self.joints + 6 * len(self.settings.imus) + 1

    @property
    def filtered(self) -> slice:
        """Where in a state vector the IMUs' channels stand after their low passes."""
        return slice(4 * self.joints, 4 * self.joints + 6 * len(self.settings.imus))

    def filters_all(self, model: np.ndarray) -> bool:
        """Return whether every channel of the IMUs has a low pass, so that what they read stands in the state."""
        return bool(model["is_filtered"][0, : 6 * len(self.settings.imus)].all())

    @property
    def advance(self) -> Callable[..., None]:
        """Compiled: one sample period."""
        function: Callable[..., None] = self.module.advance
        return function

    @property
    def joint_acceleration(self) -> Callable[..., None]:
        """Compiled: joint accelerations at this instant."""
        function: Callable[..., None] = self.module.joint_acceleration
        return function

    @property
    def imu_reading(self) -> Callable[..., None]:
        """Compiled: noise-free IMU channels at this instant."""
        function: Callable[..., None] = self.module.imu_reading
        return function

    @property
    def drive_currents(self) -> Callable[..., None]:
        """Compiled: currents that flow in the drives at this instant."""
        function: Callable[..., None] = self.module.drive_currents
        return function

    @property
    def nominal(self) -> np.ndarray:
        """Parameter values of the settings, in the order of `parameters`."""
        return np.array([parameter.value for parameter in self.parameters])

    def with_values(self, changes: Mapping[str, float]) -> np.ndarray:
        """Return the nominal parameter values with some of them replaced by name.

        Raises
        ------
        PlantError
            A name that is no parameter of this plant.
        """
        values = self.nominal
        names = [parameter.name for parameter in self.parameters]
        for name, value in changes.items():
            if name not in names:
                close = ", ".join(difflib.get_close_matches(name, names, n=3)) or ", ".join(names)
                raise PlantError(f"no plant parameter {name!r}; there is {close}")
            values[names.index(name)] = value
        return values

    def new_work(self) -> np.ndarray:
        """Return scratch memory for one thread."""
        return np.zeros(1, self._work_dtype)

    @cached_property
    def _work_dtype(self) -> np.dtype:
        return records.work_dtype(self.joints, len(self.settings.drives), len(self.settings.imus), len(self.settings.watched_bodies))

    @property
    def _query(self) -> np.ndarray:
        """Scratch memory of the calling thread."""
        own = self._of_thread
        if not hasattr(own, "query"):
            own.query = self.new_work()
        query: np.ndarray = own.query
        return query

    def inertia_and_bias(self, model: np.ndarray, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the joint-space inertia and the bias effort at these positions and speeds (..., n).

        The inertia (..., n, n) includes the armatures. The bias (..., n) is the effort that gravity, velocities and effects ask for at zero
        acceleration.
        """
        if np.shape(q) != np.shape(v):  # broadcasting takes as long as evaluating ten poses
            q, v = np.broadcast_arrays(q, v)
        positions, speeds = (np.ascontiguousarray(each, dtype=float).reshape(-1, self.joints) for each in (q, v))
        inertias, biases = np.empty((*positions.shape, self.joints)), np.empty_like(positions)
        self._query["query_time_s"] = STANDSTILL_TIME_s
        self._at_poses.evaluate(model, self._query, positions, speeds, inertias, biases)
        shape = np.shape(q)
        return inertias.reshape(*shape, self.joints), biases.reshape(shape)

    def inertias(self, model: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Return what moves with every joint (n,) in a pose (n,) [kg m^2 or kg], the armatures included."""
        inertia, _ = self.inertia_and_bias(model, q[None], np.zeros((1, self.joints)))
        return np.diag(inertia[0]).copy()

    @cached_property
    def _at_poses(self) -> ModuleType:
        return self.fuse("poses", AT_POSES)

    def drive_gains(self, model: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Return the joint effort per unit of every drive (axes,) at these joint positions."""
        work = self._query
        work["query_position"] = q
        self.module.evaluate_gains(model, work)
        return work["gains"][0, : len(self.settings.drives)].copy()

    def imu_motion(self, model: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Return specific forces and angular rates (6 imus,) of one motion, in the IMUs' frames and before their low passes."""
        work = self._query
        work["query_position"], work["query_speed"], work["query_acceleration"] = q, v, a
        self.module.evaluate_imu(model, work)
        return work["reading"][0, : 6 * len(self.settings.imus)].copy()

    def imu_motions(self, model: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Return specific forces and angular rates (N, 6 imus) of many motions (N, n), as `imu_motion` does of one."""
        readings = np.empty((len(q), 6 * len(self.settings.imus)))
        self._at_poses.imu_motions(model, self._query, *(np.ascontiguousarray(each, dtype=float) for each in (q, v, a)), readings)
        return readings

    def body_poses(self, model: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Return position and rotation by rows (bodies, 12) of the watched bodies' frames in the world."""
        work = self._query
        work["query_position"] = q
        self.module.evaluate_poses(model, work)
        return work["poses"][0, : len(self.settings.watched_bodies)].copy()

    def new_state(self, joint_positions: np.ndarray) -> np.ndarray:
        """Return the state at standstill at these joint positions (n,), with nothing in the IMUs' low passes.

        It need not be an equilibrium: see `statics.resting_state`.
        """
        state = np.zeros(self.state_size)
        state[: self.joints] = joint_positions
        return state

    def joint_of_axis(self) -> dict[str, int]:
        """Return the number of the joint that each axis drives, in axis order."""
        return {drive.axis: self.settings.tree.joint_index(drive.joint) for drive in self.settings.drives}

    @cached_property
    def driven_joints(self) -> np.ndarray:
        """Numbers (axes,) of the joints that axes drive, in axis order."""
        return np.array(list(self.joint_of_axis().values()), dtype=np.int64)

    @cached_property
    def free_joints(self) -> np.ndarray:
        """Numbers of the joints that no axis drives."""
        return np.setdiff1d(np.arange(self.joints), self.driven_joints)

    @cached_property
    def _quantities(self) -> list[tuple[str, str]]:
        """Owner and quantity of every parameter."""
        return [(parameter.owner, parameter.quantity) for parameter in self.parameters]

    @cached_property
    def _model_dtype(self) -> np.dtype:
        return records.model_dtype(self.joints, len(self.settings.drives), len(self.settings.imus), self.constant_count)

    def model(self, values: np.ndarray | None = None, effects: Sequence[EffectSetting] | None = None) -> np.ndarray:
        """Return the record of this plant with these parameter values and effects.

        Parameters
        ----------
        values : (parameters,) array, optional
            In the order of `parameters`; the settings' own by default.
        effects : sequence of EffectSetting, optional
            The settings' own by default.

        Raises
        ------
        EffectError
            Effects that this machine cannot take together.
        """
        values = self.nominal if values is None else np.asarray(values, dtype=float)
        effects = self.settings.effects if effects is None else effects
        by_quantity = dict(zip(self._quantities, values.tolist(), strict=True))
        by_quantity |= {(imu.name, "low_pass_shape"): 0.0 for imu in self.settings.imus}
        table.changed_values(by_quantity, effects, self.settings)
        settings, tree = self.settings, self.settings.tree
        model = np.zeros(1, self._model_dtype)
        record = model[0]
        self.derive([by_quantity[quantity] for quantity in self._quantities], record["constants"])
        record["step_s"] = settings.sample_period_s / settings.substeps
        record["steps"] = settings.substeps
        for quantity in ("stiffness", "damping", "rest_position", "brake_effort"):
            record[quantity] = [by_quantity[joint.name, quantity] for joint in tree.joints]
        record["passive_stiffness"][self.free_joints] = record["stiffness"][self.free_joints]
        for k, drive in enumerate(settings.drives):
            record["effort_gain"][k] = by_quantity[drive.axis, "constant"] * by_quantity[drive.axis, "ratio"]
        sensors = [(imu.name, sensor) for imu in settings.imus for sensor in ("accelerometer_bandwidth", "gyro_bandwidth")]
        for k, (imu, sensor) in enumerate(sensors):
            channels = slice(len(AXES) * k, len(AXES) * (k + 1))
            fill_low_pass(record, channels, by_quantity[imu, sensor], by_quantity[imu, "low_pass_shape"])
        ratio_of_axis = {drive.axis: by_quantity[drive.axis, "ratio"] for drive in settings.drives}
        table.fill_friction(record, effects, settings)
        table.fill_terms(record, effects, ratio_of_axis, settings)
        table.fill_reactions(record, effects, settings)
        table.fill_shared(record, effects, settings)
        table.fill_drives(record, effects, ratio_of_axis, settings)
        try:
            record["inner_steps"] = self._known_inner_steps(model)
        except PlantError:
            if all(by_quantity[joint.name, "armature"] >= joint.armature for joint in tree.joints):
                raise
            raise EffectError("no joint-space inertia is like this: an added_inertia takes away all that its joint has") from None
        return model

    def _known_inner_steps(self, model: np.ndarray) -> int:
        """Return `_inner_steps`, remembered for models of the same inertia and springs.

        Probing takes milliseconds.
        """
        names = ("step_s", "constants", "stiffness", "damping", "rest_position", "pair_count", "pair_rows", "pair_joints", "pair_is_spring")
        key = b"".join(np.ascontiguousarray(model[name][0]).tobytes() for name in names)
        if key not in self._inner_steps_seen:
            if len(self._inner_steps_seen) >= SEEN:
                self._inner_steps_seen.clear()
            self._inner_steps_seen[key] = self._inner_steps(model)
        return self._inner_steps_seen[key]

    @cached_property
    def _inner_steps_seen(self) -> dict[bytes, int]:
        return {}

    def _inner_steps(self, model: np.ndarray) -> int:
        """Return how many steps of the linear part within a plant step its fastest mode needs over all poses.

        An eigenvector x, x' M x = 1, of a mode s has s^2 + (x' D x) s + (x' K x) = 0: |s| is the root of x' K x where it oscillates and
        at most x' D x where it does not, so it is within the largest eigenvalues of M^-1 K and M^-1 D (Tisseur and Meerbergen 2001).
        """
        stiffness, damping, rest, step_s = (model[name][0] for name in ("stiffness", "damping", "rest_position", "step_s"))
        poses = np.where(stiffness > 0.0, rest, self._probed_poses)
        masses, _ = self.inertia_and_bias(model, poses, np.zeros_like(poses))
        try:
            np.linalg.cholesky(masses)
        except np.linalg.LinAlgError:
            if model["pair_count"][0]:
                raise EffectError("no joint-space inertia is like this: an axis_coupling larger than what it couples") from None
            raise PlantError("the joint-space inertia is not positive definite: a moving body without mass or inertia") from None
        inverses = np.linalg.inv(masses)
        fastest = max(np.sqrt(_largest(inverses, stiffness)), _largest(inverses, damping))
        return max(1, int(np.ceil(SPECTRUM_MARGIN * fastest * step_s / FINEST_PHASE)))

    @cached_property
    def _probed_poses(self) -> np.ndarray:
        """Joint positions (PROBED_POSES, n): random angles, and zeros for joints that slide."""
        is_revolute = [joint.kind == "revolute" for joint in self.settings.tree.joints]
        generator = np.random.default_rng(0)
        return np.where(is_revolute, generator.uniform(-np.pi, np.pi, (PROBED_POSES, self.joints)), 0.0)

    def fuse(self, name: str, text: str, depends_on: str = "") -> ModuleType:
        """Load a further generated module, compiled and cached like the plant's own.

        Parameters
        ----------
        name : str
            Start of the module's name.
        text : str
            Python source. `PLANT` in it stands for the name of the plant's generated module: `from PLANT import advance`.
        depends_on : str
            Source of everything else that is compiled into it (`inspect.getsource` of the modules it imports).

        Returns
        -------
        ModuleType
        """
        return load_generated(name, text.replace("PLANT", self.module.__name__), depends_on)


def _largest(inverses: np.ndarray, diagonal: np.ndarray) -> float:
    """Return the largest eigenvalue of the products of these matrices (P, n, n) and a diagonal one (n,)."""
    acting = np.flatnonzero(diagonal)
    roots = np.sqrt(np.abs(diagonal[acting]))
    products = roots[:, None] * inverses[:, acting[:, None], acting] * roots
    if not products.size:
        return 0.0
    at_most = np.sqrt(np.einsum("pij,pij->p", products, products))  # every eigenvalue is within the Frobenius norm
    at_least = np.einsum("pii->pi", products).max()  # and one is no smaller than an entry of the diagonal
    return float(np.linalg.eigvalsh(products[at_most >= at_least]).max(initial=0.0))


def compile_plant(settings: PlantSettings) -> CompiledPlant:
    """Generate and compile the plant of these settings, or load it from an earlier time.

    Raises
    ------
    PlantError
        The settings are no plant: see `check_plant`.
    """
    check_plant(settings)
    generated = plant_text(settings)
    sources = "\n".join(inspect.getsource(module) for module in DEPENDENCIES) + dispatch_sources()
    module, derive = load_generated("plant", generated.text, sources), load_generated("constants", generated.derive).derive
    return CompiledPlant(settings, plant_parameters(settings), module, derive, generated.constant_count)
