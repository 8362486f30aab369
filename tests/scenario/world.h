/* tests/scenario/world.h
 * The world around a whole device (gateway/device.h), in simulated time: a sensor that moves as a signal says
 * (model/sim/sensor.h), a bus that keeps what the device sends, and a disk. The clock moves with each sample, and where a
 * test moves it.
 *
 * A test that needs more around its device puts the world first into a struct of its own. */
#ifndef TESTS_SCENARIO_WORLD_H
#define TESTS_SCENARIO_WORLD_H

#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include "gateway/device.h"
#include "model/sim/sensor.h"

#define assert_near(a, b, tolerance) assert_true(fabs((double)(a) - (double)(b)) <= (tolerance))

enum { WORLD_NODE_ID = 16, WORLD_FRAMES = 4096 };

struct world {
	struct can_port bus;
	struct imu_port imu;
	struct device device;
	struct sensor sensor;
	const struct signal *signal;
	struct can_msg
		frames[WORLD_FRAMES]; /* sent by the device, the last WORLD_FRAMES; frame k at k % WORLD_FRAMES */
	size_t frame_count;
	struct store_image disk; /* what the storage holds */
	int disk_answer;	 /* 0, or an errno of the storage */
	uint8_t node_id;	 /* of the command line; one that LSS stored wins over it */
	uint32_t serial;	 /* 1018h:4, of the command line */
	uint64_t now_us, interval_us;
};

/** A device that is still off, with a sensor of this kind that moves as `signal` says. `w` is all 0. */
void world_init(struct world *w, const struct sensor_config *sensor, uint64_t seed, const char *signal);
/** Switches it on, or off and on, as main() does; with `settings` (up to a NULL) for a configuration file, or NULL. */
void world_power_on(struct world *w, const char *const *settings);
/** Both, for a test that needs no more around its device; to be freed. */
struct world *world_new(const struct sensor_config *sensor, uint64_t seed, const char *signal);
/** cmocka fixture: frees *state. */
int world_tear_down(void **state);

/** The device receives a frame, now. */
void world_receive(struct world *w, uint32_t id, size_t len, const void *data);
void world_nmt(struct world *w, uint8_t command);
/** The last of those frames that the device sent; NULL if there is none. */
const struct can_msg *world_last(const struct world *w, uint32_t id);
/** How many of them it sent. */
unsigned world_count(const struct world *w, uint32_t id);
/** The error code of the last EMCY message; 0 if that ended an error, or if there is none. */
uint16_t world_emcy_code(const struct world *w);
/** Expedited download; the abort code, or 0. */
uint32_t world_sdo_write(struct world *w, uint16_t index, uint8_t sub, const void *value, size_t size);

/** An interval passes, and the driver delivers this sample; the next one of the sensor; the next n; those of s seconds. */
void world_deliver(struct world *w, const struct imu_sample *sample);
void world_sample(struct world *w);
void world_samples(struct world *w, int n);
void world_seconds(struct world *w, double s);

#endif
