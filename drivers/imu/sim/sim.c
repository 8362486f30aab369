/* A simulated robot in real time: the real driver on simulated chips (sim_chips.h), which measure a scenario of
 * model/sim/signal with the errors of model/sim/sensor, calibrated unless requested otherwise. */
#include <errno.h>
#include <stdio.h>
#include <string.h>

#include "drivers/imu/pololu/i2c_imu.h"
#include "drivers/imu/sim/sim_chips.h"
#include "drivers/imu/source.h"

#define BOARDS "v0, v1, v2, v3, v5, v6, lsm9ds1, icm20948, icm42688 or bmi270"
static const char PRESET[] = "lsm303dlhc_l3gd20", BOARD[] = "v3";
enum { SEED = 1 };
/* from the robot's reference point to the sensor: the seed's 5 cm */
static const struct vec3 LEVER_ARM_B_M = {0.05, 0, 0};
/* relative errors of the oscillators */
static const double RATE_ERROR[] = {[IMU_CHIP_GYRO] = 0.004, [IMU_CHIP_ACCEL] = -0.006, [IMU_CHIP_MAG] = 0.01};

static void scenarios(char *text, size_t size)
{
	size_t n = 0;

	for (const struct signal *s = SIGNALS; s->name && n < size; s++)
		n += (size_t)snprintf(text + n, size - n, "%s%s", n ? ", " : "", s->name);
}

static int parse_option(const char *option, struct sim_config *sim, struct i2c_imu_config *driver, bool *uncalibrated)
{
	if (strncmp(option, "rate=", 5) == 0)
		return source_positive(option + 5, &driver->rate_hz);
	if (strcmp(option, "uncalibrated") == 0) {
		*uncalibrated = true;
		return 0;
	}
	if (strncmp(option, "board=", 6) != 0)
		return -EINVAL;
	sim->board = option + 6;
	return 0;
}

int sim_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size)
{
	char *rest = args, *scenario = strsep(&rest, ","), *option, name[32];
	struct sim_config config = {
		.board = BOARD, .sensor = *sensor_preset(PRESET), .seed = SEED, .now_ns = i2c_imu_now_ns};
	struct i2c_imu_config driver = {.name = name, .simulated = true};
	struct sim_board *board;
	bool uncalibrated = false;
	int result;

	config.signal = scenario && *scenario ? signal_find(scenario) : &SIGNALS[0];
	if (!config.signal) {
		char known[160];

		scenarios(known, sizeof known);
		snprintf(error, error_size, "sim: unknown scenario '%.40s': use one of %s", scenario, known);
		return -EINVAL;
	}
	while ((option = strsep(&rest, ",")))
		if (parse_option(option, &config, &driver, &uncalibrated) < 0) {
			snprintf(error, error_size,
				"sim: unknown option '%.40s': use rate=HZ, board=B with one of " BOARDS
				", or uncalibrated",
				option);
			return -EINVAL;
		}
	if (!uncalibrated)
		sensor_calibrate(&config.sensor);
	config.sensor.lever_arm_b_m = LEVER_ARM_B_M;
	memcpy(config.rate_error, RATE_ERROR, sizeof RATE_ERROR);
	snprintf(name, sizeof name, "sim:%s", config.signal->name);
	result = sim_board_open(&config, &board);
	if (result == -EINVAL)
		snprintf(error, error_size, "sim: unknown board '%.10s': use " BOARDS, config.board);
	if (result < 0)
		return result;
	if (!port) {
		i2c_close(sim_board_bus(board));
		return 0;
	}
	result = i2c_imu_start(sim_board_bus(board), &driver, settings, port, error, error_size);
	if (result == 0 && uncalibrated)
		(*port)->uncalibrated = IMU_UNCALIBRATED;
	return result;
}
