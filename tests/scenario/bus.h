/* tests/scenario/bus.h
 * One CANopen node on a simulated bus, in simulated time. A test sends frames and expects frames, each as text: "610 40
 * 00 10 00 00 00 00 00" (identifier and data in hexadecimal), "710 R" (remote).
 *
 * Time passes only in bus_run() and bus_run_until_sent(). They call the node at exactly the deadlines that it returned,
 * and assert that a microsecond before each of them nothing was due. The node is 10h; its heartbeat and the inhibit
 * time of EMCY are off by default.
 */
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
	size_t sent_count, seen; /* the test has expected `seen` of them */
	uint64_t seen_us;	 /* of the last one that was expected */
	bool full;		 /* the bus accepts no frame */
	uint32_t filter[48];
	size_t filter_count;

	uint8_t node_id;
	struct od od;
	struct od_values values;
	struct od_values power_on; /* that a reset restores */
	struct canopen_node node;

	/* the device around the node */
	enum od_status storage_answer; /* of store and restore */
	enum od_group stored, restored, reset;
	unsigned store_calls, restore_calls, reset_calls;
	uint8_t kept_node_id; /* by LSS */
	uint32_t kept_bit_s, active_bit_s;
	uint64_t switched_us; /* time of set_bit_rate() */
	unsigned store_lss_calls;
	unsigned times, collisions;
	uint16_t time_day;
	uint32_t time_ms, collision_id;
	uint64_t time_us;
	enum nmt_state states[64];
	size_t state_count;
};

/** cmocka fixtures: *state is a bus with a started node, pre-operational or operational. */
int bus_pre_operational(void **state);
int bus_operational(void **state);
int bus_teardown(void **state);
#define PRE_OPERATIONAL(test) cmocka_unit_test_setup_teardown(test, bus_pre_operational, bus_teardown)
#define OPERATIONAL(test)     cmocka_unit_test_setup_teardown(test, bus_operational, bus_teardown)

/** The two steps of the fixtures: values may be changed in between. */
struct bus *bus_new(void);
void bus_start(struct bus *bus);
/** bus_new() with another node-ID, or CANOPEN_UNCONFIGURED. */
struct bus *bus_new_with_id(uint8_t node_id);

/** Sends a frame to the node. The text has up to 8 data bytes. */
void bus_send(struct bus *bus, const char *frame);
void bus_send_msg(struct bus *bus, const struct can_msg *msg);
/** Asserts that this is the next frame of the node. */
void bus_expect(struct bus *bus, const char *frame);
/** Asserts that the node has sent no further frame. */
void bus_expect_nothing(struct bus *bus);
/** Sends a command that resets the node, and asserts that it boots up 10 ms later with `boot_up`, its only frame. */
void bus_reset(struct bus *bus, const char *command, const char *boot_up);
/** Waits for the end of the error of wrong frames, or of one that has ended before: within 1 s. */
void bus_expect_error_over(struct bus *bus);
/** Skips the frames sent so far. */
void bus_forget(struct bus *bus);
/** Sends `request`, and asserts that `response` is the only frame sent. */
void bus_exchange(struct bus *bus, const char *request, const char *response);

/** Whether the receive filter has that identifier. */
bool bus_listens_to(const struct bus *bus, uint32_t id);

/** Calls canopen_tick(), after a call of the core that is not in this file. */
void bus_tick(struct bus *bus);
/** Lets time pass. */
void bus_run(struct bus *bus, uint64_t us);
/** Lets time pass until the node has sent something new, for at most `us`. */
void bus_run_until_sent(struct bus *bus, uint64_t us);
/** Publishes a sample with this counter. */
void bus_sample(struct bus *bus, uint16_t counter);

/** Expedited download: the abort code, or 0. Upload: the value. */
uint32_t bus_write(struct bus *bus, uint16_t index, uint8_t sub, size_t size, uint32_t value);
uint32_t bus_read(struct bus *bus, uint16_t index, uint8_t sub);
/** Sets a value without hooks, as a configuration file does. */
void bus_put(struct bus *bus, uint16_t index, uint8_t sub, size_t size, uint32_t value);
/** Makes the hardware version 1009h, a string of up to 32 bytes, writable. */
const char *bus_writable_string(struct bus *bus);

#endif
