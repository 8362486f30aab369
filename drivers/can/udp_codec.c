#include "drivers/can/udp_codec.h"

#include <assert.h>
#include <errno.h>
#include <mpack.h>
#include <string.h>

/* In the order in which python-can writes them. */
enum key {
	KEY_TIMESTAMP,
	KEY_ID,
	KEY_EXTENDED,
	KEY_REMOTE,
	KEY_ERROR,
	KEY_CHANNEL,
	KEY_DLC,
	KEY_DATA,
	KEY_FD,
	KEY_BITRATE_SWITCH,
	KEY_ERROR_STATE,
	KEY_COUNT,
};

static const char *const key_names[KEY_COUNT] = {
	[KEY_TIMESTAMP] = "timestamp",
	[KEY_ID] = "arbitration_id",
	[KEY_EXTENDED] = "is_extended_id",
	[KEY_REMOTE] = "is_remote_frame",
	[KEY_ERROR] = "is_error_frame",
	[KEY_CHANNEL] = "channel",
	[KEY_DLC] = "dlc",
	[KEY_DATA] = "data",
	[KEY_FD] = "is_fd",
	[KEY_BITRATE_SWITCH] = "bitrate_switch",
	[KEY_ERROR_STATE] = "error_state_indicator",
};

struct writer {
	mpack_tokbuf_t state;
	char *out;
	size_t left;
};

static void put(struct writer *w, mpack_token_t token)
{
	int result = mpack_write(&w->state, &w->out, &w->left, &token);

	assert(result == MPACK_OK);
	(void)result;
}

static void put_bytes(struct writer *w, const char *bytes, size_t size)
{
	if (size > 0) /* mpack expects no chunk after an empty string */
		put(w, mpack_pack_chunk(bytes, (mpack_uint32_t)size));
}

static mpack_token_t value_of(enum key key, const struct can_msg *msg)
{
	/* 0.0 in 8 bytes: no time stamp; the receiver's kernel adds one. mpack_pack_float() would write 4 bytes. */
	static const mpack_token_t no_time = {.type = MPACK_TOKEN_FLOAT, .length = 8};

	switch (key) {
	case KEY_TIMESTAMP:
		return no_time;
	case KEY_ID:
		return mpack_pack_uint(msg->id);
	case KEY_EXTENDED:
		return mpack_pack_boolean(msg->extended);
	case KEY_REMOTE:
		return mpack_pack_boolean(msg->remote);
	case KEY_CHANNEL:
		return mpack_pack_nil();
	case KEY_DLC:
		return mpack_pack_uint(msg->len);
	case KEY_DATA:
		return mpack_pack_bin(msg->remote ? 0 : msg->len);
	default: /* is_error_frame, is_fd, bitrate_switch, error_state_indicator */
		return mpack_pack_boolean(false);
	}
}

size_t can_udp_encode(const struct can_msg *msg, char out[CAN_UDP_MAX])
{
	struct writer w = {MPACK_TOKBUF_INITIAL_VALUE, out, CAN_UDP_MAX};

	put(&w, mpack_pack_map(KEY_COUNT));
	for (int key = 0; key < KEY_COUNT; key++) {
		size_t name_length = strlen(key_names[key]);
		mpack_token_t value = value_of((enum key)key, msg);

		put(&w, mpack_pack_str((mpack_uint32_t)name_length));
		put_bytes(&w, key_names[key], name_length);
		put(&w, value);
		if (key == KEY_DATA)
			put_bytes(&w, (const char *)msg->data, value.length);
	}
	return CAN_UDP_MAX - w.left;
}

struct reader {
	mpack_tokbuf_t state;
	const char *in;
	size_t left;
};

/* mpack_read() must not be called with no bytes left: it would read beyond them. */
static bool next(struct reader *r, mpack_token_t *token)
{
	return r->left > 0 && mpack_read(&r->state, &r->in, &r->left, token) == MPACK_OK;
}

/* Reads one token, and the bytes of a string or binary (NULL when empty). False: malformed or truncated. */
static bool get(struct reader *r, mpack_token_t *token, const char **bytes)
{
	mpack_token_t chunk;

	*bytes = NULL;
	if (!next(r, token))
		return false;
	if (token->type < MPACK_TOKEN_BIN || token->length == 0)
		return true;
	if (token->length > r->left || !next(r, &chunk))
		return false;
	*bytes = chunk.data.chunk_ptr;
	return true;
}

static int get_key(struct reader *r)
{
	mpack_token_t token;
	const char *bytes;

	if (!get(r, &token, &bytes) || token.type != MPACK_TOKEN_STR || bytes == NULL)
		return -EBADMSG;
	for (int key = 0; key < KEY_COUNT; key++)
		if (strlen(key_names[key]) == token.length && memcmp(key_names[key], bytes, token.length) == 0)
			return key;
	return -EBADMSG;
}

struct fields {
	uint64_t id, dlc;
	bool extended, remote, error, fd;
	const char *data;
	size_t data_size;
	uint32_t seen; /* bit = key */
};

static bool get_bool(const mpack_token_t *token, bool *value)
{
	*value = token->data.value.lo != 0;
	return token->type == MPACK_TOKEN_BOOLEAN;
}

static bool get_uint(const mpack_token_t *token, uint64_t *value)
{
	if (token->type != MPACK_TOKEN_UINT)
		return false;
	*value = mpack_unpack_uint(*token);
	return true;
}

static bool get_field(struct reader *r, struct fields *f)
{
	mpack_token_t token;
	const char *bytes;
	bool ignored;
	int key = get_key(r);

	if (key < 0 || !get(r, &token, &bytes))
		return false;
	f->seen |= 1u << key;
	switch ((enum key)key) {
	case KEY_ID:
		return get_uint(&token, &f->id);
	case KEY_DLC:
		return get_uint(&token, &f->dlc);
	case KEY_EXTENDED:
		return get_bool(&token, &f->extended);
	case KEY_REMOTE:
		return get_bool(&token, &f->remote);
	case KEY_ERROR:
		return get_bool(&token, &f->error);
	case KEY_FD:
		return get_bool(&token, &f->fd);
	case KEY_BITRATE_SWITCH:
	case KEY_ERROR_STATE:
		return get_bool(&token, &ignored);
	case KEY_DATA:
		f->data = bytes;
		f->data_size = token.length;
		return token.type == MPACK_TOKEN_BIN;
	case KEY_TIMESTAMP: /* the receiver's kernel stamps the datagram */
	case KEY_CHANNEL:
		return token.type != MPACK_TOKEN_ARRAY && token.type != MPACK_TOKEN_MAP;
	case KEY_COUNT:
		break;
	}
	return false;
}

static bool fields_are_valid(const struct fields *f)
{
	const uint32_t needed = 1u << KEY_ID | 1u << KEY_EXTENDED | 1u << KEY_DLC;

	if ((f->seen & needed) != needed)
		return false;
	if (f->id > (f->extended ? 0x1FFFFFFF : 0x7FF) || f->dlc > 8)
		return false;
	return f->remote ? f->data_size == 0 : f->data_size == f->dlc;
}

int can_udp_decode(const char *in, size_t size, struct can_msg *msg)
{
	struct reader r = {MPACK_TOKBUF_INITIAL_VALUE, in, size};
	struct fields f = {0};
	mpack_token_t map;
	const char *bytes;

	if (!get(&r, &map, &bytes) || map.type != MPACK_TOKEN_MAP)
		return -EBADMSG;
	for (uint32_t i = 0; i < map.length; i++)
		if (!get_field(&r, &f))
			return -EBADMSG;
	if (r.left != 0)
		return -EBADMSG;
	if (f.fd || f.error)
		return -ENOTSUP;
	if (!fields_are_valid(&f))
		return -EBADMSG;

	memset(msg->data, 0, sizeof(msg->data));
	if (f.data_size > 0)
		memcpy(msg->data, f.data, f.data_size);
	msg->id = (uint32_t)f.id;
	msg->extended = f.extended;
	msg->remote = f.remote;
	msg->len = (uint8_t)f.dlc;
	return 0;
}
