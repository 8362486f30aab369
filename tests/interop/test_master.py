"""The tests' own CANopen master against frames written by hand from CiA 301, over python-can's virtual bus."""
import threading
import unittest

import can

import canopen_master as canopen


class Script(threading.Thread):
    """A scripted server: expects each request and sends its answer."""

    def __init__(self, lines):
        super().__init__()
        self.bus = can.Bus(interface="virtual", channel="master")
        self.lines, self.mistakes = lines, []
        self.start()

    def run(self):
        for request, answer in self.lines:
            frame = self.bus.recv(120)
            got = None if frame is None else "%03X#%s" % (frame.arbitration_id, frame.data.hex())
            if got != request:
                self.mistakes.append("%s instead of %s" % (got, request))
            if answer:
                can_id, data = answer.split("#")
                self.bus.send(can.Message(
                    arbitration_id=int(can_id, 16), data=bytes.fromhex(data), is_extended_id=False))
        self.bus.shutdown()


class TheMaster(unittest.TestCase):
    def setUp(self):
        self.master = canopen.Master(can.Bus(interface="virtual", channel="master"))

    def tearDown(self):
        self.master.close()

    def play(self, lines, action):
        script = Script(lines)
        try:
            return action()
        finally:
            script.join()
            self.assertEqual(script.mistakes, [])

    def test_an_expedited_upload_returns_the_indicated_number_of_bytes(self):
        lines = [("605#4000100000000000", "585#430010009a010400"), ("605#4001100000000000", "585#4f01100081000000")]
        self.assertEqual(
            self.play(lines, lambda: (self.master.upload(5, 0x1000), self.master.upload(5, 0x1001))),
            (bytes.fromhex("9a010400"), b"\x81"))

    def test_a_segmented_upload_is_assembled_with_alternating_toggle(self):
        lines = [
            ("605#4008100000000000", "585#410810000a000000"),
            ("605#6000000000000000", "585#0041424344454647"),
            ("605#7000000000000000", "585#1948494a00000000"),
        ]
        self.assertEqual(self.play(lines, lambda: self.master.upload(5, 0x1008)), b"ABCDEFGHIJ")

    def test_a_segment_with_the_wrong_toggle_is_refused(self):
        lines = [("605#4008100000000000", "585#410810000a000000"), ("605#6000000000000000", "585#1041424344454647")]
        with self.assertRaises(canopen.ProtocolError):
            self.play(lines, lambda: self.master.upload(5, 0x1008))

    def test_a_length_other_than_announced_is_refused(self):
        lines = [("605#4008100000000000", "585#410810000a000000"), ("605#6000000000000000", "585#0141424344454647")]
        with self.assertRaises(canopen.ProtocolError):
            self.play(lines, lambda: self.master.upload(5, 0x1008))

    def test_an_expedited_download_indicates_its_size(self):
        lines = [("605#2b171000e8030000", "585#6017100000000000"), ("605#2300200100004842", "585#6000200100000000")]
        self.play(lines, lambda: (
            self.master.download(5, 0x1017, 0, b"\xe8\x03"), self.master.download(5, 0x2000, 1, b"\x00\x00\x48\x42")))

    def test_a_segmented_download_marks_its_last_segment(self):
        lines = [
            ("605#2110200009000000", "585#6010200000000000"),
            ("605#0031323334353637", "585#2000000000000000"),
            ("605#1b38390000000000", "585#3000000000000000"),
        ]
        self.play(lines, lambda: self.master.download(5, 0x2010, 0, b"123456789"))

    def test_an_abort_has_its_code(self):
        with self.assertRaises(canopen.Abort) as caught:
            self.play([("605#4000300000000000", "585#8000300000000206")], lambda: self.master.upload(5, 0x3000))
        self.assertEqual(caught.exception.code, 0x06020000)

    def test_nmt_and_sync_follow_cia_301(self):
        self.play([("000#0105", None), ("080#", None), ("080#07", None)], lambda: (
            self.master.nmt(canopen.START, 5), self.master.sync(), self.master.sync(7)))

    def test_a_pdo_is_decoded_little_endian_and_signed(self):
        self.assertEqual(canopen.decode(bytes.fromhex("fffffe7f0080ff00"), "hhhH"), (-1, 32766, -32768, 255))

    def test_a_pdo_of_another_length_than_mapped_is_refused(self):
        with self.assertRaises(canopen.ProtocolError):
            canopen.decode(bytes(7), "hhhH")

    def test_an_emergency_is_decoded(self):
        frame = can.Message(arbitration_id=0x85, data=bytes.fromhex("1081110102030405"), is_extended_id=False)
        self.assertEqual(canopen.emergency(frame), (0x8110, 0x11, bytes([1, 2, 3, 4, 5])))


if __name__ == "__main__":
    unittest.main()
