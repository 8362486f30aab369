"""tools/experiments/broad2log on a trial that is made here in the format of the BROAD data set."""
import csv
import pathlib
import subprocess
import unittest

import rig

try:
    import numpy
    import scipy.io
except ImportError:
    numpy = None

PROGRAM = pathlib.Path(__file__).resolve().parents[2] / "tools/experiments/broad2log"
RATE_HZ, SAMPLES = 1000 / 3.5, 3000


def convert(trial):
    """Rows of TRIAL.imu.csv and TRIAL.ref.csv."""
    mat = rig.scratch(".mat")
    scipy.io.savemat(mat, trial)
    subprocess.run([PROGRAM, "-o", mat.parent, mat], check=True, stdout=subprocess.DEVNULL)
    tables = []
    for kind in "imu", "ref":
        path = mat.with_suffix(".%s.csv" % kind)
        with open(path) as file:
            tables.append(list(csv.DictReader(file)))
        path.unlink()
    return tables


@unittest.skipIf(numpy is None, "numpy and scipy are missing: apt-get install python3-numpy python3-scipy")
class Broad2log(unittest.TestCase):
    def setUp(self):
        self.t = numpy.arange(SAMPLES) / RATE_HZ
        still, gyro = numpy.zeros((SAMPLES, 3)), numpy.outer(self.t, [1, 2, 3])
        position = numpy.outer(numpy.sin(2 * self.t), [0.5, 0, 0])
        attitude = numpy.tile([1.0, 0, 0, 0], (SAMPLES, 1))
        attitude[1500:1510] = numpy.nan
        self.trial = {"sampling_rate": RATE_HZ, "imu_gyr": gyro, "imu_acc": still + [0, 0, 9.81], "imu_mag": still + 20,
                      "opt_quat": attitude, "opt_pos": position, "movement": (self.t > 2).astype("uint8")}

    def test_measurements_and_reference_have_a_row_for_each_sample(self):
        imu, ref = convert(self.trial)
        self.assertEqual((len(imu), len(ref)), (SAMPLES, SAMPLES))
        self.assertEqual(list(imu[2].values()), ["0.007000", "0.00700", "0.01400", "0.02100", "0.0000", "0.0000",
                                                 "9.8100", "20.000", "20.000", "20.000"])
        self.assertEqual([row["moving"] for row in ref], ["1" if t > 2 else "0" for t in self.t])

    def test_the_acceleration_is_the_second_derivative_of_the_position(self):
        _, ref = convert(self.trial)
        for k in range(400, 1400):
            self.assertAlmostEqual(float(ref[k]["arx"]), -2 * numpy.sin(2 * self.t[k]), delta=0.002)

    def test_the_acceleration_is_empty_near_gaps_and_at_both_ends(self):
        _, ref = convert(self.trial)
        empty = [k for k in range(SAMPLES) if ref[k]["arx"] == ""]
        self.assertEqual(empty, [*range(300), *range(1500 - 34, 1510 + 34), *range(SAMPLES - 300, SAMPLES)])
        self.assertEqual([k for k in range(SAMPLES) if ref[k]["qw"] == ""], list(range(1500, 1510)))

    def test_a_file_of_another_format_is_refused_with_its_name(self):
        other = rig.written("no trial", ".mat")
        result = subprocess.run([PROGRAM, other], capture_output=True, text=True)
        self.assertEqual(result.returncode, 1)
        self.assertIn(str(other), result.stderr)
