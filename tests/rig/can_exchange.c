/* can_exchange BUS SEND-ID RECEIVE-ID COUNT
 *
 * Sends COUNT numbered frames through the driver of BUS at the rate of a full bus of 500 kbit/s and receives COUNT
 * frames at the same time. Run it on both ends of a bus; it starts when it has received from the other end. Status 0:
 * all frames were received once and in order, and none was lost in sending. */
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "drivers/ports/can.h"

enum { FRAME_US = 250, HELLO_US = 50000, PATIENCE_US = 10000000 };
#define HELLO UINT32_MAX /* in place of a number, until the other end is heard */

struct exchange {
	struct can_port *port;
	uint32_t send_id, receive_id, count;
	uint32_t sent, received, disordered;
	uint64_t hello_at_us;
	uint64_t begun_us, last_us; /* begun: 0 until the other end was received */
	uint64_t delay_max_us;	    /* from the time of a frame to can_receive() */
};

static uint64_t now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (uint64_t)t.tv_sec * 1000000 + (uint64_t)t.tv_nsec / 1000;
}

static bool send_number(struct exchange *x, uint32_t number, uint64_t now_us)
{
	struct can_msg msg = {.id = x->send_id, .len = 8};

	memcpy(msg.data, &number, sizeof(number));
	return can_send(x->port, &msg, now_us) == 0;
}

static void send_due(struct exchange *x, uint64_t now_us)
{
	if (x->begun_us == 0 && now_us >= x->hello_at_us) {
		x->hello_at_us = now_us + HELLO_US;
		send_number(x, HELLO, now_us);
	}
	while (x->begun_us > 0 && x->sent < x->count && now_us >= x->begun_us + (uint64_t)x->sent * FRAME_US &&
		x->port->queue_count < CAN_QUEUE_LEN / 2) {
		if (!send_number(x, x->sent, now_us))
			return;
		x->sent++;
	}
}

static void receive_all(struct exchange *x, uint64_t now_us)
{
	struct can_msg msg;
	uint32_t number;

	while (can_receive(x->port, &msg, now_us) > 0) {
		if (msg.id != x->receive_id || msg.len != 8)
			continue;
		memcpy(&number, msg.data, sizeof(number));
		if (x->begun_us == 0) {
			x->begun_us = now_us;
			send_number(x, HELLO, now_us); /* the other end may have missed the first */
		}
		if (number == HELLO)
			continue;
		x->disordered += number != x->received;
		x->received++;
		x->last_us = now_us;
		if (now_us - msg.t_us > x->delay_max_us && msg.t_us <= now_us)
			x->delay_max_us = now_us - msg.t_us;
	}
}

static bool is_done(const struct exchange *x)
{
	return x->sent == x->count && x->received >= x->count && x->port->queue_count == 0;
}

static void run(struct exchange *x)
{
	struct pollfd fd = {.fd = x->port->fd, .events = POLLIN};
	uint64_t now_us = now(), moved_us = now_us;
	uint32_t moved = 0; /* frames in both directions */

	x->last_us = now_us;
	while (!is_done(x) && now_us - moved_us < PATIENCE_US) {
		poll(&fd, 1, 1);
		now_us = now();
		receive_all(x, now_us);
		can_service(x->port, now_us);
		send_due(x, now_us);
		if (moved != x->received + x->port->counters.tx) {
			moved = x->received + x->port->counters.tx;
			moved_us = now_us;
		}
	}
	/* frames for the other end may still be queued */
	for (uint64_t end_us = now_us + 500000; now_us < end_us; now_us = now()) {
		poll(&fd, 1, 10);
		receive_all(x, now_us);
		can_service(x->port, now_us);
	}
}

int main(int argc, char **argv)
{
	struct exchange x = {0};
	char error[300];

	if (argc != 5) {
		fprintf(stderr, "usage: can_exchange BUS SEND-ID RECEIVE-ID COUNT\n");
		return 2;
	}
	if (can_open(argv[1], &x.port, error, sizeof(error)) < 0) {
		fprintf(stderr, "can_exchange: %s\n", error);
		return 1;
	}
	x.send_id = (uint32_t)strtoul(argv[2], NULL, 16);
	x.receive_id = (uint32_t)strtoul(argv[3], NULL, 16);
	x.count = (uint32_t)strtoul(argv[4], NULL, 10);
	run(&x);
	const struct can_counters *c = &x.port->counters;
	printf("%s: sent %u received %u of %u, disordered %u, tx_dropped %u rx_dropped %u tx_retries %u, %.2f s, "
	       "up to %.1f ms after it was on the bus\n",
		x.port->name, x.sent, x.received, x.count, x.disordered, c->tx_dropped, c->rx_dropped, c->tx_retries,
		(double)(x.last_us - x.begun_us) / 1e6, (double)x.delay_max_us / 1e3);
	can_close(x.port);
	return x.sent == x.count && x.received == x.count && x.disordered == 0 && c->tx_dropped + c->rx_dropped == 0
		       ? EXIT_SUCCESS
		       : EXIT_FAILURE;
}
