"""What the interop tests share: the gateway as a process, the bus, and where things are."""
import os
import pathlib
import signal
import socket
import statistics
import struct
import subprocess
import tempfile
import time
import unittest

import can

import canopen_master as canopen

ROOT = pathlib.Path(__file__).resolve().parents[2]
BUILD = (ROOT / os.environ.get("BUILD", "build")).resolve()
BROAD = pathlib.Path(os.environ.get("IMU9_BROAD", ROOT / "../shared/data/broad")).resolve()
EDS = ROOT / "eds/imu9-gateway.eds"
WORK = pathlib.Path(tempfile.mkdtemp(prefix="imu9-interop."))  # removed by `run`

BUS, ROUGH_BUS = "vcan0", "vcan1"  # vcan0 is captured and must stay well-formed; rough things happen on vcan1
NODE = 16


def u8(value):
    return struct.pack("<B", value)


def u16(value):
    return struct.pack("<H", value)


def u32(value):
    return struct.pack("<I", value)


def program(name):
    return str(BUILD / name)


def run(name, *args, **options):
    """Runs one of our programs to its end."""
    return subprocess.run([program(name), *map(str, args)], capture_output=True, text=True, timeout=20, **options)


def recorded(start):
    """The recorded trial whose name starts so; skips the test where the data is missing."""
    found = sorted(BROAD.glob(start + "*.imu.csv"))
    if not found:
        raise unittest.SkipTest("the recorded trials are missing: none in %s (IMU9_BROAD=FOLDER says where)" % BROAD)
    return found[0]


def scratch(suffix=""):
    """The name of a new file or folder."""
    return pathlib.Path(tempfile.mktemp(dir=WORK, suffix=suffix))


def written(text, suffix=""):
    path = scratch(suffix)
    path.write_text(text)
    return path


def open_master(channel=BUS, own_frames=True):
    """With own_frames, `frames` has SYNCs and PDOs in the order of the bus."""
    bus = can.Bus(interface="socketcan", channel=channel, receive_own_messages=own_frames)
    # a busy machine must not cost this client any frames
    bus.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    return canopen.Master(bus)


class Gateway:
    """imu9-gateway running. `log` has its stderr."""

    last = None  # the one started last, whose log the runner shows when a test fails

    def __init__(self, *args, bus=BUS, imu="sim"):
        self.log_path = scratch(".log")
        self.command = [program("imu9-gateway"), "--imu", imu, "--can", bus, "--node-id", str(NODE),
                        "--store", str(scratch(".store")), *map(str, args)]
        self.process = None
        self.start()

    def start(self):
        Gateway.last = self
        with open(self.log_path, "a") as log:
            self.process = subprocess.Popen(self.command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)

    @property
    def log(self):
        return self.log_path.read_text()

    def end(self, signal_number=signal.SIGTERM):
        """The exit status (negative: the signal that killed it)."""
        self.process.send_signal(signal_number)
        return self.process.wait(5)

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()


class OnTheBus(unittest.TestCase):
    """A gateway for the whole class (class attributes `bus` and `imu`) and a master for each test. Every test starts in
    pre-operational with the communication objects at their defaults."""

    bus = BUS
    imu = "sim"

    @classmethod
    def setUpClass(cls):
        master = open_master(cls.bus)
        try:
            cls.gateway = Gateway(bus=cls.bus, imu=cls.imu)
            cls.addClassCleanup(cls.gateway.close)
            master.wait_state(NODE, canopen.STATE_BOOT_UP, 5)
        finally:
            master.close()

    def setUp(self):
        self.master = open_master(self.bus)
        self.addCleanup(self.master.close)
        self.reset()

    def reset(self, command=canopen.RESET_COMMUNICATION):
        self.master.drain()
        self.master.nmt(command, NODE)
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP)

    def start(self):
        self.master.nmt(canopen.START, NODE)

    def read(self, index, sub=0):
        return self.master.upload(NODE, index, sub)

    def write(self, index, sub, data):
        self.master.download(NODE, index, sub, data)

    def assert_aborts(self, code, action, *args):
        """The action is refused with exactly this abort code."""
        try:
            action(*args)
        except canopen.Abort as abort:
            self.assertEqual("%08X" % abort.code, "%08X" % code, abort)
        else:
            self.fail("not refused: %s%r" % (action.__name__, args))

    def emcy(self, code):
        """Waits for this one and gives its frame: on a busy machine the sensor has errors of its own."""
        told = bytes((code & 0xFF, code >> 8))
        return self.master.wait(lambda f: f.arbitration_id == canopen.EMCY + NODE and f.data[:2] == told)

    def assert_no_sooner_than(self, seconds, frames):
        """Frames of which each waits for the one before: a busy machine makes that longer, never shorter."""
        median = statistics.median(b.timestamp - a.timestamp for a, b in zip(frames, frames[1:]))
        self.assertGreater(median, seconds - 0.001)
        self.assertLess(median, 1.3 * seconds)

    def pdos(self, frames, number=1):
        return [f for f in frames if f.arbitration_id == canopen.TPDO[number - 1] + NODE]


def wait_until(condition, seconds=5):
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise AssertionError("did not happen within %.1f s" % seconds)
        time.sleep(0.05)
