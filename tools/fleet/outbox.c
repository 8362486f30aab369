#include "tools/fleet/outbox.h"

#include <string.h>

#include "gateway/canopen/deadline.h"

void outbox_init(struct outbox *o, const struct outbox_port *port, struct spool *spool, double rate_hz)
{
	*o = (struct outbox){.port = port, .spool = spool, .rate_hz = rate_hz};
}

static struct outbox_entry *entry(struct outbox *o, size_t i)
{
	return &o->window[(o->first + i) % OUTBOX_WINDOW];
}

static void pop_delivered(struct outbox *o)
{
	while (o->count > 0 && entry(o, 0)->acked) {
		if (entry(o, 0)->spooled)
			spool_acked(o->spool, entry(o, 0)->at);
		o->first = (o->first + 1) % OUTBOX_WINDOW;
		o->count--;
		o->delivered++;
	}
}

/* False: the broker takes none now. */
static bool send_entry(struct outbox *o, struct outbox_entry *e, bool late, uint64_t now_us)
{
	e->acknowledgement = o->port->send(o->port->ctx, e->bytes, e->size, late);
	if (e->acknowledgement < 0)
		return false;
	e->acked = e->acknowledgement == 0;
	e->sent_us = now_us;
	o->count++;
	o->sent++;
	pop_delivered(o);
	return true;
}

static bool append(struct outbox *o, const uint8_t *record, size_t size, struct spool_position *at)
{
	bool done = spool_append(o->spool, record, size, at) == 0;

	o->lost += !done;
	return done;
}

/* What is only in memory goes to the disk: it is older than all that will follow there. */
static void spill(struct outbox *o)
{
	for (size_t i = 0; i < o->count; i++) {
		struct outbox_entry *e = entry(o, i);

		if (!e->spooled && !e->acked)
			e->spooled = append(o, e->bytes, e->size, &e->at);
	}
	spool_skip(o->spool); /* of these, which are under way */
}

static bool only_in_memory(struct outbox *o)
{
	return spool_is_empty(o->spool) && o->count > 0;
}

void outbox_put(struct outbox *o, const uint8_t *record, size_t size, uint64_t now_us)
{
	struct spool_position at;

	if (o->connected && spool_is_empty(o->spool) && o->count < OUTBOX_WINDOW) {
		struct outbox_entry *e = entry(o, o->count);

		*e = (struct outbox_entry){.size = size};
		memcpy(e->bytes, record, size);
		if (send_entry(o, e, false, now_us))
			return;
	}
	if (only_in_memory(o))
		spill(o);
	append(o, record, size, &at);
}

void outbox_connected(struct outbox *o, uint64_t now_us)
{
	o->connected = true;
	o->next_us = now_us;
}

void outbox_disconnected(struct outbox *o)
{
	if (only_in_memory(o))
		spill(o);
	o->connected = false;
	o->count = 0;
	spool_rewind(o->spool);
}

void outbox_acked(struct outbox *o, long acknowledgement)
{
	for (size_t i = 0; i < o->count; i++)
		if (entry(o, i)->acknowledgement == acknowledgement && !entry(o, i)->acked) {
			entry(o, i)->acked = true;
			break;
		}
	pop_delivered(o);
}

static void send_spooled(struct outbox *o, uint64_t now_us)
{
	uint64_t period_us = (uint64_t)(1e6 / o->rate_hz);

	if (now_us > o->next_us + 100000) /* what was not used is not saved up */
		o->next_us = now_us - 100000;
	while (o->connected && o->count < OUTBOX_WINDOW && now_us >= o->next_us) {
		struct outbox_entry *e = entry(o, o->count);

		*e = (struct outbox_entry){.spooled = true};
		if (spool_next(o->spool, e->bytes, sizeof(e->bytes), &e->size, &e->at) <= 0)
			return;
		o->next_us += period_us;
		if (!send_entry(o, e, true, now_us)) {
			o->connected = false; /* the end of the connection is being reported */
			return;
		}
	}
}

uint64_t outbox_tick(struct outbox *o, uint64_t now_us)
{
	if (only_in_memory(o) && now_us - entry(o, 0)->sent_us > OUTBOX_SYNC_US)
		spill(o);
	if (!spool_is_empty(o->spool))
		send_spooled(o, now_us);
	if (now_us >= o->sync_us) {
		o->sync_us = now_us + OUTBOX_SYNC_US;
		spool_sync(o->spool); /* an error is counted there */
	}
	bool waits = o->connected && !spool_is_empty(o->spool) && o->count < OUTBOX_WINDOW;
	return waits ? earlier(o->sync_us, later(o->next_us, now_us + 1000)) : o->sync_us;
}
