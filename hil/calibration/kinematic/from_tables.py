"""From the tables of phantom-calibrated scans to a kinematic model."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from hil.calibration.kinematic.flexible import FlexibleFit, fit_flexible, joined
from hil.calibration.kinematic.geometric_model import GeometricModel
from hil.calibration.kinematic.nominal_chain import nominal_chain
from hil.calibration.use.lookup_table import LookUp
from hil.errors import UnusableInputError
from hil.imaging.nominal import nominal_beam
from hil.machine import Machine


def model_from_tables(
    machine: Machine, tables: Sequence[LookUp], frozen: Collection[str] = (), scans: Sequence[str] = ()
) -> tuple[GeometricModel, FlexibleFit]:
    """Fit a Denavit-Hartenberg model whose joints give way under gravity.

    Parameters
    ----------
    machine : Machine
        Whose file says the nominal geometry.
    tables : sequence of LookUp
    frozen : collection of str
        Parameters kept at nominal.
    scans : sequence of str
        What the model's notes call the tables.

    Raises
    ------
    UnusableInputError
        No table, tables of other machines or axes, or no such parameter.
    """
    if not tables:
        raise UnusableInputError("no tables given: a model is fitted to those of calibrate phantom")
    for table in tables:
        table.require(machine)
    start = nominal_chain(machine)
    if unknown := sorted(set(frozen) - set(start.names)):
        raise UnusableInputError(f"{', '.join(unknown)}: no such parameter; {machine.name} has {', '.join(start.names)}")
    every = joined(tables)
    measured = nominal_beam(machine, every.positions).moved(every.deviation)
    fit = fit_flexible(start, every.positions, measured, every.covariance, frozen)
    notes = {
        "machine": machine.name,
        "hash": machine.hash,
        "scans": list(scans),
        "six": bool(every.notes.get("six")),
        "rank": fit.rank,
        "null": [str(each) for each in fit.null],
        "frozen": list(fit.frozen),
    }
    return GeometricModel(machine, fit.model, fit.covariance, notes), fit
