/* model/noise.h
 * Noise of the sensors (2020h), by which the filters weigh one measurement against another. The defaults
 * (PIPELINE_DEFAULTS) are the noise densities in the datasheets of the L3GD20 and the LSM303DLHC, and instabilities as
 * MEMS sensors of that kind have them; the angles' sigma is by judgement. And what both filters presume where there is
 * no measurement. */
#ifndef MODEL_NOISE_H
#define MODEL_NOISE_H

/* m/s^2, 1 sigma of the acceleration during missing samples. By judgement: a quick robot. */
#define GAP_ACCEL_M_S2 2.0
/** s. Over a longer interval the rate was not just between those of its samples, and the velocity is unknown: a gap. By
 * judgement: a hand changes its velocity by 1 m/s within that time. */
#define GAP_S 0.1

struct noise_config {
	/** rad, >= 0, default 0.05 degrees: 1 sigma of angles, given or fused, white from sample to sample. Used where
	 * rates come from angles: a smaller one makes the automatic lever-arm correction rely on them. */
	double angle_sigma_rad;
	/** rad/s/sqrt(Hz), >= 0, default 0.03 deg/s/sqrt(Hz): one-sided noise density of the gyro. A smaller one relies
	 * on its integration for longer, a larger one on the measurements. */
	double gyro_density_rad_s_sqrt_hz;
	/** rad/s, >= 0, default 0.01 deg/s: minimum of the Allan deviation of the gyro, by which its bias walks in 100
	 * s. A smaller one averages the bias for longer, a larger one follows it. */
	double gyro_bias_instability_rad_s;
	/** m/s^2/sqrt(Hz), >= 0, default 220 ug/sqrt(Hz): one-sided noise density of the accelerometer. As for the
	 * gyro. */
	double accel_density_m_s2_sqrt_hz;
	/** m/s^2, >= 0, default 0.1 mg: minimum of the Allan deviation of the accelerometer. As for the gyro. */
	double accel_bias_instability_m_s2;
	/** rad/s/K, >= 0, default 0.03 deg/s/K: 1 sigma by which the gyro's bias changes with temperature, where nobody
	 * has calibrated that. A smaller one relies on the bias for longer while the chip warms up. */
	double gyro_bias_per_K_rad_s;
	/** m/s^2/K, >= 0, default 0.5 mg/K: of the accelerometer. As for the gyro. */
	double accel_bias_per_K_m_s2;
	/** uT, >= 0, default 0.5: 1 sigma of one sample of the magnetometer, each axis, white. A smaller one relies on
	 * single samples, a larger one averages the heading over more of them. */
	double mag_sigma_uT;
};

#endif
