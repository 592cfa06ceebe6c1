"""A contact that sticks keeps nothing moving, and inputs or outputs that are dead make a state count for nothing."""

from __future__ import annotations

from modbus_wiring import AXES, WIRING, io_map

from drivers.interface import Sample
from drivers.modbus.io import IoDriver
from drivers.modbus.transport import InProcessTransport
from virtual_bus.modbus.io_device import EmulatedIo, IoLayout

SECOND, LOOP = 10, (3, 11)
POLL_S = 0.05


class Bench:
    """A driver and a device whose switch has two contacts, and whose fourth output is wired to an input."""

    def __init__(self) -> None:
        self.device = EmulatedIo(IoLayout(**WIRING, hold_to_run_released_input=SECOND, loop_back=LOOP), AXES)
        wired = io_map(hold_to_run_released_input=SECOND, loop_back=LOOP)
        self.driver = IoDriver(wired, InProcessTransport(self.serve), AXES)
        self.sample, self.now_s, self.frozen = Sample(2), 0.0, list[bool]()

    def serve(self, request: bytes) -> bytes:
        if self.frozen:
            self.device.discrete_inputs[:] = self.frozen
        return self.device.serve(request)

    def poll(self, times: int = 1) -> Sample:
        for _ in range(times):
            self.now_s += POLL_S
            self.device.advance(self.now_s)
            self.driver.poll_due(self.now_s)
        self.driver.update(self.sample)
        return self.sample


def test_motion_needs_both_contacts_and_either_releases() -> None:
    bench = Bench()
    assert bench.poll().hold_to_run
    for stuck, shows in ((WIRING["hold_to_run_input"], True), (SECOND, False)):
        bench.device.set_hold_to_run(False)
        bench.device.discrete_inputs[stuck] = shows
        assert not bench.poll().hold_to_run
        bench.device.set_hold_to_run(True)
        assert bench.poll().hold_to_run


def test_a_state_is_fresh_while_the_wired_input_follows() -> None:
    bench = Bench()
    bench.driver.command_brakes({"roll": True})
    assert all(bench.poll().io_age_s == 0.0 for _ in range(40))
    assert bench.poll(4).brakes_open.tolist() == [False, True]


def test_frozen_inputs_and_dead_outputs_count_as_no_state_while_a_brake_may_be_open() -> None:
    for spoil in ("inputs", "outputs"):
        bench = Bench()
        bench.driver.command_brakes({"roll": True})
        bench.poll(10)
        if spoil == "inputs":
            bench.frozen = list(bench.device.discrete_inputs)
        else:
            write = bench.device.serve_pdu
            bench.device.serve_pdu = lambda pdu, write=write: pdu[:5] if pdu[0] in (5, 15) else write(pdu)  # type: ignore[method-assign]
        ages = [bench.poll().io_age_s for _ in range(14)]
        assert ages[0] == 0.0  # the output may take its time
        assert ages[-1] > 0.5
        assert not bench.sample.hold_to_run


def test_where_all_brakes_are_told_to_close_the_inputs_go_on_to_count() -> None:
    """An output watchdog takes the looped output too; what the inputs say of the brakes is all there is."""
    bench = Bench()
    bench.driver.command_brakes({"roll": True})
    bench.poll(10)
    bench.driver.command_brakes({"roll": False})
    bench.poll()
    for _ in range(10):
        bench.device.coils[:] = [False] * len(bench.device.coils)
        assert bench.poll().io_age_s == 0.0
    assert bench.sample.brakes_open.tolist() == [False, False]
