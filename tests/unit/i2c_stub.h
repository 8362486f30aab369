/* tests/unit/i2c_stub.h
 * An i2c-stub with the simulated chips of a world behind it, as tests/rig/i2c_feed makes it: registers that are carried
 * over once a millisecond, ready bits that stay, FIFOs that do not empty. */
#ifndef TESTS_UNIT_I2C_STUB_H
#define TESTS_UNIT_I2C_STUB_H

#include "tests/unit/i2c_world.h"

struct i2c_stub {
	struct i2c_bus bus;
	struct world *world;
	uint8_t registers[128][256]; /* by address */
	uint8_t shadow[128][128];    /* of the chips, as last carried over */
	int64_t fed_ns;
};

/** Puts it between the driver of `world`, which detects its board anew, and the chips. */
void stub_begin(struct i2c_stub *stub, struct world *world);

#endif
