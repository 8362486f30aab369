#include "gateway/procedure_log.h"

#include <stdio.h>
#include <string.h>

enum { TEXT = 128 };

/* "gyro", "found", or "" for a number without a word. */
static void word_of(uint16_t index, uint8_t sub, uint8_t value, char *text, size_t capacity)
{
	od_words_text(od_find(&imu9_od_table, index, sub, NULL), value, text, capacity);
}

static void lever_arm_result(const struct od_values *v, char text[TEXT])
{
	snprintf(text, TEXT, ": %.1f +- %.1f, %.1f +- %.1f, %.1f +- %.1f mm",
		1e3 * (double)v->lever_arm_identification.l, 1e3 * (double)v->lever_arm_identification.sigma_l,
		1e3 * (double)v->lever_arm_identification.s, 1e3 * (double)v->lever_arm_identification.sigma_s,
		1e3 * (double)v->lever_arm_identification.t, 1e3 * (double)v->lever_arm_identification.sigma_t);
}

static void calibration_result(const struct od_values *v, char text[TEXT])
{
	snprintf(text, TEXT, ": bias %.4g, %.4g, %.4g, quality %.3g", (double)v->calibration.bias_x,
		(double)v->calibration.bias_y, (double)v->calibration.bias_z, (double)v->calibration.quality);
}

static void on_event(void *ctx, const struct command_object *c, const char *event)
{
	const struct procedure_log *p = ctx;
	const struct od_values *v = p->values;
	bool lever = c->index == OD_INDEX_LEVER_ARM_IDENTIFICATION;
	char kind[TEXT] = "", details[TEXT] = "";

	if (!lever)
		word_of(OD_INDEX_CALIBRATION, OD_SUB_CALIBRATION_KIND, v->calibration.kind, kind, sizeof(kind));
	if (strcmp(event, "refused") == 0) {
		strcpy(details, ": ");
		word_of(c->index, lever ? OD_SUB_LEVER_ARM_IDENTIFICATION_VERDICT : OD_SUB_CALIBRATION_VERDICT,
			*c->verdict, details + 2, sizeof(details) - 2);
	} else if (strcmp(event, "done") == 0 || strcmp(event, "accepted") == 0) {
		(lever ? lever_arm_result : calibration_result)(v, details);
	}
	event_log_line(p->log, *p->now_us, "%s%s %s%s", lever ? "lever arm identification" : "calibration ", kind,
		event, details);
}

void procedure_log_attach(struct procedure_log *p, struct command_group *group)
{
	group->on_event = on_event;
	group->ctx = p;
}
