"""The examples of tools/examples, on a real bus against a running gateway."""
import importlib.util
import math
import os
import re
import struct
import subprocess
import sys
import unittest

import canopen_master as canopen
import rig
from rig import NODE

EXAMPLES = rig.ROOT / "tools/examples"
LEVER_ARM_M = 0.05, -0.02, 0.1  # in both examples
VALID, SATURATED, SENSOR_LOST = 1 << 0, 1 << 8, 1 << 9  # of the status
SAMPLES = 80


def tilted_log():
    """Half a second at rest, tilted and turned, then a push: attitude, acceleration and position end away from zero."""
    rows = ["t,gx,gy,gz,ax,ay,az,mx,my,mz"]
    for i in range(SAMPLES):
        push = 1.5 if i >= 50 else 0
        rows.append("%.2f,0,0,0,%g,1.5,9.3,20,-8,-40" % (i / 100, -2.5 + push))
    return rig.written("\n".join(rows) + "\n", ".imu.csv")


class RobotCi(unittest.TestCase):
    def run_beside(self, command, **settings):
        environment = dict(os.environ, IMU9_CAN=rig.BUS, IMU9_NODE="21", PATH="%s:%s" % (rig.BUILD, os.environ["PATH"]),
                           **settings)
        return subprocess.run([EXAMPLES / "robot-ci", "sh", "-c", command], env=environment, capture_output=True,
                              text=True, timeout=60)

    def test_a_command_reaches_the_gateway_and_its_status_is_returned(self):
        done = self.run_beside("imu9-sdo -q read 0x1000 && exit 7")
        self.assertEqual((done.returncode, done.stdout.strip()), (7, str(0x0004019A)), done.stderr)
        self.assertIn("stopping on SIGTERM", done.stderr)

    def test_a_wrong_sensor_is_told_and_the_command_not_run(self):
        done = self.run_beside("echo run", SENSOR="crystal")
        self.assertEqual((done.returncode, done.stdout), (1, ""))
        self.assertIn("crystal", done.stderr)


class PlcExample(unittest.TestCase):
    """Debian has no IEC 61131-3 compiler, so the numbers are read from the text of plc_codesys.st, and this test does
    with them what the PLC does: it fills the input image from the PDOs with those CAN-IDs and scales what is at those
    addresses."""

    FORMAT = {"INT": "<h", "UINT": "<H", "WORD": "<H", "UDINT": "<I"}

    @classmethod
    def setUpClass(cls):
        cls.text = (EXAMPLES / "plc_codesys.st").read_text()
        cls.node = int(re.search(r"IMU_NODE_ID : USINT := (\d+);", cls.text)[1])
        arm = re.search(r"IMU_LEVER_ARM_M : ARRAY\[1\.\.3\] OF REAL := \[(.*?)\];", cls.text)[1]
        cls.lever_arm_m = tuple(float(metres) for metres in arm.split(","))
        cls.can_ids = [int(can_id, 16) for can_id in re.findall(r"\(\* TPDO\d, CAN-ID 16#(\w+) \*\)", cls.text)]
        # variable: (type, byte offset in the input image); %IW3 are bytes 6 and 7, %ID7 bytes 28 to 31
        cls.inputs = {name: (kind, int(number) * {"W": 2, "D": 4}[size]) for name, size, number, kind in
                      re.findall(r"(\w+) AT %I([WD])(\d+) : (\w+);", cls.text)}
        steps = dict(re.findall(r"(IMU_\w+_STEP_\w+) : REAL := ([\d.]+);", cls.text))
        cls.outputs = {output: (variable, float(steps[step])) for output, step, variable in
                       re.findall(r"(\w+\[\d\]) := (\w+) \* INT_TO_REAL\((\w+)\);", cls.text)}
        master = rig.open_master()
        try:
            cls.gateway = rig.Gateway("--node-id", cls.node, imu="replay:%s" % tilted_log())
            cls.addClassCleanup(cls.gateway.close)
            master.wait_state(cls.node, canopen.STATE_BOOT_UP)
        finally:
            master.close()

    def setUp(self):
        self.master = rig.open_master()
        self.addCleanup(self.master.close)

    def start(self):
        self.master.nmt(canopen.START, self.node)
        self.master.upload(self.node, 0x1000)  # its answer comes after the change of state

    def inputs_now(self):
        """SYNC, then the variables of the input image."""
        self.master.drain()
        self.master.sync()
        image = b"".join(bytes(self.master.wait(can_id).data) for can_id in self.can_ids)
        return {name: struct.unpack_from(self.FORMAT[kind], image, at)[0] for name, (kind, at) in self.inputs.items()}

    def test_its_addresses_types_and_steps_are_those_of_the_dbc(self):
        signals = []
        for number, (frame, name) in enumerate(re.findall(r"^BO_ (\d+) (TPDO\d)", self.dbc(), re.M)):
            self.assertEqual(self.can_ids[number], int(frame) - 1 + self.node, name)  # the DBC is that of node 1
            block = self.dbc().split(" %s:" % name)[1].split("BO_ ")[0]
            for start, bits, sign, factor in re.findall(r"SG_ \w+ : (\d+)\|(\d+)@1([+-]) \(([\d.]+),0\)", block):
                signals.append((8 * number + int(start) // 8, int(bits), sign == "-", float(factor)))
        step = {variable: factor for variable, factor in self.outputs.values()}
        said = [(at, 8 * struct.calcsize(self.FORMAT[kind]), kind == "INT", step.get(name, 1.0))
                for name, (kind, at) in self.inputs.items()]
        self.assertEqual(said, signals)
        self.assertEqual(len(said), 15)

    def dbc(self):
        return (rig.BUILD / "gen/imu9-gateway.dbc").read_text()

    def test_its_sdo_writes_the_lever_arm(self):
        call = re.search(r"writeLeverArm\(NETWORK.*?\);", self.text, re.S)[0]
        index = int(re.search(r"INDEX := 16#(\w+)", call)[1], 16)
        length = int(re.search(r"DATALENGTH := (\d+)", call)[1])
        for sub, metres in enumerate(self.lever_arm_m, 1):
            data = struct.pack("<f", metres)
            self.assertEqual(len(data), length)
            self.master.download(self.node, index, sub, data)
        answer = rig.run("imu9-sdo", "-i", rig.BUS, "-n", self.node, "read", "lever_arm")
        self.assertEqual(answer.stdout.split("\n"),
                         ["lever_arm.l = 0.05 m", "lever_arm.s = -0.02 m", "lever_arm.t = 0.1 m", ""], answer.stderr)
        self.assertEqual(self.lever_arm_m, LEVER_ARM_M)

    def test_its_scaled_values_are_those_of_the_gateway(self):
        self.start()
        # after the end of its log the gateway keeps the last sample: PDOs and SDOs have the same values
        rig.wait_until(lambda: self.inputs_now()["imuStatus"] & SENSOR_LOST)
        inputs = self.inputs_now()
        counters = {inputs["imuCounter%d" % number] for number in (1, 2, 3, 4)}
        self.assertEqual(counters, {SAMPLES - 1})
        for output, index in (("acceleration_m_s2", 0x2109), ("angles_deg", 0x210B), ("position_m", 0x210C)):
            values = []
            for sub in (1, 2, 3):
                exact = struct.unpack("<f", self.master.upload(self.node, index, sub))[0]
                variable, step = self.outputs["%s[%d]" % (output, sub)]
                self.assertAlmostEqual(inputs[variable] * step, exact, delta=0.51 * step, msg=variable)
                values.append(abs(exact) / step)
            self.assertGreater(max(values), 10, output)  # or a wrong step would not show
        self.assertEqual(inputs["imuTime_us"], struct.unpack("<I", self.master.upload(self.node, 0x210F, 2))[0])

    def test_its_mask_finds_a_lost_sensor(self):
        words = re.search(r"imuStatus AND 16#(\w+)\) = 16#(\w+);", self.text).groups()
        mask, wanted = (int(word, 16) for word in words)
        self.assertEqual((mask, wanted), (VALID | SATURATED | SENSOR_LOST, VALID))
        self.start()
        rig.wait_until(lambda: self.inputs_now()["imuStatus"] & SENSOR_LOST)
        self.assertNotEqual(self.inputs_now()["imuStatus"] & mask, wanted)
        self.gateway.end()
        self.gateway.start()
        self.master.wait_state(self.node, canopen.STATE_BOOT_UP)
        self.start()
        rig.wait_until(lambda: self.inputs_now()["imuStatus"] & mask == wanted)


class PythonCanopenExample(rig.OnTheBus):
    imu = "sim:rest"

    def test_it_sets_the_lever_arm_and_prints_values_with_units(self):
        if not importlib.util.find_spec("canopen"):
            self.skipTest("no python-canopen, which Debian does not have: pip install canopen")
        rig.wait_until(lambda: self.read(0x210F, 3)[0] & VALID)
        example = [sys.executable, EXAMPLES / "pdo_python_canopen.py", "--channel", rig.BUS, "--node", str(NODE)]
        done = subprocess.run([*example, "--samples", "3"], capture_output=True, text=True, timeout=rig.PATIENCE)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(len(done.stdout.splitlines()), 3)
        for line in done.stdout.splitlines():
            value = dict(re.findall(r"([\w. ]+) = ([-+.\de]+)", line.replace(", ", "\n")))
            units = re.findall(r"([\w. ]+) = [-+.\de]+ (\S+)", line.replace(", ", "\n"))
            self.assertEqual([unit for _, unit in units], 3 * ["m/s^2"] + 3 * ["deg"] + 3 * ["m"])
            force = math.hypot(*(float(value["Acceleration " + axis]) for axis in "lst"))
            self.assertLess(force, 0.5)  # at rest
            self.assertEqual(int(value["Sample status"]) & 1, 1)
        self.master.drain()
        written = (struct.unpack("<f", self.read(0x2000, sub))[0] for sub in (1, 2, 3))
        self.assertEqual(tuple(round(metres, 6) for metres in written), LEVER_ARM_M)


if __name__ == "__main__":
    unittest.main()
