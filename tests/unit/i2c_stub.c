#include "tests/unit/i2c_stub.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { EVERY_NS = 1000000, TRANSFER_NS = 20000, WRITABLE = 0x40 };

static void copy_registers(struct i2c_stub *stub, enum imu_chip chip)
{
	struct world *w = stub->world;
	const uint8_t address = sim_board_address(w->sim, chip);
	uint8_t *seen = stub->registers[address], *shadow = stub->shadow[address];
	const int64_t at_ns = w->now_ns;
	const uint8_t *now;

	for (uint8_t reg = 0; reg < WRITABLE; reg++)
		if (seen[reg] != shadow[reg]) {
			i2c_write(w->bus, address, reg, seen[reg]);
			shadow[reg] = seen[reg];
			w->now_ns = at_ns; /* this access takes no time */
		}
	now = sim_board_registers(w->sim, chip);
	for (int reg = 0; reg < 128; reg++)
		if (now[reg] != shadow[reg])
			shadow[reg] = seen[reg] = seen[reg | 0x80] = now[reg];
}

static void feed_at(struct i2c_stub *stub, int64_t ns)
{
	const int64_t now_ns = stub->world->now_ns;

	stub->world->now_ns = stub->fed_ns = ns;
	for (enum imu_chip chip = IMU_CHIP_GYRO; chip <= IMU_CHIP_MAG; chip++)
		if (sim_board_has(stub->world->sim, chip))
			copy_registers(stub, chip);
	stub->world->now_ns = now_ns;
}

/* Only the first copy after a write of the driver and the last one before a read matter. */
static void catch_up(struct i2c_stub *stub)
{
	const int64_t steps = (stub->world->now_ns - stub->fed_ns) / EVERY_NS, from_ns = stub->fed_ns;

	if (steps > 0)
		feed_at(stub, from_ns + EVERY_NS);
	if (steps > 1)
		feed_at(stub, from_ns + steps * EVERY_NS);
}

static bool answers(const struct i2c_stub *stub, uint8_t address)
{
	for (enum imu_chip chip = IMU_CHIP_GYRO; chip <= IMU_CHIP_MAG; chip++)
		if (sim_board_address(stub->world->sim, chip) == address)
			return true;
	return false;
}

static int stub_read(struct i2c_bus *bus, uint8_t address, uint8_t sub, uint8_t *bytes, size_t n)
{
	struct i2c_stub *stub = (struct i2c_stub *)bus;

	catch_up(stub);
	stub->world->now_ns += TRANSFER_NS;
	if (!answers(stub, address))
		return -ENXIO;
	for (size_t i = 0; i < n; i++)
		bytes[i] = stub->registers[address][(uint8_t)(sub + i)];
	return 0;
}

static int stub_write(struct i2c_bus *bus, uint8_t address, uint8_t sub, const uint8_t *bytes, size_t n)
{
	struct i2c_stub *stub = (struct i2c_stub *)bus;

	catch_up(stub);
	stub->world->now_ns += TRANSFER_NS;
	for (size_t i = 0; i < n; i++)
		stub->registers[address][(uint8_t)(sub + i)] = bytes[i];
	return 0;
}

static const struct i2c_ops OPS = {stub_read, stub_write, NULL};

void stub_begin(struct i2c_stub *stub, struct world *w)
{
	const struct board_clock clock = w->board.clock;
	char why[200];

	*stub = (struct i2c_stub){.bus.ops = &OPS, .world = w, .fed_ns = w->now_ns};
	for (enum imu_chip chip = IMU_CHIP_GYRO; chip <= IMU_CHIP_MAG; chip++) {
		const uint8_t address = sim_board_address(w->sim, chip);
		const uint8_t *now = sim_board_registers(w->sim, chip);

		memcpy(stub->shadow[address], now, 128);
		memcpy(stub->registers[address], now, 128);
		memcpy(stub->registers[address] + 128, now, 128);
	}
	if (board_detect(&w->board, &stub->bus, &clock, why, sizeof why) < 0) {
		fprintf(stderr, "%s\n", why);
		abort();
	}
}
