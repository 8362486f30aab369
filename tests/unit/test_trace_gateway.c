/* What the parts of the gateway that need no device make of tables of inputs, compared with what they made of them when
 * the trace was written (trace.h): keys of the configuration with their limits and messages, option texts, blink codes,
 * histograms, the log's selection of lines, signs of life, names of files, thresholds, rows of a recording, the bytes
 * of the store. What is right is for the other tests to say. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "drivers/ports/imu.h"
#include "drivers/ports/sources.h"
#include "gateway/angle_filter.h"
#include "gateway/canopen/emcy_codes.h"
#include "gateway/config.h"
#include "gateway/event_log.h"
#include "gateway/histogram.h"
#include "gateway/led.h"
#include "gateway/log.h"
#include "gateway/record_file.h"
#include "gateway/record_text.h"
#include "gateway/sensor_watch.h"
#include "gateway/service.h"
#include "gateway/settings.h"
#include "gateway/store.h"
#include "gateway/store_name.h"
#include "gateway/threshold.h"
#include "gateway/window.h"
#include "od_values.h"
#include "tests/unit/trace.h"

enum { TEXT_MAX = 200 };

/* A value without 0, which a trace leaves out, so that each input has its line. */
static void show(const char *name, long long value)
{
	char text[32];

	snprintf(text, sizeof(text), "%lld", value);
	trace_text(name, text);
}

static void show_text(const char *name, const char *text)
{
	char cut[TEXT_MAX + 1];

	snprintf(cut, sizeof(cut), "'%.150s'%s", text, strlen(text) > 150 ? "..." : "");
	for (char *p = cut; *p; p++)
		if (*p == '\n')
			*p = '|';
	trace_text(name, cut);
}

static char *repeat(char c, size_t n)
{
	static char text[2048];

	assert_true(n < sizeof(text));
	memset(text, c, n);
	text[n] = '\0';
	return text;
}

/* Replaces gateway/log.c. */
void log_at(int severity, const char *format, ...)
{
	char text[500], name[20];
	va_list args;

	va_start(args, format);
	vsnprintf(text, sizeof(text), format, args);
	va_end(args);
	snprintf(name, sizeof(name), "severity %d", severity);
	show_text(name, text);
}

/* ---- configuration ----------------------------------------------------------------------------------------------- */

static struct config config;

static void show_keys(void)
{
	show_text("imu", config.imu);
	show_text("can", config.can);
	show_text("store", config.store);
	show_text("record", config.record);
	show_text("LEDs", config.run_led);
	show_text("LEDs", config.error_led);
	show_text("cia309", config.cia309);
	show_text("modbus", config.modbus);
	show("node_id", config.node_id);
	show("bitrate", config.bitrate);
	show("realtime", config.realtime);
	show("serial", config.serial);
	show("vendor_id", config.vendor_id);
	show("log_level", config.log_level);
	show("objects", (long long)config.object_count);
}

static void test_keys(void **state)
{
	static const char *const keys[] = {"imu", "can", "node_id", "bitrate", "store", "record", "realtime", "serial",
		"vendor_id", "run_led", "error_led", "log_level", "cia309", "modbus", "nodeid", ""};
	static const char *const values[] = {"", "x", "5x", "-1", " 7", "0", "1", "99", "100", "127", "128", "254",
		"255", "256", "9999", "10000", "1000000", "1000001", "4294967295", "4294967296", "99999999999999999999",
		"0x10", "010", "error", "warning", "info", "debug", "notice"};
	char error[CONFIG_ERROR_MAX];

	(void)state;
	for (size_t k = 0; k < sizeof(keys) / sizeof(keys[0]); k++) {
		trace_block(keys[k][0] ? keys[k] : "no key");
		for (size_t v = 0; v < sizeof(values) / sizeof(values[0]) + 2; v++) {
			size_t beyond = v - sizeof(values) / sizeof(values[0]), from = 0;
			const char *value =
				v < sizeof(values) / sizeof(values[0]) ? values[v] : repeat('a', 255 + beyond);
			struct config before;
			const char *changed;

			config_init(&config, &imu9_od_table);
			before = config;
			int rc = config_option(&config, keys[k], value, error);

			show(value[0] ? strlen(value) > 200 ? "long" : value : "empty", rc);
			if (rc < 0)
				show_text("error", error);
			if (rc == -ENOENT)
				break; /* there is no such key, whatever the value */
			while ((changed = config_changed(&before, &config, &from)) != NULL)
				show_text("changed", changed);
			if (config.object_count)
				show("objects", (long long)config.object_count);
		}
		config_init(&config, &imu9_od_table);
		(void)config_option(&config, keys[k], "11111", error);
		(void)config_option(&config, keys[k], "99", error);
		show_keys();
	}
	trace_block("lists");
	for (size_t length = 1; length < 600; length += 255) { /* the last one fits, or one character less */
		int rc = 0, n = 0;

		config_init(&config, &imu9_od_table);
		for (; rc == 0; n++)
			rc = config_option(&config, "modbus", repeat('m', length < 255 ? length : 254), error);
		show("times", n);
		show("length", (long long)strlen(config.modbus));
		show("result", rc);
		show_text("error", error);
		size_t room = CONFIG_LIST_MAX - 1 - strlen(config.modbus);
		if (room > 2 && room < 255) {
			show("full", config_option(&config, "modbus", repeat('n', room), error));
			show("full", config_option(&config, "modbus", repeat('n', room - 1), error));
			show("length", (long long)strlen(config.modbus));
		}
	}
	trace_check();
}

static void test_assignments(void **state)
{
	static const char *const assignments[] = {"", "=", "=1", "lever_arm.l", "lever_arm.l=", "lever_arm.l=0.05",
		"lever_arm.l = 0.05", "Lever arm l=1", "0x2000:1=2", "2000h:2=-3", "lever_arm.q=1", "lever_arm.l=11",
		"lever_arm.l=-10.1", "lever_arm.l=ten", "lever_arm.l=nan", "lever_arm_model=rigid_body",
		"lever_arm_model=4", "lever_arm_model=256", "acceleration.l=1", "device_type=1", "position.reset=1",
		"position_output.x=5", "event_log=1", "tpdo1_mapping.object_1=0x21000110", "node_id=5",
		"slope_long16_offset=7", "angle_resolution=1001", "angle_resolution=0", "cob_id_sync=0x40000080"};
	char error[CONFIG_ERROR_MAX], text[400];
	uint8_t wire[OD_VALUE_MAX];
	struct od_values values;
	struct od od;

	(void)state;
	trace_block("assignments");
	for (size_t i = 0; i < sizeof(assignments) / sizeof(assignments[0]); i++) {
		config_init(&config, &imu9_od_table);
		od_init(&od, &imu9_od_table, &values, 7);
		error[0] = '\0';
		show(assignments[i][0] ? assignments[i] : "nothing", config_set(&config, assignments[i], error));
		show_text("error", error);
		config_apply(&config, &od);
		for (size_t k = 0; k < config.object_count; k++) {
			const struct od_entry *e =
				od_find(&imu9_od_table, config.objects[k].index, config.objects[k].sub, NULL);

			od_format(e, wire, od_get(&od, e, wire, sizeof(wire)), text, sizeof(text));
			show_text(e->name, text);
		}
	}
	for (size_t length = 254; length < 258; length++) {
		snprintf(text, sizeof(text), "%.300s=1", repeat('k', length));
		show("a long name", config_set(&config, text, error));
		show_text("error", error);
	}
	trace_check();
}

static void test_files(void **state)
{
	static const char *const files[] = {"", "\n\n# nothing\n; nothing\n", "[gateway]\nnode_id = 5 ; the robot\n",
		"[GATEWAY]\nnode_id=6\n[gateway]\ncan = can3\n", "[gateway]\nnode_id = 0\ncan = can4\n",
		"[gateway]\nlever_arm.l = 1\n", "node_id = 5\n", "[lever_arm]\nl = 1\ns = 2\n[position]\nmode = 1\n",
		"[lever_arm]\nl = 1\n[lever_arm\ns = 2\n", "lever_arm.l = 1\nwhat\nlever_arm.s = 2\n",
		"lever_arm.l = 1\n\nlever_arm.s = x\nlever_arm.t = y\n", "[gateway]\nmodbus=tcp:a\nmodbus=tcp:b\n",
		"lever_arm.l = 1", "[gateway]\nwrong = 1\nworse = 2\n", "lever_arm.l : 1\n"};
	char folder[] = "/tmp/imu9-gateway-XXXXXX", path[64], error[CONFIG_ERROR_MAX];

	(void)state;
	assert_non_null(mkdtemp(folder));
	snprintf(path, sizeof(path), "%s/file", folder);
	for (size_t i = 0; i < sizeof(files) / sizeof(files[0]); i++) {
		const char *text = files[i];
		FILE *f = fopen(path, "w");

		assert_non_null(f);
		fputs(text, f);
		fclose(f);
		config_init(&config, &imu9_od_table);
		error[0] = '\0';
		char header[40];
		snprintf(header, sizeof(header), "file %zu", i);
		trace_block(header);
		show_text("text", text);
		int rc = config_file(&config, path, error);

		show("result", rc);
		show_text("error", strncmp(error, folder, strlen(folder)) == 0 ? error + strlen(folder) : error);
		show("node_id", config.node_id);
		show_text("can", config.can);
		show_text("modbus", config.modbus);
		if (rc == 0)
			show("objects", (long long)config.object_count);
	}
	trace_block("no file");
	unlink(path);
	show("result", config_file(&config, path, error));
	show_text("error", error + strlen(folder));
	show("a folder", config_file(&config, folder, error));
	show_text("error", error + strlen(folder));
	rmdir(folder);
	trace_check();
}

static void test_options(void **state)
{
	static const char *const records[] = {"", ",", "a", "a,", "a,size=1", "a,size=0", "a,size=2000", "a,size=2001",
		"a,files=2", "a,files=1", "a,files=1000", "a,files=1001", "a,files=3,size=4", "a,size=4,size=5",
		"a,size=", "a,size=4x", "a,size= 4", "a,size=-4", "a,files=+3", "a,x=3",
		"/var/lib/imu9/records,files=99"};
	static const char *const windows[] = {"", "tcp:", "tcp:127.0.0.1", "tcp:127.0.0.1:1502,allow=10.0.0.0/8",
		"tcp:127.0.0.1:1502,write=10.0.0.1", "rtu:/dev/ttyUSB0", "rtu:/dev/ttyUSB0,baud=1,parity=x", "udp:1",
		"tcp:127.0.0.1\nrtu:/dev/ttyUSB0\n", "\n", "tcp:127.0.0.1\nxyz", "tcp:a\ntcp:b\ntcp:c\ntcp:d\n",
		"tcp:a\ntcp:b\ntcp:c\ntcp:d\ntcp:e\ntcp:f\ntcp:g\ntcp:h\ntcp:i\n"};
	static const char *const sensors[] = {"", "x", "sim", "sim:", "sim:square", "sim:nowhere",
		"sim:square,board=v5", "sim:square,board=v9", "sim:square,rate=50", "sim:square,rate=0",
		"sim:square,rate=x", "sim:square,uncalibrated", "sim:,board=lsm9ds1", "sim:square,other", "replay",
		"replay:", "replay:a", "replay:a,loop", "replay:a,speed=2", "replay:a,speed=0", "replay:a,speed=-1",
		"replay:a,speed=nan", "replay:a,speed=2,loop", "replay:a,fast", "i2c", "i2c:", "i2c:/dev/i2c-1",
		"i2c:/dev/i2c-1,drdy=/dev/gpiochip0:4", "i2c:/dev/i2c-1,drdy=/dev/gpiochip0",
		"i2c:/dev/i2c-1,drdy=/dev/gpiochip0:x", "i2c:/dev/i2c-1,drdy=:4", "i2c:/dev/i2c-1,config=/a",
		"i2c:/dev/i2c-1,mode=3", "spi:/dev/spidev0.0", "spi:/dev/spidev0.0,/dev/spidev0.1",
		"spi:/dev/spidev0.0,mode=0", "spi:/dev/spidev0.0,mode=3", "spi:/dev/spidev0.0,mode=4",
		"spi:/dev/spidev0.0,speed=1000000", "spi:/dev/spidev0.0,speed=0", "spi:/dev/spidev0.0,speed=x",
		"spi:", "spi:a,b,c", "iio", "iio:", "iio:a,b", "iio:a,mount=ignore", "iio:a,mount=x", "wt901",
		"wt901:", "wt901:/dev/x", "wt901:/dev/x,baud=4800", "wt901:/dev/x,baud=9600", "wt901:/dev/x,baud=19200",
		"wt901:/dev/x,baud=38400", "wt901:/dev/x,baud=57600", "wt901:/dev/x,baud=115200",
		"wt901:/dev/x,baud=230400", "wt901:/dev/x,baud=12480", "wt901:/dev/x,baud=460800",
		"wt901:/dev/x,address=0x50", "wt901:/dev/x,address=0", "wt901:/dev/x,address=1",
		"wt901:/dev/x,address=127", "wt901:/dev/x,address=128", "wt901:/dev/x,address=247",
		"wt901:/dev/x,address=248", "wt901:/dev/x,address=x", "wt901:/dev/x,other"};
	char why[600], *syntax = NULL;
	size_t size;
	FILE *f = open_memstream(&syntax, &size);
	struct record_options o;

	(void)state;
	trace_block("recordings");
	for (size_t i = 0; i < sizeof(records) / sizeof(records[0]) + 2; i++) {
		size_t beyond = i - sizeof(records) / sizeof(records[0]);
		const char *text = i < sizeof(records) / sizeof(records[0]) ? records[i] : repeat('d', 255 + beyond);

		why[0] = '\0';
		show_text("text", text);
		show("result", record_options(text, &o, why, sizeof(why)));
		show_text("error", why);
		show_text("folder", o.folder);
		show("size", o.size_mb);
		show("files", o.files);
	}
	trace_block("windows");
	for (size_t i = 0; i < sizeof(windows) / sizeof(windows[0]); i++) {
		why[0] = '\0';
		show_text("text", windows[i]);
		show("result", window_check(windows[i], why, sizeof(why)));
		show_text("error", why);
	}
	trace_block("sensors");
	for (size_t i = 0; i < sizeof(sensors) / sizeof(sensors[0]); i++) {
		int rc = imu_open(sensors[i], NULL, NULL, why, sizeof(why));

		show_text("text", sensors[i]);
		show("result", rc);
		if (rc < 0)
			show_text("error", why);
	}
	trace_block("sensors that are not there");
	static const char *const absent[] = {"i2c:/no/such", "spi:/no/such", "wt901:/no/such", "replay:/no/such"};
	for (size_t i = 0; i < sizeof(absent) / sizeof(absent[0]); i++) {
		struct imu_port *port = NULL;

		show("result", imu_open(absent[i], NULL, &port, why, sizeof(why)));
		show_text("error", why);
		assert_null(port);
	}
	trace_block("syntax");
	imu_print_sources(f);
	window_print_syntax(f);
	fclose(f);
	for (char *line = strtok(syntax, "\n"); line; line = strtok(NULL, "\n"))
		show_text("syntax", line);
	free(syntax);
	trace_check();
}

/* ---- tables ------------------------------------------------------------------------------------------------------ */

static void test_leds(void **state)
{
	(void)state;
	for (int led = LED_OFF; led <= LED_QUADRUPLE_FLASH; led++)
		for (int second = 0; second <= 1; second++) {
			char header[40], text[80];

			snprintf(header, sizeof(header), "LED %d, %d", led, second);
			trace_block(header);
			for (int row = 0; row < 3; row++) {
				for (int i = 0; i < 72; i++) {
					uint64_t change_us;

					text[i] = led_lit((enum led_state)led, second,
							  (uint64_t)(72 * row + i) * 25000 + 1000, &change_us)
							  ? '#'
							  : '.';
				}
				text[72] = '\0';
				trace_text("lit", text);
			}
			for (uint64_t t_us = 0; t_us < 900000; t_us += 70001) {
				uint64_t change_us;

				led_lit((enum led_state)led, second, t_us, &change_us);
				show("change", (long long)change_us);
			}
		}
	trace_check();
}

static void test_histograms(void **state)
{
	struct histogram h = {0}, back;
	uint8_t wire[HISTOGRAM_WIRE], again[HISTOGRAM_WIRE];
	uint64_t duration = 1;

	(void)state;
	trace_block("bins");
	for (unsigned bin = 0; bin <= HISTOGRAM_BINS; bin++)
		show("lowest", histogram_lowest(bin));
	for (int i = 0; i < 60; i++) {
		show("bin", histogram_bin((uint32_t)duration));
		histogram_add(&h, duration);
		duration += duration / 2 + (uint64_t)i % 3;
	}
	show("minimum", h.minimum);
	show("maximum", h.maximum);
	show("count", h.count);
	show("sum", (long long)h.sum);
	for (int i = 0; i <= 20; i++)
		show("quantile", histogram_quantile(&h, i / 20.0));
	histogram_encode(&h, wire);
	show("crc", od_crc32(0, wire, sizeof(wire)));
	show("decoded", histogram_decode(&back, wire, sizeof(wire)));
	histogram_encode(&back, again);
	show("same", memcmp(wire, again, sizeof(wire)) == 0);
	show("too short", histogram_decode(&back, wire, sizeof(wire) - 1));
	wire[0]++;
	show("wrong count", histogram_decode(&back, wire, sizeof(wire)));
	trace_check();
}

static void test_thresholds(void **state)
{
	struct od_values values;
	struct od od;

	(void)state;
	od_init(&od, &imu9_od_table, &values, 1);
	values.change_threshold.acceleration = 0.3f;
	values.change_threshold.angle = 0.7f;
	values.change_threshold.angular_rate = 0.11f;
	values.change_threshold.velocity = 0.13f;
	values.change_threshold.position = 0.17f;
	trace_block("thresholds of changes");
	for (size_t i = 0; i < imu9_od_table.count; i++) {
		const struct od_entry *e = &imu9_od_table.entries[i];
		double threshold = threshold_of(&od, e);

		if (e->access & OD_TPDO && (e->index < 0x2120 || e->index >= 0x6000))
			trace_value(e->name, isinf(threshold) ? 1e9 : threshold, 1e-6);
	}
	trace_check();
}

/* Each object of the pipeline's configuration within its limits, and different from its default. */
static void put_other_values(struct od *od)
{
	for (size_t i = 0; i < od->table->count; i++) {
		const struct od_entry *e = &od->table->entries[i];
		uint8_t wire[8];
		char text[40];
		size_t size;

		if (e->index < 0x2000 || e->index > 0x2055 || !(e->access & OD_STORED))
			continue;
		double low = e->access & OD_LIMIT_LOW ? od_number_value((enum od_type)e->type, e->low) : 0,
		       high = e->access & OD_LIMIT_HIGH ? od_number_value((enum od_type)e->type, e->high) : 100;
		snprintf(text, sizeof(text), e->type == OD_REAL32 ? "%.6g" : "%.0f",
			low + (high - low) * (0.11 + 0.0137 * ((e->index * 7 + e->sub * 13) % 61)));
		assert_int_equal(od_parse(e, text, wire, sizeof(wire), &size), OD_OK);
		assert_int_equal(od_put(od, e, wire, size), OD_OK);
	}
}

static void test_settings(void **state)
{
	static struct od_values values;
	struct od od;

	(void)state;
	od_init(&od, &imu9_od_table, &values, 1);
	put_other_values(&od);
	const struct pipeline_config c = settings_pipeline(&values);
	const struct calibration_config *k = &c.calibration;
	const struct triad_calibration *const triads[] = {&k->gyro, &k->accel, &k->mag};

	trace_block("settings of the pipeline");
	for (int i = 0; i < 3; i++) {
		trace_vec("bias", triads[i]->bias, 1e-9);
		for (int row = 0; row < 3; row++)
			trace_vec("row",
				(struct vec3){triads[i]->matrix[row][0], triads[i]->matrix[row][1],
					triads[i]->matrix[row][2]},
				1e-9);
	}
	trace_vec("gyro_slope", k->temperature.gyro_slope, 1e-9);
	trace_vec("gyro_quadratic", k->temperature.gyro_quadratic, 1e-9);
	trace_vec("accel_slope", k->temperature.accel_slope, 1e-9);
	trace_vec("accel_quadratic", k->temperature.accel_quadratic, 1e-9);
	trace_value("reference_degC", k->temperature.reference_degC, 1e-9);
	trace_vec("mounting_rad", k->mounting_rad, 1e-9);
	trace_vec("lever_arm_b_m", c.estimator.lever_arm_b_m, 1e-9);
#define NUMBER(field) trace_value(#field, (double)c.field, 1e-12)
	NUMBER(uncalibrated);
	NUMBER(accel_filter.type);
	NUMBER(accel_filter.order);
	NUMBER(accel_filter.cutoff_hz);
	NUMBER(rate_filter.type);
	NUMBER(rate_filter.order);
	NUMBER(rate_filter.cutoff_hz);
	NUMBER(latency.sensor_s);
	NUMBER(latency.accelerometer_s);
	NUMBER(fusion.algorithm);
	NUMBER(fusion.use_magnetometer);
	NUMBER(fusion.madgwick_beta);
	NUMBER(fusion.mahony_kp_rad_s);
	NUMBER(fusion.mahony_ki_rad_s2);
	NUMBER(fusion.kalman.velocity_sigma_m_s);
	NUMBER(fusion.kalman.heading_sigma_rad);
	NUMBER(fusion.kalman.field_limit);
	NUMBER(fusion.kalman.rejection_time_s);
	NUMBER(fusion.kalman.gyro_error);
	NUMBER(fusion.kalman.bias_walk_rad_s_sqrt_s);
	NUMBER(fusion.kalman.gyro_scale_sigma);
	NUMBER(noise.angle_sigma_rad);
	NUMBER(noise.gyro_density_rad_s_sqrt_hz);
	NUMBER(noise.gyro_bias_instability_rad_s);
	NUMBER(noise.accel_density_m_s2_sqrt_hz);
	NUMBER(noise.accel_bias_instability_m_s2);
	NUMBER(noise.gyro_bias_per_K_rad_s);
	NUMBER(noise.accel_bias_per_K_m_s2);
	NUMBER(noise.mag_sigma_uT);
	NUMBER(estimator.model);
	NUMBER(estimator.rates_from);
	NUMBER(estimator.gravity_m_s2);
	NUMBER(rest.gyro_threshold_rad_s);
	NUMBER(rest.accel_threshold_m_s2);
	NUMBER(rest.time_s);
	NUMBER(stance_s);
	NUMBER(position.mode);
	NUMBER(position.longest_integration_s);
	NUMBER(position.sigma_limit_m);
	NUMBER(position.navigation.preset);
	NUMBER(position.navigation.levelling);
	NUMBER(position.navigation.velocity_prior_m_s);
	NUMBER(position.navigation.rope_m);
#undef NUMBER
	trace_check();
}

/* 2055h for each sensor, and what its source says. */
static void test_uncalibrated(void **state)
{
	static struct od_values values;
	struct od od;
	char name[40];

	(void)state;
	trace_block("sensors that nobody calibrated");
	for (int said = 0; said < 27; said++)
		for (unsigned source = 0; source < 8; source++) {
			od_init(&od, &imu9_od_table, &values, 1);
			values.sensor_calibration.gyro = (uint8_t)(said % 3);
			values.sensor_calibration.accelerometer = (uint8_t)(said / 3 % 3);
			values.sensor_calibration.magnetometer = (uint8_t)(said / 9);
			snprintf(name, sizeof(name), "said %d, source %u", said, source);
			show(name, settings_uncalibrated(&values, source));
			values.gyro_calibration.bias_z = 0.01f;
			values.accelerometer_calibration.zx = 0.01f;
			values.magnetometer_calibration.yy = 1.01f;
			show("calibrated", settings_uncalibrated(&values, source));
			assert_int_equal(settings_pipeline(&values).uncalibrated, settings_uncalibrated(&values, 0));
		}
	trace_check();
}

static void test_angle_filter(void **state)
{
	struct angle_filter filter = {0};
	uint64_t t_us = 5000000;

	(void)state;
	for (int part = 0; part < 4; part++) {
		static const double cutoffs[] = {0.5, 0, 3, 100};
		static const uint64_t steps_us[] = {10000, 10000, 999999, 1150000};
		char header[40];

		snprintf(header, sizeof(header), "angle filter %d", part);
		trace_block(header);
		for (int i = 0; i < 12; i++) {
			struct vec3 angles = {0.1 * i, 3.1 + 0.02 * i, -3 + 0.05 * i * i};

			t_us += steps_us[part];
			trace_vec("angles", angle_filter_step(&filter, cutoffs[part], t_us, angles), 1e-7);
		}
	}
	trace_check();
}

static void test_words(void **state)
{
	(void)state;
	trace_block("errors");
	for (unsigned code = 0; code <= 0xFFFF; code++)
		if (code == 0 || strcmp(emcy_code_text((uint16_t)code), emcy_code_text((uint16_t)(code - 1))) != 0) {
			char name[8];

			snprintf(name, sizeof(name), "%04X", code);
			show_text(name, emcy_code_text((uint16_t)code));
		}
	trace_block("faults of sensors");
	for (uint8_t fault = 0; fault < 10; fault++)
		for (uint8_t chip = 0; chip < 5; chip++) {
			const uint8_t info[5] = {fault, chip};
			char text[64];

			sensor_fault_text(info, text, sizeof(text));
			show_text("fault", text);
		}
	trace_check();
}

/* ---- the log ----------------------------------------------------------------------------------------------------- */

static void test_event_log(void **state)
{
	static struct event_log log;
	static uint8_t out[OD_DOMAIN_MAX];
	struct od_values values;
	struct od od;
	char *at, text[300];

	(void)state;
	od_init(&od, &imu9_od_table, &values, 1);
	memset(&log, 0, sizeof(log));
	event_log_attach(&log, &od);
	event_log_start(&log, 1000000);
	trace_block("lines of the log");
	for (uint64_t t_us = 900000; t_us < 9000000; t_us += 90000) {
		unsigned n = (unsigned)(t_us / 90000);

		if (t_us < 4000000 || t_us > 7000000)
			event_log_add(&log, t_us, "often %u", n);
		if (n % 4 == 0)
			event_log_add_about(&log, t_us, n % 3, "about %u of %u", n, n % 3);
		if (n % 7 == 0)
			event_log_line(&log, t_us, "seldom %u", n);
		if (n % 30 == 0)
			event_log_warning(&log, t_us, "warning %u", n);
		event_log_line_about(&log, t_us, n, "once about %u", n);
		uint64_t next_us = event_log_tick(&log, t_us);
		show("next", next_us == UINT64_MAX ? -1 : (long long)(next_us - t_us));
	}
	event_log_add(&log, 9000000, "%s", repeat('l', 149));
	event_log_add(&log, 9200000, "%s", repeat('l', 150));
	event_log_add(&log, 11000000, "%s", repeat('l', 151));
	const struct od_domain *domain = od_find_domain(&od, 0x2131, 0);
	size_t size = domain->read(domain->ctx, out);
	show("size", (long long)size);
	for (at = (char *)out; at < (char *)out + size; at = strchr(at, '\n') + 1) {
		snprintf(text, sizeof(text), "%.*s", (int)strcspn(at, "\n"), at);
		show("length", (long long)strlen(text));
		if (strncmp(at + 15, "once about", 10) != 0)
			show_text("line", text);
	}
	trace_block("a full log");
	for (unsigned i = 0; i < 700; i++)
		event_log_add_about(&log, 20000000 + (uint64_t)i * 500000, i, "line %u %s", i, repeat('.', i % 97));
	size = domain->read(domain->ctx, out);
	show("size", (long long)size);
	show("crc", od_crc32(0, out, size));
	trace_check();
}

/* ---- files ------------------------------------------------------------------------------------------------------- */

static void test_store(void **state)
{
	static const size_t sizes[][3] = {{0, 0, 0}, {1, 2, 3}, {8192, 0, 100}, {5, 8192, 8192}};
	static struct store_image image, back;
	static uint8_t bytes[STORE_FILE_MAX], again[STORE_FILE_MAX];

	(void)state;
	for (size_t i = 0; i < sizeof(sizes) / sizeof(sizes[0]); i++) {
		char header[40], text[200];
		int n = 0;

		memset(&image, 0, sizeof(image));
		for (int g = 0; g < STORE_GROUPS; g++) {
			image.groups[g].size = sizes[i][g];
			for (size_t k = 0; k < sizes[i][g]; k++)
				image.groups[g].dcf[k] = (uint8_t)(7 * k + (size_t)g);
		}
		image.lss = (struct store_lss){.node_id = (uint8_t)(i * 42), .bit_s = (uint32_t)(i * 125000)};
		image.revision = 0x00020003;
		image.lock_key = i % 2 ? 0x12345678 : 0;
		size_t size = store_encode(&image, bytes);
		snprintf(header, sizeof(header), "store %zu", i);
		trace_block(header);
		show("size", (long long)size);
		show("crc", od_crc32(0, bytes, size - 4));
		for (size_t k = 0; k < 30 && k < size; k++)
			n += snprintf(text + n, sizeof(text) - (size_t)n, "%02X", bytes[k]);
		trace_text("head", text);
		n = 0;
		for (size_t k = size > 30 ? size - 30 : 0; k < size; k++)
			n += snprintf(text + n, sizeof(text) - (size_t)n, "%02X", bytes[k]);
		trace_text("tail", text);
		show("decoded", store_decode(&back, bytes, size));
		show("same", store_encode(&back, again) == size && memcmp(bytes, again, size) == 0);
		for (uint32_t version = 0; version <= 6; version++) { /* the same content as another version */
			uint32_t crc;

			bytes[8] = (uint8_t)version;
			crc = od_crc32(0, bytes, size - 4);
			for (int k = 0; k < 4; k++)
				bytes[size - 4 + (size_t)k] = (uint8_t)(crc >> 8 * k);
			show("as version", store_decode(&back, bytes, size));
			show("node-ID", back.lss.node_id);
			show("revision", back.revision);
			show("key", back.lock_key);
		}
	}
	trace_check();
}

static void test_store_names(void **state)
{
	static const char *const buses[] = {"can0", "udp,hosts=any", "slcan:/dev/ttyACM0@115200", "gs_usb:001E:1",
		"udp:[ff15::1]:55555,x", "", "a b", ",x"};
	static const char *const files[] = {"udp,hosts=any.store", "udp@x.store", "udp,.store", "udp.store.bad",
		"udpx.store", "udp,hosts=any.stor", "node-5.store", "node-6.store", "can0.store"};
	char name[256], path[STORE_PATH_MAX], folder[] = "/tmp/imu9-gateway-XXXXXX", old[STORE_PATH_MAX];

	(void)state;
	trace_block("names of stores");
	for (size_t i = 0; i < sizeof(buses) / sizeof(buses[0]); i++) {
		store_bus_name(name, sizeof(name), buses[i]);
		show_text("name", name);
		store_path(path, sizeof(path), "/var/lib/imu9", buses[i]);
		show_text("path", path);
	}
	store_bus_name(name, 6, "slcan:/dev/ttyACM0");
	show_text("cut", name);
	assert_non_null(mkdtemp(folder));
	snprintf(path, sizeof(path), "%s/udp.store", folder);
	show("an empty folder", store_take_over(path, folder, "udp", 5, old, sizeof(old)));
	show_text("old", old);
	for (size_t i = 0; i < sizeof(files) / sizeof(files[0]); i++) {
		char file[STORE_PATH_MAX];

		snprintf(file, sizeof(file), "%s/%s", folder, files[i]);
		fclose(fopen(file, "w"));
		show(files[i], store_take_over(path, folder, "udp", 5, old, sizeof(old)));
		show_text("old", old[0] ? old + strlen(folder) : "");
		unlink(file);
		unlink(path);
	}
	rmdir(folder);
	show("no folder", store_take_over(path, folder, "udp", 5, old, sizeof(old)));
	trace_check();
}

static char mark(int result)
{
	return result == 1 ? '+' : result == 0 ? '=' : result == -EBADMSG ? '-' : '?';
}

static void test_rows_of_a_recording(void **state)
{
	struct record_entry entries[] = {
		{.kind = RECORD_START, .now_us = 1, .value = 1},
		{.kind = RECORD_SAMPLE,
			.now_us = 4000000123,
			.sample = {.t_us = 3999999999,
				.gyro_rad_s = {0.1, -0.25, 1e-9},
				.accel_m_s2 = {1.0 / 3, 9.81, -2},
				.mag_uT = {20, 0, -45.5},
				.temperature_degC = 21.5,
				.ref_accel_b_m_s2 = {1, 2, 3}}},
		{.kind = RECORD_FRAME, .now_us = 77, .msg = {.id = 0x5, .len = 3, .data = {1, 0xAB, 3}, .t_us = 70}},
		{.kind = RECORD_FRAME, .now_us = 78, .msg = {.id = 0x12345, .extended = true, .t_us = 78}},
		{.kind = RECORD_FRAME, .now_us = 79, .msg = {.id = 0x701, .remote = true, .len = 8, .t_us = 79}},
		{.kind = RECORD_WRITE, .now_us = 80, .write = {0x2000, 0x1A, 4, {0, 0, 0x80, 0x3F}}},
		{.kind = RECORD_WRITE, .now_us = 81, .write = {0x6000, 0, 0, {0}}},
		{.kind = RECORD_FAILED, .now_us = 82, .value = -5},
		{.kind = RECORD_CLOCK, .now_us = 83, .value = 1, .offset_us = -5},
		{.kind = RECORD_SAVED, .now_us = 84, .value = -28},
		{.kind = RECORD_AWAY, .now_us = 85, .offset_us = 1234},
		{.kind = RECORD_TICK, .now_us = 86},
		{.kind = RECORD_ANSWER, .value = -1},
		{.kind = RECORD_OTHERS},
		{.kind = RECORD_LOST, .value = 17},
		{.kind = RECORD_BUS, .bus = {{1, 2, 3, 4, 5, 6, 7}, 8, 9, 10, 11, 4, 13, 14}},
		{.kind = RECORD_IMU, .imu = {{1, 2, 3, 4, 5, 6, 7, 8, 9.5f}, {10, 11, 12}, 100.5, 13}},
		{.kind = RECORD_SELF, .self = {1, 2, 2, 28}},
	};
	static const char *const lines[] = {"# tick 5", "# tick 5 ", "# tick -5", "# tick 99999999999999999999",
		"# tick5", "# saved 5 2147483647", "# saved 5 2147483648", "# saved 5 -2147483648", "# saved 5 x",
		"# saved 5", "# clock 1 2 3", "# clock 1 2 3 4", "# clock 1 2", "# others", "# others 1", "# rx 5 181#",
		"# rx 5 181#0", "# rx 5 181#0G", "# rx 5 181#R", "# rx 5 181#R8", "# rx 5 181#R9", "# rx 5 181#R8 7",
		"# rx 5 181#00 7x", "# rx 5 00000181#00", "# rx 5 181#000102030405060708", "# rx x 181#00",
		"# write 5 2000 1 01", "# write 5 2000 1 0", "# write 5 2000 1 ", "# write 5 2000",
		"# bus 1 2 3 4 5 6 7 8 4 9 10 11 12 13", "# bus 1 2 3 4 5 6 7 8 5 9 10 11 12 13",
		"# imu 1 2 3 4 5 6 7 8 9 10 11 1 0 5", "# imu 1 2 3 4 5 6 7 8 9 10 11 1 2 5", "# recording 1 2 3 4",
		"# recording 1 2 3", "#tick 5", "tick 5", "", "# ", "#", "1.5,1,2,3,4,5,6,7,8,9,10,,1,2,3,5,6",
		"1.500000,1,2,3,4,5,6,,,,,,,,,5,0", "1.500000,1,2,3,4,5,6,,,,,,,,,5,0,", "1,1,2,3,4,5,6,,,,,,,,,5,0",
		"1.500000,1,2,3,4,5,6,,,,,,,,5,0", "1.500000,1 ,2,3,4,5,6,,,,,,,,,5,0"};
	char text[RECORD_ROW_MAX];

	(void)state;
	trace_block("rows of a recording");
	for (size_t i = 0; i < sizeof(entries) / sizeof(entries[0]); i++)
		for (unsigned flags = 0; flags < (entries[i].kind == RECORD_SAMPLE ? 32 : 1); flags++) {
			struct record_entry again;

			if (entries[i].kind == RECORD_SAMPLE)
				entries[i].sample.flags = flags;
			show("size", (long long)record_text(&entries[i], text));
			show_text("row", text);
			text[strcspn(text, "\n")] = '\0';
			show("read", record_parse(text, &again));
			show("kind", again.kind);
		}
	trace_block("damaged rows of a recording");
	for (size_t i = 0; i < sizeof(entries) / sizeof(entries[0]); i++) {
		char cut[TEXT_MAX + 1] = "", changed[TEXT_MAX + 1] = "", line[RECORD_ROW_MAX];
		size_t size = record_text(&entries[i], text) - 1;

		for (size_t k = 0; k < size && k < TEXT_MAX; k++) { /* the first k characters; another one at k */
			struct record_entry again;

			snprintf(line, sizeof(line), "%.*s", (int)k, text);
			cut[k] = mark(record_parse(line, &again));
			snprintf(line, sizeof(line), "%.*s", (int)size, text);
			line[k] = k % 2 ? '~' : ' ';
			changed[k] = mark(record_parse(line, &again));
		}
		trace_text("cut    ", cut);
		trace_text("changed", changed);
	}
	trace_block("lines of a recording");
	for (size_t i = 0; i < sizeof(lines) / sizeof(lines[0]); i++) {
		struct record_entry e = {0};
		int rc = record_parse(lines[i], &e);

		show_text("line", lines[i]);
		show("result", rc);
		if (rc != 1)
			continue;
		record_text(&e, text);
		show_text("again", text);
	}
	trace_check();
}

/* ---- signs of life ----------------------------------------------------------------------------------------------- */

static void test_signs_of_life(void **state)
{
	struct service s = {.fd = -1};
	char header[60], text[100];
	int ends[2];

	(void)state;
	assert_int_equal(socketpair(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK, 0, ends), 0);
	for (int part = 0; part < 4; part++) {
		static const char *const names[] = {"all is well", "the sensor hangs", "the store hangs", "late turns"};
		unsigned turns = 1;
		uint64_t now_us = 50000000;

		snprintf(header, sizeof(header), "signs of life: %s", names[part]);
		trace_block(header);
		s = (struct service){.fd = ends[0], .period_us = 1500000};
		for (int i = 0; i < 60; i++) {
			bool storing = part == 2 || i % 5 == 0;
			ssize_t n;

			turns += part != 1 || i < 20 || i > 40;
			uint64_t next_us = service_tick(&s, part == 3 ? 0 : turns, storing, now_us);
			show("next", (long long)(next_us - now_us));
			while ((n = recv(ends[1], text, sizeof(text) - 1, 0)) > 0) {
				text[n] = '\0';
				show_text("told", text);
			}
			if (i == 30)
				service_away(&s, 700000);
			now_us += part == 3 ? 400000 + (uint64_t)i * 50000 : 1500000;
		}
	}
	close(ends[0]);
	close(ends[1]);
	trace_check();
}

int main(void)
{
	struct CMUnitTest tests[] = {
		cmocka_unit_test(test_keys), cmocka_unit_test(test_assignments), cmocka_unit_test(test_files),
		cmocka_unit_test(test_options), cmocka_unit_test(test_leds), cmocka_unit_test(test_histograms),
		cmocka_unit_test(test_thresholds), cmocka_unit_test(test_settings), cmocka_unit_test(test_uncalibrated),
		cmocka_unit_test(test_angle_filter), cmocka_unit_test(test_words), cmocka_unit_test(test_event_log),
		cmocka_unit_test(test_store), cmocka_unit_test(test_store_names),
		cmocka_unit_test(test_rows_of_a_recording), cmocka_unit_test(test_signs_of_life),
		{0}, /* of trace_run() */
	};

	return trace_run("gateway", tests, sizeof(tests) / sizeof(tests[0]) - 1);
}
