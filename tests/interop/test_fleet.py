"""imu9-fleet between a bus and a real MQTT broker: what subscribers get are the values of the TPDOs with their
counters, also when the broker was away. IMU9_FLEET_SECONDS=300 keeps it away for longer."""
import json
import os
import re
import signal
import socket
import struct
import subprocess
import tomllib
import unittest

import canopen_master as canopen
import mqtt
import rig
from rig import NODE

try:
    import jsonschema
except ImportError:
    jsonschema = None

SECONDS = float(os.environ.get("IMU9_FLEET_SECONDS", 2))
SCHEMA = json.loads((rig.ROOT / "tools/imu9-json.schema.json").read_text())
# README.md: what the PDOs have before the sample counter, and the size of a step
PDOS = ((0x180, ("acceleration.l", "acceleration.s", "acceleration.t"), 0.005),
        (0x280, ("angles.roll", "angles.pitch", "angles.yaw"), 0.01),
        (0x380, ("position_output.x", "position_output.y", "position_output.z"), 0.001))


def of_frames(frames):
    """{counter: {name: value}}, by the tables of README.md and not by the mapping."""
    samples = {}
    for frame in frames:
        for function, names, step in PDOS:
            if frame.arbitration_id == function + NODE:
                *raw, counter = struct.unpack("<hhhH", frame.data)
                samples.setdefault(counter, {}).update({n: round(v * step, 6) for n, v in zip(names, raw)})
    return samples


class Published(rig.OnTheBus):
    arguments = ()
    digits = 6

    @classmethod
    def setUpClass(cls):
        mqtt.required()
        super().setUpClass()

    def setUp(self):
        super().setUp()
        self.broker = mqtt.Broker()
        self.addCleanup(self.broker.close)
        self.parsed = {}
        self.subscriber = mqtt.Subscriber(self.broker)
        self.addCleanup(self.subscriber.close)
        for number in range(4):
            self.write(0x1800 + number, 2, b"\xfe")  # with each sample

    def run_fleet(self, *args):
        fleet = mqtt.Fleet(self.broker, *self.arguments, *args)
        self.addCleanup(fleet.close)
        rig.wait_until(lambda: self.values() or self.documents("/state"))
        return fleet

    def documents(self, ending):
        parsed = self.parsed.setdefault(ending, [])
        parsed += [json.loads(payload) for _, payload in self.subscriber.messages(ending)[len(parsed):]]
        return parsed

    def values(self):
        return self.documents("/values")

    def samples(self):
        """{counter: {name: value}} of what was published, and the counters in the order in which they came first."""
        samples, order = {}, []
        for d in self.values():
            if d["sample"] not in samples:
                order.append(d["sample"])
            samples.setdefault(d["sample"], {}).update(d["values"])
        return samples, order

    def wait_for(self, counter):
        rig.wait_until(lambda: counter in self.samples()[0])

    def listen_from_first(self, count):
        """The frames of so many samples that imu9-fleet has seen, too, and more."""
        rig.wait_until(self.values)
        self.master.drain()
        return self.listen_to(count)

    def listen_to(self, count):
        """The frames of at least so many samples."""
        frames = []
        while len(self.pdos(frames)) < count + 2:  # the first and the last may not be complete
            frame = self.master.receive(rig.PATIENCE)
            self.assertIsNotNone(frame, "no PDO came")
            frames.append(frame)
        return frames

    def check(self, frames, beside=()):
        """Of each complete sample on the bus: it was published once, in order, with the same values."""
        on_bus = {c: v for c, v in of_frames(frames).items() if len(v) == 9}
        inner = sorted(on_bus)[1:-1]
        self.wait_for(inner[-1])
        published, order = self.samples()
        missing = [c for c in inner if c not in published]
        self.assertEqual(missing, [], "lost")
        self.assertEqual(order, sorted(order), "out of order")
        for counter in inner:
            for name, value in on_bus[counter].items():
                self.assertAlmostEqual(published[counter][name], value, self.digits, (counter, name))
        return inner


class FleetPublishes(Published):
    imu = "sim:square"

    def test_the_values_of_the_pdos_with_their_counters(self):
        self.start()
        self.run_fleet()
        self.assertGreater(len(self.check(self.listen_from_first(100))), 50)

    @unittest.skipUnless(jsonschema, "python3-jsonschema is not installed")
    def test_documents_that_fit_the_schema(self):
        self.start()
        self.run_fleet()
        rig.wait_until(lambda: self.documents("/status") and self.documents("/objects"))
        for kind in ("values", "objects", "state", "status"):
            for document in self.documents("/" + kind):
                jsonschema.validate(document, {"$ref": "#/$defs/fleet_" + kind, "$defs": SCHEMA["$defs"]},
                                    cls=jsonschema.Draft202012Validator)

    def test_names_and_units_are_retained(self):
        self.start()
        self.run_fleet()
        rig.wait_until(lambda: self.documents("/objects"))
        later = mqtt.Subscriber(self.broker, "imu9/bus/+/objects")
        self.addCleanup(later.close)
        rig.wait_until(lambda: later.messages("/objects"))
        retained, payload = later.messages("/objects")[0]
        self.assertTrue(retained)
        units = {o["name"]: o.get("unit") for o in json.loads(payload)["objects"]}
        self.assertEqual((units["acceleration.l"], units["angles.yaw"], units["sample.status"]), ("m/s^2", "deg", None))

    def test_each_state_and_the_last_one_is_retained(self):
        self.run_fleet()
        for command, state in ((canopen.START, "operational"), (canopen.STOP, "stopped"),
                               (canopen.PRE_OPERATIONAL, "pre-operational")):
            self.master.nmt(command, NODE)
            rig.wait_until(lambda: self.documents("/state") and self.documents("/state")[-1]["nmt"] == state)
        later = mqtt.Subscriber(self.broker, "imu9/bus/%d/state" % NODE)
        self.addCleanup(later.close)
        rig.wait_until(lambda: later.messages("/state"))
        retained, payload = later.messages("/state")[0]
        self.assertTrue(retained)
        self.assertEqual(json.loads(payload)["nmt"], "pre-operational")

    def test_each_emcy_with_its_code(self):
        self.start()
        self.run_fleet()
        self.master.send(0x200 + NODE, b"\0")  # RPDO1 is longer: 8210h
        frame = self.emcy(0x8210)
        rig.wait_until(lambda: self.documents("/emcy"))
        emcy = self.documents("/emcy")[0]
        self.assertEqual((emcy["code"], emcy["register"], emcy["info"]),
                         ("8210", frame.data[2], bytes(frame.data[3:]).hex().upper()))

    def test_a_live_mapping_and_resolution(self):
        self.master.remap(NODE, 2, [(0x2103, 1, 32), (0x210F, 1, 16)], transmission=254)  # quaternion.w, REAL32
        self.start()
        self.run_fleet()
        frames = self.listen_from_first(50)
        for frame in self.pdos(frames, 2)[1:-1]:
            w, counter = struct.unpack("<fH", frame.data)
            self.wait_for(counter)
            self.assertEqual(struct.pack("<f", self.samples()[0][counter]["quaternion.w"]), struct.pack("<f", w))

    def test_the_names_of_the_eds_of_a_node(self):
        text = rig.EDS.read_bytes().replace(b"[2100]\r\nParameterName=Acceleration\r\n",
                                            b"[2100]\r\nParameterName=Shock\r\n")
        eds = rig.scratch(".eds")
        eds.write_bytes(text)
        self.start()
        self.run_fleet("-e", "%d=%s" % (NODE, eds))
        rig.wait_until(self.values)
        self.assertIn("shock.acceleration_l", self.values()[0]["values"])

    def test_at_most_so_many_samples_a_second(self):
        self.start()
        self.run_fleet("--hz", "10")
        rig.wait_until(lambda: len(self.values()) >= 30)
        counters = self.samples()[1]
        self.assertAlmostEqual((counters[-1] - counters[0]) / (len(counters) - 1), 10, delta=1.5)  # of 100 Hz

    def test_a_kill_publishes_the_last_will_and_an_end_says_so_itself(self):
        fleet = self.run_fleet()
        rig.wait_until(lambda: self.documents("/status"))
        self.assertTrue(self.documents("/status")[-1]["online"])
        fleet.end(signal.SIGKILL)
        rig.wait_until(lambda: not self.documents("/status")[-1]["online"])
        fleet.start()
        rig.wait_until(lambda: self.documents("/status")[-1]["online"])
        self.assertEqual(fleet.end(), 0)
        rig.wait_until(lambda: not self.documents("/status")[-1]["online"])


class FleetLosesNothing(Published):
    imu = "sim:square"

    def test_while_the_broker_was_killed(self):
        self.start()
        rig.wait_until(lambda: self.subscriber.process.poll() is None)
        fleet = self.run_fleet()
        self.broker.keep_sessions()
        frames = self.listen_from_first(50)
        self.broker.kill_idle(self.gateway, self.subscriber)
        frames += self.listen_to(100 * SECONDS)
        self.assertGreater(fleet.spool_bytes(), 0)
        self.assertLess(fleet.spool_bytes(), 64 << 20)
        self.broker.start()
        frames += self.listen_to(200)
        self.assertGreater(len(self.check(frames)), 100 * SECONDS / 2)
        rig.wait_until(lambda: fleet.spool_bytes() == 0)

    def test_while_it_was_stopped_itself_and_the_broker_was_away(self):
        self.start()
        fleet = self.run_fleet()
        self.broker.keep_sessions()
        frames = self.listen_from_first(50)
        self.broker.kill_idle(self.gateway, self.subscriber)
        frames += self.listen_to(100)
        self.assertEqual(fleet.end(), 0)
        self.broker.start()
        fleet.start()
        self.check(frames)

    def test_by_a_kill_but_the_last_second(self):
        self.start()
        fleet = self.run_fleet()
        self.broker.keep_sessions()
        frames = self.listen_from_first(20)
        self.broker.kill_idle(self.gateway, self.subscriber)
        rig.wait_until(lambda: fleet.spool_bytes() > 0)
        frames += self.listen_to(100 * (SECONDS + 1))
        fleet.end(signal.SIGKILL)
        last = max(of_frames(frames))
        self.broker.start()
        fleet.start()
        self.check([f for f in frames if max(of_frames([f]), default=last) <= last - 110])


class FleetWrites(Published):
    arguments = ("--allow-writes", "lever_arm,position.motion_preset")

    def ask(self, document, retain=False, node=NODE):
        payload = document if isinstance(document, str) else json.dumps(document)
        subprocess.run(["mosquitto_pub", "-h", "127.0.0.1", "-p", str(self.broker.port), "-q", "1", "-t",
                        "imu9/bus/%d/write" % node,
                        "-m", payload, *(["-r"] if retain else [])], check=True, timeout=rig.PATIENCE)

    def answers(self, count):
        rig.wait_until(lambda: len(self.documents("/answer")) >= count)
        return self.documents("/answer")

    def test_an_allowed_object_is_written_and_answered(self):
        self.run_fleet()
        self.ask({"object": "lever_arm.s", "value": 0.05, "id": "7"})
        answer = self.answers(1)[0]
        self.assertEqual((answer["object"], answer["id"], answer["done"], answer["node"]),
                         ("lever_arm.s", "7", True, NODE))
        self.master.drain()
        self.assertEqual(self.read(0x2000, 2), struct.pack("<f", 0.05))
        if jsonschema:
            jsonschema.validate(answer, {"$ref": "#/$defs/fleet_answer", "$defs": SCHEMA["$defs"]},
                                cls=jsonschema.Draft202012Validator)

    def test_what_is_not_allowed_or_wrong_is_refused_with_the_reason(self):
        self.run_fleet()
        cases = (({"object": "lever_arm_model", "value": 1}, "not allowed"),
                 ({"object": "lever_arm.l", "value": 50}, "-10 to 10 m"),
                 ({"object": "lever_arm.l", "value": "wide"}, ""),
                 ({"object": "nothing", "value": 1}, "no such object"),
                 ({"object": "position.motion_preset", "value": 200}, ""))
        for i, (document, says) in enumerate(cases):
            with self.subTest(document=document):
                self.ask(document)
                answer = self.answers(i + 1)[i]
                self.assertFalse(answer["done"])
                self.assertIn(says, answer["error"])
        self.ask({"object": "lever_arm.l", "value": 1}, node=99)
        self.assertIn("no such node", self.answers(len(cases) + 1)[-1]["error"])
        self.master.drain()
        self.assertEqual(self.read(0x2000, 1), struct.pack("<f", 0))

    def test_a_write_that_was_retained_is_not_executed(self):
        self.ask({"object": "lever_arm.t", "value": 0.5}, retain=True)
        fleet = self.run_fleet()
        rig.wait_until(lambda: "retained" in fleet.log)
        self.ask({"object": "lever_arm.s", "value": 0.25})
        self.answers(1)
        self.master.drain()
        self.assertEqual((self.read(0x2000, 2), self.read(0x2000, 3)),
                         (struct.pack("<f", 0.25), struct.pack("<f", 0)))

    def test_what_is_no_command_is_left_alone(self):
        fleet = self.run_fleet()
        for text in ("", "{", "[]", "7", '{"object":"lever_arm.s"}', '{"object":[],"value":1}', "{" * 1000,
                     '{"object":"lever_arm.s","value":1}x', "x" * 5000):
            self.ask(text or "\n")
        self.ask({"object": "lever_arm.s", "value": 0.125, "id": "last"})
        self.assertEqual([a["id"] for a in self.answers(1)], ["last"])
        self.assertIsNone(fleet.process.poll())


class FleetSpeaksSparkplug(Published):
    imu = "sim:square"
    digits = 4  # they are floats

    @classmethod
    def setUpClass(cls):
        cls.sparkplug = mqtt.sparkplug()
        super().setUpClass()

    def setUp(self):
        super().setUp()
        self.host = mqtt.Subscriber(self.broker, "spBv1.0/#", "%t %x")
        self.addCleanup(self.host.close)

    def run_fleet(self, *args):
        fleet = mqtt.Fleet(self.broker, "--format", "sparkplug", "--topic", "plant", *args)
        self.addCleanup(fleet.close)
        rig.wait_until(lambda: self.of("DDATA"))
        return fleet

    def received(self):
        """(type, device or None, payload) of each message."""
        messages = []
        for topic, payload in (line.split(" ") for line in self.host.lines if "/mark " not in line):
            _, group, kind, edge, *device = topic.split("/")
            self.assertEqual((group, edge), ("plant", "bus"))
            messages.append((kind, *(device or [None]), self.sparkplug.Payload.FromString(bytes.fromhex(payload))))
        return messages

    def of(self, kind):
        return [payload for k, _, payload in self.received() if k == kind]

    def decoded(self):
        """As a host application sees it: {counter: {name: value}}, by the names of the births, and the order."""
        names, samples, order, late = {}, {}, [], set()
        for kind, device, payload in self.received():
            if kind == "DBIRTH":
                self.assertEqual(device, str(NODE))
                names.update({m.alias: m.name for m in payload.metrics})
            if kind == "DDATA":
                values = {names[m.alias]: getattr(m, m.WhichOneof("value")) for m in payload.metrics}
                counter = values.pop("sample.counter", None)
                if counter is None:
                    continue
                if counter not in samples:
                    order.append(counter)
                samples.setdefault(counter, {}).update(values)
                late |= {counter for m in payload.metrics if m.is_historical}
        self.late = late
        return samples, order

    samples = decoded

    def test_the_values_of_the_pdos_by_names_and_aliases(self):
        self.start()
        self.run_fleet()
        rig.wait_until(lambda: self.of("DDATA"))
        self.master.drain()
        self.check(self.listen_to(100))
        birth = {m.name: m for m in self.of("DBIRTH")[0].metrics}
        self.assertEqual(birth["acceleration.l"].properties.values[0].string_value, "m/s^2")
        self.assertEqual(birth["nmt_state"].string_value, "operational")
        self.assertTrue(all(not m.name and not m.HasField("datatype") for m in self.of("DDATA")[0].metrics))

    def test_sequence_numbers_from_the_birth_on_without_a_gap(self):
        self.start()
        self.run_fleet()
        rig.wait_until(lambda: len(self.received()) > 300)
        received = self.received()
        kinds = [kind for kind, _, _ in received]
        self.assertEqual(kinds[0], "NBIRTH")
        self.assertEqual(kinds.count("NBIRTH"), 1)
        self.assertLess(kinds.index("DBIRTH"), kinds.index("DDATA"))
        self.assertEqual([p.seq for _, _, p in received], [i % 256 for i in range(len(kinds))])

    def test_a_rebirth_when_asked_for(self):
        self.start()
        self.run_fleet()
        command = self.sparkplug.Payload()
        metric = command.metrics.add(name="Node Control/Rebirth", datatype=11)
        metric.boolean_value = True
        path = rig.scratch()
        path.write_bytes(command.SerializeToString())
        subprocess.run(["mosquitto_pub", "-h", "127.0.0.1", "-p", str(self.broker.port), "-t",
                        "spBv1.0/plant/NCMD/bus", "-f", path],
                       check=True, timeout=rig.PATIENCE)
        rig.wait_until(lambda: len(self.of("NBIRTH")) == 2 and len(self.of("DBIRTH")) == 2)
        first, second = self.of("NBIRTH")
        self.assertEqual(second.seq, 0)
        self.assertEqual(first.metrics[0].long_value, second.metrics[0].long_value)  # bdSeq: the connection is the same

    def test_a_death_with_the_number_of_the_birth(self):
        self.start()
        fleet = self.run_fleet()
        fleet.end(signal.SIGKILL)
        rig.wait_until(lambda: self.of("NDEATH"))
        fleet.start()
        rig.wait_until(lambda: len(self.of("NBIRTH")) == 2)
        fleet.end()
        rig.wait_until(lambda: len(self.of("NDEATH")) == 2)
        number = {kind: [p.metrics[0].long_value for p in self.of(kind)] for kind in ("NBIRTH", "NDEATH")}
        self.assertEqual(number["NBIRTH"], number["NDEATH"])
        self.assertEqual([p.metrics[0].name for p in self.of("NDEATH")], ["bdSeq", "bdSeq"])

    def test_a_node_that_is_lost_dies_and_is_born_again(self):
        self.start()
        self.run_fleet()
        self.master.drain()
        for _ in range(2):  # imu9-fleet has got one of them for certain
            self.master.wait_state(NODE, canopen.STATE_OPERATIONAL)
        self.gateway.process.send_signal(signal.SIGSTOP)
        try:
            rig.wait_until(lambda: self.of("DDEATH"))
        finally:
            self.gateway.process.send_signal(signal.SIGCONT)
        rig.wait_until(lambda: len(self.of("DBIRTH")) == 2)

    def test_nothing_is_lost_and_what_was_late_is_historical(self):
        self.start()
        fleet = self.run_fleet()
        self.broker.keep_sessions()
        self.master.drain()
        frames = self.listen_to(50)
        self.broker.kill_idle(self.gateway, self.host)
        away = self.listen_to(100)
        self.broker.start()
        frames += away + self.listen_to(100)
        self.check(frames)
        inner = sorted(c for c, v in of_frames(away).items() if len(v) == 9)[30:-1]
        self.assertEqual([c for c in inner if c not in self.late], [])
        births = [p.metrics[0].long_value for p in self.of("NBIRTH")]
        self.assertEqual(len(births), len(set(births)))  # each attempt to connect takes a number
        rig.wait_until(lambda: fleet.spool_bytes() == 0)

    def test_a_write_by_alias(self):
        self.start()
        self.run_fleet("--allow-writes", "lever_arm")
        command = self.sparkplug.Payload()
        metric = command.metrics.add(alias=NODE << 24 | 0x200002, datatype=9)
        metric.float_value = 0.25
        path = rig.scratch()
        path.write_bytes(command.SerializeToString())
        subprocess.run(["mosquitto_pub", "-h", "127.0.0.1", "-p", str(self.broker.port), "-t",
                        "spBv1.0/plant/DCMD/bus/%d" % NODE, "-f",
                        path], check=True, timeout=rig.PATIENCE)
        rig.wait_until(lambda: any(m.string_value and json.loads(m.string_value)["done"]
                                   for p in self.of("DDATA") for m in p.metrics if m.alias == NODE << 24 | 6))
        self.master.drain()
        self.assertEqual(self.read(0x2000, 2), struct.pack("<f", 0.25))


class FleetByTls(rig.OnTheBus):
    """A broker that wants a client certificate, and a user with a password."""

    @classmethod
    def setUpClass(cls):
        mqtt.required()
        cls.authority = mqtt.Authority()
        super().setUpClass()

    def setUp(self):
        super().setUp()
        passwords = rig.written("")
        subprocess.run(["mosquitto_passwd", "-b", passwords, "robot", "secret"], check=True, capture_output=True)
        a = self.authority
        self.broker = mqtt.Broker("allow_anonymous false", "password_file %s" % passwords, "require_certificate true",
                                  "cafile %s" % a["ca.crt"], "certfile %s" % a["server.pem"],
                                  "keyfile %s" % a["server.key"])
        self.addCleanup(self.broker.close)
        self.credentials = rig.written("robot\nsecret\n")
        self.credentials.chmod(0o600)
        self.tls = ("--cafile", a["ca.crt"], "--cert", a["client.pem"], "--key", a["client.key"])
        self.own = ("--ca", a["ca.crt"], "--cert", a["client.pem"], "--key", a["client.key"])

    def run_fleet(self, *args, host="127.0.0.1"):
        fleet = mqtt.Fleet(self.broker, *args, url="mqtts://%s:%d" % (host, self.broker.port))
        self.addCleanup(fleet.close)
        return fleet

    def test_with_certificate_and_password_it_publishes(self):
        subscriber = mqtt.Subscriber(self.broker, options=(*self.tls, "-u", "robot", "-P", "secret"))
        self.addCleanup(subscriber.close)
        self.run_fleet(*self.own, "--credentials", self.credentials)
        rig.wait_until(lambda: subscriber.messages("/state"))

    def test_whom_it_does_not_trust_gets_nothing(self):
        stranger = mqtt.Authority()
        for args, host, says in ((("--ca", stranger["ca.crt"], *self.own[2:]), "127.0.0.1", "no connection"),
                                 (self.own, "localhost", "no connection"),  # the certificate is of 127.0.0.1
                                 (self.own[:2], "127.0.0.1", "no connection"),
                                 (self.own, "127.0.0.1", "refused: ")):
            with self.subTest(args=args, host=host):
                fleet = self.run_fleet(*args, host=host)
                rig.wait_until(lambda: says in fleet.log)
                self.assertNotIn("connected to", fleet.log)
                self.assertEqual(fleet.end(), 0)


class FleetAsAService(rig.OnTheBus):
    def test_it_says_when_it_is_ready_and_gives_signs_of_life(self):
        mqtt.required()
        path = rig.scratch(".notify")
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notify:
            notify.bind(str(path))
            notify.settimeout(rig.PATIENCE)
            broker = mqtt.Broker()
            self.addCleanup(broker.close)
            fleet = mqtt.Fleet(broker, environment={"NOTIFY_SOCKET": str(path), "WATCHDOG_USEC": "1000000"})
            self.addCleanup(fleet.close)
            said = [notify.recv(4096).decode() for _ in range(3)]
            self.assertTrue(any(message.startswith("READY=1") for message in said), said)
            self.assertEqual(said.count("WATCHDOG=1"), 2)
            broker.kill()  # no reason to be restarted
            self.assertEqual([notify.recv(4096) for _ in range(3)], [b"WATCHDOG=1"] * 3)
            fleet.end()
            while (message := notify.recv(4096)) == b"WATCHDOG=1":
                pass
            self.assertEqual(message, b"STOPPING=1")


class FleetRecipes(unittest.TestCase):
    FOLDER = rig.ROOT / "tools/fleet"

    def test_the_example_configuration_is_good(self):
        path = self.FOLDER / "imu9-fleet.conf"
        self.assertEqual(rig.run("imu9-fleet", "-c", path, "--check").returncode, 0)
        text = re.sub(r"^# (\w+ = )", r"\1", path.read_text(), flags=re.M)  # what it has as examples, too
        keys = dict(re.findall(r"^(\w+) = (.*)", text, re.M))
        for key in keys:
            done = rig.run("imu9-fleet", "--broker", "mqtt://localhost", "-c",
                           rig.written("[fleet]\n%s = %s\n" % (key, keys[key])), "--check")
            self.assertNotIn("no such option", done.stderr, key)

    def test_telegraf_reads_the_topics_and_members_that_are_published(self):
        recipe = tomllib.loads((self.FOLDER / "telegraf.conf").read_text())
        topics = [t for i in recipe["inputs"]["mqtt_consumer"] for t in i["topics"]]
        self.assertEqual(topics, ["imu9/+/+/values", "imu9/+/+/state", "imu9/+/+/emcy"])
        for consumer in recipe["inputs"]["mqtt_consumer"]:
            members = set()
            for topic in consumer["topics"]:
                members |= set(SCHEMA["$defs"]["fleet_" + topic.rsplit("/", 1)[1]]["properties"])
            for rule in consumer["json_v2"]:
                paths = {rule["timestamp_path"]} | {f["path"] for f in rule["field"] + rule.get("object", [])}
                self.assertLessEqual(paths, members)

    def test_the_dashboard_shows_objects_of_the_eds(self):
        board = json.loads((self.FOLDER / "grafana-dashboard.json").read_text())
        objects = rig.run("imu9-sdo", "-q", "objects").stdout.split()
        for query in (t["query"] for panel in board["panels"] for t in panel["targets"]):
            for name in re.findall(r'mean\("([^"]+)"\)', query):
                self.assertIn(name, objects)


class FleetArguments(unittest.TestCase):
    def refused(self, *args):
        done = rig.run("imu9-fleet", *args)
        self.assertEqual(done.returncode, 2, done.stderr)
        self.assertRegex(done.stderr, "^imu9-fleet: ")
        return done.stderr

    def test_wrong_ones_are_refused_with_what_to_do(self):
        good = ("--broker", "mqtt://localhost")
        for args, says in (((), "no broker"), (("--broker", "http://x"), "write mqtt://"),
                           (("--broker", "mqtt://x:0"), "write mqtt://"), ((*good, "--hz", "-1"), "from 0 to"),
                           ((*good, "-n", "0"), "1 to 127"), ((*good, "-n", "9-3"), "1 to 127"),
                           ((*good, "--change", "nothing=1"), "no such object"),
                           ((*good, "--change", "angles"), "OBJECT=CHANGE"),
                           ((*good, "--topic", "a/#"), "topic"), ((*good, "--spool", "/x,size=0"), "size=MB"),
                           ((*good, "-e", "/nowhere"), "/nowhere"), ((*good, "--ca", "/nowhere"), "mqtts"),
                           (("-c", "/nowhere", *good), "/nowhere"), ((*good, "--nothing"), "unknown option")):
            with self.subTest(args=args):
                self.assertIn(says, self.refused(*args, "--check"))

    def test_a_password_that_others_can_read_is_refused(self):
        path = rig.written("user\nsecret\n")
        path.chmod(0o640)
        args = ("--broker", "mqtt://localhost", "--credentials", path, "--check")
        self.assertIn("chmod 600", self.refused(*args))
        path.chmod(0o600)
        self.assertEqual(rig.run("imu9-fleet", *args).returncode, 0)

    def test_a_file_has_the_options_as_keys_and_the_command_line_overrides_it(self):
        path = rig.written("[fleet]\nbroker = mqtt://localhost:1\nhz = 10\nchange = angles=0.5\nnode_id = 5\n")
        self.assertEqual(rig.run("imu9-fleet", "-c", path, "--check").returncode, 0)
        self.assertIn("write mqtt://", self.refused("--broker", "x", "-c", path, "--check"))
        bad = rig.written("[fleet]\nbroker = mqtt://localhost\nspeed = 10\n")
        self.assertIn("speed: no such option", self.refused("-c", bad, "--check"))
