#include "gateway/window.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/canopen/sdo_abort.h"
#include "gateway/log.h"

enum { TEXT_MAX = 2 * OD_VALUE_MAX + 1 };

void window_print_syntax(FILE *out)
{
	fputs("  tcp:HOST[:PORT][,allow=NET]...[,write=NET]...[,clients=N][,idle=S][,rate=N]\n"
	      "                        Modbus/TCP; allow: who may read (default: this host), write: who may\n"
	      "                        write, too (default: nobody)\n"
	      "  rtu:DEVICE[,baud=B][,parity=P][,stop=N][,address=A][,write=yes]\n"
	      "                        Modbus RTU; default 19200 Bd, even parity, address 1, read only\n",
		out);
}

/* The windows of the text; their number, or -EINVAL and a reason. */
static int parse(const char *text, struct modbus_window windows[MODBUS_WINDOWS_MAX], char *error, size_t error_size)
{
	char line[MODBUS_WHO_MAX * 4];
	int n = 0;

	for (; *text; text += strcspn(text, "\n"), text += *text == '\n') {
		if (n == MODBUS_WINDOWS_MAX) {
			snprintf(error, error_size, "more than %d Modbus windows", MODBUS_WINDOWS_MAX);
			return -EINVAL;
		}
		snprintf(line, sizeof(line), "%.*s", (int)strcspn(text, "\n"), text);
		int rc = modbus_options_parse(&windows[n++], line, error, error_size);
		if (rc < 0)
			return rc;
	}
	return n;
}

int window_check(const char *windows, char *error, size_t error_size)
{
	struct modbus_window parsed[MODBUS_WINDOWS_MAX];
	int n = parse(windows, parsed, error, error_size);

	return n < 0 ? n : 0;
}

static void on_log(int severity, const char *text)
{
	log_at(severity, "%s", text);
}

int window_open(struct window *w, const char *windows, struct device *device, char *error, size_t error_size)
{
	struct modbus_window parsed[MODBUS_WINDOWS_MAX];
	int n = parse(windows, parsed, error, error_size), rc;

	*w = (struct window){.device = device};
	if (n <= 0)
		return n;
	w->link = calloc(1, sizeof(*w->link));
	rc = w->link ? modbus_link_open(w->link) : -ENOMEM;
	if (rc < 0) {
		snprintf(error, error_size, "Modbus: %s", strerror(-rc));
		free(w->link);
		w->link = NULL;
		return rc;
	}
	modbus_link_publish(w->link, &device->values);
	const struct modbus_server_config config = {.windows = parsed,
		.count = (size_t)n,
		.link = w->link,
		.map = &imu9_modbus_map,
		.table = device->od.table,
		.abort_code = sdo_abort_code,
		.log = on_log};
	w->server = modbus_server_start(&config, error, error_size);
	if (w->server)
		return 0;
	window_close(w);
	return -EIO;
}

bool window_is_open(const struct window *w)
{
	return w->server;
}

int window_fd(const struct window *w)
{
	return w->link->request_fd;
}

/* ---- what clients write ------------------------------------------------------------------------------------------ */

static enum od_status on_write(void *ctx, uint16_t index, uint8_t sub, const void *wire, size_t size)
{
	struct device *d = ctx;

	return device_write(d, index, sub, wire, size, d->now_us);
}

/* A kind of line for each object: one that is written often does not hide the others. */
static void on_wrote(
	void *ctx, const char *who, const struct od_entry *entry, const void *wire, size_t size, enum od_status status)
{
	struct device *d = ctx;
	char text[TEXT_MAX];

	if (!wire || od_format(entry, wire, size, text, sizeof(text)) < 0)
		snprintf(text, sizeof(text), "%zu bytes", size);
	if (status == OD_OK || status == OD_PENDING)
		event_log_add_about(&d->log, d->now_us, entry->index, "Modbus, %s: %s = %.40s", who, entry->name, text);
	else
		event_log_add_about(&d->log, d->now_us, entry->index, "Modbus, %s: %s = %.40s refused: %s", who,
			entry->name, text, od_status_text(status));
}

void window_execute(struct modbus_link *link, struct device *device, uint64_t now_us)
{
	struct modbus_job *job = modbus_link_take(link);

	if (!job)
		return;
	device_tick(device, now_us); /* the services read the time of the last tick */
	modbus_execute(
		job, &imu9_modbus_map, &device->od, device->values.modbus.word_order, on_write, on_wrote, device);
	modbus_link_publish(link, &device->values);
	modbus_link_done(link);
}

/* ---- the loop ---------------------------------------------------------------------------------------------------- */

void window_serve(struct window *w, uint64_t now_us)
{
	window_execute(w->link, w->device, now_us);
}

static uint32_t read_counter(const atomic_uint *counter)
{
	return atomic_load_explicit(counter, memory_order_relaxed);
}

void window_publish(struct window *w)
{
	const struct modbus_counters *counters = modbus_server_counters(w->server);
	struct od_values *v = &w->device->values;

	v->modbus.clients = (uint8_t)read_counter(&counters->clients);
	v->modbus.requests = read_counter(&counters->requests);
	v->modbus.exceptions = read_counter(&counters->exceptions);
	v->modbus.writes = read_counter(&counters->writes);
	v->modbus.refused = read_counter(&counters->refused);
	v->modbus.malformed = read_counter(&counters->malformed);
	modbus_server_node_id(w->server, w->device->canopen.id);
	modbus_link_publish(w->link, v);
}

void window_saved(struct window *w, int result)
{
	modbus_link_ended(w->link, result == 0 ? OD_OK : OD_CANNOT_STORE);
}

void window_close(struct window *w)
{
	if (w->server)
		modbus_server_stop(w->server);
	if (w->link)
		modbus_link_close(w->link);
	free(w->link);
	*w = (struct window){0};
}
