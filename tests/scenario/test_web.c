/* imu9-web without its network, and a whole device on the same simulated bus: what browsers ask for and get. */
#include <json-c/json.h>
#include <malloc.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "od_values.h"
#include "tests/scenario/world.h"
#include "tools/web/web.h"

#define TOKEN "0123456789abcdef0123456789abcdef"
enum { MS = 1000, SECOND = 1000000, BOOT_MS = 1500 };

struct bench {
	struct world world;	  /* first member: its bus gives a pointer to it */
	struct can_port bus;	  /* of imu9-web */
	struct can_msg sent[512]; /* by imu9-web, not received by the device yet */
	size_t sent_count, total;
	size_t seen; /* frames of the device that imu9-web has received */
	struct web_token token;
	struct web web;
	bool off;      /* the device */
	size_t off_at; /* it goes off when it has sent so many frames; 0: never */
	struct json_object *events;
	struct json_object *answer;
	int64_t id;
};

static struct bench *bench;

static int take(struct can_port *port, const struct can_msg *msg)
{
	struct bench *b = (struct bench *)((char *)port - offsetof(struct bench, bus));

	assert_true(b->sent_count < 512);
	b->sent[b->sent_count++] = *msg;
	b->total++;
	b->bus.traffic.frames++;
	b->bus.traffic.bytes += msg->len;
	return 0;
}

/* All frames that are under way, in both directions. */
static void settle(struct bench *b)
{
	struct world *w = &b->world;

	while (b->sent_count > 0 || b->seen < w->frame_count) {
		while (b->seen < w->frame_count) {
			struct can_msg msg = w->frames[b->seen++ % WORLD_FRAMES];

			msg.t_us = w->now_us;
			b->bus.traffic.frames++;
			b->bus.traffic.bytes += msg.len;
			web_receive(&b->web, &msg, w->now_us);
		}
		web_tick(&b->web, w->now_us);
		if (b->sent_count > 0) {
			struct can_msg msg = b->sent[0];

			memmove(b->sent, b->sent + 1, --b->sent_count * sizeof(msg));
			b->off |= b->off_at && w->frame_count >= b->off_at;
			if (!b->off)
				world_receive(w, msg.id, msg.len, msg.data);
		}
	}
}

/* What a browser that reads everything gets. */
static void pull(struct bench *b, int client)
{
	uint64_t due_us = UINT64_MAX;
	size_t size;

	while (web_has_output(&b->web, client, b->world.now_us, &due_us)) {
		const char *text = web_output(&b->web, client, &size, b->world.now_us);
		assert_non_null(text);
		struct json_tokener *tokener = json_tokener_new();
		json_tokener_set_flags(tokener, JSON_TOKENER_VALIDATE_UTF8);
		struct json_object *json = json_tokener_parse_ex(tokener, text, (int)size), *id;

		assert_int_equal(json_tokener_get_error(tokener), json_tokener_success);
		json_tokener_free(tokener);
		if (!json_object_object_get_ex(json, "id", &id)) {
			json_object_array_add(b->events, json);
			continue;
		}
		assert_int_equal(json_object_get_int64(id), b->id);
		json_object_put(b->answer);
		b->answer = json;
	}
}

static void run(struct bench *b, int client, unsigned int ms)
{
	uint64_t end_us = b->world.now_us + ms * (uint64_t)MS;

	while (b->world.now_us < end_us) {
		if (b->off)
			b->world.now_us += b->world.interval_us;
		else
			world_sample(&b->world);
		web_tick(&b->web, b->world.now_us);
		settle(b);
		if (client >= 0)
			pull(b, client);
	}
}

/* The answer to {"op": ..}; `format`: its other members. */
static struct json_object *ask(struct bench *b, int client, const char *format, ...)
{
	static char text[400000], members[390000];
	va_list args;

	va_start(args, format);
	vsnprintf(members, sizeof(members), format, args);
	va_end(args);
	snprintf(text, sizeof(text), "{\"id\":%lld,%s}", (long long)++b->id, members);
	json_object_put(b->answer);
	b->answer = NULL;
	web_request(&b->web, client, text, strlen(text), b->world.now_us);
	settle(b);
	pull(b, client);
	for (int i = 0; i < 2000 && !b->answer; i++)
		run(b, client, 10);
	assert_non_null(b->answer);
	return b->answer;
}

/* A member by its path, "result.values.0.value". NULL: none. */
static struct json_object *at(struct json_object *json, const char *path)
{
	char copy[128], *rest = NULL;

	snprintf(copy, sizeof(copy), "%s", path);
	for (char *key = strtok_r(copy, ".", &rest); key && json; key = strtok_r(NULL, ".", &rest)) {
		struct json_object *next = NULL;

		if (json_object_is_type(json, json_type_array))
			next = json_object_array_get_idx(json, strtoul(key, NULL, 10));
		else
			json_object_object_get_ex(json, key, &next);
		json = next;
	}
	return json;
}

static double number(struct json_object *json, const char *path)
{
	assert_non_null(at(json, path));
	return json_object_get_double(at(json, path));
}

static const char *text_of(struct json_object *json, const char *path)
{
	assert_non_null(at(json, path));
	return json_object_get_string(at(json, path));
}

#define assert_done(answer) assert_true(json_object_get_boolean(at(answer, "ok")))
#define assert_refused(answer, part)                                     \
	do {                                                             \
		assert_false(json_object_get_boolean(at(answer, "ok"))); \
		assert_non_null(strstr(text_of(answer, "error"), part)); \
	} while (0)

static struct json_object *event(struct bench *b, const char *name)
{
	for (size_t i = json_object_array_length(b->events); i-- > 0;) {
		struct json_object *e = json_object_array_get_idx(b->events, i);

		if (strcmp(text_of(e, "event"), name) == 0)
			return e;
	}
	return NULL;
}

static void forget_events(struct bench *b)
{
	json_object_put(b->events);
	b->events = json_object_new_array();
}

static int set_up(void **state)
{
	static const struct can_ops ops = {.send = take};
	static const char *const settings[] = {"producer_heartbeat_time=1000", NULL};
	struct sensor_config sensor = *sensor_preset("ideal");
	struct bench *b = *state = bench = calloc(1, sizeof(*b));

	sensor.rate_hz = 100;
	b->world.now_us = SECOND;
	world_init(&b->world, &sensor, 1, "square");
	world_power_on(&b->world, settings);
	b->bus = (struct can_port){.ops = &ops, .fd = -1};
	snprintf(b->token.text, sizeof(b->token.text), TOKEN);
	web_init(&b->web, &(struct web_config){.bus = &b->bus, .bus_name = "sim", .token = &b->token}, b->world.now_us);
	b->events = json_object_new_array();
	return 0;
}

static int tear_down(void **state)
{
	struct bench *b = *state;

	web_free(&b->web);
	json_object_put(b->events);
	json_object_put(b->answer);
	free(b);
	return 0;
}

/* A browser, and a node that it has found. */
static int browser(struct bench *b)
{
	int client = web_connect(&b->web, b->world.now_us);

	assert_true(client >= 0);
	run(b, client, BOOT_MS);
	return client;
}

static int unlocked(struct bench *b)
{
	int client = browser(b);

	assert_done(ask(b, client, "\"op\":\"unlock\",\"token\":\"" TOKEN "\""));
	return client;
}

#define NODE "\"node\":16"

/* ---- nodes ------------------------------------------------------------------------------------------------------- */

static void test_a_node_is_found_by_its_heartbeat_and_identified(void **state)
{
	struct bench *b = *state;
	int client = browser(b);
	struct json_object *answer = ask(b, client, "\"op\":\"nodes\"");

	assert_int_equal(json_object_array_length(at(answer, "result.nodes")), 1);
	assert_int_equal(number(answer, "result.nodes.0.node"), WORLD_NODE_ID);
	assert_string_equal(text_of(answer, "result.nodes.0.name"), "IMU9 CANopen gateway");
	assert_string_equal(text_of(answer, "result.nodes.0.state"), "pre-operational");
	assert_int_equal(number(answer, "result.nodes.0.revision"), b->world.device.values.identity.revision_number);
	assert_true(json_object_get_boolean(at(answer, "result.nodes.0.ours")));
	assert_non_null(event(b, "nodes"));
}

static void test_a_node_that_is_silent_for_three_heartbeats_is_lost_and_comes_back(void **state)
{
	struct bench *b = *state;
	int client = browser(b);

	run(b, client, 2000);
	b->off = true;
	run(b, client, 1900); /* the last heartbeat was up to a second ago */
	assert_string_equal(text_of(event(b, "nodes"), "nodes.0.state"), "pre-operational");
	run(b, client, 1200);
	assert_string_equal(text_of(event(b, "nodes"), "nodes.0.state"), "lost");
	assert_true(number(event(b, "nodes"), "nodes.0.heard_s") >= 3);
	b->off = false;
	run(b, client, 2500);
	assert_string_equal(text_of(event(b, "nodes"), "nodes.0.state"), "pre-operational");
}

static void test_a_node_that_boots_is_shown_as_what_it_was_until_it_is_identified_again(void **state)
{
	struct bench *b = *state;
	int client = browser(b);

	world_nmt(&b->world, 0x81);
	run(b, client, 50);
	b->off = true; /* before the request */
	run(b, client, 1000);
	struct json_object *answer = ask(b, client, "\"op\":\"nodes\"");
	assert_string_equal(text_of(answer, "result.nodes.0.name"), "IMU9 CANopen gateway");
	assert_true(json_object_get_boolean(at(answer, "result.nodes.0.ours")));
}

static void test_a_node_without_heartbeat_is_lost_when_it_answers_no_longer(void **state)
{
	struct bench *b = *state;
	int client = unlocked(b);

	assert_done(ask(b, client, "\"op\":\"write\"," NODE ",\"object\":\"producer_heartbeat_time\",\"value\":0"));
	run(b, client, 20000);
	assert_string_equal(text_of(event(b, "nodes"), "nodes.0.state"), "pre-operational");
	b->off = true;
	run(b, client, 7000);
	assert_string_equal(text_of(event(b, "nodes"), "nodes.0.state"), "lost");
}

static void test_a_scan_finds_a_node_that_sends_nothing(void **state)
{
	struct bench *b = *state;
	uint16_t none = 0;

	assert_int_equal(world_sdo_write(&b->world, 0x1017, 0, &none, 2), 0);
	b->seen = b->world.frame_count; /* nobody has heard it */
	int client = browser(b);
	assert_int_equal(json_object_array_length(at(ask(b, client, "\"op\":\"nodes\""), "result.nodes")), 0);
	struct json_object *answer = ask(b, client, "\"op\":\"scan\"");
	assert_int_equal(number(answer, "result.nodes.0.node"), WORLD_NODE_ID);
	assert_string_equal(text_of(answer, "result.nodes.0.name"), "IMU9 CANopen gateway");
}

static void test_an_emcy_is_told_in_words(void **state)
{
	struct bench *b = *state;
	int client = browser(b);
	const struct can_msg msg = {.id = 0x080 + WORLD_NODE_ID, .len = 8, .data = {0x20, 0x81, 0x11}};

	web_receive(&b->web, &msg, b->world.now_us);
	pull(b, client);
	assert_int_equal(number(event(b, "emcy"), "node"), WORLD_NODE_ID);
	assert_string_equal(text_of(event(b, "emcy"), "code"), "8120h");
	assert_non_null(strstr(text_of(event(b, "emcy"), "text"), "passive"));
	assert_int_equal(number(event(b, "emcy"), "register"), 0x11);
}

static void test_the_load_is_that_of_the_bit_rate_and_null_without_one(void **state)
{
	struct bench *b = *state;
	int client = browser(b);

	assert_null(at(event(b, "bus"), "load"));
	assert_true(json_object_object_get_ex(event(b, "bus"), "load", NULL));
	b->bus.bit_s = 100000;
	run(b, client, 1100);
	b->bus.traffic = b->web.traffic;
	b->bus.traffic.frames += 500; /* of 111 bits and up to 24 stuff bits, in a second */
	b->bus.traffic.bytes += 4000;
	forget_events(b);
	b->off = true;
	run(b, client, 1100);
	assert_true(number(event(b, "bus"), "load") >= 500 * 111 / 100000.0);
	assert_true(number(event(b, "bus"), "load") <= 500 * 135 / 100000.0);
}

/* ---- objects ----------------------------------------------------------------------------------------------------- */

static struct json_object *object_named(struct json_object *answer, const char *name)
{
	struct json_object *objects = at(answer, "result.objects");

	for (size_t i = 0; i < json_object_array_length(objects); i++)
		if (strcmp(text_of(json_object_array_get_idx(objects, i), "name"), name) == 0)
			return json_object_array_get_idx(objects, i);
	return NULL;
}

static void test_objects_have_units_limits_words_and_defaults(void **state)
{
	struct bench *b = *state;
	struct json_object *answer = ask(b, browser(b), "\"op\":\"objects\"," NODE), *arm, *model, *cob_id;

	arm = object_named(answer, "lever_arm.l");
	assert_string_equal(text_of(arm, "index"), "2000h");
	assert_string_equal(text_of(arm, "record"), "lever_arm");
	assert_string_equal(text_of(arm, "type"), "REAL32");
	assert_string_equal(text_of(arm, "access"), "rw");
	assert_string_equal(text_of(arm, "unit"), "m");
	assert_true(number(arm, "low") == -10);
	assert_int_equal(number(arm, "default"), 0);
	assert_true(json_object_get_boolean(at(arm, "stored")));
	model = object_named(answer, "lever_arm_model");
	assert_string_equal(text_of(model, "words.2"), "rigid_body");
	cob_id = object_named(answer, "tpdo1_communication.cob_id");
	assert_int_equal(number(cob_id, "default"), 0x40000180 + WORLD_NODE_ID);
}

static void test_the_eds_of_another_revision_is_read_from_the_node_once(void **state)
{
	struct bench *b = *state;

	b->world.device.values.identity.revision_number += 1;
	int client = browser(b);
	size_t before = b->world.frame_count;
	assert_non_null(object_named(ask(b, client, "\"op\":\"objects\"," NODE), "lever_arm.l"));
	assert_true(b->world.frame_count - before > imu9_eds_size / 7); /* in blocks of segments of 7 bytes */
	before = b->world.frame_count;
	assert_done(ask(b, client, "\"op\":\"read\"," NODE ",\"objects\":[\"lever_arm\"]"));
	assert_int_equal(b->world.frame_count - before, 3);
}

static void test_an_eds_whose_reading_was_interrupted_is_read_again_after_a_boot_up(void **state)
{
	struct bench *b = *state;
	uint32_t revision = b->world.device.values.identity.revision_number + 1;

	b->world.device.values.identity.revision_number = revision;
	int client = browser(b);
	b->off_at = b->world.frame_count + 1000;
	assert_done(ask(b, client, "\"op\":\"objects\"," NODE)); /* what else is known of it */
	assert_true(b->off);
	b->off_at = b->off = 0;
	world_nmt(&b->world, 0x82);
	b->world.device.values.identity.revision_number = revision;
	run(b, client, BOOT_MS);
	size_t before = b->world.frame_count;
	assert_non_null(object_named(ask(b, client, "\"op\":\"objects\"," NODE), "lever_arm.l"));
	assert_true(b->world.frame_count - before > imu9_eds_size / 7);
}

static void test_a_node_without_1021h_has_the_eds_of_its_vendor_and_product_or_what_cia301_defines(void **state)
{
	static const char TEXT[] =
		"[DeviceInfo]\nVendorNumber=0x77\nProductNumber=0x88\n"
		"[ManufacturerObjects]\nSupportedObjects=1\n1=0x2000\n[2000]\nParameterName=Their arm\n"
		"ObjectType=7\nDataType=0x0008\nAccessType=rw\n";
	struct bench *b = *state;
	struct eds eds;
	char error[200];
	const char *text = TEXT;
	size_t size = sizeof(TEXT) - 1;

	if (eds_parse(&eds, "test", TEXT, size, EDS_LENIENT, error, sizeof(error)) < 0)
		fail_msg("%s", error);
	b->web.config.eds = &eds;
	b->web.config.eds_texts = &text;
	b->web.config.eds_sizes = &size;
	b->web.config.eds_count = 1;
	b->world.device.eds.index = 0x5FFE; /* instead of 1021h */
	b->world.device.values.identity.vendor_id = 0x77;
	b->world.device.values.identity.product_code = 0x89;
	int client = browser(b);
	struct json_object *answer = ask(b, client, "\"op\":\"objects\"," NODE);
	assert_non_null(object_named(answer, "producer_heartbeat_time"));
	assert_null(object_named(answer, "lever_arm.l"));
	b->world.device.values.identity.product_code = 0x88;
	world_nmt(&b->world, 0x82);
	b->world.device.values.identity.vendor_id = 0x77;
	b->world.device.values.identity.product_code = 0x88;
	run(b, client, BOOT_MS);
	answer = ask(b, client, "\"op\":\"objects\"," NODE);
	assert_int_equal(json_object_array_length(at(answer, "result.objects")), 1);
	assert_string_equal(text_of(answer, "result.objects.0.name"), "their_arm");
	assert_false(json_object_get_boolean(at(ask(b, client, "\"op\":\"nodes\""), "result.nodes.0.ours")));
	web_free(&b->web);
	eds_free(&eds);
	memset(&b->web, 0, sizeof(b->web));
	web_init(&b->web, &(struct web_config){.bus = &b->bus, .bus_name = "sim", .token = &b->token}, b->world.now_us);
}

static void test_values_are_those_of_the_node(void **state)
{
	struct bench *b = *state;
	int client = browser(b);
	struct json_object *answer;

	b->world.device.values.lever_arm.s = 0.25f;
	answer = ask(b, client,
		"\"op\":\"read\"," NODE ",\"objects\":[\"lever_arm\",\"1018h:04\",\"nonsense\",\"store_eds\"]");
	assert_int_equal(json_object_array_length(at(answer, "result.values")), 6);
	assert_string_equal(text_of(answer, "result.values.1.name"), "lever_arm.s");
	assert_true(number(answer, "result.values.1.value") == 0.25);
	assert_int_equal(number(answer, "result.values.3.value"), b->world.device.values.identity.serial_number);
	assert_string_equal(text_of(answer, "result.values.3.index"), "1018h");
	assert_non_null(at(answer, "result.values.4.error"));
	assert_non_null(at(answer, "result.values.5.error"));
	answer = ask(b, client, "\"op\":\"read\"," NODE ",\"objects\":[\"5FFFh\"]");
	assert_string_equal(text_of(answer, "result.values.0.abort"), "06020000h");
}

static void test_a_node_that_does_not_answer_is_told(void **state)
{
	struct bench *b = *state;
	int client = browser(b);

	b->off = true;
	struct json_object *answer = ask(b, client, "\"op\":\"read\"," NODE ",\"objects\":[\"lever_arm\"]");
	assert_string_equal(text_of(answer, "result.values.0.error"), "no answer");
	assert_refused(
		ask(b, client, "\"op\":\"read\",\"node\":17,\"objects\":[\"lever_arm\"]"), "no answer from node 17");
	assert_refused(ask(b, client, "\"op\":\"read\",\"node\":0,\"objects\":[\"lever_arm\"]"), "1 to 127");
}

/* ---- what writes ------------------------------------------------------------------------------------------------- */

static void test_nothing_is_written_without_the_token(void **state)
{
	static const char *const REQUESTS[] = {
		"\"op\":\"write\"," NODE ",\"object\":\"lever_arm.l\",\"value\":0.05",
		"\"op\":\"load\"," NODE ",\"format\":\"ini\",\"text\":\"lever_arm.l=0.05\"",
		"\"op\":\"store\"," NODE ",\"group\":\"all\"",
		"\"op\":\"restore\"," NODE ",\"group\":\"all\"",
		"\"op\":\"nmt\"," NODE ",\"command\":\"start\"",
		"\"op\":\"set_mapping\"," NODE ",\"pdo\":1,\"entries\":[]",
		"\"op\":\"sync\",\"hz\":100",
		"\"op\":\"lss\",\"command\":\"find\"",
		"\"op\":\"record\"," NODE ",\"on\":true",
	};
	struct bench *b = *state;
	int client = browser(b);
	size_t before = b->total;

	for (size_t i = 0; i < sizeof(REQUESTS) / sizeof(REQUESTS[0]); i++) {
		assert_refused(ask(b, client, "%s", REQUESTS[i]), "token");
		assert_true(json_object_get_boolean(at(b->answer, "locked")));
	}
	assert_int_equal(b->total, before);
}

static void test_a_write_is_read_back(void **state)
{
	struct bench *b = *state;
	int client = unlocked(b);
	struct json_object *answer;

	answer = ask(b, client, "\"op\":\"write\"," NODE ",\"object\":\"lever_arm.l\",\"value\":0.05");
	assert_true(fabs(number(answer, "result.values.0.value") - 0.05) < 1e-9);
	assert_true(b->world.device.values.lever_arm.l == 0.05f);
	ask(b, client, "\"op\":\"write\"," NODE ",\"object\":\"lever_arm_model\",\"value\":\"none\"");
	assert_int_equal(b->world.device.values.lever_arm_model, 0);
	assert_string_equal(text_of(b->answer, "result.values.0.words"), "none");
	ask(b, client, "\"op\":\"write\"," NODE ",\"object\":\"2001h\",\"value\":2");
	assert_int_equal(b->world.device.values.lever_arm_model, 2);
	assert_refused(
		ask(b, client, "\"op\":\"write\"," NODE ",\"object\":\"lever_arm.l\",\"value\":11"), "-10 to 10");
	assert_refused(
		ask(b, client, "\"op\":\"write\"," NODE ",\"object\":\"lever_arm_model\",\"value\":1.5"), "allowed");
	assert_refused(ask(b, client, "\"op\":\"write\"," NODE ",\"object\":\"lever_arm\",\"value\":1"), "record");
	assert_refused(ask(b, client, "\"op\":\"write\"," NODE ",\"object\":\"device_type\",\"value\":1"), "read");
	assert_string_equal(text_of(b->answer, "abort"), "06010002h");
}

static void test_a_scaled_value_is_written_in_its_unit(void **state)
{
	struct bench *b = *state;
	int client = unlocked(b);

	/* 6012h counts steps of 6000h: 10 is 0.01 deg */
	assert_done(ask(b, client, "\"op\":\"write\"," NODE ",\"object\":\"6000h\",\"value\":\"100\""));
	assert_int_equal(b->world.device.values.angle_resolution, 100);
	ask(b, client, "\"op\":\"write\"," NODE ",\"object\":\"6014h\",\"value\":2.5");
	assert_true(fabs(number(b->answer, "result.values.0.value") - 2.5) < 1e-6);
	assert_int_equal(number(b->answer, "result.values.0.raw"), 25);
}

static void test_wrong_tokens_are_slowed_down(void **state)
{
	struct bench *b = *state;
	int client = browser(b), other = web_connect(&b->web, b->world.now_us);

	pull(b, other);
	for (int i = 0; i < 3; i++)
		assert_refused(ask(b, i ? client : other, "\"op\":\"unlock\",\"token\":\"%d\"", i), "wrong");
	assert_refused(ask(b, client, "\"op\":\"unlock\",\"token\":\"" TOKEN "\""), "wait 1 s");
	run(b, client, 1000);
	assert_refused(ask(b, client, "\"op\":\"unlock\",\"token\":\"" TOKEN "0\""), "wrong");
	run(b, client, 1500);
	assert_refused(ask(b, client, "\"op\":\"unlock\",\"token\":\"" TOKEN "\""), "wait");
	run(b, client, 1000);
	assert_done(ask(b, client, "\"op\":\"unlock\",\"token\":\"" TOKEN "\""));
	assert_int_equal(b->web.unlock_failures, 4);
	assert_refused(ask(b, other, "\"op\":\"nmt\",\"node\":0,\"command\":\"stop\""), "token"); /* each for itself */
}

static void test_nmt_store_and_record(void **state)
{
	struct bench *b = *state;
	int client = unlocked(b);

	assert_done(ask(b, client, "\"op\":\"nmt\"," NODE ",\"command\":\"start\""));
	run(b, client, 1100);
	assert_string_equal(text_of(event(b, "nodes"), "nodes.0.state"), "operational");
	ask(b, client, "\"op\":\"write\"," NODE ",\"object\":\"lever_arm.l\",\"value\":0.05");
	assert_done(ask(b, client, "\"op\":\"store\"," NODE ",\"group\":\"all\""));
	assert_true(b->world.disk.groups[0].size + b->world.disk.groups[1].size + b->world.disk.groups[2].size > 0);
	assert_done(ask(b, client, "\"op\":\"restore\"," NODE ",\"group\":\"all\""));
	assert_refused(ask(b, client, "\"op\":\"store\"," NODE ",\"group\":\"some\""), "group");
	assert_done(ask(b, client, "\"op\":\"events\"," NODE));
}

/* ---- PDOs -------------------------------------------------------------------------------------------------------- */

static void test_every_sample_arrives_with_the_values_of_its_pdos(void **state)
{
	struct bench *b = *state;
	int client = unlocked(b), counter = -1, rows = 0;
	struct json_object *fields;

	ask(b, client, "\"op\":\"nmt\"," NODE ",\"command\":\"start\"");
	assert_done(ask(b, client, "\"op\":\"subscribe\"," NODE ",\"hz\":20"));
	assert_done(ask(b, client, "\"op\":\"sync\",\"hz\":100"));
	run(b, client, 1000);
	fields = at(event(b, "fields"), "fields");
	assert_int_equal(json_object_array_length(fields), 15);
	assert_string_equal(text_of(json_object_array_get_idx(fields, 3), "name"), "sample.counter");
	assert_string_equal(text_of(json_object_array_get_idx(fields, 0), "unit"), "m/s^2");
	forget_events(b);
	run(b, client, 3000);
	for (size_t i = 0; i < json_object_array_length(b->events); i++) {
		struct json_object *e = json_object_array_get_idx(b->events, i), *list = at(e, "rows");

		for (size_t k = 0; list && k < json_object_array_length(list); k++, rows++) {
			struct json_object *row = json_object_array_get_idx(list, k);

			assert_int_equal(json_object_array_length(row), 16);
			assert_true(counter < 0 || number(row, "4") == counter + 1);
			assert_true(number(row, "4") == number(row, "8") && number(row, "8") == number(row, "12"));
			counter = (int)number(row, "4");
		}
		assert_null(at(e, "lost"));
	}
	assert_true(rows >= 290 && rows <= 301);
	assert_near(number(at(event(b, "pdo"), "rows.0"), "5"), 0, 180);
	/* at most 20 events a second */
	assert_true(json_object_array_length(b->events) <= 3 * 20 + 8);
}

static void test_a_slow_browser_loses_the_oldest_rows_and_a_fast_one_none(void **state)
{
	struct bench *b = *state;
	int fast = unlocked(b), slow = web_connect(&b->web, b->world.now_us);

	pull(b, slow);
	ask(b, fast, "\"op\":\"nmt\"," NODE ",\"command\":\"start\"");
	ask(b, slow, "\"op\":\"subscribe\"," NODE ",\"hz\":20");
	ask(b, fast, "\"op\":\"subscribe\"," NODE ",\"hz\":20");
	ask(b, fast, "\"op\":\"sync\",\"hz\":100");
	run(b, fast, 500);
	pull(b, slow);
	forget_events(b);
	run(b, fast, 10000); /* the slow one takes nothing */
	for (size_t i = 0; i < json_object_array_length(b->events); i++)
		assert_null(at(json_object_array_get_idx(b->events, i), "lost"));
	forget_events(b);
	pull(b, slow);
	int rows = 0, lost = 0;
	for (size_t i = 0; i < json_object_array_length(b->events); i++) {
		struct json_object *e = json_object_array_get_idx(b->events, i);

		rows += at(e, "rows") ? (int)json_object_array_length(at(e, "rows")) : 0;
		lost += at(e, "lost") ? (int)number(e, "lost") : 0;
	}
	assert_true(rows >= WEB_ROWS_EVENT && rows <= WEB_ROWS);
	assert_near(rows + lost, 1000, 130); /* what is left after the first event waits for its turn */
	assert_true(lost >= 1000 - WEB_ROWS - 10);
}

static void test_a_mapping_is_changed_by_the_procedure_and_rows_follow(void **state)
{
	struct bench *b = *state;
	int client = unlocked(b);
	struct json_object *answer;

	ask(b, client, "\"op\":\"nmt\"," NODE ",\"command\":\"start\"");
	ask(b, client, "\"op\":\"subscribe\"," NODE ",\"hz\":20");
	ask(b, client, "\"op\":\"sync\",\"hz\":100");
	run(b, client, 300);
	assert_done(ask(b, client,
		"\"op\":\"set_mapping\"," NODE
		",\"pdo\":1,\"type\":2,\"entries\":[\"velocity.x\",\"sample.counter\"]"));
	answer = ask(b, client, "\"op\":\"mapping\"," NODE);
	assert_string_equal(text_of(answer, "result.pdos.0.entries.0"), "velocity.x");
	assert_int_equal(number(answer, "result.pdos.0.bits"), 48);
	assert_int_equal(number(answer, "result.pdos.0.type"), 2);
	assert_int_equal(number(answer, "result.pdos.0.cob_id"), 0x180 + WORLD_NODE_ID);
	assert_true(json_object_get_boolean(at(answer, "result.pdos.0.enabled")));
	assert_int_equal(b->world.device.values.tpdo1_mapping.object_1 >> 16, 0x2104);
	forget_events(b);
	run(b, client, 1000);
	assert_int_equal(json_object_array_length(at(event(b, "pdo"), "rows.0")), 14);
	assert_refused(
		ask(b, client, "\"op\":\"set_mapping\"," NODE ",\"pdo\":1,\"entries\":[\"lever_arm.l\"]"), "mapped");
	assert_refused(ask(b, client,
			       "\"op\":\"set_mapping\"," NODE
			       ",\"pdo\":1,\"entries\":[\"velocity.x\",\"velocity.y\",\"velocity.z\"]"),
		"8 bytes");
	assert_refused(ask(b, client, "\"op\":\"set_mapping\"," NODE ",\"pdo\":9,\"entries\":[]"), "TPDO");
}

static void test_an_rpdo_is_mapped_with_what_it_can_receive_and_dummies(void **state)
{
	struct bench *b = *state;
	int client = unlocked(b);
	struct json_object *answer = ask(b, client, "\"op\":\"mapping\"," NODE);

	assert_string_equal(text_of(answer, "result.pdos.7.direction"), "tpdo");
	assert_string_equal(text_of(answer, "result.pdos.8.direction"), "rpdo");
	assert_int_equal(number(answer, "result.pdos.8.pdo"), 1);
	assert_string_equal(text_of(answer, "result.pdos.8.entries.0"), "velocity_aid.x16");
	assert_int_equal(number(answer, "result.pdos.8.cob_id"), 0x200 + WORLD_NODE_ID);
	assert_null(at(answer, "result.pdos.8.inhibit")); /* 14xxh:03 is of no use */
	assert_done(ask(b, client,
		"\"op\":\"set_mapping\"," NODE ",\"direction\":\"rpdo\",\"pdo\":2,\"type\":1,\"cob_id\":773,"
		"\"entries\":[\"0005h:00\",\"velocity_aid.x\"]"));
	assert_int_equal(b->world.device.values.rpdo2_communication.cob_id, 0x305);
	assert_int_equal(b->world.device.values.rpdo2_communication.transmission_type, 1);
	assert_int_equal(b->world.device.values.rpdo2_mapping.number_of_mapped_objects, 2);
	assert_int_equal(b->world.device.values.rpdo2_mapping.object_1, 0x00050008);
	assert_int_equal(b->world.device.values.rpdo2_mapping.object_2, 0x20700120);
	assert_int_equal(b->world.device.values.tpdo2_mapping.number_of_mapped_objects, 4);
	answer = ask(b, client, "\"op\":\"mapping\"," NODE);
	assert_string_equal(text_of(answer, "result.pdos.9.entries.0"), "0005h:00");
	assert_refused(ask(b, client,
			       "\"op\":\"set_mapping\"," NODE
			       ",\"direction\":\"rpdo\",\"pdo\":2,\"entries\":[\"angles.roll\"]"),
		"into an RPDO");
	assert_refused(ask(b, client, "\"op\":\"set_mapping\"," NODE ",\"pdo\":2,\"entries\":[\"0005h:00\"]"),
		"no such object");
	assert_refused(ask(b, client, "\"op\":\"set_mapping\"," NODE ",\"direction\":\"out\",\"pdo\":2,\"entries\":[]"),
		"tpdo or rpdo");
}

static void test_a_mapping_that_the_node_refuses_leaves_the_pdo_as_it_was(void **state)
{
	struct bench *b = *state;
	int client = unlocked(b);

	/* transmission type 250 is reserved (CiA 301, table 72) */
	assert_refused(
		ask(b, client, "\"op\":\"set_mapping\"," NODE ",\"pdo\":1,\"type\":250,\"entries\":[\"velocity.x\"]"),
		"");
	assert_non_null(at(b->answer, "abort"));
	assert_int_equal(b->world.device.values.tpdo1_communication.cob_id & 0x80000000u, 0);
	assert_int_equal(b->world.device.values.tpdo1_mapping.number_of_mapped_objects, 4);
	assert_int_equal(b->world.device.values.tpdo1_mapping.object_1 >> 16, 0x2100);
}

static void test_polls_of_all_browsers_are_ten_a_second(void **state)
{
	struct bench *b = *state;
	int first = browser(b), second = web_connect(&b->web, b->world.now_us);

	pull(b, second);
	assert_done(ask(b, first, "\"op\":\"poll\"," NODE ",\"objects\":[\"lever_arm.l\"],\"hz\":10"));
	assert_done(ask(b, second, "\"op\":\"poll\"," NODE ",\"objects\":[\"lever_arm.s\"],\"hz\":10"));
	run(b, first, 1000);
	size_t before = b->total;
	forget_events(b);
	run(b, first, 10000);
	assert_near(b->total - before, 100, 4);
	assert_string_equal(text_of(event(b, "poll"), "values.0.name"), "lever_arm.l");
	assert_done(ask(b, first, "\"op\":\"poll\"," NODE ",\"objects\":[],\"hz\":10"));
	web_disconnect(&b->web, second);
	before = b->total;
	run(b, first, 2000);
	assert_int_equal(b->total, before);
}

static void test_sync_ends_with_its_browser_and_there_is_only_one_producer(void **state)
{
	struct bench *b = *state;
	int client = unlocked(b);
	const struct can_msg sync = {.id = 0x080};

	assert_done(ask(b, client, "\"op\":\"sync\",\"hz\":50"));
	size_t before = b->total;
	run(b, -1, 1000);
	assert_near(b->total - before, 50, 1);
	before = b->total;
	b->world.now_us += SECOND; /* the program was stopped so long */
	run(b, -1, 100);
	assert_near(b->total - before, 5, 1);
	web_disconnect(&b->web, client);
	before = b->total;
	run(b, -1, 1000);
	assert_int_equal(b->total, before);
	client = unlocked(b);
	web_receive(&b->web, &sync, b->world.now_us);
	assert_refused(ask(b, client, "\"op\":\"sync\",\"hz\":50"), "another node");
}

/* ---- configuration ----------------------------------------------------------------------------------------------- */

static const char *escaped(const char *text)
{
	static char json[390000];
	struct json_object *string = json_object_new_string(text);

	snprintf(json, sizeof(json), "%s", json_object_to_json_string_ext(string, JSON_C_TO_STRING_PLAIN));
	json_object_put(string);
	return json;
}

static void test_a_saved_configuration_is_loaded_again(void **state)
{
	static const char *const FORMATS[] = {"ini", "dcf"};
	struct bench *b = *state;
	int client = unlocked(b);

	for (size_t i = 0; i < 2; i++) {
		const char *format = FORMATS[i];

		b->world.device.values.lever_arm.l = 0.125f;
		struct json_object *saved =
			json_object_get(ask(b, client, "\"op\":\"save\"," NODE ",\"format\":\"%s\"", format));
		const char *text = escaped(text_of(saved, "result.text"));
		assert_int_equal(number(saved, "result.failed"), 0);
		b->world.device.values.lever_arm.l = 0.5f;
		b->world.device.values.tpdo1_mapping.number_of_mapped_objects = 2;
		ask(b, client, "\"op\":\"compare\"," NODE ",\"format\":\"%s\",\"text\":%s", format, text);
		assert_int_equal(json_object_array_length(at(b->answer, "result.differences")), 2);
		assert_string_equal(text_of(b->answer, "result.differences.1.name"), "lever_arm.l");
		assert_true(number(b->answer, "result.differences.1.node_value") == 0.5);
		assert_true(number(b->answer, "result.differences.1.file_value") == 0.125);
		ask(b, client, "\"op\":\"load\"," NODE ",\"format\":\"%s\",\"text\":%s", format, text);
		assert_true(number(b->answer, "result.written") >= 2);
		assert_int_equal(json_object_array_length(at(b->answer, "result.failed")), 0);
		assert_true(b->world.device.values.lever_arm.l == 0.125f);
		assert_int_equal(b->world.device.values.tpdo1_mapping.number_of_mapped_objects, 4);
		assert_int_equal(b->world.device.values.tpdo1_communication.cob_id & 0x80000000u, 0);
		ask(b, client, "\"op\":\"compare\"," NODE ",\"format\":\"%s\",\"text\":%s", format, text);
		assert_int_equal(json_object_array_length(at(b->answer, "result.differences")), 0);
		json_object_put(saved);
	}
}

static void test_a_value_that_the_node_refuses_is_named_and_the_others_are_written(void **state)
{
	struct bench *b = *state;
	int client = unlocked(b);
	const char *text = escaped("[lever_arm]\nl = 0.25\ns = 11\n");

	ask(b, client, "\"op\":\"load\"," NODE ",\"format\":\"ini\",\"text\":%s", text);
	assert_int_equal(number(b->answer, "result.written"), 1);
	assert_string_equal(text_of(b->answer, "result.failed.0.name"), "lever_arm.s");
	assert_string_equal(text_of(b->answer, "result.failed.0.abort"), "06090031h");
	assert_true(b->world.device.values.lever_arm.l == 0.25f);
	assert_refused(ask(b, client, "\"op\":\"load\"," NODE ",\"format\":\"ini\",\"text\":\"x=1\""), "line:1: x");
	assert_refused(ask(b, client, "\"op\":\"load\"," NODE ",\"format\":\"ini\",\"text\":\"\""), "empty");
	assert_refused(ask(b, client, "\"op\":\"load\"," NODE ",\"format\":\"xml\",\"text\":\"\""), "ini or dcf");
}

static void test_lss_finds_a_node_without_a_node_id_and_gives_it_one(void **state)
{
	struct bench *b = *state;

	b->world.node_id = 255;
	b->world.serial = 0x12345678;
	world_power_on(&b->world, NULL);
	b->seen = b->world.frame_count;
	int client = unlocked(b);
	struct json_object *answer = ask(b, client, "\"op\":\"lss\",\"command\":\"find\"");
	assert_int_equal(json_object_array_length(at(answer, "result.units")), 1);
	assert_int_equal(number(answer, "result.units.0.serial"), 0x12345678);
	struct json_object *unit = json_object_get(at(answer, "result.units.0"));
	answer = ask(b, client, "\"op\":\"lss\",\"command\":\"set\",\"node\":42,\"identity\":%s",
		json_object_to_json_string(unit));
	assert_done(answer);
	json_object_put(unit);
	run(b, client, 1500);
	assert_int_equal(number(event(b, "nodes"), "nodes.0.node"), 42);
	assert_refused(ask(b, client,
			       "\"op\":\"lss\",\"command\":\"set\",\"node\":43,\"identity\":{\"vendor\":1,"
			       "\"product\":2,\"revision\":3,\"serial\":4}"),
		"no node with this identity");
}

/* ---- limits ------------------------------------------------------------------------------------------------------ */

static void test_there_are_at_most_32_browsers(void **state)
{
	struct bench *b = *state;

	for (int i = 0; i < WEB_CLIENTS; i++)
		assert_int_equal(web_connect(&b->web, b->world.now_us), i);
	assert_int_equal(web_connect(&b->web, b->world.now_us), -1);
	web_disconnect(&b->web, 7);
	assert_int_equal(web_connect(&b->web, b->world.now_us), 7);
}

static void test_a_browser_that_fetches_no_answers_is_not_read_from(void **state)
{
	struct bench *b = *state;
	int client = browser(b);

	for (int i = 0; i < WEB_CLIENT_JOBS; i++) {
		assert_true(web_takes_input(&b->web, client));
		web_request(&b->web, client, "{\"id\":1,\"op\":\"hello\"}", 21, b->world.now_us);
	}
	assert_false(web_takes_input(&b->web, client));
	b->id = 1;
	pull(b, client);
	assert_true(web_takes_input(&b->web, client));
}

static void test_more_than_fifty_requests_a_second_are_refused(void **state)
{
	struct bench *b = *state;
	int client = browser(b), answered = 0;

	run(b, client, 3000);
	for (int i = 0; i < 1000; i++) { /* in a second */
		size_t size;

		web_request(&b->web, client, "{\"id\":1,\"op\":\"hello\"}", 21, b->world.now_us + (uint64_t)i * MS);
		answered += strstr(web_output(&b->web, client, &size, b->world.now_us), "\"ok\":true") != NULL;
	}
	assert_near(answered, 150, 1);
}

static void test_requests_that_are_none_are_refused(void **state)
{
	static const char *const TEXTS[] = {"", "{", "null", "[]", "{}", "{\"id\":1}", "{\"op\":\"hello\"}",
		"{\"id\":\"1\",\"op\":\"hello\"}", "{\"id\":-1,\"op\":\"hello\"}", "{\"id\":1,\"op\":7}",
		"{\"id\":1,\"op\":\"hello\"}{}", "{\"id\":1,\"op\":\"nix\"}",
		"{\"id\":1,\"op\":\"hello\",\"a\":[[[[[[[]]]]]]]}", "{\"id\":1,\"op\":\"hello\",\"a\":\"\xFF\"}"};
	struct bench *b = *state;
	int client = browser(b);
	size_t size;

	for (size_t i = 0; i < sizeof(TEXTS) / sizeof(TEXTS[0]); i++) {
		web_request(&b->web, client, TEXTS[i], strlen(TEXTS[i]), b->world.now_us);
		assert_non_null(strstr(web_output(&b->web, client, &size, b->world.now_us), "\"ok\":false"));
	}
}

static void test_a_request_may_have_more_than_ascii(void **state)
{
	struct bench *b = *state;

	struct json_object *answer = ask(b, browser(b),
		"\"op\":\"nodes\",\"note\":\"Br\xC3\xBC"
		"cke\"");
	assert_true(json_object_get_boolean(json_object_object_get(answer, "ok")));
}

static void test_names_of_devices_in_another_encoding_arrive_as_utf8(void **state)
{
	struct bench *b = *state;

	strcpy(b->world.device.values.manufacturer_device_name, "Neigungsmesser f\xFCr Br\xC3\xBC"
								"cken \xE2\x82");
	int client = browser(b); /* pull() checks each message */
	assert_string_equal(text_of(ask(b, client, "\"op\":\"nodes\""), "result.nodes.0.name"),
		"Neigungsmesser f?r Br\xC3\xBC"
		"cken ??");
}

static void test_a_browser_that_leaves_takes_its_reads_with_it_but_not_its_writes(void **state)
{
	struct bench *b = *state;
	int client = unlocked(b);
	static const char *const REQUESTS[] = {
		"{\"id\":1,\"op\":\"write\"," NODE ",\"object\":\"lever_arm.l\",\"value\":1}",
		"{\"id\":2,\"op\":\"read\"," NODE ",\"objects\":[\"calibration_gyro\"]}",
		"{\"id\":3,\"op\":\"write\"," NODE ",\"object\":\"lever_arm.s\",\"value\":2}",
	};

	for (size_t i = 0; i < 3; i++)
		web_request(&b->web, client, REQUESTS[i], strlen(REQUESTS[i]), b->world.now_us);
	web_disconnect(&b->web, client);
	size_t before = b->total;
	run(b, -1, 100);
	assert_true(b->world.device.values.lever_arm.l == 1 && b->world.device.values.lever_arm.s == 2);
	assert_int_equal(b->total - before, 4); /* each written and read back */
	assert_int_equal(b->web.nodes[WORLD_NODE_ID].job_count, 0);
}

static void test_memory_is_constant_with_twenty_browsers(void **state)
{
	struct bench *b = *state;
	int clients[20];
	size_t at_first = 0, size;

	clients[0] = unlocked(b);
	ask(b, clients[0], "\"op\":\"nmt\"," NODE ",\"command\":\"start\"");
	ask(b, clients[0], "\"op\":\"sync\",\"hz\":100");
	for (int i = 1; i < 20; i++)
		clients[i] = web_connect(&b->web, b->world.now_us);
	for (int i = 0; i < 20; i++) {
		ask(b, clients[i], "\"op\":\"subscribe\"," NODE ",\"hz\":20");
		ask(b, clients[i], "\"op\":\"poll\"," NODE ",\"objects\":[\"position_sigma\"],\"hz\":10");
	}
	for (int second = 0; second < 60; second++) {
		uint64_t due_us = UINT64_MAX;

		web_disconnect(&b->web, clients[19]); /* one comes and goes */
		clients[19] = web_connect(&b->web, b->world.now_us);
		ask(b, clients[19], "\"op\":\"subscribe\"," NODE ",\"hz\":20");
		ask(b, clients[19], "\"op\":\"read\"," NODE ",\"objects\":[\"lever_arm\"]");
		for (int i = 0; i < 100; i++) {
			run(b, -1, 10);
			for (int k = 0; k < 20; k++)
				while (web_has_output(&b->web, clients[k], b->world.now_us, &due_us))
					assert_non_null(web_output(&b->web, clients[k], &size, b->world.now_us));
		}
		forget_events(b);
		if (second == 29) /* each has had its first events of every kind */
			at_first = mallinfo2().uordblks;
	}
	assert_true(mallinfo2().uordblks < at_first + 10000);
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)

int main(void)
{
	const struct CMUnitTest tests[] = {
		TEST(test_a_node_is_found_by_its_heartbeat_and_identified),
		TEST(test_a_node_that_is_silent_for_three_heartbeats_is_lost_and_comes_back),
		TEST(test_a_node_that_boots_is_shown_as_what_it_was_until_it_is_identified_again),
		TEST(test_a_node_without_heartbeat_is_lost_when_it_answers_no_longer),
		TEST(test_a_scan_finds_a_node_that_sends_nothing),
		TEST(test_an_emcy_is_told_in_words),
		TEST(test_the_load_is_that_of_the_bit_rate_and_null_without_one),
		TEST(test_objects_have_units_limits_words_and_defaults),
		TEST(test_the_eds_of_another_revision_is_read_from_the_node_once),
		TEST(test_an_eds_whose_reading_was_interrupted_is_read_again_after_a_boot_up),
		TEST(test_a_node_without_1021h_has_the_eds_of_its_vendor_and_product_or_what_cia301_defines),
		TEST(test_values_are_those_of_the_node),
		TEST(test_a_node_that_does_not_answer_is_told),
		TEST(test_nothing_is_written_without_the_token),
		TEST(test_a_write_is_read_back),
		TEST(test_a_scaled_value_is_written_in_its_unit),
		TEST(test_wrong_tokens_are_slowed_down),
		TEST(test_nmt_store_and_record),
		TEST(test_every_sample_arrives_with_the_values_of_its_pdos),
		TEST(test_a_slow_browser_loses_the_oldest_rows_and_a_fast_one_none),
		TEST(test_a_mapping_is_changed_by_the_procedure_and_rows_follow),
		TEST(test_an_rpdo_is_mapped_with_what_it_can_receive_and_dummies),
		TEST(test_a_mapping_that_the_node_refuses_leaves_the_pdo_as_it_was),
		TEST(test_polls_of_all_browsers_are_ten_a_second),
		TEST(test_sync_ends_with_its_browser_and_there_is_only_one_producer),
		TEST(test_a_saved_configuration_is_loaded_again),
		TEST(test_a_value_that_the_node_refuses_is_named_and_the_others_are_written),
		TEST(test_lss_finds_a_node_without_a_node_id_and_gives_it_one),
		TEST(test_there_are_at_most_32_browsers),
		TEST(test_a_browser_that_fetches_no_answers_is_not_read_from),
		TEST(test_more_than_fifty_requests_a_second_are_refused),
		TEST(test_requests_that_are_none_are_refused),
		TEST(test_a_request_may_have_more_than_ascii),
		TEST(test_names_of_devices_in_another_encoding_arrive_as_utf8),
		TEST(test_a_browser_that_leaves_takes_its_reads_with_it_but_not_its_writes),
		TEST(test_memory_is_constant_with_twenty_browsers),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
