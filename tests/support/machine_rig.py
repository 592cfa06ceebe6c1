"""Two axes on the scripted bus, and the link to them."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np
from scripted_nodes import BusClock, ScriptedBus, ScriptedDrive, ScriptedEncoder, ScriptedIo, machine_settings

from drivers.machine_link import CanMachine

RESOLUTION = 2 * math.pi / (4096 * 150)
ZERO = np.zeros(2)


class PatientFor:
    """An attendant who leaves a hold after a while, and keeps what was said."""

    def __init__(self, seconds: float) -> None:
        self.seconds, self.said = seconds, []
        self.confirms: Collection[str] = ()
        self.on_say = lambda: None

    def say(self, text: str) -> None:
        self.said.append(text)
        self.on_say()

    def stays(self, held_s: float) -> bool:
        return held_s < self.seconds

    def released(self) -> Collection[str]:
        return self.confirms


class Rig:
    """Two axes on the scripted bus."""

    def __init__(self, **options: bool | int) -> None:
        self.drives = [ScriptedDrive(1), ScriptedDrive(2)]
        self.encoders = [ScriptedEncoder(11, self.drives[0]), ScriptedEncoder(12, self.drives[1])]
        self.bus = ScriptedBus(*self.drives, *self.encoders)
        self.clock = BusClock(self.bus)
        self.settings = machine_settings(**options)
        self.io = ScriptedIo(dict(zip(("propeller", "roll"), self.drives, strict=True)))
        self.attendant = PatientFor(2.0)
        self.machine = CanMachine(self.settings, self.bus, self.clock, io=self.io if self.settings.io else None, attendant=self.attendant)

    def ready(self) -> Rig:
        self.machine.start()
        self.machine.enable()
        self.machine.release_brakes(lambda _: ZERO)
        return self

    def at_rest(self) -> bool:
        powerless = all(drive.power in ("switch on disabled", "fault") for drive in self.drives)
        return powerless and not any(drive.brake_open for drive in self.drives)
