"""RPDOs, and TPDOs on change (CiA 301, 7.2.2)."""
import math
import struct

import canopen_master as canopen
import rig
from rig import NODE, u8, u16, u32

RPDO = [0x200, 0x300, 0x400, 0x500]
EXISTS_NOT = 1 << 31
EXTERNAL_AID = 1 << 11  # in the status word 210Fh:3
NOT_MAPPABLE, PDO_LENGTH, UNSUPPORTED_ACCESS, BAD_VALUE = 0x06040041, 0x06040042, 0x06010000, 0x06090030


class ReceivePdos(rig.OnTheBus):
    def send(self, number, data):
        self.master.send(RPDO[number - 1] + NODE, data)

    def commands(self):
        return struct.unpack("<H", self.read(0x2073))[0]

    def assert_emcy(self, code, info):
        _, register, received = canopen.emergency(self.emcy(code))
        self.assertEqual((register & 0x11, received.hex()), (0x11, info))

    def test_four_rpdos_have_the_predefined_identifiers(self):
        for number in range(4):
            self.assertEqual(self.read(0x1400 + number, 1), u32(RPDO[number] + NODE))

    def test_a_pdo_is_applied_on_reception_in_operational_only(self):
        self.send(1, struct.pack("<hhhH", 1, 1, 1, 0))
        self.assertEqual(self.read(0x2070, 5), struct.pack("<h", 0))
        self.start()
        self.send(1, struct.pack("<hhhH", 1500, -2, 0, 0))
        self.assertEqual([self.read(0x2070, sub) for sub in (5, 6)], [struct.pack("<h", v) for v in (1500, -2)])
        self.assertAlmostEqual(struct.unpack("<f", self.read(0x2070, 1))[0], 1.5, places=5)
        self.send(1, bytes(8))

    def test_a_synchronous_pdo_is_applied_at_the_sync(self):
        self.write(0x1403, 2, u8(1))
        self.start()
        self.send(4, u16(1))
        self.assertEqual(self.commands(), 0)
        self.master.sync()
        self.assertEqual(self.commands(), 1)
        self.send(4, u16(0))
        self.master.sync()
        self.assertEqual(self.commands(), 0)

    def test_a_wrong_length_raises_8210h_or_8220h_and_is_cleared(self):
        self.start()
        self.send(4, b"\1")
        self.assert_emcy(0x8210, "0314010200")
        self.assertEqual(self.commands(), 0)
        self.send(4, u16(0))
        self.emcy(0x0000)
        self.send(4, b"\0\0\0")
        self.assert_emcy(0x8220, "0314030200")
        self.send(4, u16(0))
        self.emcy(0x0000)

    def test_a_missing_pdo_raises_8250h_in_time_and_is_cleared(self):
        self.write(0x1403, 5, u16(100))
        self.start()
        self.send(4, u16(0))
        sent = self.master.wait(RPDO[3] + NODE)
        frame = self.emcy(0x8250)
        self.assertEqual(frame.data[3:].hex(), "0314000000")
        self.assertAlmostEqual(frame.timestamp - sent.timestamp, 0.1, delta=0.02)
        self.send(4, u16(0))
        self.emcy(0x0000)

    def test_a_value_outside_its_limits_raises_8200h_and_the_pdo_is_not_applied(self):
        self.start()
        self.send(3, struct.pack("<hhhB", 1, 2, 3, 2))
        self.assert_emcy(0x8200, "0214722007")
        self.assertEqual(self.read(0x2072, 4), struct.pack("<h", 0))
        self.send(3, bytes(7))
        self.emcy(0x0000)

    def test_a_mapping_with_a_dummy_entry_takes_effect_at_once(self):
        self.start()
        self.write(0x1400, 1, u32(EXISTS_NOT | RPDO[0] + NODE))
        self.write(0x1600, 0, u8(0))
        self.write(0x1600, 1, u32(0x00060010))
        self.write(0x1600, 2, u32(0x20730010))
        self.write(0x1600, 0, u8(2))
        self.write(0x1400, 1, u32(RPDO[0] + NODE))
        self.send(1, bytes.fromhex("FFFF0100"))
        self.assertEqual(self.commands(), 1)
        self.send(1, bytes(4))

    def test_an_invalid_mapping_is_refused(self):
        self.assert_aborts(UNSUPPORTED_ACCESS, self.write, 0x1600, 0, u8(0))
        self.assert_aborts(BAD_VALUE, self.write, 0x1400, 2, u8(252))
        self.assert_aborts(BAD_VALUE, self.write, 0x1400, 1, u32(0x211))
        self.write(0x1400, 1, u32(EXISTS_NOT | RPDO[0] + NODE))
        self.write(0x1600, 0, u8(0))
        self.assert_aborts(NOT_MAPPABLE, self.write, 0x1600, 1, u32(0x21000110))  # for TPDOs
        self.assert_aborts(PDO_LENGTH, self.write, 0x1600, 0, u8(9))

    def test_a_velocity_aid_sets_the_velocity_and_the_status_bit(self):
        self.master.remap(NODE, 1, [(0x2104, 1, 32), (0x2104, 2, 32)], transmission=254)
        self.start()
        self.master.listen(0.3)
        self.send(1, struct.pack("<hhhH", 3000, -2000, 0, 1))

        def is_set(frame):
            x, y = canopen.decode(frame.data, "ff") if frame.arbitration_id == canopen.TPDO[0] + NODE else (0, 0)
            return math.hypot(x - 3, y + 2) < 0.5

        self.master.wait(is_set)
        self.assertTrue(struct.unpack("<H", self.read(0x210F, 3))[0] & EXTERNAL_AID)

    def test_a_change_threshold_reduces_event_driven_pdos(self):
        self.master.remap(NODE, 1, [(0x2101, 1, 16), (0x210F, 1, 16)], transmission=254)
        self.start()
        self.master.collect(canopen.TPDO[0] + NODE, 50)
        self.write(0x2118, 2, struct.pack("<f", 1000.0))
        self.master.listen(0.1)
        rare = len(self.pdos(self.master.listen(1.0)))
        self.write(0x2118, 2, struct.pack("<f", 0.0))
        self.assertEqual(rare, 0)
