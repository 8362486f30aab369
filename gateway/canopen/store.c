/* Store (1010h) and restore (1011h) parameters: CiA 301, 7.5.2.13 and 7.5.2.14; verify configuration (1020h): 7.5.2.23.
 */
#include "gateway/canopen/service.h"
#include "od_index.h"

#include <string.h>

static enum od_status before_write(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	struct canopen_node *node = ctx;
	const struct canopen_device *device = &node->device;
	bool restore = entry->index == OD_INDEX_RESTORE_DEFAULTS;
	enum od_status (*action)(void *, enum od_group) = restore ? device->restore : device->store;
	enum od_status status;

	if (memcmp(wire, restore ? "load" : "save", size) != 0 || !action)
		return OD_CANNOT_STORE;
	if (node->store.pending)
		return OD_DEVICE_STATE;
	status = action(device->ctx, (enum od_group)entry->sub);
	node->store.pending = status == OD_PENDING;
	return status == OD_OK ? OD_CONSUMED : status;
}

/* A changed configuration is no longer the one that the tool wrote at the date of 1020h. */
static void after_any_write(void *ctx, const struct od_entry *entry)
{
	struct store *store = &((struct canopen_node *)ctx)->store;

	if (!(entry->access & OD_STORED) || entry->index == OD_INDEX_VERIFY_CONFIGURATION)
		return;
	for (size_t i = 0; i < 2; i++)
		if (store->date[i])
			*store->date[i] = 0;
}

void store_init(struct canopen_node *node)
{
	for (uint8_t i = 0; i < 2; i++)
		node->store.date[i] =
			od_value(node->od, OD_INDEX_VERIFY_CONFIGURATION, (uint8_t)(i + 1), sizeof(uint32_t));
	node->store.date_hook =
		(struct od_hook){.first = 0x1000, .last = 0xFFFF, .after = after_any_write, .ctx = node};
	od_attach(node->od, &node->store.date_hook);
	node->store.hook = (struct od_hook){.first = OD_INDEX_STORE_PARAMETERS,
		.last = OD_INDEX_RESTORE_DEFAULTS,
		.before = before_write,
		.ctx = node};
	od_attach(node->od, &node->store.hook);
}

void canopen_store_done(struct canopen_node *node, enum od_status status, uint64_t now_us)
{
	node->now_us = now_us;
	node->store.pending = false;
	sdo_server_done(node, status);
	if (node->listener)
		node->listener->stored(node->listener->ctx, status);
}
