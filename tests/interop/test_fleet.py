"""imu9-fleet between a bus and a real MQTT broker: what subscribers get are the values of the TPDOs with their counters,
also when the broker was away. IMU9_FLEET_SECONDS=300 keeps it away for longer."""
import json
import os
import signal
import struct
import time
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

    @classmethod
    def setUpClass(cls):
        mqtt.required()
        super().setUpClass()

    def setUp(self):
        super().setUp()
        self.broker = mqtt.Broker()
        self.addCleanup(self.broker.close)
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
        return [json.loads(payload) for _, payload in self.subscriber.messages(ending)]

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

    def listen_from_first(self, seconds):
        """The frames of complete samples that imu9-fleet has seen, too, and more for so long."""
        rig.wait_until(self.values)
        self.master.drain()
        return self.master.listen(seconds)

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
                self.assertAlmostEqual(published[counter][name], value, 6, (counter, name))
        return inner


class FleetPublishes(Published):
    imu = "sim:square"

    def test_the_values_of_the_pdos_with_their_counters(self):
        self.start()
        self.run_fleet()
        self.assertGreater(len(self.check(self.listen_from_first(1))), 50)

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
        frames = self.listen_from_first(0.5)
        for frame in self.pdos(frames, 2)[1:-1]:
            w, counter = struct.unpack("<fH", frame.data)
            self.wait_for(counter)
            self.assertEqual(struct.pack("<f", self.samples()[0][counter]["quaternion.w"]), struct.pack("<f", w))

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
        frames = self.listen_from_first(0.5)
        self.broker.kill()
        frames += self.master.listen(SECONDS)
        self.assertGreater(fleet.spool_bytes(), 0)
        self.assertLess(fleet.spool_bytes(), 64 << 20)
        self.broker.start()
        frames += self.master.listen(2)
        self.assertGreater(len(self.check(frames)), 100 * SECONDS / 2)
        rig.wait_until(lambda: fleet.spool_bytes() == 0)

    def test_while_it_was_stopped_itself_and_the_broker_was_away(self):
        self.start()
        fleet = self.run_fleet()
        self.broker.keep_sessions()
        frames = self.listen_from_first(0.5)
        self.broker.kill()
        frames += self.master.listen(1)
        self.assertEqual(fleet.end(), 0)
        self.broker.start()
        fleet.start()
        self.check(frames)

    def test_by_a_kill_but_the_last_second(self):
        self.start()
        fleet = self.run_fleet()
        self.broker.keep_sessions()
        self.broker.kill()
        rig.wait_until(lambda: fleet.spool_bytes() > 0)
        frames = self.master.listen(SECONDS + 1)
        fleet.end(signal.SIGKILL)
        last = max(of_frames(frames))
        self.broker.start()
        fleet.start()
        self.check([f for f in frames if max(of_frames([f]), default=last) <= last - 110])


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
