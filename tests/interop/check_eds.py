#!/usr/bin/python3
"""check_eds.py: checks the EDS and the generated DBC by rules of other readers.

The EDS is read with Python's configparser, key by key like python-canopen (case-sensitive keys, int(x, 0), float()),
and compared with the lists, counts and types of CiA 306; by the rules of lely's dcfchk (a key that is not in CiA 306,
or a number in another notation, makes the file invalid, so additional keys are in comments), of CANopenEditor, and of a
strict parser in JavaScript. The DBC is checked by its grammar and signal by signal against the mapping objects. Needs
no bus. Status 1 and one line for each error; also uses python-canopen and dcfchk if they are installed. With --fix it
first puts ';' before additional keys.
"""
import configparser
import os
import pathlib
import re
import shutil
import subprocess
import sys

sys.dont_write_bytecode = True
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from eds_file import OWN_KEYS, with_own_keys

ROOT = pathlib.Path(__file__).resolve().parents[2]
EDS = ROOT / "eds/imu9-gateway.eds"
DBC = ROOT / os.environ.get("BUILD", "build") / "gen/imu9-gateway.dbc"

SIGNED = {2: 8, 3: 16, 4: 32, 0x15: 64}
UNSIGNED = {1: 1, 5: 8, 6: 16, 7: 32, 0x1B: 64}
REAL = {8: 32, 0x11: 64}
BITS = {**SIGNED, **UNSIGNED, **REAL}
OTHER = {9, 10, 15}  # strings, DOMAIN

VAR_KEYS = {"ParameterName", "ObjectType", "DataType", "AccessType", "DefaultValue", "LowLimit", "HighLimit",
            "PDOMapping", "ObjFlags"}
OUR_KEYS = {"Unit", "Factor", "Resolution", "Description", "RealDefault", "RealLowLimit", "RealHighLimit", "StringSize",
            "Stored", "Values", "Bits"}
RECORD_KEYS = {"ParameterName", "ObjectType", "SubNumber", "ObjFlags", "Description"}
FILE_KEYS = {"FileName", "FileVersion", "FileRevision", "EDSVersion", "Description", "CreationTime", "CreationDate",
             "CreatedBy", "ModificationTime", "ModificationDate", "ModifiedBy"}
DEVICE_KEYS = {"VendorName", "VendorNumber", "ProductName", "ProductNumber", "RevisionNumber", "OrderCode",
               "SimpleBootUpMaster", "SimpleBootUpSlave", "Granularity", "DynamicChannelsSupported", "GroupMessaging",
               "NrOfRXPDO", "NrOfTXPDO", "LSS_Supported",
               *("BaudRate_%d" % b for b in (10, 20, 50, 125, 250, 500, 800, 1000))}
TIME, DATE = r"(0\d|1[0-2]):[0-5]\d[AP]M", r"\d\d-\d\d-\d{4}"
FIXED = ("1018", "1200")  # ro, but the same in every device
LISTS = ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects")

errors = []


def expect(condition, where, what):
    if not condition:
        errors.append("%s: %s" % (where, what))


def number(text, data_type, where):
    """As python-canopen converts a value for node-ID 0; None when it cannot."""
    try:
        if data_type in REAL:
            return float(text)
        value = int(re.sub(r"\+?\$NODEID\+?", "", text), 0)
    except ValueError:
        errors.append("%s: %r is not a value of type %#x" % (where, text, data_type))
        return None
    bits = BITS[data_type]
    low, high = (-1 << bits - 1, (1 << bits - 1) - 1) if data_type in SIGNED else (0, (1 << bits) - 1)
    expect(low <= value <= high, where, "%s does not fit its type" % text)
    return value


def check_variable(eds, section):
    keys = eds[section]
    where = "[%s]" % section
    expect(set(keys) <= VAR_KEYS | OUR_KEYS, where, "unexpected keys %s" % sorted(set(keys) - VAR_KEYS - OUR_KEYS))
    for key in ("ParameterName", "ObjectType", "DataType", "AccessType"):
        if key not in keys:
            errors.append("%s: no %s" % (where, key))
            return
    data_type = int(keys["DataType"], 0)
    expect(data_type != 15 or not {"PDOMapping", "DefaultValue", "LowLimit"} & set(keys), where,
           "a DOMAIN with a key of values, which strict parsers refuse")
    expect(data_type in BITS or data_type in OTHER, where, "DataType %#x" % data_type)
    expect(keys["AccessType"] in ("ro", "wo", "rw", "rwr", "rww", "const"), where, "AccessType " + keys["AccessType"])
    object_type = 2 if data_type == 15 and "sub" not in section else 7  # CANopenEditor loses a sub-index that is no VAR
    expect(int(keys["ObjectType"], 0) == object_type, where, "ObjectType " + keys["ObjectType"])
    if "PDOMapping" in keys:
        bool(int(keys["PDOMapping"], 0))
    if "Factor" in keys:
        expect(float(keys["Factor"]) > 0, where, "Factor " + keys["Factor"])
    if data_type not in BITS:
        return
    prefix = "Real" if data_type in REAL else ""
    low, high = (number(keys[k], data_type, where) if k in keys else None
                 for k in (prefix + "LowLimit", prefix + "HighLimit"))
    default = number(keys.get("RealDefault", keys.get("DefaultValue", "0")), data_type, where)
    if data_type in REAL:
        expect(keys.get("DefaultValue", "0") == "0", where,
               "DefaultValue of a REAL32 other than 0 (tools disagree on its form)")
        expect("LowLimit" not in keys and "HighLimit" not in keys, where, "limits of a REAL32 in an integer's keys")
    expect(keys["AccessType"] != "ro" or "DefaultValue" not in keys or section[:4] in FIXED, where,
           "DefaultValue of a value that changes: configuration tools compare it with the device")
    expect(low is None or low <= default, where, "default below LowLimit")
    expect(high is None or default <= high, where, "default above HighLimit")


NUMBER = re.compile(r"(\$NODEID\+)?(-?0x[0-9A-Fa-f]+|-?[0-9]+)")


def strict_number(text, data_type, where):
    """An integer, decimal or 0x, within its type for every node-ID; a REAL as its IEEE 754 bits."""
    match = NUMBER.fullmatch(text)
    if not match:
        errors.append("%s: %r is not a number for every reader" % (where, text))
        return None
    value = int(match[2], 0)
    bits = BITS[data_type]
    low, high = (-1 << bits - 1, (1 << bits - 1) - 1) if data_type in SIGNED else (0, (1 << bits) - 1)
    expect(low <= value <= high - (127 if match[1] else 0), where, "%s does not fit its type" % text)
    return value


def check_strictly(text):
    """What a reader of plain CiA 306 accepts."""
    eds = configparser.ConfigParser(inline_comment_prefixes=("#", ";"), interpolation=None, strict=True)
    eds.optionxform = str
    eds.read_string(text)
    known = {"FileInfo": FILE_KEYS, "DeviceInfo": DEVICE_KEYS}
    for name in eds.sections():
        section, where = eds[name], "[%s]" % name
        match = re.fullmatch("[0-9A-F]{4}(sub[0-9A-F]+)?", name)
        if name in known:
            expect(set(section) <= known[name], where, "keys %s" % sorted(set(section) - known[name]))
        elif name == "DummyUsage":
            for key, value in section.items():
                expect(re.fullmatch("Dummy[0-9A-F]{4}", key) and value in "01", where, key)
        elif match:
            strange = set(section) - VAR_KEYS - {"SubNumber", "CompactSubObj"}
            expect(not strange, where, "%s: put ';' before a key that is not in CiA 306" % ", ".join(sorted(strange)))
            if "SubNumber" not in section and int(section["DataType"], 0) in BITS:
                data_type = int(section["DataType"], 0)
                low, value, high = (strict_number(section[key], data_type, where) if key in section else None
                                    for key in ("LowLimit", "DefaultValue", "HighLimit"))
                for a, b in ((low, value), (value, high)):
                    expect(a is None or b is None or a <= b, where, "the default is beyond a limit")
            elif "SubNumber" in section:
                expect(name + "sub0" in eds and int(eds[name + "sub0"]["DataType"], 0) == 5, where,
                       "sub-index 0 is not an UNSIGNED8")
            else:
                expect("LowLimit" not in section and "HighLimit" not in section, where, "limits of a string")
        else:
            expect(name in LISTS + ("Comments",), where, "unknown section")


def base_of(text):
    """The base in which CANopenEditor reads a number: a leading 0 is octal."""
    return 16 if re.fullmatch(r"\s*0[xX][0-9A-Fa-f]+\s*", text) else 8 if re.match("0[0-7]", text) else 10


def check_as_canopeneditor(text):
    """What libEDSsharp, which CANopenEditor and others use, reads: line by line. A semicolon before a section does not
    make it a comment, a sub-index needs its object before it and must be a VAR, numbers have at most the width of their
    field."""
    sections, name = {}, None
    for n, line in enumerate(text.splitlines(), 1):
        bare = line.lstrip(";")
        section, key = re.match(r"\[([A-Za-z0-9]+)\]", bare), re.match(r"([A-Za-z0-9_]+) *= *(.*)", bare)
        where = "CANopenEditor, line %d" % n
        if section:
            expect(not line.startswith(";"), where, "a section in a comment")
            expect(section[1] not in sections, where, "the section is there twice")
            sections.setdefault(name := section[1], {})
        elif key and not line.startswith(";"):
            expect(key[1] not in sections[name], where, "the key is there twice")
            sections[name][key[1]] = key[2].rstrip()
        else:
            expect(not line or line.startswith(";"), where, "neither section nor key")
            expect(not key or key[1] not in ("StorageLocation", "TPDODetectCos"), where, "a key of its own")
    widths = {"ObjectType": 0x7FFF, "DataType": 0x7FFF, "PDOMapping": 0x7FFF, "ObjFlags": 0xFFFFFFFF, 
              "FileVersion": 255,
              "FileRevision": 255, "Granularity": 255, "NrOfRXPDO": 0xFFFF, "NrOfTXPDO": 0xFFFF, "SubNumber": 255}
    objects = set()
    for name, keys in sections.items():
        where = "CANopenEditor, [%s]" % name
        for key, value in keys.items():
            if key in widths:
                expect(int(value, base_of(value)) <= widths[key], where, key)
            if key in widths or key in ("DefaultValue", "LowLimit", "HighLimit"):
                expect(base_of(value) != 8, where, "%s=%s is octal" % (key, value))
        match = re.fullmatch("([A-Fa-f0-9]+)(sub)?([0-9A-Fa-f]*)", name)
        if not match or "ParameterName" not in keys:
            continue
        kind = int(keys.get("ObjectType", "7"), base_of(keys.get("ObjectType", "7")))
        if match[2]:
            expect(int(match[1], 16) in objects, where, "a sub-index before its object")
            expect(kind == 7, where, "a sub-index that is not a VAR is lost")
        else:
            objects.add(int(match[1], 16))
        expect(kind in (2, 7, 8, 9), where, "ObjectType")
        expect(kind not in (8, 9) or "SubNumber" in keys, where, "no SubNumber")
    return {(name, key): value for name, keys in sections.items() for key, value in keys.items()}


def check_as_javascript(eds):
    """What the npm package canopen refuses: keys of values in records and DOMAINs, limits in the wrong order as
    text."""
    for name in eds.sections():
        match, keys = re.fullmatch("[0-9A-F]{4}(sub[0-9A-F]+)?", name), eds[name]
        if not match:
            continue
        kind, where = int(keys.get("ObjectType", "7"), 0), "JavaScript, [%s]" % name
        refused = {7: {"CompactSubObj"}, 2: {"PDOMapping", "LowLimit", "HighLimit", "CompactSubObj"}}.get(
            kind, {"DataType", "AccessType", "DefaultValue", "PDOMapping", "LowLimit", "HighLimit"})
        expect(not refused & set(keys), where, "%s is not supported" % sorted(refused & set(keys)))
        expect("ParameterName" in keys and (kind != 7 or "DataType" in keys), where, "a mandatory key is missing")
        if {"LowLimit", "HighLimit"} <= set(keys):
            expect(int(keys["LowLimit"], 0) <= int(keys["HighLimit"], 0), where, "limits")


def check_eds():
    raw = EDS.read_bytes()
    expect(raw.count(b"\r\n") == raw.count(b"\n"), EDS.name, "a line without CRLF")
    text = raw.decode("ascii")
    expect(max(map(len, text.splitlines())) < 200, EDS.name, "a line of 200 characters or more")
    eds = configparser.RawConfigParser(inline_comment_prefixes=(";",), strict=True)
    eds.optionxform = str
    check_strictly(text)
    eds.read_string(text)
    check_as_javascript(eds)
    expect(check_as_canopeneditor(text) == {(s, k): eds[s][k] for s in eds.sections() for k in eds[s]}, EDS.name,
           "CANopenEditor reads other values")
    eds.clear()
    eds.read_string(with_own_keys(text))
    for section in eds.sections():
        for key, value in eds[section].items():
            expect(value.strip(), "[%s]" % section, "%s is empty" % key)
    expect(set(eds["FileInfo"]) == FILE_KEYS, "[FileInfo]",
           "keys differ: %s" % sorted(set(eds["FileInfo"]) ^ FILE_KEYS))
    expect(set(eds["DeviceInfo"]) == DEVICE_KEYS, "[DeviceInfo]",
           "keys differ: %s" % sorted(set(eds["DeviceInfo"]) ^ DEVICE_KEYS))
    expect(eds["FileInfo"]["FileName"] == EDS.name, "[FileInfo]", "FileName")
    for key, pattern in (("CreationTime", TIME), ("CreationDate", DATE), ("ModificationTime", TIME),
                         ("ModificationDate", DATE),
                         ("EDSVersion", r"4\.0")):
        expect(re.fullmatch(pattern, eds["FileInfo"][key]), "[FileInfo]", key)
    for sub, key in enumerate(("VendorNumber", "ProductNumber", "RevisionNumber"), 1):
        same = int(eds["DeviceInfo"][key], 0) == int(eds["1018sub%d" % sub]["DefaultValue"], 0)
        expect(same, "[DeviceInfo]", key + " differs from 1018h")
    major, minor = (int(eds["FileInfo"][key]) for key in ("FileVersion", "FileRevision"))
    expect(int(eds["DeviceInfo"]["RevisionNumber"], 0) == major << 16 | minor, "[FileInfo]",
           "version and revision differ from 1018h:3")
    lines = int(eds["Comments"]["Lines"])
    expect(set(eds["Comments"]) == {"Lines"} | {"Line%d" % (i + 1) for i in range(lines)}, "[Comments]",
           "lines do not agree")

    listed = []
    for name in LISTS:
        count = int(eds[name]["SupportedObjects"])
        expect(set(eds[name]) == {"SupportedObjects"} | {str(i + 1) for i in range(count)}, "[%s]" % name, "numbering")
        listed += [(name, int(v, 16)) for k, v in eds[name].items() if k != "SupportedObjects"]
    for name, index in listed:
        mandatory, manufacturer = index in (0x1000, 0x1001, 0x1018), 0x2000 <= index <= 0x5FFF
        right = LISTS[0] if mandatory else LISTS[2] if manufacturer else LISTS[1]
        expect(name == right, "%04X" % index, "belongs in [%s]" % right)
    indices = [index for _, index in listed]
    expect(len(set(indices)) == len(indices), "lists", "an object twice")
    described = {s for s in eds.sections() if re.fullmatch("[0-9A-F]{4}", s)}
    expect(described == {"%04X" % i for i in indices}, "lists", "sections and lists differ")

    entries = {}
    for section in eds.sections():
        match = re.fullmatch("([0-9A-F]{4})(?:sub([0-9A-F]+))?", section)
        if not match:
            continue
        expect(match[1] in described, "[%s]" % section, "no such object")
        if match[2] is None and int(eds[section]["ObjectType"], 0) in (8, 9):
            expect(set(eds[section]) <= RECORD_KEYS, "[%s]" % section, "unexpected keys")
            continue
        check_variable(eds, section)
        entries[int(match[1], 16), int(match[2] or "0", 16)] = eds[section]
    for section in described:
        subs = sorted(sub for index, sub in entries if index == int(section, 16))
        if "SubNumber" in eds[section]:
            expect(int(eds[section]["SubNumber"], 0) == len(subs), "[%s]" % section, "SubNumber")
            expect(subs[0] == 0, "[%s]" % section, "no sub-index 0")
        else:
            expect(subs == [0], "[%s]" % section, "sub-indices of a VAR")
    for key, first in (("NrOfRXPDO", 0x1400), ("NrOfTXPDO", 0x1800)):
        expect(int(eds["DeviceInfo"][key]) == sum(first <= i < first + 0x200 for i in indices), "[DeviceInfo]", key)
    dummies = {"Dummy%04X" % i: "1" if 2 <= i <= 7 else "0" for i in range(1, 8)}
    expect(dict(eds["DummyUsage"]) == dummies, "[DummyUsage]", "differs from the types that the device supports")
    return entries


def mapped(entries, index):
    """(key of the entry, bits) for each default mapping in the object `index`."""
    result = []
    for sub in range(1, int(entries[index, 0]["DefaultValue"]) + 1):
        value = int(entries[index, sub]["DefaultValue"], 0)
        key = value >> 16, value >> 8 & 0xFF
        where = "[%04Xsub%X]" % (index, sub)
        if key not in entries:
            errors.append("%s: maps %04X:%02X, which does not exist" % (where, *key))
            continue
        expect(entries[key].get("PDOMapping") == "1", where, "maps an object that is not mappable")
        access = ("wo", "rw", "rww") if index < 0x1800 else ("ro", "const", "rw", "rwr")
        expect(entries[key]["AccessType"] in access, where, "maps an object for the other direction")
        expect(value & 0xFF == BITS[int(entries[key]["DataType"], 0)], where, "wrong length")
        result.append((key, value & 0xFF))
    return result


def without_groups(pattern):
    return re.sub(r"(?<!\\)\((?!\?)", "(?:", pattern)


def check_dbc(entries):
    text = DBC.read_text("ascii")
    signal = r' SG_ ([A-Za-z_]\w{0,31}) : (\d+)\|(\d+)@1([+-]) ' \
        r'\(([^,]+),0\) \[([^|]+)\|([^]]+)\] "([^"]*)" (?:Vector__XXX|IMU9)\n'
    message = r"BO_ (\d+) ([A-Za-z_]\w{0,31}): (\d) (?:IMU9|Vector__XXX)\n((?:%s)+)\n" % without_groups(signal)
    tail = r'(?:CM_ (?:BO_ \d+ |SG_ \d+ \w+ )?"(?:[^"\\]|\\.)*";\n|' \
        r'SIG_VALTYPE_ \d+ \w+ : [12];\n|VAL_ \d+ \w+(?: \d+ "[^"]*")+ ;\n)*'
    whole = r'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: IMU9\n\n(?:%s)+%s' % (without_groups(message), tail)
    expect(re.fullmatch(whole, text), DBC.name, "does not follow the grammar")
    messages = {int(m[1]): m for m in re.finditer(message, text)}
    if set(messages) != {0x181, 0x281, 0x381, 0x481, 0x201, 0x301, 0x401, 0x501, 0x81, 0x701}:
        errors.append("%s: CAN-IDs %s" % (DBC.name, sorted(map(hex, messages))))
        return
    pdos = [("TPDO", 0x181, 0x1A00, n) for n in range(4)] + [("RPDO", 0x201, 0x1600, n) for n in range(4)]
    for kind, first_id, mapping, pdo in pdos:
        found = re.findall(signal, messages[first_id + 0x100 * pdo][4])
        wanted = mapped(entries, mapping + pdo)
        where = "%s %s%d" % (DBC.name, kind, pdo + 1)
        expect(messages[first_id + 0x100 * pdo][2] == kind + str(pdo + 1), where, "name")
        expect(len(found) == len(wanted), where, "%d signals for %d mapped objects" % (len(found), len(wanted)))
        start = 0
        for (name, at, bits, sign, factor, low, high, unit), (key, length) in zip(found, wanted):
            entry = entries[key]
            scale = float(entry.get("Factor", "1"))
            real, signed = int(entry["DataType"], 0) in REAL, int(entry["DataType"], 0) in SIGNED
            raw = (0, 0) if real else (-1 << length - 1, (1 << length - 1) - 1) if signed else (0, (1 << length) - 1)
            expect((int(at), int(bits)) == (start, length), where, name + " has the wrong position")
            expect(sign == ("-" if signed or real else "+"), where, name + " has the wrong sign")
            expect(float(factor) == scale and unit == entry.get("Unit", ""), where,
                   name + " has the wrong unit or factor")
            for limit, bound in zip((low, high), raw):
                expect(abs(float(limit) - bound * scale) < 1e-6, where, name + " has the wrong range")
            start += length
        expect(start == 8 * int(messages[first_id + 0x100 * pdo][3]) <= 64, where, "length")


def check_with_python_canopen():
    """Returns a note for the log."""
    try:
        import canopen
    except ImportError:
        return "python-canopen is not installed"
    import logging
    import warnings

    warnings.simplefilter("error")
    log = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: log.append(record.getMessage())
    logging.getLogger().addHandler(handler)
    dictionary = canopen.import_od(str(EDS), node_id=1)
    for line in log:
        errors.append("python-canopen: " + line)
    plain = configparser.RawConfigParser(inline_comment_prefixes=(";",))
    plain.optionxform = str
    plain.read_string(EDS.read_text("ascii"))
    for section in plain.sections():
        match = re.fullmatch("([0-9A-F]{4})(?:sub([0-9A-F]+))?", section)
        if match and "DataType" in plain[section]:
            variable = dictionary[int(match[1], 16)]
            variable = variable[int(match[2], 16)] if match[2] else variable
            expect(variable.data_type == int(plain[section]["DataType"], 0), "python-canopen", "type of " + section)
    return "python-canopen agrees"


def check_with_dcfchk():
    if not shutil.which("dcfchk"):
        return "dcfchk is not installed"
    done = subprocess.run(["dcfchk", "-n", "1", str(EDS)], capture_output=True, text=True)
    for line in done.stderr.splitlines():
        errors.append("dcfchk: " + line)
    expect(done.returncode == 0, "dcfchk", "status %d" % done.returncode)
    return "dcfchk agrees"


def fix():
    """Turns additional keys into comments."""
    text = EDS.read_bytes().decode("ascii")
    start, end = text.index("[DummyUsage]"), text.index("[Comments]")
    objects = re.sub(r"(?m)^(?=(?:%s)=)" % "|".join(OWN_KEYS), ";", text[start:end])
    EDS.write_bytes((text[:start] + objects + text[end:]).encode("ascii"))


def main():
    if sys.argv[1:] == ["--fix"]:
        fix()
    entries = check_eds()
    if DBC.exists():
        check_dbc(entries)
    else:
        errors.append("%s is missing: run make first" % DBC)
    note = check_with_python_canopen() + "; " + check_with_dcfchk()
    for fault in errors:
        print(fault)
    print("%d entries checked, %d errors; %s" % (len(entries), len(errors), note))
    return 1 if errors else 0


sys.exit(main())
