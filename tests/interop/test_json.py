"""--json of the programs: valid by tools/imu9-json.schema.json, and the values are those that SDO reads. The one-liners
of tools/README.md run."""
import json
import os
import re
import struct
import subprocess
import unittest

import canopen_master as canopen
import rig
from rig import NODE

try:
    import jsonschema
except ImportError:
    jsonschema = None

SCHEMA = json.loads((rig.ROOT / "tools/imu9-json.schema.json").read_text())


def valid(name, text):
    document = json.loads(text)
    jsonschema.validate(document, {"$ref": "#/$defs/" + name, "$defs": SCHEMA["$defs"]},
                        cls=jsonschema.Draft202012Validator)
    return document


@unittest.skipUnless(jsonschema, "python3-jsonschema is not installed")
class Json(rig.OnTheBus):
    def sdo(self, *args, status=0):
        done = rig.run("imu9-sdo", "-i", self.bus, "-n", NODE, "--json", *args)
        self.master.drain()  # the answers to imu9-sdo
        self.assertEqual(done.returncode, status, done.stderr)
        return done.stdout

    def values(self, name, *args, status=0):
        return {v["name"]: v for v in valid(name, self.sdo(name, *args, status=status))["values"]}

    def test_the_schema_refuses_a_document_of_another_command(self):
        with self.assertRaises(jsonschema.ValidationError):
            valid("log", self.sdo("read", "lever_arm"))

    def test_read_has_the_values_of_the_node(self):
        self.write(0x2000, 2, struct.pack("<f", 0.05))
        values = self.values("read", "lever_arm", "lever_arm_model", "sample.status", "manufacturer_device_name")
        self.assertEqual(values["lever_arm.s"],
                         {"name": "lever_arm.s", "address": "2000h:02", "value": 0.05, "unit": "m"})
        self.assertEqual((values["lever_arm_model"]["value"], values["lever_arm_model"]["words"]), (2, "rigid_body"))
        # after the reset before this test it takes the node some samples
        rig.wait_until(lambda: "valid" in self.values("read", "sample.status")["sample.status"]["words"])
        self.assertEqual(values["manufacturer_device_name"]["value"], "IMU9 CANopen gateway")

    def test_a_scaled_value_is_physical_and_its_steps_are_raw(self):
        value = self.values("read", "acceleration")["acceleration.t"]
        self.assertAlmostEqual(value["value"], value["raw"] * 0.005, 9)

    def test_what_cannot_be_read_has_its_abort_code(self):
        values = valid("read", self.sdo("read", "lever_arm.l", "0x2000:9", status=1))["values"]
        self.assertEqual(values[0]["name"], "lever_arm.l")
        self.assertEqual((values[1]["address"], values[1]["abort"]), ("2000h:09", "06090011h"))

    def test_dump_has_every_readable_object(self):
        values = self.values("dump")
        listed = rig.run("imu9-sdo", "-i", self.bus, "-n", NODE, "dump").stdout
        names = {line.split()[1] for line in listed.splitlines() if "(a file: " not in line}
        self.assertEqual(set(values), names)

    def test_watch_prints_a_document_for_each_line(self):
        lines = [valid("watch", line)
                 for line in self.sdo("watch", "angles", "--count", "3", "--rate", "50").splitlines()]
        self.assertEqual(len(lines), 3)
        self.assertLess(lines[0]["utc"], lines[2]["utc"])

    def test_the_bench_prints_what_the_histograms_of_the_node_hold(self):
        self.start()
        self.write(0x214A, 1, bytes(4))
        for _ in range(25):
            self.master.sync()
            self.master.wait(lambda f: f.arbitration_id == canopen.TPDO[3] + NODE)
        done = rig.run("imu9-bench", "-i", self.bus, "-n", NODE, "--json")
        self.master.drain()
        found = {h["name"]: h for h in valid("bench", done.stdout)["histograms"]}
        self.assertEqual(set(found), {"sample_age", "sync_to_tpdo", "loop_turn", "stage_read", "stage_filter",
                                      "stage_publish"})
        count, low, high, total, *bins = struct.unpack("<3IQ96I", self.read(0x214A, 4))
        sync = found["sync_to_tpdo"]
        self.assertEqual((count, sum(bins)), (25, 25))
        self.assertEqual((sync["count"], sync["minimum"], sync["maximum"]), (count, low, high))
        self.assertAlmostEqual(sync["mean"], total / count, 3)
        # the bins by the words of the EDS: 0 to 7 one by one, then 8, 10, 12, 14, 16, 20, ...
        edges = [*range(8)] + [(4 + k % 4) << (k // 4 - 1) for k in range(8, 96)]
        self.assertEqual(edges[8:14], [8, 10, 12, 14, 16, 20])
        self.assertEqual([(b["from"], b["count"]) for b in sync["bins"]], [e for e in zip(edges, bins) if e[1]])

    def test_the_monitor_prints_what_pdos_carry(self):
        done = rig.run("imu9-monitor", "-i", self.bus, "-n", NODE, "--json", "--start", "--sync", "50", "-t", "1.5")
        lines = [valid("monitor", line) for line in done.stdout.splitlines()]
        last = {value["name"]: value for value in lines[-1]["values"]}
        self.assertEqual(last["acceleration.l"]["unit"], "m/s^2")
        self.assertIn("valid", last["sample.status"]["words"])

    def test_scan_has_the_identity(self):
        nodes = valid("scan", self.sdo("scan"))["nodes"]
        serial, = struct.unpack("<I", self.read(0x1018, 4))
        self.assertEqual([n["serial"] for n in nodes if n["node"] == NODE], [serial])

    def test_log_has_the_events_of_the_text(self):
        events = valid("log", self.sdo("log"))["events"]
        text = rig.run("imu9-sdo", "-i", self.bus, "-n", NODE, "log").stdout
        self.assertEqual([(e["t"], e["text"]) for e in events[:2]],
                         [(float(line[:14]), line[15:]) for line in text.splitlines()[:2]])

    def test_dcf_compare_has_the_differences(self):
        self.write(0x2000, 1, struct.pack("<f", 0.125))
        path = rig.scratch(".dcf")
        rig.run("imu9-sdo", "-i", self.bus, "-n", NODE, "dcf", "save", str(path))
        same = valid("compare", self.sdo("dcf", "compare", str(path)))
        self.assertEqual(same["differences"], [])
        self.write(0x2000, 1, struct.pack("<f", 0.25))
        result = valid("compare", self.sdo("dcf", "compare", str(path), status=1))
        self.assertEqual(result["differences"],
                         [{"name": "lever_arm.l", "address": "2000h:01", "unit": "m", "node": 0.25, "file": 0.125}])
        self.assertEqual(result["same"], same["same"] - 1)

    def test_commands_without_it_refuse_it(self):
        self.sdo("write", "lever_arm.l", "0", status=2)

    def test_the_one_liners_of_the_readme_run(self):
        text = (rig.ROOT / "tools/README.md").read_text()
        lines = re.findall(r"(?m)^    \$ (imu9-\w+ .*--json.*\| (?:jq|python3) .*)$", text)
        self.assertGreaterEqual(len(lines), 4)
        environment = dict(os.environ, IMU9_CAN=self.bus, IMU9_NODE=str(NODE),
                           PATH="%s:%s" % (rig.BUILD, os.environ["PATH"]))
        path = rig.scratch(".dcf")
        rig.run("imu9-sdo", "-i", self.bus, "-n", NODE, "dcf", "save", str(path))
        for line in lines:
            done = subprocess.run(["bash", "-o", "pipefail", "-c", line.replace("node5.dcf", str(path))],
                                  env=environment, capture_output=True, text=True, timeout=30)
            self.assertEqual(done.returncode, 0, line + "\n" + done.stderr)
            self.assertNotEqual(done.stdout.strip(), "", line)
