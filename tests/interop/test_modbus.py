"""The Modbus window beside the bus: other Modbus clients (pymodbus, mbpoll, raw frames) against what the PDOs of the
same sample counter have. IMU9_MODBUS_SECONDS=60 compares longer, IMU9_MODBUS_FRAMES=10000 sends more random frames.
IMU9_NODE_RED: the folder in which `npm install node-red@3.1 node-red-contrib-modbus@5.23.3` ran; without it Node-RED is
left out."""
import collections
import json
import os
import pty
import random
import re
import select
import shutil
import signal
import socket
import struct
import subprocess
import threading
import time
import tty
import unittest

import canopen_master as canopen
import rig
from rig import NODE

try:
    from pymodbus.client import ModbusSerialClient, ModbusTcpClient
except ImportError:
    ModbusTcpClient = None

SECONDS = float(os.environ.get("IMU9_MODBUS_SECONDS", 1))
FRAMES = int(os.environ.get("IMU9_MODBUS_FRAMES", 1000))
INTEGERS, LEVER_ARM, MODEL, STORE, RESET = 0, 0x1000, 0x1040, 1, 0
FORMS = ("hhhH", "hhhH", "hhhH", "HHI")


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def signed(word):
    return word - 0x10000 if word & 0x8000 else word


def of_registers(words):
    """The counter, and what TPDO1 to TPDO4 have of the block of integers: {(PDO, field): value}."""
    values = {(pdo, field): signed(words[4 + 3 * pdo + field]) for pdo in range(3) for field in range(3)}
    values.update({(3, 0): words[3], (3, 2): words[1] << 16 | words[2]})
    return words[0], values


class Line:
    """Two ptys that are connected: the gateway has one end, a client the other."""

    def __init__(self):
        self.masters, self.slaves, self.names = [], [], []
        for _ in range(2):
            master, slave = pty.openpty()
            tty.setraw(slave)
            self.masters.append(master)
            self.slaves.append(slave)  # open, so that it lives without a program at this end
            self.names.append(os.ttyname(slave))
        for end in (0, 1):
            threading.Thread(target=self.copy, args=(self.masters[end], self.masters[1 - end]), daemon=True).start()

    @staticmethod
    def copy(source, sink):
        while True:
            os.write(sink, os.read(source, 256))


def crc(data):
    """Of Modbus over serial line V1.02, 6.2.2: polynomial A001h (reflected), begun with FFFFh."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return struct.pack("<H", value)


class Raw:
    """Requests byte by byte. Its subclasses have request(pdu), which returns the PDU of the response."""

    turn = 0

    def receive(self, size):
        data = b""
        while len(data) < size:
            part = self.part(size - len(data))
            if not part:
                raise ConnectionError("closed")
            data += part
        return data

    def read_object(self, index, sub, form):
        answer = self.request(struct.pack(">BBBBHBHH", 0x2B, 0x0D, 0, NODE, index, sub, 0, 240))
        assert answer[:2] == b"\x2B\x0D", answer
        return struct.unpack("<" + form, answer[11:])[0]

    def sample(self):
        """One value, as of_registers(); or None: another sample came in between."""
        self.turn = (self.turn + 1) % 9
        pdo, field = divmod(self.turn, 3)
        counter = self.read_object(0x210F, 1, "H")
        value = self.read_object(0x2100 + pdo, 1 + field, "h")
        return (counter, {(pdo, field): value}) if counter == self.read_object(0x210F, 1, "H") else None


class RawTcp(Raw):
    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), rig.PATIENCE)
        self.part, self.close = self.socket.recv, self.socket.close
        self.transaction = 0

    def request(self, pdu):
        self.transaction = self.transaction + 1 & 0xFFFF
        self.socket.sendall(struct.pack(">HHHB", self.transaction, 0, len(pdu) + 1, 1) + pdu)
        transaction, protocol, length, _ = struct.unpack(">HHHB", self.receive(7))
        assert (transaction, protocol) == (self.transaction, 0)
        return self.receive(length - 1)


class RawRtu(Raw):
    """Reads of function 43/13 at address 1 of a serial line."""

    def __init__(self, name):
        self.file = os.open(name, os.O_RDWR | os.O_NOCTTY)

    def close(self):
        os.close(self.file)

    def part(self, size):
        return os.read(self.file, size) if select.select([self.file], [], [], rig.PATIENCE)[0] else b""

    def request(self, pdu):
        os.write(self.file, b"\1" + pdu + crc(b"\1" + pdu))
        frame = self.receive(12)  # up to the number of bytes of the value
        assert frame[:3] == b"\1\x2B\x0D", frame
        frame += self.receive(frame[11])
        assert self.receive(2) == crc(frame), frame
        return frame[1:]


class NodeRed:
    """A flow that reads the block of integers every 10 ms."""

    FOLDER = os.environ.get("IMU9_NODE_RED", "")

    def __init__(self, client):
        listener = socket.create_server(("127.0.0.1", 0))
        home = rig.scratch(".node-red")
        home.mkdir()
        (home / "node_modules").symlink_to(os.path.join(self.FOLDER, "node_modules"))
        (home / "settings.js").write_text("module.exports = {httpAdminRoot: false, httpNodeRoot: false, uiPort: %d};"
                                          % free_port())
        (home / "flow.json").write_text(json.dumps([
            {"id": "tab", "type": "tab"},
            {"id": "client", "type": "modbus-client", "unit_id": 1, "commandDelay": 1, "clientTimeout": 1000,
             "reconnectTimeout": 200, "bufferCommands": True, **client},
            {"id": "read", "type": "modbus-read", "z": "tab", "server": "client", "dataType": "InputRegister",
             "adr": "0", "quantity": "45", "rate": "10", "rateUnit": "ms", "wires": [["line"], []]},
            {"id": "line", "type": "function", "z": "tab", "outputs": 1, "wires": [["out"]],
             "func": "return {payload: JSON.stringify(msg.payload) + '\\n'};"},
            {"id": "out", "type": "tcp out", "z": "tab", "beserver": "client", "host": "127.0.0.1",
             "port": listener.getsockname()[1], "base64": False, "end": False}]))
        self.process = subprocess.Popen([home / "node_modules/.bin/node-red", "-u", home, home / "flow.json"],
                                        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        listener.settimeout(rig.PATIENCE)
        self.lines = listener.accept()[0].makefile()
        listener.close()

    def close(self):
        self.process.terminate()
        self.process.wait(rig.PATIENCE)
        self.lines.close()

    def read(self):
        return of_registers(json.loads(self.lines.readline()))


class Window(unittest.TestCase):
    options = ",write=127.0.0.1,rate=2000"

    @classmethod
    def setUpClass(cls):
        if not ModbusTcpClient:
            raise unittest.SkipTest("no pymodbus: apt-get install python3-pymodbus")
        cls.port, cls.line = free_port(), Line()
        master = rig.open_master()
        try:
            cls.gateway = rig.Gateway("--modbus", "tcp:127.0.0.1:%d%s" % (cls.port, cls.options),
                                      "--modbus", "rtu:%s,baud=115200,parity=none,write=yes" % cls.line.names[0],
                                      imu="sim:square")
            cls.addClassCleanup(cls.gateway.close)
            master.wait_state(NODE, canopen.STATE_BOOT_UP)
        finally:
            master.close()
        rig.wait_until(lambda: cls.accepts())

    @classmethod
    def accepts(cls):
        try:
            socket.create_connection(("127.0.0.1", cls.port)).close()
            return True
        except ConnectionRefusedError:
            return False

    def setUp(self):
        self.master = rig.open_master()
        self.addCleanup(self.master.close)
        self.master.nmt(canopen.RESET_NODE, NODE)
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP)

    def tcp(self):
        client = ModbusTcpClient("127.0.0.1", port=self.port, timeout=rig.PATIENCE)
        self.assertTrue(client.connect())
        self.addCleanup(client.close)
        return client

    def serial(self):
        client = ModbusSerialClient(self.line.names[1], baudrate=115200, parity="N", timeout=10)
        self.assertTrue(client.connect())
        self.addCleanup(client.close)
        return client


class SameSample(Window):
    def setUp(self):
        super().setUp()
        # before the first sample the counter is 0, which the first one has, too
        rig.wait_until(lambda: self.master.upload(NODE, 0x210F, 1) != bytes(2))
        self.master.nmt(canopen.START, NODE)

    def collect(self, read, wanted):
        """Calls read() beside SYNC at 100 Hz until so many samples were seen by both windows, and SECONDS are over."""
        seen, stop, error = collections.deque(maxlen=50), threading.Event(), []

        def work():
            try:
                while not stop.is_set():
                    seen.append(read())
            except Exception as e:  # to be told by the test, not by the thread
                error.append(e)
        thread = threading.Thread(target=work)
        thread.start()
        pdos, compared, begun = {}, 0, time.monotonic()
        while not error and (compared < wanted or time.monotonic() < begun + SECONDS):
            self.assertLess(time.monotonic(), begun + SECONDS + rig.PATIENCE, "%d samples compared" % compared)
            self.master.sync()
            for frame in self.master.listen(0.01):
                if frame.arbitration_id - NODE in canopen.TPDO[:4]:
                    pdo = canopen.TPDO.index(frame.arbitration_id - NODE)
                    values = struct.unpack("<" + FORMS[pdo], frame.data)
                    pdos.setdefault(values[1 if pdo == 3 else 3], {})[pdo] = values
            for _ in range(len(seen)):  # the PDOs of the latest are still to come
                sample = seen.popleft()
                if sample and self.compare(sample, pdos):
                    compared += 1
                elif sample:
                    seen.append(sample)
        stop.set()
        thread.join()
        self.assertEqual(error, [])
        self.note = "%d samples compared in %.0f s" % (compared, time.monotonic() - begun)

    def compare(self, sample, pdos):
        """Whether there is a PDO of this sample. The counter does not wrap in the time of a test."""
        counter, values = sample
        found = False
        for (pdo, field), value in values.items():
            if pdo in pdos.get(counter, {}):
                self.assertEqual(value, pdos[counter][pdo][field], "counter %d, TPDO%d" % (counter, pdo + 1))
                found = True
        return found

    def test_pymodbus_over_tcp_reads_the_values_of_the_pdos(self):
        client = self.tcp()
        read = lambda: of_registers(client.read_input_registers(INTEGERS, count=45, slave=1).registers)
        self.collect(read, 50)

    def test_pymodbus_over_a_serial_line_reads_the_values_of_the_pdos(self):
        client = self.serial()
        read = lambda: of_registers(client.read_input_registers(INTEGERS, count=45, slave=1).registers)
        self.collect(read, 50)

    def raw(self, client):
        self.addCleanup(client.close)
        self.collect(client.sample, 50)

    def test_raw_frames_of_function_43_13_over_tcp_read_the_values_of_the_pdos(self):
        self.raw(RawTcp(self.port))

    def test_raw_frames_of_function_43_13_over_a_serial_line_read_the_values_of_the_pdos(self):
        self.raw(RawRtu(self.line.names[1]))

    def mbpoll(self, *target):
        if not shutil.which("mbpoll"):
            self.skipTest("no mbpoll")

        def read():
            out = subprocess.run(["mbpoll", "-a", "1", "-0", "-1", "-t", "3:hex", "-r", "0", "-c", "45", "-o", "10",
                                  *target],
                                 capture_output=True, text=True, timeout=rig.PATIENCE)
            words = {int(a): int(b, 16) for a, b in re.findall(r"^\[(\d+)\]:\s+0x([0-9A-F]{4})", out.stdout, re.M)}
            self.assertEqual(sorted(words), list(range(45)), out)
            return of_registers([words[i] for i in range(45)])
        self.collect(read, 5)

    def test_mbpoll_over_tcp_reads_the_values_of_the_pdos(self):
        self.mbpoll("-m", "tcp", "-p", str(self.port), "127.0.0.1")

    def test_mbpoll_over_a_serial_line_reads_the_values_of_the_pdos(self):
        self.mbpoll("-m", "rtu", "-b", "115200", "-P", "none", self.line.names[1])

    def node_red(self, **client):
        if not NodeRed.FOLDER:
            self.skipTest("no Node-RED: IMU9_NODE_RED is not set")
        node_red = NodeRed(client)
        self.addCleanup(node_red.close)
        self.collect(node_red.read, 50)

    def test_node_red_over_tcp_reads_the_values_of_the_pdos(self):
        self.node_red(clienttype="tcp", tcpHost="127.0.0.1", tcpPort=str(self.port))

    def test_node_red_over_a_serial_line_reads_the_values_of_the_pdos(self):
        self.node_red(clienttype="simpleser", serialPort=self.line.names[1], serialType="RTU-BUFFERD",
                      serialBaudrate="115200", serialDatabits="8", serialStopbits="1", serialParity="none",
                      serialConnectionDelay="100")


class Writing(Window):
    def test_what_one_window_writes_the_other_reads(self):
        client = self.tcp()
        words = struct.unpack(">6H", struct.pack(">3f", 0.05, -0.25, 0.125))
        self.assertFalse(client.write_registers(LEVER_ARM, words, slave=1).isError())
        self.assertEqual(self.master.upload(NODE, 0x2000, 2), struct.pack("<f", -0.25))
        self.master.download(NODE, 0x2000, 1, struct.pack("<f", 0.5))
        rig.wait_until(lambda: client.read_holding_registers(LEVER_ARM, count=2, slave=1).registers == [0x3F00, 0])

    def test_refused_writes_are_exceptions_2_and_3_and_keep_the_old_value(self):
        client = self.tcp()
        self.assertEqual(client.write_register(MODEL, 99, slave=1).exception_code, 3)
        self.assertEqual(client.write_registers(LEVER_ARM, [0x4270, 0, 0, 0], slave=1).exception_code, 3)  # 60 m
        self.assertEqual(client.write_register(INTEGERS, 1, slave=1).exception_code, 2)
        self.assertEqual(client.write_register(LEVER_ARM, 1, slave=1).exception_code, 2)
        self.assertEqual(self.master.upload(NODE, 0x2001), b"\x02")
        self.assertEqual(self.master.upload(NODE, 0x2000, 1), bytes(4))

    def test_the_serial_line_writes_and_stores(self):
        client = self.serial()
        self.assertFalse(client.write_register(MODEL, 1, slave=1).isError())
        self.assertFalse(client.write_coil(STORE, True, slave=1).isError())
        self.master.nmt(canopen.RESET_NODE, NODE)
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP)
        self.assertEqual(self.master.upload(NODE, 0x2001), b"\x01")
        self.assertFalse(client.write_register(MODEL, 2, slave=1).isError())
        self.assertFalse(client.write_coil(STORE, True, slave=1).isError())

    def test_the_event_log_names_the_client(self):
        client = self.tcp()
        self.assertFalse(client.write_register(MODEL, 1, slave=1).isError())
        name = "Modbus, 127.0.0.1:%d: lever_arm_model = 1\n" % client.socket.getsockname()[1]
        self.assertIn(name.encode(), self.master.upload(NODE, 0x2131))

    def test_identification_is_read_by_pymodbus(self):
        client = self.tcp()
        if hasattr(client, "read_device_information"):
            answer = client.read_device_information(read_code=3, object_id=0, slave=1)
        else:  # pymodbus 3.0
            from pymodbus.mei_message import ReadDeviceInformationRequest
            answer = client.execute(ReadDeviceInformationRequest(3, 0, unit=1))
        self.assertEqual(answer.information[0x04], b"IMU9 CANopen gateway")
        self.assertEqual(int(answer.information[0x80], 16), struct.unpack("<I", self.master.upload(NODE, 0x1018, 4))[0])


class Abuse(Window):
    options = ",write=127.0.0.1,rate=2000,clients=8"

    def memory(self):
        status = open("/proc/%d/status" % self.gateway.process.pid).read()
        return int(re.search(r"VmRSS:\s+(\d+)", status)[1])

    def test_random_frames_and_slow_clients_cost_neither_a_pdo_nor_memory(self):
        self.master.nmt(canopen.START, NODE)
        dice, slow = random.Random(16), []
        for _ in range(50):
            slow.append(socket.create_connection(("127.0.0.1", self.port)))
            slow[-1].send(b"\0\1\0\0\0")
        refused = []
        while len(refused) < 42:  # in which order they come, the network decides
            ready = select.select([s for s in slow if s not in refused], [], [], rig.PATIENCE)[0]
            self.assertTrue(ready, "%d of 50 were refused" % len(refused))
            refused += ready
        for s in [s for s in slow if s not in refused][:2]:
            s.close()
        raw, before = None, None
        for k in range(FRAMES):
            if k == FRAMES // 4:
                before = self.memory()
            try:
                raw = raw or RawTcp(self.port)
                pdu = bytes(dice.choices(range(256), k=dice.randrange(1, 253)))
                if dice.random() < 0.5:
                    pdu = bytes([dice.choice((1, 2, 3, 4, 5, 6, 15, 16, 22, 23, 43))]) + pdu[1:]
                if pdu[0] == 43 and len(pdu) > 2 or pdu[:1] in (b"\5", b"\x0F"):
                    pdu = pdu[:2]  # it could reset the configuration
                answer = raw.request(pdu)
                self.assertEqual(answer[0] & 0x7F, pdu[0] & 0x7F)
            except (ConnectionError, TimeoutError):
                raw = None
                time.sleep(0.01)
            if k % 100 == 0:
                self.master.sync()
                self.master.wait(lambda f: f.arbitration_id == canopen.TPDO[0] + NODE)
        self.assertLess(self.memory() - before, 300, "kB")
        for s in slow:
            s.close()
        self.assertGreater(struct.unpack("<I", self.master.upload(NODE, 0x2150, 6))[0], 40)  # refused
        self.assertGreater(struct.unpack("<I", self.master.upload(NODE, 0x2150, 4))[0], FRAMES // 2)  # exceptions


class Limits(Window):
    options = ",idle=1"

    def test_a_silent_client_is_disconnected(self):
        silent = socket.create_connection(("127.0.0.1", self.port))
        silent.settimeout(rig.PATIENCE)
        silent.send(b"\0\1\0\0")
        self.assertEqual(silent.recv(1), b"")

    def test_writing_needs_the_second_list(self):
        self.assertEqual(self.tcp().write_register(MODEL, 1, slave=1).exception_code, 1)

    def test_a_reload_tells_that_a_window_needs_a_restart(self):
        file = rig.written("[gateway]\n")
        gateway = rig.Gateway("-c", file, bus="vcan1")
        self.addCleanup(gateway.close)
        rig.wait_until(lambda: "node %d on" % NODE in gateway.log)
        file.write_text("[gateway]\nmodbus = tcp:127.0.0.1:1502\n")
        gateway.process.send_signal(signal.SIGHUP)
        rig.wait_until(lambda: "modbus: not changed: a restart is needed for it" in gateway.log)

    def test_a_wrong_window_is_a_wrong_configuration(self):
        for window in ("tcp:", "udp:1", "tcp:127.0.0.1:1502,allow=everyone", "rtu:/dev/ttyX,baud=1"):
            result = rig.run("imu9-gateway", "--check", "--modbus", window)
            self.assertEqual(result.returncode, 2, result)
            self.assertIn("Modbus", result.stderr)
        self.assertEqual(rig.run("imu9-gateway", "--check", "--modbus", "tcp:0.0.0.0:502").returncode, 0)

    def test_a_port_in_use_is_told(self):
        result = rig.run("imu9-gateway", "--can", "vcan1", "--node-id", NODE + 1, "--modbus",
                         "tcp:127.0.0.1:%d" % self.port)
        self.assertEqual(result.returncode, 1, result)
        self.assertIn("Modbus: 127.0.0.1:%d: Address already in use" % self.port, result.stderr)
