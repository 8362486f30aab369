#include "tools/monitor/output.h"

#include <json-c/json.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "gateway/canopen/canopen.h"
#include "od_index.h"
#include "tools/lib/cli_time.h"
#include "tools/lib/json_words.h"

enum { TEXT_MAX = 256 };

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

/* Calls print() for each column of a value. */
static void for_each_field(const struct watch *watch,
	void (*print)(void *ctx, const struct watch_pdo *pdo, const struct watch_field *field), void *ctx)
{
	for (size_t i = 0; i < watch->pdo_count; i++)
		for (size_t k = 0; watch->pdos[i].enabled && k < watch->pdos[i].field_count; k++)
			if (!shown_before(watch, i, k))
				print(ctx, &watch->pdos[i], &watch->pdos[i].fields[k]);
}

static uint64_t skipped_samples(const struct watch *watch)
{
	uint64_t most = 0;

	for (size_t i = 0; i < watch->pdo_count; i++)
		if (watch->pdos[i].enabled && watch->pdos[i].skipped > most)
			most = watch->pdos[i].skipped;
	return most;
}

/* ---- lines ---- */

static void print_unit(void *ctx, const struct watch_pdo *pdo, const struct watch_field *field)
{
	char name[TEXT_MAX];

	(void)ctx, (void)pdo;
	field_name(field, name, sizeof(name));
	if (field_unit(field)[0])
		printf(" %s[%s]", name, field_unit(field));
}

static void print_rate(const char *separator, const struct watch_rate *rate, uint64_t now_us, const char *none)
{
	double hz = watch_rate_hz(rate, now_us);

	if (hz > 0)
		printf("%s%.1f", separator, hz);
	else
		printf("%s%s", separator, none);
}

static void print_pair(void *ctx, const struct watch_pdo *pdo, const struct watch_field *field)
{
	char name[TEXT_MAX], value[TEXT_MAX];

	(void)ctx;
	field_name(field, name, sizeof(name));
	watch_field_text(field, value, sizeof(value));
	printf(" %s=%s", name, pdo->rate.count ? value : "-");
}

static void print_line(const struct watch *w, double t_s, uint64_t now_us)
{
	printf("t=%.2f nmt=%s", t_s, watch_nmt_text(watch_nmt_state(w, now_us)));
	print_rate(" sync_hz=", &w->sync, now_us, "-");
	for (size_t i = 0; i < w->pdo_count; i++) {
		char key[32];

		snprintf(key, sizeof(key), " tpdo%zu_hz=", i + 1);
		if (w->pdos[i].enabled)
			print_rate(key, &w->pdos[i].rate, now_us, "-");
	}
	for_each_field(w, print_pair, NULL);
	printf(" skipped=%llu emcy=%04X\n", (unsigned long long)skipped_samples(w), w->emcys[0].code);
}

/* ---- CSV ---- */

static void print_column(void *ctx, const struct watch_pdo *pdo, const struct watch_field *field)
{
	char name[TEXT_MAX];

	(void)ctx, (void)pdo;
	field_name(field, name, sizeof(name));
	printf(field_unit(field)[0] ? ",%s [%s]" : ",%s", name, field_unit(field));
}

static void print_cell(void *ctx, const struct watch_pdo *pdo, const struct watch_field *field)
{
	char value[TEXT_MAX];

	(void)ctx;
	watch_field_text(field, value, sizeof(value));
	printf(strchr(value, ',') ? ",\"%s\"" : ",%s", pdo->rate.count ? value : "");
}

static void print_csv(const struct watch *w, double t_s, uint64_t now_us)
{
	char utc[CLI_UTC_TEXT];

	cli_utc_text(utc);
	printf("%.3f,%s,%s", t_s, utc, watch_nmt_text(watch_nmt_state(w, now_us)));
	print_rate(",", &w->sync, now_us, "");
	for_each_field(w, print_cell, NULL);
	printf(",%llu,%04X\n", (unsigned long long)skipped_samples(w), w->emcys[0].code);
}

/* ---- JSON ---- */

static struct json_object *number(double value, const char *text)
{
	return isfinite(value) ? json_object_new_double_s(value, text) : NULL;
}

static void add_value(void *ctx, const struct watch_pdo *pdo, const struct watch_field *field)
{
	struct json_object *value = json_object_new_object();
	double physical = field->raw * field->step;
	char text[TEXT_MAX];

	field_name(field, text, sizeof(text));
	json_object_object_add(value, "name", json_object_new_string(text));
	snprintf(text, sizeof(text), "%.9g", physical);
	json_object_object_add(value, "value", pdo->rate.count ? number(physical, text) : NULL);
	if (field_unit(field)[0])
		json_object_object_add(value, "unit", json_object_new_string(field_unit(field)));
	if (od_has_words(field->entry) && pdo->rate.count)
		json_object_object_add(value, "words", json_words(field->entry, (uint64_t)field->raw));
	json_object_array_add(ctx, value);
}

static struct json_object *rate_or_null(const struct watch_rate *rate, uint64_t now_us)
{
	double hz = watch_rate_hz(rate, now_us);
	char text[32];

	snprintf(text, sizeof(text), "%.1f", hz);
	return hz > 0 ? json_object_new_double_s(hz, text) : NULL;
}

static void print_json(const struct watch *w, long node_id, double t_s, uint64_t now_us)
{
	struct json_object *line = json_object_new_object(), *values = json_object_new_array();
	char text[CLI_UTC_TEXT];

	json_object_object_add(line, "node", json_object_new_int64(node_id));
	snprintf(text, sizeof(text), "%.3f", t_s);
	json_object_object_add(line, "t", json_object_new_double_s(t_s, text));
	cli_utc_text(text);
	json_object_object_add(line, "utc", json_object_new_string(text));
	json_object_object_add(line, "nmt", json_object_new_string(watch_nmt_text(watch_nmt_state(w, now_us))));
	json_object_object_add(line, "sync_hz", rate_or_null(&w->sync, now_us));
	snprintf(text, sizeof(text), "%04X", w->emcys[0].code);
	json_object_object_add(line, "emcy", json_object_new_string(text));
	json_object_object_add(line, "skipped", json_object_new_int64((int64_t)skipped_samples(w)));
	for_each_field(w, add_value, values);
	json_object_object_add(line, "values", values);
	puts(json_object_to_json_string_ext(line, JSON_C_TO_STRING_SPACED | JSON_C_TO_STRING_NOSLASHESCAPE));
	json_object_put(line);
}

void output_header(enum output output, const struct watch *watch)
{
	if (output == OUTPUT_LINE) {
		fputs("# units:", stdout);
		for_each_field(watch, print_unit, NULL);
		putchar('\n');
	} else if (output == OUTPUT_CSV) {
		fputs("t [s],utc,nmt,sync [Hz]", stdout);
		for_each_field(watch, print_column, NULL);
		puts(",skipped,emcy");
	}
}

void output_values(enum output output, const struct watch *watch, long node_id, double t_s, uint64_t now_us)
{
	if (output == OUTPUT_JSON)
		print_json(watch, node_id, t_s, now_us);
	else if (output == OUTPUT_CSV)
		print_csv(watch, t_s, now_us);
	else
		print_line(watch, t_s, now_us);
	fflush(stdout);
}

/* ---- the table at the end ---- */

static double seconds(uint64_t from_us, uint64_t to_us)
{
	return (double)(to_us - from_us) * 1e-6;
}

void output_summary(const struct watch *w, uint64_t now_us)
{
	char name[TEXT_MAX], value[TEXT_MAX];

	printf("\n%-6s %7s %9s %10s %9s %9s\n", "PDO", "CAN-ID", "received", "rate [Hz]", "skipped", "repeated");
	for (size_t i = 0; i < w->pdo_count; i++) {
		const struct watch_pdo *pdo = &w->pdos[i];
		double span_s = seconds(pdo->rate.first_us, pdo->rate.last_us);
		char rate[32] = "-";

		if (!pdo->enabled)
			continue;
		if (span_s > 0)
			snprintf(rate, sizeof(rate), "%.1f", (double)(pdo->rate.count - 1) / span_s);
		printf("TPDO%zu %7Xh %9llu %10s %9llu %9llu\n", i + 1, pdo->id, (unsigned long long)pdo->rate.count,
			rate, (unsigned long long)pdo->skipped, (unsigned long long)pdo->repeated);
		for (size_t k = 0; k < pdo->field_count && pdo->rate.count; k++) {
			field_name(&pdo->fields[k], name, sizeof(name));
			watch_field_text(&pdo->fields[k], value, sizeof(value));
			printf("       %-28s %14s %s\n", name, value, field_unit(&pdo->fields[k]));
		}
	}
	printf("NMT state %s; %llu heartbeats, %llu SYNC, %llu EMCY%s%s\n", watch_nmt_text(watch_nmt_state(w, now_us)),
		(unsigned long long)w->heartbeat.count, (unsigned long long)w->sync.count,
		(unsigned long long)w->emcy.count, w->emcy.count ? ", the last: " : "",
		w->emcy.count ? emcy_code_text(w->emcys[0].code) : "");
}
