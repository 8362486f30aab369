"""Wireshark's CANopen dissector on all frames of vcan0. `run` records the capture and runs this module last."""
import collections
import os
import re
import subprocess
import unittest


class TheWholeRun(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        capture = os.environ.get("IMU9_CAPTURE")
        if not capture:
            raise unittest.SkipTest("no capture: tests/interop/run takes one (with dumpcap, of Debian's tshark)")
        fields = ("frame.number", "can.id", "frame.protocols", "_ws.malformed", "_ws.expert.severity", "_ws.col.Info")
        result = subprocess.run(
            ["tshark", "-r", capture, "-d", "can.subdissector,canopen", "-T", "fields"] +
            [word for field in fields for word in ("-e", field)], capture_output=True, text=True, timeout=600)
        assert result.returncode == 0, result.stderr
        frames = [dict(zip(fields, line.split("\t"))) for line in result.stdout.splitlines()]
        # remote frames have no data, so only the CAN dissector handles them
        cls.frames = [f for f in frames if "Remote Transmission Request" not in f["_ws.col.Info"]]

    def test_every_frame_is_dissected_as_canopen(self):
        self.assertGreater(len(self.frames), 5000)
        # a SYNC without counter has no data: the dissector fills the Info column only
        wanted = {("can:canopen", True), ("can", False)}
        odd = [f for f in self.frames if (f["frame.protocols"], f["_ws.col.Info"] != "SYNC") not in wanted]
        self.assertEqual(odd, [])

    def test_no_frame_is_malformed(self):
        bad = [f for f in self.frames if f["_ws.malformed"] or f["_ws.expert.severity"]]
        self.assertEqual(bad, [])

    def test_every_service_is_recognised(self):
        kinds = collections.Counter(re.match(r"\w+", f["_ws.col.Info"])[0] for f in self.frames)
        self.note = ", ".join("%s %d" % pair for pair in kinds.most_common())
        # "Default" are the SDOs of the first server; "NMT" includes error control
        self.assertEqual(set(kinds), {"NMT", "SYNC", "TIME", "EMCY", "PDO1", "PDO2", "PDO3", "PDO4", "Default", "LSS"})


if __name__ == "__main__":
    unittest.main()
