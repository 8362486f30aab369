#include "tools/calibrate/procedure.h"

#include <poll.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "od_values.h"

static const uint64_t POLL_US = 200000;

/* ---- the object -------------------------------------------------------------------------------------------------- */

static bool explain(const struct procedure *p, uint8_t sub)
{
	if (p->node.sdo.result == SDO_DONE)
		cli_error("%04Xh:%02X of node %u has an unexpected size: is it an IMU9 gateway of this version?",
			p->object, sub, p->node.id);
	cli_node_explain(&p->node, od_find(&imu9_od_table, p->object, sub, NULL));
	return false;
}

bool procedure_command(struct procedure *p, uint8_t value)
{
	return cli_node_write(&p->node, p->object, PROCEDURE_COMMAND, &value, 1) || explain(p, PROCEDURE_COMMAND);
}

bool procedure_start(struct procedure *p, uint8_t value)
{
	if (procedure_command(p, value))
		return true;
	if (p->node.sdo.result == SDO_ABORTED && p->node.sdo.abort_code == 0x08000022)
		cli_error("is another calibration running (imu9-sdo write calibration.command 0 and imu9-sdo write "
			  "lever_arm_identification.command 0 end it), or does the sensor give no samples (imu9-sdo "
			  "log)?");
	return false;
}

static bool read_value(struct procedure *p, uint8_t sub, void *value, size_t size)
{
	return (cli_node_read(&p->node, p->object, sub, value, size) && p->node.sdo.size == size) || explain(p, sub);
}

bool procedure_byte(struct procedure *p, uint8_t sub, uint8_t *value)
{
	return read_value(p, sub, value, sizeof *value);
}

bool procedure_real(struct procedure *p, uint8_t sub, float *value)
{
	return read_value(p, sub, value, sizeof *value);
}

bool procedure_write_real(struct procedure *p, uint8_t sub, float value)
{
	return cli_node_write(&p->node, p->object, sub, &value, sizeof value) || explain(p, sub);
}

/* ---- the user ---------------------------------------------------------------------------------------------------- */

bool procedure_ask(const struct procedure *p, const char *prompt, char *answer, int size)
{
	struct pollfd fds[] = {{STDIN_FILENO, POLLIN, 0}, {p->signal_fd, POLLIN, 0}};

	fputs(prompt, stdout);
	fflush(stdout);
	if (poll(fds, 2, -1) <= 0 || fds[1].revents || !fgets(answer, size, stdin)) {
		putchar('\n');
		return false;
	}
	answer[strcspn(answer, "\r\n")] = '\0';
	if (!isatty(STDIN_FILENO))
		puts(answer);
	return true;
}

bool procedure_agree(const struct procedure *p, const char *prompt)
{
	char answer[16];

	return p->yes || (procedure_ask(p, prompt, answer, sizeof answer) && (answer[0] == 'y' || answer[0] == 'Y'));
}

bool procedure_begin(const struct procedure *p, const char *what_to_do)
{
	char answer[16];

	puts(what_to_do);
	if (p->yes)
		return true;
	if (p->lead) {
		if (!procedure_ask(p, p->lead->prompt, p->lead->answer, sizeof p->lead->answer))
			strcpy(p->lead->answer, "q");
		return p->lead->answer[0] == '\0';
	}
	return !isatty(STDIN_FILENO) ||
	       procedure_ask(p, "Enter starts, Ctrl-C leaves everything as it is: ", answer, sizeof answer);
}

void procedure_result(const struct procedure *p, const char *format, ...)
{
	FILE *const files[] = {stdout, p->lead ? p->lead->report : NULL};
	va_list args;

	for (size_t i = 0; i < 2 && files[i]; i++) {
		va_start(args, format);
		vfprintf(files[i], format, args);
		va_end(args);
	}
}

void procedure_show(const char *text)
{
	static char last[256];

	if (strcmp(text, last) == 0)
		return;
	snprintf(last, sizeof last, "%s", text);
	printf(isatty(STDOUT_FILENO) ? "\r\033[K%s" : "%s\n", text);
	fflush(stdout);
}

bool procedure_pause(struct procedure *p, uint64_t us)
{
	const uint64_t end_us = cli_now_us() + us;
	struct can_msg msg;
	bool stop = false;

	while (!stop && cli_now_us() < end_us) {
		stop = cli_wait(p->node.bus, p->signal_fd, end_us);
		while (can_receive(p->node.bus, &msg, cli_now_us()) > 0)
			continue;
	}
	return stop;
}

bool procedure_watch(struct procedure *p, bool (*show)(struct procedure *p, void *ctx), void *ctx, uint8_t *state)
{
	bool stop = false;

	while (!stop) {
		if (!procedure_byte(p, PROCEDURE_STATE, state))
			return false;
		if (*state != PROCEDURE_RUNNING)
			break;
		if (!show(p, ctx))
			return false;
		stop = procedure_pause(p, POLL_US);
	}
	if (isatty(STDOUT_FILENO))
		putchar('\n');
	if (stop && procedure_command(p, PROCEDURE_ABORT))
		cli_error("stopped: nothing was changed");
	return !stop;
}

bool procedure_accept(struct procedure *p, uint8_t accept, uint8_t discard)
{
	if (!procedure_agree(p, "accept? [y/N] ")) {
		if (procedure_command(p, discard))
			puts("discarded");
		return false;
	}
	if (!procedure_command(p, accept))
		return false;
	puts(p->lead ? "accepted and in use" : "accepted and in use; 'imu9-sdo store' makes it permanent");
	return true;
}
