/* What imu9-fleet reads that others may have written. Arbitrary bytes as a file of the spool, as they are, and as
 * records whose CRC is right: what is read fits, in order, and both formats make messages of it that parse. And
 * arbitrary messages of the broker: only objects that are allowed are written, within their limits. */
#include <fcntl.h>
#include <json-c/json.h>
#include <string.h>

#include "od/little_endian.h"
#include "od_values.h"
#include "sparkplug_b.pb-c.h"
#include "tests/fuzz/fuzz_od.h"
#include "tools/fleet/format.h"
#include "tools/fleet/spool.h"
#include "tools/fleet/writes.h"

enum { NODE = 5, SECOND = 1000000, SPOOL_BYTES = 65536, HEADER = 20 };

static const struct od_table *tables[FLEET_NODES];
static struct format json, sparkplug;

/* ---- records ----------------------------------------------------------------------------------------------------- */

static long check_json(void *ctx, const struct message *message)
{
	struct json_tokener *tokener = json_tokener_new();

	(void)ctx;
	json_tokener_set_flags(tokener, JSON_TOKENER_VALIDATE_UTF8);
	struct json_object *document = json_tokener_parse_ex(tokener, message->payload, (int)message->size);
	require(document && json_object_is_type(document, json_type_object));
	require(strncmp(message->topic, "imu9/bus/", 9) == 0 && message->qos == 1);
	json_object_put(document);
	json_tokener_free(tokener);
	return 1;
}

static long check_sparkplug(void *ctx, const struct message *message)
{
	Sparkplug__Payload *payload = sparkplug__payload__unpack(NULL, message->size, message->payload);

	(void)ctx;
	require(payload && strncmp(message->topic, "spBv1.0/imu9/", 13) == 0);
	sparkplug__payload__free_unpacked(payload, NULL);
	return 1;
}

static void publish(const uint8_t *bytes, size_t size)
{
	static const struct publisher to_json = {NULL, check_json}, to_sparkplug = {NULL, check_sparkplug};
	static struct record record, again;
	uint8_t out[RECORD_MAX];

	if (record_decode(&record, bytes, size) < 0)
		return;
	require(record_encode(&record, out) == size);
	require(record_decode(&again, out, size) == 0 && record_encode(&again, out) == size);
	json.ops->record(&json, &to_json, &record, true);
	sparkplug.ops->record(&sparkplug, &to_sparkplug, &record, true);
}

/* ---- the spool --------------------------------------------------------------------------------------------------- */

static char folder[] = "/dev/shm/imu9-fuzz.XXXXXX";

static void write_file(const uint8_t *bytes, size_t size)
{
	char path[64];

	snprintf(path, sizeof(path), "%s/spool-01.seg", folder);
	int fd = open(path, O_WRONLY | O_CREAT | O_TRUNC, 0600);
	require(fd >= 0 && write(fd, bytes, size) == (ssize_t)size);
	close(fd);
}

static void remove_files(void)
{
	char path[64];

	for (int i = 0; i < SPOOL_SEGMENTS; i++) {
		snprintf(path, sizeof(path), "%s/spool-%02d.seg", folder, i);
		unlink(path);
	}
	snprintf(path, sizeof(path), "%s/spool.ack", folder);
	unlink(path);
}

/* Returns the number of records that are read. */
static unsigned read_spool(void)
{
	static struct spool spool;
	struct spool_position at, before = {0};
	uint8_t bytes[SPOOL_RECORD_MAX];
	unsigned count = 0;
	size_t size;

	require(spool_open(&spool, folder, SPOOL_BYTES) == 0);
	uint64_t expected = spool.records;
	while (spool_next(&spool, bytes, sizeof(bytes), &size, &at) > 0) {
		require(size > 0 && size <= sizeof(bytes));
		require(at.segment > before.segment || at.offset > before.offset);
		before = at;
		publish(bytes, size);
		spool_acked(&spool, at);
		count++;
	}
	require(count == expected && spool_is_empty(&spool));
	require(spool_append(&spool, "x", 1, &at) == 0); /* it goes on */
	spool_close(&spool);
	remove_files();
	return count;
}

/* The input as records, each behind its length. */
static void spool_records(struct input *in)
{
	static struct spool spool;
	struct spool_position at;
	uint8_t bytes[256];
	unsigned count = 0;

	require(spool_open(&spool, folder, SPOOL_BYTES) == 0);
	while (in->size > 1) {
		size_t size = read_byte(in);

		size = size == 0 ? 1 : size;
		read_bytes(in, bytes, size);
		require(spool_append(&spool, bytes, size, &at) == 0);
		count++;
	}
	spool_close(&spool);
	require(read_spool() == count);
}

/* ---- commands ---------------------------------------------------------------------------------------------------- */

static struct fleet fleet;
static struct writes writes;
static unsigned answers, requests;

static int port_send(struct can_port *port, const struct can_msg *msg)
{
	(void)port;
	require(msg->id == 0x600 + NODE && msg->len == 8);
	require(msg->data[0] == 0x23 && get_u16(msg->data + 1) == 0x2000 && msg->data[3] >= 1 && msg->data[3] <= 3);
	float value;
	memcpy(&value, msg->data + 4, sizeof(value));
	require(value >= -10 && value <= 10); /* the limits of the EDS */
	requests++;
	return 0;
}

static void on_record(void *ctx, const struct record *record)
{
	(void)ctx;
	if (record->kind != RECORD_ANSWER)
		return;
	struct json_object *answer = json_tokener_parse(record->text);
	require(answer != NULL);
	json_object_put(answer);
	answers++;
}

static void on_command(void *ctx, const struct command *command)
{
	(void)ctx;
	require(memchr(command->object, 0, sizeof(command->object)) &&
		memchr(command->value, 0, sizeof(command->value)));
	if (command->kind == COMMAND_WRITE)
		writes_submit(&writes, &fleet, command, SECOND, 0);
	fleet_tick(&fleet, SECOND, 0);
}

static void receive(const uint8_t *payload, size_t size)
{
	static const struct can_ops ops = {.send = port_send};
	static const struct fleet_sink sink = {NULL, on_record};
	static struct fleet_config config;
	struct can_port bus = {.ops = &ops, .fd = -1};
	const uint8_t operational = 5;
	struct can_msg heartbeat = {.id = 0x700 + NODE, .len = 1, .data = {operational}};

	memcpy(config.tables, tables, sizeof(tables));
	config.passive = true; /* so that it does not read the mapping */
	fleet_init(&fleet, &config, &bus, &sink, SECOND);
	fleet_receive(&fleet, &heartbeat, SECOND, 0);
	fleet_node(&fleet, NODE)->watch.passive = false;
	writes = (struct writes){.allowed = {{0x2000, -1}}, .allowed_count = 1, .bus = "bus"};
	json.ops->command(&json.config, "imu9/bus/5/write", payload, size, on_command, NULL);
	sparkplug.ops->command(&sparkplug.config, "spBv1.0/imu9/DCMD/bus/5", payload, size, on_command, NULL);
	sparkplug.ops->command(&sparkplug.config, "spBv1.0/imu9/NCMD/bus", payload, size, on_command, NULL);
	fleet_free(&fleet);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct input in = {data, size};
	static bool made;

	if (!made) {
		made = true;
		require(mkdtemp(folder) != NULL);
		for (int id = 1; id < FLEET_NODES; id++)
			tables[id] = &imu9_od_table;
	}
	const struct format_config config = {.prefix = "imu9", .bus = "bus", .tables = tables};
	format_init(&json, &format_json, &config, 0);
	format_init(&sparkplug, &format_sparkplug, &config, 0);
	switch (read_byte(&in) % 3) {
	case 0:
		write_file(in.data, in.size);
		read_spool();
		break;
	case 1:
		spool_records(&in);
		break;
	default:
		receive(in.data, in.size);
		break;
	}
	return 0;
}
