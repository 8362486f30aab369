"""The device on a SocketCAN bus with independent clients: python3-can, can-utils, the kernel."""
import random
import re
import signal
import statistics
import struct
import subprocess
import time
import unittest
import zlib

import canopen_master as canopen
import eds_file
import rig
from rig import NODE, u8, u16, u32

OBJECTS = eds_file.read(rig.EDS, NODE)
NO_DATA, READ_ONLY, WRITE_ONLY, NO_OBJECT, NO_SUBINDEX = 0x08000024, 0x06010002, 0x06010001, 0x06020000, 0x06090011
TOO_LONG, TOO_SHORT, BAD_VALUE, TOO_HIGH, TOO_LOW = 0x06070012, 0x06070013, 0x06090030, 0x06090031, 0x06090032
NOT_MAPPABLE, PDO_LENGTH, UNSUPPORTED_ACCESS = 0x06040041, 0x06040042, 0x06010000
TOGGLE, BAD_COMMAND = 0x05030000, 0x05040001
LEVER_ARM_L = (0x2000, 1)
COUNT_ON = (0x2149, 0x214A, 0x214B, 0x2151, 0x2152, 0x2153)  # histograms: only 0 can be written to their count
DEFAULT_HEARTBEAT = struct.pack("<H", OBJECTS[0x1017, 0].default)


def f32(value):
    return struct.pack("<f", value)


def next_f32(value, direction):
    """The adjacent REAL32, away from zero if direction has the sign of value."""
    bits = struct.unpack("<i", f32(value))[0]
    return struct.unpack("<f", struct.pack("<i", bits + (direction if value > 0 else -direction)))[0]


def period(frames):
    """The median interval [s]: a busy machine delays some frames."""
    return statistics.median(b.timestamp - a.timestamp for a, b in zip(frames, frames[1:]))


class NetworkManagement(rig.OnTheBus):
    def heartbeats(self, ms):
        self.write(0x1017, 0, u16(ms))

    def test_reset_node_sends_one_boot_up_and_enters_pre_operational(self):
        self.master.nmt(canopen.RESET_NODE, NODE)
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP)
        self.heartbeats(50)
        frames = [f for f in self.master.listen(0.3) if f.arbitration_id == canopen.HEARTBEAT + NODE]
        self.assertEqual({bytes(f.data) for f in frames}, {b"\x7f"})

    def test_start_stop_and_pre_operational_show_in_the_heartbeat(self):
        self.heartbeats(20)
        for command, state in (
                (canopen.START, canopen.STATE_OPERATIONAL), (canopen.STOP, canopen.STATE_STOPPED),
                (canopen.PRE_OPERATIONAL, canopen.STATE_PRE_OPERATIONAL)):
            self.master.nmt(command, NODE)
            self.master.wait_state(NODE, state)

    def test_a_command_to_all_nodes_is_executed_and_one_to_another_node_is_not(self):
        self.heartbeats(20)
        self.master.nmt(canopen.START, 0)
        self.master.wait_state(NODE, canopen.STATE_OPERATIONAL)
        self.master.nmt(canopen.STOP, NODE + 1)
        self.master.drain()
        frames = [f for f in self.master.listen(0.1) if f.arbitration_id == canopen.HEARTBEAT + NODE]
        self.assertEqual({bytes(f.data) for f in frames}, {b"\x05"})

    def test_the_heartbeat_keeps_its_period(self):
        self.heartbeats(50)
        self.assertAlmostEqual(period(self.master.collect(canopen.HEARTBEAT + NODE, 25)), 0.050, delta=0.001)

    def test_a_stopped_node_answers_no_sdo(self):
        self.master.nmt(canopen.STOP, NODE)
        self.master.patience = 0.2
        with self.assertRaises(canopen.Timeout):
            self.read(0x1000)

    def test_reset_communication_resets_communication_objects_only(self):
        self.heartbeats(50)
        self.write(*LEVER_ARM_L, f32(0.25))
        self.reset(canopen.RESET_COMMUNICATION)
        self.assertEqual(self.read(0x1017), DEFAULT_HEARTBEAT)
        self.assertEqual(self.read(*LEVER_ARM_L), f32(0.25))
        self.reset(canopen.RESET_NODE)
        self.assertEqual(self.read(*LEVER_ARM_L), f32(0))


class AStoppedProcess(rig.OnTheBus):
    def test_the_sensor_is_not_lost_after_the_process_was_suspended(self):
        for _ in range(4):
            self.gateway.process.send_signal(signal.SIGSTOP)
            time.sleep(0.5)
            self.gateway.process.send_signal(signal.SIGCONT)
            self.master.listen(0.3)
        self.assertEqual([bytes(f.data).hex() for f in self.master.frames
                          if f.arbitration_id == canopen.EMCY + NODE], [])


class SdoServer(rig.OnTheBus):
    def readable(self):
        """(entry, bytes) of every object that has a value now."""
        for (index, sub), entry in OBJECTS.items():
            if entry.access == "wo" or entry.type == eds_file.DOMAIN:
                continue
            try:
                yield entry, self.read(index, sub)
            except canopen.Abort as abort:
                if index != 0x1003 or abort.code != NO_DATA:  # an unused entry of the error history
                    self.fail("%s: %s" % (entry.where, abort))

    def test_every_object_of_the_eds_has_its_type_and_its_default(self):
        self.reset(canopen.RESET_NODE)
        set_at_start_up = {(0x1009, 0), (0x100A, 0), (0x1018, 4)}
        compared = 0
        for entry, data in self.readable():
            if entry.numeric:
                self.assertEqual(len(data), entry.size, entry.where)
            if (entry.index, entry.sub) in set_at_start_up or entry.access == "ro" or entry.default is None:
                continue
            wanted = entry.encode(entry.default) if entry.numeric else entry.default.encode()
            self.assertEqual(data, wanted, entry.where)
            compared += 1
        self.assertGreater(compared, 150)

    def test_identity_and_software_version_are_those_of_eds_and_program(self):
        for sub in (1, 2, 3):
            self.assertEqual(self.read(0x1018, sub), u32(OBJECTS[0x1018, sub].default))
        version = rig.run("imu9-gateway", "--version").stdout.split()[1]
        self.assertEqual(self.read(0x100A).decode(), version)
        self.assertEqual(self.read(0x1F56, 1), u32(zlib.crc32(version.encode())))

    def test_the_eds_can_be_read_from_the_device_itself(self):
        self.assertEqual(self.read(0x1022), u8(0))
        reader = rig.open_master(own_frames=False)  # without its own of 15000 frames it is five times as fast
        self.addCleanup(reader.close)
        self.assertEqual(reader.upload(NODE, 0x1021), rig.EDS.read_bytes())

    def test_a_write_to_a_read_only_or_constant_object_is_refused(self):
        for (index, sub), entry in OBJECTS.items():
            if entry.access in ("ro", "const") and entry.numeric:
                self.assert_aborts(READ_ONLY, self.write, index, sub, bytes(entry.size))

    def test_a_read_of_a_write_only_object_is_refused(self):
        write_only = [key for key, entry in OBJECTS.items() if entry.access == "wo"]
        self.assertTrue(write_only)
        for index, sub in write_only:
            self.assert_aborts(WRITE_ONLY, self.read, index, sub)

    def test_an_access_to_a_missing_object_is_refused(self):
        self.assert_aborts(NO_OBJECT, self.read, 0x3000, 0)
        self.assert_aborts(NO_OBJECT, self.write, 0x1FFF, 1, u8(0))
        self.assert_aborts(NO_SUBINDEX, self.read, 0x1018, 5)
        self.assert_aborts(NO_SUBINDEX, self.write, 0x2000, 4, f32(0))
        self.assert_aborts(NO_SUBINDEX, self.read, 0x1000, 1)

    def test_values_outside_the_limits_are_refused_and_the_old_value_remains(self):
        tried = 0
        for (index, sub), entry in OBJECTS.items():
            if entry.access not in ("rw", "wo"):
                continue
            for limit, direction, code in ((entry.low, -1, TOO_LOW), (entry.high, 1, TOO_HIGH)):
                if limit is None:
                    continue
                if entry.type != eds_file.REAL32:
                    beyond = limit + direction
                elif limit == 0:
                    beyond = direction * 1e-30
                else:
                    beyond = next_f32(limit, direction)
                try:
                    data = entry.encode(beyond)
                except struct.error:
                    continue  # the limit is that of the type
                before = None if entry.access == "wo" else self.read(index, sub)
                self.assert_aborts(code, self.write, index, sub, data)
                if index in COUNT_ON:
                    self.assertGreaterEqual(int.from_bytes(self.read(index, sub), "little"),
                                            int.from_bytes(before, "little"), entry.where)
                elif before is not None:
                    self.assertEqual(self.read(index, sub), before, entry.where)
                tried += 1
        self.assertGreater(tried, 100)

    def test_a_value_of_the_wrong_size_is_refused(self):
        for (index, sub), entry in OBJECTS.items():
            if entry.access == "rw" and entry.numeric:
                self.assert_aborts(TOO_LONG, self.master.download, NODE, index, sub, bytes(entry.size + 1))
                if entry.size > 1:
                    self.assert_aborts(TOO_SHORT, self.write, index, sub, bytes(entry.size - 1))

    def test_nan_and_infinity_are_refused(self):
        for value in (float("nan"), float("inf"), float("-inf")):
            with self.assertRaises(canopen.Abort) as caught:
                self.write(*LEVER_ARM_L, f32(value))
            self.assertIn(caught.exception.code, (BAD_VALUE, TOO_HIGH, TOO_LOW))
        self.assertEqual(self.read(*LEVER_ARM_L), f32(0))

    def test_a_number_can_be_written_by_segmented_transfer(self):
        self.master.download(NODE, *LEVER_ARM_L, f32(0.5), segmented=True)
        self.assertEqual(self.read(*LEVER_ARM_L), f32(0.5))
        self.write(*LEVER_ARM_L, f32(0))

    def test_a_segment_with_the_wrong_toggle_ends_the_transfer(self):
        self.master.sdo_request(NODE, bytes.fromhex("4008100000000000"))
        answer = self.master.sdo_request(NODE, bytes.fromhex("7000000000000000"))
        self.assertEqual(answer, bytes.fromhex("80081000") + u32(TOGGLE))
        answer = self.master.sdo_request(NODE, bytes.fromhex("6000000000000000"))
        self.assertEqual((answer[0], answer[4:]), (0x80, u32(BAD_COMMAND)))

    def test_an_unknown_command_is_refused(self):
        answer = self.master.sdo_request(NODE, bytes.fromhex("e000200100000000"))
        self.assertEqual((answer[0], answer[4:]), (0x80, u32(BAD_COMMAND)))

    def test_an_abort_by_the_client_ends_the_transfer_without_an_answer(self):
        self.master.sdo_request(NODE, bytes.fromhex("4008100000000000"))
        self.master.drain()
        self.master.send(canopen.SDO_RX + NODE, bytes.fromhex("8008100000000008"))
        self.assertEqual([f for f in self.master.listen(0.1) if f.arbitration_id == canopen.SDO_TX + NODE], [])
        self.assertEqual(self.read(0x1000), u32(0x0004019A))


class ProcessData(rig.OnTheBus):
    def sync(self, times, counter_of=None, answered=True):
        """Sends SYNCs every 20 ms, or after TPDO4, the last one of a SYNC; returns the frames received meanwhile."""
        first = len(self.master.frames)
        for i in range(times):
            self.master.sync(counter_of(i) if counter_of else None)
            if answered:
                self.master.wait(canopen.TPDO[3] + NODE)
            self.master.listen(0.02)
        return self.master.frames[first:]

    def test_no_pdo_is_sent_before_nmt_start(self):
        frames = self.sync(5, answered=False)
        self.assertEqual([self.pdos(frames, n) for n in (1, 2, 3, 4)], [[], [], [], []])

    def test_each_sync_triggers_four_pdos_of_one_sample(self):
        self.start()
        frames = self.sync(20)
        numbers = [canopen.decode(f.data, "HHI")[1] for f in self.pdos(frames, 4)]
        for number in (1, 2, 3):
            self.assertEqual([canopen.decode(f.data, "hhhH")[3] for f in self.pdos(frames, number)], numbers)
        self.assertEqual(len(numbers), 20)
        self.assertEqual(numbers, sorted(numbers))
        self.assertGreater(len(set(numbers)), 2)  # a busy machine may have no new sample between two SYNCs

    def test_type_n_sends_a_pdo_at_every_nth_sync(self):
        self.master.remap(NODE, 1, None, transmission=5)
        self.master.remap(NODE, 2, None, transmission=240)
        self.start()
        frames = self.sync(20)
        self.assertEqual([len(self.pdos(frames, n)) for n in (1, 2, 3)], [4, 0, 20])

    def test_event_driven_pdos_are_sent_with_each_sample_without_sync(self):
        self.master.remap(NODE, 1, None, transmission=254)
        self.start()
        self.master.listen(0.1)
        numbers = [canopen.decode(f.data, "hhhH")[3] for f in self.master.collect(canopen.TPDO[0] + NODE, 30)]
        self.assertEqual(numbers, [(numbers[0] + i) % 65536 for i in range(len(numbers))])

    def test_the_inhibit_time_is_the_minimum_interval_of_event_driven_pdos(self):
        self.master.remap(NODE, 1, None, transmission=255, inhibit=500)
        self.start()
        self.assert_no_sooner_than(0.050, self.master.collect(canopen.TPDO[0] + NODE, 15))

    def test_sync_counter_and_start_value_select_the_syncs_with_pdos(self):
        self.write(0x1019, 0, u8(10))
        self.master.remap(NODE, 1, None, transmission=2, start=3)
        self.start()
        heard, after = self.sync(14, lambda i: i % 10 + 1), []
        for i, frame in enumerate(heard):
            if frame.arbitration_id == canopen.TPDO[0] + NODE:
                after.append([f for f in heard[:i] if f.arbitration_id == canopen.SYNC][-1].data[0])
        # the SYNC with the start value is the first one that counts; then every second one
        self.assertEqual(after, [4, 6, 8, 10, 2, 4])

    def test_a_sync_of_wrong_length_raises_an_emcy_that_is_cleared(self):
        self.write(0x1019, 0, u8(10))
        for counter, wanted in ((None, (0x8240, 0x11)), (1, (0x0000, 0x00))):
            self.master.sync(counter)
            self.assertEqual(canopen.emergency(self.emcy(wanted[0]))[1] & 0x11, wanted[1])

    def test_a_new_mapping_takes_effect_at_once(self):
        default = [(0x2100, 1, 16), (0x2100, 2, 16), (0x2100, 3, 16), (0x210F, 1, 16)]
        self.assertEqual(self.master.mapping(NODE, 1), default)
        self.start()
        self.assertEqual(len(self.pdos(self.sync(1))[0].data), 8)
        self.master.remap(NODE, 1, [(0x2103, 1, 32), (0x210F, 1, 16)])
        self.assertEqual(self.master.mapping(NODE, 1), [(0x2103, 1, 32), (0x210F, 1, 16)])
        frames = self.sync(1)
        w, counter = canopen.decode(self.pdos(frames)[0].data, "fH")
        self.assertLessEqual(abs(w), 1.0)
        self.assertEqual(counter, canopen.decode(self.pdos(frames, 2)[0].data, "hhhH")[3])

    def test_another_cob_id_takes_effect_at_once(self):
        self.write(0x1800, 1, u32(1 << 31 | 0x1F5))
        self.write(0x1800, 1, u32(0x1F5))
        self.start()
        frames = self.sync(3)
        self.assertEqual((len([f for f in frames if f.arbitration_id == 0x1F5]), len(self.pdos(frames))), (3, 0))

    def test_a_mapping_is_refused_while_the_pdo_is_valid(self):
        for sub, data in ((0, u8(0)), (1, u32(0x21010110))):
            self.assert_aborts(UNSUPPORTED_ACCESS, self.write, 0x1A00, sub, data)

    def test_an_invalid_mapping_is_refused(self):
        self.write(0x1800, 1, u32(1 << 31 | canopen.TPDO[0] + NODE))
        self.write(0x1A00, 0, u8(0))
        self.assert_aborts(NOT_MAPPABLE, self.write, 0x1A00, 1, u32(0x20000120))  # the lever arm
        self.assert_aborts(NO_OBJECT, self.write, 0x1A00, 1, u32(0x30000010))
        for sub in (1, 2, 3):
            self.write(0x1A00, sub, u32(0x21030020 | sub << 8))
        self.assert_aborts(PDO_LENGTH, self.write, 0x1A00, 0, u8(3))
        self.write(0x1A00, 0, u8(2))

    def test_can_utils_see_the_same_device(self):
        dump = subprocess.Popen(
            ["candump", "-L", "-T", "2000", "-n", "2", rig.BUS + ",590:7FF,190:7FF"], stdout=subprocess.PIPE, text=True)
        time.sleep(0.3)
        for frame in ("610#4000100000000000", "000#0110", "080#"):
            subprocess.run(["cansend", rig.BUS, frame], check=True)
            time.sleep(0.05)
        lines = dump.communicate()[0].split("\n")
        self.assertRegex(lines[0], r" 590#430010009A010400$")
        self.assertRegex(lines[1], r" 190#[0-9A-F]{16}$")


class Emergencies(rig.OnTheBus):
    """A sensor that stops: a log that ends after 0.3 s."""

    @classmethod
    def setUpClass(cls):
        rows = ["%.3f,0,0,0,0,0,9.81,0,20,-40" % (i * 0.01) for i in range(30)]
        cls.imu = "replay:%s" % rig.written("t,gx,gy,gz,ax,ay,az,mx,my,mz\n" + "\n".join(rows) + "\n", ".imu.csv")
        super().setUpClass()
        rig.wait_until(lambda: "has ended" in cls.gateway.log)

    def test_a_lasting_fault_is_sent_again_after_a_reset_and_sets_the_error_register(self):
        self.reset(canopen.RESET_NODE)
        code, register, _ = canopen.emergency(self.master.wait(canopen.EMCY + NODE))
        self.assertEqual(code, 0x5030)
        self.assertEqual(register, 0x81)
        self.assertEqual(self.read(0x1001), u8(0x81))
        self.assertEqual(self.read(0x1003, 1)[:2], u16(0x5030))

    def test_the_error_history_is_cleared_by_0_and_refuses_other_values(self):
        self.assert_aborts(BAD_VALUE, self.write, 0x1003, 0, u8(1))
        self.write(0x1003, 0, u8(0))
        self.assertEqual(self.read(0x1003, 0), u8(0))
        self.assert_aborts(NO_DATA, self.read, 0x1003, 1)

    def test_the_status_word_has_the_bit_sensor_lost(self):
        status = struct.unpack("<H", self.read(0x210F, 3))[0]
        self.assertEqual((status & 1, status >> 9 & 1), (0, 1))

    def test_the_event_timer_sends_without_an_event(self):
        self.master.remap(NODE, 1, None, transmission=255, event=60)
        self.start()
        self.master.listen(0.2)
        self.assert_no_sooner_than(0.060, self.master.collect(canopen.TPDO[0] + NODE, 12))

    def test_an_acyclic_synchronous_pdo_is_sent_only_after_an_event(self):
        self.master.remap(NODE, 1, None, transmission=0)
        self.start()
        for _ in range(4):
            self.master.sync()
            self.master.listen(0.02)
        self.assertLessEqual(len(self.pdos(self.master.frames)), 1)
        self.assertEqual(len(self.pdos(self.master.frames, 2)), 4)


class Storage(unittest.TestCase):
    def setUp(self):
        self.master = rig.open_master()
        self.addCleanup(self.master.close)
        self.gateway = rig.Gateway()
        self.addCleanup(self.gateway.close)
        self.boot_up()

    def boot_up(self):
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP)

    def kill_and_start(self):
        self.assertEqual(self.gateway.end(signal.SIGKILL), -signal.SIGKILL)
        self.gateway.start()
        self.boot_up()

    def test_after_kill_9_stored_values_are_restored_and_others_are_not(self):
        self.master.download(NODE, 0x2000, 1, f32(0.125))
        self.master.download(NODE, 0x1017, 0, u16(200))
        self.master.download(NODE, 0x1010, 1, canopen.SAVE)
        self.master.download(NODE, 0x2000, 2, f32(0.25))
        self.kill_and_start()
        self.assertEqual(self.master.upload(NODE, 0x2000, 1), f32(0.125))
        self.assertEqual(self.master.upload(NODE, 0x2000, 2), f32(0))
        self.assertEqual(self.master.upload(NODE, 0x1017), u16(200))

    def test_one_group_can_be_stored_alone(self):
        self.master.download(NODE, 0x2000, 1, f32(0.125))
        self.master.download(NODE, 0x1017, 0, u16(200))
        self.master.download(NODE, 0x1010, 4, canopen.SAVE)
        self.kill_and_start()
        self.assertEqual(self.master.upload(NODE, 0x2000, 1), f32(0.125))
        self.assertEqual(self.master.upload(NODE, 0x1017), DEFAULT_HEARTBEAT)

    def test_load_restores_the_defaults_with_the_next_reset(self):
        self.master.download(NODE, 0x2000, 1, f32(0.125))
        self.master.download(NODE, 0x1010, 1, canopen.SAVE)
        self.master.download(NODE, 0x1011, 1, canopen.LOAD)
        self.assertEqual(self.master.upload(NODE, 0x2000, 1), f32(0.125))
        self.master.nmt(canopen.RESET_NODE, NODE)
        self.boot_up()
        self.assertEqual(self.master.upload(NODE, 0x2000, 1), f32(0))

    def test_a_wrong_signature_stores_nothing(self):
        self.master.download(NODE, 0x2000, 1, f32(0.125))
        with self.assertRaises(canopen.Abort) as caught:
            self.master.download(NODE, 0x1010, 1, b"SAVE")
        self.assertEqual(caught.exception.code & ~0xF, 0x08000020)
        self.kill_and_start()
        self.assertEqual(self.master.upload(NODE, 0x2000, 1), f32(0))

    def test_sigterm_ends_it_cleanly(self):
        self.assertEqual(self.gateway.end(signal.SIGTERM), 0)


class RoughBus(rig.OnTheBus):
    """On vcan1, so that the capture of vcan0 has only valid traffic."""

    bus = rig.ROUGH_BUS

    def still_answers(self):
        self.assertIsNone(self.gateway.process.poll(), "the gateway has ended")
        self.reset(canopen.RESET_NODE)
        self.assertEqual(self.read(0x1000), u32(0x0004019A))
        self.start()
        self.master.sync()
        self.master.wait(canopen.TPDO[3] + NODE)

    def test_it_answers_after_seconds_of_random_traffic(self):
        self.start()
        for flags in (["-e"], []):
            subprocess.run(["cangen", self.bus, "-g", "0.4", "-n", "2000", "-i", *flags],
                           check=True, timeout=rig.PATIENCE)
        self.still_answers()

    def test_it_answers_after_random_frames_with_its_own_identifiers(self):
        dice = random.Random(9)
        self.start()
        for _ in range(2000):
            can_id = dice.choice((canopen.NMT, canopen.SYNC, 0x100, canopen.SDO_RX + NODE, 0x7E5))
            self.master.send(can_id, dice.randbytes(dice.randrange(9)))
        self.still_answers()

    def test_sdo_requests_shorter_than_8_bytes_are_ignored(self):
        for length in range(8):
            self.master.send(canopen.SDO_RX + NODE, bytes.fromhex("40001000000000")[:length])
        self.assertEqual([f for f in self.master.listen(0.1) if f.arbitration_id == canopen.SDO_TX + NODE], [])

    def test_it_continues_after_the_interface_went_down_and_up(self):
        self.write(0x1017, 0, u16(50))
        self.master.wait_state(NODE, canopen.STATE_PRE_OPERATIONAL)
        subprocess.run(["ip", "link", "set", self.bus, "down"], check=True)
        rig.wait_until(lambda: re.search(self.bus + ".*down", self.gateway.log))
        subprocess.run(["ip", "link", "set", self.bus, "up"], check=True)
        self.master.close()
        self.master = rig.open_master(self.bus)
        self.addCleanup(self.master.close)
        self.master.wait_state(NODE, canopen.STATE_PRE_OPERATIONAL, 5)
        self.still_answers()

    def test_error_passive_raises_an_emcy_that_is_cleared_after_recovery(self):
        before = struct.unpack("<I", self.read(0x2120, 6))[0]
        subprocess.run(["cansend", self.bus, "20000004#0020000000000000"], check=True)
        self.emcy(0x8120)
        subprocess.run(["cansend", self.bus, "20000004#0040000000000000"], check=True)
        self.emcy(0x0000)
        self.assertEqual(struct.unpack("<I", self.read(0x2120, 6))[0], before + 2)


if __name__ == "__main__":
    unittest.main()
