"""Sources of the configuration and their precedence; messages for errors in it or in the input."""
import os
import re
import signal
import socket
import struct
import unittest

import canopen_master as canopen
import rig
from rig import NODE

HEADER = "t,gx,gy,gz,ax,ay,az,mx,my,mz\n"


def log_of(*rows):
    return rig.written(HEADER + "".join(row + "\n" for row in rows), ".imu.csv")


def row(k, magnetometer=",0,20,-40"):
    return "%.2f,0,0,0,0,0,9.81%s" % (k * 0.01, magnetometer)


class ARunningGateway(unittest.TestCase):
    def start(self, *args, **options):
        self.master = rig.open_master()
        self.addCleanup(self.master.close)
        self.gateway = rig.Gateway(*args, **options)
        self.addCleanup(self.gateway.close)
        self.boot_up()

    def boot_up(self):
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP)

    def real(self, index, sub=0):
        return struct.unpack("<f", self.master.upload(NODE, index, sub))[0]


class Precedence(ARunningGateway):
    def test_precedence_is_default_file_command_line_stored_value(self):
        file = rig.written("[lever_arm]\nl = 0.1\ns = 0.1\nt = 0.1\n[gateway]\nnode_id = 99\n")
        self.start("-c", file, "--set", "lever_arm.s=0.2", "--set", "lever_arm.t=0.2")
        self.assertAlmostEqual(self.real(0x2003), 9.81, places=6)  # default
        self.assertAlmostEqual(self.real(0x2000, 1), 0.1, places=6)  # file
        self.assertAlmostEqual(self.real(0x2000, 2), 0.2, places=6)  # command line
        self.master.download(NODE, 0x2000, 3, struct.pack("<f", 0.3))
        self.master.download(NODE, 0x1010, 1, canopen.SAVE)
        self.gateway.end()
        self.gateway.start()
        self.boot_up()
        for sub, metres in ((1, 0.1), (2, 0.2), (3, 0.3)):  # stored
            self.assertAlmostEqual(self.real(0x2000, sub), metres, places=6)

    def test_objects_can_be_named_with_and_without_section(self):
        self.start("-c", rig.written("lever_arm.l = 0.1\nrates_from = 1\nLever Arm.s = 0.2\n[lever_arm]\nt = 0.3\n"))
        for sub, metres in ((1, 0.1), (2, 0.2), (3, 0.3)):
            self.assertAlmostEqual(self.real(0x2000, sub), metres, places=6)
        self.assertEqual(self.master.upload(NODE, 0x2002), b"\x01")


class Reload(ARunningGateway):
    """SIGHUP."""

    def hang_up(self, text):
        self.file.write_text(text)
        before = self.gateway.log.count("reading the configuration again")
        self.gateway.process.send_signal(signal.SIGHUP)
        rig.wait_until(lambda: self.gateway.log.count("reading the configuration again") > before)

    def setUp(self):
        self.file = rig.written("[lever_arm]\nl = 0.1\n")
        self.start("-c", self.file)

    def test_what_changed_is_applied_and_what_needs_a_restart_is_told(self):
        self.hang_up("[gateway]\nbitrate = 250000\n[lever_arm]\nl = 0.2\n")
        rig.wait_until(lambda: "snapshot of 1 entries applied" in self.gateway.log)
        self.assertAlmostEqual(self.real(0x2000, 1), 0.2, places=6)
        self.assertRegex(self.gateway.log, "bitrate: not changed: a restart is needed")
        self.assertNotIn("node_id", self.gateway.log)

    def test_a_wrong_file_changes_nothing(self):
        self.hang_up("[lever_arm]\nl = 0.2\nx = 1\n")
        rig.wait_until(lambda: "not changed" in self.gateway.log)
        self.assertIn("%s:3: " % self.file, self.gateway.log)
        self.assertAlmostEqual(self.real(0x2000, 1), 0.1, places=6)

    def test_the_log_level_is_applied(self):
        self.hang_up("[gateway]\nlog_level = error\n[lever_arm]\nl = 0.1\n")
        self.master.nmt(canopen.START, NODE)
        self.master.wait_state(NODE, canopen.STATE_OPERATIONAL)
        self.assertNotIn("NMT state: operational", self.gateway.log)


class Libraries(ARunningGateway):
    def test_libiio_and_what_it_needs_are_loaded_for_iio_only(self):
        self.start()
        with open("/proc/%d/maps" % self.gateway.process.pid) as maps:
            loaded = maps.read()
        self.assertIn("libc.so", loaded)
        self.assertNotRegex(loaded, "libiio|libxml2|libicu|libavahi|libdbus|libsystemd")


class Service(ARunningGateway):
    """A service manager with a watchdog of half a second, as the environment of sd_notify(3) tells it."""

    def test_it_tells_when_it_is_ready_gives_signs_of_life_and_tells_when_it_stops(self):
        manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.addCleanup(manager.close)
        path = rig.scratch(".notify")
        manager.bind(str(path))
        manager.settimeout(60)
        os.environ.update(NOTIFY_SOCKET=str(path), WATCHDOG_USEC="500000")
        try:
            self.start()
        finally:
            del os.environ["NOTIFY_SOCKET"], os.environ["WATCHDOG_USEC"]
        messages = [manager.recv(1000) for _ in range(4)]
        self.assertTrue([m for m in messages if m.startswith(b"READY=1\nSTATUS=sim:square")], messages)
        self.assertGreaterEqual(messages.count(b"WATCHDOG=1"), 3)
        self.gateway.end()
        while messages[-1] != b"STOPPING=1":
            messages.append(manager.recv(1000))


class BadInput(unittest.TestCase):
    """Status 2 for wrong usage or configuration, 1 for missing files and devices; one line that names the cause and
    says what to do."""

    def refused(self, status, pattern, *args):
        result = rig.run("imu9-gateway", *args)
        self.assertEqual(result.returncode, status, result.stderr)
        self.assertRegex(result.stderr, re.compile(pattern, re.S))
        self.assertRegex(result.stderr, "^imu9-gateway: ")
        self.assertEqual(result.stdout, "")

    def file_refused(self, line, pattern, text):
        path = rig.written(text)
        self.refused(2, re.escape("%s:%d: " % (path, line)) + ".*" + pattern, "-c", path)

    def test_an_unknown_option(self):
        self.refused(2, "frobnicate", "--frobnicate")

    def test_an_argument_that_is_not_an_option(self):
        self.refused(2, "'stray'.*--help", "stray")

    def test_an_option_without_its_value(self):
        self.refused(2, "can", "--can")

    def test_an_unknown_key_names_its_line_and_the_known_ones(self):
        self.file_refused(3, "'nodeid'.*node_id", "# a comment\n[gateway]\nnodeid = 3\n")

    def test_an_unknown_object_names_its_line(self):
        self.file_refused(2, "lever_arm.x", "[lever_arm]\nx = 3\n")

    def test_a_value_beyond_the_limits_names_its_line_and_the_limits(self):
        self.file_refused(1, "-10 to 10 m", "lever_arm.l = 11\n")

    def test_a_value_that_is_not_a_number_names_its_line(self):
        self.file_refused(1, "lever_arm.l = abc", "lever_arm.l = abc\n")
        self.file_refused(1, "lever_arm.l", "lever_arm.l = nan\n")

    def test_a_line_that_is_neither_section_nor_key_names_its_line(self):
        self.file_refused(2, ".", "lever_arm.l = 0\nwhat is this\n")

    def test_an_object_that_is_not_configuration_is_refused(self):
        self.file_refused(1, "not a configuration object", "acceleration.l = 1\n")

    def test_a_missing_configuration_file(self):
        self.refused(2, "/no/such/file.*No such file", "-c", "/no/such/file")

    def test_an_unknown_object_on_the_command_line(self):
        self.refused(2, "no_such_thing", "--set", "no_such_thing=1")

    def test_an_assignment_without_a_value(self):
        self.refused(2, "NAME=VALUE", "--set", "lever_arm.l")

    def test_a_node_id_out_of_range(self):
        for node_id in ("0", "128", "-1", "12x", ""):
            self.refused(2, "node_id", "--node-id", node_id)

    def test_a_missing_bus(self):
        self.refused(1, "nocan7.*ip link", "--can", "nocan7")

    def test_an_interface_that_is_not_a_can_bus(self):
        self.refused(1, "lo\\b", "--can", "lo")

    def test_an_unknown_kind_of_sensor(self):
        self.refused(2, "crystal.*replay:", "--imu", "crystal:ball")

    def test_a_wrong_option_of_sensor_or_bus_is_refused_before_either_is_opened(self):
        for imu in ("sim:nowhere", "sim:,board=v9", "i2c", "i2c:/dev/x,drdy=1", "wt901:/dev/x,baud=3",
                    "replay:/no/such.imu.csv,speed=0", "iio:a,b,c,d,e"):
            self.refused(2, imu.split(":")[0], "--imu", imu, "--can", "nocan7")
        for bus in ("udp:1.2.3.4", "udp,hosts=x", "gs_usb:x:y:z", "slcan:/dev/x,bitrate=3",
                    "slcan:/dev/x,bitrate=300000",
                    "can0:1", "a-name-that-is-too-long"):
            self.refused(2, "use|name", "--can", bus)

    def test_check_tells_whether_a_configuration_is_good_and_opens_nothing(self):
        good = rig.run("imu9-gateway", "--imu", "i2c:/dev/i2c-99", "-i", "nocan7", "-n", "5", "--check")
        self.assertEqual((good.returncode, good.stderr), (0, ""))
        self.assertEqual(good.stdout, "good: node 5 on nocan7, sensor i2c:/dev/i2c-99\n")
        self.refused(2, "crystal", "--imu", "crystal", "--check")
        self.refused(2, "inconsistent", "--set", "accelerometer_calibration.xx=0", "--check")
        self.file_refused(2, "lever_arm.x", "[lever_arm]\nx = 3\n")

    def test_a_contradiction_in_the_configuration(self):
        self.refused(2, "inconsistent", "--set", "accelerometer_calibration.xx=0", "--store", rig.scratch(".store"),
                     "--can", rig.BUS)

    def test_a_missing_log(self):
        self.refused(1, "/no/such.imu.csv.*No such file", "--imu", "replay:/no/such.imu.csv")

    def test_a_log_whose_header_lacks_a_column_names_the_line(self):
        path = rig.written("t,gx,gy,gz,ax,ay\n0,0,0,0,0,0\n", ".imu.csv")
        self.refused(1, re.escape("%s:1: " % path) + ".*az", "--imu", "replay:%s" % path)

    def test_an_empty_log(self):
        path = rig.written("", ".imu.csv")
        self.refused(1, re.escape(str(path)), "--imu", "replay:%s" % path)

    def test_every_program_has_help_and_version(self):
        programs = [[name] for name in ("imu9-gateway", "imu9-replay", "imu9-sdo", "imu9-monitor", "imu9-calibrate",
                                        "imu9-commission", "imu9-sim", "imu9-allan", "imu9-plot", "imu9-web",
                                        "imu9-bench")]
        for name, *word in programs + [["imu9-calibrate", "gyro"], ["imu9-calibrate", "lever-arm"]]:
            said = {option: rig.run(name, *word, option) for option in ("--help", "-h", "--version", "-V")}
            for option, result in said.items():
                self.assertEqual((result.returncode, result.stderr), (0, ""), (name, option))
                self.assertIn(name, result.stdout)
            self.assertEqual(said["--help"].stdout, said["-h"].stdout)
            self.assertEqual(said["--version"].stdout, said["-V"].stdout)
            self.assertRegex(said["--help"].stdout,
                             "\nExit status: 0 .*, 1 failed.*, 2 wrong usage or configuration.\n")

    def test_bus_and_node_have_one_spelling_and_that_of_earlier_versions(self):
        for spelling in (("-i", "-n"), ("--can", "--node-id"), ("--bus", "--node")):
            for name, word in (("imu9-sdo", "dump"), ("imu9-monitor", "--once"), ("imu9-calibrate", "gyro")):
                result = rig.run(name, spelling[0], "nocan7", spelling[1], "5", word)
                self.assertEqual(result.returncode, 1, (name, spelling))
                self.assertIn("nocan7", result.stderr)
                result = rig.run(name, spelling[0], "nocan7", spelling[1], "128", word)
                self.assertEqual(result.returncode, 2, (name, spelling))
        self.refused(1, "nocan7", "-i", "nocan7", "-n", "5")


class BadLogs(ARunningGateway):
    GOOD = [row(k) for k in range(60)]

    def skips(self, line, bad):
        """Rows 0..29, the invalid one, rows 31..: gateway and imu9-replay skip only the invalid one."""
        path = log_of(*self.GOOD[:30], bad, *self.GOOD[31:])
        where = re.escape("%s:%d: " % (path.name, line))
        replay = rig.run("imu9-replay", path)
        self.assertEqual(replay.returncode, 0, replay.stderr)
        self.assertEqual(len(replay.stdout.splitlines()), 1 + 59)
        self.assertNotRegex(replay.stdout, "(?i)nan|inf")
        self.assertRegex(replay.stderr, where)
        self.start(imu="replay:%s" % path)
        rig.wait_until(lambda: "has ended" in self.gateway.log)
        self.assertRegex(self.gateway.log, where)
        counters = [struct.unpack("<I", self.master.upload(NODE, 0x2121, sub))[0] for sub in (1, 2)]
        self.assertEqual(counters, [59, 1])
        self.assertEqual(struct.unpack("<H", self.master.upload(NODE, 0x210F, 1))[0], 58)

    def test_a_row_with_a_missing_field_is_skipped(self):
        self.skips(32, "0.30,0,0,0,0,0")

    def test_a_row_that_is_not_a_number_is_skipped(self):
        self.skips(32, "0.30,0,zero,0,0,0,9.81,0,20,-40")

    def test_a_row_with_nan_is_skipped(self):
        self.skips(32, "0.30,0,nan,0,0,0,9.81,0,20,-40")

    def test_a_row_with_infinity_is_skipped(self):
        self.skips(32, "0.30,0,0,0,0,0,inf,0,20,-40")

    def test_a_row_back_in_time_is_skipped(self):
        self.skips(32, row(10))

    def test_a_log_without_magnetometer_clears_its_status_bit(self):
        for text in (log_of(*[row(k, ",,,") for k in range(60)]),
                     rig.written("t,gx,gy,gz,ax,ay,az\n" + "".join(row(k, "") + "\n" for k in range(60)), ".imu.csv")):
            self.start(imu="replay:%s" % text)
            rig.wait_until(lambda: "has ended" in self.gateway.log)
            status = struct.unpack("<H", self.master.upload(NODE, 0x210F, 3))[0]
            self.assertEqual(status & 4, 0)
            self.assertEqual(self.master.upload(NODE, 0x2121, 2), bytes(4))
            self.assertEqual(struct.unpack("<H", self.master.upload(NODE, 0x210F, 1))[0], 59)
            self.gateway.end()


if __name__ == "__main__":
    unittest.main()
