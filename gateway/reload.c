#include "gateway/reload.h"

#include <errno.h>
#include <string.h>

#include "gateway/log.h"
#include "gateway/settings.h"
#include "od_index.h"

static bool is_stored(const struct storing *s, const struct od_entry *e)
{
	const struct store_group *g = &s->stored.groups[od_group_of(e->index) - OD_GROUP_COMMUNICATION];
	struct od_dcf_item item;
	size_t used = 0;

	if (!od_dcf_valid(g->dcf, g->size))
		return false;
	while (od_dcf_next(g->dcf, g->size, &used, &item))
		if (item.index == e->index && item.sub == e->sub)
			return true;
	return false;
}

/* Takes the value of one object over into the base. True: it is to be applied now. */
static bool take_over(struct device *d, const struct od_entry *e, const uint8_t *wire, size_t size)
{
	struct od base = {.table = d->od.table, .values = &d->storing.base};
	uint8_t old[OD_VALUE_MAX];

	if (od_get(&base, e, old, sizeof(old)) == size && memcmp(old, wire, size) == 0)
		return false;
	od_put(&base, e, wire, size);
	if (is_stored(&d->storing, e))
		log_warning("%s: not changed: the value that 1010h stored has precedence; 1011h clears it", e->name);
	else if (od_group_of(e->index) == OD_GROUP_COMMUNICATION)
		log_line("%s: from the next NMT reset communication on", e->name);
	else
		return true;
	return false;
}

static void tell_keys(const struct config *before, const struct config *after)
{
	const char *key;

	for (size_t i = 0; (key = config_changed(before, after, &i)) != NULL;)
		if (strcmp(key, "log_level") != 0)
			log_warning("%s: not changed: a restart is needed for it", key);
}

int reload(struct device *d, const struct config *before, const struct config *after, uint64_t now_us)
{
	uint8_t changes[OD_DOMAIN_MAX], wire[OD_VALUE_MAX];
	struct od_values values;
	struct od od;
	size_t used = 0;

	od_init(&od, d->od.table, &values, d->storing.node_id);
	config_apply(after, &od);
	if (!settings_valid(&values))
		return -EINVAL;
	d->now_us = now_us;
	tell_keys(before, after);
	for (size_t i = 0; i < od.table->count; i++) {
		const struct od_entry *e = &od.table->entries[i];
		size_t size = e->access & OD_STORED ? od_get(&od, e, wire, sizeof(wire)) : 0;
		struct od_dcf_item item = {e->index, e->sub, wire, size};

		if (size > 0 && take_over(d, e, wire, size))
			od_dcf_add(changes, sizeof(changes), &used, &item);
	}
	d->write_lock.suspended = true;
	if (used > 0)
		od_write(&d->od, OD_INDEX_CONFIGURATION_SNAPSHOT, 0, changes, used); /* the log has the result */
	d->write_lock.suspended = false;
	record_begin_again(d->record);
	return 0;
}
