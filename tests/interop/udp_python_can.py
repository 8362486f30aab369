#!/usr/bin/python3
"""The udp bus between imu9-gateway and python-can, both ways, over IPv4 and IPv6. Needs no CAN.

Where no route leads to the multicast groups (a container, the guest of vcan-run), python-can cannot join them; the
routes are added to the loopback interface then, which needs root.
"""
import os
import pathlib
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import unittest

sys.dont_write_bytecode = True
HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
try:
    import can
    from can.interfaces.udp_multicast.utils import pack_message
    import canopen_master as canopen
except ImportError as error:
    print("skipped: %s (apt-get install python3-can python3-msgpack)" % error)
    sys.exit(77)

ROOT = HERE.parents[1]
BUILD = (ROOT / os.environ.get("BUILD", "build")).resolve()
GROUP4, GROUP6 = "239.74.163.2", "ff15:7079:7468:6f6e:6465:6d6f:6d63:6173"
DEFAULT_PORT = 43113
PORT = 20000 + os.getpid() % 20000  # not the default, which others may use
NODE = 97
RX_FRAMES, RX_DROPPED = 2, 5  # of 2120h


def reachable(group):
    """Whether python-can hears its own datagram: not every kernel loops IPv6 multicast on a loopback interface."""
    try:
        bus = can.Bus(interface="udp_multicast", channel=group, port=PORT)
    except (OSError, can.CanError):
        return False
    try:
        bus.send(can.Message(arbitration_id=0x701, is_extended_id=False))
        return bus.recv(5) is not None
    except (OSError, can.CanError):
        return False
    finally:
        bus.shutdown()


def make_reachable(group, *route):
    if not reachable(group):
        subprocess.run(["ip", *route], stderr=subprocess.DEVNULL)
    return reachable(group)


class Gateway:
    def __init__(self, bus):
        self.store = tempfile.mkdtemp(prefix="imu9-udp.")
        self.process = subprocess.Popen(
            [BUILD / "imu9-gateway", "--imu", "sim", "--can", bus, "--node-id", str(NODE), "--store", self.store],
            stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def end(self):
        self.process.terminate()
        status = self.process.wait(120)
        shutil.rmtree(self.store)
        return status


class OnABus(unittest.TestCase):
    group, port = GROUP4, PORT

    def setUp(self):
        if ":" in self.group:
            if not make_reachable(self.group, "-6", "route", "add", "ff15::/16", "dev", "lo"):
                self.skipTest("no IPv6 multicast here")
        elif not make_reachable(self.group, "route", "add", "239.0.0.0/8", "dev", "lo"):
            self.skipTest("no IPv4 multicast here, and not root to add a route")
        self.bus = can.Bus(interface="udp_multicast", channel=self.group, port=self.port)
        self.addCleanup(self.bus.shutdown)
        self.master = canopen.Master(self.bus)
        name = "udp:[%s]:%d" if ":" in self.group else "udp:%s:%d"
        self.gateway = Gateway("udp" if self.port == DEFAULT_PORT else name % (self.group, self.port))
        self.addCleanup(self.gateway.end)
        self.boot_up = self.master.wait_state(NODE, canopen.STATE_BOOT_UP)

    def counter(self, sub):
        return int.from_bytes(self.master.upload(NODE, 0x2120, sub), "little")

    def heard_of_ten_requests(self):
        """The number of these frames that the gateway received; each is answered by one frame."""
        counts = []
        for _ in range(2):
            time.sleep(0.1)  # the counters are published with each sample
            counts.append(self.counter(RX_FRAMES))
            for _ in range(9):
                self.master.upload(NODE, 0x1000)
        return counts[1] - counts[0]

    def forget_what_is_malformed(self):
        """python-can also receives datagrams of this host, and raises at malformed ones."""
        end = time.monotonic() + 0.3
        while time.monotonic() < end:
            try:
                self.bus.recv(0.1)
            except can.CanError:
                pass


class Ipv4(OnABus):
    def test_a_file_is_transferred_in_thousands_of_frames(self):
        self.assertEqual(self.master.upload(NODE, 0x1021), (ROOT / "eds/imu9-gateway.eds").read_bytes())

    def test_every_sync_is_answered_with_four_pdos(self):
        self.master.nmt(canopen.START, NODE)
        self.master.upload(NODE, 0x1000)
        self.master.drain()
        for _ in range(50):
            self.master.sync()
            for base in canopen.TPDO:
                self.assertEqual(self.master.wait(base + NODE).dlc, 8)

    def test_the_gateway_does_not_receive_its_own_frames(self):
        self.assertEqual(self.heard_of_ten_requests(), 10)

    def test_datagrams_that_are_not_classical_frames_are_counted_and_ignored(self):
        before = self.counter(RX_DROPPED)
        self.bus.send(can.Message(arbitration_id=0x600 + NODE, is_extended_id=False, is_fd=True, data=bytes(12)))
        self.bus.send(can.Message(arbitration_id=0x40, is_extended_id=False, is_error_frame=True, data=bytes(8)))
        valid = pack_message(can.Message(arbitration_id=0x80, is_extended_id=False))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as raw:
            for datagram in (b"rubbish", valid[:-1], valid + b"\0", bytes(5000)):
                raw.sendto(datagram, (self.group, self.port))
        self.forget_what_is_malformed()  # meanwhile the counter is published
        self.assertEqual(self.counter(RX_DROPPED) - before, 6)
        self.assertEqual(self.gateway.process.poll(), None)

    def test_frames_of_other_nodes_and_remote_frames_are_ignored(self):
        self.bus.send(can.Message(arbitration_id=0x1FFFFFFF, is_extended_id=True, data=bytes(8)))
        self.bus.send(can.Message(arbitration_id=0x600 + NODE, is_extended_id=True, data=bytes(8)))
        self.bus.send(can.Message(arbitration_id=0x700 + NODE, is_extended_id=False, is_remote_frame=True, dlc=1))
        self.assertEqual(self.master.upload(NODE, 0x1000), bytes.fromhex("9a010400"))

    def test_it_ends_with_status_0(self):
        self.gateway.process.terminate()
        self.assertEqual(self.gateway.process.wait(120), 0)


class Default(OnABus):
    port = DEFAULT_PORT

    def test_the_group_and_port_are_those_of_python_can(self):
        self.assertFalse(self.boot_up.is_extended_id or self.boot_up.is_remote_frame or self.boot_up.is_error_frame)
        self.assertEqual(self.boot_up.dlc, 1)
        self.assertEqual(self.master.upload(NODE, 0x1000), bytes.fromhex("9a010400"))


class Ipv6(OnABus):
    group = GROUP6

    def test_an_object_is_read(self):
        self.assertEqual(self.master.upload(NODE, 0x1000), bytes.fromhex("9a010400"))

    def test_the_gateway_does_not_receive_its_own_frames(self):
        self.assertEqual(self.heard_of_ten_requests(), 10)


class Isolated(unittest.TestCase):
    """In a network namespace with only a loopback interface and no route."""

    def test_programs_of_this_project_share_the_bus(self):
        alone = ["unshare", "-n"] if os.geteuid() == 0 else ["unshare", "-rn"]
        if subprocess.run([*alone, "ip", "link", "set", "lo", "up"], stderr=subprocess.DEVNULL).returncode != 0:
            self.skipTest("no network namespaces here")
        script = """ip link set lo up
            "$1"/imu9-gateway --imu sim --can udp --node-id 5 --store "$2" 2>/dev/null &
            for _ in 1 2 3 4 5 6 7 8 9 10; do "$1"/imu9-sdo -q -i udp -n 5 read 0x1018:1 && break; sleep 0.2; done
            kill $!; wait $!"""
        with tempfile.TemporaryDirectory() as store:
            done = subprocess.run([*alone, "sh", "-c", script, "sh", BUILD, store], capture_output=True, text=True)
        self.assertRegex(done.stdout, r"^\d+\n$")
        self.assertEqual(done.returncode, 0)


if __name__ == "__main__":
    unittest.main()
