/* model/noise.h
 * How noisy the sensors are (2020h): what the filters that weigh one measurement against another go by. */
#ifndef MODEL_NOISE_H
#define MODEL_NOISE_H

struct noise_config {
	double angle_sigma_rad;		   /* of given or fused angles, white from sample to sample */
	double gyro_density_rad_s_sqrt_hz; /* one-sided, as in datasheets */
	double gyro_bias_instability_rad_s;
	double accel_density_m_s2_sqrt_hz;
	double accel_bias_instability_m_s2;
};

#endif
