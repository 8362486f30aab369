#include "gateway/store_name.h"

#include <dirent.h>
#include <errno.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include "gateway/store.h"

static const char ENDING[] = ".store";

static void file_name(char *out, size_t size, const char *text, size_t length)
{
	snprintf(out, size, "%.*s", (int)length, text);
	for (char *p = out; *p; p++)
		if (strchr("/:[] ", *p))
			*p = '_';
}

void store_bus_name(char *out, size_t size, const char *bus)
{
	file_name(out, size, bus, strcspn(bus, ",@"));
}

void store_path(char *path, size_t size, const char *folder, const char *bus)
{
	char name[256];

	store_bus_name(name, sizeof(name), bus);
	snprintf(path, size, "%s/%s%s", folder, name, ENDING);
}

/* "udp,hosts=any.store" for "udp", "slcan__dev_ttyACM0@115200.store", "node-5.store". */
static bool is_earlier(const char *file, const char *bus_name, const char *node_name)
{
	size_t length = strlen(file), bus = strlen(bus_name);

	if (strcmp(file, node_name) == 0)
		return true;
	return length > bus + sizeof(ENDING) && strncmp(file, bus_name, bus) == 0 && strchr(",@", file[bus]) &&
	       strcmp(file + length - strlen(ENDING), ENDING) == 0;
}

static bool newer(const struct timespec *a, const struct timespec *b)
{
	return a->tv_sec > b->tv_sec || (a->tv_sec == b->tv_sec && a->tv_nsec > b->tv_nsec);
}

int store_take_over(const char *path, const char *folder, const char *bus, unsigned node_id, char *old, size_t size)
{
	char bus_name[256], node_name[32], name[STORE_PATH_MAX + 256];
	struct timespec newest = {0};
	struct stat status;
	struct dirent *entry;

	old[0] = '\0';
	DIR *dir = lstat(path, &status) < 0 && errno == ENOENT ? opendir(folder) : NULL;
	if (!dir)
		return 0;
	store_bus_name(bus_name, sizeof(bus_name), bus);
	snprintf(node_name, sizeof(node_name), "node-%u%s", node_id, ENDING);
	while ((entry = readdir(dir))) {
		snprintf(name, sizeof(name), "%.500s/%.255s", folder, entry->d_name);
		if (!is_earlier(entry->d_name, bus_name, node_name) || lstat(name, &status) < 0 ||
			!S_ISREG(status.st_mode) || (old[0] && !newer(&status.st_mtim, &newest)))
			continue;
		newest = status.st_mtim;
		snprintf(old, size, "%s", name);
	}
	closedir(dir);
	if (!old[0])
		return 0;
	return rename(old, path) < 0 ? -errno : 1;
}
