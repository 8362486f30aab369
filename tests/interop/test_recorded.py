"""Recorded IMU data through the gateway and a CAN bus, compared with imu9-replay of the same log."""
import csv
import math
import struct
import time
import unittest

import canopen_master as canopen
import rig
from rig import NODE

ACCELERATION_LSB, ANGLE_LSB, POSITION_LSB = 0.005, 0.01, 0.001  # m/s^2, deg, m: the defaults of 2110h and 6000h
PRINTED = 1e-5  # resolution of imu9-replay's output and of REAL32


def replayed(log, *args, rows=None):
    """The rows of imu9-replay, [{column: number}]; the index in the list is the sample counter."""
    result = rig.run("imu9-replay", *args, log)
    assert result.returncode == 0, result.stderr
    table = []
    for row in csv.DictReader(result.stdout.splitlines()[:None if rows is None else rows + 1]):
        table.append({name: float(text) for name, text in row.items()})
        assert table[-1]["sample"] == len(table) - 1
    return table


def angles(row):
    """Roll, pitch, yaw [deg], z-y'-x'', from the replay's quaternion."""
    w, x, y, z = (row[name] for name in ("qw", "qx", "qy", "qz"))
    return [math.degrees(angle) for angle in (
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(max(-1, min(1, 2 * (w * y - z * x)))),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))]


def expected(row):
    """The values of TPDO1, 2 and 3 for this row: [(values, resolution)]."""
    return [
        ([row[name] for name in ("al", "as", "at")], ACCELERATION_LSB),
        (angles(row), ANGLE_LSB),
        ([row[name] for name in ("px", "py", "pz")], POSITION_LSB),
    ]


def off_by(number, value, lsb):
    """Difference between the integer on the bus and the value, in LSB; 0 if the integer is saturated as it must be."""
    if abs(value) > 32767.5 * lsb:
        return 0 if number == (32767 if value > 0 else -32768) else math.inf
    return abs(number - value / lsb)


class ARecordedTrial(unittest.TestCase):
    SECONDS, SYNC_HZ = 30, 100

    def test_every_pdo_value_equals_the_replay_for_30_s_of_sync_at_100_hz(self):
        log = rig.recorded("09_")
        rows = replayed(log, rows=60 * 290)
        master = rig.open_master()
        self.addCleanup(master.close)
        gateway = rig.Gateway(imu="replay:%s" % log)
        self.addCleanup(gateway.close)
        master.wait_state(NODE, canopen.STATE_BOOT_UP)
        master.nmt(canopen.START, NODE)
        master.drain()
        self.produce_sync(master)
        self.check(master.frames, rows)

    def produce_sync(self, master):
        start = time.monotonic()
        for i in range(self.SECONDS * self.SYNC_HZ):
            master.listen(start + i / self.SYNC_HZ - time.monotonic())
            master.sync()
            if i % 10 == 5:  # SDO traffic beside the PDOs
                self.assertEqual(master.upload(NODE, 0x1008), b"IMU9 CANopen gateway")
        master.listen(0.5)

    def check(self, frames, rows):
        syncs = [f for f in frames if f.arbitration_id == canopen.SYNC]
        pdos = [[f for f in frames if f.arbitration_id == cob_id + NODE] for cob_id in canopen.TPDO]
        wanted = self.SECONDS * self.SYNC_HZ
        self.assertEqual([len(syncs)] + [len(p) for p in pdos], [wanted] * 5, "SYNCs and the four PDOs of each")

        worst = [0, 0, 0]
        previous = -1
        for first, second, third, fourth in zip(*pdos):
            status, number, t_us = canopen.decode(fourth.data, "HHI")
            self.assertGreaterEqual(number, previous)
            previous = number
            row = rows[number]
            self.assertEqual(status & 0x301, 1, "valid, not saturated, sensor there")
            self.assertAlmostEqual(t_us * 1e-6, row["t"], delta=1e-6)
            for i, (frame, (values, lsb)) in enumerate(zip((first, second, third), expected(row))):
                *integers, counter = canopen.decode(frame.data, "hhhH")
                self.assertEqual(counter, number, "all PDOs of one SYNC carry one sample")
                worst[i] = max([worst[i]] + [off_by(n, v, lsb) for n, v in zip(integers, values)])
        for error, lsb in zip(worst, (ACCELERATION_LSB, ANGLE_LSB, POSITION_LSB)):
            self.assertLessEqual(error, 0.5 + PRINTED / lsb)

        delays = sorted(f.timestamp - s.timestamp for s, f in zip(syncs, pdos[3]))
        self.note = "%d SYNCs, 0 lost; SYNC to the last of its PDOs: median %.2f ms, p99 %.2f ms, max %.2f ms; " \
            "worst error %.3f LSB" % (wanted, 1e3 * delays[wanted // 2], 1e3 * delays[wanted * 99 // 100],
                                      1e3 * delays[-1], max(worst))


class TheLeverArm(unittest.TestCase):
    """A lever arm written by SDO changes the acceleration of the next sample by the rigid-body terms, and nothing
    else."""

    ARM = (0.8, -0.5, 0.3)

    def setUp(self):
        self.log = self.moving_part(rig.recorded("09_"))
        self.master = rig.open_master()
        self.addCleanup(self.master.close)
        # with a fusion that does not use the lever arm all later samples can be compared, not only the next one
        # four PDOs for each sample: 572 a second
        self.gateway = rig.Gateway("--set", "fusion.algorithm=0", imu="replay:%s,speed=0.5" % self.log)
        self.addCleanup(self.gateway.close)
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP)

    @staticmethod
    def moving_part(log):
        """Four seconds of the trial with fast rotation."""
        lines = log.read_text().splitlines()
        samples = [[float(x) for x in line.split(",")[1:4]] for line in lines[1:20000]]
        start = next(i for i, gyro in enumerate(samples) if math.hypot(*gyro) > 3) - 200
        return rig.written("\n".join([lines[0]] + lines[1 + start:1 + start + 4 * 286]) + "\n", ".imu.csv")

    @staticmethod
    def rigid_body(omega, alpha, r):
        """alpha x r + omega x (omega x r)"""
        def cross(a, b):
            return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
        return [a + b for a, b in zip(cross(alpha, r), cross(omega, cross(omega, r)))]

    def test_the_next_sample_has_alpha_x_r_plus_omega_x_omega_x_r(self):
        # event-driven PDOs for each sample: acceleration and counter; angular rate and acceleration in three PDOs
        self.master.remap(NODE, 1, None, transmission=254)
        for number, entries in ((2, [(0x2105, 1, 32), (0x2105, 2, 32)]), (3, [(0x2105, 3, 32), (0x2106, 1, 32)]),
                                (4, [(0x2106, 2, 32), (0x2106, 3, 32)])):
            self.master.remap(NODE, number, entries, transmission=254)
        self.master.drain()
        self.master.nmt(canopen.START, NODE)
        self.master.listen(2.0)
        for i, metres in enumerate(self.ARM):
            self.master.download(NODE, 0x2000, 1 + i, struct.pack("<f", metres))
            self.master.listen(0.3)
        self.check(self.master.frames, replayed(self.log, "--set", "fusion.algorithm=0"))

    @staticmethod
    def samples(frames):
        """For each sample: the number of SDO answers before it, the values of TPDO1, and those of the other three."""
        answers, pdos = 0, []
        for frame in frames:
            if frame.arbitration_id == canopen.SDO_TX + NODE:
                answers += 1
            elif frame.arbitration_id - NODE in canopen.TPDO:
                if frame.arbitration_id == canopen.TPDO[0] + NODE:
                    pdos = []
                pdos.append(frame.data)
                if len(pdos) == 4:
                    yield answers, canopen.decode(pdos[0], "hhhH"), canopen.decode(b"".join(pdos[1:]), "6f")

    def check(self, frames, without_arm):
        changes = [[] for _ in range(1 + len(self.ARM))]
        for answers, (*integers, number), rates in self.samples(frames):
            row = without_arm[number]
            for value, name in zip(rates, ("wl", "ws", "wt", "dwl", "dws", "dwt")):
                self.assertAlmostEqual(value, row[name], delta=PRINTED + 1e-6 * abs(value), msg=name)
            arm = self.ARM[:answers] + (0,) * (3 - answers)
            term = self.rigid_body(rates[:3], rates[3:], arm)
            for n, name, t in zip(integers, ("al", "as", "at"), term):
                self.assertLessEqual(
                    off_by(n, row[name] - t, ACCELERATION_LSB), 0.5 + 3 * PRINTED / ACCELERATION_LSB,
                    "%s of sample %d with the lever arm %r" % (name, number, arm))
            changes[answers].append(max(map(abs, term)))
        self.assertTrue(all(len(change) > 30 for change in changes), changes)
        first = [change[0] for change in changes[1:]]
        self.assertGreater(min(first), 10 * ACCELERATION_LSB, "the move was too slow to tell")
        self.note = "%d samples; terms in the first sample after each write: %s m/s^2" % (
            sum(map(len, changes)), ", ".join("%.2f" % change for change in first))


class TheLastMovement(unittest.TestCase):
    """The path read over the bus while the sensor moves on is the one that imu9-replay writes. A hand held it."""

    HAND_HELD = ("--set", "position.motion_preset=1")

    def test_its_trajectory_equals_that_of_the_replay(self):
        lines = rig.recorded("09_").read_text().splitlines()
        log = rig.written("\n".join(lines[:1 + 68 * 286]) + "\n", ".imu.csv")  # the first movement ends after 61 s
        path = rig.scratch(".csv")
        self.assertEqual(rig.run("imu9-replay", *self.HAND_HELD, "--movements", path, log).returncode, 0)
        with open(path) as file:
            rows = [{name: float(text) for name, text in row.items()} for row in csv.DictReader(file)]
        self.assertEqual({row["movement"] for row in rows}, {1})
        master = rig.open_master()
        self.addCleanup(master.close)
        gateway = rig.Gateway(*self.HAND_HELD, imu="replay:%s,speed=20" % log)
        self.addCleanup(gateway.close)
        master.wait_state(NODE, canopen.STATE_BOOT_UP)
        self.wait_for_it(master)
        text = master.upload(NODE, 0x2132).decode()
        table = [{name: float(number) for name, number in row.items()} for row in csv.DictReader(text.splitlines())]
        self.assertEqual(len(table), len(rows))
        for row, expected_row in zip(table, rows):
            for name, number in row.items():
                self.assertAlmostEqual(number, expected_row[name], delta=0.001 if name == "t_s" else 0.0001, msg=name)
        for sub, name in ((6, "x_m"), (7, "y_m"), (8, "z_m")):
            self.assertAlmostEqual(self.real(master, sub), rows[-1][name], delta=1e-5)
        self.note = "%d points, %.1f m in %.1f s" % (len(table), self.real(master, 3), self.real(master, 2))

    @staticmethod
    def real(master, sub):
        return struct.unpack("<f", master.upload(NODE, 0x211A, sub))[0]

    def wait_for_it(self, master):
        end = time.monotonic() + rig.PATIENCE
        while struct.unpack("<I", master.upload(NODE, 0x211A, 1))[0] == 0:
            self.assertLess(time.monotonic(), end, "no movement has ended")
            master.listen(0.1)


if __name__ == "__main__":
    unittest.main()
