"""isocenter attend: a machine that tells its state from connection on, and is jogged by hand while orders come."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.options import BusOption, ImuOption, IoOption, MachineOption, PoseOption, RealTimeOption, load, parse_pose
from hil.terminal.output import Answer, JsonOption
from hil.terminal.progress import working

if TYPE_CHECKING:
    import numpy as np

    from hil.bench.bench import Bench
    from hil.bench.options import BenchOptions
    from hil.machine import Machine
    from hil.observing.live import LiveObserver

TellOption = Annotated[
    bool,
    typer.Option(
        "--tell", help="Tell the state as `isocenter attend` does, while the machine homes, goes to the start and closes its brakes."
    ),
]


def telling(bench: Bench, wanted: bool) -> contextlib.AbstractContextManager[object]:
    """Return what tells a bench's state for the length of a block, where that is wanted."""
    from hil.bench.telling import Teller

    return Teller(bench, rows=False) if wanted else contextlib.nullcontext()


@contextlib.contextmanager
def opened(
    machine: Machine, options: BenchOptions, start_pose: np.ndarray | None = None, observer: LiveObserver | None = None
) -> Iterator[Bench]:
    """Open a bench as `hil.bench.open.open_bench` does, and tell meanwhile that it starts and what is compiled."""
    from hil.bench.open import open_bench

    with contextlib.ExitStack() as stack:
        with working(f"starting {machine.name}"):
            bench = stack.enter_context(open_bench(machine, options, start_pose, observer))
        yield bench


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="Stay connected: state in lines, jog by hand.",
        help="Stay connected to a machine, as the page of `isocenter bench` does: ten times a second a line `state {...}` tells position,"
        " effort, brake, drive and temperature of every axis, in SI. Nothing moves before a line at the terminal orders it: home; jog AXIS"
        " SPEED (rad/s or m/s), renewed every 0.1 s for as long as the axis is to move (it rests 0.35 s after the last); still; end."
        " Ctrl-C stops as in a run."
        "\n\nExample:  isocenter attend -m carm -b lockstep:",
    )(attend)


def attend(
    machine_name: MachineOption,
    bus: BusOption,
    pose: PoseOption = "",
    imu: ImuOption = "",
    io: IoOption = "",
    real_time: RealTimeOption = True,
    rows: Annotated[bool, typer.Option("--rows", help="Every row, too, in lines `rows {...}`: base64 of float64.")] = False,
    json_to: JsonOption = None,
) -> None:
    """Tell the state until the end is ordered."""
    from hil.bench.attendant import TypedLines
    from hil.bench.attended import Attended
    from hil.bench.options import BenchOptions
    from hil.bench.telling import Teller
    from hil.experiments.plan import pose_array

    machine = load(machine_name)
    answer = Answer(json_to)
    start = pose_array(machine, parse_pose(pose, machine))
    options = BenchOptions(bus, imu, io, real_time=real_time, paced=True)
    with opened(machine, options, start) as bench, Teller(bench, rows) as teller:
        Attended(bench, TypedLines().take, teller.shown).serve()
        emulated, stands = bench.emulated, dict(zip(machine.axes, bench.pose.tolist(), strict=True))
    answer.write({"machine": machine.name, "bus": bus, "emulated": emulated, "position": stands})
