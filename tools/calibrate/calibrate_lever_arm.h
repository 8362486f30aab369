/* tools/calibrate/calibrate_lever_arm.h
 * imu9-calibrate lever-arm: identifies the lever arm from a log, or in a gateway on the bus. */
#ifndef TOOLS_CALIBRATE_CALIBRATE_LEVER_ARM_H
#define TOOLS_CALIBRATE_CALIBRATE_LEVER_ARM_H

#include <stdbool.h>
#include <stdint.h>

/** argv[0] is the name of the subcommand. Returns an exit code of cli.h. */
int calibrate_lever_arm(int argc, char **argv);

/** On the bus. */
struct lever_request {
	const char *bus;
	uint8_t node;
	unsigned timeout_ms;
	bool yes, reference;	     /* do not ask; 2075h gives the acceleration of the reference point */
	struct procedure_lead *lead; /* or NULL */
};
int calibrate_lever_live(const struct lever_request *request);

/** The axes about which it has to be turned more ("s and t"), or NULL: none is missing. From the sigma of r, or, before
 * there is one, from the RMS of the rates. */
const char *calibrate_missing_by_sigma(const double sigma_m[3]);
const char *calibrate_missing_by_rate(const double rate_rad_s[3]);

#endif
