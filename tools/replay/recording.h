/* tools/replay/recording.h
 * Replays a file of imu9-gateway --record (gateway/record_file.h): the device of the gateway, with ports that give what
 * those of the recording gave. It continues from the state in the file when this program and the gateway are of one
 * build; otherwise it starts with the recorded configuration, and says so. Failures end the program, as in
 * cli_file.h. */
#ifndef TOOLS_REPLAY_RECORDING_H
#define TOOLS_REPLAY_RECORDING_H

#include <stdbool.h>

#include "gateway/config.h"
#include "gateway/device.h"

struct recording_events {
	void *ctx;
	/** The pipeline has processed a sample; its output is d->pipeline.last_good. */
	void (*sample)(void *ctx, const struct device *d);
	/** The device has sent a frame. */
	void (*frame)(void *ctx, const char *bus, const struct can_msg *msg, uint64_t now_us);
};

/** Whether the file begins as a recording does. */
bool recording_is(const char *path);
/** `changes`: objects that are to be other than recorded; if there are any, the state is not used. False: the recording
 * is damaged, or the replay differs from it; a message said so. */
bool recording_replay(const char *path, const struct config *changes, const struct recording_events *events);

#endif
