/* Many CANopen nodes in one process, for tests/plant/run: the CANopen core and the dictionary of the gateway, without
 * sensors. They send sample 65535 again and again. After a line on standard input each node sends its four TPDOs HZ
 * times a second, for SECONDS. The sample counter counts from 0, and acceleration and angles follow from it: the
 * receiver knows what it must have got.
 *
 * usage: nodes BUS FIRST COUNT HZ SECONDS: nodes FIRST to FIRST + COUNT - 1. Prints the number of samples of each, and
 * that of frames that could not be sent. */
#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "gateway/canopen/canopen.h"
#include "gateway/canopen/deadline.h"
#include "gateway/canopen/node.h"
#include "od_values.h"
#include "tools/lib/cli.h"

enum { NODES = 127, EACH_SAMPLE = 254, BEYOND_US = 2000000, FLUSH_US = 1000, HELLO_US = 500000, HELLO = 65535 };

static struct simulated {
	struct can_port port; /* first member: what it sends goes to the bus */
	struct od od;
	struct od_values values;
	struct canopen_node node;
} nodes[NODES];
static size_t count;
static struct can_port *bus;

static int relay(struct can_port *port, const struct can_msg *msg)
{
	(void)port;
	return can_send(bus, msg, cli_now_us());
}

static int take_all(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port, (void)ids, (void)n;
	return 0;
}

static void make_node(struct simulated *s, uint8_t id, uint64_t now_us)
{
	static const struct can_ops ops = {.send = relay, .filter = take_all};
	char text[32];

	s->port = (struct can_port){.ops = &ops, .fd = -1};
	od_init(&s->od, &imu9_od_table, &s->values, id);
	s->values.nmt_startup = 0; /* operational by itself */
	for (int i = 1; i <= 4; i++) {
		snprintf(text, sizeof(text), "0x180%d:2", i - 1);
		const struct od_entry *entry = od_find_name(&imu9_od_table, text);
		od_put(&s->od, entry, &(uint8_t){EACH_SAMPLE}, 1);
	}
	if (canopen_init(&s->node, &s->od, &s->port, NULL, id) != 0)
		abort();
	canopen_start(&s->node, now_us);
}

/* tests/plant/run has the same rule. */
static void sample(struct simulated *s, uint8_t id, uint32_t n, uint64_t now_us)
{
	s->values.sample.counter = (uint16_t)n;
	s->values.sample.time = n * 1000;
	s->values.acceleration.l = (int16_t)((n * 7 + id) % 30000 - 15000);
	s->values.acceleration.s = (int16_t)id;
	s->values.angles.yaw = (int16_t)(n % 36000 - 18000);
	canopen_sample(&s->node, now_us);
}

/* Answers SDO, sends heartbeats. */
static void serve_until(uint64_t until_us, int also_fd)
{
	for (;;) {
		uint64_t now_us = cli_now_us(), next_us = until_us;
		struct can_msg msg;

		if (now_us >= until_us)
			return;
		while (can_receive(bus, &msg, now_us) > 0)
			for (size_t i = 0; i < count; i++)
				canopen_receive(&nodes[i].node, &msg, now_us);
		for (size_t i = 0; i < count; i++)
			next_us = earlier(next_us, canopen_tick(&nodes[i].node, now_us));
		cli_wait(bus, also_fd, next_us);
		if (also_fd >= 0 && poll(&(struct pollfd){.fd = also_fd, .events = POLLIN}, 1, 0) > 0)
			return;
	}
}

int main(int argc, char **argv)
{
	double hz, seconds;
	long first, n;

	if (argc != 6 || !cli_integer(argv[2], 1, NODES, &first) || !cli_integer(argv[3], 1, NODES + 1 - first, &n) ||
		!cli_real(argv[4], 0.1, 1000, &hz) || !cli_real(argv[5], 0.1, 1e6, &seconds))
		cli_usage_error("usage: nodes BUS FIRST COUNT HZ SECONDS");
	bus = cli_open_bus(argv[1]);
	count = (size_t)n;
	for (size_t i = 0; i < count; i++)
		make_node(&nodes[i], (uint8_t)(first + (long)i), cli_now_us());
	while (poll(&(struct pollfd){.fd = 0, .events = POLLIN}, 1, 0) == 0) { /* until all are known to the receiver */
		serve_until(cli_now_us() + HELLO_US, 0);
		for (size_t i = 0; i < count; i++)
			sample(&nodes[i], (uint8_t)(first + (long)i), HELLO, cli_now_us());
	}
	uint64_t begin_us = cli_now_us();
	uint32_t samples = (uint32_t)(hz * seconds);
	for (uint32_t k = 0; k < samples; k++)
		for (size_t i = 0; i < count; i++) { /* spread over the period, as nodes without a common clock are */
			serve_until(begin_us + (uint64_t)(1e6 / hz * ((double)k + (double)i / (double)count)), -1);
			while (bus->queue_count > 0) /* a late player must not make the bus lose frames */
				serve_until(cli_now_us() + FLUSH_US, -1);
			sample(&nodes[i], (uint8_t)(first + (long)i), k, cli_now_us());
		}
	serve_until(cli_now_us() + BEYOND_US, -1);
	printf("%u %u\n", samples, bus->counters.tx_dropped);
	can_close(bus);
	return 0;
}
