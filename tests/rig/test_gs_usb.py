#!/usr/bin/python3
# rig: -k -V
"""A gs_usb adapter, emulated down to its USB descriptors: through the kernel's driver, and through the gateway's
driver with libusb. The bus behind the adapter is vcan0, where the other node is."""
import os
import pathlib
import struct
import subprocess
import time
import unittest

import rig_tests
from rig_tests import UsbAdapter, program, rig, shell
from rig import NODE
import canopen_master as canopen

FAR = "vcan0"
TX_DROPPED, RX_DROPPED, ERROR_FRAMES, BUS_OFF = 4, 5, 6, 7  # of 2120h
ACTIVE, WARNING, PASSIVE, OFF = 0, 1, 2, 3  # 2122h:2
PASSIVE_CODE, OVERRUN, BUS_OFF_OVER = 0x8120, 0x8110, 0x8140
adapter = UsbAdapter(FAR, "vcan1")


def u16(value):
    return struct.pack("<H", value)


def u32(data):
    return int.from_bytes(data, "little")


def emergencies(frames):
    """The EMCYs of the bus: on a busy machine the simulated sensor may be late, too."""
    codes = [canopen.emergency(f)[0] for f in frames if f.arbitration_id == canopen.EMCY + NODE]
    return [code for code in codes if code & 0xFF00 == 0x8100]


class ThroughTheKernel(unittest.TestCase):
    bus = "can0"
    down = "(ip link set ... up)"

    @classmethod
    def setUpClass(cls):
        cls.up()

    @staticmethod
    def up():
        rig.wait_until(lambda: os.path.exists("/sys/class/net/can0"))
        # the guest's only processor may run the emulator for long: the kernel queues more frames than on real hardware
        pathlib.Path("/proc/sys/net/core/netdev_max_backlog").write_text("20000")
        shell("ip", "link", "set", "can0", "type", "can", "bitrate", "500000")
        shell("ip", "link", "set", "can0", "txqueuelen", "100", "up")

    @classmethod
    def tearDownClass(cls):
        shell("ip", "link", "set", "can0", "down")

    def setUp(self):
        adapter.tell("ack", "hears")
        self.master = rig.open_master(FAR)
        self.addCleanup(self.master.close)

    # ---- plain traffic

    def test_5000_frames_go_each_way_and_none_is_lost(self):
        ends = [subprocess.Popen([program("can_exchange"), *arguments], stdout=subprocess.PIPE, text=True)
                for arguments in ((self.bus, "181", "201", "5000"), (FAR, "201", "181", "5000"))]
        said = [end.communicate(timeout=60)[0] for end in ends]
        self.assertEqual([end.returncode for end in ends], [0, 0], "".join(said))
        self.note = "".join(said)

    # ---- the gateway

    def start(self, *options):
        self.gateway = rig.Gateway(*options, bus=self.bus)
        self.addCleanup(self.stop, self.gateway)
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP, 10)
        self.master.download(NODE, 0x1800, 2, b"\xFE")  # TPDO1 with each sample
        self.master.nmt(canopen.START, NODE)
        self.pdos_come()

    @staticmethod
    def stop(gateway):
        """Closes the port, so that the kernel's driver gets the adapter back."""
        if gateway.process.poll() is None:
            gateway.end()

    def pdos_come(self, seconds=10):
        self.master.wait(canopen.TPDO[0] + NODE, seconds)

    def counter(self, sub):
        return u32(self.master.upload(NODE, 0x2120, sub))

    def state(self):
        return u32(self.master.upload(NODE, 0x2122, 2))

    def wait_for_emergency(self, code, seconds=10):
        self.master.wait(lambda f: f.arbitration_id == canopen.EMCY + NODE and canopen.emergency(f)[0] == code, seconds)

    def test_the_gateway_serves_sdo_and_pdos_at_100_hz_to_a_master_on_the_far_side(self):
        self.start()
        self.master.drain()
        frames = self.master.listen(5)
        counters = [int.from_bytes(f.data[6:8], "little") for f in frames if f.arbitration_id == canopen.TPDO[0] + NODE]
        self.assertGreater(len(counters), 450)
        self.assertEqual([b for a, b in zip(counters, counters[1:]) if b - a & 0xFFFF > 1], [], "samples are missing")
        begun = time.monotonic()
        for value in range(1000, 1200):
            self.master.download(NODE, 0x1017, 0, u16(value))
            self.assertEqual(self.master.upload(NODE, 0x1017, 0), u16(value))
        self.note = "%d PDOs in 5 s; an SDO transfer takes %.2f ms beside them" % (
            len(counters), (time.monotonic() - begun) / 400 * 1000)
        self.assertEqual([self.counter(TX_DROPPED), self.counter(RX_DROPPED)], [0, 0])

    def test_a_warning_is_counted_and_told_but_no_emergency(self):
        self.start()
        before = self.counter(ERROR_FRAMES)
        self.master.drain()
        adapter.tell("warning")
        frames = self.master.listen(0.5)
        self.assertEqual(emergencies(frames), [])
        self.assertEqual(self.counter(ERROR_FRAMES), before + 1)
        self.assertIn("error warning", self.gateway.log)
        adapter.tell("active")
        rig.wait_until(lambda: "error active" in self.gateway.log)

    def test_error_passive_gives_8120h_until_it_is_over(self):
        self.start()
        self.master.drain()
        adapter.tell("passive")
        self.wait_for_emergency(PASSIVE_CODE)
        adapter.tell("active")
        self.wait_for_emergency(0)
        self.assertEqual(self.master.upload(NODE, 0x1001, 0)[0] & 0x10, 0)  # communication error

    def assert_back_from_bus_off(self, before):
        self.wait_for_emergency(BUS_OFF_OVER)
        self.assertEqual(self.counter(BUS_OFF), before + 1)
        self.master.nmt(canopen.START, NODE)  # 1029h: bus-off ended operational
        self.master.drain()
        self.pdos_come()

    def test_an_adapter_that_comes_back_from_bus_off_by_itself_gives_8140h(self):
        self.start()
        before = self.counter(BUS_OFF)
        adapter.tell("bus-off")
        rig.wait_until(lambda: "bus-off" in self.gateway.log)
        adapter.tell("restarted")
        self.assert_back_from_bus_off(before)

    def test_without_acknowledge_8110h_and_8120h_come_when_there_is_one_again(self):
        self.start()
        self.assertEqual(self.counter(TX_DROPPED), 0)
        adapter.tell("noack")
        rig.wait_until(lambda: "error passive" in self.gateway.log)
        time.sleep(3)  # the queues overflow
        self.master.drain()
        adapter.tell("ack")
        frames = self.master.listen(2)
        self.assertTrue({PASSIVE_CODE, OVERRUN} <= set(emergencies(frames)), emergencies(frames))
        self.assertGreater(self.counter(TX_DROPPED), 0)
        self.master.drain()
        self.pdos_come()

    def replugged(self):
        self.up()

    def test_unplugged_and_plugged_in_again_it_goes_on(self):
        self.start()
        for _ in range(3):
            adapter.tell("unplug")
            rig.wait_until(lambda: self.gateway.log.rstrip().endswith(self.down))
            self.master.drain()
            self.assertEqual(self.master.listen(0.3), [])
            adapter.tell("replug")
            self.replugged()
            self.master.drain()
            self.pdos_come()
            self.master.upload(NODE, 0x1000, 0)


class ThroughLibusb(ThroughTheKernel):
    bus = "gs_usb"
    down = "plug the adapter in, it is searched for"

    @classmethod
    def setUpClass(cls):
        pass

    @classmethod
    def tearDownClass(cls):
        pass

    def replugged(self):
        pass

    def monitor(self, bus, *options, **more):
        return subprocess.run([program("../../imu9-sdo"), "-i", bus, "-n", "9", *options, "read", "1000h"],
                              capture_output=True, text=True, timeout=20, **more)

    def test_the_gateway_restarts_an_adapter_that_stays_bus_off(self):
        self.start()
        before = self.counter(BUS_OFF)
        adapter.tell("bus-off")
        self.assert_back_from_bus_off(before)

    def test_packets_that_are_no_frames_are_counted_and_disturb_nothing(self):
        self.start()
        before = self.counter(RX_DROPPED)
        adapter.tell("garbage")
        self.pdos_come()
        rig.wait_until(lambda: self.counter(RX_DROPPED) == before + 10)

    def test_an_adapter_that_forgets_frames_is_restarted(self):
        self.start()
        starts = adapter.report()[2]
        adapter.tell("deaf")
        time.sleep(1)
        adapter.tell("hears")
        rig.wait_until(lambda: adapter.report()[2] == starts + 1)
        self.master.drain()
        self.pdos_come()

    def test_the_bit_rate_asked_for_is_set_with_the_sample_point_of_cia_301(self):
        for bit_s, point in ((1000000, 750), (800000, 800), (500000, 875), (125000, 875), (10000, 875)):
            self.monitor("gs_usb,bitrate=%d" % bit_s)
            self.assertEqual(adapter.last_line("bit rate"), "bit rate %d sample point %d" % (bit_s, point))
        self.monitor("gs_usb,bitrate=500000,sample-point=0.75")
        self.assertEqual(adapter.last_line("bit rate"), "bit rate 500000 sample point 750")

    def test_the_gateway_s_option_sets_the_bit_rate_before_it_goes_on_the_bus(self):
        starts = adapter.report()[2]
        self.start("--bitrate", "250000")
        self.assertEqual(adapter.last_line("bit rate"), "bit rate 250000 sample point 875")
        self.assertEqual(adapter.report()[2], starts + 1)

    def test_the_kernel_s_driver_gets_the_adapter_back(self):
        self.assertEqual(rig_tests.driver_of_adapter(), "gs_usb")
        self.start()
        self.assertEqual(rig_tests.driver_of_adapter(), "usbfs")
        self.gateway.end()
        rig.wait_until(lambda: rig_tests.driver_of_adapter() == "gs_usb")

    def test_the_second_channel_is_another_bus(self):
        master = rig.open_master("vcan1")
        self.addCleanup(master.close)
        gateway = rig.Gateway(bus="gs_usb:%s:1" % UsbAdapter.serial)
        self.addCleanup(self.stop, gateway)
        master.wait_state(NODE, canopen.STATE_BOOT_UP, 10)
        self.assertEqual(master.upload(NODE, 0x1000, 0)[:2], u16(410))

    def test_listening_only_nothing_is_sent(self):
        before = adapter.report()[0]
        self.monitor("gs_usb,listen-only")
        self.assertEqual(adapter.report()[0], before)

    def test_what_is_wrong_is_said(self):
        for bus, words in (("gs_usb:NOSUCH", "use one of gs_usb:%s" % UsbAdapter.serial), ("gs_usb::2", "no channel 2"),
                           ("gs_usb,bitrate=930000", "does not support 930000 bit/s"), ("gs_usb,speed=1", "bitrate=")):
            done = self.monitor(bus)
            self.assertNotEqual(done.returncode, 0)
            self.assertIn(words, done.stderr)

    def test_two_programs_cannot_have_it_both(self):
        self.start()
        self.assertIn("another program uses the adapter", self.monitor("gs_usb").stderr)
        self.master.drain()
        self.pdos_come()

    def test_without_permission_the_udev_rule_is_named(self):
        done = self.monitor("gs_usb", user="nobody")
        self.assertIn("70-imu9-gateway.rules", done.stderr)


if __name__ == "__main__":
    rig_tests.main()
