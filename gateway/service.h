/* gateway/service.h
 * What the process tells the service manager that started it, by the protocol of sd_notify(3): one datagram to
 * $NOTIFY_SOCKET for each message. Ready after the first sample; afterwards a sign of life, at least every half of
 * $WATCHDOG_USEC, as long as the loop runs and neither the sensor's thread nor the thread that stores hangs. Without
 * these signs the manager ends the process and starts it again. Passive but for the socket; one thread. */
#ifndef GATEWAY_SERVICE_H
#define GATEWAY_SERVICE_H

#include <stdbool.h>
#include <stdint.h>

/* A thread that has not come round for so long hangs. The slowest it does when all is well: a sensor that is restarted
 * every second, an SD card that takes ten seconds for an fsync. */
enum { SERVICE_SENSOR_HANGS_US = 10000000, SERVICE_STORE_HANGS_US = 60000000 };

struct service {
	/* PRIVATE */
	int fd;		    /* -1: there is no service manager */
	uint64_t period_us; /* of the signs of life; 0: none are wanted */
	uint64_t next_us;
	bool ready, silent;
	struct service_thread {
		unsigned turns; /* when it last came round, at `since_us` */
		uint64_t since_us;
	} sensor, store;
};

/** `socket`: $NOTIFY_SOCKET, `watchdog`: $WATCHDOG_USEC, `pid`: $WATCHDOG_PID; NULL where they are not set. */
void service_open(struct service *s, const char *socket, const char *watchdog, const char *pid);
void service_close(struct service *s);

/** After the first sample; `status` is for `systemctl status`. Later calls do nothing. */
void service_ready(struct service *s, const char *status);
void service_stopping(struct service *s);

/** What the threads do: the sensor's has come round `turns` times (0: there is none), and the store's is writing. Gives
 * a sign of life when it is due. Returns the next deadline. `now_us`: CLOCK_MONOTONIC. */
uint64_t service_tick(struct service *s, unsigned turns, bool storing, uint64_t now_us);

/** The process was not scheduled for `us`, as its threads were not. */
void service_away(struct service *s, uint64_t us);

#endif
