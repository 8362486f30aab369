#include "gateway/utc.h"

#define US_PER_DAY ((int64_t)86400000000)

enum {
	DAYS_TO_1984 = 5113,	    /* from 1970-01-01 */
	HOLD_US = 300000000,	    /* TIME is used for so long: an error of 15 ms at 50 ppm */
	STEP_US = 10000,	    /* a larger deviation means that the clock of TIME was set */
	SMOOTHING = 8,		    /* low-pass constant, in messages: TIME has a resolution of 1 ms and jitter */
	LAG_LEAK = 20000,	    /* 50 ppm: drift between the two clocks */
	LAG_STEP_US = 1000000,	    /* a larger lag means that a replay has started again */
	SAME_CLOCK_LAG_US = 100000, /* up to this lag the time stamps are CLOCK_MONOTONIC itself */
};

void utc_init(struct utc *utc, struct od_values *values, struct canopen_node *node)
{
	*utc = (struct utc){.values = values, .node = node};
}

void utc_time(struct utc *utc, uint16_t day, uint32_t ms, uint64_t t_us)
{
	int64_t offset_us = (day + DAYS_TO_1984) * US_PER_DAY + ms * (int64_t)1000 - (int64_t)t_us;
	int64_t off_us = offset_us - utc->time_offset_us;

	if (off_us > STEP_US || off_us < -STEP_US) /* or it is the first: years since 1970 */
		utc->time_offset_us = offset_us;
	else
		utc->time_offset_us += off_us / SMOOTHING;
	utc->heard_us = t_us;
}

void utc_host_clock(struct utc *utc, bool synchronised, int64_t offset_us)
{
	utc->host_synchronised = synchronised;
	utc->host_offset_us = offset_us;
}

/* TIME has precedence: all nodes on the bus shall have the same time. */
static enum utc_source source_of(const struct utc *utc, uint64_t now_us)
{
	if (utc->heard_us > 0 && now_us <= utc->heard_us + HOLD_US)
		return UTC_TIME;
	return utc->host_synchronised ? UTC_HOST : UTC_NONE;
}

/* When the sample was measured, in CLOCK_MONOTONIC. */
static int64_t taken_us(struct utc *utc, uint64_t t_us, uint64_t now_us)
{
	int64_t lag_us = (int64_t)(now_us - t_us);

	utc->lag_us += (int64_t)(t_us - utc->sample_us) / LAG_LEAK;
	if (lag_us < utc->lag_us || lag_us > utc->lag_us + LAG_STEP_US)
		utc->lag_us = lag_us;
	utc->sample_us = t_us;
	if (utc->lag_us >= 0 && utc->lag_us <= SAME_CLOCK_LAG_US)
		return (int64_t)t_us;
	return (int64_t)t_us + utc->lag_us;
}

static uint16_t day_of(int64_t utc_us)
{
	return (uint16_t)(utc_us / US_PER_DAY - DAYS_TO_1984);
}

static uint32_t ms_of(int64_t utc_us)
{
	return (uint32_t)(utc_us % US_PER_DAY / 1000);
}

enum utc_source utc_sample(struct utc *utc, uint64_t t_us, uint64_t now_us)
{
	enum utc_source source = source_of(utc, now_us);
	int64_t offset_us = source == UTC_TIME ? utc->time_offset_us : utc->host_offset_us;

	utc->taken_us = taken_us(utc, t_us, now_us);
	int64_t utc_us = utc->taken_us + offset_us;
	bool known = source != UTC_NONE && utc_us >= DAYS_TO_1984 * US_PER_DAY;

	utc->values->utc.day = known ? day_of(utc_us) : 0;
	utc->values->utc.ms = known ? ms_of(utc_us) : 0;
	utc->values->utc.time = known ? (uint64_t)utc_us : 0;
	utc->values->utc.source = (uint8_t)(known ? source : UTC_NONE);
	return known ? source : UTC_NONE;
}

/* Only from the host's own clock: a time that was received as TIME is not sent back. */
uint64_t utc_tick(struct utc *utc, uint64_t now_us)
{
	uint64_t period_us = utc->values->utc.producer_period * (uint64_t)1000000;
	int64_t utc_us = (int64_t)now_us + utc->host_offset_us;

	if (!utc->host_synchronised || utc_us < DAYS_TO_1984 * US_PER_DAY) {
		utc->produces = false;
		return UINT64_MAX;
	}
	if (utc->produces && now_us < utc->produce_us)
		return utc->produce_us;
	utc->produces = canopen_send_time(utc->node, day_of(utc_us), ms_of(utc_us), now_us);
	utc->produce_us = now_us + period_us;
	return utc->produces ? utc->produce_us : UINT64_MAX;
}
