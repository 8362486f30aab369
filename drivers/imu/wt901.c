/* WitMotion WT901C-485: Modbus RTU, one read of all measurements per cycle. Registers and scales: WitMotion's protocol
 * description ("WIT Standard Modbus") and its SDK for this sensor
 * (github.com/WITMOTION/WitStandardModbus_WT901C485). */
#include <errno.h>
#include <math.h>
#include <modbus/modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "drivers/imu/frozen.h"
#include "drivers/imu/imu_thread.h"
#include "drivers/imu/source.h"
#include "model/math/units.h"

enum {
	REG_BANDWIDTH = 0x1F,
	REG_DATA = 0x34, /* acceleration, rate, field, angles (3 each), temperature */
	DATA_WORDS = 13,
	MEASURED_WORDS = 9, /* of these, measured (the angles are computed by the sensor) */
	TEMPERATURE_WORD = 12,
	REG_UNLOCK = 0x69,
	UNLOCK_KEY = 0xB588, /* unlocks the configuration for 10 s */
	REG_MAG_TYPE = 0x72,

	/* of one cycle, 8N1 */
	REQUEST_CHARS = 8,
	ANSWER_CHARS = 5 + 2 * DATA_WORDS,
	BITS_PER_CHAR = 10,

	FAILURES = 2, /* consecutive ones: the sensor does not answer */
	OPEN_TRIES = 3,
};

#define ACCEL_RANGE_G	 16.0
#define GYRO_RANGE_DEG_S 2000.0
#define FULL_SCALE	 32768.0

#define NS_PER_MS	    1000000.0
#define TURNAROUND_NS	    (3 * NS_PER_MS)    /* response delay, factory setting of register 74h */
#define SHORTEST_SILENCE_NS (1.75 * NS_PER_MS) /* Modbus RTU: 3.5 characters, above 19200 Bd this */
#define PATIENCE_NS	    (40 * NS_PER_MS)   /* added to the timeouts: twice the latency of a USB adapter */
#define UNLOCKED_NS	    (20 * NS_PER_MS)   /* SDK: pause after a write to the configuration */

static const int BAUDS[] = {4800, 9600, 19200, 38400, 57600, 115200, 230400};
/* register 1Fh: code and low-pass, Hz */
static const int BANDWIDTHS_HZ[] = {256, 188, 98, 42, 20, 10, 5};
/* uT per digit by the type of the magnetometer (register 72h), from the SDK; type 3 where the type is not known */
static const double MAG_STEP_UT[] = {[2] = 0.15, [3] = 0.013, [4] = 0.058, [5] = 0.098, [6] = 1.0 / 120, [7] = 0.02};
enum { MAG_TYPES = sizeof MAG_STEP_UT / sizeof *MAG_STEP_UT, MAG_TYPE_USUAL = 3 };

struct wt901 {
	struct imu_thread thread;
	char path[128];
	int baud, address;
	double char_ns, silence_ns;

	/* set by the port, read by the thread */
	_Atomic int64_t period_ns;
	atomic_uint bandwidth; /* code */
	atomic_bool configure;

	/* used by the thread only */
	modbus_t *modbus; /* NULL: not connected */
	double mag_step_uT;
	unsigned failures;
	struct frozen frozen;
};

/* ---- the line ---------------------------------------------------------------------------------------------------- */

static void disconnect(struct wt901 *w)
{
	if (!w->modbus)
		return;
	modbus_close(w->modbus);
	modbus_free(w->modbus);
	w->modbus = NULL;
}

static int connect_line(struct wt901 *w)
{
	int result;

	w->modbus = modbus_new_rtu(w->path, w->baud, 'N', 8, 1);
	if (!w->modbus)
		return -errno;
	modbus_set_slave(w->modbus, w->address);
	modbus_set_response_timeout(
		w->modbus, 0, (uint32_t)((REQUEST_CHARS * w->char_ns + TURNAROUND_NS + PATIENCE_NS) / 1e3));
	modbus_set_byte_timeout(w->modbus, 0, (uint32_t)((w->silence_ns + PATIENCE_NS) / 1e3));
	if (modbus_connect(w->modbus) == 0)
		return 0;
	result = -errno;
	modbus_free(w->modbus);
	w->modbus = NULL;
	return result;
}

/* Whether libmodbus reports a missing or bad answer; other errors are those of the serial device. */
static bool is_answer_error(int error)
{
	return error == ETIMEDOUT || error > MODBUS_ENOBASE;
}

static bool is_exception(int error)
{
	return error >= EMBXILFUN && error <= EMBXGTAR;
}

static void pause_ns(struct wt901 *w, double ns)
{
	imu_thread_sleep(&w->thread, imu_thread_now_ns() + (int64_t)ns);
}

static int read_registers(struct wt901 *w, int at, int n, uint16_t *words)
{
	int error;

	if (modbus_read_registers(w->modbus, at, n, words) == n)
		return 0;
	error = errno;
	w->thread.health.bus_errors++;
	if (is_answer_error(error)) { /* discard the rest of this answer */
		pause_ns(w, w->silence_ns);
		modbus_flush(w->modbus);
	}
	return -error;
}

/* Not saved: it is written at each start, which spares the sensor's flash. A sensor that rejects it keeps its
 * setting. */
static void write_bandwidth(struct wt901 *w)
{
	pause_ns(w, w->silence_ns);
	if (modbus_write_register(w->modbus, REG_UNLOCK, UNLOCK_KEY) != 1)
		w->thread.health.bus_errors++;
	pause_ns(w, UNLOCKED_NS);
	if (modbus_write_register(w->modbus, REG_BANDWIDTH, (uint16_t)atomic_load(&w->bandwidth)) != 1)
		w->thread.health.bus_errors++;
	pause_ns(w, UNLOCKED_NS);
	modbus_flush(w->modbus);
}

static int start(struct wt901 *w)
{
	uint16_t type = MAG_TYPE_USUAL;
	int result = connect_line(w);

	if (result < 0)
		return result;
	modbus_flush(w->modbus);
	result = read_registers(w, REG_MAG_TYPE, 1, &type);
	if (result < 0 && !is_exception(-result)) { /* an exception is an answer: this firmware lacks the register */
		disconnect(w);
		return result;
	}
	w->mag_step_uT = MAG_STEP_UT[type < MAG_TYPES && MAG_STEP_UT[type] > 0 ? type : MAG_TYPE_USUAL];
	write_bandwidth(w);
	w->failures = 0;
	return 0;
}

/* ---- samples ----------------------------------------------------------------------------------------------------- */

static struct vec3 triad(const uint16_t *words, double step)
{
	return (struct vec3){step * (int16_t)words[0], step * (int16_t)words[1], step * (int16_t)words[2]};
}

static bool saturated(const uint16_t *words)
{
	for (int i = 0; i < 6; i++)
		if ((int16_t)words[i] == INT16_MAX || (int16_t)words[i] == INT16_MIN)
			return true;
	return false;
}

/* The measurements were taken between the end of the request and the start of the answer: their middle. */
static double measured_ns(const struct wt901 *w, int64_t asked_ns, int64_t answered_ns)
{
	double asked = (double)asked_ns, answered = (double)answered_ns;
	double middle = (asked + REQUEST_CHARS * w->char_ns + answered - ANSWER_CHARS * w->char_ns) / 2;

	return fmin(answered, fmax(asked, middle));
}

static void deliver(struct wt901 *w, const uint16_t *words, double t_ns)
{
	struct imu_sample sample = {
		.t_us = (uint64_t)(t_ns / 1e3),
		.accel_m_s2 = triad(words, ACCEL_RANGE_G * STANDARD_GRAVITY_M_S2 / FULL_SCALE),
		.gyro_rad_s = triad(words + 3, GYRO_RANGE_DEG_S * RAD_PER_DEG / FULL_SCALE),
		.mag_uT = triad(words + 6, w->mag_step_uT),
		.temperature_degC = 0.01 * (int16_t)words[TEMPERATURE_WORD],
		.flags = SAMPLE_MAG | SAMPLE_TEMPERATURE | (saturated(words) ? SAMPLE_SATURATED : 0),
	};

	imu_thread_recovered(&w->thread);
	imu_thread_rate(&w->thread, &sample);
	imu_thread_send(&w->thread, &sample);
}

static int read_sample(struct wt901 *w)
{
	uint16_t words[DATA_WORDS];
	double measured[MEASURED_WORDS];
	int64_t asked_ns = imu_thread_now_ns(), answered_ns;
	int result = read_registers(w, REG_DATA, DATA_WORDS, words);

	if (result < 0)
		return result;
	answered_ns = imu_thread_now_ns();
	w->failures = 0;
	for (int i = 0; i < MEASURED_WORDS; i++)
		measured[i] = (int16_t)words[i];
	if (frozen_watch(&w->frozen, measured, MEASURED_WORDS)) {
		w->thread.health.fault = IMU_FAULT_FROZEN;
		w->thread.health.fault_chip = IMU_CHIP_GYRO;
		imu_thread_report(&w->thread);
		return 0;
	}
	deliver(w, words, measured_ns(w, asked_ns, answered_ns));
	return 0;
}

/* ---- the thread -------------------------------------------------------------------------------------------------- */

static void fail(struct wt901 *w)
{
	disconnect(w);
	imu_thread_failed(&w->thread, IMU_FAULT_SILENT, IMU_CHIP_GYRO);
}

static void run(struct imu_thread *t)
{
	struct wt901 *w = (struct wt901 *)t;
	int64_t next_ns = imu_thread_now_ns(), quiet_ns;

	while (!imu_thread_stopping(t)) {
		if (!w->modbus && start(w) < 0) {
			fail(w);
			continue;
		}
		if (atomic_exchange(&w->configure, false))
			write_bandwidth(w);
		int result = read_sample(w);
		if (result < 0 && (!is_answer_error(-result) || ++w->failures >= FAILURES)) {
			fail(w);
			continue;
		}
		quiet_ns = imu_thread_now_ns() + (int64_t)w->silence_ns;
		next_ns += atomic_load(&w->period_ns);
		if (next_ns < quiet_ns)
			next_ns = quiet_ns;
		imu_thread_sleep(t, next_ns);
	}
	disconnect(w);
}

/* ---- the port ---------------------------------------------------------------------------------------------------- */

static double highest_rate_hz(const struct wt901 *w)
{
	return 1e9 / ((REQUEST_CHARS + ANSWER_CHARS) * w->char_ns + 2 * w->silence_ns + TURNAROUND_NS);
}

static unsigned bandwidth_code(double at_least_hz)
{
	unsigned code = sizeof BANDWIDTHS_HZ / sizeof *BANDWIDTHS_HZ - 1;

	while (code > 0 && BANDWIDTHS_HZ[code] < at_least_hz)
		code--;
	return code;
}

static int port_configure(
	struct imu_port *port, const struct imu_settings *settings, int dry, char *error, size_t error_size)
{
	struct wt901 *w = (struct wt901 *)port;
	double rate_hz = fmin(settings->rate_hz, highest_rate_hz(w));

	if (settings->gyro_range_deg_s > GYRO_RANGE_DEG_S || settings->accel_range_g > ACCEL_RANGE_G) {
		snprintf(error, error_size, "wt901: range too wide: the sensor has %.0f deg/s and %.0f g",
			GYRO_RANGE_DEG_S, ACCEL_RANGE_G);
		return -EINVAL;
	}
	if (dry)
		return 0;
	source_use_rate(port, rate_hz);
	atomic_store(&w->period_ns, (int64_t)(1e9 / rate_hz));
	atomic_store(&w->bandwidth, bandwidth_code(settings->bandwidth_hz > 0 ? settings->bandwidth_hz : rate_hz / 2));
	atomic_store(&w->configure, true);
	return 0;
}

static void port_close(struct imu_port *port)
{
	struct wt901 *w = (struct wt901 *)port;

	imu_thread_stop(&w->thread);
	imu_thread_release(&w->thread);
	free(w);
}

static const struct imu_ops OPS = {.read = imu_thread_read, .close = port_close, .configure = port_configure};

/* ---- wt901:/dev/ttyX --------------------------------------------------------------------------------------------- */

static bool is_baud_rate(int baud)
{
	for (size_t i = 0; i < sizeof BAUDS / sizeof *BAUDS; i++)
		if (baud == BAUDS[i])
			return true;
	return false;
}

static int parse(struct wt901 *w, char *args, char *error, size_t error_size)
{
	char *rest = args, *path = strsep(&rest, ","), *option, *end;

	if (!path || *path == '\0' || strlen(path) >= sizeof w->path) {
		snprintf(error, error_size, "wt901: no serial port: use " WT901_SYNTAX);
		return -EINVAL;
	}
	strcpy(w->path, path);
	w->baud = 9600;
	w->address = 0x50;
	while ((option = strsep(&rest, ","))) {
		char *value = strchr(option, '=');
		long number = value ? strtol(value + 1, &end, 0) : -1;
		bool whole = value && value[1] != '\0' && *end == '\0';

		if (whole && strncmp(option, "baud=", 5) == 0 && number <= 230400 && is_baud_rate((int)number)) {
			w->baud = (int)number;
		} else if (whole && strncmp(option, "address=", 8) == 0 && number >= 1 && number <= 247) {
			w->address = (int)number;
		} else {
			snprintf(error, error_size,
				"wt901: unknown option or bad value '%.40s': use baud=4800, 9600, ... 230400 or "
				"address=1 "
				"to 247",
				option);
			return -EINVAL;
		}
	}
	return 0;
}

static int begin(struct wt901 *w, const struct imu_settings *settings, char *error, size_t error_size)
{
	int result = imu_thread_init(&w->thread);

	if (result == 0)
		result = port_configure(&w->thread.port, settings, 0, error, error_size);
	if (result < 0)
		return result;
	atomic_store(&w->configure, false); /* start() writes it */
	for (int i = 0; i < OPEN_TRIES; i++) {
		result = start(w);
		if (result == 0 || !is_answer_error(-result))
			break;
	}
	if (result < 0 && is_answer_error(-result))
		snprintf(error, error_size,
			"%s: no answer from address %02Xh at %d Bd: check the wires A and B and power, or set baud= "
			"and "
			"address=",
			w->path, (unsigned)w->address, w->baud);
	else if (result < 0)
		snprintf(error, error_size,
			"%s: %s: check that it is the right port and that this user is in its group (dialout)", w->path,
			strerror(-result));
	if (result < 0)
		return result;
	result = imu_thread_start(&w->thread, "imu9-wt901", settings->realtime, run);
	if (result < 0)
		snprintf(error, error_size, "cannot start the sensor's thread: %s", strerror(-result));
	return result;
}

int wt901_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size)
{
	struct wt901 *w = calloc(1, sizeof *w);
	int result;

	if (!w)
		return -ENOMEM;
	w->thread.port.fd = -1;
	result = parse(w, args, error, error_size);
	if (result < 0) {
		free(w);
		return result;
	}
	w->char_ns = 1e9 * BITS_PER_CHAR / w->baud;
	w->silence_ns = fmax(SHORTEST_SILENCE_NS, 3.5 * w->char_ns);
	w->thread.port.ops = &OPS;
	w->frozen.noisy = true; /* its accelerometer has digits of 0.5 mg, below its noise */
	w->thread.port.uncalibrated = IMU_UNCALIBRATED_MAG; /* the module calibrates the others itself */
	snprintf(w->thread.port.name, sizeof w->thread.port.name, "wt901:%.40s %d Bd", w->path, w->baud);
	result = begin(w, settings, error, error_size);
	if (result < 0) {
		disconnect(w);
		imu_thread_release(&w->thread);
		free(w);
		return result;
	}
	*port = &w->thread.port;
	return 0;
}
