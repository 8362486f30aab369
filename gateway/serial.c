#include "gateway/serial.h"

#include <ctype.h>
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "gateway/store.h"
#include "gateway/store_name.h"
#include "od/od.h"

enum { TEXT_MAX = 128, NUMBERS_MAX = 8, LINES_MAX = 16, NAME_MAX_LENGTH = 255, FILE_MAX = 8192 };

/* ---- numbers of the hardware ------------------------------------------------------------------------------------- */

struct hardware {
	uint32_t numbers[NUMBERS_MAX]; /* CRCs of the numbers, the best one first */
	size_t count;
};

/* The first line of a file, without white space around it; "" without one. */
static void read_text(const char *root, const char *path, char text[TEXT_MAX])
{
	char name[600];
	size_t size = 0;

	snprintf(name, sizeof(name), "%s/%s", root, path);
	FILE *f = fopen(name, "re");
	if (f) {
		size = fread(text, 1, TEXT_MAX - 1, f);
		fclose(f);
	}
	text[size] = '\0'; /* the device tree ends its texts with NUL */
	text[strcspn(text, "\r\n")] = '\0';
	for (size = strlen(text); size > 0 && isspace((unsigned char)text[size - 1]);)
		text[--size] = '\0';
}

/* Vendors leave "Default string", "To be filled by O.E.M.", 00000000 or 123456789 where a number should be. */
static bool is_number(const char *text)
{
	static const char *const placeholders[] = {"123456789", "0123456789", "03000200-0400-0500-0006-000700080009"};
	bool seen[256] = {false};
	int different = 0;

	for (const char *p = text; *p; p++) {
		different += !seen[(unsigned char)*p];
		seen[(unsigned char)*p] = true;
	}
	for (size_t i = 0; i < sizeof(placeholders) / sizeof(placeholders[0]); i++)
		if (strcmp(text, placeholders[i]) == 0)
			return false;
	return strlen(text) >= 5 && different >= 4 && !seen[' '] && strpbrk(text, "0123456789");
}

static void add(struct hardware *h, const char *text)
{
	if (is_number(text) && h->count < NUMBERS_MAX)
		h->numbers[h->count++] = od_crc32(0, text, strlen(text));
}

static int compare_texts(const void *a, const void *b)
{
	return strcmp(a, b);
}

/* Addresses that the hardware has of its own; sorted, since the order of names can change. */
static void add_mac_addresses(struct hardware *h, const char *root)
{
	char name[600], addresses[NUMBERS_MAX][TEXT_MAX], text[TEXT_MAX];
	struct dirent *entry;
	size_t n = 0;

	snprintf(name, sizeof(name), "%s/sys/class/net", root);
	DIR *dir = opendir(name);
	while (dir && n < NUMBERS_MAX && (entry = readdir(dir))) {
		snprintf(name, sizeof(name), "sys/class/net/%.255s/addr_assign_type", entry->d_name);
		read_text(root, name, text);
		if (strcmp(text, "0") != 0) /* NET_ADDR_PERM */
			continue;
		snprintf(name, sizeof(name), "sys/class/net/%.255s/type", entry->d_name);
		read_text(root, name, text);
		if (strcmp(text, "1") != 0) /* ARPHRD_ETHER */
			continue;
		snprintf(name, sizeof(name), "sys/class/net/%.255s/address", entry->d_name);
		read_text(root, name, addresses[n++]);
	}
	if (dir)
		closedir(dir);
	qsort(addresses, n, sizeof(addresses[0]), compare_texts);
	for (size_t i = 0; i < n; i++)
		add(h, addresses[i]);
}

/* Only root can read those of DMI. The number of a CAN adapter counts where the machine has none: adapters move. */
static struct hardware hardware_of(const char *root, const char *bus)
{
	static const char *const files[] = {"proc/device-tree/serial-number", "sys/class/dmi/id/product_uuid",
		"sys/class/dmi/id/product_serial", "sys/class/dmi/id/board_serial"};
	char text[TEXT_MAX], name[400], bus_name[NAME_MAX_LENGTH + 1];
	struct hardware h = {.count = 0};

	for (size_t i = 0; i < sizeof(files) / sizeof(files[0]); i++) {
		read_text(root, files[i], text);
		add(&h, text);
	}
	add_mac_addresses(&h, root);
	if (h.count == 0) {
		store_bus_name(bus_name, sizeof(bus_name), bus);
		snprintf(name, sizeof(name), "sys/class/net/%s/device/../serial", bus_name); /* of the USB device */
		read_text(root, name, text);
		add(&h, text);
	}
	return h;
}

/* No number at all: the installation has one. */
static uint32_t first_number(const struct hardware *h, const char *root)
{
	char machine[TEXT_MAX];

	if (h->count > 0)
		return h->numbers[0];
	read_text(root, "etc/machine-id", machine);
	return od_crc32(0, machine, strlen(machine));
}

/* Unknown on one side: it may be. */
static bool may_be_same(const struct hardware *a, const struct hardware *b)
{
	for (size_t i = 0; i < a->count; i++)
		for (size_t k = 0; k < b->count; k++)
			if (a->numbers[i] == b->numbers[k])
				return true;
	return a->count == 0 || b->count == 0;
}

/* ---- the file: for each gateway "SERIAL BUS NUMBER..." ----------------------------------------------------------- */

struct line {
	uint32_t serial;
	char bus[NAME_MAX_LENGTH + 1];
	struct hardware hardware;
};

struct table {
	struct line lines[LINES_MAX];
	size_t count;
};

static bool parse(struct line *line, const char *text)
{
	int used = 0;

	*line = (struct line){.serial = 0};
	if (sscanf(text, "%x %255s%n", &line->serial, line->bus, &used) != 2 || line->serial == 0)
		return false;
	for (text += used; line->hardware.count < NUMBERS_MAX; text += used)
		if (sscanf(text, "%x%n", &line->hardware.numbers[line->hardware.count], &used) != 1)
			break;
		else
			line->hardware.count++;
	return true;
}

/* The lines of this hardware; whether there was one of another. */
static bool read_table(struct table *table, const char *path, const struct hardware *hardware)
{
	bool foreign = false;
	char text[512];
	int fd = open(path, O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
	FILE *f = fd < 0 ? NULL : fdopen(fd, "r");

	table->count = 0;
	if (!f)
		return false;
	while (table->count < LINES_MAX && fgets(text, sizeof(text), f)) {
		struct line *line = &table->lines[table->count];

		if (!parse(line, text))
			continue;
		if (may_be_same(&line->hardware, hardware))
			table->count++;
		else
			foreign = true;
	}
	fclose(f);
	return foreign;
}

static int write_table(const struct table *table, const char *path)
{
	char text[FILE_MAX];
	size_t n = 0;

	for (size_t i = 0; i < table->count; i++) {
		const struct line *line = &table->lines[i];

		n += (size_t)snprintf(text + n, sizeof(text) - n, "%08X %s", line->serial, line->bus);
		for (size_t k = 0; k < line->hardware.count; k++)
			n += (size_t)snprintf(text + n, sizeof(text) - n, " %08X", line->hardware.numbers[k]);
		n += (size_t)snprintf(text + n, sizeof(text) - n, "\n");
	}
	return store_write(path, (const uint8_t *)text, n);
}

/* ---- the number -------------------------------------------------------------------------------------------------- */

/* Holds the number by a socket in the abstract name space, which the kernel releases with the process. False: another
 * process of this host has it. */
static bool claim(uint32_t serial)
{
	struct sockaddr_un name = {.sun_family = AF_UNIX};
	int length = snprintf(name.sun_path + 1, sizeof(name.sun_path) - 1, "imu9-gateway/serial/%08X", serial);
	int fd = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);

	if (fd < 0)
		return true;
	if (bind(fd, (struct sockaddr *)&name,
		    (socklen_t)(offsetof(struct sockaddr_un, sun_path) + 1 + (size_t)length)) == 0)
		return true; /* open until the process ends */
	bool taken = errno == EADDRINUSE;
	close(fd);
	return !taken;
}

static struct line *find(struct table *table, const char *bus)
{
	for (size_t i = 0; i < table->count; i++)
		if (strcmp(table->lines[i].bus, bus) == 0)
			return &table->lines[i];
	return NULL;
}

static bool in_table(const struct table *table, uint32_t serial)
{
	for (size_t i = 0; i < table->count; i++)
		if (table->lines[i].serial == serial)
			return true;
	return false;
}

/* The first of this hardware's numbers that no gateway has. */
static uint32_t derive(const struct table *table, uint32_t hardware)
{
	for (uint32_t k = 0;; k++) {
		uint32_t serial = k == 0 ? hardware : od_crc32(hardware, &k, sizeof(k));

		if (serial != 0 && !in_table(table, serial) && claim(serial))
			return serial;
	}
}

/* A new line; the last one is replaced when there are too many. */
static struct line *new_line(struct table *table, uint32_t serial)
{
	if (table->count < LINES_MAX)
		table->count++;
	table->lines[table->count - 1] = (struct line){.serial = serial};
	return &table->lines[table->count - 1];
}

/* The line of this bus; or the only one, whose bus has another name now. */
static struct line *choose(
	struct table *table, const char *bus, const struct hardware *h, const char *root, char note[SERIAL_NOTE_MAX])
{
	struct line *line = find(table, bus);

	if (line && !claim(line->serial))
		snprintf(note, SERIAL_NOTE_MAX,
			"serial number %08Xh is that of another gateway of this host, too: set --serial", line->serial);
	else if (!line && table->count == 1 && claim(table->lines[0].serial))
		line = &table->lines[0];
	return line ? line : new_line(table, derive(table, first_number(h, root)));
}

static void keep(struct table *table, struct line *line, const char *bus, const struct hardware *h, const char *path,
	char note[SERIAL_NOTE_MAX])
{
	struct line now = *line;

	snprintf(now.bus, sizeof(now.bus), "%s", bus);
	if (h->count > 0)
		now.hardware = *h;
	if (memcmp(&now, line, sizeof(now)) == 0)
		return;
	*line = now;
	int rc = write_table(table, path);
	if (rc < 0)
		snprintf(note, SERIAL_NOTE_MAX, "serial number %08Xh cannot be kept in %.100s: %s", line->serial, path,
			strerror(-rc));
}

uint32_t serial_number(
	const char *root, const char *folder, const char *bus, uint32_t configured, char note[SERIAL_NOTE_MAX])
{
	char path[STORE_PATH_MAX], lock_path[STORE_PATH_MAX + 8], bus_name[NAME_MAX_LENGTH + 1];
	struct table table;

	note[0] = '\0';
	if (configured) {
		if (!claim(configured))
			snprintf(note, SERIAL_NOTE_MAX,
				"serial number %08Xh is that of another gateway of this host, too: set another "
				"--serial",
				configured);
		return configured;
	}
	snprintf(path, sizeof(path), "%.500s/serial", folder);
	snprintf(lock_path, sizeof(lock_path), "%s.lock", path);
	store_bus_name(bus_name, sizeof(bus_name), bus);
	int lock = open(lock_path, O_RDWR | O_CREAT | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC, 0644);
	if (lock >= 0)
		flock(lock, LOCK_EX); /* another gateway reads and writes the table for a moment */
	struct hardware hardware = hardware_of(root, bus);
	bool foreign = read_table(&table, path, &hardware);
	struct line *line = choose(&table, bus_name, &hardware, root, note);
	if (foreign)
		snprintf(note, SERIAL_NOTE_MAX, "the serial number in %.100s is of other hardware; this one has %08Xh",
			path, line->serial);
	keep(&table, line, bus_name, &hardware, path, note);
	uint32_t serial = line->serial;
	if (lock >= 0)
		close(lock);
	return serial;
}
