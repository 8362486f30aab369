#!/usr/bin/python3
# rig: -k -V -I 0x19,0x1d,0x1e,0x6b
"""The gateway on chips in an i2c-stub that measure a known motion, through /dev/i2c and through the kernel's IIO
drivers: its PDOs are compared with the replay of that motion, and faults are injected."""
import os
import pathlib
import subprocess
import time
import unittest

import numpy

import rig_tests
from rig_tests import program, rig
from rig import NODE
import canopen_master as canopen

SIGNAL = "figure"  # slow rotations through all directions, never at rest
SECONDS = 20
ANGLE_LIMIT = 0.3  # deg; a digit and a half of 12 bits of acceleration
LATE = 0.003  # s; error of a sample's time: the feeder's millisecond, and the jitter of a timer trigger
G, DEG = 9.80665, numpy.pi / 180
FORCE, RATE = slice(0, 3), slice(3, 6)
LSM303DLHC_DIGIT, LSM303D_DIGIT = 0.004 * G, 0.000244 * G  # m/s^2 at 8 g: 12 bits, 16 bits
L3GD20_DIGIT = 0.07 * DEG  # rad/s at 2000 deg/s

BUS = next(path.parent.name for path in pathlib.Path("/sys/class/i2c-dev").glob("*/name")
           if "SMBus stub" in path.read_text())
NODES = pathlib.Path("/sys/bus/i2c/devices", BUS)
DEVICE = "/dev/" + BUS


class Feeder:
    """i2c_feed on the stub, without noise."""

    def __init__(self, board):
        self.process = subprocess.Popen([program("i2c_feed"), "-n", "-b", board, "-s", SIGNAL, DEVICE],
                                        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)
        self.start_us = int(self.process.stdout.readline().split()[1])

    def tell(self, line):
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def close(self):
        self.process.communicate("quit\n", timeout=10)


class Motion:
    """The ideal motion, sampled at 1 kHz."""

    def __init__(self):
        log = rig.run("imu9-sim", "-s", "ideal", "-r", "1000", "-d", SECONDS + 15, SIGNAL)
        table = numpy.genfromtxt(log.stdout.splitlines(), delimiter=",", skip_header=1)
        self.t, gyro, accel, self.mag = table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7:10]
        self.values = numpy.hstack([accel, gyro])

    @staticmethod
    def between(t, known, values):
        return numpy.stack([numpy.interp(t, known, column) for column in values.T], axis=-1)

    def at(self, t):
        return self.between(t, self.t, self.values)

    def bounds(self, t):
        """The minimum and maximum of each value within LATE of t."""
        near = numpy.stack([self.at(t + late) for late in numpy.linspace(-LATE, LATE, 13)])
        return near.min(axis=0), near.max(axis=0)

    def replay(self, t):
        """The output of imu9-replay for samples at these times."""
        values, mag = self.at(t), self.between(t, self.t, self.mag)
        rows = ["t,gx,gy,gz,ax,ay,az,mx,my,mz"]
        rows += [",".join("%.9g" % x for x in (t[i], *values[i, RATE], *values[i, FORCE], *mag[i]))
                 for i in range(len(t))]
        out = rig.run("imu9-replay", rig.written("\n".join(rows) + "\n", ".imu.csv")).stdout
        names = out[:out.index("\n")].split(",")
        table = numpy.genfromtxt(out.splitlines(), delimiter=",", skip_header=1)
        return {what: table[:, [names.index(name) for name in columns.split()]] for what, columns in (
            ("angles", "roll pitch yaw"), ("rate", "wl ws wt"), ("acceleration", "al as at"))}


class Sensor(unittest.TestCase):
    """Tests for each way to the chips; the subclasses define it."""

    def setUp(self):
        self.feeder = Feeder(self.board)
        self.addCleanup(self.feeder.close)
        self.bind()
        self.master = rig.open_master()
        self.addCleanup(self.master.close)
        calibrated = ["sensor_calibration.%s=1" % sensor for sensor in ("gyro", "accelerometer", "magnetometer")]
        self.gateway = rig.Gateway(*("--set=" + each for each in calibrated), imu=self.source)  # but for their digits
        self.addCleanup(self.end)
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP, 10)
        time.sleep(1)  # the sample clocks are locked, the filters have settled
        self.master.drain()

    def bind(self):
        pass

    def end(self):
        self.assertEqual(self.gateway.end(), 0)

    def map(self):
        """Each sample: TPDO1 acceleration, 2 angles, 4 status and time; 5 to 7 force and rate."""
        words = [(0x2107, sub, 32) for sub in (1, 2, 3)] + [(0x2105, sub, 32) for sub in (1, 2, 3)]
        for number in (1, 2, 4):
            self.master.remap(NODE, number, None, transmission=254)
        for i, number in enumerate((5, 6, 7)):
            self.master.download(NODE, 0x1800 + number - 1, 1, (0x80000000 | self.extra(number)).to_bytes(4, "little"))
            self.master.remap(NODE, number, words[2 * i:2 * i + 2], transmission=254)

    @staticmethod
    def extra(number):
        return 0x190 + (number - 5) * 0x100 + NODE  # 190h, 290h, 390h + node: not used otherwise here

    def record(self):
        """Times of the motion [s], force and rate, angles [deg]; one row for each sample with all its PDOs."""
        self.map()
        self.master.nmt(canopen.START, NODE)
        dump = subprocess.run(["timeout", str(SECONDS), "candump", "-L", rig.BUS], capture_output=True,
                              text=True).stdout
        self.master.nmt(canopen.PRE_OPERATIONAL, NODE)
        self.assertEqual([line for line in dump.splitlines() if " %03X#" % (canopen.EMCY + NODE) in line], [])
        rows, sample = [], {}
        for line in dump.splitlines():
            can_id, data = line.split()[2].split("#")
            sample[int(can_id, 16)] = bytes.fromhex(data)
            if int(can_id, 16) != self.extra(7):
                continue
            if set(self.carried()) <= set(sample):
                rows.append(self.row([sample[each] for each in self.carried()]))
            sample = {}
        table = numpy.array(rows)
        return table[:, 0], table[:, 1:7], table[:, 7:10], table[:, 10:13]

    def carried(self):
        return [canopen.TPDO[n] + NODE for n in (0, 1, 3)] + [self.extra(n) for n in (5, 6, 7)]

    def row(self, data):
        *acceleration, first = canopen.decode(data[0], "hhhH")
        *angles, second = canopen.decode(data[1], "hhhH")
        status, third, us = canopen.decode(data[2], "HHI")
        self.assertEqual((first, status & 1), (second, 1))
        self.assertEqual(first, third)
        return [(us - self.feeder.start_us) % (1 << 32) * 1e-6, *sum((canopen.decode(d, "ff") for d in data[3:]), ()),
                *[0.01 * x for x in angles], *[0.005 * x for x in acceleration]]

    def test_what_is_on_the_bus_is_the_replay_of_the_motion_within_the_chips_digits(self):
        t, values, angles, acceleration = self.record()
        self.assertGreater(t[-1] - t[0], SECONDS - 1)
        self.assertLess(numpy.diff(t).max(), 0.025)
        settled = t > t[0] + 3  # the gateway's filters started before the replay's
        motion = Motion()
        low, high = motion.bounds(t)
        beyond = numpy.maximum(numpy.maximum(low - values, values - high), 0)[:, FORCE].max() / self.force_digit
        replay = motion.replay(t)
        rate_off = numpy.abs(values[:, RATE] - replay["rate"])[settled] / self.rate_digit
        turned = numpy.abs((angles - replay["angles"] + 180) % 360 - 180)[settled]
        force_off = numpy.abs(acceleration - replay["acceleration"])[settled]
        self.note = ("%d samples at %.1f Hz; force %.2f digits beyond the motion at most, rate %.2f RMS %.2f at most; "
                     "angles %s deg RMS, %s at most; acceleration %.3f m/s^2 RMS, %.3f at most" % (
                         len(t), (len(t) - 1) / (t[-1] - t[0]), beyond, numpy.sqrt((rate_off ** 2).mean()),
                         rate_off.max(), numpy.sqrt((turned ** 2).mean(axis=0)).round(2), turned.max(axis=0).round(2),
                         numpy.sqrt((force_off ** 2).mean()), force_off.max()))
        self.assertLess(beyond, 0.52, self.note)
        self.assertLess(numpy.sqrt((rate_off ** 2).mean()), 1, self.note)
        self.assertLess(turned.max(), ANGLE_LIMIT, self.note)
        self.assertLess(force_off.max(), self.force_digit / 2 + ANGLE_LIMIT * DEG * G + 0.05, self.note)

    def wait_for_emergency(self, code, seconds=3):
        self.master.wait(lambda f: f.arbitration_id == canopen.EMCY + NODE and canopen.emergency(f)[0] == code, seconds)


class I2cOf12Bits(Sensor):
    board, source = "v2", "i2c:%s,stub" % DEVICE
    force_digit, rate_digit = LSM303DLHC_DIGIT, L3GD20_DIGIT


class I2cOf16Bits(I2cOf12Bits):
    board, force_digit = "v3", LSM303D_DIGIT


class Iio(Sensor):
    board, source = "v2", "iio"
    force_digit, rate_digit = 4 * LSM303DLHC_DIGIT, L3GD20_DIGIT  # the kernel's driver uses 10 bits
    chips = {"l3gd20": "0x6b", "lsm303dlhc_accel": "0x19", "lsm303dlhc_magn": "0x1e"}

    def bind(self):
        if not os.path.ismount("/sys/kernel/config"):
            rig_tests.shell("mount", "-t", "configfs", "none", "/sys/kernel/config")
        for name in self.chips:
            self.plug(name)
            self.addCleanup(self.unplug, name)

    def plug(self, name):
        (NODES / "new_device").write_text("%s %s\n" % (name, self.chips[name]))

    def unplug(self, name):
        (NODES / "delete_device").write_text(self.chips[name] + "\n")


    def test_a_chip_that_vanishes_is_told_and_taken_again_when_it_is_back(self):
        for name in ("l3gd20", "lsm303dlhc_accel"):
            self.unplug(name)
            self.wait_for_emergency(0x5030)
            self.plug(name)
            self.wait_for_emergency(0)
            self.assertEqual(self.master.upload(NODE, 0x2124, 1), b"\0")

    def test_without_the_magnetometer_samples_go_on_and_it_is_taken_again(self):
        self.unplug("lsm303dlhc_magn")
        self.wait_for_emergency(0x5031)
        self.master.nmt(canopen.START, NODE)
        self.plug("lsm303dlhc_magn")
        self.wait_for_emergency(0, 10)

    def test_chips_that_lost_their_configuration_are_set_up_again(self):
        self.feeder.tell("brownout gyro")
        self.wait_for_emergency(0x5030)
        self.wait_for_emergency(0)

    def test_the_gateway_leaves_no_trigger_behind(self):
        triggers = pathlib.Path("/sys/kernel/config/iio/triggers/hrtimer")
        self.assertEqual(len(list(triggers.iterdir())), 2)
        self.end()
        self.assertEqual(list(triggers.iterdir()), [])
        self.gateway.start()  # stopped by the clean-up
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP, 10)

    def test_without_a_trigger_it_is_polled(self):
        self.end()
        rig_tests.shell("umount", "/sys/kernel/config")
        self.gateway.start()
        rig.wait_until(lambda: "polled at" in self.gateway.log)
        time.sleep(2)
        self.assertNotIn("EMCY", self.gateway.log)
        self.note = self.gateway.log.split("polled at")[1].split("\n")[0]


del Sensor  # only its subclasses run

if __name__ == "__main__":
    rig_tests.main()
