"""An MQTT broker (mosquitto), a subscriber (mosquitto_sub) and imu9-fleet as processes, for the tests."""
import importlib
import os
import pathlib
import shutil
import signal
import socket
import subprocess
import sys
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
                                        *("log_type " + t for t in ("error", "warning", "notice", "subscribe")),
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

    @property
    def log(self):
        return (self.folder / "log").read_text()

    def keep_sessions(self):
        """Writes down who has subscribed to what: a kill does not lose that."""
        self.process.send_signal(signal.SIGUSR1)
        rig.wait_until((self.folder / "mosquitto.db").exists)

    def kill_idle(self, gateway, subscriber):
        """A killed broker loses what it has taken and not passed on. So that only imu9-fleet can be the one that loses
        something, it is killed while the gateway sends nothing and all was passed on; imu9-fleet is not told."""
        gateway.process.send_signal(signal.SIGSTOP)
        before = None
        while before != len(subscriber.lines):
            before = len(subscriber.lines) + 1
            subprocess.run(["mosquitto_pub", "-h", "127.0.0.1", "-p", str(self.port), "-q", "1", "-m", str(before),
                            "-t", subscriber.topic.replace("#", "mark")], check=True, timeout=rig.PATIENCE)
            rig.wait_until(lambda: len(subscriber.lines) >= before)
        self.kill()
        gateway.process.send_signal(signal.SIGCONT)

    def kill(self):
        self.process.kill()
        self.process.wait()

    def close(self):
        if self.process.poll() is None:
            self.kill()


class Subscriber:
    """Keeps its session over a restart of the broker. `lines`: what it has got."""

    def __init__(self, broker, topic="#", form="%r %t %p", options=()):
        self.path, self.topic = rig.scratch(".sub"), topic
        with open(self.path, "w") as out:
            self.process = subprocess.Popen(
                ["stdbuf", "-oL", "mosquitto_sub", "-h", "127.0.0.1", "-p", str(broker.port), "-t", topic, "-q", "1",
                 "-c", "-i", self.path.stem, "-F", form, *options], stdout=out)
        rig.wait_until(lambda: "%s 1 %s" % (self.path.stem, topic) in broker.log)

    @property
    def lines(self):
        text = self.path.read_text()
        return text[:text.rfind("\n") + 1].splitlines()

    def messages(self, ending):
        """(retained, payload) of each message whose topic ends so."""
        split = (line.split(" ", 2) for line in self.lines)
        return [(m[0] == "1", m[2]) for m in split if len(m) == 3 and m[1].endswith(ending)]

    def close(self):
        self.process.kill()
        self.process.wait()


class Fleet:
    def __init__(self, broker, *args, bus=rig.BUS, url=None, environment=None):
        self.environment = {**os.environ, **(environment or {})}
        self.log_path, self.spool = rig.scratch(".log"), rig.scratch(".spool")
        self.command = [rig.program("imu9-fleet"), "-i", bus, "--broker", url or "mqtt://127.0.0.1:%d" % broker.port,
                        "--name", "bus", "--spool", str(self.spool), *map(str, args)]
        self.start()

    def start(self):
        with open(self.log_path, "a") as log:
            self.process = subprocess.Popen(self.command, stderr=log, env=self.environment)

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


def sparkplug():
    """The module that protoc makes of the .proto."""
    if not shutil.which("protoc"):
        raise unittest.SkipTest("no protoc: apt-get install protobuf-compiler")
    folder = rig.scratch(".proto")
    folder.mkdir()
    subprocess.run(["protoc", "--proto_path=%s" % (rig.ROOT / "tools/fleet"), "--python_out=%s" % folder,
                    "sparkplug_b.proto"], check=True, timeout=rig.PATIENCE)
    sys.path.insert(0, str(folder))
    try:
        return importlib.import_module("sparkplug_b_pb2")
    except ImportError as error:
        raise unittest.SkipTest("%s: apt-get install python3-protobuf" % error) from error


class Authority:
    """Certificates: of a CA, of a server on 127.0.0.1, of a client."""

    def __init__(self):
        if not shutil.which("openssl"):
            raise unittest.SkipTest("no openssl: apt-get install openssl")
        self.folder = rig.scratch(".ca")
        self.folder.mkdir()
        self.make("ca", "-x509", "-days", "3650")
        for name, extension in (("server", "subjectAltName=IP:127.0.0.1"), ("client", "basicConstraints=CA:FALSE")):
            self.make(name)
            self["ext"].write_text(extension)
            self.openssl("x509", "-req", "-in", self[name + ".crt"], "-CA", self["ca.crt"], "-CAkey", self["ca.key"],
                         "-CAcreateserial", "-days", "3650", "-extfile", self["ext"], "-out", self[name + ".pem"])

    def __getitem__(self, name):
        return self.folder / name

    def make(self, name, *options):
        self.openssl("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-subj",
                     "/CN=" + name, "-keyout", self[name + ".key"], "-out", self[name + ".crt"], *options)

    @staticmethod
    def openssl(*args):
        subprocess.run(["openssl", *map(str, args)], check=True, capture_output=True, timeout=rig.PATIENCE)
