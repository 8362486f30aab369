"""LSS (CiA 305), its storage, and the bit rate of a CAN controller: the kernel's slcan driver, with this test at the
other end of its pseudo-terminal."""
import fcntl
import os
import pathlib
import platform
import signal
import struct
import subprocess
import threading
import time
import tty
import unittest

import canopen_master as canopen
import rig
from rig import NODE

N_SLCAN, TIOCSETD = 17, 0x5423


class Lss(unittest.TestCase):
    bus = rig.BUS

    def begin(self, *args):
        self.master = rig.open_master(self.bus)
        self.addCleanup(self.master.close)
        self.gateway = rig.Gateway(*args, bus=self.bus)
        self.addCleanup(self.gateway.close)

    def boot_up(self, node):
        self.master.wait_state(node, canopen.STATE_BOOT_UP)

    def order(self, *data):
        self.master.send(0x7E5, bytes(data).ljust(8, b"\0"))

    def ask(self, *data):
        """The answer's first two bytes."""
        self.master.drain()
        self.order(*data)
        return self.master.wait(lambda f: f.arbitration_id == 0x7E4).data[:2]

    def test_a_stored_node_id_is_used_after_kill_9(self):
        self.begin()
        self.boot_up(NODE)
        self.order(0x04, 1)
        self.assertEqual(self.ask(0x11, 33), b"\x11\0")
        self.assertEqual(self.ask(0x17), b"\x17\0")
        self.gateway.end(signal.SIGKILL)
        self.gateway.start()
        self.boot_up(33)
        self.assertEqual(self.master.upload(33, 0x1014), struct.pack("<I", 0x80 + 33))
        self.assertIn("node-ID 33, stored by LSS, replaces the configured 16", self.gateway.log)

    def test_a_node_without_a_node_id_is_silent_until_it_gets_one(self):
        self.begin("--node-id", "255")
        rig.wait_until(lambda: "waiting for LSS to assign one" in self.gateway.log)
        rig.wait_until(lambda: self.answers_unconfigured())
        self.order(0x04, 1)
        self.assertEqual(self.ask(0x11, 34), b"\x11\0")
        self.order(0x04, 0)
        self.boot_up(34)

    def answers_unconfigured(self):
        self.order(0x4C)
        return any(f.arbitration_id == 0x7E4 and f.data[0] == 0x50 for f in self.master.listen(0.1))

    def test_a_bit_rate_for_vcan_is_refused(self):
        self.begin()
        self.boot_up(NODE)
        self.order(0x04, 1)
        self.assertEqual(self.ask(0x13, 0, 2), b"\x13\x01")

    def test_a_second_gateway_does_not_use_the_same_store(self):
        self.begin()
        self.boot_up(NODE)
        store = self.gateway.command[self.gateway.command.index("--store") + 1]
        other = rig.Gateway("--node-id", "35", "--store", store, bus=self.bus)
        self.addCleanup(other.close)
        rig.wait_until(lambda: "belongs to another gateway" in other.log)
        self.boot_up(35)

    def test_the_serial_number_stays_with_another_spelling_of_the_sensor(self):
        self.begin("--vendor-id", "0x12345678")
        self.boot_up(NODE)
        identity = [self.master.upload(NODE, 0x1018, sub) for sub in (1, 4)]
        self.gateway.end()
        self.gateway.command[self.gateway.command.index("--imu") + 1] = "sim:square,board=v3"
        self.gateway.start()
        self.boot_up(NODE)
        self.assertEqual([self.master.upload(NODE, 0x1018, sub) for sub in (1, 4)], identity)
        self.assertEqual(identity[0], struct.pack("<I", 0x12345678))

    def test_two_nodes_with_one_identity_are_told_by_scan(self):
        self.begin("--serial", "77")
        self.boot_up(NODE)
        other = rig.Gateway("--node-id", "35", "--serial", "77", bus=self.bus)
        self.addCleanup(other.close)
        self.boot_up(35)
        self.assertIn("serial number 0000004Dh is that of another gateway of this host", other.log)
        scan = rig.run("imu9-sdo", "-i", self.bus, "scan")
        self.assertIn("nodes %d and 35 have the same identity (1018h)" % NODE, scan.stderr)

    def test_another_node_with_the_same_node_id_raises_an_emcy(self):
        self.begin()
        self.boot_up(NODE)
        self.master.send(0x700 + NODE, b"\0")
        emcy = self.master.wait(lambda f: f.arbitration_id == 0x80 + NODE)
        self.assertEqual(emcy.data, bytes([0x50, 0x81, 0x11, 0x10, 0x07, 0, 0, 0]))


class Slcan:
    """A simulated slcan adapter: the bytes that the kernel's driver sends. They must be read continuously, as the
    driver waits for it."""

    def __init__(self):
        self.end, self.tty = os.openpty()
        tty.setraw(self.tty)
        before = set(os.listdir("/sys/class/net"))
        fcntl.ioctl(self.tty, TIOCSETD, struct.pack("i", N_SLCAN))
        self.name, = set(os.listdir("/sys/class/net")) - before
        self.text = b""
        self.reader = threading.Thread(target=self.read)
        self.reader.start()

    def read(self):
        try:
            while True:
                text = os.read(self.end, 4096)
                self.text += text
        except OSError:  # the other end was closed
            pass

    def said(self, seconds):
        """The bytes received since the last call and in the next `seconds`."""
        time.sleep(seconds)
        text, self.text = self.text, b""
        return text

    def close(self):
        os.close(self.tty)
        self.reader.join(5)
        os.close(self.end)


def load_slcan():
    """Loads the module if modprobe does not find it; otherwise the kernel has the driver or loads it."""
    module = pathlib.Path("/usr/lib/uml/modules", platform.release(), "kernel/drivers/net/can/slcan/slcan.ko")
    if module.exists():
        subprocess.run(["insmod", module], capture_output=True)


class BitRate(unittest.TestCase):
    def setUp(self):
        load_slcan()
        try:
            self.adapter = Slcan()
        except OSError:
            self.skipTest("this kernel has no slcan driver")
        self.addCleanup(self.adapter.close)
        subprocess.run(["ip", "link", "set", self.adapter.name, "up", "type", "can", "bitrate", "500000"], check=True)
        self.adapter.said(0.2)

    def start(self, *args):
        gateway = rig.Gateway(*args, bus=self.adapter.name)
        self.addCleanup(gateway.close)
        return gateway

    def send(self, *data):
        os.write(self.adapter.end, b"t7E58" + bytes(data).ljust(8, b"\0").hex().upper().encode() + b"\r")

    def test_the_bit_rate_of_the_command_line_is_set(self):
        gateway = self.start("--bitrate", "125000")
        said = self.adapter.said(1)
        self.assertIn(b"S4\r", said)
        self.assertIn(b"t710100", said)  # boot-up
        self.assertIn("125000 bit/s set", gateway.log)

    def test_an_equal_bit_rate_is_not_set_again(self):
        self.start("--bitrate", "500000")
        said = self.adapter.said(1)
        self.assertNotIn(b"S", said)
        self.assertIn(b"t710100", said)

    def test_a_bit_rate_that_the_controller_does_not_support_is_reported(self):
        gateway = self.start("--bitrate", "333000")
        self.adapter.said(0.5)
        self.assertIn("the controller does not support this bit rate", gateway.log)

    def test_lss_switches_the_bit_rate_between_two_switch_delays(self):
        self.start()
        self.adapter.said(1)
        self.send(0x04, 1)
        self.send(0x13, 0, 6)  # 50 kbit/s
        self.assertIn(b"t7E481300", self.adapter.said(0.3))
        self.send(0x17)
        self.assertIn(b"t7E481700", self.adapter.said(0.3))
        self.send(0x15, 0xF4, 0x01)  # 500 ms
        self.assertEqual(self.adapter.said(0.4), b"")
        switch = self.adapter.said(0.4)
        self.assertIn(b"S2\r", switch)
        self.assertNotIn(b"t", switch)
        self.assertIn(b"t71017F", self.adapter.said(1.5))  # the heartbeat

    def test_a_bit_rate_stored_by_lss_is_set_at_the_next_start(self):
        gateway = self.start()
        self.adapter.said(1)
        self.send(0x04, 1)
        self.send(0x13, 0, 4)
        self.send(0x17)
        self.assertIn(b"t7E481700", self.adapter.said(0.5))
        gateway.end(signal.SIGKILL)
        self.adapter.said(0.1)
        gateway.start()
        said = self.adapter.said(1)
        self.assertIn(b"S4\r", said)
        self.assertIn("125000 bit/s set, as stored by LSS", gateway.log)
