#!/usr/bin/python3
# rig: -k -V
"""The gateway on emulated slcan adapters whose firmware has the habits of real ones, behind a pseudo terminal. The test
is the master on the far side of the adapter."""
import os
import threading
import time
import tty
import unittest

import rig_tests
from rig_tests import rig
from rig import NODE

BOOT_UP, ANSWER, TPDO1 = 0x700 + NODE, 0x580 + NODE, 0x180 + NODE
DEVICE_TYPE = bytes.fromhex("4000100000000000")  # SDO upload of 1000h
BEL = b"\a"
MUTE = "the adapter does not answer: unplug it and plug it in again; it is tried again"
REFUSED = "the adapter has refused frames: its buffer was full, or it had left the bus."
CLOSED = "the adapter refuses to go on the bus: unplug it, or use another bit rate; it is tried again"


class Firmware:
    """An adapter. `end`: of its lines, None: no answers; `sent`: its answer to a frame; `status`: it knows F."""

    def __init__(self, end=b"\r", sent=b"", one_a_packet=False, status=True):
        self.end, self.sent, self.one_a_packet, self.status = end, sent, one_a_packet, status
        self.mute = self.refusing = self.open = False
        self.rate = None
        self.frames = []  # that the gateway has put on the bus: ID and data
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.name = os.ttyname(self.slave)
        threading.Thread(target=self.run, daemon=True).start()

    def run(self):
        rest = b""
        while True:
            packet = os.read(self.master, 4096)
            if self.mute:
                rest = b""
                continue
            *commands, rest = (rest + packet).split(b"\r")
            if self.one_a_packet and commands[0][:1] != b"t":  # the terminal joins frames, which USB sends one by one
                commands = commands[:1]
            for command in commands:
                answer = BEL if self.refusing else self.obey(command)
                if self.end is not None:
                    os.write(self.master, answer if answer == BEL else answer + self.end)

    def obey(self, command):
        kind, argument = command[:1], command[1:]
        if kind == b"C":
            self.open = False
        elif kind == b"S" and not self.open:
            self.rate = argument
        elif kind == b"O" and self.rate is not None and not self.open:
            self.open = True
        elif kind == b"F" and self.status and self.open:
            return b"F00"
        elif kind == b"t" and self.open:
            self.frames.append((int(argument[:3], 16), bytes.fromhex(argument[4:].decode())))
            return self.sent
        else:
            return BEL
        return b""

    def put(self, can_id, data=b""):
        """A frame of the master."""
        if self.open and not self.mute:
            line = "t%03X%d%s" % (can_id, len(data), data.hex().upper())
            os.write(self.master, line.encode() + (b"\r" if self.end is None else self.end))

    def forget(self):
        """As after a reset of the adapter."""
        self.open, self.rate = False, None


class Habits(unittest.TestCase):
    def begin(self, firmware):
        self.firmware = firmware
        self.gateway = rig.Gateway(bus="slcan:" + firmware.name)
        self.addCleanup(self.gateway.close)

    def sees(self, can_id, since=0):
        return any(frame[0] == can_id for frame in self.firmware.frames[since:])

    def answers(self):
        """Whether an SDO request and a SYNC are answered at once."""
        since = len(self.firmware.frames)
        self.firmware.put(0x600 + NODE, DEVICE_TYPE)
        self.firmware.put(0x080)
        time.sleep(0.05)
        return self.sees(ANSWER, since) and self.sees(TPDO1, since)

    def go_operational(self):
        rig.wait_until(lambda: self.sees(BOOT_UP))
        self.firmware.put(0x000, bytes([1, NODE]))
        time.sleep(0.1)

    def told(self):
        """What the log says of the adapter after the start."""
        about = "imu9-gateway: slcan:%s: " % self.firmware.name
        return [line[len(about):] for line in self.gateway.log.splitlines() if line.startswith(about)]

    def works(self, **habits):
        self.begin(Firmware(**habits))
        self.go_operational()
        for _ in range(50):
            self.assertTrue(self.answers())
        time.sleep(10)
        self.assertTrue(self.answers())
        self.assertEqual(self.told(), [])

    def test_answers_that_end_with_cr_are_understood(self):
        self.works()

    def test_answers_that_end_with_lf_are_understood(self):
        self.works(end=b"\n")

    def test_answers_that_end_with_cr_lf_are_understood(self):
        self.works(end=b"\r\n")

    def test_a_z_after_each_frame_is_understood(self):
        self.works(sent=b"z")

    def test_no_answers_at_all_do(self):
        self.works(end=None)

    def test_one_command_a_packet_is_enough(self):
        self.works(one_a_packet=True)

    def test_no_status_command_is_needed(self):
        self.works(status=False)

    def recovers(self, trouble, forgets=False, **habits):
        """From an adapter that is mute or refusing for 10 s; the lines of the log about it."""
        self.begin(Firmware(**habits))
        self.go_operational()
        time.sleep(3)
        setattr(self.firmware, trouble, True)
        time.sleep(10)
        if forgets:
            self.firmware.forget()
        setattr(self.firmware, trouble, False)
        begun = time.monotonic()
        rig.wait_until(self.answers)
        seconds = time.monotonic() - begun
        self.assertLess(seconds, 5)
        time.sleep(10)
        self.assertTrue(self.answers())
        self.note = "%.1f s after it was well" % seconds
        return self.told()

    def test_a_mute_adapter_recovers(self):
        self.assertEqual(self.recovers("mute"), [MUTE, "error active"])

    def test_a_mute_adapter_that_has_left_the_bus_recovers(self):
        self.assertEqual(self.recovers("mute", forgets=True), [MUTE, "error active"])

    def test_a_mute_adapter_without_status_that_has_left_the_bus_recovers(self):
        self.assertEqual(self.recovers("mute", forgets=True, status=False), [REFUSED])

    def test_a_mute_adapter_without_answers_recovers_unnoticed(self):
        self.assertEqual(self.recovers("mute", end=None), [])

    def test_an_adapter_that_refuses_everything_recovers(self):
        self.assertEqual(self.recovers("refusing"), [CLOSED, "error active"])

    def recovers_from_the_start(self, trouble):
        firmware = Firmware()
        setattr(firmware, trouble, True)
        self.begin(firmware)
        time.sleep(10)
        setattr(firmware, trouble, False)
        begun = time.monotonic()
        rig.wait_until(lambda: firmware.frames)
        self.note = "%.1f s after it was well" % (time.monotonic() - begun)
        self.assertLess(time.monotonic() - begun, 5)
        firmware.put(0x000, bytes([1, NODE]))
        time.sleep(0.1)
        self.assertTrue(self.answers())
        return self.told()

    def test_an_adapter_that_refuses_everything_from_the_start_recovers(self):
        self.assertEqual(self.recovers_from_the_start("refusing"), [CLOSED, "error active"])

    def test_an_adapter_that_is_mute_from_the_start_recovers(self):
        self.assertEqual(self.recovers_from_the_start("mute"), [REFUSED])


if __name__ == "__main__":
    rig_tests.main()
