"""Conformance with CiA 301, 302-2 and 305 on a real bus, beyond test_bus.py: SDO block transfers with lost segments,
two SDO channels, error control, SYNC and TIME, remote requests, LSS fastscan. The expected answers are from the
documents."""
import binascii
import signal
import struct
import time
import unittest

import can

import canopen_master as canopen
import rig
from rig import NODE, u8, u16, u32

CRC, BLOCK_SIZE, SEQUENCE = 0x05040004, 0x05040002, 0x05040003
LSS_REQUEST, LSS_RESPONSE = 0x7E5, 0x7E4
OTHER_NODE = 5  # node-ID of a second node, simulated by this test


class BlockTransfer(rig.OnTheBus):
    """SDO block transfer (CiA 301, 7.2.4.3.9 to 16). The client drops segment n, counted from 1, if lost(n) is true."""

    def request(self, *data):
        self.master.send(canopen.SDO_RX + NODE, bytes(data).ljust(8, b"\0"))
        return self.answer()

    def answer(self):
        data = bytes(self.master.wait(canopen.SDO_TX + NODE).data)
        if data[0] == 0x80:
            raise canopen.Abort(*struct.unpack("<xHBI", data))
        return data

    @canopen.again_after_a_timeout
    def upload(self, index, block_size, lost=lambda n: False):
        """The bytes of the object and the CRC that the server sent."""
        data, count = b"", 0
        answer = self.request(0xA4, index & 0xFF, index >> 8, 0, block_size)
        self.assertEqual(answer[0], 0xC6)
        size = struct.unpack_from("<I", answer, 4)[0]
        self.master.send(canopen.SDO_RX + NODE, b"\xA3" + bytes(7))
        while len(data) < size:
            in_order, done = 0, False
            segments = min(block_size, -(-(size - len(data)) // 7))
            for sequence in range(1, segments + 1):
                segment = self.answer()
                self.assertEqual(segment[0] & 0x7F, sequence)
                count += 1
                if sequence == in_order + 1 and not lost(count):
                    in_order, data = sequence, data + segment[1:]
                    done = bool(segment[0] & 0x80)
            self.master.send(canopen.SDO_RX + NODE, bytes((0xA2, in_order, block_size)) + bytes(5))
            if done:
                break
        end = self.answer()
        self.assertEqual(end[0] & 0xE3, 0xC1)
        self.master.send(canopen.SDO_RX + NODE, b"\xA1" + bytes(7))
        data = data[:len(data) - (end[0] >> 2 & 7)]
        self.assertEqual(len(data), size)
        return data, struct.unpack_from("<H", end, 1)[0]

    @canopen.again_after_a_timeout
    def download(self, index, data, lost=lambda n: False, crc=None):
        answer = self.request(0xC6, index & 0xFF, index >> 8, 0, *u32(len(data)))
        self.assertEqual(answer[0] & 0xFB, 0xA0)
        size, at, count = answer[4], 0, 0
        while at < len(data):
            segments = [data[at + i * 7:at + i * 7 + 7] for i in range(size) if at + i * 7 < len(data)]
            for i, segment in enumerate(segments):
                last = at + (i + 1) * 7 >= len(data)
                count += 1
                if not lost(count):
                    self.master.send(
                        canopen.SDO_RX + NODE, bytes((i + 1 | (0x80 if last else 0),)) + segment.ljust(7, b"\0"))
            answer = self.answer()
            self.assertEqual(answer[0], 0xA2)
            at, size = at + answer[1] * 7, answer[2]
        crc = binascii.crc_hqx(data, 0) if crc is None else crc
        self.assertEqual(self.request(0xC1 | (-len(data) % 7) << 2, *u16(crc))[0], 0xA1)

    def test_block_upload_of_the_eds_with_crc(self):
        data, crc = self.upload(0x1021, 127)
        self.assertEqual(data, rig.EDS.read_bytes())
        self.assertEqual(crc, binascii.crc_hqx(data, 0))

    def test_lost_upload_segments_are_retransmitted(self):
        data, crc = self.upload(0x2130, 20, lambda n: n % 11 == 0)
        self.assertEqual(crc, binascii.crc_hqx(data, 0))
        self.assertEqual(data, self.upload(0x2130, 127)[0])

    def test_the_last_upload_segment_is_retransmitted(self):
        whole = self.upload(0x1008, 127)[0]
        self.assertEqual(self.upload(0x1008, 127, lambda n: n == -(-len(whole) // 7))[0], whole)

    def test_every_block_size_uploads_the_same_bytes(self):
        whole = self.upload(0x2130, 127)[0]
        for size in (1, 2, 7, 31, 126):
            self.assertEqual(self.upload(0x2130, size)[0], whole)

    def test_block_download_of_a_snapshot_with_lost_segments(self):
        self.write(0x2000, 1, struct.pack("<f", 0.125))
        snapshot = self.upload(0x2130, 127)[0]
        self.write(0x2000, 1, struct.pack("<f", 0.5))
        self.download(0x2130, snapshot, lambda n: n in (3, 32, 40))
        self.assertEqual(self.read(0x2000, 1), struct.pack("<f", 0.125))
        self.assertEqual(self.upload(0x2130, 127)[0], snapshot)
        self.write(0x2000, 1, bytes(4))

    def test_a_download_with_a_wrong_crc_is_aborted_and_not_applied(self):
        snapshot = self.upload(0x2130, 127)[0]
        self.write(0x2000, 1, struct.pack("<f", 0.5))
        self.assert_aborts(CRC, self.download, 0x2130, snapshot, lambda n: False, 0x1234)
        self.assertEqual(self.read(0x2000, 1), struct.pack("<f", 0.5))
        self.write(0x2000, 1, bytes(4))

    def test_invalid_block_sizes_and_sequence_numbers_are_aborted(self):
        for size in (0, 128):
            self.assert_aborts(BLOCK_SIZE, self.upload, 0x1021, size)
        self.request(0xA4, 0x08, 0x10, 0, 10)
        self.master.send(canopen.SDO_RX + NODE, b"\xA3" + bytes(7))
        self.master.wait(lambda f: f.arbitration_id == canopen.SDO_TX + NODE and f.data[0] & 0x80)
        self.assert_aborts(SEQUENCE, self.request, 0xA2, 9, 10)

    def test_up_to_the_protocol_switch_threshold_the_answer_is_an_expedited_upload(self):
        self.assertEqual(self.request(0xA4, 0x00, 0x10, 0, 10, 4).hex(), "430010009a010400")
        self.assertEqual(self.request(0xA4, 0x00, 0x10, 0, 10, 3)[0], 0xC6)


class SeveralClients(rig.OnTheBus):
    """On vcan1, because the dissector that checks vcan0 decodes the predefined COB-IDs only."""

    bus = rig.ROUGH_BUS

    def test_eight_clients_have_transfers_at_the_same_time(self):
        channels = [(0x600 + NODE, 0x580 + NODE)] + [(0x680 + n, 0x690 + n) for n in range(1, 8)]
        for n, (request, response) in list(enumerate(channels))[1:]:
            self.write(0x1200 + n, 1, u32(request))
            self.write(0x1200 + n, 2, u32(response))
        requests = [bytes.fromhex("4008100000000000")] + [bytes((0x60 | t,)) + bytes(7) for t in (0, 0x10, 0)]
        texts = [b""] * len(channels)
        for request in requests:  # a string of 20 bytes, segment by segment on all channels in turn
            for n, (to, back) in enumerate(channels):
                self.master.send(to, request)
                answer = self.master.wait(lambda f, back=back: f.arbitration_id == back).data
                if request[0] != 0x40:
                    texts[n] += answer[1:8 - (answer[0] >> 1 & 7)]
        self.assertEqual(texts, [self.read(0x1008)] * len(channels))


class ErrorControl(rig.OnTheBus):
    def heartbeat(self, state=canopen.STATE_OPERATIONAL):
        self.master.send(canopen.HEARTBEAT + OTHER_NODE, u8(state))

    def test_a_missing_heartbeat_sends_emcy_8130h_and_enters_pre_operational_until_it_returns(self):
        self.write(0x1017, 0, u16(20))
        self.write(0x1016, 1, u32(OTHER_NODE << 16 | 150))
        self.start()
        self.heartbeat()
        started = time.monotonic()
        _, error_register, manufacturer_bytes = canopen.emergency(self.emcy(0x8130))
        self.assertGreater(time.monotonic() - started, 0.1)
        self.assertEqual((error_register & 0x11, manufacturer_bytes[0]), (0x11, OTHER_NODE))
        self.master.wait_state(NODE, canopen.STATE_PRE_OPERATIONAL)
        self.heartbeat()
        self.emcy(0x0000)

    def test_1029h_selects_stopped_or_no_change_after_a_heartbeat_error(self):
        for behaviour, state in ((2, canopen.STATE_STOPPED), (1, canopen.STATE_OPERATIONAL)):
            self.reset()
            self.write(0x1017, 0, u16(20))
            self.write(0x1029, 1, u8(behaviour))
            self.write(0x1016, 1, u32(OTHER_NODE << 16 | 100))
            self.start()
            self.heartbeat()
            self.emcy(0x8130)
            self.master.drain()
            self.master.wait_state(NODE, state)
        self.assertEqual({f.data[0] for f in self.master.listen(0.1) if f.arbitration_id == canopen.HEARTBEAT + NODE},
                         {canopen.STATE_OPERATIONAL})

    def test_two_consumer_heartbeat_times_for_one_node_are_refused(self):
        self.write(0x1016, 1, u32(OTHER_NODE << 16 | 100))
        self.assert_aborts(0x06040043, self.write, 0x1016, 2, u32(OTHER_NODE << 16 | 200))

    def guard(self):
        """The answer to one node guarding request."""
        self.master.bus.send(can.Message(
            arbitration_id=canopen.HEARTBEAT + NODE, is_remote_frame=True, dlc=1, is_extended_id=False))
        return self.master.wait(
            lambda f: f.arbitration_id == canopen.HEARTBEAT + NODE and not f.is_remote_frame).data[0]

    def test_node_guarding_toggles_its_bit_and_reset_communication_clears_it(self):
        self.write(0x1017, 0, u16(0))
        self.assertEqual([self.guard() for _ in range(3)], [0x7F, 0xFF, 0x7F])
        self.start()
        self.assertEqual([self.guard() for _ in range(2)], [0x85, 0x05])
        self.guard()
        self.reset()
        self.write(0x1017, 0, u16(0))
        self.assertEqual(self.guard(), 0x7F)

    def test_a_life_guarding_timeout_sends_emcy_8130h(self):
        self.write(0x1017, 0, u16(0))
        self.write(0x100C, 0, u16(100))
        self.write(0x100D, 0, u8(2))
        self.start()
        self.guard()
        self.assertEqual(canopen.emergency(self.emcy(0x8130))[2][0], 0)
        self.guard()
        self.emcy(0x0000)


class Producers(rig.OnTheBus):
    def test_a_sync_producer_sends_its_own_synchronous_pdos(self):
        self.write(0x1019, 0, u8(4))
        self.write(0x1006, 0, u32(20000))
        self.write(0x1005, 0, u32(0x40000080))
        self.start()
        before = len(self.master.frames)
        self.master.collect(canopen.SYNC, 20)
        frames = self.master.frames[before:]
        self.write(0x1005, 0, u32(0x80))
        first = next(i for i, f in enumerate(frames) if f.arbitration_id == canopen.TPDO[0] + NODE)
        frames = frames[first - 1:]  # from the first SYNC in state operational
        counters = [f.data[0] for f in frames if f.arbitration_id == canopen.SYNC]
        self.assertGreater(len(counters), 10)
        self.assertEqual(counters, [(counters[0] + i - 1) % 4 + 1 for i in range(len(counters))])
        self.assertGreaterEqual(len(self.pdos(frames)), len(counters) - 1)

    def test_a_time_message_of_the_master_sets_the_time_status_of_samples(self):
        self.write(0x1012, 0, u32(0x80000100))
        day, ms = 15000, 43200000
        self.master.send(0x100, struct.pack("<IH", ms, day))
        self.master.listen(0.1)
        self.assertTrue(struct.unpack("<H", self.read(0x210F, 3))[0] & 1 << 13)

    def test_a_pdo_of_type_253_is_sent_on_a_remote_request(self):
        self.write(0x1800, 1, u32(1 << 31 | 0x180 + NODE))
        self.write(0x1800, 2, u8(253))
        self.write(0x1800, 1, u32(0x180 + NODE))
        self.start()
        self.assertEqual(self.pdos(self.master.listen(0.1)), [])
        self.master.bus.send(can.Message(
            arbitration_id=0x180 + NODE, is_remote_frame=True, dlc=8, is_extended_id=False))
        answer = self.master.wait(lambda f: f.arbitration_id == 0x180 + NODE and not f.is_remote_frame)
        self.assertEqual(len(answer.data), 8)

    def test_bit_31_of_1014h_disables_emcy_but_not_the_error_register(self):
        self.write(0x1014, 0, u32(1 << 31 | 0x80 + NODE))
        self.write(0x1019, 0, u8(10))
        self.master.drain()
        self.master.sync()
        self.assertEqual([f for f in self.master.listen(0.2) if f.arbitration_id == 0x80 + NODE], [])
        self.assertEqual(self.read(0x1001)[0] & 0x11, 0x11)


class StoredCommunication(unittest.TestCase):
    def setUp(self):
        self.master = rig.open_master()
        self.addCleanup(self.master.close)
        self.gateway = rig.Gateway()
        self.addCleanup(self.gateway.close)
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP)

    def test_reset_communication_restores_the_stored_values_not_the_defaults(self):
        self.master.download(NODE, 0x1017, 0, u16(200))
        self.master.download(NODE, 0x1010, 2, canopen.SAVE)
        self.master.download(NODE, 0x1017, 0, u16(300))
        self.master.nmt(canopen.RESET_COMMUNICATION, NODE)
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP)
        self.assertEqual(self.master.upload(NODE, 0x1017), u16(200))

    def test_a_node_with_1f80h_bit_2_clear_starts_itself_after_kill_9(self):
        self.master.download(NODE, 0x1F80, 0, u32(0))
        self.master.download(NODE, 0x1017, 0, u16(50))
        self.master.download(NODE, 0x1010, 1, canopen.SAVE)
        self.gateway.end(signal.SIGKILL)
        self.gateway.start()
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP)
        self.master.wait_state(NODE, canopen.STATE_OPERATIONAL)


class Fastscan(unittest.TestCase):
    """The master finds the identity of an unconfigured node bit by bit (CiA 305, 3.12)."""

    def setUp(self):
        self.master = rig.open_master()
        self.addCleanup(self.master.close)
        self.gateway = rig.Gateway("--node-id", "255")
        self.addCleanup(self.gateway.close)

    def request(self, *data):
        self.master.send(LSS_REQUEST, bytes(data).ljust(8, b"\0"))

    def is_unconfigured(self):
        self.request(0x4C)
        return any(f.arbitration_id == LSS_RESPONSE for f in self.master.listen(0.1))

    def confirms(self, number, bits, bit, following):
        """Whether the node confirms these bits. Each request is followed by "identify non-configured slaves" (4Ch). Its
        answer always comes, and after the confirmation, so that a missing confirmation needs no timeout."""
        self.request(0x51, *u32(bits), bit, number, following)
        self.request(0x4C)
        answers = []
        while answers[-1:] != [0x50]:
            answer = self.master.wait(LSS_RESPONSE)
            self.assertEqual(answer.data[1:], bytes(7))
            answers.append(answer.data[0])
        self.assertIn(answers, ([0x50], [0x4F, 0x50]))
        return len(answers) == 2

    def test_fastscan_finds_the_identity_and_assigns_a_node_id(self):
        rig.wait_until(self.is_unconfigured)
        self.master.listen(0.5)  # late answers to the requests sent while it started
        self.assertTrue(self.confirms(0, 0, 0x80, 0))
        identity = []
        for number in range(4):
            bits = 0
            for bit in range(31, -1, -1):
                if not self.confirms(number, bits, bit, number):
                    bits |= 1 << bit
            self.assertTrue(self.confirms(number, bits, 0, (number + 1) % 4), "%08X" % bits)
            identity.append(bits)
        self.request(0x11, NODE)
        self.master.wait(lambda f: f.arbitration_id == LSS_RESPONSE and f.data[:2] == b"\x11\0")
        self.request(0x04, 0)
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP)
        reported = [struct.unpack("<I", self.master.upload(NODE, 0x1018, sub))[0] for sub in (1, 2, 3, 4)]
        self.assertEqual(identity, reported)


if __name__ == "__main__":
    unittest.main()
