/* tests/scenario/hammer.h
 * A device in simulated time whose windows are hammered: random writes within and beyond the limits, by Modbus
 * (functions 16 and 43/13), CiA 309-3 and SDO; several values at once, NMT commands, stores, restores and PDO mappings.
 * The test keeps a model of the dictionary beside it: the value of each stored object, as it was acknowledged, and what
 * a reset has to make of it. */
#ifndef TESTS_SCENARIO_HAMMER_H
#define TESTS_SCENARIO_HAMMER_H

#include <stdint.h>

struct hammer_count {
	unsigned written[4], refused; /* by Modbus, function 43/13, CiA 309-3, SDO; of all */
	unsigned read, blocks, remaps, stores, restores, resets;
	unsigned objects;  /* that were written at least once */
	unsigned compared; /* objects that were compared with the model, in all */
	long grown;	   /* bytes of heap since the first tenth */
};

/** Runs so many seconds of bus life; fails (cmocka's assertions) as soon as dictionary and model differ. */
struct hammer_count hammer(unsigned seconds, uint64_t seed);

#endif
