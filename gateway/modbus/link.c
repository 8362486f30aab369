#include "gateway/modbus/link.h"

#include <errno.h>
#include <poll.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

enum { BUFFER = 3, FRESH = 4 }; /* of `shared` */
enum { IDLE, POSTED, TAKEN, DONE };
enum { NOTHING_LATE = -1 };

static void reset(struct modbus_link *link)
{
	link->writing = 0;
	link->reading = 1;
	atomic_init(&link->shared, 2);
	atomic_init(&link->state, IDLE);
	atomic_init(&link->late, NOTHING_LATE);
	atomic_init(&link->closing, false);
	link->pending = false;
	link->serve = NULL;
	link->request_fd = link->done_fd = -1;
}

int modbus_link_open(struct modbus_link *link)
{
	reset(link);
	link->request_fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
	link->done_fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
	if (link->request_fd >= 0 && link->done_fd >= 0)
		return 0;
	int rc = -errno;
	modbus_link_close(link);
	return rc;
}

void modbus_link_direct(struct modbus_link *link, void (*serve)(void *ctx), void *ctx)
{
	reset(link);
	link->serve = serve;
	link->ctx = ctx;
}

void modbus_link_close(struct modbus_link *link)
{
	if (link->request_fd >= 0)
		close(link->request_fd);
	if (link->done_fd >= 0)
		close(link->done_fd);
	link->request_fd = link->done_fd = -1;
}

void modbus_link_closing(struct modbus_link *link)
{
	atomic_store(&link->closing, true);
	eventfd_write(link->done_fd, 1);
}

/* ---- values ------------------------------------------------------------------------------------------------------ */

void modbus_link_publish(struct modbus_link *link, const struct od_values *values)
{
	link->values[link->writing] = *values;
	link->writing = atomic_exchange(&link->shared, link->writing | FRESH) & BUFFER;
}

const struct od_values *modbus_link_values(struct modbus_link *link)
{
	if (atomic_load(&link->shared) & FRESH)
		link->reading = atomic_exchange(&link->shared, link->reading) & BUFFER;
	return &link->values[link->reading];
}

/* ---- jobs -------------------------------------------------------------------------------------------------------- */

/* False: the loop has not answered in time. */
static bool wait_done(struct modbus_link *link)
{
	struct pollfd done = {.fd = link->done_fd, .events = POLLIN};
	eventfd_t count;

	while (atomic_load(&link->state) != DONE) {
		if (atomic_load(&link->closing) || poll(&done, 1, MODBUS_LINK_PATIENCE_MS) == 0)
			return false;
		eventfd_read(link->done_fd, &count);
	}
	return true;
}

enum od_status modbus_link_submit(struct modbus_link *link)
{
	int posted = POSTED;

	link->job.ticket++;
	atomic_store(&link->state, POSTED);
	if (link->serve)
		link->serve(link->ctx);
	else
		eventfd_write(link->request_fd, 1);
	/* One that the loop has begun is waited for. */
	while (!link->serve && !wait_done(link))
		if (atomic_compare_exchange_strong(&link->state, &posted, IDLE))
			return OD_DEVICE_STATE;
	atomic_store(&link->state, IDLE);
	return link->job.status;
}

bool modbus_link_late(struct modbus_link *link, uint8_t *ticket, enum od_status *status)
{
	int late = atomic_exchange(&link->late, NOTHING_LATE);

	*ticket = (uint8_t)((unsigned)late >> 8);
	*status = (enum od_status)(late & 0xFF);
	return late != NOTHING_LATE;
}

struct modbus_job *modbus_link_take(struct modbus_link *link)
{
	eventfd_t count;
	int posted = POSTED;

	if (link->request_fd >= 0)
		eventfd_read(link->request_fd, &count);
	return atomic_compare_exchange_strong(&link->state, &posted, TAKEN) ? &link->job : NULL;
}

void modbus_link_done(struct modbus_link *link)
{
	if (link->job.status == OD_PENDING) {
		link->pending = true;
		link->pending_ticket = link->job.ticket;
	}
	atomic_store(&link->state, DONE);
	if (link->done_fd >= 0)
		eventfd_write(link->done_fd, 1);
}

void modbus_link_ended(struct modbus_link *link, enum od_status status)
{
	if (!link->pending)
		return;
	link->pending = false;
	atomic_store(&link->late, link->pending_ticket << 8 | (int)status);
	if (link->done_fd >= 0)
		eventfd_write(link->done_fd, 1);
}
