"""A device of another vendor: an encoder that answers SDO, with a heartbeat and one TPDO. It has no object 1021h; its
EDS is a file."""
import struct
import threading
import time

import can

NODE = 42
POSITION = 0x6004, 0
EDS = """[FileInfo]
FileName=encoder.eds
FileVersion=1
FileRevision=1
EDSVersion=4.0
[DeviceInfo]
VendorName=Somebody
VendorNumber=0x123
ProductName=Encoder
ProductNumber=7
RevisionNumber=1
BaudRate_500=1
NrOfRXPDO=0
NrOfTXPDO=1
[MandatoryObjects]
SupportedObjects=3
1=0x1000
2=0x1001
3=0x1018
"""


def variable(section, name, data_type, access, default, mapped=0):
    return "[%s]\nParameterName=%s\nObjectType=0x7\nDataType=0x%04X\nAccessType=%s\nDefaultValue=%s\nPDOMapping=%d\n" \
        % (section, name, data_type, access, default, mapped)


def record(index, name, subs):
    return "[%s]\nParameterName=%s\nObjectType=0x9\nSubNumber=%d\n" % (index, name, len(subs) + 1) + \
        variable(index + "sub0", "Highest sub-index supported", 5, "const", len(subs)) + \
        "".join(variable("%ssub%X" % (index, i + 1), *sub) for i, sub in enumerate(subs))


EDS += variable("1000", "Device type", 7, "ro", "0x00080196") + variable("1001", "Error register", 5, "ro", 0) + \
    record("1018", "Identity", [("Vendor-ID", 7, "ro", "0x123"), ("Product code", 7, "ro", 7),
                                ("Revision number", 7, "ro", 1), ("Serial number", 7, "ro", 99)]) + \
    "[OptionalObjects]\nSupportedObjects=4\n1=0x1008\n2=0x1800\n3=0x1A00\n4=0x6004\n" + \
    variable("1008", "Manufacturer device name", 9, "const", "ENC7") + \
    record("1800", "TPDO1 communication",
           [("COB-ID", 7, "rw", "$NODEID+0x180"), ("Transmission type", 5, "rw", 254)]) + \
    "[1A00]\nParameterName=TPDO1 mapping\nObjectType=0x9\nSubNumber=2\n" + \
    variable("1A00sub0", "Number of mapped objects", 5, "rw", 1) + \
    variable("1A00sub1", "Object 1", 7, "rw", "0x60040020") + \
    variable("6004", "Position value", 7, "ro", 0, 1)
EDS += "[ManufacturerObjects]\nSupportedObjects=0\n"


class Encoder(threading.Thread):
    def __init__(self, bus):
        super().__init__(daemon=True)
        group, port = bus.split(":")[1:]
        self.bus = can.Bus(interface="udp_multicast", channel=group, port=int(port))
        self.going = True
        self.position = 0
        self.values = {
            (0x1000, 0): struct.pack("<I", 0x00080196), (0x1001, 0): b"\0", (0x1008, 0): b"ENC7",
            (0x1018, 0): b"\4", (0x1018, 1): struct.pack("<I", 0x123), (0x1018, 2): struct.pack("<I", 7),
            (0x1018, 3): struct.pack("<I", 1), (0x1018, 4): struct.pack("<I", 99),
            (0x1800, 0): b"\2", (0x1800, 1): struct.pack("<I", 0x180 + NODE), (0x1800, 2): b"\xfe",
            (0x1A00, 0): b"\1", (0x1A00, 1): struct.pack("<I", 0x60040020), POSITION: bytes(4)}

    def send(self, identifier, data):
        self.bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    def answer(self, request):
        command, index, sub = struct.unpack("<BHB", request[:4])
        value = self.values.get((index, sub))
        if command == 0x40 and value is not None:
            head = struct.pack("<BHB", 0x43 | (4 - len(value)) << 2, index, sub)
            self.send(0x580 + NODE, head + value.ljust(4, b"\0"))
        else:
            self.send(0x580 + NODE, struct.pack("<BHBI", 0x80, index, sub, 0x06020000))

    def run(self):
        due = 0
        while self.going:
            message = self.bus.recv(0.05)
            if message and message.arbitration_id == 0x600 + NODE and len(message.data) == 8:
                self.answer(bytes(message.data))
            if time.monotonic() >= due:
                due = time.monotonic() + 0.2
                self.position += 1000
                self.values[POSITION] = struct.pack("<I", self.position)
                self.send(0x180 + NODE, self.values[POSITION])
                self.send(0x700 + NODE, b"\5")

    def end(self):
        self.going = False
        self.join()
        self.bus.shutdown()
