/* model/fusion.h — H1 completes: state struct, init, step */
#ifndef MODEL_FUSION_H
#define MODEL_FUSION_H

#include "model/quat.h"
#include "model/sample.h"

enum fusion_algorithm { FUSION_MADGWICK = 0, FUSION_MAHONY = 1 };

struct fusion_config {
	enum fusion_algorithm algorithm;
	int use_magnetometer;  /* 0: 6D, heading free; 1: 9D */
	double madgwick_beta;  /* rad/s: gradient step */
	double mahony_kp_rad_s, mahony_ki_rad_s2;
};
#endif
