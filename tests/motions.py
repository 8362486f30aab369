"""Simulated motions of a mounted IMU with known truth, for tests/honesty.

A motion is a mechanism driven by a coordinate q(t), a distance or an angle, whose derivatives are known in closed form
or from the equation of motion. The mechanism turns q, dq/dt and d2q/dt2 into position and acceleration of the sensor in
the frame of the machine, and into its rotation about a fixed axis there. So the rate and the specific force

    f_b = R_bn (a_n + g)                                        (g: 9.81 m/s^2, up)

are exact. Vibration is a displacement, too. The heading of the machine and a mounting a few degrees off level are drawn
with the seed, as are the errors of the sensor.

Frames: b = sensor, machine = z up, n = global (ENU). Units: m, s, rad, uT."""
import zlib
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Callable, Dict
import numpy as np
from scipy.integrate import solve_ivp
from scipy.signal import butter, sosfilt
from scipy.spatial.transform import Rotation

GRAVITY_M_S2 = 9.81
RATE_HZ = 100  # of the samples
STEP_S = 1e-3  # of the simulation, in which the chip's low-pass runs
REST_S = 10.0  # before and after each motion, if nothing else is said
FIELD_N_UT = np.array([0, 20.3, -43.5])  # 48 uT, dip 65 deg
WARMING_S = 120.0  # time constant of a board after it is switched on
FADE_S = 1.0  # in which vibration begins and ends
MOUNTING_RAD = np.radians(3)  # 1 sigma of roll and pitch


@dataclass
class Chip:
    """A calibrated MEMS chip; spreads are 1 sigma. Noise densities per sqrt(Hz), one-sided."""
    cut_off_hz: float = 40.0  # second-order Butterworth
    accel_bias_m_s2: float = 0.02
    accel_scale: float = 0.002
    accel_density_m_s2: float = 150e-6 * GRAVITY_M_S2
    accel_step_m_s2: float = 244e-6 * GRAVITY_M_S2
    gyro_bias_rad_s: float = np.radians(0.02)
    gyro_scale: float = 0.003
    gyro_density_rad_s: float = np.radians(0.01)
    gyro_walk_rad_s: float = np.radians(0.001)  # of the bias, per sqrt(s)
    gyro_step_rad_s: float = np.radians(0.07)
    mag_uT: float = 0.5  # noise of one sample
    uncalibrated_rad_s: float = 0.0  # length of a further gyro bias, in any direction
    warms_K: float = 0.0  # above the 25 degC at the start, within some WARMING_S; and what that does to the biases:
    gyro_bias_rad_s_K: float = np.radians(0.03)
    accel_bias_m_s2_K: float = 0.5e-3 * GRAVITY_M_S2

    def delay_s(self):
        """Of slow changes: sqrt(2) / omega of the low-pass."""
        return np.sqrt(2) / (2 * np.pi * self.cut_off_hz)


@dataclass
class Course:
    """A coordinate over time: value and its first two derivatives."""
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray

    def __add__(self, other):
        return Course(self.q + other.q, self.dq + other.dq, self.ddq + other.ddq)


def step(t, begin_s, ramp_s, speed):
    """The speed changes by `speed` from begin_s on, along half a cosine of ramp_s."""
    u = np.clip((t - begin_s) / ramp_s, 0, 1)
    after_s = np.maximum(t - begin_s - ramp_s, 0)
    return Course(speed * (ramp_s * (u / 2 - np.sin(np.pi * u) / (2 * np.pi)) + after_s),
                  speed * (1 - np.cos(np.pi * u)) / 2,
                  speed * np.pi / (2 * ramp_s) * np.sin(np.pi * u))


def cruise(t, begin_s, ramp_s, speed, cruise_s):
    return step(t, begin_s, ramp_s, speed) + step(t, begin_s + ramp_s + cruise_s, ramp_s, -speed)


def swing(t, begin_s, fade_s, amplitude, hz, full_s, phase=0.0):
    """A sine whose amplitude A fades in and out, as the speed of a cruise does."""
    fade = cruise(t, begin_s, fade_s, amplitude, full_s)
    a, da = fade.dq, fade.ddq
    fading = (t > begin_s) & (t < begin_s + fade_s) | \
        (t > begin_s + fade_s + full_s) & (t < begin_s + 2 * fade_s + full_s)
    dda = np.where(fading, (np.pi / fade_s) ** 2 * (amplitude / 2 - a), 0)  # A is half a cosine about amplitude / 2
    w = 2 * np.pi * hz
    s, c = np.sin(w * (t - begin_s) + phase), np.cos(w * (t - begin_s) + phase)
    return Course(a * s, da * s + a * w * c, dda * s + 2 * da * w * c - a * w * w * s)


@dataclass
class Path:
    """Of the sensor in the machine's frame; the rotation is `angle` about a fixed axis."""
    position: np.ndarray
    accel: np.ndarray
    axis: np.ndarray = field(default_factory=lambda: np.array([0, 0, 1.0]))
    angle: np.ndarray = 0.0
    rate: np.ndarray = 0.0


def slide(course, axis):
    return Path(np.outer(course.q, axis), np.outer(course.ddq, axis))


def rotate(course, axis, arm):
    """A rigid arm turns about an axis through a fixed point; the path begins at 0."""
    axis, arm = np.asarray(axis, float), np.asarray(arm, float)
    radial = Rotation.from_rotvec(np.outer(course.q, axis)).apply(arm)
    tangential = np.cross(axis, radial)
    return Path(radial - arm, course.ddq[:, None] * tangential - (course.dq ** 2)[:, None] * radial, axis, course.q,
                course.dq)


def pendulum(trolley, t, rope_m, damping_per_s):
    """A load under a trolley: theta'' = -(g sin theta + x'' cos theta) / rope - damping theta'. At theta > 0 the load
    is ahead of the trolley: a turn about -y."""
    def pull(at_s):
        return np.interp(at_s, t, trolley.ddq)

    def motion(at_s, state):
        theta, omega = state
        return omega, -(GRAVITY_M_S2 * np.sin(theta) + pull(at_s) * np.cos(theta)) / rope_m - damping_per_s * omega
    theta, omega = solve_ivp(motion, t[[0, -1]], [0, 0], t_eval=t, rtol=1e-8, atol=1e-10, max_step=0.1).y
    load = rotate(Course(theta, omega, motion(t, (theta, omega))[1]), [0, -1, 0], [0, 0, -rope_m])
    carried = slide(trolley, [1, 0, 0])
    return Path(load.position + carried.position, load.accel + carried.accel, load.axis, load.angle, load.rate)


def stride(t, begin_s, swing_s):
    """Of one swing of the leg: phase 0..1, the same as an angle of a full turn, and its angular velocity."""
    u = np.clip((t - begin_s) / swing_s, 0, 1)
    return u, 2 * np.pi * u, 2 * np.pi / swing_s


def walk(t, begin_s, strides, length_m, swing_s, stance_s):
    """A sensor on a shoe: in each swing it moves forward along x, is lifted by 10 cm, and pitches to and fro by 40 deg.
    In the stances it stands."""
    height_m, pitch_rad = 0.1, np.radians(40)
    position, accel = np.zeros((2, len(t), 3))
    pitch, rate = np.zeros((2, len(t)))
    for k in range(strides):
        u, s, w = stride(t, begin_s + k * (swing_s + stance_s), swing_s)
        position[:, 0] += length_m * (u - np.sin(s) / (2 * np.pi))
        accel[:, 0] += length_m * w ** 2 / (2 * np.pi) * np.sin(s)
        position[:, 2] += height_m * ((1 - np.cos(s)) / 2) ** 2
        accel[:, 2] += height_m * w ** 2 * (np.cos(s) - np.cos(2 * s)) / 2
        pitch += pitch_rad * (np.sin(s) - np.sin(2 * s) / 2) / 1.3
        rate += pitch_rad * w * (np.cos(s) - np.cos(2 * s)) / 1.3
    return Path(position, accel, np.array([0, 1.0, 0]), pitch, rate)


def shake(t, rng, begin_s, end_s, amplitude_m_s2, hz):
    """By a machine: one sine, mostly vertical. `amplitude_m_s2` is that of the acceleration."""
    displacement = swing(t, begin_s, FADE_S, amplitude_m_s2 / (2 * np.pi * hz) ** 2, hz, end_s - begin_s - 2 * FADE_S)
    return slide(displacement, [0.3, 0.3, 1])


def rumble(t, rng, begin_s, end_s, rms_m_s2, low_hz, high_hz):
    """Of a vehicle: acceleration with an even spectrum between two frequencies, half as strong sideways."""
    tones = 20
    axes = []
    for strength in (0.5, 0.5, 1):
        hz = low_hz + (high_hz - low_hz) * (np.arange(tones) + rng.uniform(size=tones)) / tones
        axes.append(sum((swing(t, begin_s, FADE_S, strength * rms_m_s2 * np.sqrt(2 / tones) / (2 * np.pi * f) ** 2, f,
                               end_s - begin_s - 2 * FADE_S, rng.uniform(0, 2 * np.pi)) for f in hz),
                        Course(0, 0, 0)))
    return Path(np.stack([axis.q for axis in axes], 1), np.stack([axis.ddq for axis in axes], 1))


@dataclass
class Motion:
    path: Callable  # t -> Path
    begin_s: float
    end_s: float
    vibration: Callable = None  # t, rng, begin_s, end_s -> Path, added to the other
    chip: Dict = field(default_factory=dict)  # what differs from a calibrated one
    turns: bool = False  # about the vertical: worth a replay without magnetometer
    preset: int = 0  # position.motion_preset
    rope_m: float = 0  # position.rope_length
    gaps: bool = False  # without samples for 0.08 to 0.32 s, every 0.5 to 3 s of the motion
    uncalibrated: str = ''  # the sensors that the log tells to be


def drive(speed, cruise_s, ramp_s, axis=(1, 0, 0), vibration=None, preset=0):
    return Motion(lambda t: slide(cruise(t, REST_S, ramp_s, speed, cruise_s), axis), REST_S,
                  REST_S + 2 * ramp_s + cruise_s, vibration, preset=preset)


def turn(rate_rad_s, cruise_s, radius_m=0.0, begin_s=REST_S, ramp_s=1.0):
    return Motion(lambda t: rotate(cruise(t, begin_s, ramp_s, rate_rad_s, cruise_s), [0, 0, 1], [0, -radius_m, 0]),
                  begin_s, begin_s + 2 * ramp_s + cruise_s, turns=True)


def arm(length_m, amplitude_deg, hz, full_s=60.0, fade_s=2.0):
    return Motion(lambda t: rotate(swing(t, REST_S, fade_s, np.radians(amplitude_deg), hz, full_s), [0, -1, 0],
                                   [0, 0, -length_m]), REST_S, REST_S + 2 * fade_s + full_s)


# the load still swings at the end
def crane(rope_m, speed, cruise_s, swings_s, told_m=None):
    preset = {} if told_m is None else {'preset': 7, 'rope_m': told_m}
    return Motion(lambda t: pendulum(cruise(t, REST_S, 2.0, speed, cruise_s), t, rope_m, 0.02), REST_S,
                  REST_S + 4 + cruise_s + swings_s, **preset)


def still(begin_s=0.0, vibration=None, **chip):
    return Motion(lambda t: slide(Course(0 * t, 0 * t, 0 * t), [1, 0, 0]), begin_s, 60, vibration, chip)


def on_foot(strides, length_m, swing_s, stance_s):
    return Motion(lambda t: walk(t, REST_S, strides, length_m, swing_s, stance_s), REST_S,
                  REST_S + strides * (swing_s + stance_s), preset=5)


def all_motions():
    m = {}
    for speed in (0.05, 0.2, 0.5, 1.0):
        for seconds in (10, 60):
            m[f'straight {speed:g} m/s, {seconds} s'] = drive(speed, seconds, 1.0)
    for rms in (0.3, 1.0):
        m[f'road {rms:g} m/s², 1 m/s, 60 s'] = drive(1.0, 60, 1.5, vibration=partial(
            rumble, rms_m_s2=rms, low_hz=3, high_hz=25))
    m['conveyor 0.3 m/s, 30 s'] = drive(0.3, 30, 0.5, vibration=partial(rumble, rms_m_s2=0.1, low_hz=10, high_hz=40))
    for height, speed, ramp_s in ((3, 0.5, 1.0), (12, 2.0, 2.0), (40, 2.5, 2.5)):
        for preset, name in ((0, ''), (6, ', preset 6')):
            m[f'lift {height} m, {speed:g} m/s{name}'] = drive(
                speed, height / speed - ramp_s, ramp_s, (0, 0, 1), preset=preset)
    for deg in (0.1, 0.3, 0.6, 1.15, 1.9, 2.5):
        m[f'turn {deg:g} deg/s, 60 s'] = turn(np.radians(deg), 60)
    for begin_s in (0.5, 1.2, 3.0):
        m[f'turn 5 deg/s from {begin_s:g} s on'] = turn(np.radians(5), 60, begin_s=begin_s)
    m['spin 17 deg/s, 60 s'] = turn(np.radians(17), 60, ramp_s=2.0)
    for radius, rate in ((0.5, 0.3), (2, 0.5), (2, 0.02), (5, 0.2)):
        m[f'circle {radius:g} m, {rate:g} rad/s'] = turn(rate, 60, radius, ramp_s=2.0)
    for length, amplitude, hz in ((0.3, 60, 0.5), (1.0, 60, 0.5), (1.0, 20, 0.1)):
        m[f'arm {length:g} m, ±{amplitude} deg, {hz:g} Hz'] = arm(length, amplitude, hz)
    m['on foot, 40 strides of 1.3 m, preset 5'] = on_foot(40, 1.3, 0.6, 0.5)
    m['on foot, 60 strides of 0.8 m, preset 5'] = on_foot(60, 0.8, 0.5, 0.25)
    for rope_m, speed in ((5, 0.5), (12, 0.3), (30, 1.0)):
        m[f'crane, rope {rope_m} m'] = crane(rope_m, speed, 20, 30)
    m['straight 1 m/s, 30 s, braked in 3 s'] = drive(1.0, 30, 3.0)
    for rope_m, told_m in ((5, 5), (5, 4), (12, 12)):
        m[f'crane, rope {rope_m} m, preset 7 with {told_m} m'] = crane(rope_m, 0.5, 20, 30, told_m)
    for amplitude, hz in ((2, 17), (5, 33), (10, 47), (10, 80), (5, 10)):
        m[f'shaken {amplitude} m/s², {hz} Hz, from the start'] = still(
            -FADE_S, partial(shake, amplitude_m_s2=amplitude, hz=hz))
    for amplitude, hz in ((2, 17), (5, 10)):
        m[f'shaken {amplitude} m/s², {hz} Hz, after a rest'] = still(
            REST_S, partial(shake, amplitude_m_s2=amplitude, hz=hz))
    for name in ('road 1 m/s², 1 m/s, 60 s', 'turn 5 deg/s from 3 s on', 'circle 2 m, 0.5 rad/s',
                 'arm 1 m, ±60 deg, 0.5 Hz', 'crane, rope 5 m', 'straight 1 m/s, 10 s', 'straight 1 m/s, 60 s',
                 'lift 12 m, 2 m/s', 'conveyor 0.3 m/s, 30 s'):
        m[name + ', gaps'] = replace(m[name], gaps=True)
    delivered = {'uncalibrated_rad_s': np.radians(5), 'gyro_scale': 0.02}
    for name in ('turn 5 deg/s from 3 s on', 'circle 2 m, 0.5 rad/s', 'arm 0.3 m, ±60 deg, 0.5 Hz',
                 'arm 1 m, ±60 deg, 0.5 Hz'):
        m[name + ', uncalibrated'] = replace(m[name], chip=dict(delivered), uncalibrated='gyro')
    delivered |= {'accel_scale': 0.02, 'accel_bias_m_s2': 0.3}
    for name in ('lift 12 m, 2 m/s, preset 6', 'lift 40 m, 2.5 m/s', 'lift 40 m, 2.5 m/s, preset 6'):
        m[name + ', uncalibrated'] = replace(m[name], chip=delivered, uncalibrated='gyro accelerometer')
    noisy = {'accel_density_m_s2': 600e-6 * GRAVITY_M_S2, 'gyro_density_rad_s': np.radians(0.045)}
    for name in ('straight 0.05 m/s, 60 s', 'straight 0.2 m/s, 10 s', 'straight 1 m/s, 60 s',
                 'lift 12 m, 2 m/s, preset 6'):
        m[name + ', noisier than told'] = replace(m[name], chip=noisy)
    for name in ('straight 0.2 m/s, 60 s', 'road 1 m/s², 1 m/s, 60 s', 'lift 12 m, 2 m/s, preset 6',
                 'lift 40 m, 2.5 m/s, preset 6', 'circle 2 m, 0.02 rad/s', 'arm 1 m, ±20 deg, 0.1 Hz'):
        m[name + ', steps of 8 mg'] = replace(m[name], chip={'accel_step_m_s2': 8e-3 * GRAVITY_M_S2})
    for name in ('straight 0.5 m/s, 10 s', 'straight 1 m/s, 60 s', 'lift 40 m, 2.5 m/s, preset 6',
                 'turn 1.15 deg/s, 60 s', 'crane, rope 5 m, preset 7 with 5 m',
                 'on foot, 40 strides of 1.3 m, preset 5'):
        m[name + ', warming'] = replace(m[name], chip={'warms_K': 10})
    for deg in (2, 5, 10, 20):
        m[f'lying, gyro bias {deg} deg/s'] = still(uncalibrated_rad_s=np.radians(deg))
    return m


@dataclass
class Recording:
    """What the sensor reported, and the truth at the same times."""
    t: np.ndarray
    gyro_b: np.ndarray
    accel_b: np.ndarray
    mag_b: np.ndarray
    position_n: np.ndarray
    velocity_n: np.ndarray
    attitude: Rotation  # b -> n
    moving: np.ndarray
    temperature_degC: np.ndarray
    delay_s: float  # of position and velocity as a sensor with this low-pass can know them


def direction(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def without_gaps(t, rng, begin_s, gaps_s=(0.08, 0.32)):
    """True for the samples that are left."""
    there, gap_s = np.ones(len(t), bool), begin_s
    while gap_s < t[-1] - 1:
        end_s = gap_s + rng.uniform(*gaps_s)
        there &= (t < gap_s) | (t >= end_s)
        gap_s = end_s + rng.uniform(0.5, 3)
    return there


def record(name, motion, seed):
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    chip = Chip(**motion.chip)
    t = np.arange(0, motion.end_s + REST_S, STEP_S)
    path = motion.path(t)
    if motion.vibration:
        vibration = motion.vibration(t, rng, motion.begin_s, motion.end_s)
        path.position, path.accel = path.position + vibration.position, path.accel + vibration.accel

    roll, pitch = rng.normal(0, MOUNTING_RAD, 2)
    mounting = Rotation.from_euler('xyz', [roll, pitch, 0])
    machine = Rotation.from_euler('z', rng.uniform(-np.pi, np.pi))
    angle, rate = (np.broadcast_to(x, t.shape) for x in (path.angle, path.rate))
    attitude = machine * Rotation.from_rotvec(np.outer(angle, path.axis)) * mounting
    force = attitude.inv().apply(machine.apply(path.accel) + [0, 0, GRAVITY_M_S2])
    gyro = np.outer(rate, mounting.inv().apply(path.axis))

    low_pass = butter(2, chip.cut_off_hz, fs=1 / STEP_S, output='sos')
    every = int(round(1 / (RATE_HZ * STEP_S)))
    force, gyro = (sosfilt(low_pass, x - x[0], axis=0)[::every] + x[0] for x in (force, gyro))
    position = machine.apply(path.position - path.position[0])
    velocity = np.gradient(position, STEP_S, axis=0)[::every]
    position, attitude, t = position[::every], attitude[::every], t[::every]

    def white(density):
        return rng.normal(0, density * np.sqrt(RATE_HZ / 2), force.shape)

    def quantised(x, step_):
        return np.round(x / step_) * step_
    accel = force * (1 + rng.normal(0, chip.accel_scale, 3)) + rng.normal(0, chip.accel_bias_m_s2, 3)
    accel += white(chip.accel_density_m_s2)
    gyro = gyro * (1 + rng.normal(0, chip.gyro_scale, 3)) + rng.normal(0, chip.gyro_bias_rad_s, 3)
    gyro += chip.uncalibrated_rad_s * direction(rng) + white(chip.gyro_density_rad_s)
    gyro += np.cumsum(rng.normal(0, chip.gyro_walk_rad_s / np.sqrt(RATE_HZ), gyro.shape), axis=0)
    warmer_K = chip.warms_K * (1 - np.exp(-t / WARMING_S))
    temperature = quantised(25 + warmer_K, 0.1)
    if chip.warms_K:
        accel += np.outer(warmer_K, rng.normal(0, chip.accel_bias_m_s2_K, 3))
        gyro += np.outer(warmer_K, rng.normal(0, chip.gyro_bias_rad_s_K, 3))
    mag = attitude.inv().apply(FIELD_N_UT) + rng.normal(0, chip.mag_uT, force.shape)
    there = without_gaps(t, rng, motion.begin_s) if motion.gaps else slice(None)
    moving = (t >= motion.begin_s) & (t <= motion.end_s)
    gyro, accel = quantised(gyro, chip.gyro_step_rad_s), quantised(accel, chip.accel_step_m_s2)
    return Recording(*(x[there] for x in (t, gyro, accel, mag, position, velocity, attitude, moving,
                                           temperature)), chip.delay_s())
