/* imu9-sdo: configures a CANopen node by the names of its objects. The commands are in sdo_*.c. */
#include <errno.h>
#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "od_values.h"
#include "tools/sdo/sdo_session.h"

static const char help[] =
	"Usage: imu9-sdo [-i BUS] [-n NODE] [-e EDS] [-t MS] [-q|-j] COMMAND\n"
	"Configures the nodes of a CANopen bus: objects by SDO, NMT and LSS.\n"
	"\n"
	"  read OBJECT...        print values; OBJECT is a name (lever_arm.l), a whole record\n"
	"                        (lever_arm) or an index (0x2000:1, 2000h:1, 0x1017)\n"
	"    -o FILE             write the bytes of one object to FILE; without it a DOMAIN is written\n"
	"                        to standard output (eds, snapshot and log are short names)\n"
	"    --block, --no-block use block transfer always or never (default: for DOMAINs)\n"
	"  write OBJECT VALUE    VALUE by the object's type: decimal, 0x hex, float, text, or a word\n"
	"                        (rigid_body; several bits: inverted,offset; 'objects' lists them); for a\n"
	"                        DOMAIN, or after file:, the name of a file with the bytes.\n"
	"                        If the object is not in the EDS, with its type:\n"
	"                        u8: u16: u32: u64: i8: i16: i32: i64: r32: r64: bool: str: hex:\n"
	"  watch OBJECT...       print a line of values twice a second until Ctrl-C; --rate HZ, --count N;\n"
	"                        --utc: with the time of day; --csv: as CSV, with units in its header\n"
	"  dump                  print all readable objects of the EDS\n"
	"  objects [OBJECT]      list the objects of the EDS, without a node; -q: only their names.\n"
	"                        OBJECT: a record, or one object and the words of its values\n"
	"  log                   print the event log of the gateway since its start (2131h)\n"
	"  save FILE             save the configuration to FILE ('-': standard output), in the\n"
	"                        format that 'load' and 'imu9-gateway -c' read\n"
	"  load FILE             load the configuration in FILE into the node; writes only values\n"
	"                        that differ, PDOs by the mapping procedure\n"
	"  dcf save FILE         save the configuration as a DCF (CiA 306), from the EDS\n"
	"  dcf apply FILE        load a DCF, or a concise DCF from 'read snapshot -o FILE'\n"
	"  dcf compare FILE      print the differences between node and FILE; status 1 if there are any\n"
	"  dbc [FILE]            write a DBC of the PDOs as the node has them now (default: standard output)\n"
	"  store [GROUP]         store the configuration in the node, safe against power loss (1010h)\n"
	"  restore [GROUP]       delete the stored configuration (1011h)\n"
	"                        GROUP: all (default), communication, application, manufacturer\n"
	"  nmt COMMAND           start, stop, preop, reset or reset-comm; with -n 0 to all nodes\n"
	"  scan                  list the nodes on the bus with state and identity. It sends a\n"
	"                        request to every node-ID, which ends SDO transfers of other tools\n"
	"  lss scan              list the nodes without a node-ID by their identity (fastscan)\n"
	"  lss assign ID         assign ID to the first of them, or to the one with --serial N;\n"
	"                        --store: the node stores it\n"
	"  lss inquire           print node-ID and identity\n"
	"  lss node-id ID        set another node-ID, valid from the next 'nmt reset-comm' (255: none)\n"
	"  lss bit-rate KBIT     set another bit rate; --activate MS switches the bus to it after MS\n"
	"  lss store             store node-ID and bit rate, safe against power loss\n"
	"                        To select one of several nodes: --serial N, and --vendor N,\n"
	"                        --product N, --revision N if they are not those of the EDS\n"
	"\n"
	"  -i, --can BUS         the CAN bus, see below (default: $IMU9_CAN or vcan0)\n"
	"  -n, --node-id NODE    node-ID 1 to 127 (default: $IMU9_NODE or 1)\n"
	"  -e, --eds EDS         EDS of the node (default: built-in EDS of the IMU9 gateway)\n"
	"  -t, --timeout MS      timeout of each answer (default: 500; lss: 50)\n"
	"  -q, --quiet           print bare values, without names, units and words\n"
	"  -j, --json            print JSON: read, dump, watch (one line each), scan, log, dcf compare\n"
	"  -h, --help            this text\n"
	"  -V, --version         the version\n"
	"\n" CLI_EXIT_STATUS "\nExample: imu9-sdo -n 5 write lever_arm.l 0.05 && imu9-sdo -n 5 store\n";

static const struct command {
	const char *name;
	int (*run)(struct session *s, int argc, char **argv);
	int args_min, args_max;
	const char *args;
	bool for_all; /* may be used with -n 0 (all nodes), or needs no node */
	bool json;
} commands[] = {
	{"read", sdo_command_read, 1, SDO_TARGETS_MAX + 3, "OBJECT... [-o FILE] [--block|--no-block]", false, true},
	{"write", sdo_command_write, 2, 3, "OBJECT VALUE [--block|--no-block]", false, false},
	{"watch", sdo_command_watch, 1, SDO_TARGETS_MAX + 6, "OBJECT... [--rate HZ] [--count N] [--utc] [--csv]", false,
		true},
	{"dump", sdo_command_dump, 0, 0, "(no arguments)", false, true},
	{"objects", sdo_command_objects, 0, 1, "[OBJECT]", true, false},
	{"log", sdo_command_log, 0, 0, "(no arguments)", false, true},
	{"save", sdo_command_save, 1, 1, "FILE", false, false},
	{"load", sdo_command_load, 1, 1, "FILE", false, false},
	{"dcf", sdo_command_dcf, 2, 2, "apply|compare|save FILE", false, true},
	{"dbc", sdo_command_dbc, 0, 1, "[FILE]", false, false},
	{"store", sdo_command_store, 0, 1, "[all|communication|application|manufacturer]", false, false},
	{"restore", sdo_command_restore, 0, 1, "[all|communication|application|manufacturer]", false, false},
	{"nmt", sdo_command_nmt, 1, 1, "start|stop|preop|reset|reset-comm", true, false},
	{"scan", sdo_command_scan, 0, 0, "(no arguments)", true, true},
	{"lss", sdo_command_lss, 1, 12, "scan|assign|node-id|bit-rate|store|inquire ...", true, false},
};

static const struct command *find_command(const char *name)
{
	for (size_t i = 0; i < sizeof(commands) / sizeof(commands[0]); i++)
		if (strcmp(commands[i].name, name) == 0)
			return &commands[i];
	cli_usage_error("unknown command '%s'", name);
}

static void parse_options(struct session *s, int argc, char **argv)
{
	static const struct option options[] = {
		CLI_BUS_OPTIONS,
		{"eds", required_argument, NULL, 'e'},
		{"timeout", required_argument, NULL, 't'},
		{"quiet", no_argument, NULL, 'q'},
		{"json", no_argument, NULL, 'j'},
		CLI_COMMON_OPTIONS,
	};
	int option;

	opterr = 0;
	/* '+': parsing of options ends at the command, so that -1 in "write OBJECT -1" is a value */
	while ((option = getopt_long(argc, argv, "+:i:n:e:t:qjhV", options, NULL)) != -1) {
		switch (option) {
		case 'i':
			s->bus = optarg;
			break;
		case 'n':
			s->node_id = cli_integer_option("-n", optarg, 0, 127);
			break;
		case 'e':
			s->eds_path = optarg;
			break;
		case 't':
			s->timeout_ms = (unsigned int)cli_integer_option("-t", optarg, 1, 3600000);
			s->timeout_given = true;
			break;
		case 'q':
			s->quiet = true;
			break;
		case 'j':
			s->json = true;
			break;
		case 'h':
			cli_print_help(help);
			exit(CLI_OK);
		case 'V':
			puts("imu9-sdo " IMU9_VERSION);
			exit(CLI_OK);
		default:
			cli_bad_option(option, argv);
		}
	}
}

int main(int argc, char **argv)
{
	struct session s = {.bus = cli_default_bus(), .node_id = -1, .timeout_ms = 500};
	struct eds eds;
	char error[512];

	parse_options(&s, argc, argv);
	if (s.node_id < 0)
		s.node_id = cli_default_node();
	argc -= optind;
	argv += optind;
	if (argc == 0)
		cli_usage_error("no command given: read, write, watch, dump, objects, log, save, load, dcf, dbc, "
				"store, restore, "
				"nmt, scan or lss");
	const struct command *command = find_command(argv[0]);
	if (command->json)
		s.json |= sdo_extract_flag(&argc, argv, "--json");
	if (s.json && !command->json)
		cli_usage_error("--json is for read, dump, watch, scan, log and dcf compare");
	if (argc - 1 < command->args_min || argc - 1 > command->args_max)
		cli_usage_error("usage: imu9-sdo %s %s", command->name, command->args);
	if (s.node_id == 0 && !command->for_all)
		cli_usage_error("-n 0 (all nodes) is for nmt only: give a node-ID from 1 to 127");

	s.table = &imu9_od_table;
	if (s.eds_path) {
		if (eds_load(&eds, s.eds_path, EDS_LENIENT, error, sizeof(error)) < 0) {
			cli_error("%s", error);
			return CLI_FAILED;
		}
		s.table = &eds.table;
	}
	int exit_code = command->run(&s, argc - 1, argv + 1);
	if (s.eds_path)
		eds_free(&eds);
	if (fflush(stdout) != 0 || ferror(stdout)) {
		cli_error("standard output: %s", strerror(errno));
		return CLI_FAILED;
	}
	return exit_code;
}
