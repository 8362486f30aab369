/* tests/scenario/world.h
 * A whole device (gateway/device.h) in simulated time: a simulated sensor (model/sim/sensor.h) that moves by a signal,
 * a bus that records the frames of the device, and a storage. Time passes with each sample, and where a test adds to
 * now_us.
 *
 * A test that needs more around its device has the world as the first member of its own struct. */
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
	struct store_image disk; /* content of the storage */
	int disk_answer;	 /* 0, or the negative errno of the storage; -EINPROGRESS: device_saved() will end it */
	bool disk_waits;	 /* for that */
	struct store_image to_disk; /* what the disk will have */
	uint8_t node_id;	    /* of the command line; one that LSS stored takes precedence */
	uint32_t serial;	    /* 1018h:4, of the command line */
	uint32_t vendor;	    /* vendor_id of the configuration, or 0 */
	uint64_t now_us, interval_us;
};

/** A device that is off, with a sensor of this kind that moves by `signal`. `w` is zeroed. */
void world_init(struct world *w, const struct sensor_config *sensor, uint64_t seed, const char *signal);
/** Switches it on, or off and on, as main() does; without an inhibit time of EMCY. `settings` (NULL-terminated, or
 * NULL) are its configuration file. */
void world_power_on(struct world *w, const char *const *settings);
/** Both; allocated, to be freed by world_tear_down(). */
struct world *world_new(const struct sensor_config *sensor, uint64_t seed, const char *signal);
/** cmocka fixture: frees *state. */
int world_tear_down(void **state);

/** The device receives a frame. */
void world_receive(struct world *w, uint32_t id, size_t len, const void *data);
void world_nmt(struct world *w, uint8_t command);
/** The last frame with this identifier that the device sent, or NULL. */
const struct can_msg *world_last(const struct world *w, uint32_t id);
/** How many of the recorded frames have this identifier. */
unsigned world_count(const struct world *w, uint32_t id);
/** The code of the last EMCY message, 0 if there is none. */
uint16_t world_emcy_code(const struct world *w);
/** Expedited download: the abort code, or 0. */
uint32_t world_sdo_write(struct world *w, uint16_t index, uint8_t sub, const void *value, size_t size);

/** An interval passes and the driver delivers: this sample; the next one of the sensor; the next n; those of s seconds.
 */
void world_deliver(struct world *w, const struct imu_sample *sample);
void world_sample(struct world *w);
void world_samples(struct world *w, int n);
void world_seconds(struct world *w, double s);

#endif
