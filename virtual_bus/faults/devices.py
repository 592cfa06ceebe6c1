"""Brakes, I/O device and IMU of an emulated machine with seams at which faults act."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from virtual_bus.faults.seam import Seam
from virtual_bus.modbus.io_device import BRAKE_DELAY_S, EmulatedIo, IoLayout
from virtual_bus.serial.xsens_imu import EmulatedImu

if TYPE_CHECKING:
    from virtual_bus.modbus.framing import TcpFraming
    from virtual_bus.physics import Physics


class FaultyBrakes:
    """The brakes between the coils that work them and the plant.

    Parameters
    ----------
    physics : Physics

    Attributes
    ----------
    armatures : Seam
        By axis: from whether the coil would have the brake open to whether it is.
    torques : Seam
        By axis: from the share of its effort that the brake applies to another.
    """

    def __init__(self, physics: Physics) -> None:
        self.armatures: Seam[Callable[[bool], bool]] = Seam()
        self.torques: Seam[Callable[[float], float]] = Seam()
        self.is_open = [False] * len(physics.axes)
        self.share = np.ones(len(physics.axes))
        self._physics = physics

    def settle(self, wanted_open: Sequence[bool]) -> None:
        """Bring every brake where its coil (in axis order) and the faults have it."""
        before = self.share.copy()
        for index, axis in enumerate(self._physics.axes):
            is_open = wanted_open[index]
            for armature in self.armatures.at(axis):
                is_open = armature(is_open)
            share = 0.0 if is_open else 1.0
            for torque in self.torques.at(axis):
                share = torque(share)
            self.is_open[index], self.share[index] = is_open, share
        if not np.array_equal(before, self.share):
            self._physics.set_brake_shares(self.share)


class FaultyIo(EmulatedIo):
    """The I/O device with seams.

    Attributes
    ----------
    feedbacks : Seam
        By axis: from whether the brake is open to what its feedback input shows.
    thermometers : Seam
        By axis: from the winding's temperature [degC] to what the sensor shows.
    refusals : Seam
        Key "": from a request's PDU to the PDU that answers it, None where the device answers as it would.
    answers : Seam
        Key "": from the bytes of an answer on TCP to those that are sent.
    hangs_up : bool
        Whether every connection is closed as soon as something comes.
    hangs : bool
        Whether requests are taken and nothing is done.
    """

    def __init__(self, layout: IoLayout, axes: tuple[str, ...], brakes: FaultyBrakes, brake_delay_s: float = BRAKE_DELAY_S) -> None:
        self.feedbacks: Seam[Callable[[bool], bool]] = Seam()
        self.thermometers: Seam[Callable[[float], float]] = Seam()
        self.refusals: Seam[Callable[[bytes], bytes | None]] = Seam()
        self.answers: Seam[Callable[[bytes], bytes]] = Seam()
        self.hangs_up = self.hangs = False
        self._brakes = brakes
        super().__init__(layout, axes, brake_delay_s=brake_delay_s)

    def advance(self, time_s: float) -> None:
        """Move machine time on: the feedback follows the armature, not the coil."""
        super().advance(time_s)
        self._brakes.settle((~self.brakes_closed).tolist())
        for axis, is_open in zip(self.axes, self._brakes.is_open, strict=True):
            feedback = self.layout.brake_feedback_inputs.get(axis)
            if feedback is not None:
                for change in self.feedbacks.at(axis):
                    is_open = change(is_open)
                self.discrete_inputs[feedback] = is_open

    def set_temperature(self, axis: str, temperature_degC: float) -> None:
        """Set what the sensor of an axis's winding shows."""
        for change in self.thermometers.at(axis):
            temperature_degC = change(temperature_degC)
        super().set_temperature(axis, temperature_degC)

    def serve_pdu(self, pdu: bytes) -> bytes:
        """Carry out one request, or refuse it."""
        for refuse in self.refusals.at(""):
            if (answer := refuse(pdu)) is not None:
                return answer
        return super().serve_pdu(pdu)

    def serve_tcp(self, framing: TcpFraming, data: bytes) -> bytes:
        """Take bytes of a connection and return the answers, where there are any."""
        if self.hangs_up:
            framing.broken = True
            return b""
        if self.hangs:
            framing.feed(data)
            return b""
        answer = super().serve_tcp(framing, data)
        for change in self.answers.at(""):
            answer = change(answer)
        return answer

    def serve_rtu(self, frame: bytes) -> bytes:
        """Answer a frame of a serial line, where there is an answer."""
        answer = b"" if self.hangs_up or self.hangs else super().serve_rtu(frame)
        for change in self.answers.at(""):
            answer = change(answer)
        return answer


class FaultyImu(EmulatedImu):
    """The IMU with seams.

    Attributes
    ----------
    readings : Seam
        Key "": from the reading (6,) of a message to another.
    messages : Seam
        Key "": from the bytes of a measurement message to those on the line.
    """

    def __init__(self) -> None:
        self.readings: Seam[Callable[[np.ndarray], np.ndarray]] = Seam()
        self.messages: Seam[Callable[[bytes], bytes]] = Seam()
        self._rehearsing = False
        super().__init__()

    def rehearse(self) -> None:
        """Prepare a message without sending it."""
        self._rehearsing = True
        super().rehearse()
        self._rehearsing = False

    def _mtdata2(self, device_time_s: float, status: int, imu: tuple[float, ...]) -> bytes:
        if self._rehearsing:
            return super()._mtdata2(device_time_s, status, imu)
        for of_reading in self.readings.at(""):
            imu = tuple(of_reading(np.array(imu)).tolist())
        message = super()._mtdata2(device_time_s, status, imu)
        for of_message in self.messages.at(""):
            message = of_message(message)
        return message
