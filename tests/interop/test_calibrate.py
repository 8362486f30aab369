"""imu9-calibrate: compared with scipy, on recorded trials, and with a gateway on a real bus."""
import configparser
import csv
import unittest

import rig

try:
    import numpy
    import scipy.optimize
except ImportError:
    numpy = None


def columns(path, names):
    with open(path) as file:
        rows = list(csv.DictReader(file))
    return numpy.array([[float(row[name]) for name in names] for row in rows if all(row[name] for name in names)])


def simulated(signal, *args):
    result = rig.run("imu9-sim", "--uncalibrated", *args, signal)
    assert result.returncode == 0, result.stderr
    return rig.written(result.stdout, ".imu.csv")


def calibrated(what, log, *args):
    """(bias, matrix) from the file that imu9-calibrate writes."""
    ini = rig.scratch(".ini")
    result = rig.run("imu9-calibrate", what, *args, "-o", str(ini), str(log))
    assert result.returncode == 0, result.stderr
    config = configparser.ConfigParser()
    config.read(ini)
    section = config[what + "_calibration"]
    bias = numpy.array([float(section["bias_" + axis]) for axis in "xyz"])
    matrix = numpy.array([[float(section[row + column]) for column in "xyz"] for row in "xyz"])
    return bias, matrix


def ellipsoid(points, radius):
    """Centre c and symmetric matrix M that minimise the squares of |M (p - c)| - radius, by scipy."""
    def unpack(x):
        return x[:3], numpy.array([[x[3], x[6], x[7]], [x[6], x[4], x[8]], [x[7], x[8], x[5]]])

    def miss(x):
        centre, matrix = unpack(x)
        return numpy.linalg.norm((points - centre) @ matrix.T, axis=1) - radius

    start = numpy.concatenate([(points.max(0) + points.min(0)) / 2, [1, 1, 1, 0, 0, 0]])
    return unpack(scipy.optimize.least_squares(miss, start, x_scale="jac").x)


@unittest.skipIf(numpy is None, "numpy and scipy are missing: apt-get install python3-numpy python3-scipy")
class AgainstScipy(unittest.TestCase):
    def test_free_positions_give_the_result_of_scipy_for_the_rests(self):
        log = simulated("multiposition")
        accel = columns(log, ["ax", "ay", "az"])
        # the simulation rests for 3 s at the beginning of each 4.5 s
        starts = [4.5 * k for k in range(14)]
        rests = [accel[int(100 * (t + (0.5 if t else 0.2))):int(100 * (t + 2.7))].mean(0) for t in starts]
        centre, matrix = ellipsoid(numpy.array(rests), 9.80665)
        bias, found = calibrated("accelerometer", log)
        self.assertLess(abs(bias - centre).max(), 0.006)
        self.assertLess(abs(found - matrix).max(), 5e-4)

    def test_the_magnetometer_gives_the_result_of_scipy_for_all_samples(self):
        log = simulated("figure")
        centre, matrix = ellipsoid(columns(log, ["mx", "my", "mz"]), 50)
        bias, found = calibrated("magnetometer", log, "--field", "50")
        self.assertLess(abs(bias - centre).max(), 0.15)
        self.assertLess(abs(found - matrix).max(), 5e-3)


@unittest.skipIf(numpy is None, "numpy and scipy are missing: apt-get install python3-numpy python3-scipy")
class RecordedTrials(unittest.TestCase):
    def test_iron_calibrated_in_one_trial_is_corrected_in_another_one(self):
        """The magnetometer of the trials is calibrated; the remaining 2 % are the inhomogeneity of the room."""
        iron, offset = numpy.array([[1.1, 0.05, 0], [0, 0.9, 0.03], [0.02, 0, 1.05]]), numpy.array([30, -20, 15])

        def spread(vectors):
            lengths = numpy.linalg.norm(vectors, axis=1)
            return lengths.std() / lengths.mean()

        with open(rig.recorded("02")) as file:
            rows = list(csv.DictReader(file))
        lines = ["t,gx,gy,gz,ax,ay,az,mx,my,mz"]
        for row in rows:
            field = iron @ [float(row[name] or 0) for name in ("mx", "my", "mz")] + offset
            mag = "%.4f,%.4f,%.4f" % tuple(field) if row["mx"] else ",,"
            lines.append(",".join(row[name] for name in ("t", "gx", "gy", "gz", "ax", "ay", "az")) + "," + mag)
        bias, matrix = calibrated("magnetometer", rig.written("\n".join(lines) + "\n", ".imu.csv"))
        for trial in "02", "09":
            field = columns(rig.recorded(trial), ["mx", "my", "mz"])
            distorted = field @ iron.T + offset
            self.assertGreater(spread(distorted), 0.1)
            self.assertLess(spread((distorted - bias) @ matrix.T), 1.15 * spread(field))

    def test_the_gyro_bias_of_two_trials_of_one_session_agrees(self):
        first, second = (calibrated("gyro", rig.recorded(trial))[0] for trial in ("02", "09"))
        self.assertLess(abs(first - second).max(), 0.015 * numpy.pi / 180)

    def test_a_trial_with_one_rest_cannot_calibrate_an_accelerometer(self):
        result = rig.run("imu9-calibrate", "accelerometer", str(rig.recorded("06")))
        self.assertEqual(result.returncode, 1)
        self.assertIn("too few positions", result.stderr)
        self.assertRegex(result.stderr, r"missing: \S+ up; the nearest is \d+ deg away")


@unittest.skipIf(numpy is None, "numpy is missing: apt-get install python3-numpy")
class Options(unittest.TestCase):
    def test_set_overrides_the_file_in_any_order(self):
        log = simulated("rest", "--duration", 20)
        file = rig.written("gyro_calibration.xx = 1.02\n", ".ini")
        matrix = calibrated("gyro", log, "--set", "gyro_calibration.xx=1.01", "-c", str(file))[1]
        self.assertEqual(matrix[0, 0], 1.01)

    def test_an_unknown_quantity_is_refused_with_the_list_of_quantities(self):
        result = rig.run("imu9-calibrate", "giro", "log.csv")
        self.assertEqual(result.returncode, 2)
        self.assertIn("giro: not a quantity: give gyro, accelerometer", result.stderr)


class ByCommand(unittest.TestCase):
    def test_a_gyro_is_calibrated_and_accepted(self):
        gateway = rig.Gateway(imu="sim:rest,uncalibrated")
        self.addCleanup(gateway.close)
        rig.wait_until(lambda: "pre-operational" in gateway.log)
        node = "-i", rig.BUS, "-n", rig.NODE
        result = rig.run("imu9-calibrate", *node, "gyro", "--yes")
        self.assertEqual(result.returncode, 0, result.stderr)
        self.assertIn("accepted", result.stdout)
        found = next(line for line in result.stdout.splitlines() if line.startswith("bias"))
        kept = rig.run("imu9-sdo", *node, "read", "gyro_calibration.bias_x")
        self.assertIn(found.split()[1][:8], kept.stdout)
