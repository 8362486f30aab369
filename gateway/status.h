/* gateway/status.h
 * The bits of the status word 210Fh:3 that the device adds to those of the pipeline (PIPELINE_..., model/pipeline.h).
 * The tools use them, too. */
#ifndef GATEWAY_STATUS_H
#define GATEWAY_STATUS_H

enum {
	STATUS_SATURATED = 1 << 8,	/* a scaled output exceeds its integer: raise its resolution object */
	STATUS_SENSOR_LOST = 1 << 9,	/* no samples; the values are those of the last one */
	STATUS_SENSOR_FAULT = 1 << 10,	/* a chip has a fault (2124h), or a value is at the limit of its range */
	STATUS_EXTERNAL_AID = 1 << 11,	/* an external velocity, yaw or standstill was used in the last second */
	STATUS_COMMISSIONING = 1 << 12, /* an identification (2060h) or a calibration (2061h) runs */
	STATUS_UTC = 1 << 13,		/* 2117h is the time of the sample */
};

#endif
