/* imu9-fleet: publishes what the CANopen nodes of a bus send at an MQTT broker. */
#include <errno.h>
#include <getopt.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <time.h>
#include <unistd.h>

#include "gateway/canopen/deadline.h"
#include "gateway/log.h"
#include "gateway/service.h"
#include "tools/fleet/options.h"
#include "tools/lib/cli.h"

static const char help[] =
	"Usage: imu9-fleet [-c FILE] [-i BUS] --broker mqtt(s)://HOST[:PORT] [OPTION]...\n"
	"Publishes what the CANopen nodes of a bus send at an MQTT broker: values, NMT states, emergencies.\n"
	"What the broker does not take waits in a spool on disk, and is sent in order when it is back.\n"
	"\n"
	"  -c, --config FILE     INI file: [fleet] with the long options below as keys (node_id = 5)\n"
	"  -i, --can BUS         the CAN bus, see below               (default: $IMU9_CAN or vcan0)\n"
	"  -n, --node-id NODES   only these, like 5,7,10-19            (default: all that are heard)\n"
	"  -e, --eds [NODE=]FILE  the EDS of a node, or of all others; repeatable\n"
	"                        (default: that of the IMU9 gateway)\n"
	"  -p, --passive         send no SDO; use the default PDO mapping of the EDS\n"
	"      --broker URL      mqtt://HOST[:PORT], or with TLS mqtts://HOST[:PORT]\n"
	"      --ca FILE         certificates of the authorities that are trusted  (default: the system's)\n"
	"      --cert FILE, --key FILE   the client's own certificate and its key\n"
	"      --credentials FILE  user in the first line, password in the second; mode 600\n"
	"      --client-id ID    (default: imu9-fleet-HOSTNAME-NAME)\n"
	"      --topic PREFIX    the first levels of the topics                      (default: imu9)\n"
	"      --name NAME       of the bus in the topics                            (default: BUS)\n"
	"      --format FORMAT   json, or sparkplug: Sparkplug B 3.0; PREFIX is the group then, NAME the\n"
	"                        edge node                                           (default: json)\n"
	"      --hz HZ           samples a second of each node, at most              (default: all)\n"
	"      --change OBJECT=X  only samples in which a value of OBJECT has changed by more than X in\n"
	"                        its unit; repeatable\n"
	"      --at-least SECS   one sample in that time at least, with --change     (default: 60)\n"
	"      --spool DIR[,size=MB]  (default: /var/lib/imu9-fleet/NAME, or\n"
	"                        ~/.local/state/imu9-fleet/NAME when not root; 64)\n"
	"      --late-rate N     records a second from the spool, at most            (default: 1000)\n"
	"      --check           only tell whether the configuration is good\n"
	"      --allow-writes OBJECT,...  subscribers may write these objects, or records, of the nodes:\n"
	"                        PREFIX/NAME/NODE/write, answered by .../answer; repeatable (default: none)\n"
	"  -h, --help            this text\n"
	"  -V, --version         the version\n"
	"\n"
	"Topics: PREFIX/NAME/NODE/values, objects, state and emcy, and PREFIX/NAME/status.\n"
	"\n" CLI_EXIT_STATUS "\nExample: imu9-fleet -i can0 --broker mqtt://localhost --hz 10\n";

enum {
	FRAMES_A_WAKE = 1000,
	COMMANDS_A_WAKE = 16,
	COMMANDS_BYTES = 1 << 15,
	OPT_KEY = 256,
	OPT_CHECK
}; /* OPT_KEY: a key of [fleet] */

static const char letters[] = ":c:i:n:e:phV";
static const struct option long_options[] = {
	CLI_BUS_OPTIONS,
	{"config", required_argument, NULL, 'c'},
	{"eds", required_argument, NULL, 'e'},
	{"passive", no_argument, NULL, 'p'},
	{"broker", required_argument, NULL, OPT_KEY},
	{"ca", required_argument, NULL, OPT_KEY},
	{"cert", required_argument, NULL, OPT_KEY},
	{"key", required_argument, NULL, OPT_KEY},
	{"credentials", required_argument, NULL, OPT_KEY},
	{"client-id", required_argument, NULL, OPT_KEY},
	{"topic", required_argument, NULL, OPT_KEY},
	{"name", required_argument, NULL, OPT_KEY},
	{"format", required_argument, NULL, OPT_KEY},
	{"hz", required_argument, NULL, OPT_KEY},
	{"change", required_argument, NULL, OPT_KEY},
	{"at-least", required_argument, NULL, OPT_KEY},
	{"spool", required_argument, NULL, OPT_KEY},
	{"late-rate", required_argument, NULL, OPT_KEY},
	{"allow-writes", required_argument, NULL, OPT_KEY},
	{"check", no_argument, NULL, OPT_CHECK},
	CLI_COMMON_OPTIONS,
};

static struct options options;
static struct sender sender;

/* ---- commands, in the thread of the broker ----------------------------------------------------------------------- */

static struct ring commands; /* struct command, for the loop */

static void hand_over(void *ctx, const struct command *command)
{
	(void)ctx;
	if (command->kind == COMMAND_REBIRTH)
		sender_rebirth(&sender);
	else
		ring_put(&commands, command, sizeof(*command));
}

static void on_message(void *ctx, const char *topic, const void *payload, size_t size, bool retained)
{
	bool good = !retained && size <= BROKER_COMMAND_MAX &&
		    options.sender.ops->command(&options.sender.format, topic, payload, size, hand_over, ctx);

	if (!good)
		log_warning("message on %.100s not executed: %s", topic,
			retained ? "it was retained, and so it would be executed again and again" : "it is no command");
}

/* ---- the loop ---------------------------------------------------------------------------------------------------- */

struct loop {
	struct can_port *bus;
	struct fleet fleet;
	struct service service;
	unsigned turns; /* of the sender */
	uint64_t second_us;
	int64_t offset_us; /* UTC - CLOCK_MONOTONIC */
	bool down_told;
};

/* UTC - CLOCK_MONOTONIC. The best of three: the process can lose the processor between the clocks. */
static int64_t utc_offset_us(void)
{
	uint64_t shortest_us = UINT64_MAX;
	int64_t offset_us = 0;

	for (int i = 0; i < 3; i++) {
		struct timespec t;
		uint64_t before_us = cli_now_us();
		clock_gettime(CLOCK_REALTIME, &t);
		uint64_t took_us = cli_now_us() - before_us;

		if (took_us < shortest_us)
			offset_us = (int64_t)t.tv_sec * 1000000 + t.tv_nsec / 1000 - (int64_t)(before_us + took_us / 2);
		shortest_us = earlier(took_us, shortest_us);
	}
	return offset_us;
}

static void put_record(void *ctx, const struct record *record)
{
	sender_put(ctx, record);
}

static void each_second(struct loop *loop, uint64_t now_us)
{
	bool down = loop->bus->state == CAN_STATE_DOWN;

	loop->second_us = now_us + 1000000;
	loop->offset_us = utc_offset_us();
	can_refresh(loop->bus);
	sender_count(&sender, &(struct fleet_status){
				      .nodes = loop->fleet.node_count,
				      .samples = loop->fleet.samples,
				      .withheld = loop->fleet.withheld,
				      .misfits = loop->fleet.misfits,
				      .bus_dropped = loop->bus->counters.rx_dropped,
				      .commands_dropped = atomic_load(&commands.dropped),
			      });
	if (down && !loop->down_told)
		log_warning("%s is down%s%s", loop->bus->name, loop->bus->down_why ? ": " : "",
			loop->bus->down_why ? loop->bus->down_why : "");
	if (!down && loop->down_told)
		log_line("%s is up", loop->bus->name);
	loop->down_told = down;
	if (loop->bus->notice)
		log_line("%s: %s", loop->bus->name, loop->bus->notice);
	loop->bus->notice = NULL;
}

static uint64_t serve(struct loop *loop, uint64_t now_us)
{
	if (now_us >= loop->second_us)
		each_second(loop, now_us);
	uint64_t next_us = fleet_tick(&loop->fleet, now_us, loop->offset_us);
	writes_poll(&options.writes, &loop->fleet, now_us, loop->offset_us); /* what got no answer */
	uint64_t sign_us = service_tick(&loop->service, 0, sender_is_busy(&sender, &loop->turns), now_us);
	return earlier(earlier(next_us, loop->second_us), sign_us);
}

static void receive(struct loop *loop, const struct can_msg *msg, uint64_t now_us)
{
	fleet_receive(&loop->fleet, msg, now_us, loop->offset_us);
	writes_poll(&options.writes, &loop->fleet, now_us, loop->offset_us);
}

static void take_commands(struct loop *loop, uint64_t now_us)
{
	struct command command;

	for (int n = 0; n < COMMANDS_A_WAKE && ring_get(&commands, &command, sizeof(command)) > 0; n++)
		writes_submit(&options.writes, &loop->fleet, &command, now_us, loop->offset_us);
}

/* Readable when a signal arrives, or a command. */
static int signal_or_command(int signal_fd)
{
	struct epoll_event event = {.events = EPOLLIN};
	int fd = epoll_create1(EPOLL_CLOEXEC);

	if (fd < 0 || epoll_ctl(fd, EPOLL_CTL_ADD, signal_fd, &event) < 0)
		return signal_fd;
	epoll_ctl(fd, EPOLL_CTL_ADD, commands.fd, &event); /* else they wait for the next frame */
	return fd;
}

static bool is_signal(int signal_fd)
{
	struct pollfd signal = {.fd = signal_fd, .events = POLLIN};

	return poll(&signal, 1, 0) > 0;
}

static void run(struct loop *loop, int signal_fd)
{
	int wake_fd = signal_or_command(signal_fd);
	struct can_msg msg;
	uint64_t now_us = cli_now_us();

	for (;;) {
		bool woken = cli_wait(loop->bus, wake_fd, serve(loop, now_us));
		if (woken && is_signal(signal_fd))
			return;
		now_us = cli_now_us();
		for (int n = 0; n < FRAMES_A_WAKE && can_receive(loop->bus, &msg, now_us) > 0; n++)
			receive(loop, &msg, now_us);
		if (woken)
			ring_clear(&commands);
		take_commands(loop, now_us);
	}
}

static int publish_the_bus(void)
{
	static struct loop loop;
	static const struct fleet_sink sink = {&sender, put_record};
	char status[2 * OPTIONS_TEXT_MAX + 32];

	service_open(&loop.service, getenv("NOTIFY_SOCKET"), getenv("WATCHDOG_USEC"), getenv("WATCHDOG_PID"));
	int signal_fd = cli_signal_fd();
	loop.bus = cli_open_bus(options.bus);
	int result = ring_open(&commands, COMMANDS_BYTES);
	if (result < 0) {
		log_error("commands: %s", strerror(-result));
		return CLI_FAILED;
	}
	result = sender_start(&sender, &options.sender, on_message, NULL);
	if (result < 0) {
		log_error("spool %s: %s", options.sender.spool_folder,
			result == -EBUSY ? "another process has it; use another folder with --spool"
					 : strerror(-result));
		return CLI_FAILED;
	}
	fleet_init(&loop.fleet, &options.fleet, loop.bus, &sink, cli_now_us());
	snprintf(status, sizeof(status), "%s to %s:%d", options.bus, options.sender.broker.host,
		options.sender.broker.port);
	log_line("%s, spool %s", status, options.sender.spool_folder);
	service_ready(&loop.service, status);
	run(&loop, signal_fd);
	service_stopping(&loop.service);
	sender_stop(&sender);
	fleet_free(&loop.fleet);
	can_close(loop.bus);
	service_close(&loop.service);
	return CLI_OK;
}

/* ---- the command line -------------------------------------------------------------------------------------------- */

static void set(const char *key, const char *value)
{
	char why[OPTIONS_ERROR_MAX];

	if (options_set(&options, key, value, why) < 0)
		cli_usage_error("%s", why);
}

static _Noreturn void bad_configuration(const char *why)
{
	cli_error("%s", why);
	exit(CLI_USAGE);
}

/* The files first: the command line overrides them whatever the order. */
static void read_files(int argc, char **argv)
{
	char why[OPTIONS_ERROR_MAX];
	int option;

	while ((option = getopt_long(argc, argv, letters, long_options, NULL)) != -1)
		if (option == 'c' && options_file(&options, optarg, why) < 0)
			bad_configuration(why);
	optind = 0; /* glibc: start again */
}

/* True: --check */
static bool read_options(int argc, char **argv)
{
	bool check = false;
	int option, index = 0;

	opterr = 0;
	read_files(argc, argv);
	while ((option = getopt_long(argc, argv, letters, long_options, &index)) != -1)
		switch (option) {
		case 'c':
			break;
		case 'i':
			set("can", optarg);
			break;
		case 'n':
			set("node-id", optarg);
			break;
		case 'e':
			set("eds", optarg);
			break;
		case 'p':
			set("passive", "yes");
			break;
		case OPT_KEY:
			set(long_options[index].name, optarg);
			break;
		case OPT_CHECK:
			check = true;
			break;
		case 'h':
			cli_print_help(help);
			exit(CLI_OK);
		case 'V':
			puts("imu9-fleet " IMU9_VERSION);
			exit(CLI_OK);
		default:
			cli_bad_option(option, argv);
		}
	if (optind < argc)
		cli_usage_error("%s: unexpected argument", argv[optind]);
	return check;
}

int main(int argc, char **argv)
{
	char why[OPTIONS_ERROR_MAX];

	options_init(&options);
	bool check = read_options(argc, argv);
	if (options_finish(&options, why) < 0)
		bad_configuration(why);
	int status = check ? CLI_OK : publish_the_bus();
	options_free(&options);
	return status;
}
