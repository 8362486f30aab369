"""CiA 309-3: a client of the sockets that speaks as CANopenNode's cocomm does; the master on the bus is the oracle."""
import os
import re
import socket
import struct
import unittest

import canopen_master as canopen
import rig
from rig import NODE

OTHER = NODE + 1


class Client:
    """As cocomm: one command, then the answer up to CR LF."""

    def __init__(self, family, address):
        self.socket = socket.socket(family, socket.SOCK_STREAM)
        self.socket.settimeout(rig.PATIENCE)
        self.socket.connect(address)

    def ask(self, command):
        self.socket.sendall(b"[1] %s\n" % command.encode())
        answer = b""
        while not answer.endswith(b"\r\n"):
            more = self.socket.recv(4096)
            if not more:
                raise AssertionError("closed after %r" % answer)
            answer += more
        return answer[:-2].decode()

    def close(self):
        self.socket.close()


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Gateways(unittest.TestCase):
    def setUp(self):
        self.master = rig.open_master()
        self.addCleanup(self.master.close)

    def gateway(self, *args, node=NODE):
        gateway = rig.Gateway("--node-id", str(node), *args)
        self.addCleanup(gateway.close)
        if node != 255:
            self.master.wait_state(node, canopen.STATE_BOOT_UP)
        return gateway

    def unix(self, options=",write=yes", node=NODE):
        self.path = str(rig.scratch(".sock"))
        gateway = self.gateway("--cia309", "unix:" + self.path + options, node=node)
        rig.wait_until(lambda: os.path.exists(self.path))
        return gateway

    def connect(self):
        client = Client(socket.AF_UNIX, self.path)
        self.addCleanup(client.close)
        return client


    def read(self, node, index, sub):
        """By the master; the bus has responses to the gateway's requests, too."""
        self.master.drain()
        return self.master.upload(node, index, sub)

    def unconfigured(self):
        self.master.send(0x7E5, b"\x4c".ljust(8, b"\0"))
        return sum(f.arbitration_id == 0x7E4 and f.data[0] == 0x50 for f in self.master.listen(0.1))


class Cia309(Gateways):
    def test_a_client_and_the_master_read_and_write_the_same_values_of_either_node(self):
        self.unix()
        self.gateway(node=OTHER)
        client = self.connect()
        for node in (NODE, OTHER):
            serial = struct.unpack("<I", self.read(node, 0x1018, 4))[0]
            self.assertEqual(client.ask("%d r 0x1018 4 u32" % node), "[1] %d" % serial)
            self.assertEqual(client.ask("%d read 0x1008 0 vs" % node), '[1] "IMU9 CANopen gateway"')
            self.assertEqual(client.ask("%d write 0x2000 1 r32 0.05" % node), "[1] OK")
            self.assertEqual(self.read(node, 0x2000, 1), struct.pack("<f", 0.05))
            self.master.drain()
            self.master.download(node, 0x2000, 2, struct.pack("<f", -0.25))
            self.assertEqual(client.ask("%d r 0x2000 2 r32" % node), "[1] -0.25")
            self.assertEqual(client.ask("%d w 0x1000 0 u32 1" % node)[:23], "[1] ERROR:0x06010002 #t")

    def test_nmt_commands_are_on_the_bus_and_hold_for_this_node_too(self):
        self.unix()
        self.gateway(node=OTHER)
        client = self.connect()
        self.master.drain()
        self.assertEqual(client.ask("%d start" % OTHER), "[1] OK")
        frame = self.master.wait(lambda f: f.arbitration_id == 0)
        self.assertEqual(bytes(frame.data), bytes((canopen.START, OTHER)))
        self.master.wait_state(OTHER, canopen.STATE_OPERATIONAL)
        self.assertEqual(client.ask("%d start" % NODE), "[1] OK")
        self.master.wait_state(NODE, canopen.STATE_OPERATIONAL)
        self.assertEqual(client.ask("0 preop"), "[1] OK")
        for node in (NODE, OTHER):
            self.master.wait_state(node, canopen.STATE_PRE_OPERATIONAL)
        self.assertEqual(client.ask("%d reset node" % NODE), "[1] OK")
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP)
        self.assertEqual(client.ask("%d reset comm" % OTHER), "[1] OK")
        self.master.wait_state(OTHER, canopen.STATE_BOOT_UP)

    def test_nodes_without_a_node_id_get_theirs_by_lss(self):
        gateway = self.unix(node=255)
        self.gateway(node=255)
        client = self.connect()
        rig.wait_until(lambda: self.unconfigured() == 2)
        # half a second for each bit of the serial number: a busy machine may need some of it
        revision = re.search(r"RevisionNumber=(\w+)", rig.EDS.read_text())[1]
        answer = client.ask("lss_allnodes 500 %d 0 2 0x494D55 2 9 2 %s 0 0" % (NODE, revision))
        self.assertEqual(answer.count("assigned to: 0x00494D55 0x00000009 "), 2, answer)
        self.assertTrue(answer.endswith("# Found 2 nodes, search finished.\n[1] OK"), answer)
        for node in (NODE, OTHER):
            serial = struct.unpack("<I", self.read(node, 0x1018, 4))[0]
            self.assertIn("# Node-ID %d assigned to: " % node, answer)
            self.assertIn(" 0x%08X\n" % serial, answer)
        self.assertIn("assigned by LSS", gateway.log)

    def test_a_client_that_may_only_read_changes_nothing_over_tcp(self):
        port = free_port()
        gateway = self.gateway("--cia309", "tcp:127.0.0.1:%d" % port)
        rig.wait_until(lambda: "CiA 309-3 at" in gateway.log)
        client = Client(socket.AF_INET, ("127.0.0.1", port))
        self.addCleanup(client.close)
        self.assertEqual(client.ask("%d r 0x2000 1 r32" % NODE), "[1] 0")
        for command in ("%d w 0x2000 1 r32 0.5" % NODE, "%d start" % NODE, "lss_switch_glob 1"):
            self.assertTrue(client.ask(command).startswith("[1] ERROR:102 #Not permitted"), command)
        self.assertEqual(self.read(NODE, 0x2000, 1), struct.pack("<f", 0))
        rig.wait_until(lambda: "CiA 309, 127.0.0.1 port %d: [1] %d start: ERROR:102" % (
            client.socket.getsockname()[1], NODE) in gateway.log)

    def test_the_socket_is_removed_at_the_end_and_replaced_after_a_kill(self):
        gateway = self.unix()
        gateway.process.kill()
        gateway.process.wait()
        self.assertTrue(os.path.exists(self.path))
        gateway.start()
        self.master.wait_state(NODE, canopen.STATE_BOOT_UP)
        rig.wait_until(lambda: gateway.log.count("CiA 309-3 at") == 2)
        self.assertEqual(self.connect().ask("%d r 0x1017 0 u16" % NODE), "[1] 1000")
        self.assertEqual(gateway.end(), 0)
        self.assertFalse(os.path.exists(self.path))

    def test_a_wrong_address_is_a_wrong_configuration(self):
        for address in ("tcp:0.0.0.0:60000", "unix:relative", "unix:/x,group=no-such-group"):
            result = rig.run("imu9-gateway", "--check", "--cia309", address)
            self.assertEqual(result.returncode, 2)
            self.assertIn("cia309", result.stderr)
