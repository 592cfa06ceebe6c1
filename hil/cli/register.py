"""The list of commands. Each module adds its own and imports what it needs when it runs, so that --help stays fast."""

from __future__ import annotations

import typer

from hil.cli import (
    answers,
    attend,
    bench,
    bus,
    calibrate,
    calibrate_chain,
    calibrate_consistency,
    calibrate_convergence,
    calibrate_data,
    calibrate_model,
    calibrate_spot,
    calibrate_tracker,
    commission,
    conformance,
    diagnose,
    doctor,
    faults,
    fleet,
    fleet_change,
    foxglove,
    geometry,
    identify,
    lpv,
    machine,
    observe,
    physics,
    plane,
    plot,
    reconstruct,
    roadmap,
    run,
    shape,
    shape_plant,
    story,
)


def commands(app: typer.Typer) -> None:
    """Add every command to the app, once."""
    if app.registered_commands:
        return
    story.register(app)
    app.add_typer(machine.app, name="machine")
    physics.register(app)
    plot.register(app)
    doctor.register(app)
    bus.register(app)
    commission.register(app)
    bench.register(app)
    attend.register(app)
    conformance.register(app)
    app.add_typer(run.app, name="run")
    answers.register(app)
    foxglove.register(app)
    identify.register(app)
    lpv.register(app)
    shape.register(app)
    shape_plant.register(app)
    observe.register(app)
    calibrate.register(app)
    calibrate_data.register(calibrate.app)
    calibrate_model.register(calibrate.app)
    calibrate_spot.register(calibrate.app)
    calibrate_tracker.register(calibrate.app)
    calibrate_consistency.register(calibrate.app)
    calibrate_chain.register(calibrate.app)
    calibrate_convergence.register(calibrate.app)
    roadmap.register(app)
    geometry.register(app)
    reconstruct.register(app)
    plane.register(app)
    diagnose.register(app)
    app.add_typer(faults.app, name="faults")
    fleet_change.register(fleet.app)
    app.add_typer(fleet.app, name="fleet")
