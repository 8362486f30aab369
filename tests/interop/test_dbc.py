"""imu9-sdo dbc: frames on the bus decoded by it have the values that SDO reads. Also loaded by cantools, if
installed."""
import re
import struct
import time
import unittest

import canopen_master as canopen
import rig
from rig import NODE

SIGNAL = re.compile(r' SG_ (\w+) : (\d+)\|(\d+)@1([+-]) \(([^,]+),0\) \[([^|]+)\|([^\]]+)\] "([^"]*)" (\w+)')


class Dbc:
    """What this test needs of a DBC: little-endian signals without multiplexing."""

    def __init__(self, text):
        self.text, self.messages = text, {}
        for block in re.findall(r"(?m)^BO_ (?:.+\n)(?: SG_ .+\n)+", text):
            head, *lines = block.splitlines()
            can_id, name, length, sender = re.fullmatch(r"BO_ (\d+) (\w+): (\d+) (\w+)", head).groups()
            signals = {}
            for line in lines:
                match = SIGNAL.fullmatch(line)
                assert match and match[1] not in signals and len(match[1]) <= 32, line
                signals[match[1]] = (int(match[2]), int(match[3]), match[4] == "-", float(match[5]), match[8])
            self.messages[int(can_id)] = (name, int(length), sender, signals)
        self.values = {(int(i), s): dict((int(n), t) for n, t in re.findall(r'(\d+) "([^"]*)"', rest))
                       for i, s, rest in re.findall(r"(?m)^VAL_ (\d+) (\w+)((?: \d+ \"[^\"]*\")+) ;$", text)}
        self.reals = {(int(i), s) for i, s in re.findall(r"(?m)^SIG_VALTYPE_ (\d+) (\w+) : 1;$", text)}

    def decode(self, can_id, data):
        raw, result = int.from_bytes(data, "little"), {}
        for name, (start, bits, signed, factor, _) in self.messages[can_id][3].items():
            value = raw >> start & (1 << bits) - 1
            if (can_id, name) in self.reals:
                result[name] = struct.unpack("<f", struct.pack("<I", value))[0]
                continue
            result[name] = (value - (1 << bits) if signed and value >> bits - 1 else value) * factor
        return result


class LiveDbc(rig.OnTheBus):
    def dbc(self):
        done = rig.run("imu9-sdo", "-i", self.bus, "-n", NODE, "dbc")
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        return Dbc(done.stdout)

    def pdo_of_sync(self, can_id):
        self.master.drain()
        self.master.send(0x80, b"")
        return self.master.wait(lambda f: f.arbitration_id == can_id).data

    def map(self, number, *objects):
        cob_id = canopen.TPDO[number - 1] + NODE
        self.write(0x1800 + number - 1, 1, struct.pack("<I", 1 << 31 | cob_id))
        self.write(0x1A00 + number - 1, 0, b"\0")
        for sub, (index, entry, bits) in enumerate(objects, 1):
            self.write(0x1A00 + number - 1, sub, struct.pack("<I", index << 16 | entry << 8 | bits))
        self.write(0x1A00 + number - 1, 0, bytes([len(objects)]))
        self.write(0x1800 + number - 1, 1, struct.pack("<I", cob_id))

    def test_each_signal_has_a_place_of_its_own_within_its_message(self):
        dbc = self.dbc()
        self.assertEqual(sorted(dbc.messages), sorted(
            [canopen.TPDO[n] + NODE for n in range(4)] + [0x200 + 0x100 * n + NODE for n in range(4)] +
            [0x80 + NODE, 0x700 + NODE]))
        for name, length, _, signals in dbc.messages.values():
            taken = set()
            for signal, (start, bits, *_) in signals.items():
                place = set(range(start, start + bits))
                self.assertFalse(place & taken or start + bits > 8 * length, "%s of %s" % (signal, name))
                taken |= place
        for can_id, signal in list(dbc.values) + list(dbc.reals):
            self.assertIn(signal, dbc.messages[can_id][3])

    def test_a_frame_has_the_values_that_sdo_reads_with_mapping_and_resolution_as_they_are(self):
        self.map(1, (0x2101, 1, 16), (0x2109, 3, 32), (0x210F, 1, 16))
        self.write(0x6000, 0, struct.pack("<H", 100))  # steps of 0.1 deg
        self.addCleanup(self.reset, canopen.RESET_NODE)
        dbc = self.dbc()
        self.start()
        can_id = canopen.TPDO[0] + NODE
        name, length, _, signals = dbc.messages[can_id]
        self.assertEqual((name, length, list(signals)), (
            "TPDO1", 8, ["angles_roll", "acceleration_object_t", "sample_counter"]))
        self.assertEqual((signals["angles_roll"][3:]), (0.1, "deg"))
        data = self.pdo_of_sync(can_id)
        decoded = dbc.decode(can_id, data)
        roll, real, counter = struct.unpack("<hfH", data)
        self.assertEqual(decoded, {"angles_roll": roll * 0.1, "acceleration_object_t": real, "sample_counter": counter})

    def test_the_bits_of_the_status_are_signals_with_texts(self):
        dbc = self.dbc()
        self.start()
        can_id = canopen.TPDO[3] + NODE
        data = self.pdo_of_sync(can_id)
        while not data[0] & 1:  # no sample yet
            time.sleep(0.02)
            data = self.pdo_of_sync(can_id)
        decoded, status = dbc.decode(can_id, data), struct.unpack_from("<H", data)[0]
        bits = [name for name in dbc.messages[can_id][3] if name.startswith("status_")]
        self.assertEqual(len(bits), 15)
        self.assertEqual(sum(int(decoded[name]) << n for n, name in enumerate(bits)), status)
        self.assertEqual(decoded["status_valid"], 1)
        self.assertTrue(all(dbc.values[can_id, name] == {0: "no", 1: "yes"} for name in bits))
        self.assertEqual(dbc.values[0x700 + NODE, "nmt_state"][5], "operational")
        self.assertIn(0x8130, dbc.values[0x80 + NODE, "emcy_error_code"])

    def test_an_object_mapped_twice_and_one_that_is_not_valid(self):
        self.map(2, (0x210F, 1, 16), (0x210F, 1, 16))
        self.write(0x1802, 1, struct.pack("<I", 0x80000000 | canopen.TPDO[2] + NODE))
        dbc = self.dbc()
        self.assertEqual(list(dbc.messages[canopen.TPDO[1] + NODE][3]), ["sample_counter", "sample_counter_2"])
        self.assertNotIn(canopen.TPDO[2] + NODE, dbc.messages)

    def test_cantools_loads_it(self):
        try:
            import cantools
        except ImportError:
            raise unittest.SkipTest("cantools is not installed")
        database = cantools.database.load_string(self.dbc().text, "dbc", strict=True)
        self.assertEqual(len(database.messages), 10)


if __name__ == "__main__":
    unittest.main()
