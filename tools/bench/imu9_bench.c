/* tools/bench/imu9_bench.c
 * imu9-bench: where the time goes in a running gateway, from its histograms of latency (2149h to 214Bh, 2151h to
 * 2153h). */
#include <getopt.h>
#include <json-c/json.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/histogram.h"
#include "od_values.h"
#include "tools/lib/cli.h"
#include "tools/lib/cli_node.h"
#include "tools/lib/cli_value.h"
#include "tools/lib/json_value.h"

static const char help[] =
	"Usage: imu9-bench [-i BUS] [-n NODE] [-s SECS] [--bins] [--reset] [--json]\n"
	"Shows where the time goes in a running gateway: the histograms that it has of the age of samples in\n"
	"TPDOs, of the time from SYNC to TPDO, of the turns of its loop, and of the stages of a sample.\n"
	"\n"
	"  -i, --can BUS      the CAN bus, see below (default: $IMU9_CAN or vcan0)\n"
	"  -n, --node-id NODE node-ID 1 to 127 (default: $IMU9_NODE or 1)\n"
	"  -s, --seconds SECS empty the histograms first, and show what was measured in this time;\n"
	"                     without it: since the start of the gateway, or since they were emptied\n"
	"  -b, --bins         also each bin that is not empty, with a bar\n"
	"  -r, --reset        empty the histograms afterwards\n"
	"  -j, --json         print JSON\n"
	"  -t, --timeout MS   for one SDO answer (default 1000)\n"
	"  -h, --help         this text\n"
	"  -V, --version      the version\n"
	"\n"
	"Times are in us. Median, 99 % and 99.9 % are the ends of bins, which are up to a quarter too high;\n"
	"minimum, maximum and mean are exact. The processor time of a sample is that of the whole process.\n"
	"\n" CLI_EXIT_STATUS;

enum { TIMEOUT_MS = 1000, BAR_WIDTH = 50, HISTOGRAMS = 6, FIRST_STAGE = 3 /* of those in ns */ };

static const struct {
	const char *text;
	uint16_t index;
	uint8_t count, bins; /* sub-indices */
} OBJECTS[HISTOGRAMS] = {
	{"age of a sample in TPDOs", OD_INDEX_SAMPLE_AGE, OD_SUB_SAMPLE_AGE_COUNT, OD_SUB_SAMPLE_AGE_BINS},
	{"SYNC to TPDO", OD_INDEX_SYNC_TO_TPDO, OD_SUB_SYNC_TO_TPDO_COUNT, OD_SUB_SYNC_TO_TPDO_BINS},
	{"turn of the loop", OD_INDEX_LOOP_TURN, OD_SUB_LOOP_TURN_COUNT, OD_SUB_LOOP_TURN_BINS},
	{"sample: read", OD_INDEX_STAGE_READ, OD_SUB_STAGE_READ_COUNT, OD_SUB_STAGE_READ_BINS},
	{"sample: filter", OD_INDEX_STAGE_FILTER, OD_SUB_STAGE_FILTER_COUNT, OD_SUB_STAGE_FILTER_BINS},
	{"sample: publish", OD_INDEX_STAGE_PUBLISH, OD_SUB_STAGE_PUBLISH_COUNT, OD_SUB_STAGE_PUBLISH_BINS},
};

struct bench {
	const char *bus;
	long node_id;
	unsigned timeout_ms;
	double seconds; /* 0: since the start */
	bool bins, reset, json;

	struct cli_node node;
	struct histogram histograms[HISTOGRAMS];
	double cpu_us; /* for each sample */
};

/* ---- the node ---------------------------------------------------------------------------------------------------- */

static const struct od_entry *entry_of(uint16_t index, uint8_t sub)
{
	return od_find(&imu9_od_table, index, sub, NULL);
}

static bool empty(struct bench *b)
{
	static const uint8_t zero[4] = {0};

	for (int i = 0; i < HISTOGRAMS; i++) {
		if (cli_node_write(&b->node, OBJECTS[i].index, OBJECTS[i].count, zero, sizeof(zero)))
			continue;
		cli_node_explain(&b->node, entry_of(OBJECTS[i].index, OBJECTS[i].count));
		return false;
	}
	return true;
}

static bool read_all(struct bench *b)
{
	uint8_t wire[HISTOGRAM_WIRE];

	for (int i = 0; i < HISTOGRAMS; i++) {
		const struct od_entry *entry = entry_of(OBJECTS[i].index, OBJECTS[i].bins);

		if (!cli_node_read_large(&b->node, entry->index, entry->sub, wire, sizeof(wire))) {
			cli_node_explain(&b->node, entry);
			return false;
		}
		if (histogram_decode(&b->histograms[i], wire, b->node.sdo.size) < 0) {
			cli_error("%s is not a histogram of this version: use the imu9-bench of the gateway's version",
				entry->name);
			return false;
		}
	}
	const struct od_entry *cpu = entry_of(OD_INDEX_LOOP_TURN, OD_SUB_LOOP_TURN_CPU_PER_SAMPLE);
	if (!cli_node_read(&b->node, cpu->index, cpu->sub, wire, sizeof(wire))) {
		cli_node_explain(&b->node, cpu);
		return false;
	}
	b->cpu_us = cli_number(cpu, wire);
	return true;
}

/* A signal ends it early. */
static void measure(const struct bench *b)
{
	uint64_t end_us = cli_now_us() + (uint64_t)(b->seconds * 1e6);
	int signals = cli_signal_fd();
	struct can_msg msg;

	while (cli_now_us() < end_us && !cli_wait(b->node.bus, signals, end_us))
		while (can_receive(b->node.bus, &msg, cli_now_us()) > 0)
			;
}

/* ---- output ------------------------------------------------------------------------------------------------------ */

/* us for one step of the histogram. */
static double step_us(int i)
{
	return i < FIRST_STAGE ? 1 : 1e-3;
}

static double mean(const struct histogram *h)
{
	return h->count ? (double)h->sum / h->count : 0;
}

static void print_number(double us)
{
	printf("%10.*f", us < 1 ? 3 : us < 10 ? 2 : us < 1000 ? 1 : 0, us);
}

static void print_table(const struct bench *b)
{
	printf("%-26s%10s%10s%10s%10s%10s%10s%10s\n", "us", "count", "minimum", "median", "99 %", "99.9 %", "maximum",
		"mean");
	for (int i = 0; i < HISTOGRAMS; i++) {
		const struct histogram *h = &b->histograms[i];
		const double columns[] = {h->minimum, histogram_quantile(h, 0.5), histogram_quantile(h, 0.01),
			histogram_quantile(h, 0.001), h->maximum, mean(h)};

		printf("%-26s%10u", OBJECTS[i].text, h->count);
		for (size_t k = 0; h->count && k < sizeof(columns) / sizeof(columns[0]); k++)
			print_number(columns[k] * step_us(i));
		putchar('\n');
	}
	printf("processor time of a sample, in the last second:%9.1f us\n", b->cpu_us);
}

static void print_bins(const struct histogram *h, const char *text, double step)
{
	uint32_t most = 0;
	char bar[BAR_WIDTH + 1];

	if (h->count == 0)
		return;
	for (unsigned i = 0; i < HISTOGRAM_BINS; i++)
		most = h->bins[i] > most ? h->bins[i] : most;
	printf("\n%s, from us on\n", text);
	for (unsigned i = 0; i < HISTOGRAM_BINS; i++) {
		size_t width = (size_t)((double)h->bins[i] * BAR_WIDTH / most + 0.5);

		if (h->bins[i] == 0)
			continue;
		memset(bar, '#', width);
		bar[width] = '\0';
		print_number(histogram_lowest(i) * step);
		printf("%10u%s%s\n", h->bins[i], width ? "  " : "", bar);
	}
}

static void add_number(struct json_object *to, const char *key, double value)
{
	char text[32];

	snprintf(text, sizeof(text), "%.9g", value);
	json_object_object_add(to, key, json_number(text));
}

static struct json_object *json_histogram(const struct bench *b, int i)
{
	const struct histogram *h = &b->histograms[i];
	struct json_object *object = json_object_new_object(), *bins = json_object_new_array();
	const struct od_entry *entry = entry_of(OBJECTS[i].index, OBJECTS[i].bins);
	int length = (int)strcspn(entry->name, ".");

	json_object_object_add(object, "name", json_object_new_string_len(entry->name, length));
	json_object_object_add(object, "count", json_object_new_int64(h->count));
	add_number(object, "minimum", h->minimum * step_us(i));
	add_number(object, "median", histogram_quantile(h, 0.5) * step_us(i));
	add_number(object, "p99", histogram_quantile(h, 0.01) * step_us(i));
	add_number(object, "p999", histogram_quantile(h, 0.001) * step_us(i));
	add_number(object, "maximum", h->maximum * step_us(i));
	add_number(object, "mean", mean(h) * step_us(i));
	for (unsigned k = 0; k < HISTOGRAM_BINS; k++) {
		struct json_object *bin;

		if (h->bins[k] == 0)
			continue;
		bin = json_object_new_object();
		add_number(bin, "from", histogram_lowest(k) * step_us(i));
		json_object_object_add(bin, "count", json_object_new_int64(h->bins[k]));
		json_object_array_add(bins, bin);
	}
	json_object_object_add(object, "bins", bins);
	return object;
}

static void print_json(const struct bench *b)
{
	struct json_object *document = json_object_new_object(), *histograms = json_object_new_array();

	json_object_object_add(document, "node", json_object_new_int64(b->node_id));
	json_object_object_add(document, "bus", json_object_new_string(b->bus));
	json_object_object_add(document, "unit", json_object_new_string("us"));
	add_number(document, "cpu_per_sample", b->cpu_us);
	for (int i = 0; i < HISTOGRAMS; i++)
		json_object_array_add(histograms, json_histogram(b, i));
	json_object_object_add(document, "histograms", histograms);
	puts(json_object_to_json_string_ext(document, JSON_C_TO_STRING_PRETTY | JSON_C_TO_STRING_NOSLASHESCAPE));
	json_object_put(document);
}

static void print(const struct bench *b)
{
	if (b->json) {
		print_json(b);
		return;
	}
	print_table(b);
	for (int i = 0; b->bins && i < HISTOGRAMS; i++)
		print_bins(&b->histograms[i], OBJECTS[i].text, step_us(i));
}

/* ---- command line ------------------------------------------------------------------------------------------------ */

static void parse(struct bench *b, int argc, char **argv)
{
	static const struct option options[] = {CLI_BUS_OPTIONS, {"seconds", required_argument, NULL, 's'},
		{"bins", no_argument, NULL, 'b'}, {"reset", no_argument, NULL, 'r'}, {"json", no_argument, NULL, 'j'},
		{"timeout", required_argument, NULL, 't'}, CLI_COMMON_OPTIONS};
	int option;

	b->bus = cli_default_bus();
	b->node_id = cli_default_node();
	b->timeout_ms = TIMEOUT_MS;
	opterr = 0;
	while ((option = getopt_long(argc, argv, ":i:n:s:brjt:hV", options, NULL)) != -1) {
		switch (option) {
		case 'i':
			b->bus = optarg;
			break;
		case 'n':
			b->node_id = cli_integer_option("-n", optarg, 1, 127);
			break;
		case 's':
			b->seconds = cli_real_option("-s", optarg, 0.1, 1e6);
			break;
		case 'b':
			b->bins = true;
			break;
		case 'r':
			b->reset = true;
			break;
		case 'j':
			b->json = true;
			break;
		case 't':
			b->timeout_ms = (unsigned)cli_integer_option("-t", optarg, 1, 600000);
			break;
		case 'h':
			cli_print_help(help);
			exit(CLI_OK);
		case 'V':
			puts("imu9-bench " IMU9_VERSION);
			exit(CLI_OK);
		default:
			cli_bad_option(option, argv);
		}
	}
	if (optind < argc)
		cli_usage_error("unexpected argument '%s'", argv[optind]);
	if (b->json && b->bins)
		cli_usage_error("--json has the bins: leave --bins out");
}

int main(int argc, char **argv)
{
	static struct bench b;

	parse(&b, argc, argv);
	cli_node_open(&b.node, b.bus, (uint8_t)b.node_id, b.timeout_ms);
	bool ok = b.seconds == 0 || empty(&b);
	if (ok && b.seconds > 0)
		measure(&b);
	ok = ok && read_all(&b);
	if (ok)
		print(&b);
	ok = ok && (!b.reset || empty(&b));
	cli_node_close(&b.node);
	return ok ? CLI_OK : CLI_FAILED;
}
