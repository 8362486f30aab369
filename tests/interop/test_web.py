"""imu9-web as a process: a WebSocket client does what the page does, and whoever must not, is refused."""
import http.client
import json
import os
import re
import socket
import struct
import subprocess
import time
import unittest

import canopen_master as canopen
import rig
from rig import NODE

try:
    import websocket
except ImportError:
    websocket = None


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Server:
    """A running imu9-web."""

    def __init__(self, bus, *args):
        self.port = free_port()
        self.host = "127.0.0.1:%d" % self.port
        self.process = subprocess.Popen([rig.program("imu9-web"), "-i", bus, "--listen", self.host, *args],
                                        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)
        self.page = self.process.stdout.readline()
        self.token = self.process.stdout.readline().split()[-1]
        rig.wait_until(self.listens)

    def listens(self):
        with socket.socket() as s:
            return s.connect_ex(("127.0.0.1", self.port)) == 0

    def close(self):
        self.process.terminate()
        status = self.process.wait(rig.PATIENCE)
        self.process.stdout.close()
        assert status == 0, "imu9-web ended with %d" % status

    def memory_kib(self):
        with open("/proc/%d/status" % self.process.pid) as status:
            return int(re.search(r"VmRSS:\s+(\d+)", status.read())[1])

    def get(self, path, method="GET", **headers):
        """Status, headers and body."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=rig.PATIENCE)
        try:
            connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            for name, value in {"Host": self.host, **headers}.items():
                connection.putheader(name.replace("_", "-"), value)
            connection.endheaders()
            answer = connection.getresponse()
            return answer.status, answer.headers, answer.read()
        finally:
            connection.close()

    def raw(self, data, seconds=rig.PATIENCE):
        """What the server sends until it closes."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=seconds) as s:
            s.sendall(data)
            received = b""
            try:
                while chunk := s.recv(65536):
                    received += chunk
            except ConnectionResetError:
                pass
            return received


class Browser:
    def __init__(self, server, **options):
        options = {"origin": "http://" + server.host, **options}
        self.ws = websocket.create_connection("ws://%s%s" % (server.host, options.pop("path", "/ws")),
                                              timeout=rig.PATIENCE, subprotocols=["imu9.v1"], **options)
        self.events, self.id = [], 0

    def receive(self):
        message = json.loads(self.ws.recv())
        if "event" in message:
            self.events.append(message)
        return message

    def ask(self, op, **members):
        self.id += 1
        self.ws.send(json.dumps({"id": self.id, "op": op, **members}))
        while True:
            message = self.receive()
            if message.get("id") == self.id:
                return message

    def result(self, op, **members):
        answer = self.ask(op, **members)
        if not answer["ok"]:
            raise AssertionError("%s: %s" % (op, answer))
        return answer["result"]

    def until(self, condition):
        """The first event for which it holds."""
        end = time.monotonic() + rig.PATIENCE
        while time.monotonic() < end:
            message = self.receive()
            if "event" in message and condition(message):
                return message
        raise AssertionError("no such event")

    def close(self):
        self.ws.close()


@unittest.skipUnless(websocket, "python3-websocket is not installed")
class Web(rig.OnTheBus):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.server = Server(cls.bus)
        cls.addClassCleanup(cls.server.close)

    def browser(self, unlock=False, **options):
        browser = Browser(self.server, **options)
        self.addCleanup(browser.close)
        if unlock:
            browser.result("unlock", token=self.server.token)
        return browser

    def value(self, browser, name):
        value = browser.result("read", node=NODE, objects=[name])["values"][0]["value"]
        self.master.drain()  # the answers to imu9-web, which has asked all that it needs to know
        return value

    # ---- what one sees and does ----

    def test_values_agree_with_those_of_sdo(self):
        browser = self.browser()
        self.value(browser, "device_type")
        self.write(0x2000, 2, struct.pack("<f", 0.125))
        self.assertEqual(self.value(browser, "lever_arm.s"), 0.125)
        serial = struct.unpack("<I", self.read(0x1018, 4))[0]
        self.assertEqual(self.value(browser, "identity.serial_number"), serial)
        self.assertGreater(len(browser.result("objects", node=NODE)["objects"]), 300)

    def test_what_is_written_is_in_the_node(self):
        browser = self.browser()
        self.assertTrue(browser.ask("write", node=NODE, object="lever_arm.l", value=0.5)["locked"])
        browser.result("unlock", token=self.server.token)
        browser.result("write", node=NODE, object="lever_arm.l", value=0.5)
        self.master.drain()
        self.assertEqual(self.read(0x2000, 1), struct.pack("<f", 0.5))
        browser.result("write", node=NODE, object="lever_arm.l", value=0)

    def test_samples_arrive_at_a_hundred_hertz_without_a_gap(self):
        browser = self.browser(unlock=True)
        browser.result("nmt", node=NODE, command="start")
        browser.result("subscribe", node=NODE, hz=20)
        browser.result("sync", hz=100)
        rows = []
        while len(rows) < 300:
            event = browser.until(lambda e: e["event"] == "pdo")
            self.assertEqual(event.get("lost", 0), 0)
            rows += event["rows"]
        counters = [row[4] for row in rows[20:] if row[4] is not None]
        self.assertGreater(len(counters), 250)
        self.assertEqual(counters, sorted(counters))
        times = [row[0] for row in rows]
        self.assertEqual(times, sorted(times))

    def test_a_gateway_that_is_killed_is_lost_and_comes_back(self):
        browser = self.browser()

        def state(event):
            return {n["node"]: n["state"] for n in event.get("nodes", [])}.get(NODE)

        rig.wait_until(lambda: browser.receive() and any(state(e) for e in browser.events))
        time.sleep(2)  # two heartbeats
        self.gateway.close()
        browser.until(lambda e: state(e) == "lost")
        self.gateway.start()
        browser.until(lambda e: state(e) == "pre-operational")

    def test_a_configuration_is_saved_compared_and_loaded(self):
        browser = self.browser(unlock=True)
        text = browser.result("save", node=NODE, format="ini")["text"]
        self.master.drain()
        self.write(0x2000, 3, struct.pack("<f", 0.25))
        differences = browser.result("compare", node=NODE, format="ini", text=text)["differences"]
        self.assertEqual([(d["name"], d["node_value"], d["file_value"]) for d in differences],
                         [("lever_arm.t", 0.25, 0)])
        loaded = browser.result("load", node=NODE, format="ini", text=text)
        self.master.drain()
        self.assertEqual((loaded["written"], loaded["failed"]), (1, []))
        self.assertEqual(self.read(0x2000, 3), struct.pack("<f", 0))

    # ---- the attack list ----

    def test_files_say_what_a_browser_may_do_with_them(self):
        status, headers, body = self.server.get("/chart.min.js")
        self.assertEqual((status, headers["Content-Encoding"], body[:2]), (200, "gzip", b"\x1f\x8b"))
        self.assertEqual(headers["Content-Type"], "text/javascript; charset=utf-8")
        self.assertIn("frame-ancestors 'none'", headers["Content-Security-Policy"])
        self.assertEqual(headers["X-Content-Type-Options"], "nosniff")
        self.assertEqual(headers["Referrer-Policy"], "no-referrer")
        again = self.server.get("/chart.min.js", If_None_Match=headers["ETag"])
        self.assertEqual((again[0], again[2]), (304, b""))

    def test_another_origin_gets_no_cors_header_and_no_websocket(self):
        headers = self.server.get("/chart.min.js", Origin="http://evil.example")[1]
        self.assertFalse([name for name in headers if name.lower().startswith("access-control")])
        for origin in ("http://evil.example", "null", "http://127.0.0.1:1", "https://evil.example/" + self.server.host):
            with self.assertRaises(websocket.WebSocketBadStatusException) as refused:
                self.browser(origin=origin)
            self.assertEqual(refused.exception.status_code, 403)

    def test_a_websocket_without_an_origin_is_refused(self):
        with self.assertRaises(websocket.WebSocketBadStatusException):
            self.browser(suppress_origin=True)

    def test_a_rebound_name_is_refused(self):
        host = "rebound.example:%d" % self.server.port
        self.assertEqual(self.server.get("/chart.min.js", Host=host)[0], 403)
        with self.assertRaises(websocket.WebSocketBadStatusException) as refused:
            self.browser(host=host, origin="http://" + host)
        self.assertEqual(refused.exception.status_code, 403)

    def test_only_get_and_only_the_files_of_the_page(self):
        for path in ("/../../etc/passwd", "/..%2f..%2fetc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "//etc/passwd",
                     "/chart.min.js%00.html", "/tools/web/server.c", "/\\..\\etc"):
            answer = self.server.raw(("GET %s HTTP/1.1\r\nHost: %s\r\nConnection: close\r\n\r\n" %
                                      (path, self.server.host)).encode())
            self.assertIn(answer[9:12], (b"", b"400", b"403", b"404"), path)  # or closed at once
            self.assertNotIn(b"root:", answer)
        for method in ("POST", "PUT", "DELETE", "OPTIONS", "HEAD", "TRACE"):
            try:
                self.assertNotEqual(self.server.get("/chart.min.js", method)[0], 200, method)
            except (http.client.HTTPException, ConnectionError):
                pass  # closed without an answer
        with self.assertRaises(websocket.WebSocketBadStatusException):
            self.browser(path="/other")

    def test_a_message_that_is_too_long_or_no_text_ends_the_connection(self):
        for send in (lambda ws: ws.send("{\"id\": 1, \"op\": \"" + "x" * (1 << 20)), lambda ws: ws.send_binary(b"{}"),
                     lambda ws: ws.send(b"\xff\xfe", websocket.ABNF.OPCODE_TEXT)):
            browser = self.browser()
            with self.assertRaises((websocket.WebSocketException, ConnectionError)):
                send(browser.ws)
                while browser.ws.connected:
                    opcode, _ = browser.ws.recv_data()
                    if opcode == websocket.ABNF.OPCODE_CLOSE:
                        raise ConnectionError
        self.assertTrue(self.browser().ask("hello")["ok"])

    def test_garbage_ends_only_its_connection(self):
        browser = self.browser()
        for data in (b"\0" * 1000, b"GET / HTTP/1.1\r\n" + b"A: " + b"b" * 100000 + b"\r\n\r\n", os.urandom(4000),
                     b"GET /" + b"a" * 20000 + b" HTTP/1.1\r\n\r\n", b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
                     b"GET /chart.min.js HTTP/1.1\r\n\r\n"):
            self.assertNotIn(b" 200 ", self.server.raw(data)[:20])
        self.assertTrue(browser.ask("hello")["ok"])

    def test_requests_that_never_end_are_cut_off(self):
        self.assertNotIn(b" 200 ", self.server.raw(b"GET /chart.min.js HTTP/1.1\r\nHost: ")[:20])  # in time

    def place(self):
        """A browser that has one of the 32 places, or None: it was refused."""
        browser = self.browser()
        opcode, data = browser.ws.recv_data()
        if opcode == websocket.ABNF.OPCODE_TEXT:
            self.assertEqual(json.loads(data)["event"], "hello")
            return browser
        self.assertEqual((opcode, data), (websocket.ABNF.OPCODE_CLOSE, struct.pack("!H", 1008) + b"too many browsers"))
        return None

    def all_places(self):
        """32 browsers. One of an earlier test that went without a word has its place until the server notices."""
        browsers = []
        rig.wait_until(lambda: browsers.append(self.place()) or len([b for b in browsers if b]) == 32)
        return [b for b in browsers if b]

    def test_the_33rd_browser_is_refused_and_idle_connections_do_not_lock_out_the_others(self):
        first = self.all_places()[0]
        self.assertIsNone(self.place())
        idle = [socket.create_connection(("127.0.0.1", self.server.port)) for _ in range(200)]
        self.assertTrue(first.ask("hello")["ok"])
        for s in idle:
            s.close()
        first.close()
        rig.wait_until(self.place)

    def test_the_place_of_a_browser_that_says_goodbye_or_is_sent_away_is_free_at_once(self):
        polite, rude = self.all_places()[:2]
        for browser, message, opcode in ((polite, struct.pack("!H", 1000), websocket.ABNF.OPCODE_CLOSE),
                                         (rude, b"not a text", websocket.ABNF.OPCODE_BINARY)):
            self.assertIsNone(self.place())
            browser.ws.send(message, opcode)
            while browser.ws.recv_frame().opcode != websocket.ABNF.OPCODE_CLOSE:
                pass
            self.assertIsNotNone(self.place())

    def test_a_browser_that_does_not_read_costs_no_memory_and_slows_nobody(self):
        fast, slow = self.browser(unlock=True), self.browser()
        fast.result("nmt", node=NODE, command="start")
        slow.ws.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.result("subscribe", node=NODE, hz=20)
        fast.result("subscribe", node=NODE, hz=20)
        fast.result("sync", hz=100)
        fast.until(lambda e: e["event"] == "pdo")
        for _ in range(50):  # 180 kB each
            slow.ws.send("{\"id\":1,\"op\":\"objects\",\"node\":%d}" % NODE)
        before = self.server.memory_kib()
        end, rows = time.monotonic() + 5, 0
        while time.monotonic() < end:
            event = fast.until(lambda e: e["event"] == "pdo")
            self.assertEqual(event.get("lost", 0), 0)
            rows += len(event["rows"])
        self.assertGreater(rows, 100)
        self.assertLess(self.server.memory_kib() - before, 4096)


@unittest.skipUnless(websocket, "python3-websocket is not installed")
class WebStart(unittest.TestCase):
    def test_it_does_not_listen_for_others_without_a_token_file(self):
        done = rig.run("imu9-web", "-i", rig.BUS, "--listen", "0.0.0.0:8410")
        self.assertEqual(done.returncode, 2)
        self.assertIn("--token-file", done.stderr)

    def test_a_token_file_that_others_can_read_is_refused(self):
        path = rig.written("0123456789abcdef\n")
        path.chmod(0o644)
        done = rig.run("imu9-web", "-i", rig.BUS, "--token-file", path)
        self.assertEqual(done.returncode, 2)
        self.assertIn("chmod 600", done.stderr)

    def test_a_token_file_unlocks_and_a_given_name_is_a_host(self):
        path = rig.written("0123456789abcdef\n")
        path.chmod(0o600)
        server = Server(rig.BUS, "--token-file", str(path), "--host", "robot.example")
        self.addCleanup(server.close)
        browser = Browser(server, host="robot.example", origin="https://robot.example")
        self.assertEqual(browser.result("unlock", token="0123456789abcdef"), {"unlocked": True})
        browser.close()
