"""Records of a periodic experiment as the estimators take them: arrays over realisations, experiments and samples.

The plant's input is the command that the loop computed (row k of `command`), not the measured current: the command is known without noise
and equals w - C y exactly, so the indirect method's ratio of G_wy and G_wu holds exactly. The drive applies command k at SYNC k+1 and holds
it until k+2, so the response from command to a sampled output is G(z) = z^-1 (C (zI - A_d)^-1 B_d + D), with A_d, B_d the zero-order-hold
discretisation of the plant and z = exp(i 2 pi f / f_s). The measured current at row k reflects command k-1, so from the measured current
the factor z^-1 is absent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypedDict

import numpy as np

from hil.errors import IdentificationError

PERIODICITY_TOLERANCE = 1e-6  # of the excitation's peak; a file that rounds to single precision passes, a shifted period does not
EXCITED_SHARE = 1e-6  # a line with less than this share of the largest amplitude counts as not excited


@dataclass(frozen=True)
class PeriodicRecords:
    """M realisations of E experiments with one periodic excitation design, at one pose, all sampled alike.

    Attributes
    ----------
    outputs : (M, E, T, n_y) plant outputs; NaN marks missing samples.
    inputs : (M, E, T, n_u) plant inputs, or None in open loop, where the excitation is the input.
    excitation : (M, E, T, n_u) w, added to the feedback's command.
    period_samples : samples N of one period.
    settle_periods : leading periods that still hold the transient; averaging leaves them out, local methods use them unless a jog grows in.
    sample_rate_Hz : f_s.
    lines : (L,) excited lines, multiples of f_s / N; neither 0 nor N/2.
    output_names, input_names, output_units, input_units : labels in the arrays' order.
    pose : (n_theta,) scheduling parameters of the pose, or empty.
    unexcited_reference_lines : lines a jog occupies; no detection lines.
    """

    outputs: np.ndarray
    inputs: np.ndarray | None
    excitation: np.ndarray
    period_samples: int
    settle_periods: int
    sample_rate_Hz: float
    lines: np.ndarray
    output_names: tuple[str, ...]
    input_names: tuple[str, ...]
    output_units: tuple[str, ...]
    input_units: tuple[str, ...]
    pose: tuple[float, ...] = ()
    unexcited_reference_lines: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def realisations(self) -> int:
        """Number of realisations M."""
        count: int = self.outputs.shape[0]
        return count

    @property
    def experiments(self) -> int:
        """Number of experiments E of each realisation."""
        count: int = self.outputs.shape[1]
        return count

    @property
    def periods(self) -> int:
        """Whole periods in each record, the settling ones included."""
        count: int = self.outputs.shape[2] // self.period_samples
        return count

    @property
    def n_outputs(self) -> int:
        """Number of plant outputs."""
        count: int = self.outputs.shape[3]
        return count

    @property
    def n_inputs(self) -> int:
        """Number of plant inputs."""
        count: int = self.excitation.shape[3]
        return count

    @property
    def closed_loop_outputs(self) -> np.ndarray:
        """Closed-loop outputs z = [y; u] of (3.7), (M, E, T, n_z); y alone in open loop."""
        if self.inputs is None:
            return self.outputs
        return np.concatenate((self.outputs, self.inputs), axis=-1)

    @property
    def frequencies_Hz(self) -> np.ndarray:
        """Frequencies (L,) of the excited lines."""
        return self.lines * self.sample_rate_Hz / self.period_samples

    def __post_init__(self) -> None:
        """Check that arrays and labels fit together."""
        realisations, experiments, samples, n_outputs = self.outputs.shape
        expected = (realisations, experiments, samples, len(self.input_names))
        for name, array in (("excitation", self.excitation), ("inputs", self.inputs)):
            if array is not None and array.shape != expected:
                raise IdentificationError(f"{name} has shape {array.shape}; outputs and names ask for {expected}")
        if len(self.output_names) != n_outputs:
            raise IdentificationError(f"{len(self.output_names)} output names for {n_outputs} outputs")
        if samples < self.period_samples:
            raise IdentificationError(f"records of {samples} samples hold no whole period of {self.period_samples}")
        if self.settle_periods >= self.periods:
            raise IdentificationError(f"{self.periods} periods recorded, {self.settle_periods} of them to settle: none is left")
        if len(self.lines) == 0:
            raise IdentificationError("no excited lines: the excitation is zero or its lines are not given")


def periodic_records(
    outputs: np.ndarray,
    inputs: np.ndarray | None,
    excitation: np.ndarray,
    *,
    period_samples: int,
    sample_rate_Hz: float,
    lines: np.ndarray | None = None,
    settle_periods: int = 0,
    output_names: tuple[str, ...] | None = None,
    input_names: tuple[str, ...] | None = None,
    output_units: tuple[str, ...] | None = None,
    input_units: tuple[str, ...] | None = None,
    pose: tuple[float, ...] = (),
    unexcited_reference_lines: tuple[int, ...] = (),
    notes: tuple[str, ...] = (),
) -> PeriodicRecords:
    """Build `PeriodicRecords` from arrays (M, E, T, channels), checking what the estimators rely on.

    Excited lines are found from the excitation where they are not given. Samples beyond the last whole period are left out.

    Raises
    ------
    IdentificationError
        Shapes that do not fit, an excitation that does not repeat with `period_samples`, an input that is not excited.
    """
    outputs, excitation = np.asarray(outputs, float), np.asarray(excitation, float)
    if outputs.ndim != 4 or excitation.ndim != 4:
        raise IdentificationError(
            f"outputs and excitation are (realisations, experiments, samples, channels), not {outputs.shape}, {excitation.shape}"
        )
    n_outputs, n_inputs = outputs.shape[3], excitation.shape[3]
    whole = excitation.shape[2] // period_samples * period_samples
    if whole == 0:
        raise IdentificationError(f"records of {excitation.shape[2]} samples hold no whole period of {period_samples}")
    excitation = excitation[:, :, :whole]
    input_names = input_names or tuple(f"u{i + 1}" for i in range(n_inputs))
    _check_periodicity(excitation, period_samples, input_names)
    excited = _excited_lines(excitation, period_samples)
    if lines is None:
        chosen = excited
    else:
        chosen = np.unique(np.asarray(lines, int))
        silent = np.setdiff1d(chosen, excited)
        if len(silent):
            raise IdentificationError(f"line {silent[0]} is listed as excited and has no excitation ({len(silent)} such lines)")
    if period_samples % 2 == 0 and np.any(chosen == period_samples // 2):
        notes = (*notes, f"line {period_samples // 2} is the Nyquist line, real by definition: left out")
    chosen = chosen[(chosen > 0) & (2 * chosen < period_samples)]
    _check_every_input(excitation, period_samples, chosen, input_names)
    return PeriodicRecords(
        outputs=outputs[:, :, :whole],
        inputs=None if inputs is None else np.asarray(inputs, float)[:, :, :whole],
        excitation=excitation,
        period_samples=int(period_samples),
        settle_periods=int(settle_periods),
        sample_rate_Hz=float(sample_rate_Hz),
        lines=chosen,
        output_names=output_names or tuple(f"y{i + 1}" for i in range(n_outputs)),
        input_names=input_names,
        output_units=output_units or ("",) * n_outputs,
        input_units=input_units or ("",) * n_inputs,
        pose=pose,
        unexcited_reference_lines=unexcited_reference_lines,
        notes=notes,
    )


def _check_periodicity(excitation: np.ndarray, period_samples: int, names: tuple[str, ...]) -> None:
    if np.isnan(excitation).any():
        raise IdentificationError("the excitation has missing samples; it is what the loop sent and must be complete")
    peak = np.abs(excitation).max()
    if peak == 0.0:
        raise IdentificationError("the excitation is zero in every record")
    if excitation.shape[2] == period_samples:
        return
    difference = np.abs(excitation[:, :, period_samples:] - excitation[:, :, :-period_samples]).max(axis=(0, 1, 2))
    worst = int(difference.argmax())
    if difference[worst] > PERIODICITY_TOLERANCE * peak:
        raise IdentificationError(
            f"excitation of {names[worst]} does not repeat every {period_samples} samples:"
            f" it differs by {difference[worst]:.3g} from one period to the next; check period_samples"
        )


def _excited_lines(excitation: np.ndarray, period_samples: int) -> np.ndarray:
    spectrum = np.abs(np.fft.rfft(excitation[:, :, :period_samples], axis=2)).max(axis=(0, 1, 3))
    spectrum[0] = 0.0
    return np.flatnonzero(spectrum > EXCITED_SHARE * spectrum.max())


def _check_every_input(excitation: np.ndarray, period_samples: int, lines: np.ndarray, names: tuple[str, ...]) -> None:
    spectrum = np.abs(np.fft.rfft(excitation[:, :, :period_samples], axis=2)[:, :, lines])
    largest = spectrum.max(axis=(0, 1, 2))
    for name, value in zip(names, largest, strict=True):
        if value <= EXCITED_SHARE * spectrum.max():
            others = ", ".join(n for n, v in zip(names, largest, strict=True) if v > EXCITED_SHARE * spectrum.max())
            raise IdentificationError(f"input {name} is not excited in any record; excite it, or identify the inputs {others} only")


class Labels(TypedDict):
    """What a frequency response takes over from its records, by the names of its fields."""

    output_names: tuple[str, ...]
    input_names: tuple[str, ...]
    output_units: tuple[str, ...]
    input_units: tuple[str, ...]
    sample_rate_Hz: float
    period_samples: int
    pose: tuple[float, ...]


def labels(records: PeriodicRecords) -> Labels:
    """Return names, units and sampling that a result takes over from its records."""
    return {
        "output_names": records.output_names,
        "input_names": records.input_names,
        "output_units": records.output_units,
        "input_units": records.input_units,
        "sample_rate_Hz": records.sample_rate_Hz,
        "period_samples": records.period_samples,
        "pose": records.pose,
    }
