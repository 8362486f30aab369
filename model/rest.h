/* model/rest.h — H1 completes */
#ifndef MODEL_REST_H
#define MODEL_REST_H

struct rest_config {
	double gyro_threshold_rad_s; /* deviation from its slow mean */
	double accel_threshold_m_s2;
	double time_s;               /* both below for that long: at rest */
};
#endif
