#include "tools/replay/recording.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/device_state.h"
#include "gateway/log.h"
#include "gateway/record_text.h"
#include "tools/lib/cli.h"

static const char FIRST_LINE[] = "# imu9-recording ";
enum { VERSION = 1 };

struct recording {
	struct can_port bus; /* first: the ports find the recording by them */
	struct imu_port imu;
	const char *path;
	FILE *file;
	char *text;
	size_t room;
	long line;
	bool torn, damaged;

	struct config config; /* as recorded */
	bool same_build, whole_state;
	unsigned node_id, nmt_state, uncalibrated, self_test;
	uint8_t state[sizeof(struct device)];

	struct record record;
	struct device device;
	const struct recording_events *events;
	uint64_t now_us;
	struct record_entry next; /* read ahead */
	bool has_next, running;
	bool bus_is_new, imu_is_new; /* they count the frame or sample that comes next */
	bool others;		     /* have sent frames, too, since then */
	uint32_t sent_then, sent;    /* frames, by the gateway until it last said so, and by the replay since */
	long differs;		     /* first line where the replay differs; 0: it does not */
};

#define RECORDING_OF(port_, member) ((struct recording *)((char *)(port_)-offsetof(struct recording, member)))

/* ---- lines ------------------------------------------------------------------------------------------------------- */

/* The next line without its line break; NULL: the end. The last one of a power cut is torn. */
static char *next_line(struct recording *r)
{
	ssize_t n = getline(&r->text, &r->room, r->file);

	if (n <= 0)
		return NULL;
	r->line++;
	if (r->text[n - 1] != '\n') {
		r->torn = true;
		return NULL;
	}
	r->text[n - 1] = '\0';
	return r->text;
}

static const struct record_entry *peek(struct recording *r)
{
	while (!r->has_next && !r->damaged) {
		const char *text = next_line(r);
		int rc = text ? record_parse(text, &r->next) : 0;

		if (!text)
			return NULL;
		r->damaged = rc < 0;
		r->has_next = rc == 1;
	}
	return r->has_next ? &r->next : NULL;
}

static void differs(struct recording *r)
{
	if (!r->differs)
		r->differs = r->line;
}

/* ---- ports ------------------------------------------------------------------------------------------------------- */

static void show_bus(struct recording *r, const struct record_bus *b)
{
	uint32_t sent = b->counters.tx + b->counters.tx_dropped + b->queued;

	if (r->running && !r->others && sent - r->sent_then != r->sent)
		differs(r);
	r->sent_then = sent;
	r->sent = 0;
	r->others = false;
	r->bus.counters = b->counters;
	r->bus.traffic.frames = b->frames;
	r->bus.traffic.bytes = b->bytes;
	r->bus.bit_s = b->bit_s;
	r->bus.state = (enum can_state)b->state;
	r->bus.tx_errors = b->tx_errors;
	r->bus.rx_errors = b->rx_errors;
	r->bus_is_new = true;
}

static void show_imu(struct recording *r, const struct record_imu *i)
{
	r->imu.counters = i->counters;
	r->imu.health = i->health;
	r->imu.rate_hz = i->rate_hz;
	r->imu.silence_us = i->silence_us;
	r->imu_is_new = true;
}

/* True: the entry was what the ports show next. */
static bool show(struct recording *r, const struct record_entry *e)
{
	switch (e->kind) {
	case RECORD_BUS:
		show_bus(r, &e->bus);
		return true;
	case RECORD_IMU:
		show_imu(r, &e->imu);
		return true;
	case RECORD_SELF:
		r->record.self = e->self;
		return true;
	case RECORD_OTHERS:
		r->others = true;
		return true;
	default:
		return false;
	}
}

/* What the port answered then, or `otherwise`. */
static int answer(struct recording *r, int otherwise)
{
	const struct record_entry *e = peek(r);

	if (!e || e->kind != RECORD_ANSWER) {
		if (r->running && !(!e && r->torn))
			differs(r);
		return otherwise;
	}
	r->has_next = false;
	return e->value;
}

static int bus_send(struct can_port *port, const struct can_msg *msg)
{
	struct recording *r = RECORDING_OF(port, bus);

	r->sent++;
	r->events->frame(r->events->ctx, r->bus.name, msg, r->now_us);
	return 0;
}

static int bus_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port, (void)ids, (void)n;
	return 0;
}

static void bus_refresh(struct can_port *port)
{
	struct recording *r = RECORDING_OF(port, bus);
	const struct record_entry *e = peek(r);

	if (e && e->kind == RECORD_BUS)
		r->has_next = !show(r, e);
}

static int bus_bit_rate(struct can_port *port, uint32_t bit_s, bool dry_run)
{
	(void)bit_s, (void)dry_run;
	return answer(RECORDING_OF(port, bus), -EOPNOTSUPP);
}

static int bus_restart(struct can_port *port)
{
	return answer(RECORDING_OF(port, bus), -EOPNOTSUPP);
}

static int imu_configure(
	struct imu_port *port, const struct imu_settings *settings, int dry, char *error, size_t error_size)
{
	struct recording *r = RECORDING_OF(port, imu);
	int rc = answer(r, 0);
	const struct record_entry *e = peek(r);

	(void)settings, (void)dry;
	if (e && e->kind == RECORD_IMU)
		r->has_next = !show(r, e);
	snprintf(error, error_size, "not recorded");
	return rc;
}

static void imu_self_test(struct imu_port *port)
{
	(void)port;
}

static int save(void *ctx, const uint8_t *bytes, size_t size)
{
	(void)bytes, (void)size;
	return answer(ctx, -EIO);
}

static const struct can_ops BUS_OPS = {.send = bus_send,
	.filter = bus_filter,
	.refresh = bus_refresh,
	.bit_rate = bus_bit_rate,
	.restart = bus_restart};
static const struct imu_ops IMU_OPS = {.configure = imu_configure, .self_test = imu_self_test};
static const struct imu_ops IMU_OPS_WITHOUT_TEST = {.configure = imu_configure};

/* ---- the head ---------------------------------------------------------------------------------------------------- */

_Noreturn static void bad(const struct recording *r, const char *what)
{
	cli_error("%s:%ld: %s", r->path, r->line, what);
	exit(CLI_FAILED);
}

static void read_build(struct recording *r, const char *text)
{
	char build[64] = "";
	int version = 0;

	sscanf(text, "%d %63s", &version, build);
	if (version != VERSION)
		bad(r, "a recording of a later version: use its imu9-replay");
	r->same_build = strcmp(build, device_state_build()) == 0;
}

/* "lever_arm.l = 0.05" */
static void read_configuration(struct recording *r, const char *text)
{
	char assignment[CONFIG_TEXT_MAX * 2], why[CONFIG_ERROR_MAX];
	const char *equals = strstr(text, " = ");

	if (!equals || strlen(text) >= sizeof(assignment))
		bad(r, "damaged");
	snprintf(assignment, sizeof(assignment), "%.*s=%s", (int)(equals - text), text, equals + 3);
	if (config_set(&r->config, assignment, why) < 0)
		cli_error("%s:%ld: not used: %s", r->path, r->line, why);
}

static void read_state(struct recording *r, const char *text)
{
	size_t at = 0, length;
	int n = 0;

	if (!r->same_build)
		return;
	if (sscanf(text, "%zu %n", &at, &n) != 1 || n == 0)
		bad(r, "damaged");
	text += n;
	length = strlen(text);
	if (at > sizeof(r->state) || length / 4 * 3 > sizeof(r->state) - at + 2 ||
		record_from_base64(text, length, r->state + at) < 0)
		bad(r, "damaged");
}

static void read_state_end(struct recording *r, const char *text)
{
	unsigned crc = 0;
	size_t size = 0;

	sscanf(text, "%zu %X", &size, &crc);
	r->whole_state = r->same_build && size == sizeof(r->state) && crc == od_crc32(0, r->state, size);
	if (r->same_build && !r->whole_state)
		bad(r, "the state is damaged");
}

static bool begins(const char **text, const char *word)
{
	size_t length = strlen(word);

	if (strncmp(*text, word, length) != 0)
		return false;
	*text += length;
	return true;
}

static void read_head(struct recording *r)
{
	const char *text;

	while ((text = next_line(r)) != NULL && strcmp(text, RECORD_COLUMNS) != 0) {
		if (begins(&text, FIRST_LINE))
			read_build(r, text);
		else if (begins(&text, "# device "))
			sscanf(text, "%u %u %u %u", &r->node_id, &r->nmt_state, &r->uncalibrated, &r->self_test);
		else if (begins(&text, "# sensor "))
			snprintf(r->imu.name, sizeof(r->imu.name), "%.63s", text);
		else if (begins(&text, "# can "))
			snprintf(r->bus.name, sizeof(r->bus.name), "%.63s", text);
		else if (begins(&text, "# config "))
			read_configuration(r, text);
		else if (begins(&text, "# state "))
			read_state(r, text);
		else if (begins(&text, "# state-end "))
			read_state_end(r, text);
	}
	if (!text)
		bad(r, "the recording ends before its first input");
	for (const struct record_entry *e; (e = peek(r)) != NULL && show(r, e);)
		r->has_next = false;
	if (r->imu.rate_hz <= 0 || r->node_id == 0 || r->node_id > 255)
		bad(r, "damaged");
}

/* ---- the run ----------------------------------------------------------------------------------------------------- */

/* Without the state: as after a start, and in the NMT state that it had. */
static void start_anew(struct recording *r, uint64_t now_us)
{
	struct can_msg start = {.len = 2, .data = {1, (uint8_t)r->node_id}, .t_us = now_us};

	r->now_us = now_us;
	device_start(&r->device, false, now_us);
	if (r->nmt_state == NMT_OPERATIONAL)
		device_receive(&r->device, &start, now_us);
}

static void start(struct recording *r, const struct config *changes)
{
	const struct storing_port storage = {.ctx = r, .save = save};
	const struct record_entry *first = peek(r);
	bool from_state = r->whole_state && changes->object_count == 0;

	if (!first)
		bad(r, "the recording ends before its first input");
	r->bus.ops = &BUS_OPS;
	r->bus.fd = r->imu.fd = -1;
	r->imu.ops = r->self_test ? &IMU_OPS : &IMU_OPS_WITHOUT_TEST;
	r->imu.uncalibrated = (uint8_t)r->uncalibrated;
	r->record.replayed = true;
	od_init(&r->device.od, &imu9_od_table, &r->device.values, (uint8_t)r->node_id);
	config_apply(&r->config, &r->device.od);
	config_apply(changes, &r->device.od);
	if (device_init(&r->device, &r->bus, &r->imu, &storage, NULL, (uint8_t)r->node_id) < 0)
		bad(r, "the recorded configuration is inconsistent");
	record_attach(&r->record, &r->device);
	if (from_state)
		device_state_load(&r->device, r->state);
	else if (!r->same_build)
		cli_error("%s: recorded by another build of the gateway: the values may differ from those of then",
			r->path);
	if (!from_state && first->kind != RECORD_START) {
		cli_error("%s: the recording begins in the run: here the filters start anew, with its configuration",
			r->path);
		start_anew(r, first->now_us);
	}
	r->running = from_state;
}

static void sample(struct recording *r, const struct record_entry *e)
{
	uint32_t refused = r->device.pipeline.refused;

	r->imu.counters.samples += !r->imu_is_new;
	device_sample(&r->device, 1, &e->sample, e->now_us);
	if (r->device.pipeline.refused == refused)
		r->events->sample(r->events->ctx, &r->device);
}

static void input(struct recording *r, const struct record_entry *e)
{
	struct device *d = &r->device;

	r->now_us = e->now_us ? e->now_us : r->now_us;
	switch (e->kind) {
	case RECORD_START:
		device_start(d, e->value, e->now_us);
		break;
	case RECORD_SAMPLE:
		sample(r, e);
		break;
	case RECORD_FAILED:
		device_sample(d, e->value, NULL, e->now_us);
		break;
	case RECORD_FRAME:
		r->bus.counters.rx += !r->bus_is_new;
		device_receive(d, &e->msg, e->now_us);
		break;
	case RECORD_WRITE:
		(void)device_write(d, e->write.index, e->write.sub, e->write.wire, e->write.size, e->now_us);
		break;
	case RECORD_CLOCK:
		device_host_clock(d, e->value, e->offset_us);
		break;
	case RECORD_SAVED:
		device_saved(d, e->value, e->now_us);
		break;
	case RECORD_AWAY:
		device_away(d, (uint64_t)e->offset_us, e->now_us);
		break;
	case RECORD_TICK:
		(void)device_tick(d, e->now_us);
		break;
	case RECORD_ANSWER:
		if (r->running)
			differs(r); /* the device did not ask */
		break;
	case RECORD_LOST:
		cli_error("%s:%ld: %u inputs are missing: the disk was too slow; the next file continues", r->path,
			r->line, (unsigned)e->value);
		break;
	default:
		break;
	}
}

bool recording_is(const char *path)
{
	char text[sizeof(FIRST_LINE)] = "";
	FILE *file = strcmp(path, "-") == 0 ? NULL : fopen(path, "re");
	bool is = file && fgets(text, sizeof(text), file) && strcmp(text, FIRST_LINE) == 0;

	if (file)
		fclose(file);
	return is;
}

bool recording_replay(const char *path, const struct config *changes, const struct recording_events *events)
{
	static struct recording recording;
	struct recording *r = &recording;
	const struct record_entry *e;

	memset(r, 0, sizeof(*r));
	r->path = path;
	r->events = events;
	r->file = fopen(path, "re");
	if (!r->file) {
		cli_error("%s: %s", path, strerror(errno));
		return false;
	}
	log_set_level(-1); /* the device's messages are of then */
	config_init(&r->config, &imu9_od_table);
	read_head(r);
	start(r, changes);
	while ((e = peek(r)) != NULL) {
		struct record_entry now = *e;

		r->has_next = false;
		if (show(r, &now))
			continue;
		input(r, &now);
		r->bus_is_new = r->imu_is_new = false;
	}
	if (r->torn)
		cli_error("%s:%ld: the last line is torn, and not used", path, r->line);
	if (r->damaged)
		cli_error("%s:%ld: damaged; not replayed from here on", path, r->line);
	if (r->differs)
		cli_error("%s:%ld: the replay differs from the recording from here on: another processor or C library?",
			path, r->differs);
	fclose(r->file);
	free(r->text);
	return !r->damaged && !r->differs;
}
