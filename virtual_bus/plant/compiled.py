"""A plant whose equations are generated from its tree and compiled once.

Calling convention
------------------
`plant = compile_plant(settings)` writes (or finds) the generated module; its compiled functions take arrays only and may be called from
other numba functions. All arrays are float64 and C-contiguous, n joints in body order, axes in the order of the drives.

    model = plant.model(values, effects)          # a named tuple; new numbers need no compilation
    work = plant.new_work()                       # scratch memory, one per thread
    state = plant.new_state(joint_positions)      # (plant.state_size,) float64, at standstill
    plant.advance(state, effort, brakes, model, work)      # one sample period: model.steps plant steps, in place
    plant.imu_reading(state, effort, brakes, model, work, reading)   # (6 imus,) noise-free, of this instant
    plant.joint_acceleration(state, effort, brakes, model, work)     # (n,) into work.derivative: of this instant
    plant.imu(q, v, a, model.constants, reading)  # (6 imus,) before the low passes, of given motion
    plant.mass_and_bias(q, v, model.constants, M, b)       # joint-space inertia (lower half) and gravity and velocity effort
    plant.poses(q, model.constants, out)          # (bodies, 12): position and rotation by rows of settings.watched_bodies

`effort` (axes,) is in the drives' units and held over the sample; `brakes` (axes,) is 1.0 for closed, 0.0 for open.
`state` is [positions n, speeds n, mean accelerations of the last step n, friction effort n, filtered imu channels 6 per imu].

A kernel that fuses the plant with something else is a generated module too, so that numba can cache it: see `CompiledPlant.fuse`.
"""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from virtual_bus.effects import effect, registry
from virtual_bus.effects.effect import FRICTION
from virtual_bus.effects.table import friction_table
from virtual_bus.errors import PlantError
from virtual_bus.plant import integrator, jit, readings
from virtual_bus.plant import model as model_arrays
from virtual_bus.plant.checks import check_plant
from virtual_bus.plant.emit import Emitter
from virtual_bus.plant.equations import PlantEquations
from virtual_bus.plant.model import Model, Work, new_work
from virtual_bus.plant.modules import load_generated
from virtual_bus.plant.parameters import AXES, PlantParameter, plant_parameters
from virtual_bus.settings import EffectSetting, PlantSettings

HEADER = '''"""Generated from a tree of rigid bodies; do not edit."""

from math import cos, sin

from virtual_bus.plant import integrator, readings
from virtual_bus.plant.jit import compiled, compiled_and_cached


def interpreted(function):
    return function


'''

ENTRY_POINTS = """

@compiled_and_cached
def advance(state, effort, brakes, model, work):
    integrator.advance(JOINTS, AXIS_JOINTS, mass_and_bias, friction_level, imu, state, effort, brakes, model, work)


@compiled_and_cached
def joint_acceleration(state, effort, brakes, model, work):
    readings.joint_acceleration(JOINTS, AXIS_JOINTS, mass_and_bias, friction_level, state, effort, brakes, model, work)


@compiled_and_cached
def imu_reading(state, effort, brakes, model, work, reading):
    readings.imu_reading(JOINTS, AXIS_JOINTS, mass_and_bias, friction_level, imu, state, effort, brakes, model, work, reading)
"""

DEPENDENCIES = (effect, jit, integrator, readings, model_arrays)  # compiled into every generated plant
FINEST_PHASE = 1.5  # largest product of inner step and spectral radius: well inside the Taylor flow's stability, error below 1e-4
PROBED_POSES = 40  # at which the spectral radius is looked for
SPECTRUM_MARGIN = 1.15  # for the poses between


@dataclass(frozen=True)
class CompiledPlant:
    """A plant's compiled functions, its parameters, and the makers of the arrays they take. See the module's text."""

    settings: PlantSettings
    parameters: tuple[PlantParameter, ...]
    module: ModuleType
    constant_count: int

    @property
    def joints(self) -> int:
        return len(self.settings.tree.joints)

    @property
    def state_size(self) -> int:
        return 4 * self.joints + 6 * len(self.settings.imus)

    @property
    def advance(self) -> Any:
        return self.module.advance

    @property
    def joint_acceleration(self) -> Any:
        return self.module.joint_acceleration

    @property
    def imu_reading(self) -> Any:
        return self.module.imu_reading

    @property
    def mass_and_bias(self) -> Any:
        return self.module.mass_and_bias

    @property
    def imu(self) -> Any:
        return self.module.imu

    @property
    def poses(self) -> Any:
        return self.module.poses

    @property
    def nominal(self) -> np.ndarray:
        """Parameter values of the settings, in the order of `parameters`."""
        return np.array([parameter.value for parameter in self.parameters])

    def with_values(self, changes: Mapping[str, float]) -> np.ndarray:
        """Nominal parameter values with some replaced by name."""
        values = self.nominal
        names = [parameter.name for parameter in self.parameters]
        for name, value in changes.items():
            if name not in names:
                close = ", ".join(difflib.get_close_matches(name, names, n=3)) or ", ".join(names)
                raise PlantError(f"no plant parameter {name!r}; there is {close}")
            values[names.index(name)] = value
        return values

    def new_work(self) -> Work:
        return new_work(self.joints, len(self.settings.imus))

    def new_state(self, joint_positions: np.ndarray) -> np.ndarray:
        """State at standstill at these positions (n,), with nothing in the IMUs' low passes: see `statics.settle` for equilibrium."""
        state = np.zeros(self.state_size)
        state[: self.joints] = joint_positions
        return state

    def joint_of_axis(self) -> dict[str, int]:
        return {drive.axis: self.settings.tree.joint_index(drive.joint) for drive in self.settings.drives}

    def model(self, values: np.ndarray | None = None, effects: Sequence[EffectSetting] | None = None) -> Model:
        """The arrays of this plant with these numbers.

        Parameters
        ----------
        values : (parameters,) array, optional
            In the order of `parameters`; the settings' own by default.
        effects : sequence of EffectSetting, optional
            The settings' own by default.
        """
        values = self.nominal if values is None else np.asarray(values, dtype=float)
        by_name = {parameter.name: float(value) for parameter, value in zip(self.parameters, values, strict=True)}
        by_quantity = {(p.owner, p.quantity): by_name[p.name] for p in self.parameters}
        constants = np.zeros(max(self.constant_count, 1))
        self.module.derive([float(value) for value in values], constants)
        settings, tree = self.settings, self.settings.tree
        first, rows = friction_table(settings.effects if effects is None else effects, self.joint_of_axis(), self.joints)
        step_s = settings.sample_period_s / settings.substeps
        bandwidths = [
            by_quantity[imu.name, sensor] for imu in settings.imus for sensor in ("accelerometer_bandwidth", "gyro_bandwidth") for _ in AXES
        ]

        def of_joints(quantity: str) -> np.ndarray:
            return np.array([by_quantity[joint.name, quantity] for joint in tree.joints])

        model = Model(
            step_s=step_s,
            steps=settings.substeps,
            inner_steps=1,
            constants=constants,
            stiffness=of_joints("stiffness"),
            damping=of_joints("damping"),
            rest_position=of_joints("rest_position"),
            brake_effort=of_joints("brake_effort"),
            effort_gain=np.array([by_quantity[d.axis, "constant"] * by_quantity[d.axis, "ratio"] for d in settings.drives]),
            filter_weights=np.array([_low_pass_weights(bandwidth, step_s) for bandwidth in bandwidths]).reshape(-1, 3),
            is_filtered=np.array(bandwidths, dtype=float) > 0.0,
            friction_first=first,
            friction_rows=rows,
        )
        return model._replace(inner_steps=self._inner_steps(model))

    def _inner_steps(self, model: Model) -> int:
        """As many steps of the linear part within a plant step as its fastest mode over all poses needs."""
        n = self.joints
        generator = np.random.default_rng(0)
        mass, bias = np.zeros((n, n)), np.zeros(n)
        fastest = 0.0
        for _ in range(PROBED_POSES):
            q = np.where([joint.kind == "revolute" for joint in self.settings.tree.joints], generator.uniform(-np.pi, np.pi, n), 0.0)
            q = np.where(model.stiffness > 0.0, model.rest_position, q)
            self.mass_and_bias(q, np.zeros(n), model.constants, mass, bias)
            try:
                lower = np.linalg.cholesky(mass)
            except np.linalg.LinAlgError:
                raise PlantError("the plant's joint-space inertia is not positive definite: a moving body without mass or inertia") from None
            inverse = np.linalg.inv(lower @ lower.T)
            first_order = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse * model.stiffness, -inverse * model.damping]])
            fastest = max(fastest, float(np.abs(np.linalg.eigvals(first_order)).max()))
        return max(1, int(np.ceil(SPECTRUM_MARGIN * fastest * model.step_s / FINEST_PHASE)))

    def fuse(self, name: str, text: str, depends_on: str = "") -> ModuleType:
        """A further generated module, compiled and cached like the plant's own.

        Parameters
        ----------
        name : str
            Start of the module's name.
        text : str
            Python source. `PLANT` in it stands for the name of the plant's generated module: `from PLANT import advance`.
        depends_on : str
            Source of whatever else is compiled into it (`inspect.getsource` of the modules it imports).
        """
        return load_generated(name, text.replace("PLANT", self.module.__name__), depends_on)


def _low_pass_weights(bandwidth_Hz: float, step_s: float) -> tuple[float, float, float]:
    """First-order low pass over one step, exact for an input linear in time: weights of old output, input at start, input at end."""
    if bandwidth_Hz <= 0.0:
        return 0.0, 0.0, 1.0
    phase = 2.0 * np.pi * bandwidth_Hz * step_s
    decay = float(np.exp(-phase))
    mean = (1.0 - decay) / phase
    return decay, mean - decay, 1.0 - mean


def compile_plant(settings: PlantSettings) -> CompiledPlant:
    """Generate and compile the plant of these settings, or load it from an earlier time.

    Raises
    ------
    PlantError
        The settings are no plant: see `check_plant`.
    """
    check_plant(settings)
    parameters = plant_parameters(settings)
    text, constant_count = plant_text(settings, tuple(parameter.name for parameter in parameters))
    sources = "\n".join(inspect.getsource(module) for module in DEPENDENCIES) + registry.effect_sources()
    return CompiledPlant(settings, parameters, load_generated("plant", text, sources), constant_count)


def plant_text(settings: PlantSettings, parameter_names: tuple[str, ...]) -> tuple[str, int]:
    """Source of a plant's generated module, and the length of its vector of constants."""
    equations = PlantEquations(settings, parameter_names)
    emitter = Emitter()
    joints = settings.tree.joints
    inertia = equations.inertia()
    targets = [
        (f"M[{i}, {j}]", inertia.get((i, j), equations.graph.zero)) for i in range(len(joints)) for j in range(i + 1)
    ]
    targets += [(f"b[{i}]", node) for i, node in enumerate(equations.bias())]
    readings_of_imus = [node for imu in settings.imus for node in equations.imu(imu)]
    poses = [(f"out[{i}, {k}]", node) for i, body in enumerate(settings.watched_bodies) for k, node in enumerate(equations.pose(body))]
    axis_joints = tuple(settings.tree.joint_index(drive.joint) for drive in settings.drives)
    parts = [
        HEADER,
        f"JOINTS = {tuple(range(len(joints)))!r}\nAXIS_JOINTS = {axis_joints!r}\n\n",
        emitter.function_text("compiled_and_cached", "mass_and_bias", "q, v, c, M, b", targets),
        emitter.function_text("compiled_and_cached", "imu", "q, v, a, c, out", [(f"out[{k}]", node) for k, node in enumerate(readings_of_imus)]),
        emitter.function_text("compiled_and_cached", "poses", "q, c, out", poses),
        emitter.derive_text(),
        registry.dispatcher_text(FRICTION, "friction_level"),
    ]
    return "\n\n".join(parts) + ENTRY_POINTS, emitter.constant_count
