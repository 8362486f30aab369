"""imu9-commission: the dialogue, from an uncalibrated chip, mounted obliquely, to a stored configuration."""
import math
import os
import subprocess
import unittest

import rig

SPEED = 4  # of the replay; the procedures count the time of the samples
SEED = os.environ.get("IMU9_COMMISSION_SEED", "1")  # another chip
ARM = 0.05, -0.02, 0.03  # m
MOUNTING = 20.0, -35.0, 110.0  # deg
STEPS = 8
SKIP = "s\n"


def rotation(roll, pitch, yaw):
    """Sensor -> object, z-y'-x''."""
    cr, sr, cp, sp, cy, sy = (f(math.radians(a)) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return [[cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr]]


class Motion:
    """Logs of one chip one after the other, as a chip measures them that is turned by MOUNTING in the object."""

    def __init__(self):
        self.rows, self.turn = [], rotation(*MOUNTING)

    def sensor_axes(self, text):
        v = [float(x) for x in text]
        return ["%.6f" % sum(self.turn[i][k] * v[i] for i in range(3)) for k in range(3)]

    def add(self, signal, seconds, start=0.0, repeat=1):
        result = rig.run("imu9-sim", "--uncalibrated", "--seed", SEED, "--lever-arm", "%g,%g,%g" % ARM, "-d",
                         start + seconds, signal)
        assert result.returncode == 0, result.stderr
        rows = [line.split(",") for line in result.stdout.splitlines()[1:]]
        for row in [row[1:] for row in rows if float(row[0]) >= start] * repeat:
            triads = row[0:3], row[3:6], row[6:9]
            self.rows.append(sum((self.sensor_axes(t) if t[0] else t for t in triads), []))
        return self

    def write(self):
        lines = ["%.2f,%s" % (0.01 * i, ",".join(row)) for i, row in enumerate(self.rows)]
        head = ["# uncalibrated: gyro accelerometer magnetometer", "t,gx,gy,gz,ax,ay,az,mx,my,mz"]
        return rig.written("\n".join(head + lines) + "\n", ".imu.csv")


def commissioning():
    """A hand that does what the dialogue asks for, in its order: 7 minutes. Each procedure waits for its motion."""
    motion = Motion()
    motion.add("rest", 40)
    motion.add("multiposition", 63)
    motion.add("figure", 60)
    motion.add("multiposition", 3, repeat=20)  # level
    motion.add("multiposition", 2.9, start=58.55, repeat=20)  # its 14th position: the front up
    return motion.add("tumble", 140).write()


class Dialogue:
    """A user at the prompts of imu9-commission. `before` maps the name of a step to what is awaited first."""

    def __init__(self, process, before):
        self.text = ""
        while (letter := process.stdout.read(1)):
            self.text += letter
            if self.text.endswith("quits: "):
                step = self.text[self.text.rindex(" of %d: " % STEPS):].split("]")[0][7:]
                before.get(step, lambda: None)()
                self.answer(process, "robot_base" if step == "motion preset" else "")
            elif self.text.endswith("[y/N] "):
                self.answer(process, "y")
        self.status = process.wait(rig.PATIENCE)

    @staticmethod
    def answer(process, text):
        process.stdin.write(text + "\n")
        process.stdin.flush()


class Commission(unittest.TestCase):
    def start(self, imu="sim:rest", *options):
        gateway = rig.Gateway(*options, imu=imu)
        self.addCleanup(gateway.close)
        rig.wait_until(lambda: "pre-operational" in gateway.log)
        return gateway

    def read(self, *names, node=rig.NODE):
        result = rig.run("imu9-sdo", "-q", "-i", rig.BUS, "-n", node, "read", *names)
        self.assertEqual(result.returncode, 0, result.stderr)
        return [float(line) for line in result.stdout.split()]

    def command(self, *options):
        self.report = rig.scratch(".txt")
        return rig.program("imu9-commission"), "-i", rig.BUS, "-n", str(rig.NODE), "-o", str(self.report), *options

    def answered(self, *lines):
        file = rig.written("".join(lines), ".txt")
        command = self.command("--answers", str(file))
        return subprocess.run(command, capture_output=True, text=True, timeout=rig.PATIENCE)

    @unittest.skipUnless(rig.SIMULATED_TIME, "in real time the log goes on while a busy machine does not; make rig")
    def test_an_uncalibrated_chip_becomes_a_stored_configuration(self):
        gateway = self.start("replay:%s,speed=%d" % (commissioning(), SPEED),
                             "--set", "lever_arm_identification.duration=60")
        self.assertEqual(self.read("sensor_state.uncalibrated"), [7])
        tumbling = {"lever arm": lambda: rig.wait_until(
            lambda: max(map(abs, self.read("angular_rate.l", "angular_rate.s"))) > 1)}
        process = subprocess.Popen(self.command(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        dialogue = Dialogue(process, tumbling)
        self.assertEqual(dialogue.status, 0, dialogue.text)
        self.assertEqual(self.read("sensor_state.uncalibrated"), [0])
        # stored: a gateway that starts anew has the values
        names = "lever_arm", "mounting", "accelerometer_calibration", "position.motion_preset"
        values = self.read(*names)
        gateway.end()
        gateway.start()
        rig.wait_until(lambda: gateway.log.count("pre-operational") > 1)
        self.assertEqual(self.read(*names), values)
        arm, mounting, accelerometer, preset = values[:3], values[3:6], values[6:18], values[18]
        self.assertEqual(preset, 2)
        tilt_deg, off_mm = self.worst_tilt_deg(accelerometer, mounting), [1e3 * (a - b) for a, b in zip(arm, ARM)]
        self.note = "lever arm off by %.2f %.2f %.2f mm, tilt by %.3f deg" % (*off_mm, tilt_deg)
        self.assertLess(tilt_deg, 0.1)
        # by the matrix of the gyro: with its bias alone, 1 % of scale is 1 % of the arm
        self.assertLess(max(map(abs, off_mm)), 0.5)

    def worst_tilt_deg(self, accelerometer, mounting):
        """Of the calibrated force on six faces and eight corners, against the motion's own attitude."""
        bias, matrix, turn = accelerometer[:3], accelerometer[3:], rotation(*mounting)
        log = Motion().add("multiposition", 63).rows
        truth = rig.run("imu9-sim", "--truth", "-d", 63, "multiposition").stdout
        worst = 0
        for k in range(14):
            rest = range(int(450 * k) + 50, int(450 * k) + 250)
            raw = [sum(float(log[i][3 + axis]) for i in rest) / len(rest) - bias[axis] for axis in range(3)]
            force = [sum(matrix[3 * i + j] * raw[j] for j in range(3)) for i in range(3)]
            found = [sum(turn[i][j] * force[j] for j in range(3)) for i in range(3)]
            w, x, y, z = (float(v) for v in truth.splitlines()[1 + rest[100]].split(",")[10:14])
            up = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
            worst = max(worst, math.degrees(math.dist(up, [f / math.hypot(*found) for f in found])))
        return worst

    def test_a_step_can_be_skipped_repeated_and_quit_and_then_all_is_as_before(self):
        self.start()
        result = self.answered(5 * SKIP, "foot\n", "r\n", "lift\n", "2\n", "200\n", "q\n", "n\n")
        self.assertEqual(result.returncode, 1)
        self.assertIn("motion_preset = foot", result.stdout)
        self.assertIn("lift: no preset", result.stderr)
        self.assertIn("motion_preset = robot_base", result.stdout)
        self.assertIn("all values are as they were before", result.stdout)
        self.assertEqual(self.read("position.motion_preset"), [0])
        self.assertFalse(self.report.exists())

    def test_a_step_can_be_repeated_any_number_of_times(self):
        self.start()
        answers = rig.written(SKIP + 40 * ("r\n" + SKIP) + "q\n" + "n\n", ".txt")
        result = subprocess.run(["prlimit", "--nofile=24", *self.command("--answers", str(answers))],
                                capture_output=True, text=True, timeout=rig.PATIENCE)
        self.assertIn("all values are as they were before", result.stdout, result.stderr)

    def test_what_was_done_can_be_kept(self):
        self.start()
        result = self.answered("\n", "y\n", 4 * SKIP, "foot\n", "q\n", "y\n")
        self.assertEqual(result.returncode, 1)
        self.assertEqual(self.read("position.motion_preset"), [5])
        report = self.report.read_text()
        self.assertRegex(report, r"\[gyro\]\nbias .* rad/s\n1 sigma .* rad/s\n")
        self.assertIn("[magnetometer]\nskipped\n", report)
        self.assertIn("motion_preset = foot", report)
        self.assertIn("identity.serial_number", report)

    def test_after_a_failure_without_a_user_all_is_as_before(self):
        log = "t,gx,gy,gz,ax,ay,az\n" + "".join("%.2f,0,0,0,0,0,9.81\n" % (0.01 * i) for i in range(6))
        gateway = self.start("replay:%s" % rig.written(log, ".imu.csv"))
        rig.wait_until(lambda: "has ended" in gateway.log)
        result = subprocess.run(self.command("--yes"), capture_output=True, text=True, timeout=rig.PATIENCE)
        self.assertEqual(result.returncode, 1)
        self.assertIn("the step 'gyro' failed", result.stderr)
        self.assertIn("all values are as they were before", result.stdout)

    def test_the_node_id_is_given_by_lss(self):
        self.start()
        result = self.answered(6 * SKIP, "128\n", "18\n", "\n")
        self.assertEqual(result.returncode, 0, result.stderr)
        self.assertIn("128: no node-ID", result.stderr)
        self.assertEqual(rig.run("imu9-sdo", "-i", rig.BUS, "-n", rig.NODE, "nmt", "reset-comm").returncode, 0)
        rig.wait_until(lambda: rig.run("imu9-sdo", "-i", rig.BUS, "-n", 18, "read", "gravity").returncode == 0)

    def test_without_a_node_id_it_takes_the_only_node(self):
        self.start()
        result = subprocess.run([rig.program("imu9-commission"), "-i", rig.BUS, "-o", str(rig.scratch())], text=True,
                                input="q\nn\n", capture_output=True, timeout=rig.PATIENCE)
        self.assertIn("identity.serial_number", result.stdout)
        self.assertIn("all values are as they were before", result.stdout)
