/* tools/calibrate/calibrate_lever_arm.h
 * imu9-calibrate lever-arm: identifies the lever arm from a log. */
#ifndef TOOLS_CALIBRATE_CALIBRATE_LEVER_ARM_H
#define TOOLS_CALIBRATE_CALIBRATE_LEVER_ARM_H

/** argv[0] is the name of the subcommand. Returns an exit code of cli.h. */
int calibrate_lever_arm(int argc, char **argv);

#endif
