#include "drivers/can/gs_usb_find.h"

#include <ctype.h>
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* The USB IDs of Linux's gs_usb driver. */
static const char *const known_ids[] = {"1d50:606f", "1209:2323", "1cd2:606f", "16d0:10b8", "16d0:0f30", "1209:ca01"};

/* Reads the first line of a file; control characters are replaced, since the text goes to terminals. False: no such
 * file, or an empty one. */
static bool read_line(int dir, const char *file, char out[GS_USB_TEXT])
{
	int fd = openat(dir, file, O_RDONLY);
	ssize_t n = fd < 0 ? -1 : read(fd, out, GS_USB_TEXT - 1);

	if (fd >= 0)
		close(fd);
	out[n > 0 ? n : 0] = '\0';
	out[strcspn(out, "\n")] = '\0';
	for (char *c = out; *c != '\0'; c++)
		if (iscntrl((unsigned char)*c))
			*c = '?';
	return n > 0;
}

static bool is_known(const char *vendor, const char *product)
{
	char id[2 * GS_USB_TEXT];

	snprintf(id, sizeof(id), "%s:%s", vendor, product);
	for (size_t i = 0; i < sizeof(known_ids) / sizeof(known_ids[0]); i++)
		if (strcmp(id, known_ids[i]) == 0)
			return true;
	return false;
}

static bool read_adapter(int root, const char *name, struct gs_usb_adapter *adapter)
{
	char vendor[GS_USB_TEXT], product[GS_USB_TEXT], bus[GS_USB_TEXT], number[GS_USB_TEXT];
	int dir = openat(root, name, O_DIRECTORY);
	bool found;

	if (dir < 0)
		return false;
	found = read_line(dir, "idVendor", vendor) && read_line(dir, "idProduct", product) &&
		is_known(vendor, product) && read_line(dir, "busnum", bus) && read_line(dir, "devnum", number);
	if (found) {
		snprintf(adapter->place, sizeof(adapter->place), "%.63s", name);
		snprintf(adapter->node, sizeof(adapter->node), "/dev/bus/usb/%03lu/%03lu", strtoul(bus, NULL, 10),
			strtoul(number, NULL, 10));
		(void)read_line(dir, "serial", adapter->serial);
		(void)read_line(dir, "product", adapter->product);
	}
	close(dir);
	return found;
}

static int by_place(const void *a, const void *b)
{
	const struct gs_usb_adapter *x = a, *y = b;

	return strcmp(x->place, y->place);
}

size_t gs_usb_list(const char *root, struct gs_usb_adapter list[GS_USB_ADAPTERS])
{
	DIR *dir = opendir(root);
	const struct dirent *entry;
	size_t n = 0;

	if (dir == NULL)
		return 0;
	while (n < GS_USB_ADAPTERS && (entry = readdir(dir)) != NULL) {
		if (strchr(entry->d_name, ':') != NULL || entry->d_name[0] == '.')
			continue; /* an interface of a device */
		if (read_adapter(dirfd(dir), entry->d_name, &list[n]))
			n++;
	}
	closedir(dir);
	qsort(list, n, sizeof(*list), by_place);
	return n;
}

static void explain(const struct gs_usb_adapter *list, size_t n, const char *wanted, char *error, size_t error_size)
{
	size_t used;

	if (n == 0) {
		snprintf(error, error_size,
			"no gs_usb adapter (candleLight, CANable or similar) found: plug it in; `lsusb` lists the USB "
			"devices");
		return;
	}
	if (wanted[0] != '\0')
		snprintf(error, error_size, "no gs_usb adapter with the serial number or USB port '%s': use one of",
			wanted);
	else
		snprintf(error, error_size, "several gs_usb adapters found: use one of");
	for (size_t i = 0; i < n; i++) {
		used = strlen(error);
		snprintf(error + used, error_size - used, "%s gs_usb:%s (%s at %s)", i > 0 ? "," : "",
			gs_usb_name(&list[i]), list[i].product, list[i].place);
	}
}

int gs_usb_choose(const struct gs_usb_adapter *list, size_t n, const char *wanted, struct gs_usb_adapter *found,
	char *error, size_t error_size)
{
	const struct gs_usb_adapter *match = NULL;
	size_t matches = 0;

	for (size_t i = 0; i < n; i++) {
		if (strcmp(wanted, list[i].place) == 0) {
			*found = list[i];
			return 0;
		}
		if (wanted[0] == '\0' || strcmp(wanted, list[i].serial) == 0) {
			match = &list[i];
			matches++;
		}
	}
	if (matches == 1) {
		*found = *match;
		return 0;
	}
	explain(list, n, matches ? "" : wanted, error, error_size);
	return matches ? -ENOTUNIQ : -ENODEV;
}
