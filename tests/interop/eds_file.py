"""Reads an EDS (CiA 306) with configparser: an object dictionary independent of the gateway's code."""
import configparser
import re
import struct
from dataclasses import dataclass

OWN_KEYS = ("Unit", "Factor", "Resolution", "Description", "RealDefault", "RealLowLimit", "RealHighLimit", "StringSize",
            "Stored", "Values", "Bits")


def with_own_keys(text):
    """Turns the additional keys in comments (";Unit=m") into keys."""
    return re.sub(r"(?m)^;(?=(?:%s)=)" % "|".join(OWN_KEYS), "", text)


# CiA 301 table 44: data type -> struct form
FORMS = {
    0x01: "?", 0x02: "b", 0x03: "h", 0x04: "i", 0x05: "B", 0x06: "H", 0x07: "I", 0x08: "f", 0x11: "d",
    0x15: "q", 0x1B: "Q"}
STRING, OCTETS, DOMAIN, REAL32 = 0x09, 0x0A, 0x0F, 0x08


@dataclass
class Entry:
    index: int
    sub: int
    name: str
    type: int
    access: str  # ro, rw, wo, const
    default: object  # a number, a string, or None
    low: object
    high: object

    @property
    def form(self):
        return "<" + FORMS[self.type]

    @property
    def numeric(self):
        return self.type in FORMS

    @property
    def size(self):
        return struct.calcsize(self.form)

    @property
    def where(self):
        return "%04Xh:%02X %s" % (self.index, self.sub, self.name)

    def encode(self, value):
        return struct.pack(self.form, value)

    def decode(self, data):
        return struct.unpack(self.form, data)[0]


def _number(text, kind, node_id):
    if text is None or text == "":
        return None
    if kind == REAL32:
        if text.lower().startswith("0x"):  # CiA 306: IEEE 754 bits
            return struct.unpack("<f", struct.pack("<I", int(text, 16)))[0]
        return float(text)
    total = 0
    for term in text.upper().split("+"):
        total += node_id if term.strip() == "$NODEID" else int(term.strip(), 0)
    return total


def _entry(section, index, sub, node_id):
    kind = int(section["DataType"], 0)
    text = section.get("DefaultValue")
    real = {key: section.get("Real" + key) for key in ("Default", "LowLimit", "HighLimit")}
    default = text
    if kind in FORMS:
        default = _number(real["Default"] or text, kind, node_id)
    return Entry(
        index, sub, section["ParameterName"], kind, section["AccessType"].lower(), default,
        _number(real["LowLimit"] or section.get("LowLimit"), kind, node_id),
        _number(real["HighLimit"] or section.get("HighLimit"), kind, node_id))


def read(path, node_id):
    """All entries: {(index, sub): Entry}."""
    parser = configparser.ConfigParser(interpolation=None, delimiters=("=",), comment_prefixes=(";",), strict=True)
    parser.optionxform = str
    with open(path, newline=None, encoding="latin-1") as file:
        parser.read_string(with_own_keys(file.read()))
    entries = {}
    for name in parser.sections():
        match = re.fullmatch(r"([0-9A-Fa-f]{4})(?:sub([0-9A-Fa-f]{1,2}))?", name)
        if match and "DataType" in parser[name]:
            key = int(match[1], 16), int(match[2] or "0", 16)
            entries[key] = _entry(parser[name], *key, node_id)
    return entries
