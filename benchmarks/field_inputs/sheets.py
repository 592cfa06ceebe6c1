"""Data sheets with sections that few files have."""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path
from typing import Any

from drivers.canopen.eds import load_object_dictionary
from drivers.errors import ProtocolError
from field_inputs.kinds import RIGHT, WRONG, Input, Outcome, refused

TYPE = "[1000]\nParameterName=Device type\nObjectType=7\nDataType=7\nAccessType=ro\nDefaultValue=0x00030191\n"
ONE = "ParameterName=One\nObjectType=7\nDataType={}\nAccessType=rw\n{}\n"
PDO = "[1800]\nParameterName=TPDO\nObjectType=9\nDataType=0x20\nCompactSubObj=6\n[1800Value]\n1=$NODEID+0x180\n2=254\n5=20\n"
MODULE = "[M1ModuleInfo]\nProductName=digital in\n[M1SubExtends]\n1=0x6000\n[M1SubExt6000]\nDataType=5\nAccessType=ro\nCount=2\n"
CONNECTED = "[ConnectedModules]\nNrOfEntries=2\n1=1\n2=1\n"
FIXED = "[M1FixedObjects]\n1=0x2A00\n[M1Fixed2A00]\n" + ONE.format(3, "DefaultValue=-5")

CASES: list[tuple[str, str, dict[tuple[int, int], Any], str]] = [
    ("compact PDO record", PDO, {(0x1800, 1): 0x185, (0x1800, 2): 254, (0x1800, 5): 20}, ""),
    (
        "compact mapping record",
        "[1A00]\nObjectType=9\nDataType=0x21\nCompactSubObj=2\n[1A00Value]\n1=0x60410010\n",
        {(0x1A00, 1): 0x60410010},
        "",
    ),
    (
        "compact identity record",
        "[1018]\nObjectType=9\nDataType=0x23\nCompactSubObj=4\n[1018Value]\n1=0x2F1\n3=7\n",
        {(0x1018, 1): 0x2F1, (0x1018, 3): 7},
        "",
    ),
    (
        "compact SDO record",
        "[1200]\nObjectType=9\nDataType=0x22\nCompactSubObj=3\n[1200Value]\n1=$NODEID+0x600\n",
        {(0x1200, 1): 0x605},
        "",
    ),
    ("compact record without a type", "[1400]\nObjectType=9\nCompactSubObj=2\nAccessType=rw\n[1400Value]\n2=255\n", {(0x1400, 2): 255}, ""),
    (
        "compact array with names",
        "[2100]\nObjectType=8\nDataType=3\nCompactSubObj=3\n[2100Value]\n3=-30\n[2100Name]\n3=last\n",
        {(0x2100, 3): -30},
        "",
    ),
    ("modules not connected", MODULE, {}, "M1 digital in described and not connected"),
    ("modules connected", MODULE + CONNECTED, {(0x6000, 0): 4}, ""),
    (
        "module that is not described",
        MODULE + "[ConnectedModules]\n1=1\n2=9\n",
        {(0x6000, 0): 2},
        "module 9 is connected and not described",
    ),
    ("fixed object of a module", MODULE + FIXED + CONNECTED, {(0x2A00, 0): -5}, ""),
    (
        "modules already written out",
        MODULE + CONNECTED + "[6000]\nObjectType=8\n" + "".join(f"[6000sub{k}]\n{ONE.format(5, f'DefaultValue={k}')}" for k in range(5)),
        {(0x6000, 4): 4},
        "taken to be among them",
    ),
    ("value of a DCF", "[1017]\n" + ONE.format(6, "DefaultValue=0\nParameterValue=150"), {(0x1017, 0): 150}, ""),
    ("value of a DCF with the node id", "[1014]\n" + ONE.format(7, "ParameterValue=$NODEID+0x80"), {(0x1014, 0): 0x85}, ""),
    ("negative value in hex", "[2404]\n" + ONE.format(3, "ParameterValue=0xFCF7"), {(0x2404, 0): -777}, ""),
    ("node id of another", "[DeviceComissioning]\nNodeID=12\n", {}, "NodeID=12 is this file's, read here for node 5"),
    ("node id that is none", "[DeviceCommissioning]\nNodeID=200\n", {}, "NodeID=200 is no node id"),
    ("object links", "[1600ObjectLinks]\nObjectLinks=1\n1=0x1400\n", {}, "not taken: [1600OBJECTLINKS]"),
    ("dynamic channels", "[DynamicChannels]\nNrOfSeg=1\nType1=4\n", {}, "not taken: [DYNAMICCHANNELS]"),
    ("tools", "[Tools]\nItems=1\n[Tool1]\nName=x\n", {}, "not taken: [TOOLS], [TOOL1]"),
    (
        "listed and missing",
        "[ManufacturerObjects]\nSupportedObjects=1\n1=0x2022\n",
        {},
        "listed without a section, and so not there: [2022]",
    ),
    ("subindex without its object", "[2022sub1]\n" + ONE.format(5, "DefaultValue=9"), {(0x2022, 1): 9}, "object [2022] is missing"),
    ("file of a domain", "[1F50]\nParameterName=Program\nObjectType=2\nDownloadFile=a.bin\n", {}, "DownloadFile was not taken"),
    ("object that is nothing", "[2500]\nParameterName=None\nObjectType=0\n", {}, "ObjectType=0 holds no value"),
    (
        "compact PDOs",
        "[DeviceInfo]\nGranularity=8\nNrOfRXPDO=1\nNrOfTXPDO=5\nCompactPDO=0x13\n",
        {(0x1400, 1): 0x205, (0x1803, 1): 0x485, (0x1804, 1): 0x80000000},
        "read as CiA 301's, nothing mapped",
    ),
    ("flags for tools", "[2700]\n" + ONE.format(5, "ObjFlags=1\nDefaultValue=9"), {(0x2700, 0): 9}, "ObjFlags was not taken"),
    ("name of a DCF", "[2700]\n" + ONE.format(5, "DefaultValue=9\nDenotation=mine"), {(0x2700, 0): 9}, "Denotation was not taken"),
    ("misspelt key", "[2700]\n" + ONE.format(5, "DefaltValue=9"), {}, "DefaltValue was not taken"),
    ("line without =", "[2700]\n" + ONE.format(5, "DefaultValue 9"), {}, "no section and no key of one was left out"),
    ("key that stands twice", "[2700]\n" + ONE.format(5, "DefaultValue=9\nDefaultValue=8"), {(0x2700, 0): 8}, "has the last value"),
    (
        "section that stands twice",
        "[2700]\nDataType=5\n[2700]\nDefaultValue=9\n",
        {(0x2700, 0): 9},
        "a section that stands twice is read as one",
    ),
    ("fewer subindices than said", "[2700]\nObjectType=9\nSubNumber=4\n[2700sub0]\nDataType=5\n", {}, "says 4 subindices, 1 are described"),
    (
        "element beyond the array",
        "[2700]\nObjectType=8\nDataType=3\nCompactSubObj=2\n[2700Value]\n2=-4\n7=1\n",
        {(0x2700, 2): -4},
        "a value or name of another was not taken",
    ),
    (
        "names of a compact array in a DCF",
        "[2700]\nObjectType=8\nDataType=3\nCompactSubObj=2\n[2700Denotation]\n1=a\n",
        {},
        "[2700DENOTATION]",
    ),
    (
        "network of a DCF",
        "[DeviceComissioning]\nNodeID=5\nBaudrate=250\nNodeName=roll\nNetNumber=3\n",
        {},
        "NodeName, NetNumber were not taken",
    ),
    ("real number", "[2700]\n" + ONE.format(8, "DefaultValue=0.75"), {(0x2700, 0): 0.75}, ""),
    ("real number by its bits", "[2700]\n" + ONE.format(8, "DefaultValue=0x3F400000"), {(0x2700, 0): 0.75}, ""),
    ("real number that is none", "[2700]\n" + ONE.format(8, "DefaultValue=fast"), {}, "no value of type 0008h"),
    ("octets", "[2700]\n" + ONE.format(10, "DefaultValue=0x01 0xFE"), {(0x2700, 0): b"\x01\xfe"}, ""),
    ("octets that are none", "[2700]\n" + ONE.format(10, "DefaultValue=no bytes"), {}, "no value of type 000Ah"),
    (
        "comment of another kind",
        "[2700]\n" + ONE.format(5, "DefaultValue=9 // nine"),
        {(0x2700, 0): 9},
        "a comment behind a value begins with ;",
    ),
    ("limit beyond its type", "[2700]\n" + ONE.format(6, "HighLimit=65536"), {}, "is beyond its type and read as 65535"),
    ("section of a module's comments", "[M1ModuleInfo]\nProductName=a\n[M1Comments]\nLines=1\n", {}, "M1 a described and not connected"),
    (
        "node id beside a number",
        "[1400]\nObjectType=9\n[1400sub1]\n" + ONE.format(7, "DefaultValue=0x200+$NODEID"),
        {(0x1400, 1): 0x205},
        "",
    ),
    ("an XDD", "<?xml version='1.0'?>", {}, "refused: XDD and XDC of CiA 311"),
    ("type that is impossible", "[2600]\n" + ONE.format("text", "DefaultValue=1"), {}, "refused: [2600] DataType=text: must be an integer"),
]


def judged(folder: Path, text: str, values: dict[tuple[int, int], Any], words: str) -> Outcome:
    path = folder / "device.eds"
    path.write_text(text if text.startswith("<") else TYPE + text)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            dictionary = load_object_dictionary(path, 5)
        except ProtocolError as refusal:
            return refused(str(refusal), words.removeprefix("refused: ") if words.startswith("refused: ") else "no refusal was due")
    said = " ".join(str(one.message) for one in caught)
    for (index, subindex), value in values.items():
        found = dictionary.get_variable(index, subindex)
        if found is None or value not in (found.value, found.default):
            return Outcome(WRONG, f"{index:04X}h:{subindex} is {found and (found.value, found.default)}, not {value}")
    return Outcome(RIGHT, said) if words.lower() in said.lower() and bool(said) == bool(words) else Outcome(WRONG, f"said {said!r}")


INPUTS = [Input(name, "data sheets", "text", partial(judged, text=text, values=values, words=words)) for name, text, values, words in CASES]
