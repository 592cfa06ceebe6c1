"""A machine that somebody attends to: its state is told from the start on, and an axis is jogged by hand while orders are renewed.

Nothing moves before it is ordered. Orders are lines: `home`; `jog AXIS SPEED` [rad/s or m/s], renewed while a button is held; `still`;
`end`. Everything that stops a run stops this: limits, sensors, hold-to-run, door, the supervisor, a lost device, a signal.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.interface import Sample
from hil.bench.bench import Bench
from hil.bench.hand_jog import HandJog
from hil.bench.told_state import HOLDING, HOMING, LETTING_GO, READY, TAKING_HOLD, WATCHING
from hil.errors import LoopAbortedError
from hil.experiments.safety import gravity_feedforward

HOLD_S = 8.0
"""Time without an order after which the brakes are closed: long enough to press the next button, short enough for warm motors."""

LEG_S = 1
"""Length of the legs that a jog consists of, in whole seconds; between two of them it may end."""

Take = Callable[[], list[str]]


@dataclass
class Shown:
    """What is shown of the machine, overwritten in every tick.

    Attributes
    ----------
    doing : str
        Any of the states above.
    says : str
        Why an order is not followed, in words; "" where all are.
    sample : Sample
    put : callable
        Takes a row (width,), to be copied at once and left as it is; its time begins anew with every leg.
    """

    doing: str
    says: str
    sample: Sample
    put: Callable[[np.ndarray], None]


class _Leg:
    """One second of a jog, of which a few rows are known ahead; it is the loop's sink, too, by which it goes on."""

    keeps = False

    def __init__(self, bench: Bench, jog: HandJog, take: Callable[[], None], shown: Shown) -> None:
        machine = bench.machine
        rows = round(LEG_S * machine.sample_rate_Hz)
        self.reference = np.tile(jog.position, (rows, 1))
        self.reference_raw, self.excitation = self.reference, np.zeros_like(self.reference)
        self.feedforward = gravity_feedforward(machine, bench.model, self.reference)
        self._bench, self._jog, self._take, self._shown = bench, jog, take, shown
        self._known, self._ahead = 0, machine.overrun_ticks + 2  # lost ticks that are bridged find a row
        self._lead(-1)

    def put(self, row: np.ndarray) -> None:
        """Show a row, hear the orders, and go on by as many rows as ticks have passed."""
        self._shown.put(row)
        self._take()
        self._lead(round(row[0] * self._bench.machine.sample_rate_Hz))

    def _lead(self, at: int) -> None:
        while self._known < min(at + 1 + self._ahead, len(self.reference)):
            self.reference[self._known] = self._jog.step()
            if self.feedforward is not None:
                row = gravity_feedforward(self._bench.machine, self._bench.model, self.reference[self._known][None, :])
                self.feedforward[self._known] = 0.0 if row is None else row[0]
            self._known += 1


class _Nothing:
    """The signals of an axis that nothing is asked of."""

    feedforward = None

    def __init__(self, axes: int) -> None:
        self.reference = self.reference_raw = np.full((1, axes), np.nan)
        self.excitation = np.zeros((1, axes))


class Attended:
    """Attends to a bench at rest, in one session.

    Parameters
    ----------
    bench : Bench
        Of a machine whose drives follow efforts, velocities or positions in every tick.
    take : callable
        Returns the lines that came since the last call; never waits.
    shown : Shown
        Is kept up to date.
    """

    def __init__(self, bench: Bench, take: Take, shown: Shown) -> None:
        self._bench, self._lines, self._shown = bench, take, shown
        self._jog = HandJog(bench.machine.limits, 1.0 / bench.machine.sample_rate_Hz)
        self._homed = self._ends = self._asked_home = False
        self._row = np.full(bench.loop.layout.width, np.nan)
        self._nothing = _Nothing(len(bench.machine.axes))

    def serve(self) -> None:
        """Serve until `end` is ordered.

        Raises
        ------
        LoopAbortedError, DriverError
            The motors were stopped, by whatever stops a run.
        """
        with self._bench.session(homes=False):
            self._bench.see_pose()
            while not self._ends:
                self._take()
                if self._asked_home:
                    self._home()
                elif self._jog.held:
                    self._hold_and_jog()
                self._rest()

    def _take(self) -> None:
        """Hear the orders that have come; the newest counts."""
        for line in self._lines():
            match line.split():
                case ["home"]:
                    self._asked_home = True
                case ["jog", axis, speed] if axis in self._bench.machine.axes and _is_speed(speed):
                    self._jog.order(self._bench.machine.axis_index(axis), float(speed))
                case ["still"]:
                    self._jog.let_go()
                    self._shown.says = ""
                case ["end"]:
                    self._ends = True
                    self._jog.let_go()
                case _:
                    self._shown.says = f"{line[:40]!r} is no order: home, jog AXIS SPEED, still, end"

    def _may_move(self) -> bool:
        """Whether hold-to-run, door and I/O permit motion; says why not."""
        self._shown.says = self._bench.wiring.link.refusal()
        return not self._shown.says

    def _home(self) -> None:
        self._asked_home = False
        if self._may_move():
            self._shown.doing = HOMING
            self._bench.home()
            self._bench.see_pose()
            self._homed = True
            self._forget()

    def _hold_and_jog(self) -> None:
        """Take hold, follow the orders until none has come for a while, and close the brakes again."""
        if not self._homed:
            self._shown.says = "home first: where an axis stands, and which way it goes, is not known yet"
            self._jog.let_go()
            return
        if not self._may_move():
            self._jog.let_go()
            return
        bench, jog, link = self._bench, self._jog, self._bench.wiring.link
        if by_themselves := bench.by_themselves():
            self._shown.says = f"{', '.join(by_themselves)}: in profile position mode a drive goes to poses by itself: `isocenter move`"
            jog.let_go()
            return
        self._shown.doing = TAKING_HOLD
        bench.take_hold()
        link.watch.lead()
        jog.begin(bench.pose)
        self._forget()
        self._shown.doing, idle_since_s = HOLDING, time.monotonic()
        while time.monotonic() - idle_since_s < HOLD_S and not (self._ends and jog.rests):
            leg = _Leg(bench, jog, self._take, self._shown)
            bench.loop.run(leg, leg)
            if jog.held or not jog.rests:
                idle_since_s = time.monotonic()
        self._shown.doing = LETTING_GO
        bench.pose = jog.position.copy()
        link.close_brakes(bench.holding())
        bench.see_pose()
        self._forget()

    def _forget(self) -> None:
        """Forget orders to move that came meanwhile: whoever still holds the button renews it."""
        self._take()
        self._jog.let_go()
        self._asked_home = False

    def _rest(self) -> None:
        """Make one tick with the brakes closed and the drives disabled, its thermometers judged."""
        bench = self._bench
        self._shown.doing = READY if self._homed else WATCHING
        sample = bench.wiring.link.exchange(bench.wiring.link.zeros)
        if reason := bench.judges(sample):
            bench.wiring.link.stop()
            raise LoopAbortedError(f"{reason}; {bench.wiring.link.outcome}")
        bench.loop.layout.fill(self._row, 0, sample, self._nothing, bench.wiring.link.zeros, (sample.lateness_s, math.nan, math.nan))
        self._shown.put(self._row)


def _is_speed(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
