/* tests/bench/bench_bus.c
 * Latency of the gateway on vcan0 compared with that of a minimal program that answers every frame (the floor): on the
 * same boot and processor, in alternating batches, medians. Prints ratios, because absolute times depend on the
 * machine.
 *
 *     tests/rig/vcan-run build/tests/bench/bench_bus       (`make bench` does) */
#include <arpa/inet.h>
#include <errno.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum { NODE = 1, SYNC = 0x80, NMT = 0x000, TPDO1 = 0x180 + NODE, REQUEST = 0x600 + NODE, RESPONSE = 0x580 + NODE };
enum { BOOT_UP = 0x700 + NODE, PATIENCE_MS = 10000 };
enum { BATCHES = 10, ROUNDS = 200, SEGMENT = 7, BLOCK_SEGMENTS = 127, FOREIGN = 2000, FOREIGN_ID = 0x2AA };
enum { MODBUS_PORT = 1502, SLOW_CLIENTS = 50, MODBUS_FRAME = 40, SHORT_BATCH = 20 };
enum { FLOOR_BLOCK_BYTES = 120000, PAUSE_US = 3000 };

static const char MODBUS_WINDOW[] = "tcp:127.0.0.1:1502,write=127.0.0.1,clients=32";

static void fail(const char *what)
{
	fprintf(stderr, "bench_bus: %s: %s\n", what, strerror(errno));
	exit(EXIT_FAILURE);
}

static int open_bus(void)
{
	struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = (int)if_nametoindex("vcan0")};
	int fd = socket(PF_CAN, SOCK_RAW | SOCK_CLOEXEC, CAN_RAW);
	int size = 1 << 20;

	if (fd < 0 || bind(fd, (struct sockaddr *)&address, sizeof(address)) < 0)
		fail("there is no vcan0: run it with tests/rig/vcan-run");
	setsockopt(fd, SOL_SOCKET, SO_RCVBUFFORCE, &size, sizeof(size));
	return fd;
}

static void only(int fd, uint32_t id, uint32_t id2)
{
	struct can_filter filters[] = {{id, CAN_SFF_MASK}, {id2, CAN_SFF_MASK}};

	setsockopt(fd, SOL_CAN_RAW, CAN_RAW_FILTER, filters, sizeof(filters));
}

static void put(int fd, uint32_t id, const void *data, size_t len)
{
	struct can_frame frame = {.can_id = id, .can_dlc = (uint8_t)len};

	memcpy(frame.data, data, len);
	while (write(fd, &frame, sizeof(frame)) < 0)
		if (errno != ENOBUFS && errno != EAGAIN)
			fail("write");
}

static struct can_frame get(int fd, uint32_t id)
{
	struct pollfd p = {.fd = fd, .events = POLLIN};
	struct can_frame frame;

	do {
		if (poll(&p, 1, PATIENCE_MS) != 1) {
			errno = ETIMEDOUT;
			fail("no answer");
		}
		if (read(fd, &frame, sizeof(frame)) < 0)
			fail("read");
	} while (frame.can_id != id);
	return frame;
}

static double now_us(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec * 1e6 + (double)t.tv_nsec / 1e3;
}

/* ---- the floor --------------------------------------------------------------------------------------------------- */

static void floor_block(int fd, size_t *left)
{
	uint8_t segment[8] = {0};

	for (uint8_t n = 1; n <= BLOCK_SEGMENTS && *left > 0; n++) {
		*left -= *left < SEGMENT ? *left : SEGMENT;
		segment[0] = (uint8_t)(n | (*left == 0 ? 0x80 : 0));
		put(fd, RESPONSE, segment, sizeof(segment));
	}
}

static void floor_sdo(int fd, const struct can_frame *request, size_t *left)
{
	uint8_t answer[8] = {0x43, 0x00, 0x10, 0x00};

	switch (request->data[0]) {
	case 0xA0: /* block upload */
	case 0xA4:
		*left = FLOOR_BLOCK_BYTES;
		answer[0] = 0xC2;
		memcpy(answer + 4, &(uint32_t){FLOOR_BLOCK_BYTES}, 4);
		break;
	case 0xA2: /* acknowledge */
		if (*left == 0) {
			answer[0] = 0xC1;
			break;
		}  /* fall through */
	case 0xA3: /* start */
		floor_block(fd, left);
		return;
	case 0xA1: /* end */
		return;
	}
	put(fd, RESPONSE, answer, sizeof(answer));
}

static pid_t start_floor(void)
{
	pid_t pid = fork();

	if (pid != 0)
		return pid;
	int fd = open_bus();
	size_t left = 0;
	struct can_frame frame;

	only(fd, SYNC, REQUEST);
	while (read(fd, &frame, sizeof(frame)) > 0)
		if (frame.can_id == SYNC)
			put(fd, TPDO1, (uint8_t[8]){0}, 8);
		else
			floor_sdo(fd, &frame, &left);
	_exit(0);
}

/* ---- the gateway ------------------------------------------------------------------------------------------------- */

static void sdo_write(int fd, uint16_t index, uint8_t sub, uint32_t value, uint8_t size)
{
	uint8_t request[8] = {(uint8_t)(0x23 | (4 - size) << 2), (uint8_t)index, (uint8_t)(index >> 8), sub};

	memcpy(request + 4, &value, size);
	put(fd, REQUEST, request, sizeof(request));
	if (get(fd, RESPONSE).data[0] != 0x60) {
		errno = EPROTO;
		fail("the gateway refused its configuration");
	}
}

/* Operational with TPDO1 only, like the floor. */
static void set_up(int fd)
{
	for (uint8_t n = 1; n < 4; n++)
		sdo_write(fd, (uint16_t)(0x1800 + n), 1, 0xC0000180u + 0x100u * n + NODE, 4);
	put(fd, NMT, (uint8_t[]){1, NODE}, 2);
	usleep(100000);
}

static pid_t start_gateway(const char *folder, const char *imu, const char *modbus)
{
	const char *build = getenv("BUILD");
	char program[256];
	int fd = open_bus();

	only(fd, BOOT_UP, BOOT_UP);
	pid_t pid = fork();
	if (pid != 0) {
		get(fd, BOOT_UP);
		close(fd);
		return pid;
	}
	snprintf(program, sizeof(program), "%s/imu9-gateway", build ? build : "build");
	if (!freopen("/dev/null", "w", stderr))
		_exit(1);
	execl(program, program, "--can", "vcan0", "--node-id", "1", "--imu", imu, "--store", folder,
		modbus ? "--modbus" : NULL, modbus, NULL);
	_exit(1);
}

static void stop(pid_t pid)
{
	kill(pid, SIGTERM);
	waitpid(pid, NULL, 0);
}

/* ---- measurements -------------------------------------------------------------------------------------------- */

/* With a pause before each SYNC the processor has gone to sleep, as with a master that has a period. */
static void sync_rounds(int fd, double *us, int rounds, unsigned pause_us)
{
	for (int i = 0; i < rounds; i++) {
		if (pause_us > 0)
			usleep(pause_us);
		double start = now_us();

		put(fd, SYNC, "", 0);
		get(fd, TPDO1);
		us[i] = now_us() - start;
	}
}

static void expedited(int fd, double *us)
{
	static const uint8_t read_1000h[8] = {0x40, 0x00, 0x10, 0x00};

	for (int i = 0; i < ROUNDS; i++) {
		double start = now_us();

		put(fd, REQUEST, read_1000h, 8);
		get(fd, RESPONSE);
		us[i] = now_us() - start;
	}
}

/* kB/s of one block upload of 1021h, the EDS. */
static double block_upload(int fd)
{
	uint8_t start_upload[8] = {0xA3}, initiate[8] = {0xA4, 0x21, 0x10, 0x00, BLOCK_SEGMENTS};
	size_t segments = 0;
	double start = now_us();

	put(fd, REQUEST, initiate, 8);
	get(fd, RESPONSE);
	put(fd, REQUEST, start_upload, 8);
	for (;;) {
		struct can_frame f = get(fd, RESPONSE);
		uint8_t number = f.data[0] & 0x7F;

		segments++;
		if (!(f.data[0] & 0x80) && number < BLOCK_SEGMENTS)
			continue;
		put(fd, REQUEST, (uint8_t[8]){0xA2, number, BLOCK_SEGMENTS}, 8);
		if (f.data[0] & 0x80)
			break;
	}
	get(fd, RESPONSE);
	put(fd, REQUEST, (uint8_t[8]){0xA1}, 8);
	return (double)(segments * SEGMENT) / ((now_us() - start) / 1e6) / 1000;
}

static int ascending(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

static double median(double *values, size_t n)
{
	qsort(values, n, sizeof(*values), ascending);
	return values[n / 2];
}

struct figures {
	double sync_us[BATCHES * ROUNDS], paced_us[BATCHES * ROUNDS], sdo_us[BATCHES * ROUNDS], block_kb_s[BATCHES];
};

static struct figures measured[2]; /* floor, gateway */

static void measure(int fd, struct figures *f, int batch)
{
	sync_rounds(fd, f->sync_us + batch * ROUNDS, ROUNDS, 0);
	sync_rounds(fd, f->paced_us + batch * ROUNDS, ROUNDS, PAUSE_US);
	expedited(fd, f->sdo_us + batch * ROUNDS);
	f->block_kb_s[batch] = block_upload(fd);
}

static void print_ratio(const char *what, double *floor_us, double *gateway_us)
{
	double low = median(floor_us, BATCHES * ROUNDS), own = median(gateway_us, BATCHES * ROUNDS);

	printf("%-28s %.2f times the floor (%.0f us against %.0f)\n", what, own / low, own, low);
}

static void compare(int fd, const char *folder)
{
	for (int batch = 0; batch < BATCHES; batch++) {
		pid_t pid = start_floor();

		usleep(100000);
		measure(fd, &measured[0], batch);
		stop(pid);
		pid = start_gateway(folder, "sim:rest", NULL);
		set_up(fd);
		measure(fd, &measured[1], batch);
		stop(pid);
	}
	print_ratio("SYNC to TPDO, back to back", measured[0].sync_us, measured[1].sync_us);
	print_ratio("SYNC to TPDO, paced", measured[0].paced_us, measured[1].paced_us);
	print_ratio("expedited SDO upload", measured[0].sdo_us, measured[1].sdo_us);
	double low = median(measured[0].block_kb_s, BATCHES), own = median(measured[1].block_kb_s, BATCHES);
	printf("%-28s %.2f times the floor (%.0f kB/s against %.0f)\n", "block upload", own / low, own, low);
}

/* ---- Modbus clients ---------------------------------------------------------------------------------------------- */

static int connect_client(void)
{
	struct sockaddr_in address = {
		.sin_family = AF_INET, .sin_port = htons(MODBUS_PORT), .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
	int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);

	if (connect(fd, (struct sockaddr *)&address, sizeof(address)) < 0 && errno != EINPROGRESS)
		fail("Modbus");
	return fd;
}

/* Until it is stopped: clients of which each has sent a part of a request, and one that sends random requests as fast
 * as they are answered. */
static pid_t start_clients(void)
{
	pid_t pid = fork();
	uint8_t frame[MODBUS_FRAME] = {0, 1, 0, 0, 0, MODBUS_FRAME - 6, 1}, answer[300];

	if (pid != 0) {
		usleep(300000);
		return pid;
	}
	int fd = connect_client();
	for (int i = 0; i < SLOW_CLIENTS; i++)
		if (write(connect_client(), frame, 4) < 0 && errno != EAGAIN)
			continue; /* one too many: the server has closed it */
	for (;;) {
		struct pollfd p = {.fd = fd, .events = POLLIN};

		for (size_t i = 7; i < sizeof(frame); i++)
			frame[i] = (uint8_t)rand();
		if (write(fd, frame, sizeof(frame)) < 0 && errno != EAGAIN)
			fail("Modbus");
		poll(&p, 1, 1000);
		while (read(fd, answer, sizeof(answer)) > 0)
			;
	}
}

/* One gateway, and clients that are stopped and continued: short batches, so that what else the machine does is in
 * both. */
static void compare_with_clients(int fd, const char *folder)
{
	static double without_us[BATCHES * ROUNDS], with_us[BATCHES * ROUNDS];
	pid_t gateway = start_gateway(folder, "sim:rest", MODBUS_WINDOW);

	set_up(fd);
	pid_t clients = start_clients();
	for (int i = 0; i < BATCHES * ROUNDS; i += SHORT_BATCH) {
		kill(clients, SIGSTOP);
		usleep(PAUSE_US);
		sync_rounds(fd, without_us + i, SHORT_BATCH, 0);
		kill(clients, SIGCONT);
		usleep(PAUSE_US);
		sync_rounds(fd, with_us + i, SHORT_BATCH, 0);
	}
	kill(clients, SIGKILL);
	waitpid(clients, NULL, 0);
	stop(gateway);
	double without = median(without_us, BATCHES * ROUNDS), with = median(with_us, BATCHES * ROUNDS);
	printf("%-28s %.2f times that without them (%.0f us against %.0f)\n", "SYNC to TPDO, Modbus clients",
		with / without, with, without);
}

/* ---- system calls ------------------------------------------------------------------------------------------------ */

/* System calls of the main thread of `pid` while `traffic` runs in another process. */
static long syscalls_during(pid_t pid, void (*traffic)(int fd))
{
	long stops = 0;
	int status;
	pid_t child;

	if (ptrace(PTRACE_SEIZE, pid, NULL, (void *)(long)PTRACE_O_TRACESYSGOOD) < 0 ||
		ptrace(PTRACE_INTERRUPT, pid, NULL, NULL) < 0)
		fail("ptrace");
	waitpid(pid, &status, 0);
	ptrace(PTRACE_SYSCALL, pid, NULL, NULL);
	child = fork();
	if (child == 0) {
		int fd = open_bus();

		usleep(50000);
		traffic(fd);
		_exit(0);
	}
	for (;;) {
		pid_t who = waitpid(-1, &status, __WALL);

		if (who == child)
			break;
		if (who == pid && WIFSTOPPED(status) && WSTOPSIG(status) == (SIGTRAP | 0x80))
			stops++;
		if (who == pid)
			ptrace(PTRACE_SYSCALL, pid, NULL, NULL);
	}
	kill(pid, SIGSTOP);
	while (waitpid(pid, &status, __WALL) == pid && !(WIFSTOPPED(status) && WSTOPSIG(status) == SIGSTOP))
		ptrace(PTRACE_SYSCALL, pid, NULL, NULL);
	ptrace(PTRACE_DETACH, pid, NULL, NULL);
	kill(pid, SIGCONT);
	return stops / 2;
}

/* With pauses: a traced process is slow, and would read several frames in one call. */
static void sdo_traffic(int fd)
{
	static const uint8_t read_1000h[8] = {0x40, 0x00, 0x10, 0x00};

	for (int i = 0; i < ROUNDS; i++) {
		put(fd, REQUEST, read_1000h, 8);
		get(fd, RESPONSE);
		usleep(PAUSE_US);
	}
}

static void sync_traffic(int fd)
{
	for (int i = 0; i < ROUNDS; i++) {
		put(fd, SYNC, "", 0);
		get(fd, TPDO1);
		usleep(PAUSE_US);
	}
}

static void foreign_traffic(int fd)
{
	for (int i = 0; i < FOREIGN; i++)
		put(fd, FOREIGN_ID, "foreign", 7);
}

/* A log of one sample per second, so that almost no system calls are those of the sensor. */
static void write_slow_log(const char *path)
{
	FILE *f = fopen(path, "w");

	if (!f)
		fail(path);
	fputs("t [s],gx,gy,gz,ax,ay,az,mx,my,mz\n", f);
	for (int t = 0; t < 600; t++)
		fprintf(f, "%d,0,0,0,0,0,9.81,0,20,-45\n", t);
	fclose(f);
}

static void count_syscalls(int fd, const char *folder)
{
	char log[256], imu[300];

	snprintf(log, sizeof(log), "%s/slow.imu.csv", folder);
	snprintf(imu, sizeof(imu), "replay:%s", log);
	write_slow_log(log);
	pid_t pid = start_gateway(folder, imu, NULL);

	set_up(fd);
	printf("%-28s %.1f per request and answer\n", "system calls, SDO",
		(double)syscalls_during(pid, sdo_traffic) / ROUNDS);
	printf("%-28s %.1f per SYNC and TPDO\n", "system calls, SYNC",
		(double)syscalls_during(pid, sync_traffic) / ROUNDS);
	printf("%-28s %.2f per frame\n", "system calls, foreign frames",
		(double)syscalls_during(pid, foreign_traffic) / FOREIGN);
	stop(pid);
}

int main(void)
{
	char folder[] = "/tmp/bench_bus.XXXXXX", clean[64];
	cpu_set_t first;
	int fd = open_bus();

	CPU_ZERO(&first);
	CPU_SET(0, &first);
	sched_setaffinity(0, sizeof(first), &first);
	if (!mkdtemp(folder))
		fail(folder);
	only(fd, TPDO1, RESPONSE);
	compare(fd, folder);
	compare_with_clients(fd, folder);
	count_syscalls(fd, folder);
	snprintf(clean, sizeof(clean), "rm -rf %s", folder);
	return system(clean) == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}
