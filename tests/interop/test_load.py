"""A sensor with 1000 samples a second, and all eight TPDOs full: nothing is lost. IMU9_LOAD_SAMPLES=60000 counts a
minute of them."""
import json
import os
import struct
import unittest

import canopen_master as canopen
import rig
from rig import NODE, u8, u32

SAMPLES = int(os.environ.get("IMU9_LOAD_SAMPLES", 2000))
COB_IDS = [*canopen.TPDO, *(cob_id + 0x40 for cob_id in canopen.TPDO)]
VECTORS = 0x2100, 0x2101, 0x2102, 0x2141, 0x2142, 0x2143, 0x2144, 0x2145
COUNTER, VALID = 0x210F0110, 1 << 31


@unittest.skipUnless(rig.SIMULATED_TIME,
                     "in real time a machine may be too busy for 1000 samples a second; make rig")
class ThousandHertz(rig.OnTheBus):
    imu = "sim:rest,board=icm42688,rate=1000"

    def map_all(self, transmission_type):
        """Each with a vector and the counter of its sample: 8 bytes."""
        for i, (cob_id, vector) in enumerate(zip(COB_IDS, VECTORS)):
            communication, mapping = 0x1800 + i, 0x1A00 + i
            self.write(communication, 1, u32(VALID | cob_id + NODE))
            self.write(communication, 2, u8(transmission_type))
            self.write(mapping, 0, u8(0))
            for sub in (1, 2, 3):
                self.write(mapping, sub, u32(vector << 16 | sub << 8 | 16))
            self.write(mapping, 4, u32(COUNTER))
            self.write(mapping, 0, u8(4))
            self.write(communication, 1, u32(cob_id + NODE))

    def test_eight_tpdos_of_every_sample_are_on_the_bus(self):
        self.map_all(255)
        for index in (0x2149, 0x2151, 0x2152, 0x2153, 0x214B):
            self.write(index, 1, u32(0))
        self.start()
        counters = {cob_id + NODE: [] for cob_id in COB_IDS}
        while min(map(len, counters.values())) < SAMPLES:
            frame = self.master.receive(rig.PATIENCE)
            self.assertIsNotNone(frame)
            if frame.arbitration_id in counters:
                counters[frame.arbitration_id].append(struct.unpack_from("<H", frame.data, 6)[0])
            self.master.frames.clear()
        first = counters[COB_IDS[0] + NODE][0]
        for cob_id, seen in counters.items():
            self.assertEqual(seen[:SAMPLES], [first + k & 0xFFFF for k in range(SAMPLES)], "%03Xh" % cob_id)
        self.master.nmt(canopen.PRE_OPERATIONAL, NODE)
        self.master.drain()
        self.assertEqual(self.read(0x2120, 4), u32(0))  # frames lost
        found = json.loads(rig.run("imu9-bench", "-i", self.bus, "-n", NODE, "--json").stdout)["histograms"]
        self.note = "us: " + ", ".join("%(name)s median %(median)g, 99.9 %% %(p999)g, maximum %(maximum)g" % h
                                       for h in found if h["count"])
