/* imu9-sdo watch: values again and again, as lines, CSV or JSON. */
#include <stdio.h>
#include <string.h>

#include "tools/lib/cli_time.h"
#include "tools/lib/cli_value.h"
#include "tools/sdo/sdo_json.h"
#include "tools/sdo/sdo_session.h"

struct watching {
	struct session *session;
	struct target targets[SDO_TARGETS_MAX];
	size_t count;
	bool utc, csv;
	uint64_t start_us;
};

/* A physical number without unit, a word, or a text; in quotes if it has a comma. */
static void print_csv(struct session *s, const struct target *target, const uint8_t *wire, size_t size)
{
	struct json_object *value = sdo_json_value(s, target, wire, size);
	char text[CLI_VALUE_TEXT_MAX];

	if (od_has_words(target->entry))
		sdo_value_text(s, target, wire, size, text, sizeof(text));
	else
		snprintf(text, sizeof(text), "%s", value ? json_object_get_string(value) : "");
	json_object_put(value);
	for (char *quote = text; (quote = strchr(quote, '"'));)
		*quote = '\'';
	printf(strchr(text, ',') ? ",\"%s\"" : ",%s", text);
}

static void print_header(const struct watching *w)
{
	char name[128];

	fputs("t [s],utc", stdout);
	for (size_t i = 0; i < w->count; i++) {
		const struct od_entry *entry = w->targets[i].entry;

		sdo_target_name(&w->targets[i], name, sizeof(name));
		printf(entry && entry->unit[0] ? ",%s [%s]" : ",%s", name, entry ? entry->unit : "");
	}
	putchar('\n');
}

/* The values of one instant: the time before them, and each after its separator. */
static void print_time(const struct watching *w, struct json_object *line, double t_s)
{
	char utc[CLI_UTC_TEXT], t[32];

	cli_utc_text(utc);
	if (line) {
		snprintf(t, sizeof(t), "%.3f", t_s);
		json_object_object_add(line, "t", json_object_new_double_s(t_s, t));
		json_object_object_add(line, "utc", json_object_new_string(utc));
	} else if (w->csv) {
		printf("%.3f,%s", t_s, utc);
	} else if (w->utc) {
		fputs(utc, stdout);
	} else if (!w->session->quiet) {
		printf("%10.3f s", t_s);
	}
}

static void print_value(
	const struct watching *w, const struct target *target, const uint8_t *wire, size_t size, bool first)
{
	struct session *s = w->session;
	char text[CLI_VALUE_TEXT_MAX], name[128];

	if (w->csv) {
		print_csv(s, target, wire, size);
		return;
	}
	sdo_value_text(s, target, wire, size, text, sizeof(text));
	sdo_target_name(target, name, sizeof(name));
	if (s->quiet)
		printf("%s%s", first && !w->utc ? "" : " ", text);
	else
		printf("  %s = %s", name, text);
}

static bool print_line(const struct watching *w)
{
	struct session *s = w->session;
	double t_s = (double)(cli_now_us() - w->start_us) / 1e6;
	struct json_object *line = s->json ? sdo_json_new(s) : NULL, *values = NULL;
	uint8_t wire[SDO_STRING_MAX];

	for (size_t i = 0; i < w->count; i++) {
		const struct target *target = &w->targets[i];

		if (!cli_node_read(&s->node, target->index, target->sub, wire, sizeof(wire))) {
			cli_node_explain(&s->node, target->entry);
			json_object_put(line);
			return false;
		}
		size_t size = s->node.sdo.size;
		if (i == 0)
			print_time(w, line, t_s);
		if (!line) {
			print_value(w, target, wire, size, i == 0);
			continue;
		}
		if (!values)
			values = sdo_json_array(line, "values");
		json_object_array_add(values, sdo_json_object(s, target, wire, size, true));
	}
	if (line)
		sdo_json_print(line, true);
	else
		putchar('\n');
	return fflush(stdout) == 0;
}

/* True: a signal arrived before that time. */
static bool wait_until(struct session *s, int signals, uint64_t until_us)
{
	struct can_msg msg;

	while (cli_now_us() < until_us) {
		if (cli_wait(s->node.bus, signals, until_us))
			return true;
		while (can_receive(s->node.bus, &msg, cli_now_us()) > 0)
			; /* late answers */
	}
	return false;
}

int sdo_command_watch(struct session *s, int argc, char **argv)
{
	static struct watching w;
	const char *rate_text = sdo_extract_value(&argc, argv, "--rate");
	const char *count_text = sdo_extract_value(&argc, argv, "--count");
	double rate_hz = rate_text ? cli_real_option("--rate", rate_text, 0.01, 1000) : 2;
	long left = count_text ? cli_integer_option("--count", count_text, 1, 1000000000) : -1;
	bool ok = true;

	w.session = s;
	w.utc = sdo_extract_flag(&argc, argv, "--utc");
	w.csv = sdo_extract_flag(&argc, argv, "--csv");
	if (w.csv && s->json)
		cli_usage_error("--csv and --json exclude each other");
	for (int i = 0; i < argc; i++)
		w.count += sdo_targets(s, argv[i], &w.targets[w.count], SDO_TARGETS_MAX - w.count);
	if (w.count == 0)
		cli_usage_error("usage: imu9-sdo watch OBJECT... [--rate HZ] [--count N] [--utc] [--csv|--json]");
	int signals = cli_signal_fd();
	sdo_open(s);
	uint64_t next_us = w.start_us = cli_now_us();
	if (w.csv)
		print_header(&w);
	while (ok && left != 0 && !wait_until(s, signals, next_us)) {
		ok = print_line(&w);
		next_us += (uint64_t)(1e6 / rate_hz);
		left -= left > 0;
	}
	sdo_close(s);
	return ok ? CLI_OK : CLI_FAILED;
}
