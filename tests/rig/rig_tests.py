"""Shared by the Python tests of the rig: the runner and the emulated USB adapter."""
import atexit
import os
import pathlib
import shutil
import subprocess
import sys
import time
import unittest

sys.dont_write_bytecode = True
HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "interop"))
import rig  # noqa: E402

atexit.register(shutil.rmtree, rig.WORK)


def program(name):
    """One of tests/rig/*.c."""
    return str(rig.BUILD / "tests/rig" / name)


class Result(unittest.TestResult):
    counts = {"passed": 0, "failed": 0, "skipped": 0}

    def startTest(self, test):
        super().startTest(test)
        self.begun = time.monotonic()

    def report(self, outcome, test, text=""):
        self.counts[outcome] += 1
        group, name = test.id().split(".")[-2:]
        seconds = time.monotonic() - getattr(self, "begun", time.monotonic())
        print("%-8s%s: %s %.2f s" % (outcome, group, name[5:].replace("_", " "), seconds))
        for line in text.strip().splitlines():
            print("        " + line)
        sys.stdout.flush()

    def addSuccess(self, test):
        self.report("passed", test, getattr(test, "note", ""))

    def addSkip(self, test, reason):
        self.report("skipped", test, reason)

    def addError(self, test, err):
        text = self._exc_info_to_string(err, test)
        if rig.Gateway.last:
            text += "the gateway's log:\n" + "\n".join(rig.Gateway.last.log.splitlines()[-15:])
        self.report("failed", test, text)

    addFailure = addError


def main():
    """Runs the tests of the program whose names contain one of its arguments."""
    words = sys.argv[1:]
    for group in unittest.defaultTestLoader.loadTestsFromName("__main__"):
        chosen = [test for test in group if not words or any(word in test.id() for word in words)]
        unittest.TestSuite(chosen).run(Result())
    print("%(passed)d passed, %(failed)d failed, %(skipped)d skipped" % Result.counts)
    sys.exit(Result.counts["failed"] != 0)


def shell(*command):
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise AssertionError("%s: %s" % (" ".join(command), done.stderr))
    return done.stdout


class UsbAdapter:
    """The emulated adapter (gs_emulator.c), plugged in; its channels are the interfaces `buses`."""

    serial = "IMU9RIG0001"
    gadget = pathlib.Path("/sys/kernel/config/usb_gadget/imu9")

    def __init__(self, *buses):
        self.make_gadget()
        self.log = rig.scratch(".emulator")
        self.commands = rig.scratch(".commands")
        os.mkfifo(self.commands)
        with open(self.log, "w") as log:
            self.process = subprocess.Popen([program("gs_emulator"), "/dev/imu9-ffs", self.gadget, self.commands,
                                             *buses], stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        rig.wait_until(lambda: "ready" in self.log.read_text() or self.process.poll() is not None)
        self.plug()

    def make_gadget(self):
        if not os.path.ismount("/sys/kernel/config"):
            shell("mount", "-t", "configfs", "none", "/sys/kernel/config")
        for name in ("strings/0x409", "configs/c.1", "functions/ffs.imu9"):
            (self.gadget / name).mkdir(parents=True)
        for name, value in (("idVendor", "0x1d50"), ("idProduct", "0x606f"),
                            ("strings/0x409/serialnumber", self.serial),
                            ("strings/0x409/product", "emulated candleLight")):
            (self.gadget / name).write_text(value)
        (self.gadget / "configs/c.1/ffs.imu9").symlink_to(self.gadget / "functions/ffs.imu9")
        os.mkdir("/dev/imu9-ffs")
        shell("mount", "-t", "functionfs", "imu9", "/dev/imu9-ffs")

    def plug(self):
        (self.gadget / "UDC").write_text("dummy_udc.0\n")
        rig.wait_until(self.is_there)

    @staticmethod
    def is_there():
        return any(path.read_text().strip() == "1d50"
                   for path in pathlib.Path("/sys/bus/usb/devices").glob("*/idVendor"))

    def tell(self, *commands):
        with open(self.commands, "w") as f:
            f.write("\n".join(commands) + "\n")

    def last_line(self, start):
        """The last line of the emulator with this start."""
        return [line for line in self.log.read_text().splitlines() if line.startswith(start)][-1]

    def report(self):
        """Frames from the host, frames to it, starts of channel 0."""
        before = self.log.read_text().count("from host")
        self.tell("report")
        rig.wait_until(lambda: self.log.read_text().count("from host") > before)
        return [int(word) for word in self.last_line("from host").split() if word.isdigit()]


def driver_of_adapter():
    """The kernel driver bound to the adapter's interface, or None."""
    for path in pathlib.Path("/sys/bus/usb/drivers").glob("*/*:*"):
        if (path / "../idVendor").resolve().read_text().strip() == "1d50":
            return path.parent.name
    return None
