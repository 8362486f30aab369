/* imu9-web without its network: browsers that send anything, and nodes that send anything, at any time. Host, Origin
 * and address are parsed from the first bytes. Whatever comes, each message to a browser is UTF-8 and JSON, nothing is
 * written without the token, and at the end all memory is given back. */
#include <json-c/json.h>
#include <string.h>

#include "tests/fuzz/fuzz.h"
#include "tools/web/web.h"

#define TOKEN "0123456789abcdef"
enum { NODE = 5, TEXT_MAX = 400, CLIENTS = 3, SENT_MAX = 64, LONG = 20000 };

static struct web web;
static struct can_msg sent[SENT_MAX];
static size_t sent_count;
static bool unlocked;

static int take(struct can_port *port, const struct can_msg *msg)
{
	bool download = msg->id >= 0x601 && msg->id <= 0x67F && (msg->data[0] & 0xE0) == 0x20;

	(void)port;
	require(unlocked || (!download && msg->id != 0x000 && msg->id != 0x080 && msg->id != 0x7E5));
	if (sent_count < SENT_MAX)
		sent[sent_count++] = *msg;
	return 0;
}

/* Answers the last SDO request: 4 bytes of the input, or an abort, so that jobs go on. */
static void answer_sdo(struct input *in, uint64_t now_us)
{
	const struct can_msg *request = sent_count ? &sent[--sent_count] : NULL;
	uint8_t what = read_byte(in);
	struct can_msg msg = {.len = 8, .t_us = now_us};

	if (!request || request->id <= 0x600 || request->id > 0x67F)
		return;
	msg.id = request->id - 0x80;
	memcpy(msg.data + 1, request->data + 1, 3);
	if (what & 0x80)
		msg.data[0] = 0x80;
	else if (what & 0x40)
		msg.data[0] = (uint8_t)((request->data[0] & 0xE0) == 0x20 ? 0x60 : 0x41); /* a size: segments follow */
	else
		msg.data[0] = (uint8_t)((request->data[0] & 0xE0) == 0x20 ? 0x60 : 0x43 | (what & 3) << 2);
	read_bytes(in, msg.data + 4, 4);
	web_receive(&web, &msg, now_us);
}

static void any_frame(struct input *in, uint64_t now_us)
{
	struct can_msg msg = {.t_us = now_us};
	uint8_t what = read_byte(in);

	msg.id = (uint32_t)(read_byte(in) | (what & 7) << 8);
	if (what & 0x80)
		msg.id = (msg.id & 0x780) | NODE;
	msg.len = what >> 3 & 8 ? 8 : what >> 3 & 7;
	read_bytes(in, msg.data, msg.len);
	web_receive(&web, &msg, now_us);
}

static void any_request(struct input *in, int client, uint64_t now_us)
{
	char text[TEXT_MAX];
	size_t size = 0;

	while (in->size > 0 && size < TEXT_MAX) {
		text[size] = (char)read_byte(in);
		if (text[size] == '\n')
			break;
		size++;
	}
	if (web_takes_input(&web, client))
		web_request(&web, client, text, size, now_us);
	unlocked |= web.clients[client].unlocked;
}

/* The list of all objects is a hundred times as long as any other answer, and mostly the one that was checked last. */
static bool was_checked(const char *text, size_t size)
{
	static const char HEAD[] = "{\"id\":";
	static char last[1 << 20];
	static size_t last_size;
	size_t head = sizeof(HEAD) - 1;

	if (size < LONG || size > sizeof(last) || memcmp(text, HEAD, head) != 0)
		return false;
	head += strspn(text + head, "0123456789");
	if (size - head == last_size && memcmp(text + head, last, last_size) == 0)
		return true;
	last_size = size - head;
	memcpy(last, text + head, last_size);
	return false;
}

static void pull(int client, uint64_t now_us)
{
	uint64_t due_us = UINT64_MAX;
	size_t size;

	for (int i = 0; i < 50 && web_has_output(&web, client, now_us, &due_us); i++) {
		const char *text = web_output(&web, client, &size, now_us);
		struct json_tokener *tokener;

		require(text);
		if (was_checked(text, size))
			continue;
		tokener = json_tokener_new();
		json_tokener_set_flags(tokener, JSON_TOKENER_VALIDATE_UTF8);
		struct json_object *json = json_tokener_parse_ex(tokener, text, (int)size);
		require(json_tokener_get_error(tokener) == json_tokener_success);
		require(json_object_is_type(json, json_type_object));
		json_object_put(json);
		json_tokener_free(tokener);
	}
}

static void headers(struct input *in)
{
	static const char *const names[] = {"robot.example"};
	char host[64], origin[64], address[64];
	int port;

	read_bytes(in, host, sizeof(host) - 1);
	read_bytes(in, origin, sizeof(origin) - 1);
	host[sizeof(host) - 1] = origin[sizeof(origin) - 1] = '\0';
	if (web_host_allowed(host, names, 1))
		require(strspn(host, "0123456789abcdefABCDEFlochstrbexmpLOCHSTRBEXMP.:[]") == strlen(host));
	if (web_origin_allowed(origin, host))
		require(strlen(origin) > strlen(host) && strncmp(origin, "http", 4) == 0);
	if (web_listen_address(host, address, &port))
		require(port >= 0 && port <= 65535);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	static const struct can_ops ops = {.send = take};
	struct can_port bus = {.ops = &ops, .fd = -1};
	struct web_token token = {.text = TOKEN};
	const struct web_config config = {.bus = &bus, .bus_name = "fuzz", .token = &token};
	struct input in = {data, size};
	uint64_t now_us = 1000000;
	int clients[CLIENTS];

	if (size > 0 && data[0] == 'H') {
		headers(&in);
		return 0;
	}
	sent_count = 0;
	unlocked = false;
	web_init(&web, &config, now_us);
	for (int i = 0; i < CLIENTS; i++)
		clients[i] = web_connect(&web, now_us);
	while (in.size > 0) {
		uint8_t what = read_byte(&in);
		int *client = &clients[what >> 4 & 1];

		switch (what & 7) {
		case 0:
		case 1:
			any_request(&in, *client, now_us);
			break;
		case 2:
		case 3:
			answer_sdo(&in, now_us);
			break;
		case 4:
			any_frame(&in, now_us);
			break;
		case 5:
			now_us += (uint64_t)read_byte(&in) * (what & 8 ? 100000 : 1000);
			break;
		case 6:
			pull(*client, now_us);
			break;
		default:
			web_disconnect(&web, *client);
			*client = web_connect(&web, now_us);
			require(*client >= 0);
			break;
		}
		uint64_t next_us = web_tick(&web, now_us);
		require(next_us > 0);
	}
	for (int i = 0; i < CLIENTS; i++)
		pull(clients[i], now_us);
	web_free(&web);
	return 0;
}
