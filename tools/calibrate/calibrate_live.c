#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "model/identify/calibrate.h"
#include "od_values.h"
#include "tools/calibrate/calibrate_sensor.h"
#include "tools/lib/cli_node.h"

enum { OBJECT = OD_INDEX_CALIBRATION };
enum {
	COMMAND = 1,
	STATE,
	KIND,
	VERDICT,
	PROGRESS,
	POSITIONS,
	WANTED,
	NEXT,
	QUALITY,
	COVERAGE,
	FIELD,
	TEMPERATURE,
	STRENGTH,
	FOUND
}; /* sub-indices */
enum { ABORT = 0, GYRO = 1, SIX_FACES, FREE, MAGNETOMETER, ACCEPT = 10, DISCARD = 11 };
enum { RUNNING = 1, DONE = 2 };
static const uint64_t POLL_US = 200000;

/* ---- the object -------------------------------------------------------------------------------------------------- */

static bool explain(const struct cli_node *node, uint8_t sub)
{
	if (node->sdo.result == SDO_DONE)
		cli_error("%04Xh:%02X of node %u has an unexpected size: is it an IMU9 gateway of this version?",
			OBJECT, sub, node->id);
	cli_node_explain(node, od_find(&imu9_od_table, OBJECT, sub, NULL));
	return false;
}

static bool command(struct cli_node *node, uint8_t value)
{
	return cli_node_write(node, OBJECT, COMMAND, &value, 1) || explain(node, COMMAND);
}

static bool read_value(struct cli_node *node, uint8_t sub, void *value, size_t size)
{
	return (cli_node_read(node, OBJECT, sub, value, size) && node->sdo.size == size) || explain(node, sub);
}

static bool read_byte(struct cli_node *node, uint8_t sub, uint8_t *value)
{
	return read_value(node, sub, value, sizeof *value);
}

static bool read_real(struct cli_node *node, uint8_t sub, float *value)
{
	return read_value(node, sub, value, sizeof *value);
}

/* ---- the user ---------------------------------------------------------------------------------------------------- */

/* Overwrites one line on a terminal; elsewhere each change gets a new line. */
static void show(const char *text)
{
	static char last[160];

	if (strcmp(text, last) == 0)
		return;
	snprintf(last, sizeof last, "%s", text);
	printf(isatty(STDOUT_FILENO) ? "\r\033[K%s" : "%s\n", text);
	fflush(stdout);
}

static bool show_progress(struct cli_node *node, uint8_t kind)
{
	uint8_t progress, positions, wanted, next, coverage;
	char text[160];

	if (!read_byte(node, PROGRESS, &progress))
		return false;
	switch (kind) {
	case GYRO:
		snprintf(text, sizeof text, "do not touch the sensor: %u %%", progress);
		break;
	case MAGNETOMETER:
		if (!read_byte(node, COVERAGE, &coverage) || !read_byte(node, NEXT, &next))
			return false;
		snprintf(text, sizeof text, "turn it slowly through all directions: %u %% (coverage %u %%)%s%s",
			progress, coverage, next ? "; missing along the field: " : "",
			next ? calibrate_side_text(next) : "");
		break;
	default:
		if (!read_byte(node, POSITIONS, &positions) || !read_byte(node, WANTED, &wanted) ||
			!read_byte(node, NEXT, &next))
			return false;
		snprintf(text, sizeof text, "%u of %u positions; turn it and hold it still: %s up", positions, wanted,
			calibrate_side_text(next));
	}
	show(text);
	return true;
}

static void pause_for(struct cli_node *node, uint64_t us, int signal_fd, bool *stop)
{
	const uint64_t end_us = cli_now_us() + us;
	struct can_msg msg;

	while (!*stop && cli_now_us() < end_us) {
		*stop = cli_wait(node->bus, signal_fd, end_us);
		while (can_receive(node->bus, &msg, cli_now_us()) > 0)
			continue;
	}
}

/* Shows the progress until the calibration ends. False: the node does not answer, or the user stopped it. */
static bool watch(struct cli_node *node, uint8_t kind, int signal_fd, uint8_t *state)
{
	bool stop = false;

	while (!stop) {
		if (!read_byte(node, STATE, state))
			return false;
		if (*state != RUNNING)
			break;
		if (!show_progress(node, kind))
			return false;
		pause_for(node, POLL_US, signal_fd, &stop);
	}
	if (isatty(STDOUT_FILENO))
		putchar('\n');
	if (stop && command(node, ABORT))
		cli_error("stopped: the calibration is unchanged");
	return !stop;
}

static bool print_result(struct cli_node *node, uint8_t kind)
{
	static const char *const UNITS[] = {"", "rad/s", "m/s^2", "m/s^2", "uT"};
	float value[12], quality, temperature;

	for (uint8_t i = 0; i < 12; i++)
		if (!read_real(node, (uint8_t)(FOUND + i), &value[i]))
			return false;
	if (!read_real(node, QUALITY, &quality) || !read_real(node, TEMPERATURE, &temperature))
		return false;
	printf("bias     %12.6g %12.6g %12.6g %s\n", (double)value[0], (double)value[1], (double)value[2], UNITS[kind]);
	if (kind != GYRO)
		for (int i = 3; i < 12; i += 3)
			printf("%-8s %12.6f %12.6f %12.6f\n", i == 3 ? "matrix" : "", (double)value[i],
				(double)value[i + 1], (double)value[i + 2]);
	printf("%-8s %12.4g %s\n", kind == GYRO ? "1 sigma" : "residual", (double)quality,
		kind == MAGNETOMETER ? "% of the field" : UNITS[kind]);
	if (temperature > -300)
		printf("%-8s %12.4g degC\n", "at", (double)temperature);
	return true;
}

static bool ask(int signal_fd)
{
	struct pollfd fds[] = {{STDIN_FILENO, POLLIN, 0}, {signal_fd, POLLIN, 0}};
	char answer[16];

	printf("accept? [y/N] ");
	fflush(stdout);
	return poll(fds, 2, -1) > 0 && !fds[1].revents && fgets(answer, sizeof answer, stdin) &&
	       (answer[0] == 'y' || answer[0] == 'Y');
}

static bool start(struct cli_node *node, uint8_t kind)
{
	if (command(node, kind))
		return true;
	if (node->sdo.result == SDO_ABORTED && node->sdo.abort_code == 0x08000022)
		cli_error("is another calibration running (imu9-sdo write calibration.command 0 ends it), or does the "
			  "sensor give no samples (imu9-sdo log)?");
	return false;
}

static int run(struct cli_node *node, const struct calibrate_request *r, uint8_t kind)
{
	const float strength = (float)r->field_uT;
	const int signal_fd = cli_signal_fd(); /* signals stay blocked: at the question they mean no */
	uint8_t state = 0, verdict;

	if (strength > 0 && !cli_node_write(node, OBJECT, STRENGTH, &strength, sizeof strength)) {
		explain(node, STRENGTH);
		return CLI_FAILED;
	}
	if (!start(node, kind) || !watch(node, kind, signal_fd, &state) || !read_byte(node, VERDICT, &verdict))
		return CLI_FAILED;
	if (state != DONE) {
		cli_error("%s refused: %s", r->what, calibrate_text((enum calibrate_verdict)verdict));
		return CLI_FAILED;
	}
	if (!print_result(node, kind))
		return CLI_FAILED;
	if (!r->yes && !ask(signal_fd)) {
		if (command(node, DISCARD))
			puts("discarded");
		return CLI_FAILED;
	}
	if (!command(node, ACCEPT))
		return CLI_FAILED;
	puts("accepted and in use; 'imu9-sdo store' makes it permanent");
	return CLI_OK;
}

int calibrate_live(const struct calibrate_request *r)
{
	const uint8_t kind = strcmp(r->what, "gyro") == 0	    ? GYRO
			     : strcmp(r->what, "magnetometer") == 0 ? MAGNETOMETER
			     : r->six				    ? SIX_FACES
								    : FREE;
	struct cli_node node;
	int result;

	cli_node_open(&node, r->bus, r->node, r->timeout_ms);
	result = run(&node, r, kind);
	cli_node_close(&node);
	return result;
}
