"""The data sheet of a device that has every service of CiA 301 and 305 that the emulated node knows, written out as an EDS."""

from __future__ import annotations

U8, U16, U32, U64, I8, I16, I32, I64, BOOL, REAL32, REAL64, TEXT, OCTETS, DOMAIN = 5, 6, 7, 0x1B, 2, 3, 4, 0x15, 1, 8, 0x11, 9, 10, 15
VENDOR, PRODUCT, REVISION, SERIAL = 0x00000319, 0x46554C4C, 0x00020001, 0x00BC614E
NODE = 5
LONG_TEXT = "a text that takes more than a hundred bytes, so that blocks and segments have something to carry from end to end"


def entry(head: str, data_type: int, access: str, default: object = "", mappable: int = 0, limits: tuple[int, int] | None = None) -> str:
    """One variable of an EDS."""
    low_high = "" if limits is None else f"LowLimit={limits[0]}\nHighLimit={limits[1]}\n"
    values = f"DataType={data_type}\nAccessType={access}\nDefaultValue={default}\nPDOMapping={mappable}\n{low_high}"
    return f"[{head}]\nParameterName=Object {head}\nObjectType=0x7\n{values}\n"


def record(index: int, *subindices: tuple[int, int, str, object], object_type: int = 9) -> str:
    """A record or array: (subindex, type, access, default) of each beside its count."""
    count = max(sub for sub, *_ in subindices)
    head = f"[{index:04X}]\nParameterName=Object {index:04X}\nObjectType={object_type}\nSubNumber={len(subindices) + 1}\n\n"
    access = "rw" if 0x1600 <= index < 0x1800 or 0x1A00 <= index < 0x1C00 or index == 0x1003 else "ro"
    size = 0 if index == 0x1003 else sum(1 for s in subindices if s[3]) if access == "rw" else count
    return head + entry(f"{index:04X}sub0", U8, access, size) + "".join(entry(f"{index:04X}sub{s:X}", t, a, d) for s, t, a, d in subindices)


def pdo(number: int, *, receive: bool, cob_id: int, mapped: tuple[int, ...], transmission: int) -> str:
    """One PDO with room for eight entries."""
    base, map_base = (0x1400, 0x1600) if receive else (0x1800, 0x1A00)
    settings = [(1, U32, "rw", f"$NODEID+{cob_id:#x}"), (2, U8, "rw", transmission), (3, U16, "rw", 0), (5, U16, "rw", 0)]
    communication = record(base + number, *settings, *([] if receive else [(6, U8, "rw", 0)]))
    places = [(i + 1, U32, "rw", mapped[i] if i < len(mapped) else 0) for i in range(8)]
    return communication + record(map_base + number, *places)


def full_device_eds() -> str:
    """The EDS."""
    text = "[DeviceInfo]\nVendorName=Test\nProductName=Full device\nGranularity=8\nNrOfRXPDO=2\nNrOfTXPDO=2\nLSS_Supported=1\n\n"
    text += "[DummyUsage]\n" + "".join(f"Dummy{i:04d}={int(i > 1)}\n" for i in range(1, 8)) + "\n"
    text += entry("1000", U32, "ro", 0) + entry("1001", U8, "ro", 0, 1) + entry("1005", U32, "rw", "0x80") + entry("1006", U32, "rw", 0)
    text += entry("1007", U32, "rw", 0) + record(0x1020, (1, U32, "rw", 0), (2, U32, "rw", 0), object_type=8)
    text += record(0x1003, *((i, U32, "ro", 0) for i in range(1, 5)), object_type=8)
    text += (
        entry("1008", TEXT, "const", "Full device for tests") + entry("1009", TEXT, "const", "A1") + entry("100A", TEXT, "const", "1.02")
    )
    text += entry("100C", U16, "rw", 0) + entry("100D", U8, "rw", 0) + entry("1012", U32, "rw", "0x80000100")
    text += "".join(record(index, *((i, U32, "rw", 1) for i in range(1, 4)), object_type=8) for index in (0x1010, 0x1011))
    text += (
        entry("1014", U32, "rw", "$NODEID+0x80") + entry("1015", U16, "rw", 0) + entry("1017", U16, "rw", 0) + entry("1019", U8, "rw", 0)
    )
    text += record(0x1016, (1, U32, "rw", 0), (2, U32, "rw", 0), object_type=8)
    text += record(0x1018, (1, U32, "ro", VENDOR), (2, U32, "ro", PRODUCT), (3, U32, "ro", REVISION), (4, U32, "ro", SERIAL))
    text += record(0x1029, (1, U8, "rw", 0), object_type=8)
    text += record(0x1200, (1, U32, "ro", "$NODEID+0x600"), (2, U32, "ro", "$NODEID+0x580"))
    text += pdo(0, receive=True, cob_id=0x200, mapped=(0x21010010, 0x21000008), transmission=1)
    text += pdo(1, receive=True, cob_id=0x300, mapped=(0x21020020,), transmission=255)
    text += pdo(0, receive=False, cob_id=0x40000180, mapped=(0x21010010, 0x21000008), transmission=1)
    text += pdo(1, receive=False, cob_id=0x40000280, mapped=(0x21020020,), transmission=254)
    text += entry("2100", U8, "rw", 3, 1, (1, 200)) + entry("2101", I16, "rw", -1234, 1, (-2000, 2000)) + entry("2102", U32, "rw", 77777, 1)
    text += (
        entry("2103", I8, "rw", -5, 1, (-100, 100)) + entry("2104", U16, "rw", 4321, 0, (10, 50000)) + entry("2105", I32, "rw", -70000, 1)
    )
    text += entry("2106", U64, "rw", 12345678901234, 1) + entry("2107", I64, "rw", -5, 1) + entry("2108", REAL32, "rw", 0, 1)
    text += (
        entry("2109", REAL64, "rw", 0, 1) + entry("210A", BOOL, "rw", 1) + entry("210B", U16, "ro", 0xBEEF, 1) + entry("210C", U32, "wo", 0)
    )
    text += (
        entry("2110", TEXT, "rw", LONG_TEXT)
        + entry("2111", OCTETS, "rw", "01 02 03 04 05 06 07 08 09 0A")
        + entry("2112", DOMAIN, "rw", "")
    )
    text += entry("2113", U32, "const", "0x12345678") + entry("2114", TEXT, "ro", "read only words")
    text += record(0x2120, (1, U16, "rw", 5), (2, U16, "rw", 6), (3, U16, "rw", 7), object_type=8)
    return text
