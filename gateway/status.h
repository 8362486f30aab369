/* gateway/status.h
 * What the device says about itself, to the tools as well: the bits of the status word 210Fh:3 beside those of
 * PIPELINE_... (model/pipeline.h), and its own EMCY codes. Those of the protocol are in gateway/canopen. */
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

enum {
	EMCY_SLOPE_LONG = 0x5010, /* CiA 410: the slope is beyond its range (2119h), or beyond what its objects hold */
	EMCY_SLOPE_LATERAL = 0x5020,   /* the same */
	EMCY_SENSOR_LOST = 0x5030,     /* no sample arrives; enum imu_fault and imu_chip in the manufacturer's bytes */
	EMCY_SENSOR_DEGRADED = 0x5031, /* a fault that samples go on with; bytes the same */
	EMCY_STORE_DAMAGED = 0x5530,   /* the stored values could not be read: defaults are in use */
	EMCY_CONFIGURATION =
		0x6320, /* the configuration objects contradict each other: the last good set stays in use */
	EMCY_SENSOR_SETTINGS = 0x6321, /* 2058h asks for what the sensor has not: it goes on as it was */
	EMCY_CAN_OVERRUN = 0x8110,     /* frames were lost: the bus took none for too long */
	EMCY_ERROR_PASSIVE = 0x8120,
	EMCY_BUS_OFF_OVER = 0x8140,
	EMCY_POSITION_UNSURE = 0xFF10, /* 1 sigma of the position exceeds 2040h:9 */
};

#endif
