#include "gateway/led.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <unistd.h>

#include "gateway/canopen/deadline.h"

/* ---- states ------------------------------------------------------------------------------------------------------ */

/* The green LED. */
static enum led_state led_run(const struct canopen_node *node)
{
	if (canopen_lss_active(node))
		return LED_FLICKERING;
	switch (canopen_nmt_state(node)) {
	case NMT_OPERATIONAL:
		return LED_ON;
	case NMT_PRE_OPERATIONAL:
		return LED_BLINKING;
	case NMT_STOPPED:
		return LED_SINGLE_FLASH;
	case NMT_INITIALISING:
		break;
	}
	return LED_OFF;
}

/* The red LED. Of several errors it shows the one of highest priority, the last in the table of CiA 303-3. */
static enum led_state led_error(const struct canopen_node *node, enum can_state bus)
{
	if (bus == CAN_STATE_BUS_OFF)
		return LED_ON;
	if (canopen_error_active(node, EMCY_PDO_TIMEOUT))
		return LED_QUADRUPLE_FLASH;
	if (canopen_error_active(node, EMCY_SYNC_TIME) || canopen_error_active(node, EMCY_SYNC_LENGTH))
		return LED_TRIPLE_FLASH;
	if (canopen_error_active(node, EMCY_HEARTBEAT))
		return LED_DOUBLE_FLASH;
	if (bus == CAN_STATE_WARNING || bus == CAN_STATE_PASSIVE)
		return LED_SINGLE_FLASH;
	if (canopen_error_active(node, EMCY_DATA_SET) || canopen_error_active(node, EMCY_CONFIGURATION) ||
		canopen_error_active(node, EMCY_STORE_DAMAGED))
		return LED_BLINKING;
	return canopen_lss_active(node) ? LED_FLICKERING : LED_OFF;
}

/* ---- flash patterns ---------------------------------------------------------------------------------------------- */

enum { FLICKER_US = 50000, FLASH_US = 200000, PAUSE_US = 1000000 };

static unsigned flashes(enum led_state state)
{
	return (unsigned)(state - LED_SINGLE_FLASH) + 1;
}

bool led_lit(enum led_state state, bool second, uint64_t t_us, uint64_t *change_us)
{
	uint64_t half_us = state == LED_FLICKERING ? FLICKER_US : FLASH_US;
	uint64_t halves = t_us / half_us;

	*change_us = (halves + 1) * half_us;
	switch (state) {
	case LED_OFF:
	case LED_ON:
		*change_us = UINT64_MAX;
		return state == LED_ON;
	case LED_FLICKERING:
		return halves % 2 == second;
	case LED_BLINKING:
		return halves % 2 == 0;
	case LED_SINGLE_FLASH:
	case LED_DOUBLE_FLASH:
	case LED_TRIPLE_FLASH:
	case LED_QUADRUPLE_FLASH:
		break;
	}
	/* flashes and pauses of equal length, then the long pause */
	uint64_t within = halves % (2 * flashes(state) - 1 + PAUSE_US / FLASH_US);
	return within < 2 * flashes(state) && within % 2 == 0;
}

/* ---- Linux LEDs -------------------------------------------------------------------------------------------------- */

void leds_init(struct leds *leds, struct od_values *values, const struct canopen_node *node, const struct can_port *bus)
{
	*leds = (struct leds){.values = values,
		.node = node,
		.bus = bus,
		.run = {.brightness = -1},
		.error = {.brightness = -1, .second = true}};
}

static int open_file(const char *folder, const char *name, const char *file)
{
	char path[512];

	snprintf(path, sizeof(path), "%.200s/%.200s/%s", folder, name, file);
	int fd = open(path, O_WRONLY | O_NONBLOCK | O_CLOEXEC);
	return fd < 0 ? -errno : fd;
}

static void put(int fd, const char *text, size_t size)
{
	if (pwrite(fd, text, size, 0) < 0)
		return; /* the LED was removed: no fault of the device */
}

static int open_led(struct led *led, const char *folder, const char *name)
{
	if (name[0] == '\0')
		return 0;
	int trigger = open_file(folder, name, "trigger");
	if (trigger >= 0) { /* not every LED has one */
		put(trigger, "none", 4);
		close(trigger);
	}
	led->brightness = open_file(folder, name, "brightness");
	if (led->brightness < 0)
		return led->brightness;
	put(led->brightness, "0", 1);
	return 0;
}

int leds_open(struct leds *leds, const char *folder, const char *run, const char *error, const char **which)
{
	int run_rc = open_led(&leds->run, folder, run), error_rc = open_led(&leds->error, folder, error);

	*which = run_rc < 0 ? run : error;
	return run_rc < 0 ? run_rc : error_rc;
}

static void close_led(struct led *led)
{
	if (led->brightness < 0)
		return;
	put(led->brightness, "0", 1);
	close(led->brightness);
	led->brightness = -1;
}

void leds_close(struct leds *leds)
{
	close_led(&leds->run);
	close_led(&leds->error);
}

static uint64_t show(struct led *led, enum led_state state, uint64_t now_us)
{
	uint64_t change_us;
	bool lit = led_lit(state, led->second, now_us, &change_us);

	led->state = state;
	if (led->brightness < 0)
		return UINT64_MAX;
	if (lit != led->lit)
		put(led->brightness, lit ? "255" : "0", lit ? 3 : 1);
	led->lit = lit;
	return change_us;
}

uint64_t leds_tick(struct leds *leds, uint64_t now_us)
{
	uint64_t run = show(&leds->run, led_run(leds->node), now_us);
	uint64_t error = show(&leds->error, led_error(leds->node, leds->bus->state), now_us);

	leds->values->status_leds.run = (uint8_t)leds->run.state;
	leds->values->status_leds.error = (uint8_t)leds->error.state;
	return earlier(run, error);
}
