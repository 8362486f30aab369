#!/usr/bin/python3
# rig: -k -V
"""The gateway's slcan driver against the kernel's: two connected pseudo terminals, one of them with the kernel's slcan
line discipline, which makes it a CAN interface."""
import os
import select
import subprocess
import threading
import time
import tty
import unittest

import rig_tests
from rig_tests import program, rig, shell
from rig import NODE
import canopen_master as canopen


class Line:
    """Two pseudo terminals; what is written to one is read from the other. `near` and `far` are their names."""

    def __init__(self):
        self.masters, self.slaves = [], []
        for _ in range(2):
            master, slave = os.openpty()
            tty.setraw(slave)
            self.masters.append(master)
            self.slaves.append(slave)
        self.near, self.far = map(os.ttyname, self.slaves)
        threading.Thread(target=self.carry, daemon=True).start()

    def carry(self):
        while True:
            for fd in select.select(self.masters, [], [])[0]:
                data = os.read(fd, 4096)
                other = self.masters[1 - self.masters.index(fd)]
                while data:
                    data = data[os.write(other, data):]


line = Line()


class AgainstTheKernel(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.slcand = subprocess.Popen(["slcand", "-F", "-S", "115200", line.far, "slcan0"])
        cls.addClassCleanup(cls.slcand.kill)
        rig.wait_until(lambda: os.path.exists("/sys/class/net/slcan0"))
        shell("ip", "link", "set", "slcan0", "txqueuelen", "100", "up")

    def test_2000_frames_go_each_way_and_none_is_lost(self):
        ends = [subprocess.Popen([program("can_exchange"), *arguments], stdout=subprocess.PIPE, text=True)
                for arguments in (("slcan:" + line.near, "181", "201", "2000"), ("slcan0", "201", "181", "2000"))]
        said = [end.communicate(timeout=60)[0] for end in ends]
        self.assertEqual([end.returncode for end in ends], [0, 0], "".join(said))
        self.note = "".join(said)

    def test_the_gateway_serves_sdo_and_pdos_to_a_master_on_the_far_side(self):
        master = rig.open_master("slcan0")
        self.addCleanup(master.close)
        gateway = rig.Gateway(bus="slcan:" + line.near)
        self.addCleanup(gateway.close)
        master.wait_state(NODE, canopen.STATE_BOOT_UP, 10)
        master.nmt(canopen.START, NODE)
        begun = time.monotonic()
        for value in range(1000, 1050):
            master.download(NODE, 0x1017, 0, value.to_bytes(2, "little"))
            self.assertEqual(master.upload(NODE, 0x1017, 0), value.to_bytes(2, "little"))
            master.sync()
            master.wait(canopen.TPDO[0] + NODE)
        self.note = "a write, a read, and a PDO on SYNC take %.1f ms" % ((time.monotonic() - begun) / 50 * 1000)


if __name__ == "__main__":
    rig_tests.main()
