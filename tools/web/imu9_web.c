/* imu9-web: commissioning in the browser. This file reads the command line; web.h is the program, server.h its network
 * side. */
#include <errno.h>
#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tools/lib/cli.h"
#include "tools/web/server.h"

enum { EDS_FILES = 16, HOSTS = 16, EDS_FILE_MAX = 4 << 20, OPTION_LISTEN = 256, OPTION_TOKEN, OPTION_EDS, OPTION_HOST };

static const char help[] =
	"Usage: imu9-web [-i BUS] [--listen ADDRESS:PORT] [--eds FILE]... [--token-file FILE]\n"
	"Shows the nodes of a CANopen bus in the browser: live values, objects, calibration, PDO mapping, LSS.\n"
	"\n"
	"It prints the address of the page and a token. Who has the page open can see everything; who\n"
	"enters the token there can write, too.\n"
	"\n"
	"  -i, --can BUS         the CAN bus, see below (default: $IMU9_CAN or vcan0)\n"
	"  --listen ADDRESS:PORT where browsers connect (default: 127.0.0.1:8410, this computer only).\n"
	"                        Another address than 127.0.0.1 or [::1] needs --token-file; put TLS before\n"
	"                        it, since the token would be sent in clear: tools/web/README.md says how\n"
	"  --token-file FILE     the token is the first line of FILE, which only its owner may read\n"
	"                        (default: a new one at each start)\n"
	"  --host NAME           browsers may use this name of the server, besides its IP address and\n"
	"                        localhost; several times for several names\n"
	"  -e, --eds FILE        EDS of nodes that do not have it in object 1021h, by vendor and product;\n"
	"                        several times for several kinds of nodes\n"
	"  -h, --help            this text\n"
	"  -V, --version         the version\n"
	"\n" CLI_EXIT_STATUS "\nExample: imu9-web -i can0\n";

struct options {
	const char *bus, *listen, *token_file;
	const char *eds_paths[EDS_FILES], *hosts[HOSTS];
	size_t eds_count, host_count;
};

static void parse_options(struct options *o, int argc, char **argv)
{
	static const struct option options[] = {
		{"can", required_argument, NULL, 'i'},
		{"bus", required_argument, NULL, 'i'},
		{"listen", required_argument, NULL, OPTION_LISTEN},
		{"token-file", required_argument, NULL, OPTION_TOKEN},
		{"host", required_argument, NULL, OPTION_HOST},
		{"eds", required_argument, NULL, 'e'},
		CLI_COMMON_OPTIONS,
	};
	int option;

	opterr = 0;
	while ((option = getopt_long(argc, argv, ":i:e:hV", options, NULL)) != -1) {
		switch (option) {
		case 'i':
			o->bus = optarg;
			break;
		case OPTION_LISTEN:
			o->listen = optarg;
			break;
		case OPTION_TOKEN:
			o->token_file = optarg;
			break;
		case OPTION_HOST:
			if (o->host_count == HOSTS)
				cli_usage_error("more than %d names with --host", HOSTS);
			o->hosts[o->host_count++] = optarg;
			break;
		case 'e':
			if (o->eds_count == EDS_FILES)
				cli_usage_error("more than %d files with --eds", EDS_FILES);
			o->eds_paths[o->eds_count++] = optarg;
			break;
		case 'h':
			cli_print_help(help);
			exit(CLI_OK);
		case 'V':
			puts("imu9-web " IMU9_VERSION);
			exit(CLI_OK);
		default:
			cli_bad_option(option, argv);
		}
	}
	if (optind < argc)
		cli_usage_error("%s: no such argument", argv[optind]);
}

static char *read_eds(const char *path, struct eds *eds, size_t *size)
{
	char *text = malloc(EDS_FILE_MAX), error[512];
	FILE *file = fopen(path, "re");

	if (!file || !text) {
		cli_error("%s: %s", path, strerror(errno));
		exit(CLI_FAILED);
	}
	*size = fread(text, 1, EDS_FILE_MAX, file);
	fclose(file);
	if (eds_parse(eds, path, text, *size, EDS_LENIENT, error, sizeof(error)) < 0) {
		cli_error("%s", error);
		exit(CLI_USAGE);
	}
	return text;
}

static void make_token(struct web_token *token, const char *path)
{
	char error[512];

	if (path) {
		if (web_token_load(token, path, error, sizeof(error)) < 0) {
			cli_error("%s", error);
			exit(CLI_USAGE);
		}
		return;
	}
	int rc = web_token_create(token);
	if (rc < 0) {
		cli_error("no random numbers: %s", strerror(-rc));
		exit(CLI_FAILED);
	}
}

int main(int argc, char **argv)
{
	static struct web web;
	static struct eds eds[EDS_FILES];
	struct options o = {.bus = cli_default_bus(), .listen = "127.0.0.1:8410"};
	struct web_server_config server = {0};
	struct web_token token;
	char address[64], *texts[EDS_FILES], greeting[1024];
	size_t sizes[EDS_FILES];

	parse_options(&o, argc, argv);
	if (!web_listen_address(o.listen, address, &server.port))
		cli_usage_error("--listen %s: write an IP address and a port: 127.0.0.1:8410, [::1]:8410", o.listen);
	if (!web_is_loopback(address) && !o.token_file)
		cli_usage_error("--listen %s: others can reach this address: give --token-file, and put TLS before it "
				"(tools/web/README.md)",
			o.listen);
	make_token(&token, o.token_file);
	for (size_t i = 0; i < o.eds_count; i++)
		texts[i] = read_eds(o.eds_paths[i], &eds[i], &sizes[i]);
	server.address = address;
	server.hosts = o.hosts;
	server.host_count = o.host_count;
	server.signal_fd = cli_signal_fd();

	struct web_config config = {.bus = cli_open_bus(o.bus), .bus_name = o.bus, .token = &token, .eds = eds};
	config.eds_texts = (const char *const *)texts;
	config.eds_sizes = sizes;
	config.eds_count = o.eds_count;
	web_init(&web, &config, cli_now_us());
	snprintf(greeting, sizeof(greeting), "page:  http://%s/\ntoken: %s%s\n", o.listen, o.token_file ? "in " : "",
		o.token_file ? o.token_file : token.text);
	server.greeting = greeting;
	int rc = web_serve(&web, &server);
	web_free(&web);
	can_close(config.bus);
	for (size_t i = 0; i < o.eds_count; i++) {
		eds_free(&eds[i]);
		free(texts[i]);
	}
	return rc < 0 ? CLI_FAILED : CLI_OK;
}
