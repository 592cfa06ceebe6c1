"""Identity of a node: device type 1000h in words, identity object 1018h, and their comparison with the machine file."""

from __future__ import annotations

from collections.abc import Callable

from drivers.canopen.sdo import SdoNode, SdoSilenceError
from drivers.errors import NodeAbsentError, WrongIdentityError
from drivers.settings import Identity, Node

PROFILES = {
    0: "no standard profile",
    401: "I/O module (CiA 401)",
    402: "drive (CiA 402)",
    404: "measuring device (CiA 404)",
    405: "programmable controller (CiA 405)",
    406: "encoder (CiA 406)",
    408: "hydraulic drive (CiA 408)",
    410: "inclinometer (CiA 410)",
    418: "battery (CiA 418)",
    419: "battery charger (CiA 419)",
}
NO_PROFILE = 0
ROLE_PROFILES = {"drive": 402, "encoder": 406, "imu": NO_PROFILE}

# bits 16 to 23 of a CiA 402 device type
DRIVE_KINDS = {0x01: "frequency converter", 0x02: "servo drive", 0x04: "stepper drive", 0x08: "multi-axis device"}

_FIELDS = (("vendor_id", 1), ("product_code", 2), ("revision_number", 3), ("serial_number", 4))


def describe_device_type(device_type: int) -> str:
    """Return a device type in words, e.g. `servo drive (CiA 402)` for 00020192h."""
    profile = device_type & 0xFFFF
    if profile == 402 and (kind := DRIVE_KINDS.get(device_type >> 16 & 0xFF)):
        return f"{kind} (CiA 402)"
    return PROFILES.get(profile, f"device profile CiA {profile}")


def read_identity(node: SdoNode) -> Identity:
    """Read object 1018h; entries that the node does not have are None."""
    values: dict[str, int | None] = {}
    for name, subindex in _FIELDS:
        data = node.read_if_present(0x1018, subindex)
        values[name] = None if data is None else int.from_bytes(data, "little")
    return Identity(**values)


def check_identity(node: SdoNode, expected: Node) -> tuple[str, ...]:
    """Compare device profile and identity with the machine file; identity fields of None are not compared.

    Returns
    -------
    tuple of str
        What an operator should know: a device that names no profile is taken for what the machine file says.

    Raises
    ------
    WrongIdentityError
        Every difference, expected and found.
    """
    profile = node.read_integer(0x1000) & 0xFFFF
    wanted = ROLE_PROFILES[expected.role]
    if profile not in (wanted, NO_PROFILE):
        found = describe_device_type(node.read_integer(0x1000))
        raise WrongIdentityError(f"{node.who}: found {found}, the machine file expects {PROFILES[wanted]}; are node ids exchanged?")
    identity = read_identity(node)
    differences = []
    for name, _ in _FIELDS:
        want, have = getattr(expected.identity, name), getattr(identity, name)
        if want is not None and have != want:
            differences.append(f"{name} is {'absent' if have is None else f'{have:08X}h'}, the machine file says {want:08X}h")
    if differences:
        raise WrongIdentityError(f"{node.who}: {'; '.join(differences)}")
    if profile == NO_PROFILE != wanted:
        return (f"{node.who}: its device type (1000h) names no profile; it is taken for a {PROFILES[wanted]}, as the machine file says",)
    return ()


def await_identity(sdo: SdoNode, node: Node, now: Callable[[], float], has_booted: Callable[[Node], bool]) -> tuple[str, ...]:
    """Check a node's identity; one that is silent after its boot-up may take as long again before it answers SDOs.

    Raises
    ------
    DriverError
        As `check_identity` does.
    """
    deadline = now() + node.boot_timeout_s
    while True:
        try:
            return check_identity(sdo, node)
        except NodeAbsentError as error:
            if not isinstance(error.__cause__, SdoSilenceError):  # it answers, and wrongly
                raise
            if now() > deadline:
                if has_booted(node):
                    raise NodeAbsentError(
                        f"{sdo.who}: its boot-up message came, but no answer to an SDO within {node.boot_timeout_s:g} s of it; "
                        f"if it takes longer, raise bus.nodes.{node.name}.boot_timeout_s"
                    ) from error
                raise
