#include "gateway/latency.h"

#include <assert.h>

#include "od_index.h"

static const struct {
	uint16_t index;
	uint8_t count, minimum, maximum, bins; /* sub-indices */
} OBJECTS[LATENCY_KINDS] = {
#define OBJECT(NAME)                                                                                      \
	{                                                                                                 \
		OD_INDEX_##NAME, OD_SUB_##NAME##_COUNT, OD_SUB_##NAME##_MINIMUM, OD_SUB_##NAME##_MAXIMUM, \
			OD_SUB_##NAME##_BINS                                                              \
	}
	[LATENCY_SAMPLE_AGE] = OBJECT(SAMPLE_AGE),
	[LATENCY_SYNC] = OBJECT(SYNC_TO_TPDO),
	[LATENCY_LOOP] = OBJECT(LOOP_TURN),
	[LATENCY_READ] = OBJECT(STAGE_READ),
	[LATENCY_FILTER] = OBJECT(STAGE_FILTER),
	[LATENCY_PUBLISH] = OBJECT(STAGE_PUBLISH),
};

/* ---- objects ----------------------------------------------------------------------------------------------------- */

static void publish(const struct latency_object *o)
{
	*o->count = o->histogram.count;
	*o->minimum = o->histogram.minimum;
	*o->maximum = o->histogram.maximum;
}

/* All of one moment: the copy is made when the transfer begins. */
static size_t read_bins(void *ctx, uint8_t *out)
{
	const struct latency_object *o = ctx;

	histogram_encode(&o->histogram, out);
	return HISTOGRAM_WIRE;
}

/* Only 0 can be written, to the count. */
static void on_written(void *ctx, const struct od_entry *entry)
{
	struct latency *l = ctx;

	for (int kind = 0; kind < LATENCY_KINDS; kind++) {
		struct latency_object *o = &l->objects[kind];

		if (OBJECTS[kind].index != entry->index)
			continue;
		o->histogram = (struct histogram){0};
		publish(o);
	}
}

void latency_attach(struct latency *l, struct od *od)
{
	for (int kind = 0; kind < LATENCY_KINDS; kind++) {
		struct latency_object *o = &l->objects[kind];
		uint16_t index = OBJECTS[kind].index;

		o->count = od_value(od, index, OBJECTS[kind].count, sizeof(uint32_t));
		o->minimum = od_value(od, index, OBJECTS[kind].minimum, sizeof(uint32_t));
		o->maximum = od_value(od, index, OBJECTS[kind].maximum, sizeof(uint32_t));
		assert(o->count && o->minimum && o->maximum);
		o->domain = (struct od_domain){.index = index, .sub = OBJECTS[kind].bins, .read = read_bins, .ctx = o};
		od_set_domain(od, &o->domain);
	}
	l->hooks[0] = (struct od_hook){
		.first = OD_INDEX_SAMPLE_AGE, .last = OD_INDEX_LOOP_TURN, .after = on_written, .ctx = l};
	l->hooks[1] = (struct od_hook){
		.first = OD_INDEX_STAGE_READ, .last = OD_INDEX_STAGE_PUBLISH, .after = on_written, .ctx = l};
	od_attach(od, &l->hooks[0]);
	od_attach(od, &l->hooks[1]);
}

/* ---- measuring --------------------------------------------------------------------------------------------------- */

static uint64_t now_ns(const struct latency *l)
{
	return l->clock_ns(l->clock_ctx);
}

/* Never below 0: time stamps of frames and samples can be slightly ahead. */
static void add(struct latency *l, enum latency_kind kind, uint64_t from, uint64_t to)
{
	struct latency_object *o = &l->objects[kind];

	histogram_add(&o->histogram, to > from ? to - from : 0);
	publish(o);
}

void latency_mark(struct latency *l, uint64_t t_ns)
{
	l->mark_ns = t_ns;
}

void latency_stage(struct latency *l, enum latency_kind kind)
{
	uint64_t begun_ns = l->mark_ns;

	if (!l->clock_ns)
		return;
	l->mark_ns = now_ns(l);
	add(l, kind, begun_ns, l->mark_ns);
}

void latency_loop(struct latency *l, uint64_t begun_us)
{
	if (l->clock_ns && begun_us)
		add(l, LATENCY_LOOP, begun_us, now_ns(l) / 1000);
}

void latency_sent(struct latency *l, const struct canopen_node *node, uint64_t taken_us)
{
	bool answered = node->pdos.answered != l->syncs;

	if (node->pdos.sent == l->tpdos || !l->clock_ns)
		return;
	l->tpdos = node->pdos.sent;
	l->syncs = node->pdos.answered;
	uint64_t now_us = now_ns(l) / 1000;
	if (taken_us)
		add(l, LATENCY_SAMPLE_AGE, taken_us, now_us);
	if (answered)
		add(l, LATENCY_SYNC, node->sync.last_us, now_us);
}
