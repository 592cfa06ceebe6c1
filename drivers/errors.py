"""All errors of the device drivers in one hierarchy.

DriverError                    base; exit status 1 unless a class says otherwise
|-- BusError                       the bus itself
|   |-- BusUnavailableError (OSError)       no such interface, interface down, bad URL           exit status 2
|   |-- BusTimeoutError (TimeoutError)      nobody answered in time
|   `-- SecondMasterError                   somebody else sends what only the bench, or one device, may send
|-- DeviceError                    one device
|   |-- NodeAbsentError (TimeoutError)      configured node sent neither boot-up nor SDO answer   exit status 2
|   |-- WrongIdentityError                  vendor, product or revision differ from the file      exit status 2
|   |-- DuplicateNodeError                  two nodes answer to one id                            exit status 2
|   |-- ConfigurationRefusedError           an SDO abort, or a read-back that differs from what was written
|   |-- DeviceFaultError                    the drive is in fault; carries the EMCY in words
|   |-- HeartbeatLostError (TimeoutError)   a supervised node fell silent
|   `-- ProtocolError (ValueError)     bytes that are no message of the protocol
|-- imaging.SpoolError             the folder of an X-ray panel does not hold frames
|-- imaging.PanelError             a panel on the network hung up, or sends no frames
|-- imaging.ClocksDisagreeError    a panel's time stamps and the loop's pulses do not agree
`-- MotionRefusedError                  a check before motion failed: brakes, direction, encoder agreement, hold-to-run, door

DataSheetWarning               no error: a data sheet was read with repairs
"""

KEEP_AWAY = "KEEP AWAY, PRESS THE EMERGENCY STOP"
"""First in what is said while an axis moves or may move: nobody must go there, and nothing of this program holds it."""


class DataSheetWarning(UserWarning):
    """An EDS or DCF file bends the rules of CiA 306: which lines, and what was read instead."""


class DriverError(Exception):
    """Base of every error the drivers raise on purpose."""

    exit_status = 1


class BusError(DriverError):
    """The bus itself failed."""


class BusUnavailableError(BusError, OSError):
    """The interface does not exist, is down, or the bus URL cannot be read."""

    exit_status = 2


class BusTimeoutError(BusError, TimeoutError):
    """Nobody answered in time."""


class SecondMasterError(BusError):
    """Somebody else on the bus sends what only the bench, or one of its devices, may send; or floods it."""


class DeviceError(DriverError):
    """One device failed."""


class NodeAbsentError(DeviceError, TimeoutError):
    """A configured node gave neither boot-up nor an SDO answer."""

    exit_status = 2


class WrongIdentityError(DeviceError):
    """The node's identity object differs from the machine file."""

    exit_status = 2


class DuplicateNodeError(DeviceError):
    """Two devices answer to one node id."""

    exit_status = 2


class ConfigurationRefusedError(DeviceError):
    """The device aborted a write, or read back another value than was written."""


class DeviceFaultError(DeviceError):
    """The drive reports a fault; the message carries its EMCY in words."""


class HeartbeatLostError(DeviceError, TimeoutError):
    """A supervised node has not sent its heartbeat in time."""


class ProtocolError(DeviceError, ValueError):
    """Bytes or registers that are no valid message of the protocol."""


class MotionRefusedError(DriverError):
    """A check before motion failed; nothing was moved."""
