"""The guided commissioning: each step says what it will do, does it, and shows why it has passed or failed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.console import verdicts
from hil.console.commands import Answers, Command, Order, on_the_bus, recordings_of, run_command
from hil.console.facts import Facts
from hil.console.forms import Field, Form, forms_of
from hil.errors import UnusableInputError

SEEN_BEFORE = {"static": ("home",), "identify": ("home",), "observe": ("identify", "static")}
"""Steps that must have passed before."""
FROM_FILE, FROM_RESPONSE = "the machine file", "the identified response"


@dataclass(frozen=True)
class Step:
    """One step.

    Attributes
    ----------
    name, title : str
    does : tuple of str
        What it will do, a sentence each.
    fields : tuple of Field
    experiment : str
        The kind of experiment whose plan is shown before it runs; "" where none is planned.
    order : callable
        From a filled form to the work.
    moves : bool
    mend : str
        What to do where its answer is bad, a sentence.
    """

    name: str
    title: str
    does: tuple[str, ...]
    fields: tuple[Field, ...]
    experiment: str
    order: Callable[[Mapping[str, Any]], Order]
    moves: bool
    mend: str


def steps_of(facts: Facts, folder: Path) -> dict[str, Step]:
    """Return the steps for a machine, by name, in order."""
    forms = forms_of(facts)
    steps = (
        _check(facts),
        _scan(facts),
        _home(facts),
        _static(facts, folder, forms["static"]),
        _identify(facts, folder, forms["multisine"]),
        _shape(facts, folder),
        _observe(facts, folder, forms["scan"]),
    )
    return {step.name: step for step in steps}


def missing_before(name: str, passed: Mapping[str, bool], values: Mapping[str, Any]) -> str:
    """Return which earlier step has yet to pass before this one with a form filled so, in words; "" where none has."""
    needed = ("identify",) if name == "shape" and values.get("source") == FROM_RESPONSE else SEEN_BEFORE.get(name, ())
    missing = [step for step in needed if not passed.get(step)]
    return f"first {' and '.join(missing)}: {name} builds on what {'it shows' if len(missing) == 1 else 'they show'}" if missing else ""


def _check(facts: Facts) -> Step:
    commands = (Command("check", lambda answers: ["machine", "check", facts.name]),)
    return Step(
        "check",
        "Check the file",
        (
            "Computes from the machine file alone: natural frequencies and closed-loop margins over the poses, holding efforts, bus load.",
            "Nothing is sent, nothing moves.",
        ),
        (),
        "",
        lambda values: Order("Check the file", commands, step="check", judge=verdicts.check),
        moves=False,
        mend="Change in the machine file what the findings below name: a gain, a limit, a mass, a bus rate.",
    )


def _scan(facts: Facts) -> Step:
    expected = {node.node_id: node.name for node in facts.settings.nodes}
    if facts.is_lockstep:
        does: tuple[str, ...] = ("On lockstep: loop and emulated machine share one process, so that there is no wire to look at.",)
        commands: tuple[Command, ...] = ()
    else:
        names = ", ".join(f"{number} ({name})" for number, name in expected.items())
        does = (f"Asks every node on {facts.bus} what it is; the file expects {names}.", "No drive is enabled, nothing moves.")
        rate = str(facts.settings.bitrate_bit_s)
        commands = (Command("scan", lambda answers: ["scan-bus", "--bus", facts.bus, "--bitrate", rate]),)
    return Step(
        "scan",
        "Look at the bus",
        does,
        (),
        "",
        lambda values: Order("Look at the bus", commands, step="scan", judge=lambda answers: verdicts.scan(answers, expected)),
        moves=False,
        mend="Switch the named node on, see that its number is the one in the file, and that no other master is on this bus.",
    )


def _home(facts: Facts) -> Step:
    commands = (Command("home", lambda answers: ["home", *on_the_bus(facts), "--tell"], moves=True),)
    return Step(
        "home",
        "First move and homing",
        (
            "Boots and configures the nodes, then takes one axis after the other: enables its drive, opens its brake, pushes it a little, "
            "homes it, compares its encoders, closes its brake.",
            *(axis.homing + "." for axis in facts.axes),
        ),
        (),
        "",
        lambda values: Order("First move and homing", commands, step="home", judge=verdicts.home),
        moves=True,
        mend="Compare what is named with the machine: sign and resolution of the encoder in its file, its plug, its mounting.",
    )


def _static(facts: Facts, folder: Path, form: Form) -> Step:
    def order(values: Mapping[str, Any]) -> Order:
        command = run_command(facts, folder, "still", form.text(facts, values))
        return Order("At rest", (command,), step="static", judge=verdicts.static)

    return Step(
        "static",
        "At rest",
        (
            "Homes, goes to the pose, holds it and records: noise, drift and the effort that holds.",
            "The brakes are open and the drives hold meanwhile; at its end the brakes are closed and proven.",
        ),
        form.fields,
        "static",
        order,
        moves=True,
        mend="See that nothing touches the arm, that its brake opens fully, and that the named sensor sits and is wired as the file says.",
    )


def _identify(facts: Facts, folder: Path, form: Form) -> Step:
    def order(values: Mapping[str, Any]) -> Order:
        run = run_command(facts, folder, "multisine", form.text(facts, values))

        def identify(answers: Answers) -> list[str]:
            figure = drawn(folder, "identified")
            return ["identify", *recordings_of(answers["multisine"]), "-o", str(folder / "identified.frf.npz"), *figure]

        commands = (run, Command("identify", identify))
        return Order("Identify", commands, step="identify", judge=verdicts.identify, made=made_of("identified"))

    return Step(
        "identify",
        "Identify",
        (
            "Shakes the axes with a multisine under a slow jog: one recording for each experiment and draw of phases, homing before each.",
            "Then estimates frequency responses with their covariances.",
        ),
        form.fields,
        "multisine",
        order,
        moves=True,
        mend="See that the named sensor sits and is wired as the file says; an excitation that is too strong can be made smaller here.",
    )


def _shape(facts: Facts, folder: Path) -> Step:
    axis = Field("axis", "Axis", facts.axes[0].name, choices=tuple(each.name for each in facts.axes))
    source = Field("source", "Designed from", FROM_FILE, choices=(FROM_FILE, FROM_RESPONSE))

    def order(values: Mapping[str, Any]) -> Order:
        chosen = str(axis.read(values))
        name, shaper = f"{chosen}-shaper", folder / f"{chosen}.shaper.npz"
        arguments = ["shape", facts.name, "--axis", chosen, "-o", str(shaper), *drawn(folder, name)]
        if source.read(values) == FROM_RESPONSE:
            arguments += ["--frf", str(folder / "identified.frf.npz")]
        command = Command("shape", lambda answers: arguments)
        return Order(f"Shape {chosen}", (command,), step="shape", judge=verdicts.shape, made=made_of(name))

    return Step(
        "shape",
        "Shape the reference",
        (
            "Designs delay filters that cancel the lightly damped poles of the closed loop, and judges them.",
            "Nothing is sent, nothing moves.",
        ),
        (axis, source),
        "",
        order,
        moves=False,
        mend="Choose another axis or design from the identified response, which knows the resonances of the machine itself.",
    )


def _observe(facts: Facts, folder: Path, form: Form) -> Step:
    def order(values: Mapping[str, Any]) -> Order:
        scan = run_command(facts, folder, "observed", form.text(facts, values))

        def observe(answers: Answers) -> list[str]:
            (recording,) = recordings_of(answers["observed"])
            measured = [argument for each in recordings_of(answers["multisine"]) for argument in ("--multisine", each)]
            measured += [argument for each in recordings_of(answers["still"]) for argument in ("--standing", each)]
            written = ["-o", str(folder / "observed.est.npz"), "--save-design", str(folder / "machine.observer.npz")]
            return ["observe", facts.name, recording, *measured, *written, *drawn(folder, "observer")]

        commands = (scan, Command("observe", observe))
        return Order("Observe", commands, step="observe", judge=verdicts.observe, made=made_of("observer"))

    return Step(
        "observe",
        "Observe",
        (
            "Makes a scan, designs the observer from the recordings of the steps before, and replays it over the scan.",
            "Its innovations must fit the noise that it expects.",
        ),
        form.fields,
        "scan",
        order,
        moves=True,
        mend="Record at rest again (step 4) and excite again (step 5), so that noise and model are those of the machine as it is now.",
    )


def drawn(folder: Path, name: str) -> list[str]:
    """Return the options for a picture, which the page shows, and for a report, which it links."""
    return ["--figure", str(folder / f"{name}.png"), "--page", str(folder / f"{name}.html")]


def made_of(name: str) -> tuple[str, ...]:
    """Return the files that `drawn` asks for."""
    return f"{name}.html", f"{name}.png"


def step_named(steps: Mapping[str, Step], name: object) -> Step:
    """Return a step.

    Raises
    ------
    UnusableInputError
        There is none of this name.
    """
    if not isinstance(name, str) or name not in steps:
        raise UnusableInputError(f"no step {str(name)[:40]}; there is {', '.join(steps)}")
    return steps[name]
