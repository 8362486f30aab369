"""What one sees and does on the page, with simulated chips, compared with imu9-sdo."""
import csv
import math
import random
import re
import signal
import statistics

import rig
from rig import sdo, value

if not rig.MISSING:
    from selenium.webdriver.common.keys import Keys

ARM_M = 0.05, 0, 0  # of the simulations
GRAVITY = 9.80665


def newest(pattern):
    """A file that the browser has downloaded."""
    return rig.wait_until(lambda: next(iter(rig.WORK.glob(pattern)), None), pattern)


class Live(rig.OnThePage):
    nodes = {1: "sim:tumble", 2: "sim:rest"}

    def test_values_move_and_agree_with_sdo(self):
        sdo(2, "write", "mounting.roll", 20)
        sdo(2, "write", "mounting.pitch", -10)
        self.addCleanup(sdo, 2, "write", "mounting.roll", 0)
        self.addCleanup(sdo, 2, "write", "mounting.pitch", 0)
        self.open()
        self.produce_sync()
        self.go("node/2/live")
        roll, pitch = value(2, "angles_deg.roll"), value(2, "angles_deg.pitch")
        self.assertGreater(abs(roll), 5)
        self.until(lambda: self.number('[data-fact="pdo_rate"]'), "PDOs come")
        self.until(lambda: abs((self.reading("angles", 1) or 0) - roll) < 0.3, "the roll of SDO, %.2f" % roll)
        self.until(lambda: abs((self.reading("angles", 2) or 0) - pitch) < 0.3, "the pitch of SDO, %.2f" % pitch)
        self.go("node/1/live")
        seen = set()
        self.until(lambda: seen.add(self.reading("angles", 1)) or len(seen) > 10, "the roll of the other node moves")

    def test_the_age_of_samples_is_that_of_sdo(self):
        self.open()
        self.produce_sync()
        self.go("node/1/live")

        def is_shown():
            shown = re.findall(r"\d+\.\d", self.text('[data-fact="sample_age"]'))
            read = [value(1, "sample_age." + member) / 1000 for member in ("minimum", "maximum")]
            return len(shown) == 2 and all(abs(float(a) - b) < 0.051 for a, b in zip(shown, read)) and read[1] > read[0]
        self.until(is_shown, "the shortest and the longest age")

    def test_without_pdos_the_values_are_read_by_sdo(self):
        sdo(1, "nmt", "preop")
        self.open("node/1/live")
        self.until(lambda: "pre-operational" in self.text(".hint"), "the page says why")
        seen = set()
        self.until(lambda: seen.add(self.reading("angles", 1)) or len(seen) > 5, "the roll moves")
        self.button("Start", ".hint").click()
        self.until(lambda: "operational" == self.text("#node-state"), "the node is started")

    def test_the_lever_arm_removes_what_rotation_causes(self):
        self.open()
        self.produce_sync()

        def rms():
            return float(self.driver.execute_script(
                "return document.querySelector('[data-fact=\"rms\"]')?.dataset.after") or "nan")

        self.go("node/1/live")
        self.until(lambda: rms() > 0.4, "the acceleration of a sensor 5 cm from the point that stands still")
        self.go("node/1/objects")
        self.write("lever_arm.l", "0.05")
        self.assertAlmostEqual(value(1, "lever_arm.l"), 0.05, 6)
        self.go("node/1/live")
        self.until(lambda: rms() < 0.2, "the acceleration of that point")
        sdo(1, "write", "lever_arm.l", 0)

    def test_force_and_rates_are_mapped_by_a_button_and_a_spectrum_appears(self):
        self.open()
        self.produce_sync()
        self.go("node/1/live")
        self.button("Map force and rates").click()
        self.until(lambda: "Specific force, sampled at 100" in self.text("#view"), "the spectrum of the force")
        self.assertEqual(sdo(1, "-q", "read", "tpdo5_mapping.object_1").split()[0], str(0x21430110))
        self.until(lambda: "before the lever arm correction" in self.text('[data-fact="rms"]'),
                   "the acceleration before the correction")

    def test_a_recording_is_downloaded_with_every_sample(self):
        self.open()
        self.produce_sync()
        self.go("node/1/live")
        self.until(lambda: self.number('[data-fact="pdo_rate"]'), "PDOs come")
        self.button("Record").click()
        self.until(lambda: (self.number(".recorder .note") or 0) > 200, "200 rows")
        self.button("Stop and download").click()
        with open(newest("node-1-*.csv")) as file:
            rows = list(csv.DictReader(file))
        self.assertGreater(len(rows), 200)
        times = [float(row["t [s]"]) for row in rows]
        self.assertEqual(times, sorted(times))
        counter = next(name for name in rows[0] if name.startswith("sample.counter"))
        shown = [row for row in rows if row[counter]]
        # SYNC and sensor have different clocks, and a busy machine holds a row up: most have 100 samples a second
        off = [(int(b[counter]) - int(a[counter])) % 65536 - 100 * (float(b["t [s]"]) - float(a["t [s]"]))
               for a, b in zip(shown, shown[1:])]
        self.assertLess(statistics.median(map(abs, off)), 5)
        self.assertGreater(statistics.pstdev(float(row["acceleration.l [m/s^2]"]) for row in rows
                                             if row["acceleration.l [m/s^2]"]), 0.1)


class HighNodeIds(rig.OnThePage):
    nodes = {48: "sim:rest", 100: "sim:tumble", 127: "sim:rest"}

    def can_ids(self, node):
        return ["%03X" % (int(value(node, "tpdo%d_communication.cob_id" % pdo)) & 0x800007FF) for pdo in (5, 6)]

    def test_force_and_rates_of_every_node_have_can_ids_of_their_own(self):
        self.open()
        self.produce_sync()
        for node, expected in ((100, ["6DC", "6DD"]), (127, ["6DA", "6DB"]), (48, ["6DE", "6DF"])):
            self.go("node/%d/live" % node)
            self.until(lambda: self.text("#node-facts").startswith("Node %d " % node), "the view of node %d" % node)
            self.button("Map force and rates").click()
            self.until(lambda: self.can_ids(node) == expected, "its CAN-IDs are %s" % expected)


class Identification(rig.OnThePage):
    nodes = {1: "sim:tumble"}

    def test_the_lever_arm_is_identified_to_1_mm(self):
        self.open("node/1/calibration")
        self.find('[data-start="lever_arm"]').click()
        self.until(lambda: "±" in self.text(".guide"), "an estimate with its sigma")
        self.button("Accept").click()
        self.button("Store over a power cut").click()
        self.until(lambda: "Stored" in self.text("#toasts"), "it is stored")
        for axis, true in zip("lst", ARM_M):
            self.assertLess(abs(value(1, "lever_arm." + axis) - true), 1e-3, axis)


class Uncalibrated(rig.OnThePage):
    nodes = {1: "sim:multiposition,uncalibrated", 2: "sim:rest,uncalibrated"}

    def error_of_gravity(self):
        """Median distance of the specific force from gravity, m/s^2, over several positions."""
        lines = sdo(1, "-q", "watch", "specific_force", "--rate", "10", "--count", "200").splitlines()
        forces = [[float(number) for number in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", line)[-3:]] for line in lines]
        return statistics.median(abs(math.hypot(*force) - GRAVITY) for force in forces if len(force) == 3)

    def test_an_accelerometer_is_calibrated_in_free_positions(self):
        before = self.error_of_gravity()
        self.open("node/1/calibration")
        self.find('[data-start="accelerometer_free"]').click()
        self.until(lambda: "of 12 positions" in self.text(".now"), "it counts positions")
        self.find(".big-drawing svg")
        self.button("Accept").click()
        self.button("Later").click()
        after = self.error_of_gravity()
        self.assertGreater(before, 0.1)
        self.assertLess(after, 0.03)

    def test_a_gyro_is_calibrated_at_rest(self):
        self.open("node/2/calibration")
        self.find('[data-start="gyro"]').click()
        self.until(lambda: "Do not touch" in self.text(".now"), "it says what to do")
        self.button("Accept").click()
        self.button("Later").click()
        biases = [value(2, "gyro_calibration.bias_" + axis) for axis in "xyz"]
        self.assertGreater(max(map(abs, biases)), 1e-4)
        for axis, bias in zip("xyz", biases):
            self.assertAlmostEqual(value(2, "calibration.bias_" + axis), bias, 7)


MOUNTING_DEG = 20, -35, 110


class Mounting(rig.OnThePage):
    """A sensor that is mounted askew in an object. Its gateway starts anew with the log of another pose when the page
    asks for that, as if somebody had raised the object meanwhile."""

    @classmethod
    def pose(cls, raised_deg):
        """Ten minutes of rest, as that sensor measures it in the object with its front raised about s. Its noise makes
        1 sigma of about 0.01 deg in the yaw that is found."""
        angle = math.radians(raised_deg)
        force = GRAVITY * math.sin(angle), 0, GRAVITY * math.cos(angle)
        cr, sr, cp, sp, cy, sy = (f(math.radians(a)) for a in MOUNTING_DEG for f in (math.cos, math.sin))
        turn = ((cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),  # sensor -> object: z-y'-x''
                (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
                (-sp, cp * sr, cp * cr))
        sensed = [sum(turn[i][k] * force[i] for i in range(3)) for k in range(3)]
        noise = random.Random(raised_deg).gauss
        path = rig.WORK / ("raised-%d.imu.csv" % raised_deg)
        with open(path, "w") as file:
            file.write("t,gx,gy,gz,ax,ay,az,mx,my,mz\n")
            for i in range(30000):
                row = [noise(0, 0.001) for _ in range(3)] + [f + noise(0, 0.005) for f in sensed]
                file.write("%.2f,%s,,,\n" % (0.02 * i, ",".join("%.5f" % v for v in row)))
        return "replay:%s,loop" % path

    @classmethod
    def setUpClass(cls):
        cls.nodes = {1: cls.pose(0)}
        super().setUpClass()

    def test_the_mounting_is_found_from_two_poses(self):
        sdo(1, "write", "mounting.yaw", 33)  # of before: it does not matter
        sdo(1, "store")
        self.open("node/1/calibration")
        self.find('[data-start="mounting"]').click()
        self.until(lambda: "Raise the front" in self.text(".now"), "the first pose is taken")
        self.assertEqual(len(self.all(".dots .done")), 1)
        self.assertEqual(value(1, "mounting.roll"), 0, "nothing is written yet")
        self.gateways[1].end()
        self.gateways[1].command = tuple(
            self.pose(45) if part.startswith("replay:") else part for part in self.gateways[1].command)
        self.gateways[1].start()
        self.until(lambda: self.all(".result"), "the second pose is taken")
        self.assertRegex(self.text(".result"), r"Yaw1\d\d\.\d\d° \(was 33\.00\).*Poses apart4[45]\.\d")
        self.button("Accept").click()
        self.button("Store over a power cut").click()
        self.until(lambda: "Stored" in self.text("#toasts"), "it is stored")
        for axis, true in zip(("roll", "pitch", "yaw"), MOUNTING_DEG):
            self.assertAlmostEqual(value(1, "mounting." + axis), true, delta=0.1, msg=axis)


class Mapping(rig.OnThePage):
    def test_a_pdo_is_mapped_by_keyboard(self):
        self.open("node/1/pdos")
        pdo = '[data-pdo="3"] '
        self.until(lambda: len(self.all(pdo + "li")) == 4, "the mapping is read")
        self.assertIn("0 bytes left", self.text(pdo + "header"))
        for left in (2, 4, 6, 8):
            self.find(pdo + "li").send_keys(Keys.DELETE)
            self.until(lambda: "%d bytes left" % left in self.text(pdo + "header"), "%d bytes left" % left)
        for name in ("quaternion16.w", "sample.counter", "angular_acceleration.l"):
            self.find(pdo + "input[list]").send_keys(name, Keys.ENTER)
        self.until(lambda: "0 bytes left" in self.text(pdo + "header"), "it is full")
        self.all(pdo + "li")[2].send_keys(Keys.ALT, Keys.ARROW_UP)
        self.find(pdo + "input[list]").send_keys("quaternion16.x", Keys.ENTER)
        self.assertIn("No room", self.text(pdo))
        self.button("Apply", pdo).click()
        self.until(lambda: "TPDO3 is mapped" in self.text("#toasts"), "it is mapped")
        entries = [int(sdo(1, "-q", "read", "tpdo3_mapping.object_%d" % i).split()[0]) for i in (1, 2, 3)]
        self.assertEqual(["%08X" % entry for entry in entries], ["21400110", "21060120", "210F0110"])
        self.assertEqual(value(1, "tpdo3_mapping.number_of_mapped_objects"), 3)

    def test_an_rpdo_is_mapped_with_what_it_can_receive(self):
        self.open("node/1/pdos")
        pdo = '[data-rpdo="2"] '
        self.until(lambda: len(self.all(pdo + "li")) > 1, "the mapping is read")
        while self.all(pdo + "li"):
            self.find(pdo + "li").send_keys(Keys.DELETE)
        entry = self.find(pdo + "input[list]")
        entry.send_keys("angles.roll", Keys.ENTER)
        self.assertIn("no object that an RPDO can receive", self.text(pdo))
        entry.clear()
        for name in ("0006h:00", "velocity_aid.x16", "velocity_aid.sigma16"):
            entry.send_keys(name, Keys.ENTER)
        self.assertIn("2 bytes left", self.text(pdo + "header"))
        self.button("Apply", pdo).click()
        self.until(lambda: "RPDO2 is mapped" in self.text("#toasts"), "it is mapped")
        entries = [int(sdo(1, "-q", "read", "rpdo2_mapping.object_%d" % i).split()[0]) for i in (1, 2, 3)]
        self.assertEqual(["%08X" % entry for entry in entries], ["00060010", "20700510", "20700810"])

    def drag(self, source, target):
        """Drags an element to the middle of another one, as a mouse does."""
        self.driver.execute_script("""
            const [source, target] = arguments, dataTransfer = new DataTransfer(), box = target.getBoundingClientRect();
            const at = {bubbles: true, cancelable: true, dataTransfer, clientX: box.x + box.width / 2,
                clientY: box.y + box.height / 2 + 1};
            source.dispatchEvent(new DragEvent("dragstart", {bubbles: true, dataTransfer}));
            for (const type of ["dragover", "drop"])
                target.dispatchEvent(new DragEvent(type, at));""", source, target)

    def entries(self, pdo):
        return [item.get_attribute("data-entry") for item in self.all('[data-pdo="%d"] li' % pdo)]

    def test_entries_are_dragged_within_a_pdo_and_from_one_to_another(self):
        self.open("node/1/pdos")
        self.until(lambda: len(self.entries(2)) == 4, "the mapping is read")
        first, second = self.all('[data-pdo="2"] li')[:2]
        self.drag(first, second)
        self.assertEqual(self.entries(2), ["angles.pitch", "angles.roll", "angles.yaw", "sample.counter"])
        self.drag(self.all('[data-pdo="2"] li')[2], self.find('[data-pdo="7"]'))
        self.assertEqual(self.entries(2), ["angles.pitch", "angles.roll", "sample.counter"])
        self.assertEqual(self.entries(7), ["angles.yaw"])
        self.drag(self.all('[data-pdo="2"] li')[0], self.find('[data-pdo="4"]'))
        self.assertEqual(len(self.entries(2)), 3, "what has no room stays where it was")
        self.assertEqual(sdo(1, "-q", "read", "tpdo7_mapping.number_of_mapped_objects").split()[0], "0")

    def test_a_preset_maps_all_pdos(self):
        self.open("node/1/pdos")
        rig.Select(self.find("#view select")).select_by_visible_text("IMU: specific force, rates, magnetic field")
        self.button("Apply", '[aria-label="Purpose of the PDOs"]').click()
        self.until(lambda: len(self.all('[data-pdo="1"] [data-entry="specific_force16.l"]')) == 1, "it is shown")
        self.assertEqual(sdo(1, "-q", "read", "pdo_preset").split()[0], "4")
        sdo(1, "write", "pdo_preset", 1)


class Lost(rig.OnThePage):
    nodes = {1: "sim:rest", 2: "sim:tumble"}

    def test_a_killed_gateway_is_greyed_and_comes_back_with_what_was_stored(self):
        self.open("node/1/objects")
        self.write("lever_arm.s", "0.125")
        self.go("node/1/configuration")
        self.find('[data-do="store"]').click()
        self.until(lambda: "Stored" in self.text("#toasts"), "it is stored")
        self.gateways[1].end(signal.SIGKILL)
        self.until(lambda: len(self.all('.lost[data-node="1"]')) == 1, "the node is greyed in the list")
        self.until(lambda: len(self.all("#main.is-lost")) == 1, "and its view, too")
        self.assertIn("This node is silent", self.text("#lost"))
        self.assertRegex(self.text("#lost"), r"Last heard \d+")
        self.go("bus")
        self.until(lambda: "lost" in self.text("#view tr.lost"), "and in the list of the bus")
        self.assertEqual(self.all("#main.is-lost"), [], "the view Bus itself is not grey")
        self.go("node/1/configuration")
        self.assertEqual(self.all('.lost[data-node="2"]'), [])
        self.gateways[1].start()
        self.until(lambda: not self.all('.lost[data-node="1"]') and not self.all("#main.is-lost"), "it is back")
        self.go("node/1/objects")
        self.find('input[type="search"]').send_keys("lever_arm.s")
        self.until(lambda: self.find('[data-object="lever_arm.s"] input').get_attribute("value") == "0.125",
                   "the stored value")
        self.assertEqual(value(1, "lever_arm.s"), 0.125)


class Configuration(rig.OnThePage):
    def give(self, button, path):
        """The user's file for the dialogue that this button opens."""
        label = next(label for label in self.all("label.button") if button in label.text)
        label.find_element(rig.By.CSS_SELECTOR, "input").send_keys(str(path))

    def check_files(self, format):
        """A file that is saved is compared and loaded again."""
        sdo(1, "write", "lever_arm.t", 0.0625)
        self.addCleanup(sdo, 1, "write", "lever_arm.t", 0)
        self.open("node/1/configuration")
        self.button("Save " + format.upper()).click()
        path = newest("node-1*." + format)
        rig.wait_until(lambda: path.stat().st_size > 1000, "the whole file")
        sdo(1, "write", "lever_arm.t", 0.5)
        self.give("Compare with a file …", path)
        self.assertRegex(self.find('tr[data-object="lever_arm.t"]').text, r"0\.5\b.*0\.0625")
        self.assertEqual(len(self.all("tr[data-object]")), 1)
        self.give("Load a file …", path)
        self.until(lambda: "1 object written" in self.text("#view"), "one object is written")
        self.assertEqual(value(1, "lever_arm.t"), 0.0625)

    def test_a_saved_configuration_is_compared_and_loaded_again(self):
        self.check_files("ini")

    def test_a_dcf_is_saved_compared_and_loaded_again(self):
        self.check_files("dcf")

    def test_a_changed_object_is_found_among_the_defaults_and_set_back(self):
        sdo(1, "write", "rate_filter.cutoff", 33)
        self.open("node/1/configuration")
        self.button("Compare with the defaults").click()
        row = self.find('tr[data-object="rate_filter.cutoff"]')
        self.assertRegex(row.text, r"33.*40")
        self.button("Set default", 'tr[data-object="rate_filter.cutoff"]').click()
        self.until(lambda: value(1, "rate_filter.cutoff") == 40, "it is set back")


class WithoutNodeId(rig.OnThePage):
    def test_a_unit_is_found_and_named_by_lss(self):
        unit = rig.Gateway(255, "sim:rest")
        self.addCleanup(unit.end)
        rig.wait_until(lambda: "LSS" in unit.text(), "the unit has started: " + unit.text())
        self.open("bus")
        self.button("Find units").click()
        entry = self.find(".unit-row input")
        entry.clear()
        entry.send_keys("77")
        self.button("Set", ".unit-row").click()
        self.find('[data-node="77"]')
        self.assertEqual(sdo(77, "-q", "read", "0x1018:2").split()[0], "9")
