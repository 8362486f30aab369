"""An MQTT broker (mosquitto), a subscriber (mosquitto_sub) and imu9-fleet as processes, for the tests."""
import pathlib
import shutil
import signal
import socket
import subprocess
import unittest

import rig


def required():
    for program in ("mosquitto", "mosquitto_sub", "mosquitto_pub"):
        if not shutil.which(program, path="/usr/sbin:/usr/bin:/bin:/sbin"):
            raise unittest.SkipTest("no %s: apt-get install mosquitto mosquitto-clients" % program)


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Broker:
    """On a free port, with all that it needs in a folder of its own."""

    def __init__(self, *lines):
        required()
        self.folder = rig.scratch(".broker")
        self.folder.mkdir(mode=0o777)
        self.port = free_port()
        self.conf = self.folder / "mosquitto.conf"
        self.conf.write_text("\n".join(("listener %d 127.0.0.1" % self.port, "persistence true",
                                        "persistence_location %s/" % self.folder, "max_queued_messages 0",
                                        "max_inflight_messages 0", "user root",
                                        *(lines or ("allow_anonymous true",)))) + "\n")
        self.process = None
        self.start()

    def accepts(self):
        try:
            socket.create_connection(("127.0.0.1", self.port)).close()
            return True
        except OSError:
            return False

    def start(self):
        with open(self.folder / "log", "a") as log:
            self.process = subprocess.Popen(["/usr/sbin/mosquitto", "-c", self.conf], stdout=log, stderr=log)
        rig.wait_until(self.accepts)

    def keep_sessions(self):
        """Writes down who has subscribed to what: a kill does not lose that."""
        self.process.send_signal(signal.SIGUSR1)
        rig.wait_until((self.folder / "mosquitto.db").exists)

    def kill(self):
        self.process.kill()
        self.process.wait()

    def close(self):
        if self.process.poll() is None:
            self.kill()


class Subscriber:
    """Keeps its session over a restart of the broker. `lines`: what it has got."""

    def __init__(self, broker, topic="#", form="%r %t %p", options=()):
        self.path = rig.scratch(".sub")
        with open(self.path, "w") as out:
            self.process = subprocess.Popen(
                ["stdbuf", "-oL", "mosquitto_sub", "-h", "127.0.0.1", "-p", str(broker.port), "-t", topic, "-q", "1",
                 "-c", "-i", "subscriber-%s" % self.path.stem, "-F", form, *options], stdout=out)

    @property
    def lines(self):
        return self.path.read_text().splitlines()

    def messages(self, ending):
        """(retained, payload) of each message whose topic ends so."""
        split = (line.split(" ", 2) for line in self.lines)
        return [(m[0] == "1", m[2]) for m in split if len(m) == 3 and m[1].endswith(ending)]

    def close(self):
        self.process.kill()
        self.process.wait()


class Fleet:
    def __init__(self, broker, *args, bus=rig.BUS, url=None):
        self.log_path, self.spool = rig.scratch(".log"), rig.scratch(".spool")
        self.command = [rig.program("imu9-fleet"), "-i", bus, "--broker", url or "mqtt://127.0.0.1:%d" % broker.port,
                        "--name", "bus", "--spool", str(self.spool), *map(str, args)]
        self.start()

    def start(self):
        with open(self.log_path, "a") as log:
            self.process = subprocess.Popen(self.command, stderr=log)

    @property
    def log(self):
        return self.log_path.read_text()

    def spool_bytes(self):
        return sum(f.stat().st_size for f in pathlib.Path(self.spool).glob("*.seg") if f.exists())

    def end(self, number=signal.SIGTERM):
        self.process.send_signal(number)
        return self.process.wait(rig.PATIENCE)

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
