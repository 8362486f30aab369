/* A node: found by what it sends, identified by SDO, and the queue of the jobs that wait for its SDO server. */
#include <stdlib.h>
#include <string.h>

#include "gateway/canopen/canopen.h"
#include "gateway/canopen/cia301.h"
#include "gateway/canopen/deadline.h"
#include "od/little_endian.h"
#include "od_index.h"
#include "od_values.h"
#include "tools/web/web.h"

enum {
	SDO_TIMEOUT_MS = 500,
	BOOT_US = 200000,      /* from a boot-up message to the first request */
	IDENTIFY_US = 5000000, /* to the next attempt, then twice as long */
	IDENTIFY_MAX_US = 60000000,
	LOST_PERIODS = 3,
	LOST_MIN_US = 1000000,
	FRESH_US = 2000000,
	PING_US = 5000000, /* of silence of a node without heartbeat */
	IDENTITY_STEPS = 6,
};

struct web_node *web_node(struct web *web, int64_t id)
{
	return id >= 1 && id < WEB_NODES ? &web->nodes[id] : NULL;
}

const char *web_state_text(int state)
{
	return watch_nmt_text(state);
}

/* ---- steps and jobs ---------------------------------------------------------------------------------------------- */

static struct web_step *add_step(struct web_job *job, uint16_t index, uint8_t sub)
{
	if (job->count == job->room) {
		size_t room = job->room ? 2 * job->room : 16;
		struct web_step *steps = realloc(job->steps, room * sizeof(*steps));

		if (!steps)
			return NULL;
		job->steps = steps;
		job->room = room;
	}
	struct web_step *step = &job->steps[job->count++];
	*step = (struct web_step){.index = index, .sub = sub};
	if (job->node->eds)
		step->entry = od_find(job->node->eds->table, index, sub, NULL);
	return step;
}

struct web_step *web_read(struct web_job *job, uint16_t index, uint8_t sub)
{
	return add_step(job, index, sub);
}

struct web_step *web_write(struct web_job *job, uint16_t index, uint8_t sub, const void *wire, size_t size)
{
	uint8_t copy[OD_VALUE_MAX]; /* `wire` may be in a step, which a new one moves */

	if (size > sizeof(copy))
		return NULL;
	memcpy(copy, wire, size);
	struct web_step *step = add_step(job, index, sub);
	if (step) {
		step->write = true;
		step->size = size;
		memcpy(step->wire, copy, size);
	}
	return step;
}

void web_clear_steps(struct web_job *job)
{
	for (size_t i = 0; i < job->count; i++)
		free(job->steps[i].large);
	job->count = job->at = 0;
}

const uint8_t *web_bytes(const struct web_step *step)
{
	return step->large ? step->large : step->wire;
}

uint32_t web_u32(const struct web_step *step, uint32_t otherwise)
{
	return step->result == SDO_DONE && step->size <= 4 ? (uint32_t)get_uint(step->wire, step->size) : otherwise;
}

static void free_job(struct web *web, struct web_job *job)
{
	struct web_client *client = job->client >= 0 ? &web->clients[job->client] : NULL;

	if (client && client->open && client->serial == job->serial) {
		if (job->poll >= 0)
			client->polls[job->poll].running = false;
		else
			client->jobs--;
		client->job_bytes -= job->bytes;
	}
	web_clear_steps(job);
	json_object_put(job->request);
	free(job->steps);
	free(job->buffer);
	if (job->release)
		job->release(job->data);
	else
		free(job->data);
	free(job);
}

static struct web_job *new_job(struct web_node *node, web_work *work, struct json_object *request)
{
	struct web_job *job = calloc(1, sizeof(*job));

	if (job) {
		*job = (struct web_job){.node = node, .work = work, .request = request, .client = -1, .poll = -1};
		job->timeout_ms = SDO_TIMEOUT_MS;
		node->job_count++;
	}
	return job;
}

struct web_job *web_enqueue(struct web_node *node, web_work *work, struct json_object *request)
{
	struct web_job *job = node->job_count < WEB_NODE_JOBS ? new_job(node, work, request) : NULL;

	if (!job)
		return NULL;
	if (node->last)
		node->last->next = job;
	else
		node->jobs = job;
	node->last = job;
	return job;
}

/* A job that the first one in the queue needs; there is always room for it. */
static bool push_front(struct web_node *node, web_work *work)
{
	struct web_job *job = new_job(node, work, NULL);

	if (!job)
		return false;
	job->ready = true;
	job->next = node->jobs;
	node->jobs = job;
	if (!node->last)
		node->last = job;
	return true;
}

static void end_first(struct web *web, struct web_node *node)
{
	struct web_job *job = node->jobs;

	node->jobs = job->next;
	if (!node->jobs)
		node->last = NULL;
	node->job_count--;
	free_job(web, job);
}

/* ---- identity and EDS -------------------------------------------------------------------------------------------- */

static void set_eds(struct web_node *node, struct web_eds *eds)
{
	free(node->objects);
	node->objects = NULL;
	if (node->eds)
		node->eds->nodes--;
	node->eds = eds;
	if (eds)
		eds->nodes++;
}

bool web_is_ours(const struct web_node *node)
{
	const struct od_values *defaults = imu9_od_table.defaults;

	return node->known && node->identity[1] == defaults->identity.product_code &&
	       strcmp(node->name, defaults->manufacturer_device_name) == 0;
}

static void stop_watching(struct web_node *node)
{
	free(node->watch);
	free(node->values);
	free(node->rows);
	node->watch = NULL;
	node->values = NULL;
	node->rows = NULL;
}

static bool work_watch(struct web *web, struct web_job *job, uint64_t now_us)
{
	if (job->node->subscribers > 0)
		web_node_subscribe(web, job->node, now_us);
	return false;
}

static void set_name(struct web_node *node, const struct web_step *step)
{
	size_t size = step->result == SDO_DONE ? step->size : 0;

	if (size >= sizeof(node->name))
		size = sizeof(node->name) - 1;
	memcpy(node->name, web_bytes(step), size);
	node->name[size] = '\0';
}

static void set_identity(struct web *web, struct web_node *node, const struct web_step steps[IDENTITY_STEPS])
{
	uint32_t old[3];

	memcpy(old, node->identity, sizeof(old));
	node->type = web_u32(&steps[0], 0);
	for (int i = 0; i < 4; i++)
		node->identity[i] = web_u32(&steps[1 + i], 0);
	set_name(node, &steps[5]);
	node->identified = node->known = node->listed = true;
	node->identify_wait_us = 0;
	web->nodes_version++;
	if (!node->eds || (memcmp(old, node->identity, sizeof(old)) == 0 && !node->eds_interrupted))
		return;
	node->eds_interrupted = false;
	bool watched = node->watch;
	stop_watching(node);
	set_eds(node, NULL);
	if (watched)
		web_enqueue(node, work_watch, NULL);
}

static bool work_identify(struct web *web, struct web_job *job, uint64_t now_us)
{
	struct web_node *node = job->node;

	if (job->stage == 0) {
		bool ok = web_read(job, 0x1000, 0);

		for (uint8_t sub = 1; sub <= 4; sub++)
			ok = web_read(job, OD_INDEX_IDENTITY, sub) && ok;
		return web_read(job, OD_INDEX_MANUFACTURER_DEVICE_NAME, 0) && ok;
	}
	if (job->steps[IDENTITY_STEPS - 1].result == SDO_DONE || job->steps[IDENTITY_STEPS - 1].result == SDO_ABORTED) {
		set_identity(web, node, job->steps);
		return false;
	}
	node->identify_wait_us = node->identify_wait_us ? 2 * node->identify_wait_us : IDENTIFY_US;
	node->identify_wait_us = earlier(node->identify_wait_us, IDENTIFY_MAX_US);
	node->identify_us = now_us + node->identify_wait_us;
	while (job->next) { /* none of those that wait would get an answer */
		struct web_job *waiting = job->next;

		web_refuse(web, waiting, "no answer from node %u", node->id);
		job->next = waiting->next;
		node->job_count--;
		free_job(web, waiting);
	}
	node->last = job;
	return false;
}

static bool work_eds(struct web *web, struct web_job *job, uint64_t now_us)
{
	struct web_node *node = job->node;
	struct web_eds *eds = NULL;

	(void)now_us;
	if (job->stage == 0)
		return web_read(job, OD_INDEX_STORE_FORMAT, 0) && web_read(job, OD_INDEX_STORE_EDS, 0);
	struct web_step *text = &job->steps[1];
	/* 0: not compressed; a node without 1022h has no other format (CiA 301, 7.5.2.19) */
	if (text->result == SDO_DONE && text->large && web_u32(&job->steps[0], 0) == 0) {
		eds = web_eds_read(web, node, (char *)text->large, text->size);
		text->large = NULL;
	}
	node->eds_interrupted = text->result != SDO_DONE && text->result != SDO_ABORTED;
	set_eds(node, eds ? eds : web_eds_otherwise(web, node));
	return false;
}

/* True: the first job has all that it needs. */
static bool prepare(struct web *web, struct web_node *node)
{
	struct web_job *job = node->jobs;

	if (job->ready || job->stage > 0)
		return true;
	if (!node->identified) {
		if (!push_front(node, work_identify))
			end_first(web, node);
		return false;
	}
	if (!node->eds)
		set_eds(node, web_eds_known(web, node));
	if (!node->eds) {
		if (!push_front(node, work_eds))
			end_first(web, node);
		return false;
	}
	return true;
}

/* ---- transfers --------------------------------------------------------------------------------------------------- */

static bool is_large(const struct web_step *step)
{
	return (step->entry && step->entry->type == OD_DOMAIN) || step->index == OD_INDEX_STORE_EDS;
}

static void start_step(struct web_node *node, struct web_job *job, uint64_t now_us)
{
	struct web_step *step = &job->steps[job->at];
	size_t wanted = step->index == OD_INDEX_STORE_EDS ? WEB_EDS_MAX : OD_DOMAIN_MAX;

	node->sdo.timeout_us = job->timeout_ms * UINT64_C(1000);
	if (step->write) {
		sdo_client_download(&node->sdo, step->index, step->sub, step->wire, step->size, now_us);
		return;
	}
	if (job->capacity < wanted) {
		free(job->buffer);
		job->buffer = malloc(wanted);
		job->capacity = job->buffer ? wanted : 0;
	}
	if (is_large(step))
		sdo_client_block_upload(&node->sdo, step->index, step->sub, job->buffer, job->capacity, now_us);
	else
		sdo_client_upload(&node->sdo, step->index, step->sub, job->buffer, job->capacity, now_us);
}

static void keep(struct web_step *step, const uint8_t *data, size_t size)
{
	step->size = size;
	if (size <= sizeof(step->wire)) {
		memcpy(step->wire, data, size);
		return;
	}
	step->large = malloc(size + 1);
	if (!step->large) {
		step->result = SDO_ABORTED;
		step->abort_code = SDO_ABORT_MEMORY;
		return;
	}
	memcpy(step->large, data, size);
	step->large[size] = '\0';
}

static void lose(struct web *web, struct web_node *node)
{
	if (node->listed && node->state != WATCH_NMT_LOST) {
		node->state = WATCH_NMT_LOST;
		web->nodes_version++;
	}
}

/* The transfer is over. */
static void end_step(struct web *web, struct web_node *node, uint64_t now_us)
{
	struct web_job *job = node->jobs;
	struct web_step *step = &job->steps[job->at];

	step->result = node->sdo.result;
	step->abort_code = node->sdo.abort_code;
	node->sdo.result = SDO_IDLE;
	switch (step->result) {
	case SDO_DONE:
		if (!step->write)
			keep(step, job->buffer, node->sdo.size);
		job->at++;
		break;
	case SDO_ABORTED:
		job->at = job->stop ? job->count : job->at + 1;
		break;
	default:
		job->at = job->count;
		if (step->result == SDO_TIMEOUT && now_us - node->heard_us > FRESH_US)
			lose(web, node);
		break;
	}
}

static void on_transfer(struct web *web, struct web_node *node, uint64_t now_us)
{
	struct web_job *job = node->jobs;
	const struct web_step *step = &job->steps[job->at];

	/* a server without block transfer (CiA 301, 7.2.4.3.15) */
	if (node->sdo.result == SDO_ABORTED && node->sdo.aborted_by_server && is_large(step) && !step->write &&
		node->sdo.phase >= SDO_BLOCK_UPLOAD_START &&
		(node->sdo.abort_code == SDO_ABORT_COMMAND || node->sdo.abort_code == SDO_ABORT_UNSUPPORTED_ACCESS)) {
		sdo_client_upload(&node->sdo, step->index, step->sub, job->buffer, job->capacity, now_us);
		if (node->sdo.result == SDO_RUNNING)
			return;
	}
	end_step(web, node, now_us);
}

static bool is_watch_busy(const struct web_node *node)
{
	const struct watch *watch = node->watch;

	return watch && (watch->sdo.result == SDO_RUNNING || watch->mapping == WATCH_READING);
}

static bool is_wanted(const struct web *web, const struct web_job *job)
{
	const struct web_client *client = job->client >= 0 ? &web->clients[job->client] : NULL;

	return !client || job->changes || (client->open && client->serial == job->serial);
}

/* Goes on with the first job until a transfer is under way. */
static void run_jobs(struct web *web, struct web_node *node, uint64_t now_us)
{
	while (node->jobs && node->sdo.result != SDO_RUNNING && !is_watch_busy(node)) {
		struct web_job *job = node->jobs;

		if (job->at < job->count) {
			start_step(node, job, now_us);
			if (node->sdo.result != SDO_RUNNING)
				end_step(web, node, now_us);
			continue;
		}
		if (job->stage == 0 && !is_wanted(web, job)) {
			end_first(web, node);
			continue;
		}
		if (!prepare(web, node))
			continue;
		bool more = job->work(web, job, now_us);
		job->stage++;
		if (!more)
			end_first(web, node);
	}
}

/* ---- frames ------------------------------------------------------------------------------------------------------ */

static void set_state(struct web *web, struct web_node *node, int state)
{
	if (node->state != state || !node->listed)
		web->nodes_version++;
	node->state = state;
	node->listed = true;
}

static void on_boot_up(struct web *web, struct web_node *node, uint64_t now_us)
{
	set_state(web, node, NMT_PRE_OPERATIONAL);
	node->heartbeat_us = node->heartbeat_interval_us = 0;
	node->identified = false;
	node->identify_wait_us = 0;
	node->identify_us = now_us + BOOT_US;
	if (node->sdo.result == SDO_RUNNING) { /* its server has forgotten the transfer */
		node->sdo.result = SDO_TIMEOUT;
		end_step(web, node, now_us);
	}
}

static void on_heartbeat(struct web *web, struct web_node *node, int state, uint64_t now_us)
{
	if (node->heartbeat_us && node->state != WATCH_NMT_LOST)
		node->heartbeat_interval_us = now_us - node->heartbeat_us;
	node->heartbeat_us = now_us;
	set_state(web, node, state);
}

static void on_emcy(struct web *web, const struct web_node *node, const struct can_msg *msg)
{
	web->emcys[web->emcy_count++ % WEB_EMCYS] = (struct web_emcy){
		.node = node->id,
		.code = get_u16(msg->data),
		.error_register = msg->data[2],
	};
}

void web_node_receive(struct web *web, struct web_node *node, const struct can_msg *msg, uint64_t now_us)
{
	uint32_t function = msg->id & 0x780;
	bool pdo = function == 0x180 || function == 0x280 || function == 0x380 || function == 0x480;
	bool emcy = function == 0x080 && msg->len == 8;
	bool error_control = function == CAN_ID_ERROR_CONTROL && msg->len == 1;
	bool sdo = function == CAN_ID_SDO_RESPONSE && msg->len == 8;

	if (!pdo && !emcy && !error_control && !sdo)
		return;
	node->heard_us = now_us;
	if (error_control && msg->data[0] == NMT_INITIALISING)
		on_boot_up(web, node, now_us);
	else if (error_control)
		on_heartbeat(web, node, msg->data[0] & 0x7F, now_us);
	else if (emcy)
		on_emcy(web, node, msg);
	if (pdo && !node->listed) /* perhaps the PDO of another one: it must answer */
		node->identify_wait_us = later(node->identify_wait_us, 1);
	else if (!node->listed)
		set_state(web, node, WATCH_NMT_UNKNOWN);
	if (pdo && node->listed && (node->state == WATCH_NMT_UNKNOWN || node->state == WATCH_NMT_LOST))
		set_state(web, node, NMT_OPERATIONAL);
	else if (node->state == WATCH_NMT_LOST)
		set_state(web, node, WATCH_NMT_UNKNOWN);
	if (node->sdo.result == SDO_RUNNING) {
		sdo_client_receive(&node->sdo, msg, now_us);
		if (node->sdo.result != SDO_RUNNING)
			on_transfer(web, node, now_us);
	}
}

static uint64_t lost_at(const struct web_node *node)
{
	uint64_t wait_us = later(LOST_PERIODS * node->heartbeat_interval_us, LOST_MIN_US);

	if (!node->listed || node->heartbeat_interval_us == 0 || node->state == WATCH_NMT_LOST)
		return UINT64_MAX;
	return later(node->heard_us, node->heartbeat_us) + wait_us;
}

/* Also a node that has only sent PDOs. */
static uint64_t identify_at(const struct web_node *node)
{
	bool found = node->listed ? node->state != NMT_STOPPED && node->state != WATCH_NMT_LOST
				  : node->identify_wait_us > 0 && node->heard_us >= node->identify_us;

	return found && !node->identified && node->job_count == 0 ? node->identify_us : UINT64_MAX;
}

/* Whether a node without heartbeat is still there: a transfer without an answer makes it lost. */
static bool work_ping(struct web *web, struct web_job *job, uint64_t now_us)
{
	(void)web, (void)now_us;
	return job->stage == 0 && web_read(job, 0x1000, 0);
}

static uint64_t ping_at(const struct web_node *node)
{
	bool silent = node->listed && node->identified && node->heartbeat_interval_us == 0 &&
		      node->state != NMT_STOPPED && node->state != WATCH_NMT_LOST;

	return silent && node->job_count == 0 ? node->heard_us + PING_US : UINT64_MAX;
}

uint64_t web_node_tick(struct web *web, struct web_node *node, uint64_t now_us)
{
	uint64_t next_us = UINT64_MAX;

	if (node->sdo.result == SDO_RUNNING) {
		sdo_client_tick(&node->sdo, now_us);
		if (node->sdo.result != SDO_RUNNING)
			on_transfer(web, node, now_us);
	}
	if (now_us >= lost_at(node))
		lose(web, node);
	if (now_us >= identify_at(node))
		push_front(node, work_identify);
	if (now_us >= ping_at(node))
		push_front(node, work_ping);
	if (node->watch && node->sdo.result != SDO_RUNNING)
		next_us = watch_tick(node->watch, now_us);
	run_jobs(web, node, now_us);
	if (node->sdo.result == SDO_RUNNING)
		next_us = sdo_client_tick(&node->sdo, now_us);
	if (node->rows)
		next_us = earlier(next_us, web_rows_tick(web, node, now_us));
	return earlier(earlier(next_us, ping_at(node)), earlier(lost_at(node), identify_at(node)));
}

/* ---- the watch --------------------------------------------------------------------------------------------------- */

void web_node_subscribe(struct web *web, struct web_node *node, uint64_t now_us)
{
	const struct od_table *table = node->eds->table;

	if (node->watch)
		return;
	node->watch = calloc(1, sizeof(*node->watch));
	node->values = malloc(table->values_size ? table->values_size : 1);
	node->rows = calloc(1, sizeof(*node->rows));
	if (node->watch && node->values && node->rows)
		watch_init(node->watch, table, node->values, web->config.bus, node->id, false, now_us);
	else
		stop_watching(node);
}

void web_node_unsubscribe(struct web_node *node)
{
	if (node->subscribers > 0 && --node->subscribers == 0)
		stop_watching(node);
}

void web_node_mapping_changed(struct web_node *node, uint64_t now_us)
{
	if (node->watch)
		watch_read_mapping(node->watch, now_us);
}

void web_node_free(struct web *web, struct web_node *node)
{
	while (node->jobs)
		end_first(web, node);
	set_eds(node, NULL);
	stop_watching(node);
}
