/* Prints every bit of simulated samples: test_bits builds it with several compilers and compares. */
#include <stdio.h>

#include "model/sim/sensor.h"

static void print(struct vec3 v)
{
	printf(" %a %a %a", v.x, v.y, v.z);
}

int main(void)
{
	static struct sensor sensor;

	for (const struct signal *signal = SIGNALS; signal->name; signal++) {
		struct sensor_config config = SENSOR_PRESETS[0];

		config.gyro.step = config.accel.step = config.mag.step = 0; /* digits would hide the last bits */
		config.lever_arm_b_m = (struct vec3){0.01, 0.05, -0.02};
		config.jitter_s = 1e-4;
		if (sensor_init(&sensor, &config, 7) < 0)
			return 1;
		for (int i = 0; i < 3000; i++) {
			struct imu_sample sample;

			sensor_next(&sensor, signal, &sample, NULL);
			print(sample.gyro_rad_s);
			print(sample.accel_m_s2);
			print(sample.mag_uT);
			putchar('\n');
		}
	}
	return 0;
}
