"""Effects judged by free runs of the closed loop: an independent recursion's friction is named, if the controller is the file's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from carriage import MACHINE, disturbance, recording, reference, run

from controllers.feedback import Feedback
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.diagnosis.candidates.entries import free_parameters
from hil.diagnosis.diagnose import audit_recordings, diagnose
from hil.diagnosis.free_runs.runs import FreeRuns, free_runs
from hil.diagnosis.model_choice.choose import choose_effects
from hil.diagnosis.model_choice.covariance import scattered
from hil.diagnosis.model_choice.fitting import fit
from hil.diagnosis.model_choice.fixed_scale import held_at
from hil.diagnosis.model_choice.free_run_fit import fit_to
from hil.diagnosis.residuals.residuals import Residuals, residuals_of
from hil.diagnosis.retuning.linear_model import linear_at, nominal_offset
from hil.diagnosis.retuning.numbers import PRIOR
from hil.errors import RecordingError
from hil.experiments import Jog, JogOnly, Tour
from hil.machine import Machine, load_machine
from hil.recording import Recording, read_recording
from hil.simulation import simulate
from hil.simulation.smooth import smooth
from virtual_bus.settings import EffectSetting

FRICTION_N = 4.0
DRAG = EffectSetting("quadratic_friction", "carriage", {"Fv2": 5000.0})


def recorded(count: int = 3, coulomb_N: float = 0.0, duration_s: float = 4.0) -> dict[str, Recording]:
    """Repeats whose commands are the law's own."""
    print(f"seeds 0 to {count - 1}")
    wanted = reference(duration_s)
    found = {}
    for seed in range(count):
        force = disturbance(len(wanted), 2.0, seed)
        one = recording(wanted, *run(wanted, coulomb_N=coulomb_N, force_N=force, noise_seed=seed, feeds_back=True))
        states = {
            axis: {name: values.tolist() for name, values in each.items()} for axis, each in Feedback(MACHINE.controllers).states.items()
        }
        found[f"run_{seed}"] = Recording(one.channels, {**one.metadata, "initial": {"controller_states": states}})
    return found


def freely(recordings: dict[str, Recording], machine: Machine = MACHINE) -> FreeRuns:
    """Free runs beside recordings."""
    return free_runs(residuals_in(recordings, machine), audit_recordings(machine, recordings, {}))


def residuals_in(recordings: dict[str, Recording], machine: Machine = MACHINE) -> Residuals:
    """What is seen of them, where free runs judge."""
    return residuals_of(machine, recordings, freely=True)


def test_friction_that_disturbances_hide_in_each_row_is_named_with_its_level() -> None:
    recordings = recorded(coulomb_N=FRICTION_N)
    free = freely(recordings)
    best = choose_effects(residuals_in(recordings), free).best
    assert [(one.name, one.at) for one in best.settings] == [("coulomb_friction", "carriage")]
    assert best.settings[0].parameters["Fc"] == pytest.approx(FRICTION_N, rel=0.1)
    assert best.squares / free.readings == pytest.approx(1.0, abs=0.1)


def test_a_sound_machine_has_no_effect_and_leaves_noise() -> None:
    recordings = recorded()
    free = freely(recordings)
    best = choose_effects(residuals_in(recordings), free).best
    assert best.settings == ()
    assert best.squares / free.readings == pytest.approx(1.0, abs=0.1)


def test_the_scale_of_all_efforts_is_as_sure_as_the_file_is() -> None:
    """Ratios of numbers show; of K numbers, each known to a tenth, the common scale is known to a tenth over the root of K."""
    free = freely(recorded(coulomb_N=FRICTION_N, duration_s=6.0))
    fitted = fit_to(free, (EffectSetting("coulomb_friction", "carriage", {"Fc": 0.5 * FRICTION_N}),))
    assert fitted is not None
    share, value, offset = 1.03, fitted.settings[0].parameters["Fc"], fitted.offset.copy()
    scaled = [k for k, number in enumerate(free.numbers.names) if number.split(".")[1] in ("mass", "damping", "constant")]
    offset[scaled] = (share * (1.0 + PRIOR * offset[scaled]) - 1.0) / PRIOR
    larger = EffectSetting("coulomb_friction", "carriage", {"Fc": share * value})
    (here,), (there,) = (free.left([trial]) for trial in ((fitted.offset, fitted.settings), (offset, (larger,))))
    assert here is not None
    assert there is not None
    np.testing.assert_allclose(there[0], here[0], atol=1e-3)
    assert scattered(fitted)[-1] / value == pytest.approx(PRIOR / np.sqrt(len(scaled)), rel=0.25)
    direction = np.zeros(fitted.columns[0].shape[1])  # differences do not cancel as far as a quiet machine's recordings would show
    direction[scaled], direction[-1] = 1.0 / PRIOR + fitted.offset[scaled], value
    (columns,) = fitted.columns
    assert np.linalg.norm(columns @ direction) < 1e-9 * np.linalg.norm(columns * direction)


@pytest.mark.slow
def test_along_the_motion_weaker_drives_on_a_lighter_machine_leave_no_less(tmp_path: Path) -> None:
    """The equations are linear, and what is left is in forces: its scatter may not make machines look smaller, nor a delay shorter."""
    machine, delay = load_machine("turntable"), EffectSetting("delay", "turn", {"Td": 0.012})
    (plan,) = JogOnly(jog=Jog(np.radians(8.0), line=1), period_s=3.0, periods=2).plans(machine)
    recordings = {}
    with open_bench(machine, BenchOptions("lockstep:", seed=1, emulated=machine.with_effects((delay,))), plan.start_pose) as bench:
        for number in range(3):
            bench.run(plan, tmp_path / f"jog_{number}.mf4")
            recordings[f"jog_{number}"] = read_recording(tmp_path / f"jog_{number}.mf4")
    nearby = residuals_of(machine, recordings)
    linear = linear_at(nearby.trajectories, nearby.levels, nominal_offset(nearby.trajectories))
    fitted = fit(linear, (replace(delay, parameters={"Td": 0.01}),))
    assert fitted is not None
    assert fitted.settings[0].parameters["Td"] == pytest.approx(0.012, abs=5e-5)
    scaled = [
        k for k, number in enumerate(linear.numbers.names) if number.split(".")[1] in ("inertia_zz", "armature", "damping", "constant")
    ]
    assert fitted.offset[scaled] == pytest.approx(0.0, abs=0.1)
    assert scattered(fitted)[scaled].min() > 0.9 / np.sqrt(len(scaled)), "no more is known of any than of their mean"
    heavier, rubs = linear.offset.copy(), EffectSetting("coulomb_friction", "turn", {"Fc": 3.3})
    heavier[: len(linear.numbers.indices)] = 0.1 / PRIOR  # all of the turntable's numbers are forces or inertias, a tenth larger now
    held = held_at(linear, (rubs,), heavier, free_parameters((rubs,)))
    assert held.offset == pytest.approx(linear.offset, abs=1e-9)
    assert held.settings[0].parameters["Fc"] == pytest.approx(3.0)
    scale = np.zeros(fitted.columns[0].shape[1])
    scale[scaled] = 1.0 / PRIOR + fitted.offset[scaled]
    (columns,) = fitted.columns
    assert np.linalg.norm(columns @ scale) < 1e-6 * np.linalg.norm(columns * scale)


@pytest.mark.nightly
def test_fits_end_at_the_same_cost_from_wherever_they_begin(tmp_path: Path) -> None:
    """Forty numbers of the C-arm stand in for a drag and for each other: the valley between them is narrow and curved."""
    machine, drag = load_machine("carm"), EffectSetting("quadratic_friction", "propeller", {"Fv2": 0.5})
    stops = tuple({"propeller": np.radians(p), "roll": np.radians(r)} for p, r in ((0.0, 0.0), (25.0, 20.0), (-10.0, -20.0), (5.0, 35.0)))
    (plan,) = Tour(stops, pace=0.9, dwell_s=0.3).plans(machine)
    recordings = {}
    with open_bench(machine, BenchOptions("lockstep:", seed=4, emulated=machine.with_effects((drag,))), plan.start_pose) as bench:
        for number in range(3):
            bench.run(plan, tmp_path / f"tour_{number}.mf4")
            recordings[f"tour_{number}"] = read_recording(tmp_path / f"tour_{number}.mf4")
    free = freely(recordings, machine)
    fits = [fit_to(free, (replace(drag, parameters={"Fv2": strength}),)) for strength in (0.1, 0.5, 2.0)]
    costs = [one.cost() for one in fits if one is not None]
    assert costs == pytest.approx([min(costs)] * 3, abs=1.0)
    assert min(costs) / free.readings == pytest.approx(1.0, abs=0.1)


def test_what_the_recorded_motion_speaks_against_is_not_named() -> None:
    """Free runs that lack a friction, beside recordings of a motion without."""
    assert choose_effects(residuals_in(recorded()), freely(recorded(coulomb_N=FRICTION_N))).best.settings == ()


def test_held_out_errors_are_those_of_the_closed_loop() -> None:
    train, held = recorded(coulomb_N=FRICTION_N), recorded(1, coulomb_N=FRICTION_N, duration_s=3.0)
    fit = diagnose(MACHINE, train, {"held": held["run_0"]}, freely=True).diagnosis.fit
    assert fit.held_out is not None
    assert fit.horizon_s is None
    assert fit.held_out.extended == pytest.approx(1.0, abs=0.3)
    assert fit.held_out.nominal is not None
    assert fit.held_out.nominal > 1.5


def test_without_repeats_the_files_controller_or_its_states_they_are_refused() -> None:
    with pytest.raises(RecordingError, match="run_0: free runs need repeats"):
        freely(recorded(count=1))
    sections = MACHINE.controllers[0].position_sections.copy()
    sections[0, :3] *= 0.8
    slower = replace(MACHINE.controllers[0], position_sections=sections)
    with pytest.raises(RecordingError, match="carriage: free runs need the controller that recorded"):
        freely(recorded(), replace(MACHINE, controllers=(slower,)))
    without = {name: Recording(one.channels, {**one.metadata, "initial": {}}) for name, one in recorded().items()}
    assert freely(without).runs  # commands show what states the controller had


def test_steps_of_the_plant_do_not_show() -> None:
    """A recording in steps eight times finer is met to a tenth of what the steps do."""
    recordings = recorded()
    free = freely(recordings)
    (here,) = free.runs
    fine = simulate(smooth(MACHINE, 8), recordings["run_0"], [DRAG])
    coarse = simulate(smooth(MACHINE), recordings["run_0"], [DRAG])
    rows = len(here.mean)
    here = replace(here, mean=np.column_stack([fine[channel] for channel in here.channels])[:rows])
    offset = np.zeros_like(free.offset)
    (found,) = replace(free, runs=(here.about(free.numbers, (offset, (DRAG,))),)).left([(offset, (DRAG,))])
    assert found is not None
    (left,) = found
    steps = here.scatter.whiten(np.column_stack([fine[channel] - coarse[channel] for channel in here.channels])[:rows])
    assert left @ left < 0.01 * (steps @ steps)
