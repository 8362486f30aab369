/* tests/rig/i2c_feed.c
 * i2c_feed [-b BOARD] [-s SCENARIO] [-n] BUS: simulates the chips of a board in an i2c-stub, e.g. /dev/i2c-0.
 *
 * Every millisecond, registers that the driver has written to the stub are copied to the simulated chips
 * (drivers/imu/sim/sim_chips.h), and their changed registers to the stub: at the register and, since a stub ignores the
 * auto-increment bit, also at the register with bit 7 set. A stub does not know that a register was read: data-ready
 * bits stay set and FIFOs do not empty, which the option `stub` tells the driver (i2c:BUS,stub).
 *
 * -n: without noise. When the registers are written, prints "start US", the start of the scenario in CLOCK_MONOTONIC.
 * Lines on stdin: brownout|freeze|stop|saturate gyro|accel|mag [0|1]. Ends with stdin's "quit" or a signal. */
#include <errno.h>
#include <fcntl.h>
#include <linux/i2c-dev.h>
#include <linux/i2c.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/prctl.h>
#include <unistd.h>

#include "drivers/imu/pololu/i2c_imu.h"
#include "drivers/imu/sim/sim_chips.h"

enum { WATCHED = 0x40, GAP = 2, EVERY_MS = 1, CHIPS = 3, SEED = 1 };

struct fed {
	enum imu_chip chip; /* one of the sensors at that address */
	uint8_t address;
	uint8_t shadow[128]; /* the registers of the stub */
};

static int bus_fd;
static struct sim_board *board;

static void die(const char *what)
{
	fprintf(stderr, "i2c_feed: %s: %s\n", what, strerror(errno));
	exit(1);
}

static void block(uint8_t address, uint8_t direction, uint8_t at, uint8_t *bytes, size_t n)
{
	union i2c_smbus_data data = {.block = {(uint8_t)n}};
	struct i2c_smbus_ioctl_data transfer = {
		.read_write = direction, .command = at, .size = I2C_SMBUS_I2C_BLOCK_DATA, .data = &data};

	memcpy(data.block + 1, bytes, n);
	if (ioctl(bus_fd, I2C_SLAVE_FORCE, (unsigned long)address) < 0 || ioctl(bus_fd, I2C_SMBUS, &transfer) < 0)
		die("stub");
	memcpy(bytes, data.block + 1, n);
}

/* Copies what the driver wrote to the chips. */
static void from_stub(struct fed *f)
{
	uint8_t now[WATCHED];

	block(f->address, I2C_SMBUS_READ, 0, now, 32);
	block(f->address, I2C_SMBUS_READ, 32, now + 32, 32);
	for (uint8_t reg = 0; reg < WATCHED; reg++) {
		if (now[reg] == f->shadow[reg])
			continue;
		i2c_write(sim_board_bus(board), f->address, reg, now[reg]);
		f->shadow[reg] = now[reg];
	}
}

static void put_run(struct fed *f, size_t first, size_t last)
{
	for (size_t at = first; at <= last; at += 32) {
		size_t n = last - at + 1 < 32 ? last - at + 1 : 32;

		block(f->address, I2C_SMBUS_WRITE, (uint8_t)at, f->shadow + at, n);
		block(f->address, I2C_SMBUS_WRITE, (uint8_t)(at | 0x80), f->shadow + at, n);
	}
}

/* Copies changed registers to the stub, close ones in one burst: status and data must change together. */
static void to_stub(struct fed *f)
{
	const uint8_t *regs = sim_board_registers(board, f->chip);
	size_t first = 0, last = 0;
	bool open = false;

	for (size_t reg = 0; reg < sizeof f->shadow; reg++) {
		if (regs[reg] == f->shadow[reg])
			continue;
		f->shadow[reg] = regs[reg];
		if (open && reg - last > GAP) {
			put_run(f, first, last);
			open = false;
		}
		if (!open)
			first = reg;
		open = true;
		last = reg;
	}
	if (open)
		put_run(f, first, last);
}

static bool obey(char *line)
{
	static const struct {
		const char *name;
		void (*put)(struct sim_board *, enum imu_chip, bool);
	} faults[] = {{"freeze", sim_board_freeze}, {"stop", sim_board_stop}, {"saturate", sim_board_saturate}};
	char what[16] = "", which[16] = "";
	int on = 1;
	enum imu_chip chip;

	if (sscanf(line, "%15s %15s %d", what, which, &on) < 1 || strcmp(what, "quit") == 0)
		return false;
	chip = which[0] == 'g' ? IMU_CHIP_GYRO : which[0] == 'a' ? IMU_CHIP_ACCEL : IMU_CHIP_MAG;
	if (strcmp(what, "brownout") == 0)
		sim_board_brown_out(board, chip);
	for (size_t i = 0; i < sizeof faults / sizeof *faults; i++)
		if (strcmp(what, faults[i].name) == 0)
			faults[i].put(board, chip, on);
	return true;
}

/* Adds the chips to `fed`, each address once. */
static size_t gather(struct fed *fed)
{
	size_t n = 0;

	for (enum imu_chip chip = IMU_CHIP_GYRO; chip <= IMU_CHIP_MAG; chip++) {
		bool known = false;

		for (size_t i = 0; i < n; i++)
			known |= fed[i].address == sim_board_address(board, chip);
		if (!known)
			fed[n++] = (struct fed){.chip = chip, .address = sim_board_address(board, chip)};
	}
	return n;
}

static void feed(void)
{
	struct fed fed[CHIPS];
	struct pollfd in = {STDIN_FILENO, POLLIN, 0};
	size_t n = gather(fed);
	char line[80];

	for (size_t i = 0; i < n; i++) {
		memcpy(fed[i].shadow, sim_board_registers(board, fed[i].chip), sizeof fed[i].shadow);
		put_run(&fed[i], 0, sizeof fed[i].shadow - 1);
	}
	printf("start %lld\n", (long long)(sim_board_start_ns(board) / 1000));
	fflush(stdout);
	for (;;) {
		for (size_t i = 0; i < n; i++) {
			from_stub(&fed[i]);
			to_stub(&fed[i]);
		}
		if (poll(&in, 1, EVERY_MS) <= 0)
			continue;
		if (!fgets(line, sizeof line, stdin))
			in.fd = -1; /* closed: continues until a signal */
		else if (!obey(line))
			return;
	}
}

int main(int argc, char **argv)
{
	struct sim_config config = {
		.board = "v3", .sensor = *sensor_preset("lsm303dlhc_l3gd20"), .seed = SEED, .now_ns = i2c_imu_now_ns};
	const char *scenario = "square";
	int option;

	while ((option = getopt(argc, argv, "b:s:n")) != -1) {
		if (option == 'b')
			config.board = optarg;
		else if (option == 's')
			scenario = optarg;
		else if (option == 'n')
			config.sensor = *sensor_preset("ideal");
	}
	config.signal = signal_find(scenario);
	sensor_calibrate(&config.sensor);
	if (optind + 1 != argc || !config.signal || sim_board_open(&config, &board) < 0) {
		fprintf(stderr, "usage: i2c_feed [-b v0|v1|v2|v3|v5|v6] [-s SCENARIO] [-n] /dev/i2c-N\n");
		return 2;
	}
	bus_fd = open(argv[optind], O_RDWR | O_CLOEXEC);
	if (bus_fd < 0)
		die(argv[optind]);
	prctl(PR_SET_TIMERSLACK, 1UL);
	feed();
	return 0;
}
