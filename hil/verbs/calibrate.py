"""Geometric calibration: images of scans to the geometry of every exposure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from hil.verbs.errors import as_bench_errors
from hil.verbs.verb import KEPT, NOBODY, SCAN, Listener, argument, option

if TYPE_CHECKING:
    import numpy as np

    from hil.calibration.kinematic.geometric_model import GeometricModel
    from hil.calibration.use.from_phantom_scan import PhantomScan
    from hil.calibration.use.lookup_table import LookUp
    from hil.imaging.scan_folder import ImageScan
    from hil.machine import Machine

MOST_NAMED = 8
"""Exposures that a line names."""


@dataclass(frozen=True)
class CalibrateRequest:
    """A scan of the bullet phantom, or its folder, of a machine whose file says the nominal geometry."""

    machine: Machine
    scan: ImageScan | Path = argument(SCAN, "SCAN")
    out: Path | None = option("Look-up table to write (.npz).", "LOOKUP", "-o", "--out", is_needed=True)
    six: bool = option("Hold the source at nominal and fit six parameters only.", None, "--six", default=False)
    pixels: bool = option("Fit the pixels' aspect and skew (6.4) too, one for the whole scan.", None, "--pixels", default=False)
    at_standstill: bool = option(
        "Keep the poses at which the machine stood, averaged: a roadmapping grid.", None, "--standing", default=False
    )
    jobs: int = 1
    """Processes that look at images."""


@dataclass(frozen=True)
class CalibrateAnswer:
    """The geometry of every exposure."""

    exposures: int
    """Images."""
    used: int
    """Those that were used."""
    residual_um: np.ndarray
    """Per exposure, on the panel."""
    bullets: np.ndarray
    """Per exposure: bullets that were used."""
    axes: tuple[str, ...]
    """As in the LOOKUP file."""
    positions: np.ndarray
    """As in the LOOKUP file."""
    deviation: np.ndarray
    """As in the LOOKUP file."""
    sigma: np.ndarray
    """(N, 9) standard deviations."""
    aspect: float
    """Of the pixels."""
    skew: float
    """Of the pixels."""
    request: CalibrateRequest = field(metadata=KEPT, repr=False)
    found: PhantomScan = field(metadata=KEPT, repr=False)

    @property
    def over(self) -> tuple[np.ndarray, str, str]:
        """The axis that moved most: its positions, how they are labelled, its name."""
        import numpy as np

        axis = int(np.argmax(np.ptp(self.positions, axis=0)))
        along, name = self.positions[:, axis], self.axes[axis]
        is_angle = self.request.machine.units[axis].position == "rad"
        return (np.degrees(along), f"{name} [deg]", name) if is_angle else (along, f"{name} [m]", name)

    @property
    def lines(self) -> list[str]:
        """The answer in words."""
        import numpy as np

        from hil.imaging.geometry import DEVIATIONS

        fit, lines = self.found.fit, []
        if (known := self.found.pixel_sigma) is not None:
            lines.append(f"pixels: aspect {self.aspect:.5f}, sigma {known[0]:.5f}; skew {self.skew:.5f}, sigma {known[1]:.5f}")
        lines.append(
            f"{self.used} of {self.exposures} exposures, a median of {np.median(fit.used[fit.good]):.0f} bullets, residual"
            f" {float(np.nanmedian(self.residual_um)):.1f} um on the panel{'; the source held at nominal' if self.request.six else ''}"
        )
        if left := [str(k) for k in np.flatnonzero(~fit.good)]:
            more = f" and {len(left) - MOST_NAMED} others" if len(left) > MOST_NAMED else ""
            lines.append(f"  not used, they show too few bullets or something else: exposures {', '.join(left[:MOST_NAMED])}{more}")
        for k, name in enumerate(DEVIATIONS):
            values, sigma = 1e3 * self.deviation[:, k], 1e3 * float(np.median(self.sigma[:, k]))
            lines.append(f"  {name:10s} {values.min():8.3f} to {values.max():8.3f} {'mm' if k < 6 else 'mrad'}, sigma {sigma:.3f}")
        what = "poses" if self.request.at_standstill else "exposures"
        return [*lines, f"{self.request.out}: look-up table of {len(self.positions)} {what}"]


def answer(request: CalibrateRequest, listener: Listener = NOBODY) -> CalibrateAnswer:
    """Find the bullets in every image, fit the geometry, write the table where that is asked for; raises as `calibrate_phantom` does."""
    import numpy as np

    from hil.calibration.use.from_phantom_scan import calibrate_phantom_scan
    from hil.calibration.use.lookup_table import write_look_up
    from hil.files.writable import can_be_written
    from hil.imaging.scan_folder import ImageScan, read_scan

    can_be_written(request.out)
    scan = request.scan if isinstance(request.scan, ImageScan) else read_scan(Path(request.scan))
    options = {"six": request.six, "pixels": request.pixels, "at_standstill": request.at_standstill}
    with listener.working("bullets", len(scan)) as work:
        found = calibrate_phantom_scan(request.machine, scan, **options, jobs=request.jobs, progress=lambda done, total: work.done(done))
    table, fit = found.table, found.fit
    if request.out is not None:
        write_look_up(table, request.out)
    return CalibrateAnswer(
        len(fit.good),
        int(fit.good.sum()),
        1e6 * fit.residual_m,
        fit.used,
        table.axes,
        table.positions,
        table.deviation,
        np.sqrt(np.einsum("nii->ni", table.covariance)),
        found.panel.aspect,
        found.panel.skew,
        request,
        found,
    )


@as_bench_errors()
def calibrate_phantom(
    machine: Machine,
    scan: ImageScan | str | Path,
    *,
    six: bool = False,
    pixels: bool = False,
    at_standstill: bool = False,
    jobs: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> LookUp:
    """Find the geometry of every exposure of a scan, from images of the bullet phantom.

    Parameters
    ----------
    machine : Machine
        Whose file says the nominal geometry.
    scan : ImageScan, or its folder
    six : bool
        Hold the source at nominal and fit six parameters only.
    pixels : bool
        Fit the pixels' aspect and skew, too.
    at_standstill : bool
        Keep the poses at which the machine stood, averaged: a roadmapping grid.
    jobs : int
        Processes that look at images.
    progress : callable
        Told how many of how many images are done.

    Returns
    -------
    LookUp
        `.deviation` (N, 9) from the nominal geometry over `.positions` (N, axes), with `.covariance`; `.at(positions)` between them.

    Raises
    ------
    UnusableInputError
        Images that show no phantom, or a scan whose axis positions are not known.
    """
    from hil.imaging.scan_folder import ImageScan, read_scan

    folder = scan if isinstance(scan, ImageScan) else read_scan(Path(scan))
    request = CalibrateRequest(machine, folder, None, six, pixels, at_standstill, jobs)
    return answer(request, Listener(lambda done: progress(done, len(folder)))).found.table


@as_bench_errors()
def calibrate_model(machine: Machine, tables: Sequence[LookUp], *, frozen: Sequence[str] = ()) -> GeometricModel:
    """Fit a Denavit-Hartenberg model whose joints give way under gravity, which predicts the nine parameters of any pose.

    Parameters
    ----------
    machine : Machine
    tables : sequence of LookUp
        Of phantom-calibrated scans.
    frozen : sequence of str
        Parameters kept at nominal.

    Raises
    ------
    UnusableInputError
        A table is of another machine, or there is no such parameter.
    """
    from hil.calibration.kinematic.from_tables import model_from_tables

    return model_from_tables(machine, tables, frozen)[0]
