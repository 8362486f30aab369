/* gateway/led.h
 * The two status LEDs of CiA 303-3: their states (2123h), shown on LEDs of Linux (/sys/class/leds). One thread. */
#ifndef GATEWAY_LED_H
#define GATEWAY_LED_H

#include <stdbool.h>
#include <stdint.h>

#include "drivers/ports/can.h"
#include "gateway/canopen/canopen.h"
#include "od_values.h"

/** The values of 2123h. */
enum led_state {
	LED_OFF,
	LED_ON,
	LED_FLICKERING, /* 10 Hz, the two LEDs alternate */
	LED_BLINKING,	/* 2.5 Hz */
	LED_SINGLE_FLASH,
	LED_DOUBLE_FLASH,
	LED_TRIPLE_FLASH,
	LED_QUADRUPLE_FLASH,
};

/** Whether a LED in this state is lit at the time `t_us` (a time base common to both LEDs), and when this changes next
 * (UINT64_MAX: never). `second`: flickers in antiphase to the first. */
bool led_lit(enum led_state state, bool second, uint64_t t_us, uint64_t *change_us);

struct led {
	int brightness; /* descriptor of the file; -1: no LED */
	bool second, lit;
	enum led_state state;
};

struct leds {
	struct od_values *values;
	const struct canopen_node *node;
	const struct can_port *bus;
	struct led run, error;
};

void leds_init(
	struct leds *leds, struct od_values *values, const struct canopen_node *node, const struct can_port *bus);
/** Uses the LEDs of these names in `folder` (/sys/class/leds; "": none) and sets their triggers to none. 0, or -errno
 * and the first name that failed in *which; the other LED is used anyway. */
int leds_open(struct leds *leds, const char *folder, const char *run, const char *error, const char **which);
void leds_close(struct leds *leds);
/** Publishes 2123h and switches the LEDs, with one write() to sysfs for each change. Returns the next deadline;
 * UINT64_MAX when no LED is open. */
uint64_t leds_tick(struct leds *leds, uint64_t now_us);

#endif
