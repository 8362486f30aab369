#include "gateway/storing.h"

#include <errno.h>
#include <string.h>

#include "od_index.h"

static const enum od_group groups[STORE_GROUPS] = {OD_GROUP_COMMUNICATION, OD_GROUP_APPLICATION, OD_GROUP_MANUFACTURER};

/* ---- saving ------------------------------------------------------------------------------------------------------ */

static enum od_status storage_result(struct storing *s, int rc)
{
	s->in_progress = rc == -EINPROGRESS;
	if (rc >= 0) /* the file has the new values, durable or not */
		s->stored = s->saving;
	return rc == 0 ? OD_OK : rc == -EINPROGRESS ? OD_PENDING : OD_CANNOT_STORE;
}

static enum od_status save(struct storing *s)
{
	uint8_t bytes[STORE_FILE_MAX];

	if (!s->port.save)
		return OD_CANNOT_STORE;
	s->saving.revision = ((const struct od_values *)s->od->values)->identity.revision_number;
	return storage_result(
		s, record_answer(s->record, s->port.save(s->port.ctx, bytes, store_encode(&s->saving, bytes))));
}

enum od_status storing_store(struct storing *s, enum od_group group)
{
	if (s->in_progress)
		return OD_DEVICE_STATE;
	s->saving = s->stored;
	for (int i = 0; i < STORE_GROUPS; i++) {
		if (group != OD_GROUP_ALL && group != groups[i])
			continue;
		struct store_group *g = store_group(&s->saving, groups[i]);
		long size = od_encode(s->od, groups[i], &s->base, g->dcf, sizeof(g->dcf));
		if (size < 0)
			return OD_CANNOT_STORE;
		g->size = (size_t)size;
	}
	return save(s);
}

enum od_status storing_restore(struct storing *s, enum od_group group)
{
	if (s->in_progress)
		return OD_DEVICE_STATE;
	s->saving = s->stored;
	for (int i = 0; i < STORE_GROUPS; i++)
		if (group == OD_GROUP_ALL || group == groups[i])
			store_group(&s->saving, groups[i])->size = 0;
	return save(s);
}

enum od_status storing_store_lss(struct storing *s, uint8_t node_id, uint32_t bit_s)
{
	if (s->in_progress)
		return OD_DEVICE_STATE;
	s->saving = s->stored;
	s->saving.lss.node_id = node_id;
	if (bit_s)
		s->saving.lss.bit_s = bit_s;
	enum od_status status = save(s);
	s->lss = status == OD_PENDING;
	return status;
}

enum od_status storing_store_lock(struct storing *s, uint32_t key)
{
	if (s->in_progress)
		return OD_DEVICE_STATE;
	s->saving = s->stored;
	s->saving.lock_key = key;
	return save(s);
}

void storing_saved(struct storing *s, int result, uint64_t now_us)
{
	enum od_status status = storage_result(s, result);

	if (result < 0)
		event_log_warning(s->log, now_us, "values could not be stored: %s", strerror(-result));
	else if (result > 0)
		event_log_warning(s->log, now_us,
			"values stored, but a power cut may bring back the old ones: %s; store again",
			strerror(result));
	else
		event_log_add(s->log, now_us, "values of 1010h, 1011h or LSS stored");
	if (s->lss)
		canopen_lss_stored(s->canopen, status, now_us);
	else
		canopen_store_done(s->canopen, status, now_us);
	s->lss = false;
}

/* ---- values of an earlier meaning -------------------------------------------------------------------------------- */

/* Objects whose meaning changed with a revision (1018h:3). A value that an earlier revision stored is not applied. */
static const struct {
	uint16_t index;
	uint8_t sub;
	uint32_t since; /* files that were stored before 0.3.0 have revision 0 */
	const char *what;
} CHANGED[] = {
	{OD_INDEX_FUSION, OD_SUB_FUSION_GYRO_SCALE_SIGMA, 0x00010000, "was a delay, which is 2031h now"},
};

/* What the stored value meant then, or NULL: the same as now. */
static const char *other_meaning(const struct storing *s, const struct od_dcf_item *item)
{
	for (size_t i = 0; i < sizeof(CHANGED) / sizeof(CHANGED[0]); i++)
		if (item->index == CHANGED[i].index && item->sub == CHANGED[i].sub &&
			s->stored.revision < CHANGED[i].since)
			return CHANGED[i].what;
	return NULL;
}

/* Removes them from the image, too: the next save writes the present revision. */
static void leave_out_changed(struct storing *s, struct store_group *g)
{
	struct store_group kept = {.size = 0};
	struct od_dcf_item item;
	size_t from = 0;

	if (!od_dcf_valid(g->dcf, g->size))
		return;
	while (od_dcf_next(g->dcf, g->size, &from, &item)) {
		const char *what = other_meaning(s, &item);

		if (!what)
			od_dcf_add(kept.dcf, sizeof(kept.dcf), &kept.size, &item);
		else
			event_log_warning(s->log, 0,
				"stored %s (%04Xh:%u) not applied: it %s; set both, then store again (1010h)",
				od_find(s->od->table, item.index, item.sub, NULL)->name, item.index, item.sub, what);
	}
	*g = kept;
}

/* ---- applying ---------------------------------------------------------------------------------------------------- */

void storing_apply(struct storing *s, enum od_group group, uint64_t now_us)
{
	size_t skipped = 0;

	for (int i = 0; i < STORE_GROUPS; i++) {
		if (group != OD_GROUP_ALL && group != groups[i])
			continue;
		struct store_group *g = store_group(&s->stored, groups[i]);
		size_t refused = 0;
		if (g->size > 0)
			od_decode(s->od, g->dcf, g->size, &refused);
		skipped += refused;
	}
	if (skipped > 0)
		event_log_warning(s->log, now_us,
			"%zu stored values not applied: unknown or out of range in this version; store again (1010h)",
			skipped);
}

void storing_reset(struct storing *s, enum od_group group, uint64_t now_us)
{
	od_reset(s->od, group, &s->base);
	storing_apply(s, group, now_us);
}

bool storing_follow_node_id(struct storing *s, uint8_t node_id)
{
	if (node_id == s->node_id)
		return false;
	od_follow_node_id(s->od->table, &s->base, s->node_id, node_id);
	s->node_id = node_id;
	return true;
}

void storing_init(struct storing *s, struct od *od, struct canopen_node *canopen, struct event_log *log,
	const struct storing_port *port, const struct store_image *stored, uint8_t node_id)
{
	s->od = od;
	s->canopen = canopen;
	s->log = log;
	s->port = port ? *port : (struct storing_port){0};
	s->base = *(const struct od_values *)od->values;
	s->stored = stored ? *stored : (struct store_image){0};
	s->in_progress = s->lss = false;
	s->node_id = node_id;
	for (int i = 0; i < STORE_GROUPS; i++)
		leave_out_changed(s, &s->stored.groups[i]);
}
