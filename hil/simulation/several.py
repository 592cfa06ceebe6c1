"""LANES simulations of one machine at a time, each with its own plant parameters and effects, through the lane kernel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hil.simulation.inputs import COMPILED_FOR, Inputs
from hil.simulation.kernel import Loop
from hil.simulation.lane_kernel import Acting, Given, lane_kernel, loop_record
from virtual_bus.plant import side_by_side
from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.plant.lanes import LANES
from virtual_bus.sensors.effects import ANY, SensorEffects, SensorMemory, new_memory
from virtual_bus.sensors.measure import SensorModel, compiled_sensors, new_readings


class Taken(NamedTuple):
    """Outputs of one lane, N rows of n axes."""

    command: np.ndarray  # (N, n)
    effort: np.ndarray  # (N, n)
    position: np.ndarray  # (N, n)
    link_position: np.ndarray  # (N, n)
    speed: np.ndarray  # (N, n)
    imu: np.ndarray  # (N, 6 imus)
    ends_finite: bool


@dataclass(frozen=True)
class Own:
    """What a machine beside others has for itself besides its numbers and effects.

    Attributes
    ----------
    gain : (axes,) array
        Of its controllers, in units of the file's.
    position, speed : (joints,) arrays
        How far it begins from the states of restarts.
    early : (axes,) array
        Shares of a row by which commands act before the next row, on average over the row.
    """

    gain: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    early: np.ndarray


@dataclass(frozen=True)
class Prepared:
    """A prepared run."""

    model: np.ndarray
    state: np.ndarray
    target: np.ndarray  # (n,) targets of the drives before row 0
    loop: Loop
    sensors: SensorModel
    own: Own | None = None


class SideBySide:
    """The lane kernel of a plant with its controllers, and its memory."""

    def __init__(self, plant: CompiledPlant, sections: int) -> None:
        self._plant = plant
        self._kernel = lane_kernel(plant, sections)
        self._axes, self._imus = len(plant.settings.drives), len(plant.settings.imus)
        self._model = side_by_side.model_record(plant.joints, self._axes, self._imus, plant.constant_count)
        self._side = side_by_side.work_record(plant.joints, self._imus)
        self._loop = loop_record(plant.joints, self._axes, self._imus, sections)
        self._works = plant.new_work()
        self._sensors = compiled_sensors()

    def run(self, inputs: Inputs, runs: Sequence[Prepared]) -> list[Taken]:
        """Run at most LANES simulations of equal inner steps; lanes beyond them repeat the last, without the part of its effects.

        Threads may do so at once.
        """
        settings = self._plant.settings
        filled = [*runs, *[runs[-1]] * (LANES - len(runs))]
        states = np.array([one.state for one in filled])
        models = np.empty(LANES, filled[0].model.dtype)
        for lane, one in enumerate(filled):
            models[lane] = one.model[0]
        works = np.zeros(LANES, self._works.dtype)
        loop, side = self._loop.new(), self._begun(states)
        self._loop.field(loop, "target")[:] = np.array([one.target for one in filled]).T
        self._loop.field(loop, "gain")[:] = 1.0
        for lane, one in enumerate(filled):
            if one.own is not None:
                self._loop.field(loop, "gain")[:, lane] = one.own.gain
                self._loop.field(loop, "early")[:, lane] = one.own.early
                self._loop.field(loop, "begin_position")[:, lane] = one.own.position
                self._loop.field(loop, "begin_speed")[:, lane] = one.own.speed
        first = filled[0].loop
        if len(first.sections):
            self._loop.field(loop, "state")[:] = np.moveaxis(np.array([one.loop.state for one in filled]), 0, -1)
        effects = stacked_effects([one.sensors.effects for one in filled])
        memory = SensorMemory(*(np.stack([part] * LANES) for part in new_memory(settings)))
        affected = np.flatnonzero(effects.switches[: len(runs), ANY])
        for lane in affected.tolist():
            self._sensors.start(states[lane], filled[lane].sensors, SensorMemory(*(part[lane] for part in memory)))
        (count, axes), channels = inputs.excitation.shape, 6 * self._imus
        scratch = (np.zeros((LANES, axes)), np.zeros(axes), np.zeros(channels), np.zeros(axes), np.zeros(axes + channels))
        rows = np.empty((LANES, count, 5 * axes + 6 * self._imus))
        self._kernel.run(
            inputs.command is None, states, models, works, self._models(models), side, loop, filled[0].sensors, effects, memory,
            new_readings(settings), scratch, _acting(models[: len(runs)], affected), self._given(inputs, first), rows,
        )  # fmt: skip
        starts = [axes * k for k in range(1, 6)]
        found = []
        for own, ends_finite in zip(rows[: len(runs)], self._are_finite(side, states), strict=False):
            command, effort, position, link_position, speed, imu = np.split(own, starts, axis=1)
            given = command if inputs.command is None else inputs.command
            found.append(Taken(given, effort, position, link_position, speed, imu, bool(ends_finite)))
        return found

    def _are_finite(self, side: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Return whether the machines (LANES,) have finite states at the end."""
        names = ("position", "speed", "acceleration", "filtered", "filtered_slope")
        parts = [np.isfinite(self._side.field(side, name)).all(axis=0) for name in names]
        finite: np.ndarray = np.all([*parts, np.isfinite(states).all(axis=1)], axis=0)
        return finite

    def _given(self, inputs: Inputs, loop: Loop) -> Given:
        def filled(rows: np.ndarray | None) -> np.ndarray:
            return np.zeros(inputs.excitation.shape) if rows is None else np.require(rows, float, COMPILED_FOR)

        return Given(
            filled(inputs.reference), filled(inputs.excitation), filled(inputs.feedforward), filled(inputs.command),
            loop.sections, loop.rows, loop.limit, np.array([drive.resolution for drive in self._plant.settings.drives]),
            *self._restarts(inputs),
        )  # fmt: skip

    def _restarts(self, inputs: Inputs) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        joints, of = self._plant.joints, inputs.restarts
        is_set = np.zeros(joints, dtype=np.bool_)
        if of is None:
            return np.zeros(0, dtype=np.int64), np.zeros((0, joints, 2)), is_set
        numbers = np.full(len(inputs.excitation), -1, dtype=np.int64)
        numbers[of.rows] = np.arange(len(of.rows))
        begins = np.zeros((len(of.rows), joints, 2))
        begins[:, of.joints, 0], begins[:, of.joints, 1] = of.position, of.speed
        is_set[of.joints] = True
        return numbers, begins, is_set

    def _begun(self, states: np.ndarray) -> np.ndarray:
        n, channels = self._plant.joints, 6 * self._imus
        side = self._side.new()
        for k, name in enumerate(("position", "speed", "acceleration", "friction")):
            self._side.field(side, name)[:] = states[:, k * n : (k + 1) * n].T
        if channels:
            self._side.field(side, "filtered")[:] = states[:, 4 * n : 4 * n + channels].T
            self._side.field(side, "filtered_slope")[:] = states[:, -channels:].T
        return side

    def _models(self, models: np.ndarray) -> np.ndarray:
        memory = self._model.new()
        for name in ("constants", "stiffness", "damping", "rest_position", "effort_gain"):
            self._model.field(memory, name)[:] = np.moveaxis(models[name], 0, -1)
        weights = np.zeros((LANES, *models["second_weights"].shape[1:]))
        weights[:, :, 0, :1], weights[:, :, 0, 2:] = models["filter_weights"][:, :, :1], models["filter_weights"][:, :, 1:]
        is_second = models["is_filtered"] == 2
        weights[is_second] = models["second_weights"][is_second]
        self._model.field(memory, "second_weights")[:] = np.moveaxis(weights, 0, -1)
        return memory


def stacked_effects(effects: Sequence[SensorEffects]) -> SensorEffects:
    """Stack effects along a first axis of lanes; encoder errors of which a lane has fewer act on no channel."""
    most = max(len(one.encoder_channel) for one in effects)
    filled = []
    for one in effects:
        lacking = most - len(one.encoder_channel)
        channel = np.concatenate([one.encoder_channel, np.full(lacking, -1, dtype=np.int64)])
        rows = np.concatenate([one.encoder_rows, np.full((lacking, one.encoder_rows.shape[1]), -1.0)])
        filled.append(one._replace(encoder_channel=channel, encoder_rows=rows))
    return SensorEffects(*(np.stack(parts) for parts in zip(*filled, strict=True)))


def _acting(models: np.ndarray, affected: np.ndarray) -> Acting:
    rubs = np.diff(models["friction_first"]) > 0
    reacts = models["reaction_count"] > 0
    shares = models["shared_count"] > 0
    joints = np.any(rubs | (models["reacts"] > 0), axis=0)
    return Acting(
        np.flatnonzero((models["effort_count"] > 0) | (models["pair_count"] > 0)),
        np.flatnonzero(reacts),
        np.flatnonzero(rubs.any(axis=1) | reacts | shares),
        np.flatnonzero(models["has_drive_effects"]),
        affected,
        np.asarray(joints, dtype=np.int64),
    )
