"""Ticks by the SYNC of another device: the bench sends none, and follows.

A SYNC does not tell who sent it, but its time does: the producer's come a period apart. One that comes much earlier is a second
producer's. When none comes for longer than the machine file bridges, the run ends, and the bench sends SYNC itself until the machine is at
rest: drives take the commands of a stop at a SYNC.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import can

from drivers.canopen.network import PolledNetwork, is_data_frame, receive_frame, send_frame
from drivers.canopen.one_master import OneMaster
from drivers.errors import BusTimeoutError
from drivers.settings import BusSettings

EARLY_SHARE = 0.25
"""Share of a period by which a SYNC may come before it is expected; what two producers send differs by more in one of two SYNCs."""
LATER_WEIGHT, EARLIER_WEIGHT = 0.05, 0.5
"""Shares of a SYNC's lateness by which the next is expected later, or earlier. A late one was held up on its way or read late, which says
little of the producer's clock; nothing comes before it was sent."""
QUEUED_FRAMES = 4096  # most frames read at once: somebody who floods the bus must not keep the loop from its tick
LISTENING_TICKS = 128
"""Periods for which the bench listens before it starts a machine."""
RATE_TOLERANCE = 0.01
"""Share by which the producer's mean period may differ from the sample period. Over the listening, a host that reads the last SYNC a period
late makes as much; the nearest rates in use, 250 and 256 Hz, differ by more than twice that."""


class ForeignSync:
    """Waits for each SYNC of the producer that the machine file names.

    Parameters
    ----------
    network : PolledNetwork
    settings : BusSettings
    one_master : OneMaster
        Is told of SYNCs that come too early.
    """

    def __init__(self, network: PolledNetwork, settings: BusSettings, one_master: OneMaster) -> None:
        self._network, self._bus, self._clock = network, network.can_bus, network.clock
        self._one_master = one_master
        self._producer, self._can_id = settings.sync_producer, settings.sync_cob_id
        self.who = f"{settings.sync_producer} (bus.sync_producer)"
        self._period_s = settings.sync_period_s
        self._most_ticks = settings.overrun_ticks
        self._due_s = math.nan  # of the next SYNC; unknown until one has come
        self._echo_due = False  # the echo of a SYNC that the bench has sent is still to come
        self._lost = False  # the producer is silent: the bench sends SYNC
        self._behind: deque[can.Message] = deque()  # frames that came behind the newest SYNC
        self.left_out = 0  # SYNCs that did not come, and were bridged
        self._heard = 0  # SYNCs since the last tick
        self._first_s = self._last_s = math.nan
        self._listened = 0
        network.subscribe(self._can_id, self._hear)

    def restart(self) -> None:
        """Expect the next SYNC at any time."""
        self._due_s, self._heard = math.nan, 0
        self._behind.clear()

    def check_rate(self) -> None:
        """Listen to the producer's SYNCs, and compare their rate with the machine's.

        Raises
        ------
        BusTimeoutError
            None has come, or they come at another rate than the machine's.
        """
        self._listened, self._lost = 0, False
        self._network.pump_for(LISTENING_TICKS * self._period_s)
        where = f"{self.who}: on {self._bus.channel_info}"
        if self._listened < 2:
            raise BusTimeoutError(f"{where} nobody sends SYNC ({self._can_id:03X}h), and with a sync_producer the bench does not; start it")
        period_s = (self._last_s - self._first_s) / (self._listened - 1)
        if abs(period_s / self._period_s - 1.0) > RATE_TOLERANCE:
            raise BusTimeoutError(
                f"{where} SYNC comes every {1e3 * period_s:.3f} ms, timing.sample_rate makes it {1e3 * self._period_s:.3f} ms"
            )

    @property
    def ahead(self) -> bool:
        """Whether the next SYNC has come already: what comes now does not answer the last one."""
        return self._heard > 0

    def wait(self, drop: Callable[[can.Message], None], shortly_before: Callable[[], object] | None = None) -> float:
        """Wait for the next SYNC; hand all frames before it to `drop`, and return its lateness [s].

        `shortly_before` is called before a SYNC that has not come by then.

        Raises
        ------
        BusTimeoutError
            The producer is silent for longer than is bridged. From then on the bench sends SYNC.
        BusError
            The bus failed.
        """
        clock = self._clock
        due_s = self._due_s if math.isfinite(self._due_s) else clock.now() + self._period_s
        patience_s = 0.5 * self._period_s if self._lost else self._most_ticks * self._period_s + EARLY_SHARE * self._period_s
        if not clock.await_tick(lambda timeout_s: self._comes(timeout_s, drop), due_s, patience_s, shortly_before):
            if not self._lost:
                self._lost = True
                self._due_s = math.nan
                silent_s = clock.now() - due_s + self._period_s
                raise BusTimeoutError(f"{self.who}: no SYNC for {silent_s:.3f} s; timing.overrun_ticks bridges {self._most_ticks} ticks")
            self._echo_due = self._network.echoes
            send_frame(self._bus, can.Message(arbitration_id=self._can_id, is_extended_id=False, data=b""))
            self._due_s = due_s + self._period_s if due_s > clock.now() - self._period_s else math.nan
            return max(0.0, clock.now() - due_s)
        now_s = clock.now()
        self._read_on(drop)
        return self._follow(now_s - due_s, due_s)

    def take(self, timeout_s: float) -> can.Message | None:
        """Return the next frame behind the SYNC, None when none comes in time.

        Raises
        ------
        BusError
            The bus failed.
        """
        return self._behind.popleft() if self._behind else receive_frame(self._bus, timeout_s)

    def _follow(self, late_s: float, due_s: float) -> float:
        """Count the ticks that were lost, and expect the next SYNC; return this one's lateness [s]."""
        heard, self._heard, period_s = self._heard, 0, self._period_s
        if self._lost:  # it is back, at any phase: the bench's own SYNCs end
            self._due_s = due_s + late_s + period_s
            self._clock.lose(heard - 1)
            return 0.0
        late_s -= (heard - 1) * period_s
        if not math.isfinite(self._due_s):
            self._due_s = due_s + late_s + heard * period_s
            return 0.0
        silent = max(0, int(late_s / period_s))
        phase_s = late_s - silent * period_s
        if phase_s < -EARLY_SHARE * period_s:
            self._one_master.early_sync(self._producer)
            self._due_s = due_s + (heard - 1) * period_s
            return 0.0
        self._clock.lose(heard - 1 + silent)
        self.left_out += silent
        drift_s = (EARLIER_WEIGHT if phase_s < 0.0 else LATER_WEIGHT) * phase_s
        self._due_s = due_s + (heard + silent) * period_s + drift_s
        return max(0.0, phase_s)

    def _comes(self, timeout_s: float, drop: Callable[[can.Message], None]) -> bool:
        """Return whether a SYNC comes in time."""
        clock = self._clock
        if self._heard:  # behind the answers to the last one
            return True
        until_s = clock.now() + timeout_s
        for _ in range(QUEUED_FRAMES):
            message = self.take(max(0.0, until_s - clock.now()))
            if message is None:
                return False
            drop(message)  # a SYNC comes to `_hear`
            if self._heard:
                return True
        return False

    def _read_on(self, drop: Callable[[can.Message], None]) -> None:
        """Read all that is there: after a pause the newest SYNC is this tick's."""
        for _ in range(QUEUED_FRAMES):
            message = receive_frame(self._bus, 0.0)
            if message is None:
                return
            if message.arbitration_id == self._can_id and is_data_frame(message):
                while self._behind:
                    drop(self._behind.popleft())
                drop(message)
            else:
                self._behind.append(message)

    def _hear(self, identifier: int, data: bytearray, stamp: float) -> None:
        if self._echo_due:  # the bench's own, handed back by its adapter
            self._echo_due = False
            return
        self._heard += 1
        self._last_s = self._clock.now()
        if not self._listened:
            self._first_s = self._last_s
        self._listened += 1
