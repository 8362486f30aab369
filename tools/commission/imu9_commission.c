/* tools/commission/imu9_commission.c
 * imu9-commission: from a bare board to a stored configuration in one dialogue on the bus. Each step is a function that
 * asks by procedure_begin() and prints its result by procedure_result(), as the calibrations do. */
#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "model/pipeline.h"
#include "model/math/rotation.h"
#include "model/math/units.h"
#include "od_values.h"
#include "tools/calibrate/calibrate_lever_arm.h"
#include "tools/calibrate/calibrate_sensor.h"
#include "tools/calibrate/procedure.h"
#include "tools/commission/mounting.h"
#include "tools/lib/cli_file.h"
#include "tools/lib/cli_time.h"
#include "tools/sdo/sdo_session.h"

static const char help[] =
	"Usage: imu9-commission [-i BUS] [-n NODE] [OPTION]...\n"
	"Leads from a bare board to a stored configuration: gyro, accelerometer, magnetometer, mounting,\n"
	"lever arm, motion preset, node-ID, store. Before each step it says what to do and how long it takes,\n"
	"after it the result and its sigma; it asks before it takes a result. About 10 minutes.\n"
	"\n"
	"At each step: Enter starts it, s skips it, r repeats the step before, q quits and asks whether to keep\n"
	"and store what was done so far. Ctrl-C, or a failure with --yes, puts all values back.\n"
	"\n"
	"  -i, --can BUS       CAN bus (default: $IMU9_CAN or vcan0), see below\n"
	"  -n, --node-id NODE  node-ID 1 to 127 (default: $IMU9_NODE, or the only node on the bus)\n"
	"  -o, --output FILE   the report (default: imu9-commission-SERIAL.txt)\n"
	"      --six           accelerometer in a fixture on its six faces (at its step: 6)\n"
	"  -y, --yes           start each step and accept each good result without asking\n"
	"  -a, --answers FILE  answers, one a line, in place of the keyboard; at their end as Ctrl-C\n"
	"  -t, --timeout MS    for one SDO answer (default 1000)\n"
	"  -h, --help          this text\n"
	"  -V, --version       the version\n"
	"\n" CLI_EXIT_STATUS;

enum { OPT_SIX = 256 };
enum { STEPS = 8 };

struct commission {
	struct session session;
	struct procedure procedure; /* of the steps that are here */
	struct procedure_lead lead;
	bool six;
	const char *output;
	char default_output[40];
	uint32_t serial;
	char *results[STEPS];	 /* for the report; NULL: skipped */
	char *about;		 /* what the sensor said */
	uint8_t before[1 << 16]; /* 2130h */
	size_t before_size;
};

static const char PROMPT[] = "Enter starts, s skips, r repeats the step before, q quits: ";

/* ---- objects ----------------------------------------------------------------------------------------------------- */

static bool explain(struct cli_node *node, const char *name)
{
	cli_node_explain(node, od_find_name(&imu9_od_table, name));
	return false;
}

/* Objects or records as "name = value", a line each, as imu9-sdo read does. */
static bool tell(struct commission *c, const char *const names[])
{
	struct session *s = &c->session;
	struct target targets[32];
	uint8_t wire[OD_VALUE_MAX];
	char text[4 * OD_VALUE_MAX];
	bool ok = true;

	sdo_open(s);
	for (; ok && *names; names++) {
		size_t n = sdo_targets(s, *names, targets, sizeof targets / sizeof targets[0]);

		for (size_t i = 0; ok && i < n; i++) {
			ok = cli_node_read(&s->node, targets[i].index, targets[i].sub, wire, sizeof wire);
			if (!ok) {
				explain(&s->node, targets[i].entry->name);
				break;
			}
			sdo_value_text(s, &targets[i], wire, s->node.sdo.size, text, sizeof text);
			procedure_result(&c->procedure, "%s = %s\n", targets[i].entry->name, text);
		}
	}
	sdo_close(s);
	return ok;
}

static bool read_vector(struct procedure *p, uint16_t index, struct vec3 *v)
{
	float value[3];

	for (uint8_t i = 0; i < 3; i++)
		if (!cli_node_read(&p->node, index, (uint8_t)(i + 1), &value[i], sizeof value[i])) {
			cli_node_explain(&p->node, od_find(&imu9_od_table, index, (uint8_t)(i + 1), NULL));
			return false;
		}
	*v = (struct vec3){(double)value[0], (double)value[1], (double)value[2]};
	return true;
}

/* ---- calibration ------------------------------------------------------------------------------------------------- */

static bool calibrate(struct commission *c, const char *what)
{
	struct calibrate_request r = {.what = what,
		.six = c->six,
		.yes = c->procedure.yes,
		.bus = c->session.bus,
		.node = (uint8_t)c->session.node_id,
		.timeout_ms = c->session.timeout_ms,
		.lead = &c->lead};

	return calibrate_live(&r) == CLI_OK;
}

static bool gyro(struct commission *c)
{
	return calibrate(c, "gyro");
}

static bool accelerometer(struct commission *c)
{
	c->lead.prompt =
		c->six ? PROMPT
		       : "Enter starts, 6 takes the six faces of a fixture, s skips, r repeats the step before, "
			 "q quits: ";
	bool done = calibrate(c, "accelerometer");

	if (strcmp(c->lead.answer, "6") == 0)
		c->six = true;
	return done;
}

static bool magnetometer(struct commission *c)
{
	return calibrate(c, "magnetometer");
}

static bool lever_arm(struct commission *c)
{
	const struct lever_request r = {.bus = c->session.bus,
		.node = (uint8_t)c->session.node_id,
		.timeout_ms = c->session.timeout_ms,
		.yes = c->procedure.yes,
		.lead = &c->lead};

	return calibrate_lever_live(&r) == CLI_OK;
}

/* ---- mounting ---------------------------------------------------------------------------------------------------- */

/* 5 s of rest in readings 0.2 s apart; the sigma of their mean is some mm/s^2, about 0.02 deg. */
enum { READINGS = 25, READING_US = 200000, PATIENCE_S = 180 };

struct pose {
	struct vec3 force_m_s2, square;
	int readings;
};

static double pose_sigma(const struct pose *pose)
{
	const struct vec3 f = pose->force_m_s2, q = pose->square;
	const double n = pose->readings;

	return sqrt(fmax(0, q.x + q.y + q.z - n * vec3_dot(f, f)) / 3 / (n - 1) / n);
}

/* The mean of the force in sensor axes over a rest; with `level` of a pose raised against it. */
static bool measure(struct procedure *p, struct quat mounting, const struct vec3 *level, struct pose *pose)
{
	const uint64_t end_us = cli_now_us() + PATIENCE_S * 1000000ull;
	struct vec3 force, sum = {0, 0, 0};
	uint16_t status;
	char text[120];

	*pose = (struct pose){.readings = 0};
	while (pose->readings < READINGS) {
		if (!cli_node_read(&p->node, OD_INDEX_SAMPLE, OD_SUB_SAMPLE_STATUS, &status, sizeof status))
			return explain(&p->node, "sample.status");
		if (!read_vector(p, OD_INDEX_SPECIFIC_FORCE, &force))
			return false;
		force = quat_rotate_inverse(mounting, force);
		bool rest = status & PIPELINE_REST;
		bool raised = !level || mounting_angle_rad(*level, force) > MOUNTING_RAISED_DEG * RAD_PER_DEG;

		if (rest && raised) {
			sum = vec3_add(sum, force);
			pose->square = vec3_add(
				pose->square, (struct vec3){force.x * force.x, force.y * force.y, force.z * force.z});
			pose->readings++;
		} else {
			sum = (struct vec3){0, 0, 0};
			*pose = (struct pose){.readings = 0};
		}
		snprintf(text, sizeof text,
			!rest	  ? "it moves: hold it still"
			: !raised ? "raise its front"
				  : "still: %d %%",
			20 * (5 * pose->readings / READINGS));
		procedure_show(text);
		if (procedure_pause(p, READING_US) || cli_now_us() > end_us) {
			cli_error("it was not at rest in this pose for 5 s");
			return false;
		}
	}
	if (isatty(STDOUT_FILENO))
		putchar('\n');
	pose->force_m_s2 = vec3_scale(1.0 / READINGS, sum);
	return true;
}

static bool write_mounting(struct procedure *p, struct vec3 rad)
{
	const float deg[] = {(float)(rad.x / RAD_PER_DEG), (float)(rad.y / RAD_PER_DEG), (float)(rad.z / RAD_PER_DEG)};

	for (uint8_t i = 0; i < 3; i++)
		if (!cli_node_write(&p->node, OD_INDEX_MOUNTING, (uint8_t)(i + 1), &deg[i], sizeof deg[i]))
			return explain(&p->node, "mounting.roll");
	puts("accepted and in use");
	return true;
}

static bool find_mounting(struct procedure *p)
{
	struct pose level, raised;
	struct vec3 mounting_deg, mounting, sigma;

	if (!procedure_begin(p,
		    "Mounting, pose 1 of 2: put the object level, as it stands in use, and let it rest for 7 s.\n"
		    "This gives the tilt of the sensor in the object.") ||
		!read_vector(p, OD_INDEX_MOUNTING, &mounting_deg))
		return false;
	const struct quat old = quat_from_aerospace(vec3_scale(RAD_PER_DEG, mounting_deg));

	if (!measure(p, old, NULL, &level) ||
		!procedure_begin(p,
			"Mounting, pose 2 of 2: raise the front of the object (its axis l) by 30 to 90 deg, turned\n"
			"about its side axis s only, and let it rest for 7 s. This gives the heading of the "
			"sensor in the\n"
			"object: l is where the front went up.") ||
		!measure(p, old, &level.force_m_s2, &raised))
		return false;
	mounting = mounting_from_poses(level.force_m_s2, raised.force_m_s2);
	sigma = mounting_sigma_rad(level.force_m_s2, raised.force_m_s2, fmax(pose_sigma(&level), pose_sigma(&raised)));
	procedure_result(p, "mounting    roll %.3f   pitch %.3f   yaw %.3f deg\n", mounting.x / RAD_PER_DEG,
		mounting.y / RAD_PER_DEG, mounting.z / RAD_PER_DEG);
	procedure_result(p, "1 sigma     tilt %.3f   heading %.3f deg; poses %.1f deg apart\n", sigma.x / RAD_PER_DEG,
		sigma.z / RAD_PER_DEG, mounting_angle_rad(level.force_m_s2, raised.force_m_s2) / RAD_PER_DEG);
	return procedure_agree(p, "accept? [y/N] ") && write_mounting(p, mounting);
}

static bool mounting(struct commission *c)
{
	const struct session *s = &c->session;

	cli_node_open(&c->procedure.node, s->bus, (uint8_t)s->node_id, s->timeout_ms);
	bool done = find_mounting(&c->procedure);

	cli_node_close(&c->procedure.node);
	return done;
}

/* ---- settings ---------------------------------------------------------------------------------------------------- */

static bool is_command(const char *answer)
{
	return strlen(answer) == 1 && strchr("srq", answer[0]);
}

static bool preset(struct commission *c)
{
	static const char *const NAME = "position.motion_preset";
	const struct od_entry *entry = od_find_name(&imu9_od_table, NAME);
	uint8_t wire[OD_VALUE_MAX];
	char text[400];
	size_t size;
	bool done = true;

	snprintf(text, sizeof text, "Motion preset (2040h:10): what carries the sensor. One of\n%s", entry->words);
	c->lead.prompt = "its word, or Enter keeps what is set, s skips, r repeats the step before, q quits: ";
	if (!procedure_begin(&c->procedure, text)) {
		if (is_command(c->lead.answer))
			return false;
		if (od_parse(entry, c->lead.answer, wire, sizeof wire, &size) != OD_OK) {
			cli_error("%s: no preset", c->lead.answer);
			return false;
		}
		sdo_open(&c->session);
		done = cli_node_write(&c->session.node, entry->index, entry->sub, wire, size) ||
		       explain(&c->session.node, NAME);
		sdo_close(&c->session);
	}
	return done && tell(c, (const char *const[]){NAME, NULL});
}

static bool node_id(struct commission *c)
{
	char id[8], serial[16], text[160];
	long value;

	snprintf(text, sizeof text,
		"Node-ID: %ld now. Another one is given and stored by LSS; it holds from the next reset on.",
		c->session.node_id);
	c->lead.prompt = "1 to 127, or Enter keeps it, s skips, r repeats the step before, q quits: ";
	if (procedure_begin(&c->procedure, text)) {
		procedure_result(&c->procedure, "node-ID %ld\n", c->session.node_id);
		return true;
	}
	if (!cli_integer(c->lead.answer, 1, 127, &value)) {
		if (!is_command(c->lead.answer))
			cli_error("%s: no node-ID: 1 to 127", c->lead.answer);
		return false;
	}
	snprintf(id, sizeof id, "%ld", value);
	snprintf(serial, sizeof serial, "0x%X", c->serial);
	char *set[] = {"node-id", id, "--serial", serial, NULL}, *store[] = {"store", "--serial", serial, NULL};
	c->session.quiet = true;
	bool done = sdo_command_lss(&c->session, 4, set) == CLI_OK && sdo_command_lss(&c->session, 3, store) == CLI_OK;
	c->session.quiet = false;
	if (!done) {
		cli_error("the node-ID was not changed: try 'imu9-sdo lss node-id %s'", id);
		return false;
	}
	procedure_result(&c->procedure, "node-ID %s from the next reset on ('imu9-sdo -n %ld nmt reset-comm')\n", id,
		c->session.node_id);
	return true;
}

static bool store(struct commission *c)
{
	if (!procedure_begin(&c->procedure, "Store: keep all of this over a power cut (1010h).") ||
		sdo_command_store(&c->session, 0, NULL) != CLI_OK)
		return false;
	procedure_result(&c->procedure, "stored\n");
	return true;
}

/* ---- the dialogue ------------------------------------------------------------------------------------------------ */

static const struct step {
	const char *name;
	bool (*run)(struct commission *c);
} steps[STEPS] = {{"gyro", gyro}, {"accelerometer", accelerometer}, {"magnetometer", magnetometer},
	{"mounting", mounting}, {"lever arm", lever_arm}, {"motion preset", preset}, {"node-ID", node_id},
	{"store", store}};

/* From now on the results are kept in *text, until the stream is closed. */
static void start_report(struct commission *c, char **text, size_t *size)
{
	c->lead.report = open_memstream(text, size);
	if (!c->lead.report) {
		cli_error("no memory for the report");
		exit(CLI_FAILED);
	}
}

/* What the step prints as its result replaces that of an earlier run. */
static bool run_step(struct commission *c, size_t i)
{
	char *text = NULL;
	size_t size;

	printf("\n[%zu of %d: %s]\n", i + 1, STEPS, steps[i].name);
	c->lead.prompt = PROMPT;
	c->lead.answer[0] = '\0';
	start_report(c, &text, &size);
	bool done = steps[i].run(c);
	fclose(c->lead.report);
	if (done) {
		free(c->results[i]);
		c->results[i] = text;
	} else {
		free(text);
	}
	return done;
}

/* True: to the end. */
static bool lead(struct commission *c)
{
	size_t i = 0;

	while (i < STEPS) {
		bool done = run_step(c, i);
		const char *answer = c->lead.answer;

		if (done || strcmp(answer, "s") == 0) {
			i++;
		} else if (strcmp(answer, "r") == 0) {
			i -= i > 0;
		} else if (strcmp(answer, "q") == 0) {
			return false;
		} else if (c->procedure.yes) {
			cli_error("the step '%s' failed", steps[i].name);
			return false;
		}
	}
	return true;
}

static void put_back(struct commission *c)
{
	struct session *s = &c->session;

	sdo_open(s);
	if (cli_node_write_large(&s->node, OD_INDEX_CONFIGURATION_SNAPSHOT, 0, c->before, c->before_size))
		puts("all values are as they were before");
	else
		explain(&s->node, "configuration_snapshot");
	sdo_close(s);
}

static void write_report(const struct commission *c)
{
	char utc[CLI_UTC_TEXT];
	FILE *file = cli_create(c->output);

	cli_utc_text(utc);
	fprintf(file, "imu9-commission %s, %s, node %ld on %s\n\n%s", IMU9_VERSION, utc, c->session.node_id,
		c->session.bus, c->about);
	for (int i = 0; i < STEPS; i++)
		fprintf(file, "\n[%s]\n%s", steps[i].name, c->results[i] ? c->results[i] : "skipped\n");
	cli_close(file, c->output);
	printf("report: %s\n", c->output);
}

/* ---- the node ---------------------------------------------------------------------------------------------------- */

static bool find_node(struct commission *c)
{
	uint8_t id = 0;
	int found;

	if (c->session.node_id)
		return true;
	found = sdo_find_nodes(&c->session, &id);
	if (found == 0)
		cli_error(
			"no node answers on %s: is the gateway running? A node without node-ID: 'imu9-sdo lss assign'",
			c->session.bus);
	else if (found > 1)
		cli_error("%d nodes on %s: give one by -n ('imu9-sdo scan' lists them)", found, c->session.bus);
	c->session.node_id = id;
	return found == 1;
}

static bool look_at(struct commission *c)
{
	static const char *const ABOUT[] = {"manufacturer_device_name", "manufacturer_hardware_version",
		"manufacturer_software_version", "identity.serial_number", "sensor_state.rate", "sensor_state.fault",
		"sensor_state.degraded", "sensor_state.temperature", "sensor_state.uncalibrated", NULL};
	struct session *s = &c->session;
	size_t size;

	start_report(c, &c->about, &size);
	bool ok = tell(c, ABOUT);
	fclose(c->lead.report);
	if (!ok)
		return false;
	sdo_open(s);
	ok = cli_node_read(&s->node, OD_INDEX_IDENTITY, 4, &c->serial, sizeof c->serial) &&
	     cli_node_read_large(&s->node, OD_INDEX_CONFIGURATION_SNAPSHOT, 0, c->before, sizeof c->before);
	c->before_size = s->node.sdo.size;
	if (!ok)
		explain(&s->node, "configuration_snapshot");
	sdo_close(s);
	snprintf(c->default_output, sizeof c->default_output, "imu9-commission-%08X.txt", c->serial);
	if (!c->output)
		c->output = c->default_output;
	return ok;
}

static void take_answers(const char *path)
{
	if (!freopen(path, "r", stdin)) {
		cli_error("%s: cannot be read", path);
		exit(CLI_FAILED);
	}
}

static void parse_options(struct commission *c, int argc, char **argv)
{
	static const struct option options[] = {CLI_BUS_OPTIONS, {"output", required_argument, NULL, 'o'},
		{"six", no_argument, NULL, OPT_SIX}, {"yes", no_argument, NULL, 'y'},
		{"answers", required_argument, NULL, 'a'}, {"timeout", required_argument, NULL, 't'},
		CLI_COMMON_OPTIONS};
	int option;

	opterr = 0;
	while ((option = getopt_long(argc, argv, ":i:n:o:ya:t:hV", options, NULL)) != -1) {
		switch (option) {
		case 'i':
			c->session.bus = optarg;
			break;
		case 'n':
			c->session.node_id = cli_integer_option("-n", optarg, 1, 127);
			break;
		case 'o':
			c->output = optarg;
			break;
		case OPT_SIX:
			c->six = true;
			break;
		case 'y':
			c->procedure.yes = true;
			break;
		case 'a':
			take_answers(optarg);
			break;
		case 't':
			c->session.timeout_ms = (unsigned)cli_integer_option("-t", optarg, 1, 600000);
			break;
		case 'h':
			cli_print_help(help);
			exit(CLI_OK);
		case 'V':
			puts("imu9-commission " IMU9_VERSION);
			exit(CLI_OK);
		default:
			cli_bad_option(option, argv);
		}
	}
	if (optind < argc)
		cli_usage_error("%s: no arguments are known but options", argv[optind]);
}

int main(int argc, char **argv)
{
	static struct commission c = {.session = {.timeout_ms = 1000, .table = &imu9_od_table}};

	c.session.bus = cli_default_bus();
	c.session.node_id = getenv("IMU9_NODE") ? cli_default_node() : 0;
	parse_options(&c, argc, argv);
	setvbuf(stdin, NULL, _IONBF, 0); /* so that poll() sees each answer */
	c.procedure.signal_fd = cli_signal_fd();
	c.procedure.lead = &c.lead;
	if (!find_node(&c) || !look_at(&c))
		return CLI_FAILED;

	bool finished = lead(&c), kept = finished;
	if (!finished && !c.procedure.yes &&
		procedure_agree(&c.procedure, "keep and store what was done so far? [y/N] "))
		kept = sdo_command_store(&c.session, 0, NULL) == CLI_OK;
	if (kept)
		write_report(&c);
	else
		put_back(&c);
	return finished ? CLI_OK : CLI_FAILED;
}
