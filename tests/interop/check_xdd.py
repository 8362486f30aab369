#!/usr/bin/python3
"""check_xdd.py: checks the XDD (CiA 311) by the schema as CANopenEditor has it, and entry by entry against the EDS.

The schema is that of version 1.1: elements, their order and namespace, and the values of attributes. CANopenEditor
ignores an element of another namespace, and refuses the file for a value that the schema does not list. Needs no bus.
Status 1 and one line for each error.
"""
import configparser
import pathlib
import re
import sys
from xml.etree import ElementTree

sys.dont_write_bytecode = True
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from eds_file import with_own_keys

ROOT = pathlib.Path(__file__).resolve().parents[2]
EDS, XDD = ROOT / "eds/imu9-gateway.eds", ROOT / "eds/imu9-gateway.xdd"
REALS, TEXTS = (8, 0x11), (9, 10, 15)

errors = []


def expect(condition, where, what):
    if not condition:
        errors.append("%s: %s" % (where, what))


CO, XSI_TYPE = "{http://www.canopen.org/xml/1.1}", "{http://www.w3.org/2001/XMLSchema-instance}type"
# What the schema declares globally has its namespace, and all else has none.
QUALIFIED = set("""ISO15745ProfileContainer ISO15745Profile DeviceIdentity vendorName vendorID productName productID
    productText orderNumber DeviceFunction capabilities characteristicsList characteristic characteristicName
    characteristicContent ApplicationProcess dataTypeList array subrange struct varDeclaration parameterList parameter
    dataTypeIDRef defaultValue allowedValues range unit parameterGroupList parameterGroup parameterRef
    CANopenObjectList""".split())
CHILDREN = {  # of each element, in the order of the schema
    "ISO15745ProfileContainer": "ISO15745Profile", "ISO15745Profile": "ProfileHeader ProfileBody",
    "ProfileHeader": "ProfileIdentification ProfileRevision ProfileName ProfileSource ProfileClassID ISO15745Reference",
    "ISO15745Reference": "ISO15745Part ISO15745Edition ProfileTechnology",
    "ProfileBody": "DeviceIdentity DeviceFunction ApplicationProcess "
                   "ApplicationLayers TransportLayers NetworkManagement",
    "DeviceIdentity": "vendorName vendorID productName productID productText orderNumber", "productText": "description",
    "DeviceFunction": "capabilities", "capabilities": "characteristicsList", "characteristicsList": "characteristic",
    "characteristic": "characteristicName characteristicContent", "characteristicName": "label",
    "characteristicContent": "label", "ApplicationProcess": "dataTypeList parameterList parameterGroupList",
    "dataTypeList": "array struct", "array": "subrange TYPE", "struct": "varDeclaration", "varDeclaration": "TYPE",
    "parameterList": "parameter", "parameter": "label description TYPE defaultValue allowedValues unit",
    "allowedValues": "range", "range": "minValue maxValue", "unit": "label", "parameterGroupList": "parameterGroup",
    "parameterGroup": "label parameterGroup parameterRef", "ApplicationLayers": "CANopenObjectList dummyUsage",
    "CANopenObjectList": "CANopenObject", "CANopenObject": "CANopenSubObject", "dummyUsage": "dummy",
    "TransportLayers": "PhysicalLayer", "PhysicalLayer": "baudRate", "baudRate": "supportedBaudRate",
    "NetworkManagement": "CANopenGeneralFeatures CANopenMasterFeatures"}
TYPE_NAMES = {"BOOL": 1, "SINT": 2, "INT": 3, "DINT": 4, "USINT": 5, "UINT": 6, "UDINT": 7, "REAL": 8, "STRING": 9,
              "BITSTRING": 15, "LREAL": 0x11, "LINT": 0x15, "ULINT": 0x1B, "dataTypeIDRef": None}  # BITSTRING: DOMAIN
PARAMETER_ACCESS = {"const": "const", "read": "ro", "write": "wo", "readWrite": "rw", "readWriteInput": "rwr",
                    "readWriteOutput": "rww"}


def local(element):
    return element.tag.rpartition("}")[2]


def check_structure(element):
    name = local(element)
    expect(element.tag == (CO if name in QUALIFIED else "") + name, "XDD <%s>" % name, "namespace")
    order = CHILDREN.get(name, "").replace("TYPE", " ".join(TYPE_NAMES)).split()
    places = [order.index(local(child)) if local(child) in order else -1 for child in element]
    right = -1 not in places and places == sorted(places)
    expect(right, "XDD <%s>" % name, "children %s" % [local(child) for child in element])
    for child in element:
        check_structure(child)


def same_value(text, wanted, data_type):
    if text is None or wanted is None or data_type in TEXTS or "$NODEID" in wanted:
        return text == wanted
    return float(text) == float(wanted) if data_type in REALS else int(text, 0) == int(wanted, 0)


def check_xdd_entry(node, parameter, keys):
    """An object or sub-index of the object list and its parameter against the section of the EDS."""
    where, data_type = "XDD " + parameter.get("uniqueID"), int(keys["DataType"], 0)
    real = "Real" if data_type in REALS else ""
    default = keys.get("RealDefault", keys.get("DefaultValue"))
    low, high = keys.get(real + "LowLimit"), keys.get(real + "HighLimit")
    expect(int(node.get("dataType"), 16) == data_type and len(node.get("dataType")) == 2, where, "dataType")
    access = "const" if keys["AccessType"] == "const" else keys["AccessType"][:2]  # the schema has no rwr and rww
    expect(node.get("accessType") == access, where, "accessType")
    expect(PARAMETER_ACCESS[parameter.get("access")] == keys["AccessType"], where, "access")
    mapped = {"rww": "RPDO", "wo": "RPDO"}.get(keys["AccessType"], "TPDO") if keys.get("PDOMapping") == "1" else "no"
    expect(node.get("PDOmapping") == mapped, where, "PDOmapping")
    types = [TYPE_NAMES[local(child)] for child in parameter if local(child) in TYPE_NAMES]
    expect(types == [data_type], where, "type")
    value, ranges, unit = (parameter.find(CO + name) for name in ("defaultValue", "allowedValues", "unit"))
    ends = [None, None] if ranges is None else [ranges[0].find(end).get("value") for end in ("minValue", "maxValue")]
    for text, wanted in ((node.get("defaultValue"), default), (None if value is None else value.get("value"), default),
                         (node.get("lowLimit"), low), (node.get("highLimit"), high), (ends[0], low), (ends[1], high)):
        expect(same_value(text, wanted, data_type), where, "value %s instead of %s" % (text, wanted))
    expect(parameter.get("multiplier", "1") == keys.get("Factor", "1"), where, "multiplier")
    expect((None if unit is None else unit[0].text) == keys.get("Unit"), where, "unit")
    expect(parameter.findtext("description") == keys.get("Description"), where, "description")


def check_xdd():
    eds = configparser.RawConfigParser(comment_prefixes=(";",))
    eds.optionxform = str
    eds.read_string(with_own_keys(EDS.read_text("ascii")))
    root = ElementTree.parse(XDD).getroot()
    check_structure(root)
    device, network = root.iter("ProfileBody")
    expect(device.get(XSI_TYPE) == "co:ProfileBody_Device_CANopen", XDD.name, "first profile")
    expect(network.get(XSI_TYPE) == "co:ProfileBody_CommunicationNetwork_CANopen", XDD.name, "second profile")
    for body in (device, network):
        expect(body.get("fileName") == XDD.name, XDD.name, "fileName")
        expect(body.get("fileVersion") == eds["FileInfo"]["FileVersion"], XDD.name, "fileVersion")
        for key in ("Creation", "Modification"):
            month, day, year = eds["FileInfo"][key + "Date"].split("-")
            expect(body.get("file%sDate" % key) == "-".join((year, month, day)), XDD.name, key + " date")
            expect(re.fullmatch(r"([01]\d|2[0-3]):[0-5]\d:00Z", body.get("file%sTime" % key)), XDD.name, key + " time")
    for key, name in (("vendorName", "VendorName"), ("vendorID", "VendorNumber"), ("productName", "ProductName"),
                      ("productID", "ProductNumber")):
        expect(device.findtext("%sDeviceIdentity/%s%s" % (CO, CO, key)) == eds["DeviceInfo"][name], XDD.name, key)
    ids = [e.get("uniqueID") for e in root.iter() if e.get("uniqueID")]
    references = [e.get("uniqueIDRef") for e in root.iter() if e.get("uniqueIDRef")]
    expect(len(set(ids)) == len(ids) and all(re.fullmatch(r"[A-Z]\w+", i) for i in ids), XDD.name, "uniqueID")
    expect(set(references) <= set(ids), XDD.name, "uniqueIDRef")
    parameters = {p.get("uniqueID"): p for p in root.iter(CO + "parameter")}
    sections = set()
    for node in network.iter("CANopenObject"):
        index, where = node.get("index"), "XDD " + node.get("index")
        keys, parameter = eds[index], parameters[node.get("uniqueIDRef")]
        expect(node.get("name") == keys["ParameterName"] == parameter.findtext("label"), where, "name")
        expect(int(node.get("objectType")) == int(keys["ObjectType"], 0), where, "objectType")
        flags = "%04X" % int(keys["ObjFlags"], 0) if "ObjFlags" in keys else None
        expect(node.get("objFlags") == flags, where, "objFlags")
        expect(node.get("subNumber") == keys.get("SubNumber"), where, "subNumber")
        if "DataType" in keys:
            check_xdd_entry(node, parameter, keys)
        sections.add(index)
        for sub in node:
            section = "%ssub%X" % (index, int(sub.get("subIndex"), 16))
            keys, parameter = eds[section], parameters[sub.get("uniqueIDRef")]
            expect(sub.get("name") == keys["ParameterName"] == parameter.findtext("label"), where, "name of " + section)
            check_xdd_entry(sub, parameter, keys)
            sections.add(section)
    wanted = {s for s in eds.sections() if re.match("[0-9A-F]{4}", s)}
    expect(sections == wanted, XDD.name, "objects differ from the EDS: %s" % sorted(sections ^ wanted))
    grouped = [r.get("uniqueIDRef") for r in root.iter(CO + "parameterRef")]
    objects = sorted("UID_OBJ_" + s for s in sections if len(s) == 4)
    expect(sorted(grouped) == objects, XDD.name, "an object in no or two groups")
    rates = {"BaudRate_" + r.get("value").replace(" Kbps", "") for r in network.iter("supportedBaudRate")}
    wanted = {key for key, value in eds["DeviceInfo"].items() if key.startswith("BaudRate_") and value == "1"}
    expect(rates == wanted, XDD.name, "baud rates")
    dummies = [dummy.get("entry") for dummy in network.iter("dummy")]
    expect(dummies == ["%s=%s" % item for item in eds["DummyUsage"].items()], XDD.name, "dummies")
    general = network.find("NetworkManagement/CANopenGeneralFeatures")
    for key, name in (("granularity", "Granularity"), ("nrOfRxPDO", "NrOfRXPDO"), ("nrOfTxPDO", "NrOfTXPDO"),
                      ("dynamicChannels", "DynamicChannelsSupported")):
        expect(general.get(key) == eds["DeviceInfo"][name], XDD.name, key)
    for key, name in (("bootUpSlave", "SimpleBootUpSlave"), ("layerSettingServiceSlave", "LSS_Supported"),
                      ("groupMessaging", "GroupMessaging")):
        expect(general.get(key) == ("true" if eds["DeviceInfo"][name] == "1" else "false"), XDD.name, key)


check_xdd()
for fault in errors:
    print(fault)
print("%d errors" % len(errors))
sys.exit(1 if errors else 0)
