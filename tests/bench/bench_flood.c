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
#include <linux/filter.h>
#include <net/if.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "drivers/can/udp_codec.h"

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

static void fail(const char *what)
{
	fprintf(stderr, "bench_flood: %s: %s\n", what, strerror(errno));
	exit(EXIT_FAILURE);
}

static double now_us(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec * 1e6 + (double)t.tv_nsec / 1e3;
}

/* ---- the master's end of the bus --------------------------------------------------------------------------------- */

struct end {
	int fd;
	struct sockaddr_in group;
};

/* The kernel drops all other frames, so that neither the flood nor answers to it delay the master. The ID is an
 * UNSIGNED8 or UNSIGNED16 of msgpack, at this place of each datagram (8 bytes of UDP before it). */
static void receive_only(int fd, uint32_t id)
{
	enum { ID_AT = 8 + 1 + 10 + 9 + 15, UNSIGNED8 = 0xCC, UNSIGNED16 = 0xCD };
	bool small = id < 0x100;
	struct sock_filter code[] = {
		BPF_STMT(BPF_LD | BPF_B | BPF_ABS, ID_AT),
		BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, small ? UNSIGNED8 : UNSIGNED16, 0, 3),
		BPF_STMT(BPF_LD | (small ? BPF_B : BPF_H) | BPF_ABS, ID_AT + 1),
		BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, id, 0, 1),
		BPF_STMT(BPF_RET | BPF_K, 0xFFFF),
		BPF_STMT(BPF_RET | BPF_K, 0),
	};
	struct sock_fprog program = {.len = sizeof(code) / sizeof(*code), .filter = code};

	if (setsockopt(fd, SOL_SOCKET, SO_ATTACH_FILTER, &program, sizeof(program)) < 0)
		fail("filter");
}

/* `id`: of the frames to receive; 0: none. */
static struct end open_end(uint32_t id)
{
	struct end end = {.fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0),
		.group = {.sin_family = AF_INET, .sin_port = htons(PORT), .sin_addr.s_addr = inet_addr(GROUP)}};
	struct ip_mreqn member = {.imr_multiaddr = end.group.sin_addr, .imr_ifindex = (int)if_nametoindex("lo")};
	int on = 1;

	if (end.fd < 0 || setsockopt(end.fd, IPPROTO_IP, IP_MULTICAST_IF, &member, sizeof(member)) < 0)
		fail("socket");
	if (id == 0)
		return end;
	receive_only(end.fd, id);
	setsockopt(end.fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof(on));
	if (bind(end.fd, (struct sockaddr *)&end.group, sizeof(end.group)) < 0 ||
		setsockopt(end.fd, IPPROTO_IP, IP_ADD_MEMBERSHIP, &member, sizeof(member)) < 0)
		fail("udp bus");
	return end;
}

static void put_bytes(const struct end *end, const void *bytes, size_t size)
{
	while (sendto(end->fd, bytes, size, 0, (const struct sockaddr *)&end->group, sizeof(end->group)) < 0)
		if (errno != ENOBUFS && errno != EAGAIN)
			fail("send");
}

static void put(const struct end *end, uint32_t id, const void *data, size_t len)
{
	struct can_msg msg = {.id = id, .len = (uint8_t)len};
	char bytes[CAN_UDP_MAX];

	memcpy(msg.data, data, len);
	put_bytes(end, bytes, can_udp_encode(&msg, bytes));
}

/* False: nothing was received for ANSWER_MS. */
static bool get(const struct end *end, struct can_msg *msg)
{
	struct pollfd p = {.fd = end->fd, .events = POLLIN};
	char bytes[CAN_UDP_MAX];
	ssize_t size;

	if (poll(&p, 1, ANSWER_MS) != 1)
		return false;
	size = recv(end->fd, bytes, sizeof(bytes), 0);
	if (size < 0 || can_udp_decode(bytes, (size_t)size, msg) < 0)
		fail("receive");
	return true;
}

/* Returns the number of frames that were waiting. */
static unsigned drain(const struct end *end)
{
	char bytes[CAN_UDP_MAX];
	unsigned n = 0;

	while (recv(end->fd, bytes, sizeof(bytes), MSG_DONTWAIT) > 0)
		n++;
	return n;
}

/* ---- the gateway ------------------------------------------------------------------------------------------------- */

static struct can_msg sdo(const struct end *end, const uint8_t request[8])
{
	struct can_msg response;

	put(end, REQUEST, request, 8);
	if (!get(end, &response) || response.data[0] == 0x80) {
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

static void use_processor(unsigned number)
{
	cpu_set_t set;

	CPU_ZERO(&set);
	CPU_SET(number, &set);
	sched_setaffinity(0, sizeof(set), &set);
}

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
	end = open_end(0);
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
		if (!get(end, &pdo)) {
			l->unanswered++;
			continue;
		}
		l->us[l->count++] = now_us() - start;
		if (now_us() - start < SYNC_US)
			usleep((useconds_t)(SYNC_US - (now_us() - start)));
	}
}

static int ascending(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

static double quantile(struct latencies *l, double part)
{
	qsort(l->us, l->count, sizeof(*l->us), ascending);
	return l->us[(size_t)(part * (double)(l->count - 1))];
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
		kind->name, rate, quantile(&flooded, 0.5) / quantile(&quiet, 0.5), quantile(&flooded, 0.5),
		quantile(&quiet, 0.5), flooded.unanswered, samples_lost(&ends->sdo) - lost, drain(&ends->emcy),
		lines_of_log(folder) - lines);
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
	ends = (struct ends){open_end(TPDO1), open_end(RESPONSE), open_end(EMCY)};
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
