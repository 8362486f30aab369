/* imu9-monitor: displays the frames of a CANopen node: PDO values with units, rates, NMT state, emergencies. */
#include <errno.h>
#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "gateway/canopen/canopen.h"
#include "gateway/canopen/cia301.h"
#include "od_values.h"
#include "tools/lib/cli.h"
#include "tools/monitor/watch.h"

enum { TEXT_MAX = 256, GRACE_US = 1000000 };
static const double ONCE_SECONDS = 3, SCREEN_HZ = 5, LINE_HZ = 2;

static const char help[] =
	"Usage: imu9-monitor [-i BUS] [-n NODE] [--start] [--sync HZ] [--once|--line] [-t SECS]\n"
	"Displays live what a CANopen node sends: values with units, rates, NMT state, emergencies.\n"
	"It reads the PDO mapping from the node by SDO. Use --passive while another SDO client\n"
	"accesses the same node.\n"
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
	"  -r, --rate HZ      updates a second (default: 5 in a terminal, 2 lines otherwise)\n"
	"  -t, --time SECS    end after this time and print a table of what was received\n"
	"  -h, --help         this text\n"
	"  -V, --version      the version\n"
	"\n"
	"The counter in a PDO identifies its sample. \"Skipped\" counts samples that were in no PDO,\n"
	"\"repeated\" counts PDOs with the same sample as the one before. Both are normal if SYNC and\n"
	"sensor have different clocks.\n"
	"\n" CLI_EXIT_STATUS "No PDO received is a failure with -t and --once.\n"
	"\nExample: imu9-monitor -n 5 --start --sync 100\n";

struct monitor {
	const char *bus_name;
	long node_id;
	bool start, passive, once, line, screen;
	double sync_hz, update_hz, seconds; /* 0: off, default rate, no limit */

	struct can_port *bus;
	struct watch watch;
	struct od_values values; /* memory for `watch` */
	uint64_t begin_us, end_us, next_update_us, next_sync_us;
	unsigned int started;	/* watch.configured when NMT start was sent */
	unsigned int announced; /* watch.configured when the units were printed */
	uint8_t sync_counter;
	char hint[TEXT_MAX]; /* the last one printed in line mode */
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

/* ---- values as text ---- */

static void field_name(const struct watch_field *field, char *text, size_t capacity)
{
	if (field->entry)
		snprintf(text, capacity, "%s", field->entry->name);
	else
		snprintf(text, capacity, "%04Xh:%02X", field->mapping >> 16, field->mapping >> 8 & 0xFF);
}

static const char *field_unit(const struct watch_field *field)
{
	return field->entry ? field->entry->unit : "";
}

static double seconds_since(uint64_t then_us, uint64_t now_us)
{
	return (double)(now_us - then_us) * 1e-6;
}

/* ---- the screen: all values, refreshed in place ---- */

static void screen_enter(void)
{
	fputs("\033[?1049h\033[?25l\033[?7l", stdout); /* alternate screen, no cursor, no line wrap */
}

static void screen_leave(void)
{
	fputs("\033[?7h\033[?25h\033[?1049l", stdout);
	fflush(stdout);
}

static void end_line(const struct monitor *m)
{
	fputs(m->screen ? "\033[K\n" : "\n", stdout);
}

static void show_node(const struct monitor *m, uint64_t now_us)
{
	static const char *const mappings[] = {
		[WATCH_READING] = "being read from the node",
		[WATCH_READ] = "read from the node",
		[WATCH_DEFAULTS] = "default of the EDS",
	};
	const struct watch *w = &m->watch;

	printf("node %ld on %s: %s", m->node_id, m->bus_name, watch_nmt_text(watch_nmt_state(w, now_us)));
	if (w->heartbeat.count)
		printf(", heartbeat %.1f s ago", seconds_since(w->heartbeat.last_us, now_us));
	if (w->boot_ups)
		printf(", %llu boot-ups", (unsigned long long)w->boot_ups);
	end_line(m);
	printf("SYNC %.1f Hz; PDO mapping: %s", watch_rate_hz(&w->sync, now_us), mappings[w->mapping]);
	end_line(m);
	if (w->emcy.count)
		printf("EMCY %04Xh: %s, error register %02Xh, %.1f s ago (%llu in all)", w->emcy_code,
			emcy_code_text(w->emcy_code), w->emcy_register, seconds_since(w->emcy.last_us, now_us),
			(unsigned long long)w->emcy.count);
	else
		fputs("EMCY none", stdout);
	end_line(m);
}

/* Consecutive members of a record are in one line: "acceleration  l 0.615  s 0.005 m/s^2". */
static void show_fields(const struct monitor *m, const struct watch_pdo *pdo)
{
	char name[TEXT_MAX], record[TEXT_MAX] = "", value[TEXT_MAX];
	const char *unit = NULL;

	for (size_t i = 0; i < pdo->field_count; i++) {
		const struct watch_field *field = &pdo->fields[i];

		field_name(field, name, sizeof(name));
		watch_field_text(field, value, sizeof(value));
		char *dot = strchr(name, '.');
		if (dot)
			*dot = '\0';
		if (!unit || strcmp(record, name) != 0 || strcmp(unit, field_unit(field)) != 0) {
			if (unit) {
				printf(" %s", unit);
				end_line(m);
			}
			printf("  %-16s", name);
			strcpy(record, name);
			unit = field_unit(field);
		}
		printf("  %s %10s", dot ? dot + 1 : "", value);
	}
	printf(" %s", unit ? unit : "");
	end_line(m);
}

static void show_pdos(const struct monitor *m, uint64_t now_us)
{
	for (size_t i = 0; i < m->watch.pdo_count; i++) {
		const struct watch_pdo *pdo = &m->watch.pdos[i];

		if (!pdo->enabled)
			continue;
		end_line(m);
		printf("TPDO%zu  %03Xh  %.1f Hz  %llu received", i + 1, pdo->id, watch_rate_hz(&pdo->rate, now_us),
			(unsigned long long)pdo->rate.count);
		if (pdo->counted)
			printf(", %llu samples skipped, %llu repeated", (unsigned long long)pdo->skipped,
				(unsigned long long)pdo->repeated);
		if (pdo->rate.count && seconds_since(pdo->rate.last_us, now_us) > 1)
			printf(", the last %.1f s ago", seconds_since(pdo->rate.last_us, now_us));
		if (pdo->misfits)
			printf(", %llu of wrong length", (unsigned long long)pdo->misfits);
		end_line(m);
		if (pdo->rate.count)
			show_fields(m, pdo);
	}
}

static void show_all(const struct monitor *m, uint64_t now_us)
{
	char hint[TEXT_MAX];

	if (m->screen)
		fputs("\033[H", stdout);
	show_node(m, now_us);
	find_hint(m, hint, sizeof(hint));
	if (hint[0]) {
		end_line(m);
		fputs(hint, stdout);
		end_line(m);
	}
	show_pdos(m, now_us);
	if (m->screen) {
		end_line(m);
		fputs("Ctrl-C ends\033[K\033[J", stdout);
	}
	fflush(stdout);
}

/* ---- one line of key=value columns ---- */

/* An object that is in several PDOs (the sample counter) has one column. */
static bool shown_before(const struct watch *watch, size_t pdo, size_t field)
{
	uint32_t mapping = watch->pdos[pdo].fields[field].mapping;

	for (size_t i = 0; i <= pdo; i++)
		for (size_t k = 0; k < (i < pdo ? watch->pdos[i].field_count : field); k++)
			if (watch->pdos[i].enabled && watch->pdos[i].fields[k].mapping == mapping)
				return true;
	return false;
}

static void print_units(const struct watch *watch)
{
	char name[TEXT_MAX];

	fputs("# units:", stdout);
	for (size_t i = 0; i < watch->pdo_count; i++)
		for (size_t k = 0; k < watch->pdos[i].field_count; k++) {
			const struct watch_field *field = &watch->pdos[i].fields[k];

			if (!watch->pdos[i].enabled || !field_unit(field)[0])
				continue;
			field_name(field, name, sizeof(name));
			printf(" %s[%s]", name, field_unit(field));
		}
	putchar('\n');
}

static void print_columns(const struct monitor *m, uint64_t now_us)
{
	const struct watch *w = &m->watch;
	uint64_t skipped = 0;
	char name[TEXT_MAX], value[TEXT_MAX];

	printf("t=%.2f nmt=%s sync_hz=%.1f", seconds_since(m->begin_us, now_us),
		watch_nmt_text(watch_nmt_state(w, now_us)), watch_rate_hz(&w->sync, now_us));
	for (size_t i = 0; i < w->pdo_count; i++) {
		const struct watch_pdo *pdo = &w->pdos[i];

		if (!pdo->enabled)
			continue;
		printf(" tpdo%zu_hz=%.1f", i + 1, watch_rate_hz(&pdo->rate, now_us));
		if (pdo->skipped > skipped)
			skipped = pdo->skipped;
		for (size_t k = 0; k < pdo->field_count; k++) {
			if (shown_before(w, i, k))
				continue;
			field_name(&pdo->fields[k], name, sizeof(name));
			watch_field_text(&pdo->fields[k], value, sizeof(value));
			printf(" %s=%s", name, pdo->rate.count ? value : "-");
		}
	}
	printf(" skipped=%llu emcy=%04X\n", (unsigned long long)skipped, w->emcy_code);
}

static void show_line(struct monitor *m, uint64_t now_us)
{
	char hint[TEXT_MAX];

	find_hint(m, hint, sizeof(hint));
	if (!hint[0]) {
		if (m->announced != m->watch.configured)
			print_units(&m->watch);
		m->announced = m->watch.configured;
		print_columns(m, now_us);
		fflush(stdout);
	} else if (now_us >= m->begin_us + GRACE_US && strcmp(hint, m->hint) != 0) {
		cli_error("%s", hint);
		strcpy(m->hint, hint);
	}
}

/* ---- the table at the end ---- */

static void show_summary(const struct monitor *m, uint64_t now_us)
{
	const struct watch *w = &m->watch;
	char name[TEXT_MAX], value[TEXT_MAX];

	printf("\n%-6s %7s %9s %10s %9s %9s\n", "PDO", "CAN-ID", "received", "rate [Hz]", "skipped", "repeated");
	for (size_t i = 0; i < w->pdo_count; i++) {
		const struct watch_pdo *pdo = &w->pdos[i];
		double span_s = seconds_since(pdo->rate.first_us, pdo->rate.last_us);

		if (!pdo->enabled)
			continue;
		printf("TPDO%zu %7Xh %9llu %10.1f %9llu %9llu\n", i + 1, pdo->id, (unsigned long long)pdo->rate.count,
			span_s > 0 ? (double)(pdo->rate.count - 1) / span_s : 0, (unsigned long long)pdo->skipped,
			(unsigned long long)pdo->repeated);
		for (size_t k = 0; k < pdo->field_count && pdo->rate.count; k++) {
			field_name(&pdo->fields[k], name, sizeof(name));
			watch_field_text(&pdo->fields[k], value, sizeof(value));
			printf("       %-28s %14s %s\n", name, value, field_unit(&pdo->fields[k]));
		}
	}
	printf("NMT state %s; %llu heartbeats, %llu SYNC, %llu EMCY%s%s\n", watch_nmt_text(watch_nmt_state(w, now_us)),
		(unsigned long long)w->heartbeat.count, (unsigned long long)w->sync.count,
		(unsigned long long)w->emcy.count, w->emcy.count ? ", the last: " : "",
		w->emcy.count ? emcy_code_text(w->emcy_code) : "");
}

/* ---- NMT master and SYNC producer ---- */

static void send_start(struct monitor *m, uint64_t now_us)
{
	struct can_msg msg = {.len = 2, .data = {1, (uint8_t)m->node_id}};

	can_send(m->bus, &msg, now_us);
	m->started = m->watch.configured;
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
	if (m->screen)
		show_all(m, now_us);
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

	if (ready && m->start && m->started != m->watch.configured)
		send_start(m, now_us);
	if (ready && m->sync_hz > 0) {
		if (now_us >= m->next_sync_us)
			send_sync(m, now_us);
		next_us = earliest(next_us, m->next_sync_us);
	}
	if (now_us >= m->next_update_us)
		update(m, now_us);
	return earliest(next_us, m->next_update_us);
}

/* Runs until the time is over, all values are received (--once) or a signal arrives (true). */
static bool run(struct monitor *m, int signal_fd)
{
	struct can_msg msg;

	for (;;) {
		uint64_t next_us = serve(m, cli_now_us());

		if (cli_wait(m->bus, signal_fd, next_us))
			return true;
		uint64_t now_us = cli_now_us();
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
		{"rate", required_argument, NULL, 'r'},
		{"time", required_argument, NULL, 't'},
		CLI_COMMON_OPTIONS,
	};
	int option;

	opterr = 0;
	while ((option = getopt_long(argc, argv, ":i:n:sS:polr:t:hV", options, NULL)) != -1) {
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
			m->line = true;
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
	if (m->once && m->line)
		cli_usage_error("--once and --line exclude each other");
}

int main(int argc, char **argv)
{
	static struct monitor m;
	char hint[TEXT_MAX];

	m.bus_name = cli_default_bus();
	parse_options(&m, argc, argv);
	if (m.node_id == 0)
		m.node_id = cli_default_node();
	m.screen = !m.once && !m.line && isatty(STDOUT_FILENO);
	if (m.update_hz == 0)
		m.update_hz = m.screen ? SCREEN_HZ : LINE_HZ;
	if (m.once && m.seconds == 0)
		m.seconds = ONCE_SECONDS;

	int signal_fd = cli_signal_fd();
	m.bus = cli_open_bus(m.bus_name);
	m.begin_us = m.next_sync_us = cli_now_us();
	m.next_update_us = m.once ? UINT64_MAX : m.begin_us;
	m.end_us = m.seconds > 0 ? m.begin_us + (uint64_t)(m.seconds * 1e6) : UINT64_MAX;
	watch_init(&m.watch, &imu9_od_table, &m.values, m.bus, (uint8_t)m.node_id, m.passive, m.begin_us);
	if (m.screen)
		screen_enter();
	bool interrupted = run(&m, signal_fd);
	if (m.screen)
		screen_leave();

	bool received = watch_has_values(&m.watch);
	if (m.once)
		show_all(&m, cli_now_us());
	else if (received)
		show_summary(&m, cli_now_us());
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
