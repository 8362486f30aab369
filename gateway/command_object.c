#include "gateway/command_object.h"

#include "gateway/status.h"

enum { COMMAND_SUB = 1, COMMAND_ABORT = 0 };

static void enter(struct command_object *c, enum command_state state)
{
	*c->state = (uint8_t)state;
	if (state == COMMAND_RUNNING)
		c->group->running = c;
	else if (c->group->running == c)
		c->group->running = NULL;
}

static void tell(const struct command_object *c, const char *event)
{
	if (c->group->on_event)
		c->group->on_event(c->group->ctx, c, event);
}

bool command_object_running(const struct command_object *c)
{
	return c->group->running == c;
}

/* ---- commands ---------------------------------------------------------------------------------------------------- */

static enum od_status start(struct command_object *c, uint8_t command)
{
	if (c->group->sensor_lost || c->group->running)
		return OD_DEVICE_STATE;
	enum od_status status = c->on_start(c->ctx, command);
	if (status != OD_OK)
		return status;
	enter(c, COMMAND_RUNNING);
	tell(c, "started");
	return OD_CONSUMED;
}

static enum od_status accept(struct command_object *c)
{
	if (*c->state != COMMAND_DONE)
		return OD_DEVICE_STATE;
	enum od_status status = c->on_accept(c->ctx);
	if (status != OD_OK)
		return status;
	enter(c, COMMAND_IDLE);
	tell(c, "accepted");
	return OD_CONSUMED;
}

static enum od_status discard(struct command_object *c)
{
	if (*c->state != COMMAND_DONE && *c->state != COMMAND_REFUSED)
		return OD_DEVICE_STATE;
	tell(c, "discarded");
	command_object_reset(c);
	return OD_CONSUMED;
}

static enum od_status abort_running(struct command_object *c)
{
	if (!command_object_running(c))
		return OD_CONSUMED;
	command_object_reset(c);
	*c->verdict = c->aborted;
	tell(c, "stopped");
	return OD_CONSUMED;
}

static enum od_status on_command(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	struct command_object *c = ctx;

	if (entry->sub != COMMAND_SUB || size != 1)
		return OD_OK;
	const uint8_t command = *(const uint8_t *)wire;
	if (command == COMMAND_ABORT)
		return abort_running(c);
	if (command <= c->starts)
		return start(c, command);
	if (command == c->accept)
		return accept(c);
	return command == c->discard ? discard(c) : OD_BAD_VALUE;
}

/* ---- the procedure ----------------------------------------------------------------------------------------------- */

void command_object_end(struct command_object *c, bool good, uint8_t verdict)
{
	*c->verdict = verdict;
	enter(c, good ? COMMAND_DONE : COMMAND_REFUSED);
	tell(c, good ? "done" : "refused");
}

void command_object_reset(struct command_object *c)
{
	c->on_clear(c->ctx);
	enter(c, COMMAND_IDLE);
}

void command_object_attach(struct command_object *c, struct od *od)
{
	c->hook = (struct od_hook){.first = c->index, .last = c->index, .before = on_command, .ctx = c};
	od_attach(od, &c->hook);
}

void command_group_sample(struct command_group *g)
{
	g->sensor_lost = false;
}

void command_group_sensor_lost(struct command_group *g)
{
	g->sensor_lost = true;
	if (g->running)
		command_object_end(g->running, false, g->running->sensor_lost);
}

unsigned command_group_status(const struct command_group *g)
{
	return g->running ? STATUS_COMMISSIONING : 0;
}
