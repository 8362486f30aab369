#include "gateway/modbus/options.h"

#include <arpa/inet.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { TEXT_MAX = 256, BITS_MAX = 128, MAPPED_BITS = 96 };

static const char TCP_OPTIONS[] = "allow=NET, write=NET, clients=1 to 32, idle=1 to 86400 (s), rate=1 to 10000 (1/s)";
static const char RTU_OPTIONS[] =
	"baud=1200 to 921600, parity=even, odd or none, stop=1 or 2, address=1 to 247, write=yes or no";

static const uint8_t MAPPED[12] = {[10] = 0xFF, [11] = 0xFF};

static bool parse_number(const char *text, unsigned low, unsigned high, unsigned *value)
{
	char *end;

	errno = 0;
	unsigned long n = strtoul(text, &end, 10);
	if (text[0] < '0' || text[0] > '9' || *end || errno || n < low || n > high)
		return false;
	*value = (unsigned)n;
	return true;
}

static bool parse_net(const char *text, struct modbus_nets *nets)
{
	struct modbus_net net = {.bits = BITS_MAX};
	char address[INET6_ADDRSTRLEN];
	const char *slash = strchr(text, '/');
	size_t length = slash ? (size_t)(slash - text) : strlen(text);
	unsigned bits = BITS_MAX, before = 0;

	if (length >= sizeof(address) || nets->count == MODBUS_NETS_MAX)
		return false;
	memcpy(address, text, length);
	address[length] = '\0';
	if (inet_pton(AF_INET, address, net.address + sizeof(MAPPED)) == 1) {
		memcpy(net.address, MAPPED, sizeof(MAPPED));
		before = MAPPED_BITS;
	} else if (inet_pton(AF_INET6, address, net.address) != 1) {
		return false;
	}
	if (slash && !parse_number(slash + 1, 0, BITS_MAX - before, &bits))
		return false;
	net.bits = (uint8_t)(slash ? before + bits : BITS_MAX);
	nets->nets[nets->count++] = net;
	return true;
}

bool modbus_nets_have(const struct modbus_nets *nets, const uint8_t address[16])
{
	for (unsigned i = 0; i < nets->count; i++) {
		const struct modbus_net *net = &nets->nets[i];
		unsigned bytes = net->bits / 8, rest = net->bits % 8;
		uint8_t mask = (uint8_t)(0xFF00 >> rest);

		if (memcmp(address, net->address, bytes) == 0 &&
			(rest == 0 || ((address[bytes] ^ net->address[bytes]) & mask) == 0))
			return true;
	}
	return false;
}

/* The value of the option `name`, or NULL. */
static const char *value_of(const char *option, const char *name)
{
	size_t length = strlen(name);

	return strncmp(option, name, length) == 0 && option[length] == '=' ? option + length + 1 : NULL;
}

static bool parse_yes(const char *text, bool *yes)
{
	*yes = strcmp(text, "yes") == 0;
	return *yes || strcmp(text, "no") == 0;
}

static bool parse_parity(const char *text, char *parity)
{
	*parity = strcmp(text, "even") == 0 ? 'E' : strcmp(text, "odd") == 0 ? 'O' : 'N';
	return *parity != 'N' || strcmp(text, "none") == 0;
}

static bool tcp_option(struct modbus_window *w, const char *option)
{
	const char *value;

	if ((value = value_of(option, "allow")) != NULL)
		return parse_net(value, &w->allow);
	if ((value = value_of(option, "write")) != NULL)
		return parse_net(value, &w->write);
	if ((value = value_of(option, "clients")) != NULL)
		return parse_number(value, 1, MODBUS_CLIENTS_MAX, &w->clients);
	if ((value = value_of(option, "idle")) != NULL)
		return parse_number(value, 1, 86400, &w->idle_s);
	if ((value = value_of(option, "rate")) != NULL)
		return parse_number(value, 1, 10000, &w->rate);
	return false;
}

static bool rtu_option(struct modbus_window *w, const char *option)
{
	const char *value;
	unsigned n = 0;
	bool good = false;

	if ((value = value_of(option, "baud")) != NULL) {
		good = parse_number(value, 1200, 921600, &n);
		w->baud = (int)n;
	} else if ((value = value_of(option, "parity")) != NULL) {
		good = parse_parity(value, &w->parity);
	} else if ((value = value_of(option, "stop")) != NULL) {
		good = parse_number(value, 1, 2, &n);
		w->stop = (int)n;
	} else if ((value = value_of(option, "address")) != NULL) {
		good = parse_number(value, 1, 247, &n);
		w->address = (uint8_t)n;
	} else if ((value = value_of(option, "write")) != NULL) {
		good = parse_yes(value, &w->may_write);
	}
	return good;
}

/* HOST, HOST:PORT, [IPv6] or [IPv6]:PORT. */
static bool parse_host(struct modbus_window *w, const char *text)
{
	bool brackets = text[0] == '[';
	const char *end = brackets ? strchr(text, ']') : text + strcspn(text, ":");
	unsigned port = 0;

	if (!end || end == text)
		return false;
	int length = (int)(end - text - brackets);
	if (length == 0 || length >= (int)sizeof(w->host))
		return false;
	snprintf(w->host, sizeof(w->host), "%.*s", length, text + brackets);
	end += brackets;
	if (*end == '\0')
		return true;
	if (*end != ':' || !parse_number(end + 1, 1, 65535, &port))
		return false;
	snprintf(w->port, sizeof(w->port), "%u", port);
	return true;
}

/* Without a list this host may read. */
static void default_nets(struct modbus_window *w)
{
	if (w->allow.count > 0)
		return;
	parse_net("127.0.0.0/8", &w->allow);
	parse_net("::1", &w->allow);
}

static int parse(struct modbus_window *w, char *text, char *error, size_t error_size)
{
	char *option = strsep(&text, ",");

	w->serial = strncmp(option, "rtu:", 4) == 0;
	if (!w->serial && strncmp(option, "tcp:", 4) != 0) {
		snprintf(error, error_size, "'%.60s' is no Modbus window: write tcp:HOST:PORT or rtu:DEVICE", option);
		return -EINVAL;
	}
	if (w->serial ? option[4] == '\0' || strlen(option + 4) >= sizeof(w->device) : !parse_host(w, option + 4)) {
		snprintf(error, error_size, "Modbus window '%.60s': write %s", option,
			w->serial ? "rtu:DEVICE, such as rtu:/dev/ttyUSB0"
				  : "tcp:HOST:PORT, such as tcp:127.0.0.1:1502");
		return -EINVAL;
	}
	if (w->serial)
		strcpy(w->device, option + 4);
	while ((option = strsep(&text, ",")) != NULL)
		if (!(w->serial ? rtu_option : tcp_option)(w, option)) {
			snprintf(error, error_size,
				"unknown Modbus option, bad value or more than %d of a kind: '%.60s': use %s",
				MODBUS_NETS_MAX, option, w->serial ? RTU_OPTIONS : TCP_OPTIONS);
			return -EINVAL;
		}
	default_nets(w);
	return 0;
}

int modbus_options_parse(struct modbus_window *window, const char *text, char *error, size_t error_size)
{
	char copy[TEXT_MAX];

	*window = (struct modbus_window){.port = "502",
		.clients = 8,
		.idle_s = 60,
		.rate = 200,
		.baud = 19200,
		.stop = 1,
		.parity = 'E',
		.address = 1};
	if (strlen(text) >= sizeof(copy)) {
		snprintf(error, error_size, "'%.40s...' is too long for a Modbus window", text);
		return -EINVAL;
	}
	strcpy(copy, text);
	return parse(window, copy, error, error_size);
}
