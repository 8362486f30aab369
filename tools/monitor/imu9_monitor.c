/* imu9-monitor: displays the frames of a CANopen node: PDO values with units, rates, NMT state, emergencies. */
#include <errno.h>
#include <getopt.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <unistd.h>

#include "gateway/canopen/canopen.h"
#include "gateway/canopen/cia301.h"
#include "od_values.h"
#include "tools/lib/cli.h"
#include "tools/monitor/output.h"
#include "tools/monitor/screen.h"
#include "tools/monitor/terminal.h"
#include "tools/lib/watch.h"

enum {
	TEXT_MAX = 256,
	GRACE_US = 1000000,
	EVENTS_US = 5000000,
	ONCE_COLUMNS = 100,
	NMT_COMMAND_START = 1, /* CiA 301, 7.2.8.3.1 */
	NMT_COMMAND_PRE_OPERATIONAL = 128,
	COMMAND_TARE = 1 << 2,	    /* bit of 2073h */
	SIGNATURE_SAVE = 0x65766173 /* "save" */
};
static const double ONCE_SECONDS = 3, SCREEN_HZ = 5, LINE_HZ = 2;

static const char help[] =
	"Usage: imu9-monitor [-i BUS] [-n NODE] [--start] [--sync HZ] [--once|--line|--csv|--json] [-t SECS]\n"
	"Displays live what a CANopen node sends: values with units and sigmas, rates, NMT state, emergencies.\n"
	"It reads the PDO mapping from the node by SDO, and for the screen sigmas and bus load. Use\n"
	"--passive while another SDO client accesses the same node.\n"
	"\n"
	"  -i, --can BUS      the CAN bus, see below (default: $IMU9_CAN or vcan0)\n"
	"  -n, --node-id NODE node-ID 1 to 127 (default: $IMU9_NODE or 1)\n"
	"  -s, --start        send NMT start to the node first, and after each boot-up\n"
	"  -S, --sync HZ      send SYNC HZ times a second. PDOs are synchronous by default: they\n"
	"                     are sent only if this option or a master on the bus produces SYNC\n"
	"  -p, --passive      send no SDO; use the default PDO mapping of the EDS\n"
	"  -o, --once         print the values once, then end\n"
	"  -l, --line         print one line of key=value columns for each update (default if\n"
	"                     standard output is not a terminal)\n"
	"  -c, --csv          likewise as CSV, with units in its header\n"
	"  -j, --json         likewise as JSON\n"
	"  -r, --rate HZ      updates a second (default: 5 in a terminal, 2 lines otherwise)\n"
	"  -t, --time SECS    end after this time; the screen and --line then print a table\n"
	"  -h, --help         this text\n"
	"  -V, --version      the version\n"
	"\n"
	"Keys: q end, space and b pages, s NMT start, x pre-operational, t tare, z zero the position,\n"
	"S store, e event log, ? this list.\n"
	"\n"
	"The counter in a PDO identifies its sample. \"Skipped\" counts samples that were in no PDO,\n"
	"\"repeated\" counts PDOs with the same sample as the one before. Both are normal if SYNC and\n"
	"sensor have different clocks.\n"
	"\n" CLI_EXIT_STATUS "No PDO received is a failure with -t and --once.\n"
	"\nExample: imu9-monitor -n 5 --start --sync 100\n";

struct monitor {
	const char *bus_name;
	long node_id;
	bool start, passive, once;
	enum output output;
	double sync_hz, update_hz, seconds; /* 0: off, default rate, no limit */

	struct can_port *bus;
	struct watch watch;
	struct od_values values; /* memory for `watch` */
	uint64_t begin_us, end_us, next_update_us, next_sync_us;
	unsigned int started;	/* watch.configured when NMT start was sent */
	unsigned int announced; /* watch.configured when the units were printed */
	uint8_t sync_counter;
	char hint[TEXT_MAX]; /* the last one printed in line mode */

	struct history history; /* the screen */
	struct screen_cells cells;
	unsigned int page;
	bool help, events, unicode;
	uint64_t events_us; /* when the event log is read next */
};

/* ---- hints: why there are no values, and what to do ---- */

static bool any_enabled(const struct watch *watch, bool synchronous_only)
{
	for (size_t i = 0; i < watch->pdo_count; i++)
		if (watch->pdos[i].enabled && (!synchronous_only || watch->pdos[i].type <= 240))
			return true;
	return false;
}

/* Why there are no values; "" if there are values. */
static void find_hint(const struct monitor *m, char *text, size_t capacity)
{
	const struct watch *w = &m->watch;
	long n = m->node_id;

	if (watch_has_values(w))
		text[0] = '\0';
	else if (m->bus->state == CAN_STATE_DOWN && strchr(m->bus->name, ':'))
		snprintf(text, capacity, "%s is down: is the adapter plugged in?", m->bus_name);
	else if (m->bus->state == CAN_STATE_DOWN)
		snprintf(text, capacity, "%s is down: ip link set %s up", m->bus_name, m->bus_name);
	else if (w->heard_us == 0)
		snprintf(text, capacity,
			"nothing heard of node %ld on %s: is the gateway running with --node-id %ld "
			"--can %s?",
			n, m->bus_name, n, m->bus_name);
	else if (w->mapping == WATCH_READING)
		snprintf(text, capacity, "reading the PDO mapping of node %ld", n);
	else if (!any_enabled(w, false))
		snprintf(text, capacity,
			"no PDO yet: all are switched off in the node: imu9-sdo -n %ld restore "
			"communication, then nmt reset-comm",
			n);
	else if (w->nmt_state == NMT_PRE_OPERATIONAL || w->nmt_state == NMT_STOPPED)
		snprintf(text, capacity, "no PDO yet: the node is %s: imu9-sdo -n %ld nmt start, or --start here",
			watch_nmt_text(w->nmt_state), n);
	else if (w->nmt_state == WATCH_NMT_UNKNOWN)
		snprintf(text, capacity,
			"no PDO yet: is the node operational? imu9-sdo -n %ld nmt start, or --start here; "
			"synchronous PDOs need a SYNC: --sync 100",
			n);
	else if (w->sync.count == 0 && any_enabled(w, true))
		snprintf(text, capacity,
			"no PDO yet: synchronous PDOs need a SYNC and none is on the bus: produce it by "
			"a master, or --sync 100 here");
	else
		snprintf(text, capacity, "no PDO yet that fits its mapping: imu9-sdo -n %ld dump shows 1800h to 1A03h",
			n);
}

static double seconds_since(uint64_t then_us, uint64_t now_us)
{
	return (double)(now_us - then_us) * 1e-6;
}

/* ---- the screen ---- */

static void draw(struct monitor *m, uint64_t now_us)
{
	char hint[TEXT_MAX];
	struct screen screen = {
		.watch = &m->watch,
		.history = m->once ? NULL : &m->history,
		.bus_name = m->bus_name,
		.node_id = m->node_id,
		.hint = hint,
		.now_us = now_us,
		.page = m->page,
		.keys = !m->once,
		.help = m->help,
		.events = m->events,
		.ascii = !m->unicode,
	};

	find_hint(m, hint, sizeof(hint));
	screen_draw(&screen, &m->cells);
}

static void show_screen(struct monitor *m, uint64_t now_us)
{
	if (m->watch.mapping != WATCH_READING)
		history_add(&m->history, &m->watch);
	terminal_size(&m->cells);
	draw(m, now_us);
	terminal_show(&m->cells);
}

/* --once: the same as text, without end. */
static void print_screen(struct monitor *m, uint64_t now_us)
{
	char text[4 * SCREEN_COLUMNS];
	int last = 0;

	m->cells.rows = SCREEN_ROWS;
	m->cells.columns = ONCE_COLUMNS;
	draw(m, now_us);
	for (int row = 0; row < m->cells.rows; row++) {
		screen_row_text(&m->cells, row, text, sizeof(text));
		last = text[0] ? row : last;
	}
	for (int row = 0; row <= last; row++) {
		screen_row_text(&m->cells, row, text, sizeof(text));
		puts(text);
	}
}

/* ---- lines ---- */

static void show_line(struct monitor *m, uint64_t now_us)
{
	const struct watch *w = &m->watch;
	char hint[TEXT_MAX];

	find_hint(m, hint, sizeof(hint));
	if (w->mapping != WATCH_READING && w->heard_us) {
		if (m->announced != w->configured)
			output_header(m->output, w);
		m->announced = w->configured;
		output_values(m->output, w, m->node_id, seconds_since(m->begin_us, now_us), now_us);
	}
	if (hint[0] && now_us >= m->begin_us + GRACE_US && strcmp(hint, m->hint) != 0) {
		cli_error("%s", hint);
		strcpy(m->hint, hint);
	}
}

/* ---- NMT master and SYNC producer ---- */

static void send_nmt(struct monitor *m, uint8_t command, uint64_t now_us)
{
	struct can_msg msg = {.len = 2, .data = {command, (uint8_t)m->node_id}};

	can_send(m->bus, &msg, now_us);
}

static void send_sync(struct monitor *m, uint64_t now_us)
{
	uint64_t period_us = (uint64_t)(1e6 / m->sync_hz);
	uint32_t counter_overflow = watch_object(&m->watch, OD_INDEX_SYNCHRONOUS_COUNTER_OVERFLOW_VALUE, 0);
	struct can_msg msg = {.id = watch_object(&m->watch, OD_INDEX_COB_ID_SYNC, 0) & COB_ID_MASK};

	if (counter_overflow >= 2) {
		m->sync_counter = (uint8_t)(m->sync_counter % counter_overflow + 1);
		msg.data[0] = m->sync_counter;
		msg.len = 1;
	}
	if (can_send(m->bus, &msg, now_us) == 0)
		watch_sync_sent(&m->watch, now_us);
	m->next_sync_us += period_us;
	if (m->next_sync_us < now_us) /* after a delay: no burst to catch up */
		m->next_sync_us = now_us + period_us;
}

/* ---- the loop ---- */

static bool all_received(const struct watch *watch)
{
	for (size_t i = 0; i < watch->pdo_count; i++)
		if (watch->pdos[i].enabled && watch->pdos[i].rate.count == 0)
			return false;
	return any_enabled(watch, false);
}

static void update(struct monitor *m, uint64_t now_us)
{
	if (m->once)
		return;
	if (m->events && now_us >= m->events_us) {
		watch_read_events(&m->watch);
		m->events_us = now_us + EVENTS_US;
	}
	if (m->output == OUTPUT_SCREEN)
		show_screen(m, now_us);
	else
		show_line(m, now_us);
	m->next_update_us = now_us + (uint64_t)(1e6 / m->update_hz);
}

static uint64_t earliest(uint64_t a, uint64_t b)
{
	return a < b ? a : b;
}

/* Does everything that is due. Returns when it must be called again. */
static uint64_t serve(struct monitor *m, uint64_t now_us)
{
	uint64_t next_us = earliest(watch_tick(&m->watch, now_us), m->end_us);
	bool ready = m->watch.mapping != WATCH_READING;

	if (ready && m->start && m->started != m->watch.configured) {
		send_nmt(m, NMT_COMMAND_START, now_us);
		m->started = m->watch.configured;
	}
	if (ready && m->sync_hz > 0) {
		if (now_us >= m->next_sync_us)
			send_sync(m, now_us);
		next_us = earliest(next_us, m->next_sync_us);
	}
	if (now_us >= m->next_update_us)
		update(m, now_us);
	return earliest(next_us, m->next_update_us);
}

/* False: end. */
static bool on_key(struct monitor *m, int key, uint64_t now_us)
{
	switch (key) {
	case 'q':
		return false;
	case '?':
		m->help = !m->help;
		break;
	case ' ':
		m->page++;
		break;
	case 'b':
		m->page += m->page > 0 ? -1u : m->cells.pages - 1;
		break;
	case 's':
		send_nmt(m, NMT_COMMAND_START, now_us);
		break;
	case 'x':
		send_nmt(m, NMT_COMMAND_PRE_OPERATIONAL, now_us);
		break;
	case 't': /* the bit acts when it changes to 1 */
		watch_command(&m->watch, "tare", OD_INDEX_COMMANDS, 0, 0, 2);
		watch_command(&m->watch, "tare", OD_INDEX_COMMANDS, 0, COMMAND_TARE, 2);
		break;
	case 'z':
		watch_command(&m->watch, "zero", OD_INDEX_POSITION, OD_SUB_POSITION_RESET, 1, 1);
		break;
	case 'S':
		watch_command(&m->watch, "store", OD_INDEX_STORE_PARAMETERS, 1, SIGNATURE_SAVE, 4);
		break;
	case 'e':
		m->events = !m->events;
		m->events_us = 0;
		break;
	default:
		return true;
	}
	m->next_update_us = now_us;
	return true;
}

static bool read_keys(struct monitor *m, uint64_t now_us)
{
	int key;

	while ((key = terminal_key()))
		if (!on_key(m, key, now_us))
			return false;
	return true;
}

/* Readable when a signal arrives, or a key. */
static int signal_or_key(int signal_fd)
{
	struct epoll_event event = {.events = EPOLLIN};
	int fd = epoll_create1(EPOLL_CLOEXEC);

	if (fd < 0 || epoll_ctl(fd, EPOLL_CTL_ADD, signal_fd, &event) < 0)
		return signal_fd;
	event.data.fd = STDIN_FILENO;
	epoll_ctl(fd, EPOLL_CTL_ADD, STDIN_FILENO, &event); /* a file has no keys */
	return fd;
}

static bool is_signal(int fd, int signal_fd)
{
	struct pollfd signal = {.fd = signal_fd, .events = POLLIN};

	return fd == signal_fd || poll(&signal, 1, 0) > 0;
}

/* Runs until the time is over, all values are received (--once), or a signal arrives or q is pressed (true). */
static bool run(struct monitor *m, int signal_fd)
{
	int wake_fd = m->output == OUTPUT_SCREEN && !m->once ? signal_or_key(signal_fd) : signal_fd;
	struct can_msg msg;

	for (;;) {
		uint64_t next_us = serve(m, cli_now_us());

		bool woken = cli_wait(m->bus, wake_fd, next_us);
		uint64_t now_us = cli_now_us();
		if (woken && (is_signal(wake_fd, signal_fd) || !read_keys(m, now_us)))
			return true;
		while (can_receive(m->bus, &msg, now_us) > 0)
			watch_receive(&m->watch, &msg, now_us);
		if (now_us >= m->end_us || (m->once && all_received(&m->watch)) || ferror(stdout))
			return false;
	}
}

static void parse_options(struct monitor *m, int argc, char **argv)
{
	static const struct option options[] = {
		CLI_BUS_OPTIONS,
		{"start", no_argument, NULL, 's'},
		{"sync", required_argument, NULL, 'S'},
		{"passive", no_argument, NULL, 'p'},
		{"once", no_argument, NULL, 'o'},
		{"line", no_argument, NULL, 'l'},
		{"csv", no_argument, NULL, 'c'},
		{"json", no_argument, NULL, 'j'},
		{"rate", required_argument, NULL, 'r'},
		{"time", required_argument, NULL, 't'},
		CLI_COMMON_OPTIONS,
	};
	int option;

	opterr = 0;
	while ((option = getopt_long(argc, argv, ":i:n:sS:polcjr:t:hV", options, NULL)) != -1) {
		switch (option) {
		case 'i':
			m->bus_name = optarg;
			break;
		case 'n':
			m->node_id = cli_integer_option("-n", optarg, 1, 127);
			break;
		case 's':
			m->start = true;
			break;
		case 'S':
			m->sync_hz = cli_real_option("--sync", optarg, 0.01, 2000);
			break;
		case 'p':
			m->passive = true;
			break;
		case 'o':
			m->once = true;
			break;
		case 'l':
		case 'c':
		case 'j':
			if (m->output != OUTPUT_SCREEN)
				cli_usage_error("give one of --line, --csv and --json");
			m->output = option == 'l' ? OUTPUT_LINE : option == 'c' ? OUTPUT_CSV : OUTPUT_JSON;
			break;
		case 'r':
			m->update_hz = cli_real_option("--rate", optarg, 0.01, 1000);
			break;
		case 't':
			m->seconds = cli_real_option("-t", optarg, 0.01, 1e9);
			break;
		case 'h':
			cli_print_help(help);
			exit(CLI_OK);
		case 'V':
			puts("imu9-monitor " IMU9_VERSION);
			exit(CLI_OK);
		default:
			cli_bad_option(option, argv);
		}
	}
	if (optind < argc)
		cli_usage_error("%s: unexpected argument", argv[optind]);
	if (m->once && m->output != OUTPUT_SCREEN)
		cli_usage_error("--once excludes --line, --csv and --json");
}

int main(int argc, char **argv)
{
	static struct monitor m;
	char hint[TEXT_MAX];

	m.bus_name = cli_default_bus();
	parse_options(&m, argc, argv);
	if (m.node_id == 0)
		m.node_id = cli_default_node();
	if (m.output == OUTPUT_SCREEN && !m.once && (!isatty(STDOUT_FILENO) || !isatty(STDIN_FILENO)))
		m.output = OUTPUT_LINE;
	m.unicode = terminal_has_unicode();
	if (m.update_hz == 0)
		m.update_hz = m.output == OUTPUT_SCREEN ? SCREEN_HZ : LINE_HZ;
	if (m.once && m.seconds == 0)
		m.seconds = ONCE_SECONDS;

	int signal_fd = cli_signal_fd();
	m.bus = cli_open_bus(m.bus_name);
	m.begin_us = m.next_sync_us = cli_now_us();
	m.next_update_us = m.once ? UINT64_MAX : m.begin_us;
	m.end_us = m.seconds > 0 ? m.begin_us + (uint64_t)(m.seconds * 1e6) : UINT64_MAX;
	watch_init(&m.watch, &imu9_od_table, &m.values, m.bus, (uint8_t)m.node_id, m.passive, m.begin_us);
	bool screen = m.output == OUTPUT_SCREEN && !m.once;
	if (screen && !terminal_open()) {
		cli_error("ncurses does not know the terminal '%s': set TERM, or use --line", getenv("TERM"));
		return CLI_FAILED;
	}
	if (screen)
		watch_poll(&m.watch, m.begin_us);
	bool interrupted = run(&m, signal_fd);
	if (screen)
		terminal_close();

	bool received = watch_has_values(&m.watch);
	if (m.once)
		print_screen(&m, cli_now_us());
	else if (received && (m.output == OUTPUT_SCREEN || m.output == OUTPUT_LINE))
		output_summary(&m.watch, cli_now_us());
	find_hint(&m, hint, sizeof(hint));
	if (hint[0] && !m.once && strcmp(hint, m.hint) != 0)
		cli_error("%s", hint);
	can_close(m.bus);
	if (fflush(stdout) != 0 || ferror(stdout)) {
		cli_error("standard output: %s", strerror(errno));
		return CLI_FAILED;
	}
	return received || interrupted ? CLI_OK : CLI_FAILED;
}
