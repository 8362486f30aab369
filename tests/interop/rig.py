"""Shared by the interop tests: the gateway as a process, the bus, and paths."""
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

BUS, ROUGH_BUS = "vcan0", "vcan1"  # vcan0 is captured, so its frames must be valid; invalid frames go to vcan1
NODE = 16
PATIENCE = 120  # for what must come, s: only a fault lets it pass
SIMULATED_TIME = "time-travel" in pathlib.Path("/proc/cmdline").read_text()  # vcan-run -V


def u8(value):
    return struct.pack("<B", value)


def u16(value):
    return struct.pack("<H", value)


def u32(value):
    return struct.pack("<I", value)


def program(name):
    return str(BUILD / name)


def run(name, *args, **options):
    """Runs a program of this project to its end."""
    return subprocess.run([program(name), *map(str, args)], capture_output=True, text=True, timeout=PATIENCE, **options)


def recorded(start):
    """The recorded trial whose name starts with `start`; skips the test if the data are missing."""
    found = sorted(BROAD.glob(start + "*.imu.csv"))
    if not found:
        raise unittest.SkipTest("no recorded trials in %s: set IMU9_BROAD to their folder" % BROAD)
    return found[0]


def scratch(suffix=""):
    """The name of a new file or folder."""
    return pathlib.Path(tempfile.mktemp(dir=WORK, suffix=suffix))


def written(text, suffix=""):
    path = scratch(suffix)
    path.write_text(text)
    return path


def open_master(channel=BUS, own_frames=True):
    """With own_frames, `frames` contains the SYNCs sent here and the PDOs in bus order."""
    bus = can.Bus(interface="socketcan", channel=channel, receive_own_messages=own_frames)
    # large enough that no frames are lost on a busy machine
    bus.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    return canopen.Master(bus)


class Gateway:
    """A running imu9-gateway. `log` is its stderr."""

    last = None  # the one started last: its log is printed if a test fails

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
        return self.process.wait(PATIENCE)

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()


class OnTheBus(unittest.TestCase):
    """A gateway for the class (class attributes `bus` and `imu`) and a master for each test. Each test starts in
    pre-operational with default communication objects."""

    bus = BUS
    imu = "sim"

    @classmethod
    def setUpClass(cls):
        master = open_master(cls.bus)
        try:
            cls.gateway = Gateway(bus=cls.bus, imu=cls.imu)
            cls.addClassCleanup(cls.gateway.close)
            master.wait_state(NODE, canopen.STATE_BOOT_UP)
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
        """Waits for the EMCY with this code and returns its frame; others may occur on a busy machine."""
        expected = bytes((code & 0xFF, code >> 8))
        return self.master.wait(lambda f: f.arbitration_id == canopen.EMCY + NODE and f.data[:2] == expected)

    def assert_no_sooner_than(self, seconds, frames):
        """Minimum interval of frames: a busy machine makes intervals longer, never shorter."""
        median = statistics.median(b.timestamp - a.timestamp for a, b in zip(frames, frames[1:]))
        self.assertGreater(median, seconds - 0.001)
        self.assertLess(median, 1.3 * seconds)

    def pdos(self, frames, number=1):
        return [f for f in frames if f.arbitration_id == canopen.TPDO[number - 1] + NODE]


def wait_until(condition, seconds=PATIENCE):
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise AssertionError("the condition was not met within %.1f s" % seconds)
        time.sleep(0.05)
