/* tests/bench/bench_flood.c
 * What a flood costs: 20000 frames a second of one kind on the udp bus, or as many requests of Modbus/TCP as are
 * answered, beside 50 slow clients; and the time from SYNC to TPDO1 in the flood and in the quiet before each part of
 * it, in turn, medians. Prints the ratio of both, and what the gateway did meanwhile. Gateway and master share
 * processor 0; the flood comes from another one where there is one, as from an adapter.
 *
 *     build/tests/bench/bench_flood [SECONDS [WORD]]
 *
 * SECONDS of flood for each kind, default 2; WORD: only the kinds with it in their names. */
#include <arpa/inet.h>
#include <dirent.h>
#include <errno.h>
#include <sched.h>
#include <signal.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include "drivers/can/udp_codec.h"
#include "tests/bench/bus_end.h"

#define GROUP "239.74.163.98"
enum { PORT = 43198, MODBUS_PORT = 43199, NODE = 1, OTHER = 5 };
enum { MODBUS = 0x10000, SLOW_CLIENTS = 50 }; /* MODBUS: as the ID of a kind */
enum { SYNC = 0x080, EMCY = 0x080 + NODE, TPDO1 = 0x180 + NODE, REQUEST = 0x600 + NODE, RESPONSE = 0x580 + NODE };
enum {
	FRAMES_S = 20000,
	SYNC_US = 4000,
	PART_US = 500000,
	SETTLE_US = 200000,
	ANSWER_MS = 300,
	PRIORITY = 10,
	ROUNDS_MAX = 100000
};

struct kind {
	const char *name;
	uint32_t id;
	uint8_t len, data[8];
	bool malformed;
};

static const struct kind KINDS[] = {
	{"NMT commands", 0x000, 2, {1, NODE}, false},
	{"SDO requests", REQUEST, 8, {0x40, 0x00, 0x10}, false},
	{"SDO requests of 4 bytes", REQUEST, 4, {0x40, 0x00, 0x10}, false},
	{"RPDOs of wrong length", 0x200 + NODE, 6, {0}, false},
	{"unknown COB-ID", 0x2AA, 8, {0}, false},
	{"SYNC of wrong length", SYNC, 3, {1}, false},
	{"EMCY of another node", 0x080 + OTHER, 8, {0x10, 0x81}, false},
	{"heartbeats of another node", 0x700 + OTHER, 1, {5}, false},
	{"LSS commands", 0x7E5, 8, {0x04}, false},
	{"malformed datagrams", 0, 0, {0}, true},
	{"Modbus, and 50 slow clients", MODBUS, 0, {0}, false},
};

/* ---- the gateway ------------------------------------------------------------------------------------------------- */

static struct can_msg sdo(const struct end *end, const uint8_t request[8])
{
	struct can_msg response;

	put(end, REQUEST, request, 8);
	if (!get(end, &response, ANSWER_MS) || response.data[0] == 0x80) {
		errno = EPROTO;
		fail("the gateway does not answer or refuses");
	}
	return response;
}

static void sdo_write_u32(const struct end *end, uint16_t index, uint8_t sub, uint32_t value)
{
	uint8_t request[8] = {0x23, (uint8_t)index, (uint8_t)(index >> 8), sub};

	memcpy(request + 4, &value, 4);
	sdo(end, request);
}

static uint32_t sdo_read_u32(const struct end *end, uint16_t index, uint8_t sub)
{
	const uint8_t request[8] = {0x40, (uint8_t)index, (uint8_t)(index >> 8), sub};
	struct can_msg response = sdo(end, request);
	uint32_t value;

	memcpy(&value, response.data + 4, 4);
	return value;
}

static pid_t start_gateway(const char *folder)
{
	const char *build = getenv("BUILD");
	char program[256], log[256], bus[64], window[80];
	pid_t pid = fork();

	if (pid != 0) {
		usleep(1000000);
		return pid;
	}
	snprintf(program, sizeof(program), "%s/imu9-gateway", build ? build : "build");
	snprintf(log, sizeof(log), "%s/log", folder);
	snprintf(bus, sizeof(bus), "udp:" GROUP ":%d,interface=lo", PORT);
	if (!freopen(log, "w", stderr))
		_exit(1);
	snprintf(window, sizeof(window), "tcp:127.0.0.1:%d,write=127.0.0.1,clients=32,rate=10000", MODBUS_PORT);
	execl(program, program, "--can", bus, "--node-id", "1", "--imu", "sim:rest", "--store", folder, "--modbus",
		window, NULL);
	_exit(1);
}

/* Threads that gave up the real-time scheduling of the loop get one below it, as if nothing else ran on the machine:
 * other work would keep them from loading it. */
static void lift_threads(pid_t gateway)
{
	char path[64];
	const struct dirent *task;
	DIR *tasks;

	snprintf(path, sizeof(path), "/proc/%d/task", gateway);
	tasks = opendir(path);
	while (tasks && (task = readdir(tasks))) {
		pid_t id = (pid_t)atoi(task->d_name);

		if (id > 0 && sched_getscheduler(id) == SCHED_OTHER)
			(void)sched_setscheduler(id, SCHED_FIFO, &(struct sched_param){.sched_priority = PRIORITY - 1});
	}
	if (tasks)
		closedir(tasks);
}

static long lines_of_log(const char *folder)
{
	char path[256];
	long lines = 0;
	FILE *file;
	int c;

	snprintf(path, sizeof(path), "%s/log", folder);
	file = fopen(path, "r");
	while (file && (c = fgetc(file)) != EOF)
		lines += c == '\n';
	if (file)
		fclose(file);
	return lines;
}

/* ---- the flood --------------------------------------------------------------------------------------------------- */

static int connect_modbus(void)
{
	const struct sockaddr_in to = {
		.sin_family = AF_INET, .sin_port = htons(MODBUS_PORT), .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
	int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);

	if (fd < 0 || connect(fd, (const struct sockaddr *)&to, sizeof(to)) < 0)
		fail("Modbus");
	return fd;
}

/* Random bytes as a request, but for what changes the configuration; each fourth writes a lever arm (function 16),
 * which the loop executes. */
static size_t random_request(uint8_t *pdu, uint32_t *dice)
{
	static const uint8_t READ[] = {1, 2, 3, 4, 7, 8, 17, 20, 24, 43}, WRITE[] = {16, 0x10, 0, 0, 2, 4, 0x3C};
	size_t size = 2 + *dice % 250;

	for (size_t i = 0; i < size; i++) {
		*dice = *dice * 1664525 + 1013904223;
		pdu[i] = (uint8_t)(*dice >> 24);
	}
	if (pdu[0] % 4 == 0) {
		memcpy(pdu, WRITE, sizeof(WRITE));
		return 10;
	}
	pdu[0] = READ[pdu[0] % sizeof(READ)];
	pdu[1] = pdu[0] == 43 ? 14 : pdu[1];
	return size;
}

/* Returns the number of requests that were answered. */
static double flood_modbus(double stop_us)
{
	int fd = connect_modbus();
	uint8_t frame[7 + 253] = {0};
	uint32_t dice = (uint32_t)now_us();
	double answered = 0;

	for (int i = 0; i < SLOW_CLIENTS; i++)
		if (write(connect_modbus(), "\0\1\0\0\0", 5) < 0 && errno != EPIPE && errno != ECONNRESET)
			fail("slow client");
	while (now_us() < stop_us) {
		size_t size = random_request(frame + 7, &dice);

		frame[4] = (uint8_t)((size + 1) >> 8);
		frame[5] = (uint8_t)(size + 1);
		if (write(fd, frame, 7 + size) < 0 || read(fd, frame, sizeof(frame)) < 9)
			fail("Modbus");
		memset(frame, 0, 7);
		answered++;
	}
	return answered;
}

/* Writes the number of its frames a second into `report` at the end. */
static pid_t start_flood(const struct kind *kind, int report)
{
	pid_t pid = fork();
	struct end end;
	char bytes[CAN_UDP_MAX];
	size_t size = sizeof("\x8b\xa9timestamp\xcb") - 1;
	double start = now_us(), sent = 0;
	struct can_msg msg = {.id = kind->id, .len = kind->len};

	if (pid != 0)
		return pid;
	use_processor(sysconf(_SC_NPROCESSORS_ONLN) > 1 ? 1 : 0);
	if (kind->id == MODBUS)
		sent = flood_modbus(start + PART_US + SETTLE_US);
	end = open_end(GROUP, PORT, 0, END_SENDS);
	memcpy(msg.data, kind->data, sizeof(msg.data));
	memcpy(bytes, "\x8b\xa9timestamp\xcb", size);
	if (!kind->malformed)
		size = can_udp_encode(&msg, bytes);
	while (now_us() - start < PART_US + SETTLE_US) {
		if (sent >= (now_us() - start) * FRAMES_S / 1e6) {
			usleep(200);
			continue;
		}
		put_bytes(&end, bytes, size);
		sent++;
	}
	sent = sent / (now_us() - start) * 1e6;
	_exit(write(report, &sent, sizeof(sent)) != sizeof(sent));
}

/* ---- measurements ------------------------------------------------------------------------------------------------ */

struct latencies {
	double us[ROUNDS_MAX];
	size_t count, unanswered;
};

static void measure(const struct end *end, struct latencies *l)
{
	double stop = now_us() + PART_US;

	for (double start = now_us(); start < stop && l->count < ROUNDS_MAX; start = now_us()) {
		struct can_msg pdo;

		put(end, SYNC, "", 0);
		if (!get(end, &pdo, ANSWER_MS)) {
			l->unanswered++;
			continue;
		}
		l->us[l->count++] = now_us() - start;
		if (now_us() - start < SYNC_US)
			usleep((useconds_t)(SYNC_US - (now_us() - start)));
	}
}

static double median(struct latencies *l)
{
	return quantile(l->us, l->count, 0.5);
}

/* Samples skipped and gaps (2121h). */
static uint32_t samples_lost(const struct end *sdo)
{
	return sdo_read_u32(sdo, 0x2121, 2) + sdo_read_u32(sdo, 0x2121, 4);
}

struct ends {
	struct end pdo, sdo, emcy;
};

static void measure_kind(const struct ends *ends, const struct kind *kind, int parts, const char *folder)
{
	static struct latencies quiet, flooded;
	uint32_t lost = samples_lost(&ends->sdo);
	long lines = lines_of_log(folder);
	double rate = 0;

	quiet.count = flooded.count = flooded.unanswered = 0;
	for (int part = 0; part < parts; part++) {
		int report[2];
		double sent;
		pid_t flood;

		measure(&ends->pdo, &quiet);
		if (pipe(report) < 0)
			fail("pipe");
		flood = start_flood(kind, report[1]);
		usleep(SETTLE_US / 2);
		measure(&ends->pdo, &flooded);
		waitpid(flood, NULL, 0);
		if (read(report[0], &sent, sizeof(sent)) != sizeof(sent))
			fail("flood");
		rate += sent / parts;
		close(report[0]);
		close(report[1]);
		usleep(SETTLE_US);
	}
	drain(&ends->sdo);
	printf("%-28s %6.0f/s  SYNC to TPDO %.2f times the quiet (%.0f us against %.0f)  %zu SYNCs unanswered  "
	       "%u samples lost  %u EMCYs  %ld lines of log\n",
		kind->name, rate, median(&flooded) / median(&quiet), median(&flooded), median(&quiet),
		flooded.unanswered, samples_lost(&ends->sdo) - lost, drain(&ends->emcy), lines_of_log(folder) - lines);
	fflush(stdout);
}

int main(int argc, char **argv)
{
	char folder[] = "/tmp/bench_flood.XXXXXX", clean[64];
	int parts = (argc > 1 ? atoi(argv[1]) : 2) * 1000000 / PART_US;
	struct ends ends;
	pid_t gateway;

	use_processor(0);
	/* where permitted: other work on the machine disturbs less */
	(void)sched_setscheduler(0, SCHED_FIFO, &(struct sched_param){.sched_priority = PRIORITY});
	if (!mkdtemp(folder))
		fail(folder);
	ends = (struct ends){open_end(GROUP, PORT, TPDO1, 0x7FF), open_end(GROUP, PORT, RESPONSE, 0x7FF),
		open_end(GROUP, PORT, EMCY, 0x7FF)};
	gateway = start_gateway(folder);
	if (sched_getscheduler(0) == SCHED_FIFO)
		lift_threads(gateway);
	for (uint8_t n = 1; n < 4; n++)
		sdo_write_u32(&ends.sdo, (uint16_t)(0x1800 + n), 1, 0xC0000180u + 0x100u * n + NODE);
	put(&ends.sdo, 0x000, (const uint8_t[]){1, NODE}, 2);
	usleep(100000);
	for (size_t i = 0; i < sizeof(KINDS) / sizeof(*KINDS); i++)
		if (argc < 3 || strstr(KINDS[i].name, argv[2]))
			measure_kind(&ends, &KINDS[i], parts, folder);
	kill(gateway, SIGTERM);
	waitpid(gateway, NULL, 0);
	snprintf(clean, sizeof(clean), "rm -rf %s", folder);
	return system(clean) == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}
