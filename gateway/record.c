#include "gateway/record.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/device.h"
#include "gateway/device_state.h"
#include "od_index.h"

/* Entries that one input can add: its own, the ports before it, answers. */
enum { ENTRIES_OF_ONE = 16 };

/* ---- the ring ---------------------------------------------------------------------------------------------------- */

static size_t room(const struct record *r)
{
	return RECORD_RING - (atomic_load_explicit(&r->head, memory_order_relaxed) -
				     atomic_load_explicit(&r->tail, memory_order_acquire));
}

/* Whoever calls it has made sure that there is room. */
static void put(struct record *r, const struct record_entry *e)
{
	size_t head = atomic_load_explicit(&r->head, memory_order_relaxed);

	r->ring[head % RECORD_RING] = *e;
	atomic_store_explicit(&r->head, head + 1, memory_order_release);
}

const struct record_entry *record_next(struct record *r)
{
	size_t tail = atomic_load_explicit(&r->tail, memory_order_relaxed);

	return tail == atomic_load_explicit(&r->head, memory_order_acquire) ? NULL : &r->ring[tail % RECORD_RING];
}

void record_taken(struct record *r)
{
	atomic_fetch_add_explicit(&r->tail, 1, memory_order_release);
}

/* ---- the ports --------------------------------------------------------------------------------------------------- */

/* Frames and samples that the device counts itself are left out, so that the rest changes only with an event. */
static struct record_bus bus_now(const struct can_port *bus)
{
	struct record_bus now;

	memset(&now, 0, sizeof(now)); /* padding, too: compared as bytes */
	now.counters = bus->counters;
	now.frames = bus->traffic.frames;
	now.bytes = bus->traffic.bytes;
	now.queued = (uint32_t)bus->queue_count;
	now.bit_s = bus->bit_s;
	now.state = (uint8_t)bus->state;
	now.tx_errors = bus->tx_errors;
	now.rx_errors = bus->rx_errors;
	return now;
}

static bool bus_changed(struct record *r, const struct record_bus *now, bool frame)
{
	struct record_bus rest = *now;

	rest.counters.tx = 0;
	rest.counters.rx -= r->received + frame;
	rest.frames = rest.bytes = 0; /* read after can_refresh() only */
	if (memcmp(&rest, &r->bus, sizeof(rest)) == 0)
		return false;
	r->bus = rest;
	return true;
}

static struct record_imu imu_now(const struct imu_port *imu)
{
	struct record_imu now;

	memset(&now, 0, sizeof(now));
	now.health = imu->health;
	now.counters = imu->counters;
	now.rate_hz = imu->rate_hz;
	now.silence_us = imu->silence_us;
	return now;
}

static bool imu_changed(struct record *r, const struct record_imu *now, bool sample)
{
	struct record_imu rest = *now;

	rest.counters.samples -= r->samples + sample;
	if (memcmp(&rest, &r->imu, sizeof(rest)) == 0)
		return false;
	r->imu = rest;
	return true;
}

/* The driver has counted the sample or frame that comes now. */
static void put_ports(struct record *r, enum record_kind kind)
{
	struct record_entry bus = {.kind = RECORD_BUS, .bus = bus_now(r->device->bus)};
	struct record_entry imu = {.kind = RECORD_IMU, .imu = imu_now(r->device->imu)};

	if (bus_changed(r, &bus.bus, kind == RECORD_FRAME))
		put(r, &bus);
	if (imu_changed(r, &imu.imu, kind == RECORD_SAMPLE))
		put(r, &imu);
}

/* ---- files ------------------------------------------------------------------------------------------------------- */

/* The next file begins with the state of now. */
static void cut(struct record *r)
{
	device_state_save(r->device, r->state);
	atomic_store(&r->state_in_use, true);
	if (r->lost_now)
		put(r, &(struct record_entry){.kind = RECORD_LOST, .value = (int32_t)r->lost_now});
	r->lost_now = 0;
	put(r, &(struct record_entry){.kind = RECORD_CUT, .now_us = r->device->now_us});
	put(r, &(struct record_entry){.kind = RECORD_SELF, .self = r->self});
	memset(&r->bus, 0xFF, sizeof(r->bus)); /* both are put, too */
	memset(&r->imu, 0xFF, sizeof(r->imu));
	r->on = true;
	r->cut = false;
}

/* Between two inputs. */
static void begin_and_end(struct record *r)
{
	if (atomic_load_explicit(&r->error, memory_order_relaxed))
		r->on = r->wanted = false;
	if (r->on && !r->wanted && room(r) > ENTRIES_OF_ONE) {
		put(r, &(struct record_entry){.kind = RECORD_STOP});
		r->on = false;
	}
	if (!r->wanted)
		return;
	if (r->on && !r->cut && !r->lost_now && !atomic_load_explicit(&r->full, memory_order_relaxed))
		return;
	if (!atomic_load_explicit(&r->state_in_use, memory_order_acquire) && room(r) > RECORD_RING / 2)
		cut(r);
}

static void lose(struct record *r)
{
	r->lost_now++;
	r->lost++;
}

/* True: there is room for the next input. */
static bool ready(struct record *r)
{
	if (!r || r->replayed)
		return false;
	begin_and_end(r);
	if (!r->on)
		return false;
	if (r->lost_now == 0 && room(r) > ENTRIES_OF_ONE)
		return true;
	lose(r);
	return false;
}

void record_input(struct record *r, const struct record_entry *e)
{
	if (ready(r)) {
		put_ports(r, e->kind);
		put(r, e);
	}
	if (r) {
		r->samples += e->kind == RECORD_SAMPLE;
		r->received += e->kind == RECORD_FRAME;
	}
}

void record_sample(struct record *r, int read, const struct imu_sample *sample, uint64_t now_us)
{
	struct record_entry e = {.kind = RECORD_FAILED, .now_us = now_us, .value = read};

	if (read >= 0) {
		e.kind = RECORD_SAMPLE;
		e.sample = *sample;
	}
	record_input(r, &e);
}

/* During an input; ready() has kept room for it. */
static void put_now(struct record *r, const struct record_entry *e)
{
	if (!r || !r->on || r->lost_now)
		return;
	if (room(r) > 0)
		put(r, e);
	else
		lose(r);
}

int record_answer(struct record *r, int rc)
{
	put_now(r, &(struct record_entry){.kind = RECORD_ANSWER, .value = rc});
	return rc;
}

void record_configured(struct record *r, int rc, const struct imu_port *imu)
{
	(void)record_answer(r, rc);
	put_now(r, &(struct record_entry){.kind = RECORD_IMU, .imu = imu_now(imu)});
}

void record_refreshed(struct record *r, const struct can_port *bus)
{
	struct record_bus now;

	if (!r || r->replayed)
		return;
	now = bus_now(bus);
	(void)bus_changed(r, &now, false);
	put_now(r, &(struct record_entry){.kind = RECORD_BUS, .bus = now});
}

void record_write(struct record *r, uint16_t index, uint8_t sub, const void *wire, size_t size, uint64_t now_us)
{
	struct record_entry e = {.kind = RECORD_WRITE, .now_us = now_us, .write = {index, sub, (uint8_t)size, {0}}};

	if (size > sizeof(e.write.wire)) { /* a DOMAIN: the next file has what it changed */
		record_begin_again(r);
		return;
	}
	memcpy(e.write.wire, wire, size);
	record_input(r, &e);
}

void record_others(struct record *r)
{
	put_now(r, &(struct record_entry){.kind = RECORD_OTHERS});
}

void record_emcy(struct record *r, uint64_t now_us)
{
	put_now(r, &(struct record_entry){.kind = RECORD_KEEP, .now_us = now_us});
}

void record_begin_again(struct record *r)
{
	if (r)
		r->cut = true;
}

/* ---- 215Ch ------------------------------------------------------------------------------------------------------- */

enum { COMMAND_STOP = 0, COMMAND_START = 1, COMMAND_KEEP = 2 };

static enum od_status on_command(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	struct device *d = ctx;
	struct record *r = d->record;
	uint8_t command = *(const uint8_t *)wire;

	if (entry->sub != OD_SUB_RECORDING_COMMAND || size != 1)
		return OD_OK;
	if (!r || (command == COMMAND_KEEP && r->self.state != RECORD_ON))
		return OD_DEVICE_STATE;
	if (command == COMMAND_KEEP)
		record_emcy(r, d->now_us);
	else
		r->wanted = command == COMMAND_START;
	if (command == COMMAND_START)
		atomic_store(&r->error, 0);
	return OD_CONSUMED;
}

static void publish(struct record *r, uint8_t state_before)
{
	struct device *d = r->device;

	d->values.recording.state = r->self.state;
	d->values.recording.lost = r->self.lost;
	d->values.recording.kept = r->self.kept;
	if (r->self.state == RECORD_ENDED && state_before != RECORD_ENDED)
		event_log_warning(&d->log, d->now_us,
			"recording ended: %s; correct that, then write 1 to 215Ch:1 to start it again",
			strerror(r->self.error));
}

void record_tick(struct record *r, uint64_t now_us)
{
	if (!r)
		return;
	uint8_t before = r->device->values.recording.state;
	if (!r->replayed) {
		bool put_it = ready(r);
		struct record_self self = {.lost = r->lost,
			.kept = (uint16_t)atomic_load_explicit(&r->kept, memory_order_relaxed),
			.error = atomic_load_explicit(&r->error, memory_order_relaxed)};

		self.state = r->on ? RECORD_ON : self.error ? RECORD_ENDED : RECORD_OFF;
		if (put_it) {
			put_ports(r, RECORD_TICK);
			if (self.state != r->self.state || self.lost != r->self.lost || self.kept != r->self.kept)
				put(r, &(struct record_entry){.kind = RECORD_SELF, .self = self});
			put(r, &(struct record_entry){.kind = RECORD_TICK, .now_us = now_us});
		}
		r->self = self;
	}
	publish(r, before);
}

/* ---- life -------------------------------------------------------------------------------------------------------- */

int record_open(struct record *r)
{
	const size_t state_size = sizeof(struct device);

	*r = (struct record){.wanted = true};
	r->ring = malloc(RECORD_RING * sizeof(*r->ring));
	r->state = malloc(state_size);
	if (!r->ring || !r->state) {
		record_close(r);
		return -ENOMEM;
	}
	memset(r->ring, 0, RECORD_RING * sizeof(*r->ring)); /* no page is missing later */
	memset(r->state, 0, state_size);
	return 0;
}

void record_close(struct record *r)
{
	free(r->ring);
	free(r->state);
}

void record_attach_object(struct device *d)
{
	d->record_hook = (struct od_hook){
		.first = OD_INDEX_RECORDING, .last = OD_INDEX_RECORDING, .before = on_command, .ctx = d};
	od_attach(&d->od, &d->record_hook);
}

void record_attach(struct record *r, struct device *d)
{
	d->record = d->bus_health.record = d->sensor_watch.record = d->storing.record = r;
	if (r)
		r->device = d;
}
