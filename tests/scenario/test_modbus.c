/* The dictionary through Modbus: the map of registers over a whole device in simulated time. The oracle for values is
 * the same device over CAN: PDOs and SDO. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/canopen/sdo_abort.h"
#include "gateway/log.h"
#include "gateway/window.h"
#include "od/little_endian.h"
#include "tests/scenario/world.h"

enum { INTEGERS = 0, REALS = 100, AT_LEVER_ARM = 0x1000, AT_MODEL = 0x1040, AT_LEVER_ARM_UM = 0x1100 };
enum { WORD_ORDER = 0x1000 + 0x150 * 64, FILTER = 0x1000 + 0x10 * 64, POSITION = 0x1000 + 0x40 * 64 };
enum { COIL_RESET_POSITION = 0, COIL_STORE = 1 };

/* A device with a window that needs no thread. */
struct fixture {
	struct world world;
	struct modbus_link link;
	struct modbus_access access;
};

static void serve(void *ctx)
{
	struct fixture *f = ctx;

	window_execute(&f->link, &f->world.device, f->world.now_us);
}

static void attach(struct fixture *f)
{
	modbus_link_direct(&f->link, serve, f);
	modbus_access_init(
		&f->access, &f->link, &imu9_modbus_map, &imu9_od_table, "192.0.2.1:4711", true, sdo_abort_code);
	f->access.registers.node_id = WORLD_NODE_ID;
	modbus_link_publish(&f->link, &f->world.device.values);
}

static struct fixture *new_fixture(void)
{
	struct fixture *f = calloc(1, sizeof(*f));

	assert_non_null(f);
	world_init(&f->world, sensor_preset("ideal"), 1, "tumble");
	world_power_on(&f->world, NULL);
	world_seconds(&f->world, 3);
	world_nmt(&f->world, 1);
	attach(f);
	return f;
}

static int set_up(void **state)
{
	*state = new_fixture();
	return 0;
}

static void pass(struct fixture *f, double seconds)
{
	world_seconds(&f->world, seconds);
	modbus_link_publish(&f->link, &f->world.device.values);
}

/* ---- requests ---------------------------------------------------------------------------------------------------- */

static uint8_t response[MODBUS_PDU_MAX];

static size_t request(struct fixture *f, const uint8_t *bytes, size_t size)
{
	return modbus_pdu(&f->access.registers, bytes, size, response);
}

/* The exception of the response, or 0. */
static unsigned exception(size_t size)
{
	return size == 2 && response[0] & 0x80 ? response[1] : 0;
}

static uint16_t word(const uint8_t *at)
{
	return (uint16_t)(at[0] << 8 | at[1]);
}

static unsigned read_words(struct fixture *f, unsigned address, unsigned count, uint16_t *words)
{
	const uint8_t bytes[] = {3, (uint8_t)(address >> 8), (uint8_t)address, 0, (uint8_t)count};
	size_t size = request(f, bytes, sizeof(bytes));

	for (unsigned i = 0; size == 2 + 2 * count && i < count; i++)
		words[i] = word(response + 2 + (size_t)2 * i);
	return exception(size);
}

static unsigned write_words(struct fixture *f, unsigned address, unsigned count, const uint16_t *words)
{
	uint8_t bytes[MODBUS_PDU_MAX] = {
		16, (uint8_t)(address >> 8), (uint8_t)address, 0, (uint8_t)count, (uint8_t)(2 * count)};

	for (unsigned i = 0; i < count; i++) {
		bytes[6 + 2 * i] = (uint8_t)(words[i] >> 8);
		bytes[7 + 2 * i] = (uint8_t)words[i];
	}
	return exception(request(f, bytes, 6 + (size_t)2 * count));
}

static unsigned write_coil(struct fixture *f, unsigned address, bool on)
{
	const uint8_t bytes[] = {5, (uint8_t)(address >> 8), (uint8_t)address, on ? 0xFF : 0, 0};

	return exception(request(f, bytes, sizeof(bytes)));
}

static float real(const uint16_t *words)
{
	uint32_t bits = (uint32_t)words[0] << 16 | words[1];
	float value;

	memcpy(&value, &bits, sizeof(value));
	return value;
}

static void put_real(uint16_t *words, float value)
{
	uint32_t bits;

	memcpy(&bits, &value, sizeof(bits));
	words[0] = (uint16_t)(bits >> 16);
	words[1] = (uint16_t)bits;
}

static int16_t i16(const struct can_msg *msg, unsigned n)
{
	return (int16_t)get_u16(msg->data + (size_t)2 * n);
}

/* ---- the sample -------------------------------------------------------------------------------------------------- */

static void test_the_block_of_integers_is_what_the_pdos_of_its_counter_have(void **state)
{
	struct fixture *f = *state;
	uint16_t words[45];

	for (int k = 0; k < 50; k++) {
		pass(f, 0.01);
		world_receive(&f->world, 0x080, 0, NULL);
		const struct can_msg *acceleration = world_last(&f->world, 0x180 + WORLD_NODE_ID);
		const struct can_msg *angles = world_last(&f->world, 0x280 + WORLD_NODE_ID);
		const struct can_msg *position = world_last(&f->world, 0x380 + WORLD_NODE_ID);
		const struct can_msg *status = world_last(&f->world, 0x480 + WORLD_NODE_ID);
		assert_int_equal(read_words(f, INTEGERS, 45, words), 0);
		assert_int_equal(words[0], (uint16_t)i16(acceleration, 3));
		assert_int_equal(words[0], (uint16_t)i16(status, 1));
		assert_int_equal((uint32_t)words[1] << 16 | words[2], get_u32(status->data + 4));
		assert_int_equal(words[3], (uint16_t)i16(status, 0));
		for (unsigned i = 0; i < 3; i++) {
			assert_int_equal((int16_t)words[4 + i], i16(acceleration, i));
			assert_int_equal((int16_t)words[7 + i], i16(angles, i));
			assert_int_equal((int16_t)words[10 + i], i16(position, i));
		}
	}
}

static void test_the_block_of_reals_has_the_values_of_the_same_sample(void **state)
{
	struct fixture *f = *state;
	const struct od_values *v = &f->world.device.values;
	uint16_t words[102];

	pass(f, 1);
	assert_int_equal(read_words(f, REALS, 102, words), 0);
	assert_int_equal(words[0], v->sample.counter);
	assert_true(real(words + 4) == v->acceleration_object.l);
	assert_true(real(words + 14) == v->angles_deg.yaw);
	assert_true(real(words + 20) == v->position_m.z);
	assert_true(real(words + 28) == v->quaternion.w);
	assert_true(real(words + 100) == v->displacement_sigma.z);
	assert_true(fabsf(real(words + 4)) + fabsf(real(words + 6)) > 0);
}

static void test_a_request_sees_the_sample_that_was_published_and_no_half_of_the_next(void **state)
{
	struct fixture *f = *state;
	uint16_t before[45], after[45];

	pass(f, 0.01);
	assert_int_equal(read_words(f, INTEGERS, 45, before), 0);
	world_seconds(&f->world, 0.5); /* the loop goes on, and does not publish */
	assert_int_equal(read_words(f, INTEGERS, 45, after), 0);
	assert_memory_equal(before, after, sizeof(before));
	pass(f, 0.01);
	assert_int_equal(read_words(f, INTEGERS, 45, after), 0);
	assert_int_equal((uint16_t)(after[0] - before[0]), 51);
}

/* ---- the map ----------------------------------------------------------------------------------------------------- */

/* The object of 2000h at 1000h + 64 * (index - 2000h), those of 6000h at 8000h + 16 * (index - 6000h). */
static void test_every_readable_entry_is_where_its_index_says(void **state)
{
	struct fixture *f = *state;
	unsigned address = 0, seen = 0;
	uint16_t last = 0;

	for (size_t i = 0; i < imu9_od_table.count; i++) {
		const struct od_entry *e = &imu9_od_table.entries[i];
		bool record = e->sub == 0 && i + 1 < imu9_od_table.count && e[1].index == e->index;
		uint16_t words[OD_VALUE_MAX / 2];
		uint8_t wire[OD_VALUE_MAX] = {0};

		if (e->index < 0x2000 || e->type == OD_DOMAIN || record)
			continue;
		if (e->index != last)
			address = e->index < 0x6000 ? 0x1000u + 64 * (e->index - 0x2000u)
						    : 0x8000u + 16 * (e->index - 0x6000u);
		last = e->index;
		unsigned count = (e->size + 1u) / 2;
		unsigned refused = read_words(f, address, count, words);
		address += count;
		if (!(e->access & OD_READ)) {
			assert_int_equal(refused, 2);
			continue;
		}
		assert_int_equal(refused, 0);
		seen++;
		od_get(&f->world.device.od, e, wire, sizeof(wire));
		if (e->type == OD_VISIBLE_STRING || e->type == OD_OCTET_STRING)
			continue;
		if (e->type == OD_INTEGER8)
			assert_int_equal((int16_t)words[0], (int8_t)wire[0]);
		else
			for (unsigned k = 0; k < count; k++)
				assert_int_equal(words[count - 1 - k], get_u16(wire + (size_t)2 * k));
	}
	assert_true(seen > 300);
}

static void test_what_is_not_in_the_map_is_exception_2(void **state)
{
	struct fixture *f = *state;
	uint16_t words[125];

	assert_int_equal(read_words(f, 45, 1, words), 2);
	assert_int_equal(read_words(f, 0, 46, words), 2);
	assert_int_equal(read_words(f, AT_LEVER_ARM, 7, words), 2);
	assert_int_equal(read_words(f, 0xFFFF, 1, words), 2);
	assert_int_equal(write_words(f, 45, 1, words), 2);
}

static void test_a_part_of_a_value_can_be_read_but_not_written(void **state)
{
	struct fixture *f = *state;
	uint16_t words[6], part[2];

	put_real(words, 0.05f);
	put_real(words + 2, -0.25f);
	put_real(words + 4, 0.125f);
	assert_int_equal(write_words(f, AT_LEVER_ARM, 6, words), 0);
	assert_int_equal(read_words(f, AT_LEVER_ARM + 1, 2, part), 0);
	assert_int_equal(part[0], words[1]);
	assert_int_equal(part[1], words[2]);
	assert_int_equal(write_words(f, AT_LEVER_ARM, 1, words), 2);
	assert_int_equal(write_words(f, AT_LEVER_ARM, 3, words), 2);
	assert_int_equal(write_words(f, AT_LEVER_ARM + 1, 2, words), 2);
	assert_true(f->world.device.values.lever_arm.s == -0.25f);
}

static void test_the_word_order_is_an_object(void **state)
{
	struct fixture *f = *state;
	uint16_t words[6] = {0};

	put_real(words, 0.05f);
	assert_int_equal(write_words(f, AT_LEVER_ARM, 6, words), 0);
	assert_int_equal(write_words(f, WORD_ORDER, 1, (uint16_t[]){1}), 0);
	assert_int_equal(read_words(f, AT_LEVER_ARM, 2, words), 0);
	assert_int_equal(words[0], 0xCCCD);
	assert_int_equal(words[1], 0x3D4C);
	assert_int_equal(write_words(f, AT_LEVER_ARM, 2, (uint16_t[]){0x0000, 0x3F00}), 0);
	assert_true(f->world.device.values.lever_arm.l == 0.5f);
	assert_int_equal(write_words(f, WORD_ORDER, 1, (uint16_t[]){2}), 3);
}

/* ---- configuration ----------------------------------------------------------------------------------------------- */

static void test_a_written_lever_arm_is_used_from_the_next_sample_on_as_by_sdo(void **state)
{
	struct fixture *f = *state;
	struct world *other = world_new(sensor_preset("ideal"), 1, "tumble");
	uint16_t words[2];
	float l = 0.5f;

	world_seconds(other, 3);
	world_nmt(other, 1);
	put_real(words, l);
	assert_int_equal(write_words(f, AT_LEVER_ARM, 2, words), 0);
	assert_int_equal(world_sdo_write(other, 0x2000, 1, &l, 4), 0);
	for (int k = 0; k < 20; k++) {
		world_sample(&f->world);
		world_sample(other);
		world_receive(&f->world, 0x080, 0, NULL);
		world_receive(other, 0x080, 0, NULL);
		assert_memory_equal(world_last(&f->world, 0x180 + WORLD_NODE_ID)->data,
			world_last(other, 0x180 + WORLD_NODE_ID)->data, 8);
	}
	free(other);
}

static void test_limits_and_access_are_those_of_sdo_and_the_old_value_remains(void **state)
{
	struct fixture *f = *state;
	uint16_t words[2], old = f->world.device.values.lever_arm_model;

	assert_int_equal(write_words(f, AT_MODEL, 1, (uint16_t[]){9}), 3);
	assert_int_equal(write_words(f, AT_MODEL, 1, (uint16_t[]){0x0101}), 3); /* not its lower byte */
	assert_int_equal(f->world.device.values.lever_arm_model, old);
	put_real(words, 11); /* the limit is 10 m */
	assert_int_equal(write_words(f, AT_LEVER_ARM, 2, words), 3);
	put_real(words, NAN);
	assert_int_equal(write_words(f, AT_LEVER_ARM, 2, words), 3);
	assert_true(f->world.device.values.lever_arm.l == 0);
	assert_int_equal(write_words(f, INTEGERS, 1, (uint16_t[]){1}), 2);
	assert_int_equal(write_words(f, 0x1000 + 0x100 * 64, 1, (uint16_t[]){1}), 2);
}

static void test_several_values_are_written_all_or_none(void **state)
{
	struct fixture *f = *state;
	uint16_t words[6];

	put_real(words, 0.1f);
	put_real(words + 2, 0.2f);
	put_real(words + 4, 11);
	assert_int_equal(write_words(f, AT_LEVER_ARM, 6, words), 3);
	assert_true(f->world.device.values.lever_arm.l == 0 && f->world.device.values.lever_arm.s == 0);
	put_real(words + 4, 0.3f);
	assert_int_equal(write_words(f, AT_LEVER_ARM, 6, words), 0);
	assert_true(f->world.device.values.lever_arm.t == 0.3f);
}

static enum od_status refuse_t(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	(void)ctx, (void)wire, (void)size;
	return entry->sub == 3 ? OD_LOCAL_CONTROL : OD_OK;
}

static void test_a_service_that_refuses_one_value_leaves_all_as_they_were(void **state)
{
	struct fixture *f = *state;
	struct od_hook hook = {.first = 0x2000, .last = 0x2000, .before = refuse_t};
	uint16_t words[6];

	put_real(words, 0.1f);
	put_real(words + 2, 0.2f);
	put_real(words + 4, 0.3f);
	assert_int_equal(write_words(f, AT_LEVER_ARM, 4, words), 0);
	od_attach(&f->world.device.od, &hook);
	put_real(words, 0.7f);
	put_real(words + 2, 0.8f);
	assert_int_equal(write_words(f, AT_LEVER_ARM, 6, words), 6);
	assert_true(f->world.device.values.lever_arm.l == 0.1f && f->world.device.values.lever_arm.s == 0.2f);
	assert_int_equal(f->world.device.values.lever_arm_in_um.l, 100000);
}

static void test_the_lever_arm_in_micrometres_is_written_at_once(void **state)
{
	struct fixture *f = *state;
	const uint16_t words[6] = {0x0000, 0xC350, 0xFFFF, 0x3CB0, 0, 1}; /* 50000, -50000, 1 */

	assert_int_equal(write_words(f, AT_LEVER_ARM_UM, 6, words), 0);
	assert_near(f->world.device.values.lever_arm.l, 0.05, 1e-9);
	assert_near(f->world.device.values.lever_arm.s, -0.05, 1e-9);
	assert_near(f->world.device.values.lever_arm.t, 1e-6, 1e-12);
}

static void test_a_mask_write_is_one_write_of_the_register(void **state)
{
	struct fixture *f = *state;
	const uint8_t set_2_of_0_and_1[] = {22, 0x10, 0x40, 0xFF, 0xFC, 0x00, 0x02};
	const uint8_t set_all[] = {22, 0x10, 0x40, 0x00, 0x00, 0xFF, 0xFF}, nowhere[] = {22, 0xFF, 0xFF, 0, 0, 0, 0};

	assert_int_equal(write_words(f, AT_MODEL, 1, (uint16_t[]){1}), 0);
	assert_int_equal(request(f, set_2_of_0_and_1, 7), 7);
	assert_int_equal(f->world.device.values.lever_arm_model, 2);
	assert_int_equal(exception(request(f, set_all, 7)), 3);
	assert_int_equal(f->world.device.values.lever_arm_model, 2);
	assert_int_equal(exception(request(f, nowhere, 7)), 2);
}

static void test_a_client_reads_at_once_what_it_wrote(void **state)
{
	struct fixture *f = *state;
	const uint8_t both[] = {23, 0x10, 0x00, 0, 2, 0x10, 0x00, 0, 2, 4, 0x3F, 0x00, 0x00, 0x00};

	assert_int_equal(request(f, both, sizeof(both)), 6);
	assert_memory_equal(response + 2, both + 10, 4);
}

static void test_values_are_stored_by_1010h_as_any(void **state)
{
	struct fixture *f = *state;
	uint16_t words[2];

	put_real(words, 0.5f);
	assert_int_equal(write_words(f, AT_LEVER_ARM, 2, words), 0);
	assert_int_equal(write_coil(f, COIL_STORE, true), 0);
	world_power_on(&f->world, NULL);
	assert_true(f->world.device.values.lever_arm.l == 0.5f);
	f->world.disk_answer = -5;
	assert_int_equal(write_coil(f, COIL_STORE, true), 4);
}

/* ---- bits -------------------------------------------------------------------------------------------------------- */

static void test_discrete_inputs_are_the_bits_of_the_status_and_the_error_register(void **state)
{
	struct fixture *f = *state;
	const uint8_t all[] = {2, 0, 0, 0, 24}, beyond[] = {2, 0, 0, 0, 25};

	canopen_error_set(&f->world.device.canopen, 0xFF00, 0x80, NULL, f->world.now_us);
	pass(f, 0.01);
	assert_int_equal(request(f, all, 5), 5);
	assert_int_equal(get_u16(response + 2), f->world.device.values.sample.status);
	assert_int_equal(response[4], 0x81);
	assert_int_equal(exception(request(f, beyond, 5)), 2);
}

static void test_a_command_is_a_coil_that_reads_0(void **state)
{
	struct fixture *f = *state;
	const uint8_t read[] = {1, 0, 0, 0, 4};

	pass(f, 2);
	assert_true(f->world.device.values.position_m.x != 0);
	assert_int_equal(write_coil(f, COIL_RESET_POSITION, false), 0);
	assert_true(f->world.device.values.position_m.x != 0);
	float before = f->world.device.values.position_m.x;
	assert_int_equal(write_coil(f, COIL_RESET_POSITION, true), 0);
	pass(f, 0.01);
	assert_true(fabsf(f->world.device.values.position_m.x) < fabsf(before) / 10);
	assert_int_equal(request(f, read, 5), 3);
	assert_int_equal(response[2], 0);
	assert_int_equal(write_coil(f, 4, true), 2);
}

static void test_a_value_of_0_and_1_is_a_coil_at_its_register(void **state)
{
	struct fixture *f = *state;
	const uint8_t read[] = {1, WORD_ORDER >> 8, (uint8_t)WORD_ORDER, 0, 1};

	assert_int_equal(write_coil(f, WORD_ORDER, true), 0);
	assert_int_equal(f->world.device.values.modbus.word_order, 1);
	assert_int_equal(request(f, read, 5), 3);
	assert_int_equal(response[2], 1);
	assert_int_equal(write_coil(f, WORD_ORDER, false), 0);
	assert_int_equal(f->world.device.values.modbus.word_order, 0);
}

static void test_of_several_commands_none_is_executed(void **state)
{
	struct fixture *f = *state;
	const uint8_t two[] = {15, 0, 8, 0, 2, 1, 3}, one[] = {15, 0, 8, 0, 2, 1, 1};

	assert_int_equal(exception(request(f, two, sizeof(two))), 3);
	assert_int_equal(f->world.device.values.lever_arm_identification.state, 0);
	assert_int_equal(request(f, one, sizeof(one)), 5);
	pass(f, 0.1);
	assert_int_equal(f->world.device.values.lever_arm_identification.state, 1);
}

/* ---- 43/13 ------------------------------------------------------------------------------------------------------- */

static size_t read_object(struct fixture *f, uint16_t index, uint8_t sub, unsigned offset, unsigned count)
{
	const uint8_t bytes[] = {0x2B, 0x0D, 0, WORLD_NODE_ID, (uint8_t)(index >> 8), (uint8_t)index, sub,
		(uint8_t)(offset >> 8), (uint8_t)offset, (uint8_t)(count >> 8), (uint8_t)count};

	return request(f, bytes, sizeof(bytes));
}

static void test_every_object_is_read_by_function_43_13_as_by_sdo(void **state)
{
	struct fixture *f = *state;
	uint8_t wire[OD_VALUE_MAX];
	size_t size;

	for (size_t i = 0; i < imu9_od_table.count; i++) {
		const struct od_entry *e = &imu9_od_table.entries[i];
		enum od_status status = od_read(&f->world.device.od, e->index, e->sub, wire, sizeof(wire), &size);

		if (e->type == OD_DOMAIN || (e->index == 0x1003 && e->sub > 0))
			continue;
		size_t got = read_object(f, e->index, e->sub, 0, 0xFFFF);
		if (status) {
			assert_int_equal(response[0], 0xAB);
			continue;
		}
		assert_int_equal(got, 11 + size);
		assert_memory_equal(response + 11, wire, size);
	}
	/* the history is empty: 08000024h, no data available */
	assert_int_equal(read_object(f, 0x1003, 1, 0, 8), 10);
	assert_memory_equal(response, "\xAB\xFF\x00\x06\x0D\xEC\x08\x00\x00\x24", 10);
}

static void test_the_eds_is_read_in_parts(void **state)
{
	struct fixture *f = *state;
	size_t done = 0, n;

	do {
		n = read_object(f, 0x1021, 0, (unsigned)done, 242) - 11;
		assert_memory_equal(response + 11, imu9_eds + done, n);
		done += n;
	} while (n > 0 && done < 0xFF00);
	assert_true(done >= 0xFF00 || done == imu9_eds_size);
}

static void test_an_object_that_changes_is_read_as_of_its_first_part(void **state)
{
	struct fixture *f = *state;
	uint8_t first[40];

	assert_int_equal(read_object(f, 0x2131, 0, 0, 40), 11 + 40);
	memcpy(first, response + 11, 40);
	world_nmt(&f->world, 2);
	for (int i = 0; i < 200; i++)
		event_log_add_about(&f->world.device.log, f->world.now_us, (unsigned)i, "line %d of the log", i);
	assert_int_equal(read_object(f, 0x2131, 0, 20, 20), 11 + 20);
	assert_memory_equal(response + 11, first + 20, 20);
}

/* The server gives up after a second: 08000022h. */
static void be_busy(void *ctx)
{
	struct fixture *f = ctx;

	modbus_link_take(&f->link)->status = OD_DEVICE_STATE;
	modbus_link_done(&f->link);
}

static void test_a_long_object_is_not_read_while_the_loop_is_busy(void **state)
{
	struct fixture *f = *state;

	f->link.serve = be_busy;
	assert_int_equal(read_object(f, 0x2131, 0, 0, 40), 10);
	assert_memory_equal(response, "\xAB\xFF\x00\x06\x0D\xEC\x08\x00\x00\x22", 10);
	f->link.serve = serve;
	assert_int_equal(read_object(f, 0x2131, 0, 20, 20), 11 + 20); /* from its beginning */
}

static void test_objects_are_written_by_function_43_13_with_the_aborts_of_sdo(void **state)
{
	struct fixture *f = *state;
	const uint8_t good[] = {0x2B, 0x0D, 1, WORLD_NODE_ID, 0x10, 0x17, 0, 0, 0, 0, 2, 0xF4, 0x01};
	const uint8_t high[] = {0x2B, 0x0D, 1, WORLD_NODE_ID, 0x20, 0x01, 0, 0, 0, 0, 1, 9};

	assert_int_equal(request(f, good, sizeof(good)), 11);
	assert_int_equal(f->world.device.values.producer_heartbeat_time, 500);
	assert_int_equal(request(f, high, sizeof(high)), 10);
	assert_memory_equal(response, "\xAB\xFF\x00\x06\x0D\xEC\x06\x09\x00\x31", 10);
}

/* ---- who wrote --------------------------------------------------------------------------------------------------- */

static void test_the_event_log_tells_who_wrote_what(void **state)
{
	struct fixture *f = *state;
	char text[sizeof(f->world.device.log.text) + 1] = {0};

	assert_int_equal(write_words(f, AT_MODEL, 1, (uint16_t[]){1}), 0);
	assert_int_equal(write_words(f, AT_MODEL, 1, (uint16_t[]){9}), 3);
	memcpy(text, f->world.device.log.text, f->world.device.log.used);
	assert_non_null(strstr(text, "Modbus, 192.0.2.1:4711: lever_arm_model = 1\n"));
	assert_non_null(
		strstr(text, "Modbus, 192.0.2.1:4711: lever_arm_model = 9 refused: value above its high limit\n"));
}

static void test_identification_is_that_of_the_device(void **state)
{
	struct fixture *f = *state;
	const uint8_t all[] = {0x2B, 0x0E, 3, 0};
	size_t size = request(f, all, sizeof(all));

	assert_int_equal(response[6], 7);
	assert_non_null(memmem(response, size, "IMU9 CANopen gateway", 20));
}

/* ---- a day ------------------------------------------------------------------------------------------------------- */

/* What the dictionary has to have, kept without it. */
struct model {
	float arm[3];
	uint8_t lever_arm_model, rates_from, word_order;
};

struct day {
	struct fixture *f;
	struct model now, stored;
	unsigned seed, refused;
};

static unsigned roll(struct day *day, unsigned sides)
{
	return (unsigned)rand_r(&day->seed) % sides;
}

/* Within the limits of 10 m three times of four. */
static float some_metres(struct day *day)
{
	float metres = (float)roll(day, 10000) / 1000;

	return (roll(day, 2) ? 1.0f : -1.0f) * (roll(day, 4) ? metres : metres + 10.5f);
}

static void put_arm(const struct day *day, uint16_t *words, float value)
{
	put_real(words, value);
	if (day->now.word_order) {
		uint16_t first = words[0];

		words[0] = words[1];
		words[1] = first;
	}
}

static void write_arm(struct day *day, bool modbus)
{
	uint16_t words[6];
	float arm[3];
	bool good = true;

	for (unsigned i = 0; i < 3; i++) {
		arm[i] = some_metres(day);
		put_arm(day, words + (size_t)2 * i, arm[i]);
		bool fits = fabsf(arm[i]) <= 10;
		if (!modbus && fits)
			day->now.arm[i] = arm[i];
		if (!modbus)
			assert_int_equal(
				world_sdo_write(&day->f->world, 0x2000, (uint8_t)(i + 1), &arm[i], 4) == 0, fits);
		good = good && fits;
	}
	if (modbus)
		assert_int_equal(write_words(day->f, AT_LEVER_ARM, 6, words), good ? 0 : 3);
	if (modbus && good)
		memcpy(day->now.arm, arm, sizeof(arm));
	day->refused += !good;
}

static void write_model(struct day *day, unsigned how)
{
	uint8_t value = (uint8_t)roll(day, 6);
	const uint8_t object[] = {0x2B, 0x0D, 1, WORLD_NODE_ID, 0x20, 0x01, 0, 0, 0, 0, 1, value};
	bool good = value <= 3;

	if (how == 0)
		assert_int_equal(write_words(day->f, AT_MODEL, 1, (uint16_t[]){value}), good ? 0 : 3);
	else if (how == 1)
		assert_int_equal(request(day->f, object, sizeof(object)), good ? 11 : 10);
	else
		assert_int_equal(world_sdo_write(&day->f->world, 0x2001, 0, &value, 1) == 0, good);
	if (good)
		day->now.lever_arm_model = value;
	day->refused += !good;
}

static void act(struct day *day)
{
	bool on = roll(day, 2);

	switch (roll(day, 8)) {
	case 0:
		write_arm(day, false);
		break;
	case 1:
	case 2:
		write_arm(day, true);
		break;
	case 3:
	case 4:
		write_model(day, roll(day, 3));
		break;
	case 5:
		assert_int_equal(write_coil(day->f, 0x1080, on), 0);
		day->now.rates_from = on;
		break;
	case 6:
		assert_int_equal(write_coil(day->f, WORD_ORDER, on), 0);
		day->now.word_order = on;
		break;
	default:
		if (on) {
			assert_int_equal(write_coil(day->f, COIL_STORE, true), 0);
			day->stored = day->now;
		} else {
			world_nmt(&day->f->world, 0x81);
			day->now = day->stored;
		}
	}
}

static void assert_agrees(const struct day *day)
{
	const struct od_values *v = &day->f->world.device.values;
	uint16_t words[6], expected[6];

	assert_true(v->lever_arm.l == day->now.arm[0] && v->lever_arm.s == day->now.arm[1] &&
		    v->lever_arm.t == day->now.arm[2]);
	assert_int_equal(v->lever_arm_model, day->now.lever_arm_model);
	assert_int_equal(v->rates_from, day->now.rates_from);
	assert_int_equal(v->modbus.word_order, day->now.word_order);
	for (unsigned i = 0; i < 3; i++)
		put_arm(day, expected + (size_t)2 * i, day->now.arm[i]);
	assert_int_equal(read_words(day->f, AT_LEVER_ARM, 6, words), 0);
	assert_memory_equal(words, expected, sizeof(expected));
}

static void test_after_a_day_with_both_windows_the_dictionary_has_what_was_written(void **state)
{
	struct day day = {.f = *state, .seed = 1};

	log_set_level(LOG_ERR);
	day.now.lever_arm_model = day.stored.lever_arm_model = 2;
	for (int t_s = 0; t_s < 24 * 3600; t_s += 10) {
		day.f->world.now_us += 10000000;
		act(&day);
		pass(day.f, 0.02);
		assert_agrees(&day);
	}
	log_set_level(LOG_INFO);
	assert_true(day.refused > 500);
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, world_tear_down)

int main(void)
{
	const struct CMUnitTest tests[] = {
		TEST(test_the_block_of_integers_is_what_the_pdos_of_its_counter_have),
		TEST(test_the_block_of_reals_has_the_values_of_the_same_sample),
		TEST(test_a_request_sees_the_sample_that_was_published_and_no_half_of_the_next),
		TEST(test_every_readable_entry_is_where_its_index_says),
		TEST(test_what_is_not_in_the_map_is_exception_2),
		TEST(test_a_part_of_a_value_can_be_read_but_not_written),
		TEST(test_the_word_order_is_an_object),
		TEST(test_a_written_lever_arm_is_used_from_the_next_sample_on_as_by_sdo),
		TEST(test_limits_and_access_are_those_of_sdo_and_the_old_value_remains),
		TEST(test_several_values_are_written_all_or_none),
		TEST(test_a_service_that_refuses_one_value_leaves_all_as_they_were),
		TEST(test_the_lever_arm_in_micrometres_is_written_at_once),
		TEST(test_a_mask_write_is_one_write_of_the_register),
		TEST(test_a_client_reads_at_once_what_it_wrote),
		TEST(test_values_are_stored_by_1010h_as_any),
		TEST(test_discrete_inputs_are_the_bits_of_the_status_and_the_error_register),
		TEST(test_a_command_is_a_coil_that_reads_0),
		TEST(test_a_value_of_0_and_1_is_a_coil_at_its_register),
		TEST(test_of_several_commands_none_is_executed),
		TEST(test_every_object_is_read_by_function_43_13_as_by_sdo),
		TEST(test_the_eds_is_read_in_parts),
		TEST(test_an_object_that_changes_is_read_as_of_its_first_part),
		TEST(test_a_long_object_is_not_read_while_the_loop_is_busy),
		TEST(test_objects_are_written_by_function_43_13_with_the_aborts_of_sdo),
		TEST(test_the_event_log_tells_who_wrote_what),
		TEST(test_identification_is_that_of_the_device),
		TEST(test_after_a_day_with_both_windows_the_dictionary_has_what_was_written),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
