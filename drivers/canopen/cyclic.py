"""The frames of one tick: RPDOs out, heartbeat when due, SYNC, TPDOs in. It runs hundreds of times a second.

All look-ups are made beforehand: a tick handles raw frames and one dictionary by COB-ID. What is no process data, heartbeats among it, goes
to the network's subscribers.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from math import isfinite
from typing import Any

import can

from drivers.canopen.foreign_sync import ForeignSync
from drivers.canopen.heartbeat_consumer import HEARTBEAT_TOLERANCE, HeartbeatConsumer
from drivers.canopen.network import PolledNetwork, frame_sender, is_data_frame, receive_frame
from drivers.canopen.one_master import OneMaster
from drivers.canopen.process_data import AxisInput, AxisOutput, Tpdo, check_inputs, drives
from drivers.canopen.settings_watch import SettingsWatch
from drivers.canopen.units import MotionUnits, units_in_data_sheet
from drivers.errors import MotionRefusedError
from drivers.interface import Sample
from drivers.settings import BusSettings

ERROR_FRAME_BUS_OFF = 0x40  # class bit in the identifier of SocketCAN's error frames
STALE_FRAMES_MAX = 256
"""Most frames read outside the answer time: a device that floods the bus must not keep the loop from its tick."""
ANSWER_SPREAD = 0.1
"""Share of a period within which a TPDO that answers a SYNC comes about its usual time; one of an earlier SYNC comes at any time."""
USUAL_OVER = 16
"""Number of answers over which the usual time is averaged."""


class CyclicExchange:
    """Sends and receives the process data of all nodes, once per SYNC.

    Parameters
    ----------
    network : PolledNetwork
        Frames that are no process data go to its subscribers.
    settings : BusSettings
    heartbeats : HeartbeatConsumer

    Raises
    ------
    ConfigurationRefusedError
        An axis lacks a drive, or its PDOs lack what the loop needs.
    """

    def __init__(self, network: PolledNetwork, settings: BusSettings, heartbeats: HeartbeatConsumer) -> None:
        self._network, self._bus, self._clock = network, network.can_bus, network.clock
        self._heartbeats = heartbeats
        self._period_s = settings.sync_period_s
        self._answer_timeout_s = settings.answer_timeout_s
        self._send_sync = frame_sender(network.can_bus, settings.sync_cob_id)
        every = settings.master_heartbeat_period_s / settings.sync_period_s
        self._heartbeat_ticks = max(1, int(every)) if every > 0.0 else 0
        self._tick = 0
        self._axis_names = [scaling.axis for scaling in settings.scalings]
        self.inputs = [AxisInput(scaling) for scaling in settings.scalings]
        parts = zip(drives(settings), settings.scalings, self.inputs, strict=True)
        self.outputs = [
            AxisOutput(drive, scaling, source, units_in_data_sheet(drive, scaling) if scaling.mode.endswith("velocity") else MotionUnits())
            for drive, scaling, source in parts
        ]
        for output in self.outputs:
            output.connect(network.can_bus)
        mapped = [(node, pdo, self._axis_names.index(node.axis)) for node in settings.nodes for pdo in node.tpdos]
        self._tpdos = [Tpdo(node, pdo, axis, self.inputs[axis], bit) for bit, (node, pdo, axis) in enumerate(mapped)]
        check_inputs(self._tpdos, self._axis_names)
        self._by_cob_id = {tpdo.cob_id: tpdo for tpdo in self._tpdos}
        self._expected = sum(tpdo.mask for tpdo in self._tpdos if tpdo.every_sync)
        self._axis_masks = [
            sum(tpdo.mask for tpdo in self._tpdos if tpdo.axis == axis and tpdo.every_sync and tpdo.is_of_axis)
            for axis in range(len(self.inputs))
        ]
        self.silent_ticks = _silent_ticks(settings)
        self.outstanding = 0  # mask of the TPDOs of the last SYNC that have not come in time
        self._owed = 0  # answers that all of them together owe to earlier SYNCs
        self._rehearse_bus: Callable[[], None] | None = getattr(self._bus, "rehearse", None)  # only some buses have it
        self._polls = network.clock.awake_s > 0.0
        self._asleep_at_s = max(0.0, self._answer_timeout_s - network.clock.awake_s)  # remaining time at which polling without sleep ends
        self._spread_s = ANSWER_SPREAD * settings.sync_period_s
        self._late = 0  # TPDOs of which this tick brought answers to earlier SYNCs
        self._missed = 0
        self._aged = False  # whether an answer was missing in the last tick
        self._fault = ""
        self._one_master = OneMaster(network, settings, [tpdo.who if tpdo.every_sync else None for tpdo in self._tpdos])
        self._foreign = ForeignSync(network, settings, self._one_master) if settings.sync_producer else None
        self._take: Callable[[float], can.Message | None] = self._foreign.take if self._foreign else partial(receive_frame, self._bus)
        self._frames: Any = self._bus  # some buses have frames without message objects; where SYNC is foreign, some have been read already
        waiting = None if self._foreign else getattr(self._bus, "waiting_frames", None)
        self._has_frames = waiting is not None
        self._waiting: Callable[[], deque[tuple[int, bytes]]] = waiting or deque
        self._flood_frames = self._one_master.flood_frames
        self._others = self._last_other = 0  # frames of others in this tick, and the last one's identifier
        self.settings_watch = SettingsWatch(network, settings)
        self.late_frames = 0  # process data that came after the end of its tick
        self.syncs = 0  # ticks since the owner set this to 0: SYNCs, where the bench sends them

    def run(self, efforts: Sequence[float], sample: Sample, before_sync: Callable[[], object] | None = None) -> float:
        """Make one tick: send, wait for the tick, SYNC, receive.

        Parameters
        ----------
        efforts : sequence of float
            Command of each axis in its drive's unit.
        sample : Sample
            Overwritten.
        before_sync : callable, optional
            Called between the tick and its SYNC.

        Returns
        -------
        float
            Clock time at which this tick's answers are overdue.

        Raises
        ------
        MotionRefusedError
            A command is not finite; nothing was sent.
        BusError
            The bus failed.
        """
        for axis, (output, effort) in enumerate(zip(self.outputs, efforts, strict=True)):
            if not isfinite(effort):
                raise MotionRefusedError(f"{self._axis_names[axis]}: the command is {effort}; no number, no motion")
            sample.commanded[axis] = output.command(effort)
        for output in self.outputs:
            output.send()
        if self._heartbeat_ticks and self._tick % self._heartbeat_ticks == 0:
            self._network.send_heartbeat()
        self._tick = self._one_master.tick = self._tick + 1
        self.settings_watch.tick()  # all is sent, and the SYNC is not yet due
        if self._foreign is not None:
            self._late = 0
            sample.lateness_s = self._foreign.wait(partial(self._drop, sample), before_sync)
            sample.forget_answers()
        else:
            sample.lateness_s = self._clock.wait_tick()
            self._late = 0
            self._drop_stale(sample)
            if before_sync is not None:
                before_sync()
            sample.forget_answers()
            self._send_sync(b"")
        self.syncs += 1
        sent_s = self._clock.now()
        overdue_s = sent_s + self._answer_timeout_s
        self.outstanding = outstanding = self._receive(sample, sent_s, overdue_s)
        if self._others > self._flood_frames:
            self._one_master.flooded(self._others, self._last_other)
        self._others = 0
        self._grow_ages(sample, outstanding)
        self._fault = self._fault or self._heartbeats.take_fault()
        sample.fault, self._fault = self._fault, ""
        return overdue_s

    def check_sync(self) -> None:
        """Refuse a bus on which a foreign producer of SYNC is silent, or has another rate; see `ForeignSync.check_rate`."""
        if self._foreign is not None:
            self._foreign.check_rate()

    def start_ticks(self) -> None:
        """Begin the ticks anew, after other traffic."""
        self._clock.start_ticks(self._period_s)
        if self._foreign is not None:
            self._foreign.restart()

    def rehearse(self) -> None:
        """Execute those parts of a tick that change nothing, shortly before it; see `drivers.udp_bus.UdpBus.rehearse`."""
        if self._rehearse_bus is not None:
            self._rehearse_bus()
        for tpdo in self._tpdos:
            tpdo.rehearse()

    @property
    def missing(self) -> list[str]:
        """TPDOs that did not answer the last SYNC, in words, with what was wrong with their frames."""
        return [tpdo.who + (f" ({tpdo.malformed})" if tpdo.malformed else "") for tpdo in self._tpdos if self.outstanding & tpdo.mask]

    def forget_remarks(self) -> None:
        """Begin to count anew."""
        for tpdo in self._tpdos:
            tpdo.unanswered = tpdo.longer = 0
        if self._foreign is not None:
            self._foreign.left_out = 0

    @property
    def remarks(self) -> list[str]:
        """What was unusual of TPDOs and settings, in words: it was bridged, put right, or does no harm."""
        found = [f"{tpdo.who}: {tpdo.unanswered} SYNCs were not answered in time since bring-up" for tpdo in self._tpdos if tpdo.unanswered]
        found += [
            f"{tpdo.who}: {tpdo.longer} frames were longer than the {tpdo.size} bytes that it maps; the rest was ignored"
            for tpdo in self._tpdos
            if tpdo.longer
        ]
        if self._foreign is not None and self._foreign.left_out:
            found.append(f"{self._foreign.who}: {self._foreign.left_out} SYNCs did not come")
        return [*found, *self.settings_watch.remarks]

    def _receive(self, sample: Sample, sent_s: float, overdue_s: float) -> int:
        """Read until all answers to this SYNC are there or overdue; return a mask of those that are not.

        A node that has left earlier SYNCs unanswered may still answer them, so the last of its answers belongs to this SYNC. If the first
        were taken, every row from then on would show an earlier sample. When fewer answers come than are owed, either some were lost and
        the newest belongs to this SYNC, or this SYNC's answer is late, too. A frame does not tell, but its time does: it belongs to this
        SYNC if it came at the TPDO's usual time. A TPDO that was never in time owes nothing, because its node may not have been running;
        answers that lag from the first one on are therefore not detected.
        """
        outstanding = self._expected
        remaining = timeout_s = self._answer_timeout_s
        left_s = overdue_s - sent_s  # at the last look at the clock
        overtime = came = 0
        waiting, by_cob_id, in_debt = self._waiting(), self._by_cob_id, self._owed > 0
        awake = self._polls
        data: bytes | bytearray
        while outstanding:
            message = None
            if waiting:
                identifier, data = waiting.popleft()
                tpdo = by_cob_id.get(identifier)
            else:
                message = self._take(0.0 if awake else remaining)
                if message is None and not awake:
                    break
                left_s = overdue_s - self._clock.now()
                if message is None:
                    awake, remaining = left_s > self._asleep_at_s, max(0.0, left_s)
                    continue
                identifier, data = message.arbitration_id, message.data
                tpdo = by_cob_id.get(identifier) if is_data_frame(message) else None
            remaining = left_s
            if tpdo is None:
                self._other(message or self._frames.as_message(identifier, data))
                if self._foreign is not None and self._foreign.ahead:
                    break
            elif not tpdo.take(data, sample):
                self._drop_malformed(tpdo)
            else:
                mask = tpdo.mask
                if came & mask:
                    self._one_master.extra(tpdo.bit)
                came |= mask
                if tpdo.owed:
                    self._pay(tpdo)
                    tpdo.alone_s = timeout_s - remaining
                else:
                    outstanding &= ~mask
                    if not in_debt:
                        usual_s, took_s = tpdo.usual_s, timeout_s - remaining
                        tpdo.usual_s = usual_s + (took_s - usual_s) / USUAL_OVER if usual_s == usual_s else took_s
            if remaining <= 0.0:
                remaining = 0.0  # what already lies in the queue is still taken
                overtime += 1
                if overtime > STALE_FRAMES_MAX:
                    break
        return self._in_doubt(outstanding, came, sample) if outstanding else 0

    def _in_doubt(self, outstanding: int, came: int, sample: Sample) -> int:
        """Update the count of owed answers; return `outstanding` without those that came. An answer to an earlier SYNC is no sample."""
        for tpdo in self._tpdos:
            if not outstanding & tpdo.mask:
                continue
            if not came & tpdo.mask:
                self._one_master.missed(tpdo.bit)
            answers = tpdo.usual_s == tpdo.usual_s
            if came & tpdo.mask and abs(tpdo.alone_s - tpdo.usual_s) <= self._spread_s:
                outstanding &= ~tpdo.mask
                tpdo.owed = 0
            else:
                tpdo.owed = tpdo.owed + 1 if answers else 0
                tpdo.unanswered += answers
                tpdo.forget(sample, late=bool((came | self._late) & tpdo.mask))
        self._owed = sum(tpdo.owed for tpdo in self._tpdos)
        return outstanding

    def _drop_stale(self, sample: Sample) -> None:
        """Drop frames that came too late for the last tick, so that they are not mistaken for answers to the next SYNC."""
        if self._has_frames and not self._waiting():
            return
        for _ in range(STALE_FRAMES_MAX):
            message = receive_frame(self._bus, 0.0)
            if message is None:
                return
            self._drop(sample, message)

    def _drop(self, sample: Sample, message: can.Message) -> None:
        tpdo = self._by_cob_id.get(message.arbitration_id)
        if tpdo is None or not is_data_frame(message):
            self._other(message)
            return
        self.late_frames += 1
        if tpdo.owed:
            self._pay(tpdo)
        if not tpdo.take(message.data, sample):  # keeps the counter's wraps and newest statusword right; the row is cleared next
            self._drop_malformed(tpdo)
        else:
            self._one_master.extra(tpdo.bit)
            self._late |= tpdo.mask

    def _pay(self, tpdo: Tpdo) -> None:
        tpdo.owed -= 1
        self._owed -= 1

    def _drop_malformed(self, tpdo: Tpdo) -> None:
        self._network.drop(f"{tpdo.who}: {tpdo.malformed}")

    def _other(self, message: can.Message) -> None:
        identifier = message.arbitration_id
        if message.is_error_frame and identifier & ERROR_FRAME_BUS_OFF:
            self._fault = self._fault or f"{self._bus.channel_info}: the CAN controller is bus off; check wiring, termination and bit rate"
        self._others += 1
        self._last_other = identifier
        if not is_data_frame(message):
            self._network.pass_over(message)
            return
        self._network.hand_on(message)

    def _grow_ages(self, sample: Sample, outstanding: int) -> None:
        before, self._missed = self._missed, self._clock.missed
        if not (outstanding or self._aged):
            return
        self._aged = outstanding != 0
        ticks = 1 + max(0, self._missed - before)
        elapsed_s = self._period_s * ticks
        silent = outstanding == self._expected and self.silent_ticks and any(tpdo.usual_s == tpdo.usual_s for tpdo in self._tpdos)
        sample.unanswered = sample.unanswered + ticks if silent else 0
        for axis, mask in enumerate(self._axis_masks):
            sample.age_s[axis] = sample.age_s[axis] + elapsed_s if outstanding & mask else 0.0


def _silent_ticks(settings: BusSettings) -> int:
    """Return how many SYNCs in a row may stay without any answer: as long as a node's heartbeat may be missing.

    It is 0 where one node alone answers, because then nobody tells a late bus from a silent node.
    """
    answering = [node.heartbeat_period_s for node in settings.nodes if any(pdo.transmission_type == 1 for pdo in node.tpdos)]
    return int(HEARTBEAT_TOLERANCE * min(answering) / settings.sync_period_s) if len(answering) > 1 else 0
