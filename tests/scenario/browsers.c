#include "tests/scenario/browsers.h"

#include <json-c/json.h>
#include <malloc.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model/sim/rng.h"
#include "tests/scenario/world.h"
#include "tools/web/web.h"

#define TOKEN "0123456789abcdef0123456789abcdef"
#define NODE  "\"node\":16"
enum { GUESTS = 25, STEP_US = 10000, MINUTE_STEPS = 6000, QUEUE = 512, QUIET_STEPS = 10000 };
enum { OFF_FROM = 3000, OFF_STEPS = 450, IDENTITIES = 3 };

static const struct {
	const char *op, *members;
	unsigned weight;
	bool refused; /* always; the others are answered at least once */
} REQUESTS[] = {
	{"hello", "", 4, false},
	{"nodes", "", 4, false},
	{"scan", "", 1, false},
	{"objects", NODE, 6, false},
	{"read", NODE ",\"objects\":[\"lever_arm\",\"gravity\",\"nonsense\",\"5FFFh\"]", 20, false},
	{"read", NODE ",\"objects\":[\"event_log\",\"calibration_gyro\",\"1018h:04\"]", 4, false},
	{"read", "\"node\":17,\"objects\":[\"device_type\"]", 2, true},
	{"events", NODE, 6, false},
	{"subscribe", NODE ",\"hz\":20", 20, false},
	{"unsubscribe", NODE, 4, false},
	{"poll", NODE ",\"objects\":[\"position\",\"position_sigma\"],\"hz\":4", 8, false},
	{"poll", NODE ",\"objects\":[],\"hz\":0", 2, false},
	{"mapping", NODE, 6, false},
	{"save", NODE ",\"format\":\"ini\"", 2, false},
	{"save", NODE ",\"format\":\"dcf\"", 2, false},
	{"compare", NODE ",\"format\":\"ini\",\"text\":\"[lever_arm]\\nl = 0.25\\ns = 11\\n\"", 2, false},
	{"unlock", "\"token\":\"" TOKEN "\"", 40, false},
	{"write", NODE ",\"object\":\"lever_arm.l\",\"value\":0.05", 20, false},
	{"write", NODE ",\"object\":\"lever_arm.l\",\"value\":50", 2, true},
	{"load", NODE ",\"format\":\"ini\",\"text\":\"[lever_arm]\\nl = 0.25\\ns = 11\\n\"", 2, false},
	{"load", NODE ",\"format\":\"ini\",\"text\":\"x=1\"", 2, true},
	{"store", NODE ",\"group\":\"all\"", 2, false},
	{"restore", NODE ",\"group\":\"all\"", 1, false},
	{"nmt", NODE ",\"command\":\"start\"", 8, false},
	{"nmt", NODE ",\"command\":\"preop\"", 1, false},
	{"nmt", NODE ",\"command\":\"reset\"", 1, false},
	{"set_mapping", NODE ",\"pdo\":1,\"type\":1,\"entries\":[\"velocity.x\",\"sample.counter\"]", 4, false},
	{"set_mapping", NODE ",\"pdo\":1,\"type\":250,\"entries\":[\"velocity.x\"]", 1, true},
	{"sync", "\"hz\":100", 10, false},
	{"lss", "\"command\":\"find\"", 1, false},
	{"record", NODE ",\"on\":true", 2, true}, /* it has no folder for recordings */
	{"record", NODE ",\"on\":false", 2, true},
	{"nonsense", "", 1, true},
};
enum { KINDS = sizeof(REQUESTS) / sizeof(REQUESTS[0]) };

struct guest {
	int client; /* -1: away */
	bool slow;
};

struct house {
	struct world world;	    /* first member: its bus gives a pointer to it */
	struct can_port bus;	    /* of imu9-web */
	struct can_msg sent[QUEUE]; /* by imu9-web, not received by the device yet */
	size_t sent_count, seen;    /* seen: frames of the device that imu9-web has received */
	bool off;		    /* the device */
	bool was_lost;
	uint32_t revision; /* of its own EDS */
	struct web_token token;
	struct web web;
	struct guest guests[GUESTS];
	bool answered[KINDS];
	size_t heap[IDENTITIES];
	struct rng rng;
	struct browsers_count count;
};

static bool dice(struct house *h, unsigned sides)
{
	return rng_uniform(&h->rng) * sides < 1;
}

/* ---- the bus ----------------------------------------------------------------------------------------------------- */

static int take(struct can_port *port, const struct can_msg *msg)
{
	struct house *h = (struct house *)((char *)port - offsetof(struct house, bus));

	assert_true(h->sent_count < QUEUE);
	h->sent[h->sent_count++] = *msg;
	if (msg->id == 0x600 + WORLD_NODE_ID && memcmp(msg->data, "\xA4\x21\x10", 3) == 0) /* block upload of 1021h */
		h->count.eds_read++;
	return 0;
}

/* All frames that are under way, in both directions. */
static void settle(struct house *h)
{
	struct world *w = &h->world;

	while (h->sent_count > 0 || h->seen < w->frame_count) {
		while (h->seen < w->frame_count) {
			struct can_msg msg = w->frames[h->seen++ % WORLD_FRAMES];

			msg.t_us = w->now_us;
			web_receive(&h->web, &msg, w->now_us);
		}
		web_tick(&h->web, w->now_us);
		for (size_t i = 0, n = h->sent_count; i < n && !h->off; i++)
			world_receive(w, h->sent[i].id, h->sent[i].len, h->sent[i].data);
		h->sent_count = 0;
	}
}

static void step(struct house *h)
{
	if (h->off)
		h->world.now_us += STEP_US;
	else
		world_sample(&h->world);
	web_tick(&h->web, h->world.now_us);
	settle(h);
	bool lost = h->web.nodes[WORLD_NODE_ID].state == WATCH_NMT_LOST;
	h->count.lost += lost && !h->was_lost;
	h->was_lost = lost;
}

/* ---- browsers ---------------------------------------------------------------------------------------------------- */

/* The id of a request is its kind. */
static void hear(struct house *h, const char *text, size_t size)
{
	unsigned kind;
	int at = 0;

	h->count.megabytes += (double)size / 1e6;
	if (sscanf(text, "{\"id\":%u,\"ok\":true%n", &kind, &at) == 1 && at > 0) {
		assert_true(kind < KINDS && !REQUESTS[kind].refused);
		h->answered[kind] = true;
		h->count.answers++;
	} else if (strncmp(text, "{\"id\":", 6) == 0) {
		h->count.refusals++;
	}
}

static void read_messages(struct house *h, int client, int most)
{
	uint64_t due_us = UINT64_MAX;
	size_t size;

	for (int i = 0; i < most && web_has_output(&h->web, client, h->world.now_us, &due_us); i++) {
		const char *text = web_output(&h->web, client, &size, h->world.now_us);

		assert_non_null(text);
		hear(h, text, size);
	}
}

static unsigned any_kind(struct house *h)
{
	unsigned sum = 0, kind = 0;

	for (unsigned i = 0; i < KINDS; i++)
		sum += REQUESTS[i].weight;
	double left = rng_uniform(&h->rng) * sum;
	while (kind < KINDS - 1 && left >= REQUESTS[kind].weight)
		left -= REQUESTS[kind++].weight;
	return kind;
}

static void ask(struct house *h, int client)
{
	char text[512];
	unsigned kind = any_kind(h);
	size_t size = (size_t)snprintf(text, sizeof(text), "{\"id\":%u,\"op\":\"%s\"%s%s}", kind, REQUESTS[kind].op,
		REQUESTS[kind].members[0] ? "," : "", REQUESTS[kind].members);

	if (!web_takes_input(&h->web, client))
		return;
	if (dice(h, 100))
		size = (size_t)(rng_uniform(&h->rng) * (double)size); /* it is cut off: no JSON */
	web_request(&h->web, client, text, size, h->world.now_us);
	h->count.requests++;
}

static void come(struct house *h, struct guest *guest)
{
	guest->client = web_connect(&h->web, h->world.now_us);
	assert_true(guest->client >= 0);
	guest->slow = dice(h, 4);
	h->count.connections++;
}

static void leave(struct house *h, struct guest *guest)
{
	if (guest->client >= 0)
		web_disconnect(&h->web, guest->client);
	guest->client = -1;
}

/* Each comes after 2 s, stays for 15 s, and asks for something each 1.5 s, in the mean. */
static void live(struct house *h, struct guest *guest)
{
	if (guest->client < 0) {
		if (dice(h, 200))
			come(h, guest);
		return;
	}
	if (!guest->slow)
		read_messages(h, guest->client, 1000);
	else if (dice(h, 300))
		read_messages(h, guest->client, 1);
	if (dice(h, 150))
		ask(h, guest->client);
	if (dice(h, 1500))
		leave(h, guest);
}

/* ---- an hour ----------------------------------------------------------------------------------------------------- */

static size_t in_use(void)
{
	struct mallinfo2 info = mallinfo2();

	return info.uordblks + info.hblkhd;
}

static bool is_quiet(const struct house *h)
{
	return h->web.nodes[WORLD_NODE_ID].job_count == 0 && h->web.scan_id == 0 &&
	       h->web.lss.doing == WEB_LSS_NOTHING && h->web.nodes[17].job_count == 0;
}

static void minute(struct house *h, unsigned number)
{
	world_nmt(&h->world, 0x82); /* reset communication: it is asked for its identity again */
	h->world.device.values.identity.revision_number = h->revision + number % IDENTITIES;
	for (int i = 0; i < MINUTE_STEPS; i++) {
		h->off = i >= OFF_FROM && i < OFF_FROM + OFF_STEPS;
		step(h);
		for (int k = 0; k < GUESTS; k++)
			live(h, &h->guests[k]);
		size_t now = i % 100 == 0 ? in_use() : 0;
		h->count.peak = now > h->count.peak ? now : h->count.peak;
	}
	for (int k = 0; k < GUESTS; k++)
		leave(h, &h->guests[k]);
	for (int i = 0; i < QUIET_STEPS && (i < 500 || !is_quiet(h)); i++)
		step(h);
	assert_true(is_quiet(h));
}

/* What is known of the device depends on its identity. */
static void compare(struct house *h, unsigned number)
{
	size_t now = in_use(), *known = &h->heap[number % IDENTITIES];

	if (number < BROWSERS_WARM_UP) {
		*known = h->count.heap = now;
		return;
	}
	size_t grown = now > *known ? now - *known : *known - now;
	h->count.grown = grown > h->count.grown ? grown : h->count.grown;
}

struct browsers_count browsers(unsigned minutes, uint64_t seed)
{
	static const struct can_ops ops = {.send = take};
	static const char *const settings[] = {"producer_heartbeat_time=1000", NULL};
	struct sensor_config sensor = *sensor_preset("ideal");
	struct house *h = calloc(1, sizeof(*h));

	assert_non_null(h);
	rng_init(&h->rng, seed);
	sensor.rate_hz = 100;
	h->world.now_us = 1000000;
	world_init(&h->world, &sensor, seed, "square");
	world_power_on(&h->world, settings);
	h->revision = h->world.device.values.identity.revision_number;
	h->bus = (struct can_port){.ops = &ops, .fd = -1};
	snprintf(h->token.text, sizeof(h->token.text), TOKEN);
	web_init(&h->web, &(struct web_config){.bus = &h->bus, .bus_name = "sim", .token = &h->token}, h->world.now_us);
	for (int k = 0; k < GUESTS; k++)
		h->guests[k].client = -1;
	for (unsigned i = 0; i < minutes; i++) {
		minute(h, i);
		compare(h, i);
	}
	for (size_t i = 0; i < KINDS; i++)
		if (!h->answered[i] && !REQUESTS[i].refused)
			fail_msg("never answered: %s %s", REQUESTS[i].op, REQUESTS[i].members);
	web_free(&h->web);
	struct browsers_count count = h->count;
	free(h);
	return count;
}
