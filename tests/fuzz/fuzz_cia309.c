/* Arbitrary text from a client of CiA 309-3. Checked: each line has one answer, which ends with CR LF; the frames
 * sent are those of a master; a value that was read is the same after it was printed. */
#include <string.h>

#include "gateway/cia309/cia309.h"
#include "od_values.h"
#include "tests/fuzz/fuzz.h"

enum { NODE_ID = 5, TICKS_MAX = 2000 };

/* A copy of the initial one, for each run: the start of a node takes longer than most runs. */
static struct device {
	struct canopen_node node;
	struct cia309 gateway;
	struct od od;
	struct od_values values;
	struct can_port bus;
} now, initial;

static int port_send(struct can_port *port, const struct can_msg *msg)
{
	(void)port;
	require(msg->len <= 8 && !msg->extended && !msg->remote);
	if (msg->id == 0x080 + NODE_ID) /* EMCY: a PDO of a wrong length or value */
		return 0;
	require((msg->id == 0 && msg->len == 2 && msg->data[1] != NODE_ID) || msg->id == 0x7E4 || msg->id == 0x7E5 ||
		(msg->id > 0x600 && msg->id <= 0x67F && msg->id != 0x600 + NODE_ID) || msg->id == 0x700 + NODE_ID);
	return 0;
}

static int port_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port, (void)ids;
	require(n > 0);
	return 0;
}

static void receive(void *ctx, const struct can_msg *msg, uint64_t now_us)
{
	(void)ctx;
	canopen_receive(&now.node, msg, now_us);
}

static enum od_status write_object(
	void *ctx, uint16_t index, uint8_t sub, const void *wire, size_t size, uint64_t now_us)
{
	(void)ctx;
	return canopen_write(&now.node, index, sub, wire, size, now_us);
}

static void log_change(
	void *ctx, unsigned number, const char *who, const char *command, const char *answer, uint64_t now_us)
{
	(void)ctx, (void)number, (void)answer, (void)now_us;
	require(strcmp(who, "fuzzer") == 0);
	for (; *command; command++)
		require(*command >= ' ' && *command <= '~');
}

/* The line's value, printed and read again. */
static void check_value(const char *line, size_t length)
{
	static uint8_t bytes[4096], back[sizeof(bytes)];
	static char text[4 * sizeof(bytes)];
	struct cia309_command c;
	size_t n = 0;

	if (cia309_parse(line, length, &c) != CIA309_OK || c.verb != CIA309_WRITE)
		return;
	long size = cia309_scan(c.type, c.value, c.value_length, bytes, sizeof(bytes));
	require(size <= (long)sizeof(bytes));
	if (size < 0 || c.type->form == CIA309_STRING) /* CR and NUL are not printed */
		return;
	struct cia309_printer p = {.type = c.type, .bytes = bytes, .size = (size_t)size};
	while (!cia309_printed(&p))
		n += cia309_print(&p, text + n, CIA309_PRINT_MIN);
	if (size > 0)
		require(cia309_scan(c.type, text, n, back, sizeof(back)) == size &&
			memcmp(bytes, back, (size_t)size) == 0);
}

static size_t count(const char *text, size_t n, char c)
{
	size_t found = 0;

	for (size_t i = 0; i < n; i++)
		found += text[i] == c;
	return found;
}

static void power_on(void)
{
	static const struct can_ops ops = {.send = port_send, .filter = port_filter};
	static const struct cia309_device device = {.receive = receive, .write = write_object, .log = log_change};

	now.bus = (struct can_port){.ops = &ops, .fd = -1};
	od_init(&now.od, &imu9_od_table, &now.values, NODE_ID);
	require(canopen_init(&now.node, &now.od, &now.bus, NULL, NODE_ID) == 0);
	canopen_start(&now.node, 1);
	cia309_init(&now.gateway, &device, &now.node, &now.bus);
	initial = now;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	const char *text = (const char *)data;
	size_t lines = count(text, size, '\n'), answers = 0;
	uint64_t now_us = 1;

	if (!initial.bus.ops)
		power_on();
	now = initial;
	for (size_t i = 0; i < size;) {
		const char *lf = memchr(text + i, '\n', size - i);
		size_t length = lf ? (size_t)(lf - text) - i : size - i;

		check_value(text + i, length);
		i += length + 1;
	}
	struct cia309_session *s = cia309_open(&now.gateway, "fuzzer", true);
	for (int tick = 0; tick < TICKS_MAX && answers < lines; tick++) {
		size_t room = cia309_room(s), n = size < room ? size : room;

		if (n > 0)
			cia309_input(s, (const char *)data, n);
		data += n;
		size -= n;
		uint64_t next_us = canopen_tick(&now.node, now_us), due_us = cia309_tick(&now.gateway, now_us);
		const char *out = cia309_output(s, &n);
		answers += count(out, n, '\r');
		require(n == 0 || count(out, n, '\r') <= count(out, n, '\n'));
		if (cia309_closing(s))
			return 0;
		if (n > 0)
			due_us = 0;
		cia309_sent(s, n);
		if (due_us < next_us)
			next_us = due_us;
		now_us = next_us > now_us ? next_us : now_us + (n > 0);
	}
	require(answers <= lines);
	require(lines > 10 || answers == lines); /* a search over all nodes takes long */
	cia309_close(&now.gateway, s);
	return 0;
}
