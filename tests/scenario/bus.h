/* tests/scenario/bus.h
 * One CANopen node on a bus that exists only here, in simulated time. A test says what it puts on the bus and what it
 * expects there, each frame as text: "610 40 00 10 00 00 00 00 00" (identifier and data in hex), "710 R" (remote).
 *
 * The clock moves only in bus_run(), which calls the node at exactly the deadlines it asked for, and makes sure that a
 * microsecond before each of them nothing was due. The node is 10h; its heartbeat is off unless a test wants it. */
#ifndef TESTS_SCENARIO_BUS_H
#define TESTS_SCENARIO_BUS_H

#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include "gateway/canopen/node.h"
#include "od_values.h"

enum { BUS_NODE_ID = 0x10, BUS_FRAMES = 8192 };

struct bus {
	struct can_port port;
	uint64_t now_us, deadline_us;
	struct {
		uint64_t t_us;
		struct can_msg msg;
	} sent[BUS_FRAMES];	 /* by the node */
	size_t sent_count, seen; /* `seen` of them were expected by the test */
	uint64_t seen_us;	 /* when the last one of those was sent */
	bool full;		 /* the bus takes nothing for now */
	uint32_t filter[32];
	size_t filter_count;

	uint8_t node_id;
	struct od od;
	struct od_values values;
	struct od_values power_on; /* what the device resets to */
	struct canopen_node node;

	/* the device around the node */
	enum od_status storage_answer; /* of store and restore */
	enum od_group stored, restored, reset;
	unsigned store_calls, restore_calls, reset_calls;
	uint8_t kept_node_id; /* by LSS */
	uint32_t kept_bit_s, active_bit_s;
	uint64_t switched_us; /* when the bit rate was set */
	unsigned store_lss_calls;
	unsigned times, collisions;
	uint16_t time_day;
	uint32_t time_ms, collision_id;
	uint64_t time_us;
	enum nmt_state states[64];
	size_t state_count;
};

/** cmocka fixtures: *state is a started bus whose boot-up was seen, pre-operational or operational. */
int bus_pre_operational(void **state);
int bus_operational(void **state);
int bus_teardown(void **state);
#define PRE_OPERATIONAL(test) cmocka_unit_test_setup_teardown(test, bus_pre_operational, bus_teardown)
#define OPERATIONAL(test)     cmocka_unit_test_setup_teardown(test, bus_operational, bus_teardown)

/** The same by hand: values may be changed between the two. */
struct bus *bus_new(void);
void bus_start(struct bus *bus);
/** With another node-ID, or CANOPEN_UNCONFIGURED. */
struct bus *bus_new_with_id(uint8_t node_id);

/** Puts a frame on the bus, now. The first form takes no more than 8 data bytes. */
void bus_send(struct bus *bus, const char *frame);
void bus_send_msg(struct bus *bus, const struct can_msg *msg);
/** The next frame that the node sent and that nobody expected yet is this one. */
void bus_expect(struct bus *bus, const char *frame);
void bus_expect_nothing(struct bus *bus);
void bus_forget(struct bus *bus); /* whatever was sent is not of interest */
/** bus_send(), and then this and nothing else is the answer. */
void bus_exchange(struct bus *bus, const char *request, const char *response);

/** Whether the node asked the bus for that identifier. */
bool bus_listens_to(const struct bus *bus, uint32_t id);

/** After a call of the core that did not go through here. */
void bus_tick(struct bus *bus);
/** Lets time pass. */
void bus_run(struct bus *bus, uint64_t us);
/** Lets time pass until the node has sent something new, for at most `us`. */
void bus_run_until_sent(struct bus *bus, uint64_t us);
/** A new sample stands in the dictionary, with this counter. */
void bus_sample(struct bus *bus, uint16_t counter);

/** Expedited SDO; the abort code, or 0. */
uint32_t bus_write(struct bus *bus, uint16_t index, uint8_t sub, size_t size, uint32_t value);
uint32_t bus_read(struct bus *bus, uint16_t index, uint8_t sub);
/** A value set behind the core's back, as a configuration file does it. */
void bus_put(struct bus *bus, uint16_t index, uint8_t sub, size_t size, uint32_t value);
/** The hardware version 1009h, a string of up to 32 bytes, as if it could be written. */
const char *bus_writable_string(struct bus *bus);

#endif
