#include "gateway/record_text.h"

#include <ctype.h>
#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char RECORD_COLUMNS[] = "t,gx,gy,gz,ax,ay,az,mx,my,mz,temperature,clipped,ref_al,ref_as,ref_at,now_us,flags";

/* ---- samples ----------------------------------------------------------------------------------------------------- */

/* The fewest digits that read back to the same bits. */
static size_t number(char *out, double value)
{
	static const int DIGITS[] = {15, 16, 17};
	int n = 0;

	for (size_t i = 0; i < sizeof(DIGITS) / sizeof(DIGITS[0]); i++) {
		n = sprintf(out, "%.*g", DIGITS[i], value);
		if (strtod(out, NULL) == value)
			break;
	}
	return (size_t)n;
}

static size_t triad(char *out, struct vec3 v, bool known)
{
	const double values[] = {v.x, v.y, v.z};
	size_t n = 0;

	for (int i = 0; i < 3; i++) {
		n += known ? number(out + n, values[i]) : 0;
		out[n++] = ',';
	}
	return n;
}

static size_t sample_row(const struct record_entry *e, char *out)
{
	const struct imu_sample *s = &e->sample;
	size_t n = (size_t)sprintf(out, "%" PRIu64 ".%06" PRIu64 ",", s->t_us / 1000000, s->t_us % 1000000);

	n += triad(out + n, s->gyro_rad_s, true);
	n += triad(out + n, s->accel_m_s2, true);
	n += triad(out + n, s->mag_uT, s->flags & SAMPLE_MAG);
	n += s->flags & SAMPLE_TEMPERATURE ? number(out + n, s->temperature_degC) : 0;
	n += (size_t)sprintf(out + n, s->flags & SAMPLE_SATURATED ? ",1," : ",,");
	n += triad(out + n, s->ref_accel_b_m_s2, s->flags & SAMPLE_REFERENCE);
	return n + (size_t)sprintf(out + n, "%" PRIu64 ",%u\n", e->now_us, s->flags);
}

/* The end of the field; false: it is neither a number nor empty. */
static bool field(const char **text, double *value)
{
	char *end;

	*value = 0;
	if (**text != ',') {
		*value = strtod(*text, &end);
		if (end == *text)
			return false;
		*text = end;
	}
	return *(*text)++ == ',';
}

static bool field_triad(const char **text, struct vec3 *v)
{
	return field(text, &v->x) && field(text, &v->y) && field(text, &v->z);
}

static int parse_sample(const char *text, struct record_entry *e)
{
	struct imu_sample *s = &e->sample;
	uint64_t t_s, t_us;
	double clipped;
	int n = 0;

	*e = (struct record_entry){.kind = RECORD_SAMPLE};
	if (sscanf(text, "%" SCNu64 ".%6" SCNu64 ",%n", &t_s, &t_us, &n) != 2 || n == 0)
		return -EBADMSG;
	s->t_us = t_s * 1000000 + t_us;
	text += n;
	if (!field_triad(&text, &s->gyro_rad_s) || !field_triad(&text, &s->accel_m_s2) ||
		!field_triad(&text, &s->mag_uT) || !field(&text, &s->temperature_degC) || !field(&text, &clipped) ||
		!field_triad(&text, &s->ref_accel_b_m_s2))
		return -EBADMSG;
	n = 0;
	if (sscanf(text, "%" SCNu64 ",%u%n", &e->now_us, &s->flags, &n) != 2 || text[n] != '\0')
		return -EBADMSG;
	return 1;
}

/* ---- frames ------------------------------------------------------------------------------------------------------ */

/* As candump writes them: 181#0011223344, 701#R; a time of its own behind that. */
static size_t frame_row(const struct record_entry *e, char *out)
{
	const struct can_msg *msg = &e->msg;
	size_t n = (size_t)sprintf(
		out, msg->extended ? "# rx %" PRIu64 " %08X#" : "# rx %" PRIu64 " %03X#", e->now_us, msg->id);

	if (msg->remote)
		n += (size_t)sprintf(out + n, "R%u", msg->len);
	for (int i = 0; i < msg->len && !msg->remote; i++)
		n += (size_t)sprintf(out + n, "%02X", msg->data[i]);
	if (msg->t_us != e->now_us)
		n += (size_t)sprintf(out + n, " %" PRIu64, msg->t_us);
	return n + (size_t)sprintf(out + n, "\n");
}

static int digit(char c)
{
	return isdigit((unsigned char)c) ? c - '0' : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

static bool byte_of(const char *text, uint8_t *byte)
{
	int high = digit(text[0]), low = high < 0 ? -1 : digit(text[1]);

	if (low < 0)
		return false;
	*byte = (uint8_t)(16 * high + low);
	return true;
}

static int parse_frame(const char *text, struct record_entry *e)
{
	struct can_msg *msg = &e->msg;
	int at = 0, id = 0, length = 0;

	if (sscanf(text, "%" SCNu64 " %n%X%n#", &e->now_us, &id, &msg->id, &at) != 2 || text[at] != '#')
		return -EBADMSG;
	msg->extended = at - id == 8;
	text += at + 1;
	msg->remote = *text == 'R';
	for (; !msg->remote && length < 8 && byte_of(text, &msg->data[length]); text += 2)
		length++;
	if (msg->remote) {
		length = digit(text[1]);
		text += length < 0 ? 0 : 2;
	}
	msg->len = (uint8_t)length;
	msg->t_us = e->now_us;
	at = 0;
	if (*text && (*text != ' ' || sscanf(text, " %" SCNu64 "%n", &msg->t_us, &at) != 1 || text[at]))
		return -EBADMSG;
	return length >= 0 && length <= 8 ? 1 : -EBADMSG;
}

/* ---- writes ------------------------------------------------------------------------------------------------------ */

/* "# write 1000 2000 1 0000803F": time, index and sub-index in hexadecimal, bytes */
static size_t write_row(const struct record_entry *e, char *out)
{
	size_t n = (size_t)sprintf(out, "# write %" PRIu64 " %X %X ", e->now_us, e->write.index, e->write.sub);

	for (int i = 0; i < e->write.size; i++)
		n += (size_t)sprintf(out + n, "%02X", e->write.wire[i]);
	return n + (size_t)sprintf(out + n, "\n");
}

static int parse_write(const char *text, struct record_entry *e)
{
	struct record_write *w = &e->write;
	int at = 0;

	if (sscanf(text, "%" SCNu64 " %hX %hhX %n", &e->now_us, &w->index, &w->sub, &at) != 3 || at == 0)
		return -EBADMSG;
	for (text += at; w->size < sizeof(w->wire) && byte_of(text, &w->wire[w->size]); text += 2)
		w->size++;
	return *text ? -EBADMSG : 1;
}

/* ---- ports ------------------------------------------------------------------------------------------------------- */

static size_t bus_row(const struct record_bus *b, char *out)
{
	const struct can_counters *c = &b->counters;

	return (size_t)sprintf(out, "# bus %u %u %u %u %u %u %u %u %u %u %u %u %" PRIu64 " %" PRIu64 "\n", c->tx, c->rx,
		c->tx_retries, c->tx_dropped, c->rx_dropped, c->errors, c->bus_off, b->queued, b->state, b->bit_s,
		b->tx_errors, b->rx_errors, b->frames, b->bytes);
}

static int parse_bus(const char *text, struct record_bus *b)
{
	struct can_counters *c = &b->counters;
	int end = 0;
	int n = sscanf(text, "%u %u %u %u %u %u %u %u %hhu %u %hhu %hhu %" SCNu64 " %" SCNu64 "%n", &c->tx, &c->rx,
		&c->tx_retries, &c->tx_dropped, &c->rx_dropped, &c->errors, &c->bus_off, &b->queued, &b->state,
		&b->bit_s, &b->tx_errors, &b->rx_errors, &b->frames, &b->bytes, &end);

	return n == 14 && !text[end] && b->state <= CAN_STATE_DOWN ? 1 : -EBADMSG;
}

static size_t imu_row(const struct record_imu *i, char *out)
{
	const struct imu_health *h = &i->health;

	return (size_t)sprintf(out, "# imu %u %u %u %u %u %u %u %u %u %u %u %a %a %" PRIu64 "\n", i->counters.samples,
		i->counters.skipped, i->counters.late, h->fault, h->fault_chip, h->degraded, h->degraded_chip,
		h->self_test, h->bus_errors, h->restarts, h->overruns, (double)h->rate_hz, i->rate_hz, i->silence_us);
}

static int parse_imu(const char *text, struct record_imu *i)
{
	struct imu_health *h = &i->health;
	int end = 0;
	int n = sscanf(text, "%u %u %u %hhu %hhu %hhu %hhu %hhu %u %u %u %f %lf %" SCNu64 "%n", &i->counters.samples,
		&i->counters.skipped, &i->counters.late, &h->fault, &h->fault_chip, &h->degraded, &h->degraded_chip,
		&h->self_test, &h->bus_errors, &h->restarts, &h->overruns, &h->rate_hz, &i->rate_hz, &i->silence_us,
		&end);

	return n == 14 && !text[end] && i->rate_hz > 0 ? 1 : -EBADMSG;
}

static size_t self_row(const struct record_self *s, char *out)
{
	return (size_t)sprintf(out, "# recording %u %u %u %" PRId32 "\n", s->state, s->lost, s->kept, s->error);
}

static int parse_self(const char *text, struct record_self *s)
{
	int end = 0, n = sscanf(text, "%hhu %u %hu %" SCNd32 "%n", &s->state, &s->lost, &s->kept, &s->error, &end);

	return n == 4 && !text[end] ? 1 : -EBADMSG;
}

/* ---- all --------------------------------------------------------------------------------------------------------- */

enum { HAS_NOW = 1, HAS_VALUE = 2, HAS_OFFSET = 4 };

static const struct {
	const char *word;
	enum record_kind kind;
	int has; /* behind the word, of kinds without a function of their own */
} WORDS[] = {
	{"start", RECORD_START, HAS_NOW | HAS_VALUE},
	{"failed", RECORD_FAILED, HAS_NOW | HAS_VALUE},
	{"clock", RECORD_CLOCK, HAS_NOW | HAS_VALUE | HAS_OFFSET},
	{"saved", RECORD_SAVED, HAS_NOW | HAS_VALUE},
	{"away", RECORD_AWAY, HAS_NOW | HAS_OFFSET},
	{"tick", RECORD_TICK, HAS_NOW},
	{"answer", RECORD_ANSWER, HAS_VALUE},
	{"lost", RECORD_LOST, HAS_VALUE},
	{"others", .kind = RECORD_OTHERS},
	{"rx", .kind = RECORD_FRAME},
	{"write", .kind = RECORD_WRITE},
	{"bus", .kind = RECORD_BUS},
	{"imu", .kind = RECORD_IMU},
	{"recording", .kind = RECORD_SELF},
};
enum { WORD_COUNT = sizeof(WORDS) / sizeof(WORDS[0]) };

static size_t plain_row(const struct record_entry *e, char *out)
{
	size_t n = 0;

	for (size_t i = 0; i < WORD_COUNT; i++) {
		if (WORDS[i].kind != e->kind)
			continue;
		n = (size_t)sprintf(out, "# %s", WORDS[i].word);
		n += WORDS[i].has & HAS_NOW ? (size_t)sprintf(out + n, " %" PRIu64, e->now_us) : 0;
		n += WORDS[i].has & HAS_VALUE ? (size_t)sprintf(out + n, " %" PRId32, e->value) : 0;
		n += WORDS[i].has & HAS_OFFSET ? (size_t)sprintf(out + n, " %" PRId64, e->offset_us) : 0;
		out[n++] = '\n';
	}
	out[n] = '\0';
	return n;
}

size_t record_text(const struct record_entry *e, char out[RECORD_ROW_MAX])
{
	switch (e->kind) {
	case RECORD_SAMPLE:
		return sample_row(e, out);
	case RECORD_FRAME:
		return frame_row(e, out);
	case RECORD_WRITE:
		return write_row(e, out);
	case RECORD_BUS:
		return bus_row(&e->bus, out);
	case RECORD_IMU:
		return imu_row(&e->imu, out);
	case RECORD_SELF:
		return self_row(&e->self, out);
	default:
		return plain_row(e, out);
	}
}

/* Reads one number, if it is due. */
static bool take(const char **text, bool due, int64_t *value)
{
	char *end;

	*value = 0;
	if (!due)
		return true;
	*value = strtoll(*text, &end, 10);
	bool good = end != *text && (*end == '\0' || *end == ' ');
	*text = end + (*end == ' ');
	return good;
}

static int parse_plain(const char *text, int has, struct record_entry *e)
{
	int64_t now_us, value, offset_us;

	if (!take(&text, has & HAS_NOW, &now_us) || !take(&text, has & HAS_VALUE, &value) ||
		!take(&text, has & HAS_OFFSET, &offset_us) || *text || now_us < 0 || value != (int32_t)value)
		return -EBADMSG;
	e->now_us = (uint64_t)now_us;
	e->value = (int32_t)value;
	if (has & HAS_OFFSET)
		e->offset_us = offset_us;
	return e->kind == RECORD_FAILED && value >= 0 ? -EBADMSG : 1;
}

int record_parse(const char *line, struct record_entry *e)
{
	if (isdigit((unsigned char)line[0]))
		return parse_sample(line, e);
	if (strncmp(line, "# ", 2) != 0)
		return 0;
	line += 2;
	size_t length = strcspn(line, " ");

	for (size_t i = 0; i < WORD_COUNT; i++) {
		const char *numbers = line + length + (line[length] == ' ');

		if (strlen(WORDS[i].word) != length || strncmp(line, WORDS[i].word, length) != 0)
			continue;
		*e = (struct record_entry){.kind = WORDS[i].kind};
		switch (e->kind) {
		case RECORD_FRAME:
			return parse_frame(numbers, e);
		case RECORD_WRITE:
			return parse_write(numbers, e);
		case RECORD_BUS:
			return parse_bus(numbers, &e->bus);
		case RECORD_IMU:
			return parse_imu(numbers, &e->imu);
		case RECORD_SELF:
			return parse_self(numbers, &e->self);
		default:
			return parse_plain(numbers, WORDS[i].has, e);
		}
	}
	return 0;
}

/* ---- bytes ------------------------------------------------------------------------------------------------------- */

static const char BASE64[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

size_t record_base64(const uint8_t *bytes, size_t size, char *out)
{
	size_t n = 0;

	for (size_t i = 0; i < size; i += 3) {
		uint32_t group = (uint32_t)bytes[i] << 16 | (i + 1 < size ? (uint32_t)bytes[i + 1] << 8 : 0) |
				 (i + 2 < size ? bytes[i + 2] : 0);

		for (int k = 0; k < 4; k++)
			out[n++] = i + (size_t)k <= size ? BASE64[group >> (18 - 6 * k) & 63] : '=';
	}
	out[n] = '\0';
	return n;
}

long record_from_base64(const char *text, size_t length, uint8_t *out)
{
	long n = 0;

	for (size_t i = 0; i + 4 <= length; i += 4) {
		uint32_t group = 0;
		int padding = 0;

		for (int k = 0; k < 4; k++) {
			const char *at = text[i + (size_t)k] ? strchr(BASE64, text[i + (size_t)k]) : NULL;

			padding += text[i + (size_t)k] == '=';
			if (!at && !padding)
				return -EBADMSG;
			group = group << 6 | (at ? (uint32_t)(at - BASE64) : 0);
		}
		for (int k = 0; k < 3 - padding; k++)
			out[n++] = (uint8_t)(group >> (16 - 8 * k));
	}
	return length % 4 == 0 ? n : -EBADMSG;
}
