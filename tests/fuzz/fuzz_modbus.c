/* Arbitrary bytes as requests of Modbus: a sequence of a length byte and a PDU each, to a dictionary with the values of
 * the EDS. A response is a response or an exception of its function within its size, a client that may not write
 * changes nothing, and at the end every value has the type and limits of its entry. The same bytes go through the
 * framing of a serial line and the options. */
#include <string.h>

#include "gateway/canopen/sdo_abort.h"
#include "gateway/modbus/access.h"
#include "gateway/modbus/options.h"
#include "gateway/modbus/rtu.h"
#include "tests/fuzz/fuzz.h"

enum { NODE_ID = 5, ERROR = 0x80 };

static struct od od;
static struct od_values values, before, initial;
static struct modbus_link link_;
static struct modbus_access writer, reader;

static void wrote(
	void *ctx, const char *who, const struct od_entry *entry, const void *wire, size_t size, enum od_status status)
{
	(void)ctx, (void)wire, (void)size;
	require(who && entry && status < OD_STATUS_COUNT);
}

static enum od_status write_value(void *ctx, uint16_t index, uint8_t sub, const void *wire, size_t size)
{
	(void)ctx;
	return od_write(&od, index, sub, wire, size);
}

static void serve(void *ctx)
{
	struct modbus_job *job = modbus_link_take(&link_);

	(void)ctx;
	require(job);
	modbus_execute(job, &imu9_modbus_map, &od, values.modbus.word_order, write_value, wrote, NULL);
	modbus_link_publish(&link_, &values);
	modbus_link_done(&link_);
}

/* In a copy of exactly its size, so that a read beyond it is found. */
static void request(struct modbus_access *access, const uint8_t *data, size_t size)
{
	uint8_t *exact = malloc(size), *response = malloc(MODBUS_PDU_MAX);

	memcpy(exact, data, size);
	size_t n = modbus_pdu(&access->registers, exact, size, response);
	require(n >= 2 && n <= MODBUS_PDU_MAX);
	require(response[0] == exact[0] || response[0] == (exact[0] | ERROR));
	if (response[0] & ERROR && !(exact[0] & ERROR) && response[1] != 0xFF)
		require(n == 2 && (response[1] >= 1 && response[1] <= 6));
	require(modbus_pdu_size(exact, size) >= -1);
	free(exact);
	free(response);
}

static void check_values(void)
{
	uint8_t wire[OD_VALUE_MAX];

	for (size_t i = 0; i < od.table->count; i++) {
		const struct od_entry *e = &od.table->entries[i];

		if (e->type != OD_DOMAIN && e->access & OD_WRITE)
			require(od_check(e, wire, od_get(&od, e, wire, sizeof(wire))) == OD_OK);
	}
}

static void frames(const uint8_t *data, size_t size)
{
	size_t used = size < MODBUS_RTU_MAX ? size : MODBUS_RTU_MAX, frame = 0;

	for (int silent = 0; silent < 2 && used > 0; silent++) {
		enum modbus_rtu_result result = modbus_rtu_next(data, used, data[0], silent, &frame);

		require(result == MODBUS_RTU_WAIT || result == MODBUS_RTU_BAD || (frame > 0 && frame <= used));
		result = modbus_rtu_next(data, used, (uint8_t)(data[0] + 1), silent, &frame);
		require(result != MODBUS_RTU_DROP || (frame > 0 && frame <= used));
	}
}

static void options(const uint8_t *data, size_t size)
{
	struct modbus_window window;
	char text[300], why[400];

	size = size < sizeof(text) - 1 ? size : sizeof(text) - 1;
	memcpy(text, data, size);
	text[size] = '\0';
	if (modbus_options_parse(&window, text, why, sizeof(why)) == 0)
		require(window.clients >= 1 && window.clients <= MODBUS_CLIENTS_MAX && window.rate >= 1 &&
			window.baud >= 1200);
	else
		require(why[0]);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	if (!od.table) {
		od_init(&od, &imu9_od_table, &values, NODE_ID);
		initial = values;
	}
	values = initial;
	modbus_link_direct(&link_, serve, NULL);
	modbus_access_init(&writer, &link_, &imu9_modbus_map, &imu9_od_table, "writer", true, sdo_abort_code);
	modbus_access_init(&reader, &link_, &imu9_modbus_map, &imu9_od_table, "reader", false, sdo_abort_code);
	writer.registers.node_id = reader.registers.node_id = NODE_ID;
	modbus_link_publish(&link_, &values);
	for (size_t at = 0; at + 1 < size;) {
		size_t n = data[at] < size - at - 1 ? data[at] : size - at - 1;

		if (n >= 1 && n <= MODBUS_PDU_MAX) {
			before = values;
			request(&reader, data + at + 1, n);
			require(memcmp(&before, &values, sizeof(values)) == 0);
			request(&writer, data + at + 1, n);
		}
		at += 1 + n;
	}
	if (memcmp(&initial, &values, sizeof(values)) != 0)
		check_values();
	frames(data, size);
	options(data, size);
	return 0;
}
