"""What went over a real bus, and what imu9-replay makes of the recording: the same frames. IMU9_RECORD_SECONDS makes it
longer, e.g. an hour in the virtual time of the rig's kernel."""
import os
import struct
import unittest

import canopen_master as canopen
import rig
from rig import NODE, u8, u16, u32

SECONDS = float(os.environ.get("IMU9_RECORD_SECONDS", 30))
OURS = [canopen.EMCY + NODE, canopen.SDO_TX + NODE, canopen.HEARTBEAT + NODE] + [pdo + NODE for pdo in canopen.TPDO]


def a_log_in_which_the_sensor_is_lost(seconds):
    """In every 10 s there is nothing for 2 s."""
    lines = rig.run("imu9-sim", "tumble", "-d", seconds).stdout.splitlines()
    rows = []
    for line in lines[1:]:
        t, rest = line.split(",", 1)
        if float(t) % 10 < 8:
            rows.append("%s,%s" % (t, rest))
    return rig.written("\n".join(lines[:1] + rows) + "\n", ".imu.csv")


class ARecording(unittest.TestCase):
    def setUp(self):
        self.folder = rig.scratch(".record")
        self.log = a_log_in_which_the_sensor_is_lost(SECONDS + 60)
        self.master = rig.open_master(own_frames=False)
        self.addCleanup(self.master.close)

    def start(self, *args):
        gateway = rig.Gateway("--record", "%s,size=2,files=500" % self.folder, *args, imu="replay:%s" % self.log)
        self.addCleanup(gateway.close)
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP)
        self.master.nmt(canopen.START, NODE)
        return gateway

    def syncs(self, seconds):
        for _ in range(int(seconds * 20)):
            self.master.send(canopen.SYNC)
            self.master.listen(0.05)

    def write(self, index, sub, data):
        self.master.download(NODE, index, sub, data)

    def work(self, seconds):
        """Configuration changes and aids, over and over."""
        for n in range(max(1, int(seconds / 10))):
            self.syncs(2)
            self.write(0x2000, 1, struct.pack("<f", 0.01 * (n % 10)))
            self.syncs(1)
            self.write(0x2148, 0, u8(1 + n % 4))
            for i in range(20):
                self.master.send(0x200 + NODE, struct.pack("<hhhH", 10 * i, 0, 0, 50))
                self.master.send(0x300 + NODE, struct.pack("<ff", i, 2))
                self.syncs(0.1)
            self.write(0x1803, 2, u8(254))
            self.syncs(2)
            self.write(0x1803, 2, u8(1))
            self.write(0x2073, 0, u16(n % 8))
            self.master.upload(NODE, 0x1008, 0)
            if n % 3 == 1:
                self.write(0x1010, 1, canopen.SAVE)
                self.write(0x1016, 1, u32(5 << 16 | 700))
                self.master.send(canopen.HEARTBEAT + 5, b"\x05")
            self.syncs(2)
            if n % 3 == 2:
                self.master.nmt(canopen.RESET_NODE, NODE)
                self.master.wait_state(NODE, canopen.STATE_BOOT_UP)
            self.master.nmt(canopen.START, NODE)

    def test_replayed_has_every_frame_that_was_on_the_bus(self):
        gateway = self.start()
        self.work(SECONDS / 2)
        self.assertEqual(gateway.end(), 0)
        gateway = self.start("--set", "lever_arm.l=0.02")  # another process goes on in the folder
        self.work(SECONDS / 2)
        self.assertEqual(gateway.end(), 0)
        self.master.listen(0.5)

        frames = rig.scratch(".log")
        files = sorted(self.folder.glob("imu9-*.imu.csv"), key=lambda path: path.name[:11])
        result = rig.run("imu9-replay", "--frames", frames, *files)
        self.assertEqual((result.returncode, result.stderr), (0, ""))
        there = ["%03X#%s" % (f.arbitration_id, f.data.hex().upper()) for f in self.master.frames
                 if f.arbitration_id in OURS]
        again = [line.split()[2] for line in frames.read_text().splitlines()]
        self.assertGreater(len(there), 40 * SECONDS)
        self.assertEqual([(i, a, b) for i, (a, b) in enumerate(zip(there, again)) if a != b][:5], [])
        self.assertEqual(len(there), len(again))
        codes = {f.data[:2].hex() for f in self.master.frames if f.arbitration_id == canopen.EMCY + NODE}
        self.assertIn("3050", codes)  # 5030h: the sensor was lost
        self.note = "%d frames, %d files" % (len(there), len(files))


if __name__ == "__main__":
    unittest.main()
