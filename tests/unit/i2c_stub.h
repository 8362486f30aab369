/* tests/unit/i2c_stub.h
 * An i2c-stub that is fed by the simulated chips of a world, as by tests/rig/i2c_feed: registers are copied once a
 * millisecond, data-ready bits stay set, FIFOs do not empty. */
#ifndef TESTS_UNIT_I2C_STUB_H
#define TESTS_UNIT_I2C_STUB_H

#include "tests/unit/i2c_world.h"

struct i2c_stub {
	struct i2c_bus bus;
	struct world *world;
	uint8_t registers[128][256]; /* by address */
	uint8_t shadow[128][128];    /* of the chips, as last copied */
	int64_t fed_ns;
};

/** Inserts the stub between the driver of `world` and the chips; the board is detected again. */
void stub_begin(struct i2c_stub *stub, struct world *world);

#endif
