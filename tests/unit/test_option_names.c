/* The options of IMU sources and CAN buses are known by their whole names. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <stdbool.h>
#include <string.h>

#include "drivers/ports/can.h"
#include "drivers/ports/imu.h"

/* Each with one option of the form NAME=VALUE. */
static const char *const SOURCES[] = {"sim:rest,rate=100", "sim:rest,board=v3", "i2c:/dev/i2c-1,drdy=gpiochip0:5",
	"i2c:/dev/i2c-1,config=/lib/firmware/bmi270.fw", "spi:/dev/spidev0.0,mode=0", "spi:/dev/spidev0.0,speed=100000",
	"spi:/dev/spidev0.0,drdy=gpiochip0:5", "wt901:/dev/ttyUSB0,baud=115200", "wt901:/dev/ttyUSB0,address=80"};
static const char *const BUSES[] = {"udp,interface=lo", "udp,hosts=any", "gs_usb:0042:1,bitrate=125000",
	"gs_usb,sample-point=0.8", "slcan:/dev/ttyUSB0,bitrate=125000", "gs_usb,bitrate=125000"};

static bool accepts(bool bus, const char *text)
{
	char error[400];

	return (bus ? can_open(text, NULL, error, sizeof(error)) : imu_open(text, NULL, NULL, error, sizeof(error))) ==
	       0;
}

/* Another character in the place of each of the name and of "=". */
static void assert_whole_name(bool bus, const char *good)
{
	const char *equals = strchr(good, '='), *name = equals;
	char text[100];

	while (name[-1] != ',')
		name--;
	if (!accepts(bus, good))
		fail_msg("%s is refused", good);
	for (const char *at = name; at <= equals; at++) {
		strcpy(text, good);
		text[at - good] = ':';
		if (accepts(bus, text))
			fail_msg("%s is accepted", text);
	}
}

static void test_an_option_has_its_whole_name(void **state)
{
	(void)state;
	for (size_t i = 0; i < sizeof(SOURCES) / sizeof(SOURCES[0]); i++)
		assert_whole_name(false, SOURCES[i]);
	for (size_t i = 0; i < sizeof(BUSES) / sizeof(BUSES[0]); i++)
		assert_whole_name(true, BUSES[i]);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_an_option_has_its_whole_name),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
