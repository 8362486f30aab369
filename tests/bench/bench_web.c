/* tests/bench/bench_web.c
 * What 20 browsers cost five gateways: the SDO round trip and the time from SYNC to TPDO1 of each node, without
 * imu9-web (quiet), with one more program that listens to the bus, and with imu9-web and browsers that show live
 * values.
 *
 *     build/tests/bench/bench_web [-s] [SECONDS [BUS]]
 *
 * Each part takes a second and is between two quiet ones, whose mean it is compared with; SECONDS parts of each kind,
 * default 10. The figures are medians of these ratios, with their quartiles. BUS is udp, or a CAN interface: vcan0.
 *
 * Gateways and master share processor 0 and have real-time priority where permitted, so that other work on the machine
 * disturbs less; imu9-web and the browsers have none, and any processor. On each processor a process of the policy
 * SCHED_IDLE runs while nothing else does, so that it does not sleep: to wake a processor takes as long as the answer,
 * and how long differs from second to second. With -s they sleep.
 *
 * A browser is a WebSocket that does what the page does for its view Live of one node: it reads the lever arm and the
 * list of objects, subscribes to the PDOs at 20 Hz and polls by SDO. All 20 are in one process: what a real one draws
 * would be on another computer. Four of them read 4 kB a second, less than they are sent. */
#include <arpa/inet.h>
#include <errno.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/bench/bus_end.h"

#define GROUP "239.74.163.97"
#define UDP   "udp:" GROUP ":43197,interface=lo"
enum { PORT = 43197, WEB_PORT = 43197, NODES = 5, BROWSERS = 20, SLOW = 4 };
enum { SYNC = 0x080, TPDO1 = 0x180, REQUEST = 0x600, RESPONSE = 0x580, FUNCTION = 0x780 };
/* The samples of a gateway are 10 ms apart: each part has SYNCs at all times between two of them. */
enum { SYNC_US = 9700, PART_US = 1000000, ANSWER_MS = 300, PRIORITY = 10, ROUNDS_MAX = 1 << 20, PARTS_MAX = 1000 };
enum { SETTLE_US = 100000, LISTEN_US = 20000 };
enum { MESSAGE_MAX = 1 << 19, SLOW_BYTES = 4096, READY_ROWS = 50 };

static const char *bus; /* of CAN; NULL: UDP */

/* ---- browsers ---------------------------------------------------------------------------------------------------- */

struct browser {
	int fd;
	bool slow;
	uint8_t message[MESSAGE_MAX];
	size_t size, rows;
	double read_us;
};

static void send_all(int fd, const void *bytes, size_t size)
{
	if (write(fd, bytes, size) != (ssize_t)size)
		fail("write to imu9-web");
}

/* A frame of a client (RFC 6455, 5.2): masked, here by 0. */
static void send_frame(int fd, uint8_t opcode, const void *data, size_t size)
{
	uint8_t frame[512] = {(uint8_t)(0x80 | opcode), 0x80 | 126, (uint8_t)(size >> 8), (uint8_t)size};

	if (opcode != 1) { /* short ones have one byte for their size */
		frame[1] = (uint8_t)(0x80 | size);
		memcpy(frame + 6, data, size);
		send_all(fd, frame, 6 + size);
		return;
	}
	memcpy(frame + 8, data, size);
	send_all(fd, frame, 8 + size);
}

static void request(int fd, int id, const char *members)
{
	char text[300];

	send_frame(fd, 1, text, (size_t)snprintf(text, sizeof(text), "{\"id\":%d,%s}", id, members));
}

static void open_browser(struct browser *browser, int number)
{
	static const char HEAD[] = "GET /ws HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nOrigin: http://127.0.0.1:%d\r\n"
				   "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
				   "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
				   "Sec-WebSocket-Protocol: imu9.v1\r\n\r\n";
	const struct sockaddr_in to = {
		.sin_family = AF_INET, .sin_port = htons(WEB_PORT), .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
	char text[400], members[200], answer[2048];
	int node = number % NODES + 1, small = SLOW_BYTES;
	size_t used = 0;

	browser->fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
	browser->slow = number % (NODES + 1) == 0; /* of another node each */
	if (browser->slow)
		setsockopt(browser->fd, SOL_SOCKET, SO_RCVBUF, &small, sizeof(small));
	if (connect(browser->fd, (const struct sockaddr *)&to, sizeof(to)) < 0)
		fail("imu9-web");
	send_all(browser->fd, text, (size_t)snprintf(text, sizeof(text), HEAD, WEB_PORT, WEB_PORT));
	do { /* to the end of the head, and no further */
		if (read(browser->fd, answer + used, 1) != 1)
			fail("imu9-web refuses a browser");
	} while (++used < 4 || (memcmp(answer + used - 4, "\r\n\r\n", 4) != 0 && used < sizeof(answer)));
	if (memcmp(answer, "HTTP/1.1 101", 12) != 0)
		fail("imu9-web refuses a browser");
	snprintf(members, sizeof(members), "\"op\":\"read\",\"node\":%d,\"objects\":[\"gravity\",\"lever_arm\"]", node);
	request(browser->fd, 1, members);
	snprintf(members, sizeof(members), "\"op\":\"objects\",\"node\":%d", node);
	if (!browser->slow) /* it would not get further in this time */
		request(browser->fd, 2, members);
	snprintf(members, sizeof(members), "\"op\":\"subscribe\",\"node\":%d,\"hz\":20", node);
	request(browser->fd, 3, members);
	snprintf(members, sizeof(members),
		"\"op\":\"poll\",\"node\":%d,\"objects\":[\"position\",\"position_sigma\"],\"hz\":4", node);
	request(browser->fd, 4, members);
}

/* A message has arrived: rows are counted, pings are answered. */
static void take(struct browser *browser, uint8_t opcode, uint8_t *data, size_t size)
{
	static const char PDO[] = "{\"event\":\"pdo\"";

	if (opcode == 8)
		fail("imu9-web sends a browser away");
	if (opcode == 9)
		send_frame(browser->fd, 10, data, size);
	if (opcode != 1 || size < sizeof(PDO) || memcmp(data, PDO, sizeof(PDO) - 1) != 0)
		return;
	for (size_t i = 0; i < size; i++)
		browser->rows += data[i] == '[';
	browser->rows--; /* the list of rows is a list, too */
}

static void read_browser(struct browser *browser)
{
	uint8_t *at = browser->message;
	size_t room = MESSAGE_MAX - browser->size, most = browser->slow && room > SLOW_BYTES ? SLOW_BYTES : room;
	ssize_t got = read(browser->fd, at + browser->size, most);

	if (got <= 0)
		fail("imu9-web");
	browser->size += (size_t)got;
	for (;;) { /* frames of a server are not masked */
		size_t left = browser->size - (size_t)(at - browser->message), head = 2, size = left > 1 ? at[1] : 0;

		if (size == 126 && left >= 4)
			head = 4, size = (size_t)(at[2] << 8 | at[3]);
		else if (size == 127 && left >= 10)
			head = 10, size = (size_t)at[6] << 24 | (size_t)(at[7] << 16 | at[8] << 8 | at[9]);
		else if (size > 125)
			break;
		if (left < 2 || left < head + size)
			break;
		take(browser, at[0] & 0xF, at + head, size);
		at += head + size;
	}
	browser->size -= (size_t)(at - browser->message);
	memmove(browser->message, at, browser->size);
	if (browser->size == MESSAGE_MAX)
		fail("a message is too long");
}

static bool are_ready(const struct browser *browsers)
{
	for (int i = 0; i < BROWSERS; i++)
		if (!browsers[i].slow && browsers[i].rows < READY_ROWS)
			return false;
	return true;
}

/* Writes a byte when all of them are shown live values, and the rows of each a second whenever one is asked for. */
static void browse(int control)
{
	static struct browser browsers[BROWSERS];
	bool ready = false;

	for (int i = 0; i < BROWSERS; i++)
		open_browser(&browsers[i], i);
	for (;;) {
		struct pollfd p[BROWSERS + 1] = {{.fd = control, .events = POLLIN}};

		for (int i = 0; i < BROWSERS; i++)
			p[i + 1] = (struct pollfd){
				.fd = browsers[i].slow && now_us() - browsers[i].read_us < 1e6 ? -1 : browsers[i].fd,
				.events = POLLIN};
		if (poll(p, BROWSERS + 1, 100) < 0)
			fail("poll");
		for (int i = 0; i < BROWSERS; i++)
			if (p[i + 1].revents) {
				browsers[i].read_us = now_us();
				read_browser(&browsers[i]);
			}
		if (!ready && are_ready(browsers)) {
			ready = true;
			send_all(control, "", 1);
		}
		if (p[0].revents)
			break;
	}
	double rows[2] = {0};
	for (int i = 0; i < BROWSERS; i++)
		rows[browsers[i].slow] += (double)browsers[i].rows;
	send_all(control, rows, sizeof(rows));
}

/* ---- processes --------------------------------------------------------------------------------------------------- */

/* Ends with the bench. */
static void run(const char *name, const char *const *arguments, const char *log, int out)
{
	const char *build = getenv("BUILD"), *argv[16] = {name};
	char program[256];

	prctl(PR_SET_PDEATHSIG, SIGTERM);
	snprintf(program, sizeof(program), "%s/%s", build ? build : "build", name);
	if (!freopen(log, "a", stderr) || dup2(out, STDOUT_FILENO) < 0)
		_exit(1);
	for (int i = 0; arguments[i]; i++)
		argv[i + 1] = arguments[i];
	execv(program, (char *const *)argv);
	_exit(1);
}

static pid_t start_gateway(int node, const char *folder)
{
	pid_t pid = fork();
	char id[8], log[64], store[64];

	if (pid != 0)
		return pid;
	snprintf(id, sizeof(id), "%d", node);
	snprintf(log, sizeof(log), "%s/log%d", folder, node);
	snprintf(store, sizeof(store), "%s/%d", folder, node);
	run("imu9-gateway",
		(const char *[]){
			"--can", bus ? bus : UDP, "--node-id", id, "--imu", "sim:rest", "--store", store, NULL},
		log, STDERR_FILENO);
	return -1;
}

/* As any other program: without real-time priority, on any processor. */
static void be_ordinary(void)
{
	cpu_set_t all;

	CPU_ZERO(&all);
	for (unsigned i = 0; i < CPU_SETSIZE; i++)
		CPU_SET(i, &all);
	sched_setaffinity(0, sizeof(all), &all);
	sched_setscheduler(0, SCHED_OTHER, &(struct sched_param){0});
}

/* Returns when browsers can connect: then it prints the address. */
static pid_t start_web(void)
{
	char listen[32], byte;
	int ends[2];
	pid_t pid;

	if (pipe(ends) < 0 || (pid = fork()) < 0)
		fail("imu9-web");
	if (pid == 0) {
		be_ordinary();
		snprintf(listen, sizeof(listen), "127.0.0.1:%d", WEB_PORT);
		run("imu9-web", (const char *[]){"-i", bus ? bus : UDP, "--listen", listen, NULL}, "/dev/null",
			ends[1]);
	}
	close(ends[1]);
	if (read(ends[0], &byte, 1) != 1)
		fail("imu9-web does not start");
	close(ends[0]);
	return pid;
}

static pid_t start_browsers(int *control)
{
	int ends[2];
	pid_t pid;

	if (socketpair(AF_UNIX, SOCK_STREAM, 0, ends) < 0 || (pid = fork()) < 0)
		fail("browsers");
	if (pid == 0) {
		prctl(PR_SET_PDEATHSIG, SIGTERM);
		be_ordinary();
		close(ends[0]);
		browse(ends[1]);
		_exit(0);
	}
	close(ends[1]);
	*control = ends[0];
	return pid;
}

static struct end open_bus(uint32_t id, uint32_t mask)
{
	return bus ? open_can_end(bus, id, mask) : open_end(GROUP, PORT, id, mask);
}

/* A program that listens to the bus and does no more. */
static pid_t start_listener(void)
{
	pid_t pid = fork();

	if (pid < 0)
		fail("listener");
	if (pid > 0) {
		usleep(SETTLE_US);
		return pid;
	}
	prctl(PR_SET_PDEATHSIG, SIGTERM);
	be_ordinary();
	for (const struct end end = open_bus(0, END_RECEIVES_ALL);; usleep(LISTEN_US))
		drain(&end);
}

/* Keeps a processor from sleeping while there is nothing to do. */
static void keep_awake(unsigned int processor)
{
	pid_t pid = fork();

	if (pid < 0)
		fail("processor");
	if (pid > 0)
		return;
	prctl(PR_SET_PDEATHSIG, SIGTERM);
	use_processor(processor);
	sched_setscheduler(0, SCHED_IDLE, &(struct sched_param){0});
	for (;;)
		;
}

static void stop(pid_t pid)
{
	kill(pid, SIGTERM);
	waitpid(pid, NULL, 0);
}

/* ---- measurements ------------------------------------------------------------------------------------------------ */

/* Of one kind of parts: all values, and the medians of each part. */
struct latencies {
	size_t parts, of_part;
	double median_us[2 * PARTS_MAX + 1];
	double us[ROUNDS_MAX];
	size_t count, unanswered;
};

struct figures {
	struct latencies pdo, sdo;
};

struct ends {
	struct end pdo, sdo;
};

static void add(struct latencies *l, double us)
{
	if (l->count < ROUNDS_MAX)
		l->us[l->count++] = us;
}

static void measure_sync(const struct ends *ends, struct figures *f)
{
	double start = now_us();
	struct can_msg pdo;

	drain(&ends->pdo);
	put(&ends->pdo, SYNC, "", 0);
	for (int i = 0; i < NODES; i++) {
		if (get(&ends->pdo, &pdo, ANSWER_MS))
			add(&f->pdo, now_us() - start);
		else
			f->pdo.unanswered++;
	}
}

/* Reads 1000h; what is not the answer to that is one to imu9-web. */
static void measure_sdo(const struct ends *ends, struct figures *f, int node)
{
	static const uint8_t READ[8] = {0x40, 0x00, 0x10};
	struct can_msg answer = {0};
	double start = now_us();

	drain(&ends->sdo);
	put(&ends->sdo, REQUEST + (uint32_t)node, READ, 8);
	do
		if (!get(&ends->sdo, &answer, ANSWER_MS)) {
			f->sdo.unanswered++;
			return;
		}
	while (answer.id != RESPONSE + (uint32_t)node || memcmp(answer.data + 1, READ + 1, 3) != 0);
	add(&f->sdo, now_us() - start);
}

static void wait_until(double us)
{
	double left = us - now_us();

	if (left > 0)
		usleep((useconds_t)left);
}

/* SYNCs for PART_US, or until `control` can be read. */
static void measure(const struct ends *ends, struct figures *f, int control)
{
	double begin = now_us();
	struct pollfd ready = {.fd = control, .events = POLLIN};

	for (int i = 0; control < 0 ? now_us() < begin + PART_US : poll(&ready, 1, 0) == 0; i++) {
		measure_sync(ends, f);
		wait_until(begin + (i + 0.5) * SYNC_US);
		measure_sdo(ends, f, i % NODES + 1);
		wait_until(begin + (i + 1) * SYNC_US);
	}
}

static void end_part(struct latencies *l)
{
	static double us[ROUNDS_MAX];
	size_t count = l->count - l->of_part;

	memcpy(us, l->us + l->of_part, count * sizeof(*us));
	l->median_us[l->parts++] = quantile(us, count, 0.5);
	l->of_part = l->count;
}

static void measure_part(const struct ends *ends, struct figures *f)
{
	measure(ends, f, -1);
	end_part(&f->sdo);
	end_part(&f->pdo);
}

static void measure_listener(const struct ends *ends, struct figures *f)
{
	pid_t listener = start_listener();

	measure_part(ends, f);
	stop(listener);
}

static void measure_loaded(const struct ends *ends, struct figures *f, double rows[2])
{
	static struct figures meanwhile;
	pid_t web = start_web(), browsers;
	int control;
	double received[2] = {0};
	char byte;

	browsers = start_browsers(&control);
	memset(&meanwhile, 0, sizeof(meanwhile));
	measure(ends, &meanwhile, control); /* until all of them are shown values */
	if (read(control, &byte, 1) != 1)
		fail("the browsers have ended");
	measure_part(ends, f);
	send_all(control, "", 1);
	if (read(control, received, sizeof(received)) != sizeof(received))
		fail("the browsers have ended");
	for (int i = 0; i < 2; i++)
		rows[i] += received[i];
	close(control);
	waitpid(browsers, NULL, 0);
	stop(web);
}

/* `place` of a part in its round: 0 is after the first quiet one, 1 after the second. */
static void print_ratio(const char *with, const struct latencies *l, const struct latencies *quiet, size_t place)
{
	double ratio[PARTS_MAX];

	for (size_t i = 0; i < l->parts; i++)
		ratio[i] =
			2 * l->median_us[i] / (quiet->median_us[2 * i + place] + quiet->median_us[2 * i + place + 1]);
	printf("  %-14s %.2f times the quiet (%.2f to %.2f)", with, quantile(ratio, l->parts, 0.5),
		quantile(ratio, l->parts, 0.25), quantile(ratio, l->parts, 0.75));
}

static void print_all(struct latencies *l)
{
	printf("  %.0f us, 99 %%: %.0f; %zu measured, %zu unanswered\n", quantile(l->us, l->count, 0.5),
		quantile(l->us, l->count, 0.99), l->count, l->unanswered);
}

static void print(const char *what, struct latencies *quiet, struct latencies *listener, struct latencies *loaded)
{
	printf("%s\n  quiet%35s", what, "");
	print_all(quiet);
	print_ratio("a listener", listener, quiet, 0);
	print_all(listener);
	print_ratio("20 browsers", loaded, quiet, 1);
	print_all(loaded);
}

static void parse(int argc, char **argv, int *rounds, bool *sleeps)
{
	int option;

	while ((option = getopt(argc, argv, "s")) == 's')
		*sleeps = true;
	*rounds = optind < argc ? atoi(argv[optind]) : 10;
	if (option != -1 || *rounds < 1 || *rounds > PARTS_MAX || argc - optind > 2) {
		fprintf(stderr, "usage: bench_web [-s] [SECONDS [udp|INTERFACE]]\n");
		exit(2);
	}
	if (argc - optind == 2 && strcmp(argv[optind + 1], "udp") != 0)
		bus = argv[optind + 1];
}

int main(int argc, char **argv)
{
	static struct figures quiet, listener, loaded;
	char folder[] = "/tmp/bench_web.XXXXXX", clean[64];
	int rounds;
	bool sleeps = false;
	double rows[2] = {0};
	pid_t gateways[NODES];

	parse(argc, argv, &rounds, &sleeps);
	signal(SIGPIPE, SIG_IGN);
	for (long i = 0; !sleeps && i < sysconf(_SC_NPROCESSORS_ONLN); i++)
		keep_awake((unsigned int)i);
	use_processor(0);
	(void)sched_setscheduler(0, SCHED_FIFO, &(struct sched_param){.sched_priority = PRIORITY});
	if (!mkdtemp(folder))
		fail(folder);
	const struct ends ends = {open_bus(TPDO1, FUNCTION), open_bus(RESPONSE, FUNCTION)};
	for (int i = 0; i < NODES; i++)
		gateways[i] = start_gateway(i + 1, folder);
	usleep(1500000);
	put(&ends.pdo, 0x000, (const uint8_t[]){1, 0}, 2); /* NMT: start all */
	usleep(100000);
	measure_part(&ends, &quiet);
	for (int round = 0; round < rounds; round++) {
		measure_listener(&ends, &listener);
		measure_part(&ends, &quiet);
		measure_loaded(&ends, &loaded, rows);
		measure_part(&ends, &quiet);
	}
	print("SDO", &quiet.sdo, &listener.sdo, &loaded.sdo);
	print("SYNC to TPDO1", &quiet.pdo, &listener.pdo, &loaded.pdo);
	printf("rows received: %.0f by %d browsers, %.0f by %d slow ones\n", rows[0], BROWSERS - SLOW, rows[1], SLOW);
	for (int i = 0; i < NODES; i++)
		stop(gateways[i]);
	snprintf(clean, sizeof(clean), "rm -rf %s", folder);
	return system(clean) == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}
