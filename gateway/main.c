/* gateway/main.c
 * imu9-gateway: reads the configuration, opens the ports, initialises the device and runs the loop. */
#include <errno.h>
#include <getopt.h>
#include <sched.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "drivers/ports/sources.h"
#include "gateway/ascii_gateway.h"
#include "gateway/config.h"
#include "gateway/device.h"
#include "gateway/log.h"
#include "gateway/loop.h"
#include "gateway/process_guard.h"
#include "gateway/record_file.h"
#include "gateway/reload.h"
#include "gateway/sandbox.h"
#include "gateway/serial.h"
#include "gateway/settings.h"
#include "gateway/store_name.h"
#include "od_values.h"

enum { EXIT_USAGE = 2 };

static const char usage[] =
	"Usage: imu9-gateway [OPTION]...\n"
	"Turns a 9-axis IMU into a CANopen device (CiA 301, CiA 410).\n"
	"\n"
	"  -c, --config FILE     INI file: [gateway] with the options below as keys (node_id = 5), and\n"
	"                        objects by name; 'imu9-sdo save FILE' writes one\n"
	"      --imu SRC         where samples come from, see below            (default: sim)\n"
	"  -i, --can BUS         the CAN bus, see below               (default: $IMU9_CAN or vcan0)\n"
	"  -n, --node-id N       1 to 127, or 255: waits for one by LSS  (default: $IMU9_NODE or 1)\n"
	"      --bitrate B       bit/s, set where that is permitted: CAP_NET_ADMIN  (default: unchanged)\n"
	"      --set NAME=VALUE  any configuration object by its EDS name, e.g. lever_arm.l=0.05\n"
	"      --store DIR       where 1010h and LSS store (default: /var/lib/imu9-gateway, or\n"
	"                        ~/.local/state/imu9-gateway when not root)\n"
	"      --record DIR[,size=MB][,files=N]  IMU logs of all that goes in, for imu9-replay; 8 files of\n"
	"                        16 MB, and as many kept for EMCYs; 215Ch starts and stops   (default: off)\n"
	"      --realtime PRIO   SCHED_FIFO priority 1 to 99, memory locked         (default: off)\n"
	"      --serial N        1018h:4, unique among all units   (default: from the hardware, kept)\n"
	"      --vendor-id N     1018h:1, of who sells the device             (default: 0x00494D55)\n"
	"      --run-led NAME, --error-led NAME   LEDs under /sys/class/leds (CiA 303-3)\n"
	"      --modbus WINDOW   Modbus server, see below; again for another one    (default: none)\n"
	"      --log-level LEVEL  error, warning, info or debug                      (default: info)\n"
	"      --cia309 ADDRESS  unix:PATH[,group=NAME] or tcp:127.0.0.1:PORT, both [,write=yes]: CiA 309-3, the\n"
	"                        text protocol of cocomm; repeatable                  (default: off)\n"
	"      --check           only tell whether the configuration is good\n"
	"      --unlock          only open the write lock (214Ch) in the store of a gateway that is stopped\n"
	"  -h, --help            this text\n"
	"  -V, --version         the version\n"
	"\n"
	"Precedence: defaults < FILE < command line < what 1010h and LSS stored.\n"
	"SIGHUP reads FILE again; the log says what is changed by it and what needs a restart.\n"
	"\n"
	"Exit status: 0 stopped by a signal or --check is good, 1 failed, 2 wrong usage or configuration.\n"
	"\n"
	"Example: imu9-gateway --imu i2c:/dev/i2c-1 --can can0 --node-id 5\n";

enum { OPT_KEY = 256, OPT_SET, OPT_CHECK, OPT_UNLOCK }; /* OPT_KEY: a key of [gateway] */

static const char letters[] = ":c:i:n:hV";
static const struct option options[] = {
	{"config", required_argument, NULL, 'c'},
	{"imu", required_argument, NULL, OPT_KEY},
	{"can", required_argument, NULL, 'i'},
	{"node-id", required_argument, NULL, 'n'},
	{"bitrate", required_argument, NULL, OPT_KEY},
	{"set", required_argument, NULL, OPT_SET},
	{"store", required_argument, NULL, OPT_KEY},
	{"record", required_argument, NULL, OPT_KEY},
	{"realtime", required_argument, NULL, OPT_KEY},
	{"serial", required_argument, NULL, OPT_KEY},
	{"vendor-id", required_argument, NULL, OPT_KEY},
	{"run-led", required_argument, NULL, OPT_KEY},
	{"error-led", required_argument, NULL, OPT_KEY},
	{"log-level", required_argument, NULL, OPT_KEY},
	{"cia309", required_argument, NULL, OPT_KEY},
	{"modbus", required_argument, NULL, OPT_KEY},
	{"check", no_argument, NULL, OPT_CHECK},
	{"unlock", no_argument, NULL, OPT_UNLOCK},
	{"help", no_argument, NULL, 'h'},
	{"version", no_argument, NULL, 'V'},
	{0},
};

static void print_help(void)
{
	fputs(usage, stdout);
	puts("\nSRC is one of:");
	imu_print_sources(stdout);
	puts("\nBUS is one of:");
	can_print_sources(stdout);
	puts("\nWINDOW is one of:");
	window_print_syntax(stdout);
}

static int usage_error(const char *why)
{
	log_error("%s (imu9-gateway --help)", why);
	return EXIT_USAGE;
}

static int bad_configuration(const char *why)
{
	log_error("%s", why);
	return EXIT_USAGE;
}

/* An option that getopt_long() refused. */
static int bad_option(int option, char *const argv[])
{
	char why[CONFIG_ERROR_MAX];

	if (option == ':')
		snprintf(why, sizeof(why), "option %.100s needs a value", argv[optind - 1]);
	else if (optopt > 0 && optopt < OPT_KEY)
		snprintf(why, sizeof(why), "unknown option -%c", optopt);
	else
		snprintf(why, sizeof(why), "unknown option %.100s", argv[optind - 1]);
	return usage_error(why);
}

/* Option --node-id is the key node_id of the file. */
static int set_key(struct config *config, const char *option, const char *value, char *why)
{
	char key[32];

	snprintf(key, sizeof(key), "%s", option);
	for (char *dash = key; (dash = strchr(dash, '-')) != NULL;)
		*dash = '_';
	return config_option(config, key, value, why);
}

enum action { RUN, CHECK, UNLOCK };

/* One option of the command line; --config, --check and --unlock were handled before all others. -1: continue, else the
 * exit status. */
static int apply_option(struct config *config, int option, int index, char *const argv[])
{
	char why[CONFIG_ERROR_MAX];
	int rc = 0;

	switch (option) {
	case 'c':
	case OPT_CHECK:
	case OPT_UNLOCK:
		break;
	case OPT_KEY:
		rc = set_key(config, options[index].name, optarg, why);
		break;
	case 'i':
		rc = config_option(config, "can", optarg, why);
		break;
	case 'n':
		rc = config_option(config, "node_id", optarg, why);
		break;
	case OPT_SET:
		rc = config_set(config, optarg, why);
		break;
	case 'h':
		print_help();
		return EXIT_SUCCESS;
	case 'V':
		puts("imu9-gateway " IMU9_VERSION);
		return EXIT_SUCCESS;
	default:
		return bad_option(option, argv);
	}
	return rc < 0 ? bad_configuration(why) : -1;
}

/* The tools read the same variables. -1: continue, else the exit status. */
static int apply_environment(struct config *config, const char *variable, const char *key)
{
	char why[CONFIG_ERROR_MAX];
	const char *value = getenv(variable);

	if (!value || !value[0] || config_option(config, key, value, why) == 0)
		return -1;
	log_error("%s: %s", variable, why);
	return EXIT_USAGE;
}

static struct process_guard guard;

/* The file before the other options, in any order on the command line. -1: run, else the exit status. */
static int read_configuration(struct config *config, enum action *action, int argc, char **argv)
{
	char why[CONFIG_ERROR_MAX];
	int option, index = 0, status;

	config_init(config, &imu9_od_table);
	status = apply_environment(config, "IMU9_CAN", "can");
	if (status < 0)
		status = apply_environment(config, "IMU9_NODE", "node_id");
	if (status >= 0)
		return status;
	opterr = 0;
	optind = 0; /* glibc: start again */
	*action = RUN;
	while ((option = getopt_long(argc, argv, letters, options, NULL)) != -1) {
		if (option == 'c') {
			process_guard_opening(&guard, optarg);
			if (config_file(config, optarg, why) < 0)
				return bad_configuration(why);
		}
		if (option == OPT_CHECK || option == OPT_UNLOCK)
			*action = option == OPT_CHECK ? CHECK : UNLOCK;
	}
	optind = 0;
	while (status < 0 && (option = getopt_long(argc, argv, letters, options, &index)) != -1)
		status = apply_option(config, option, index, argv);
	if (status < 0 && optind < argc) {
		snprintf(why, sizeof(why), "'%.100s' is not an option", argv[optind]);
		return usage_error(why);
	}
	return status;
}

static void store_folder(char *folder, size_t size, const struct config *config)
{
	const char *state = getenv("XDG_STATE_HOME"), *home = getenv("HOME");

	if (config->store[0])
		snprintf(folder, size, "%s", config->store);
	else if (geteuid() == 0 || (!state && !home))
		snprintf(folder, size, "/var/lib/imu9-gateway");
	else if (state)
		snprintf(folder, size, "%.400s/imu9-gateway", state);
	else
		snprintf(folder, size, "%.400s/.local/state/imu9-gateway", home);
}

static void go_realtime(unsigned priority)
{
	struct sched_param param = {.sched_priority = (int)priority};

	if (priority == 0)
		return;
	if (mlockall(MCL_CURRENT | MCL_FUTURE) < 0)
		log_warning("cannot lock the memory: %s (raise ulimit -l, or grant CAP_IPC_LOCK)", strerror(errno));
	if (sched_setscheduler(0, SCHED_FIFO, &param) < 0)
		log_warning("cannot set real-time priority %u: %s (raise ulimit -r, or grant CAP_SYS_NICE)", priority,
			strerror(errno));
}

static int save_through_writer(void *ctx, const uint8_t *bytes, size_t size)
{
	int rc = store_writer_submit(ctx, bytes, size);

	return rc < 0 ? rc : -EINPROGRESS;
}

static struct device device;
static struct store_image stored;
static struct store_writer writer;
static struct window window;

/* Reads the stored values and starts the thread that stores. NULL: nothing can be stored, which does not keep the
 * gateway from running. */
static struct store_writer *open_store(const struct config *config, bool *damaged)
{
	char folder[CONFIG_TEXT_MAX * 2], path[STORE_PATH_MAX + CONFIG_TEXT_MAX], old[sizeof(path)];

	*damaged = false;
	store_folder(folder, sizeof(folder), config);
	store_path(path, sizeof(path), folder, config->can);
	int opened = store_writer_open(&writer, path);
	if (opened == -EADDRINUSE) {
		log_warning(
			"%s belongs to another gateway that is running: 1010h cannot store; use another folder with "
			"--store",
			path);
		return NULL;
	}
	int rc = store_take_over(path, folder, config->can, config->node_id, old, sizeof(old));
	if (rc > 0)
		log_line("%s renamed to %s", old, path);
	else if (rc < 0)
		log_line("%s has the values stored before; it cannot be renamed to %s: %s", old, path, strerror(-rc));
	rc = store_read(&stored, path);
	*damaged = rc < 0;
	if (rc < 0)
		log_warning("%s: stored values not used: %s", path,
			rc == -EBADMSG	 ? "damaged; kept as .bad"
			: rc == -ENOTSUP ? "of a later version; kept as .bad"
			: rc == -EINVAL	 ? "not a regular file"
			: rc == -ELOOP	 ? "a symbolic link; use the folder it points to with --store"
					 : strerror(-rc));
	if (opened < 0) {
		log_warning("%s: %s: 1010h cannot store; use another folder with --store", path, strerror(-opened));
		return NULL;
	}
	log_line("1010h and LSS store in %s", path);
	return &writer;
}

/* --unlock */
static int unlock(const struct config *config)
{
	static uint8_t bytes[STORE_FILE_MAX];
	bool damaged;

	if (!open_store(config, &damaged) || damaged) {
		log_error("not unlocked: --unlock needs the store of a gateway that is stopped");
		return EXIT_FAILURE;
	}
	bool locked = stored.lock_key != 0;
	stored.lock_key = 0;
	int rc = locked ? store_write(writer.path, bytes, store_encode(&stored, bytes)) : 0;
	if (rc != 0)
		log_error("%s: %s", writer.path, strerror(abs(rc)));
	else
		log_line(locked ? "unlocked" : "it is not locked");
	store_writer_close(&writer);
	return rc == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}

static void log_notes(const char *notes)
{
	for (; *notes; notes += strcspn(notes, "\n"), notes += *notes == '\n')
		log_line("%.*s", (int)strcspn(notes, "\n"), notes);
}

/* 1009h, 100Ah, 1018h and 1F56h. */
static void identify(struct od_values *values, const struct config *config, const struct imu_port *imu)
{
	char folder[CONFIG_TEXT_MAX * 2], note[SERIAL_NOTE_MAX];

	store_folder(folder, sizeof(folder), config);
	values->identity.serial_number = serial_number("", folder, config->can, config->serial, note);
	log_notes(note);
	if (config->vendor_id)
		values->identity.vendor_id = config->vendor_id;
	snprintf(values->manufacturer_hardware_version, sizeof(values->manufacturer_hardware_version), "%.31s",
		imu->name);
	snprintf(values->manufacturer_software_version, sizeof(values->manufacturer_software_version), "%s",
		IMU9_VERSION);
	values->program_software_identification.program_1 = od_crc32(0, IMU9_VERSION, strlen(IMU9_VERSION));
}

/* The node-ID that LSS stored has precedence over the configured one, as every stored value has. */
static uint8_t start_node_id(const struct config *config)
{
	unsigned node_id = stored.lss.node_id ? stored.lss.node_id : config->node_id;

	if (node_id != config->node_id)
		log_line("node-ID %u, stored by LSS, replaces the configured %u", node_id, config->node_id);
	return (uint8_t)node_id;
}

/* The stored bit rate, too. */
static void start_bit_rate(const struct config *config, struct can_port *bus)
{
	uint32_t bit_s = stored.lss.bit_s ? stored.lss.bit_s : config->bitrate;

	if (bit_s == 0 || bit_s == bus->bit_s)
		return;
	int rc = can_bit_rate(bus, bit_s, false);
	if (rc == 0)
		log_line("%s: %u bit/s set%s", bus->name, bit_s, stored.lss.bit_s ? ", as stored by LSS" : "");
	else if (rc == -EPERM)
		log_warning("%s runs at %u bit/s; setting %u needs CAP_NET_ADMIN; as root: `ip link set %s down; "
			    "ip link set %s up type can bitrate %u`",
			bus->name, bus->bit_s, bit_s, bus->name, bus->name, bit_s);
	else if (rc == -EOPNOTSUPP && bus->bit_s == 0)
		log_line("%s has no bit rate; its load is calculated for %u bit/s", bus->name, bus->bit_s = bit_s);
	else
		log_warning("%s: %u bit/s cannot be set: %s", bus->name, bit_s,
			rc == -EOPNOTSUPP ? "the controller does not support this bit rate" : strerror(-rc));
}

static void open_leds(const struct config *config)
{
	const char *name;
	int rc = leds_open(&device.leds, "/sys/class/leds", config->run_led, config->error_led, &name);

	if (rc < 0)
		log_warning("/sys/class/leds/%s/brightness: %s: this LED is not used", name, strerror(-rc));
}

/* The gateway runs without it, too. */
static void enter_sandbox(void)
{
	int rc = sandbox_enter();

	if (rc < 0)
		log_at(LOG_DEBUG, "no seccomp filter: %s",
			rc == -ENOENT ? "libseccomp is not installed" : strerror(-rc));
}

static const char INCONSISTENT[] = "the configuration is inconsistent: check for a singular calibration matrix or a "
				   "filter order 0";

static struct recording {
	struct record_options options;
	struct record record;
	struct record_file file;
} recording;

/* The device runs without it, too. */
static struct record *open_recording(const struct config *config)
{
	const char *folder = recording.options.folder;

	if (!config->record[0])
		return NULL;
	process_guard_opening(&guard, folder);
	int rc = record_open(&recording.record);
	if (rc == 0 && (rc = record_file_open(&recording.file, &recording.record, &recording.options)) < 0)
		record_close(&recording.record);
	process_guard_opening(&guard, NULL);
	if (rc == 0)
		log_line("recording in %s: %u files of %u MB", folder, recording.options.files,
			recording.options.size_mb);
	else
		log_warning("%s: %s: nothing is recorded; use another folder with --record", folder,
			rc == -EADDRINUSE ? "another process records there" : strerror(-rc));
	return rc == 0 ? &recording.record : NULL;
}

/* Wrong however often it is tried, whether the device is there or not. -1: good, else the exit status. */
static int check_configuration(const struct config *config)
{
	char why[CONFIG_ERROR_MAX];

	if (imu_open(config->imu, NULL, NULL, why, sizeof(why)) < 0 ||
		can_open(config->can, NULL, why, sizeof(why)) < 0 ||
		cia309_server_check(config->cia309, why, sizeof(why)) < 0 ||
		window_check(config->modbus, why, sizeof(why)) < 0)
		return bad_configuration(why);
	if (config->record[0] && record_options(config->record, &recording.options, why, sizeof(why)) < 0)
		return bad_configuration(why);
	return -1;
}

static int tell_good(const struct config *config)
{
	struct od_values values;
	struct od od;

	od_init(&od, &imu9_od_table, &values, (uint8_t)config->node_id);
	config_apply(config, &od);
	if (!settings_valid(&values))
		return bad_configuration(INCONSISTENT);
	printf("good: node %u on %s, sensor %s\n", config->node_id, config->can, config->imu);
	return EXIT_SUCCESS;
}

static struct invocation {
	int argc;
	char **argv;
	struct config config; /* as read last */
} invocation;

/* SIGHUP */
static void read_again(struct device *d, uint64_t now_us)
{
	static struct config config;
	enum action action;

	log_line("reading the configuration again");
	int status = read_configuration(&config, &action, invocation.argc, invocation.argv);
	if (status < 0)
		status = check_configuration(&config);
	if (status < 0 && reload(d, &invocation.config, &config, now_us) < 0)
		status = bad_configuration(INCONSISTENT);
	if (status >= 0) {
		log_error("the configuration is not changed");
		return;
	}
	log_set_level((int)config.log_level);
	invocation.config = config;
}

/* Other ways into the device than the bus. False: one does not open. */
static bool open_windows(const struct config *config, struct can_port *bus, struct cia309_server **cia309)
{
	char why[CONFIG_ERROR_MAX];

	*cia309 = NULL;
	if (window_open(&window, config->modbus, &device, why, sizeof(why)) < 0 ||
		(config->cia309[0] &&
			!(*cia309 = ascii_gateway_open(config->cia309, &device, bus, why, sizeof(why))))) {
		log_error("%s", why);
		return false;
	}
	return true;
}

static int run(const struct config *config, struct can_port *bus, struct imu_port *imu)
{
	struct storing_port storage = {.ctx = &writer, .save = save_through_writer};
	struct cia309_server *cia309 = NULL;
	int status = EXIT_FAILURE;
	bool damaged;

	process_guard_opening(&guard, config->store[0] ? config->store : "the store");
	struct store_writer *store = open_store(config, &damaged);
	process_guard_opening(&guard, NULL);
	uint8_t node_id = start_node_id(config);
	start_bit_rate(config, bus);
	od_init(&device.od, &imu9_od_table, &device.values, node_id);
	config_apply(config, &device.od);
	identify(&device.values, config, imu);
	int rc = device_init(&device, bus, imu, store ? &storage : NULL, &stored, node_id);
	if (rc == -EINVAL)
		status = bad_configuration(INCONSISTENT);
	else if (rc < 0)
		log_error("cannot start the device: %s", strerror(-rc));
	else if (!open_windows(config, bus, &cia309))
		rc = -EIO;
	if (rc == 0) {
		struct record *record = open_recording(config);

		record_attach(record, &device);
		if (node_id == CANOPEN_UNCONFIGURED)
			log_line("on %s, sensor %s at %.1f Hz; no node-ID: waiting for LSS to assign one (imu9-sdo lss "
				 "assign)",
				bus->name, imu->name, imu->rate_hz);
		else
			log_line("node %u on %s, sensor %s at %.1f Hz", node_id, bus->name, imu->name, imu->rate_hz);
		log_notes(imu->notes);
		open_leds(config);
		go_realtime(config->realtime);
		enter_sandbox();
		process_guard_rest(&guard);
		rc = loop_run(&device, bus, imu, store, cia309, window_is_open(&window) ? &window : NULL, damaged,
			read_again);
		process_guard_stop(&guard);
		if (rc < 0)
			log_error("cannot run: %s", strerror(-rc));
		leds_close(&device.leds);
		if (record) {
			record_file_close(&recording.file);
			record_close(record);
		}
	}
	if (cia309)
		ascii_gateway_close(cia309);
	window_close(&window);
	if (store)
		store_writer_close(store);
	return rc == 0 ? EXIT_SUCCESS : status;
}

/* The sensor is opened before the device is initialised; its stored settings (1010h) are applied at device_init(). */
static struct imu_settings settings_of(const struct config *config)
{
	static struct od_values values;
	static struct od od;

	od_init(&od, &imu9_od_table, &values, (uint8_t)config->node_id);
	config_apply(config, &od);
	struct imu_settings settings = sensor_settings(&values);
	settings.realtime = (int)config->realtime;
	return settings;
}

int main(int argc, char **argv)
{
	const struct config *config = &invocation.config;
	struct imu_port *imu;
	struct can_port *bus;
	char why[CONFIG_ERROR_MAX];
	enum action action;

	process_guard_start(&guard);
	invocation.argc = argc;
	invocation.argv = argv;
	int status = read_configuration(&invocation.config, &action, argc, argv);
	if (status < 0)
		status = check_configuration(config);
	if (status >= 0)
		return status;
	if (action == CHECK)
		return tell_good(config);
	if (action == UNLOCK)
		return unlock(config);
	log_set_level((int)config->log_level);
	const struct imu_settings settings = settings_of(config);
	process_guard_opening(&guard, config->imu);
	if (imu_open(config->imu, &settings, &imu, why, sizeof(why)) < 0) {
		log_error("%s", why);
		return EXIT_FAILURE;
	}
	process_guard_opening(&guard, config->can);
	if (can_open(config->can, &bus, why, sizeof(why)) < 0) {
		log_error("%s", why);
		imu_close(imu);
		return EXIT_FAILURE;
	}
	status = run(config, bus, imu);
	can_close(bus);
	imu_close(imu);
	return status;
}
