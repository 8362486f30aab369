/* tests/scenario/faults.h
 * The list of faults, and a site where they happen: the device (world.h) with a calibrated sensor at rest, on a bus
 * with a master. It sends SYNC every 10 ms, and every 100 ms the heartbeat of node 5 and a velocity (RPDO1) without a
 * measurement. The device watches all three (1006h, 1007h, 1016h, 1400h:5); the host's clock is synchronised.
 *
 * Each row of the list says what gateway/README.md and eds/README.md promise while the fault lasts, and how long after
 * its end all is as before. Simulated time, one thread. */
#ifndef TESTS_SCENARIO_FAULTS_H
#define TESTS_SCENARIO_FAULTS_H

#include "tests/scenario/world.h"

enum { SITE_OTHER_NODE = 5, SITE_EMCYS = 256, SITE_FAULTS = 8 };

struct site {
	struct world world;
	struct can_ops can;
	struct imu_ops imu;
	uint32_t seed, steps;
	int64_t host_offset_us;
	bool host_synchronised;
	bool sync, heartbeat, velocity; /* are sent */
	bool full;			/* the bus accepts no frame */
	bool off_again;			/* the controller goes bus-off after each restart */
	uint64_t off_us;		/* when it does; 0: not */
	/** The master starts a device that is not operational, takes it out of LSS configuration, and resets a
	 * position that exceeds its integers. */
	bool master_repairs;
	uint64_t age_us;	   /* of a SYNC, when the device gets it */
	uint64_t waited_us;	   /* since the last step */
	uint64_t sensor_offset_us; /* of its clock */
	bool stamp_ahead;	   /* the next time stamp is wrong */
	int disk_result;	   /* of each store */
	unsigned saves;		   /* that have succeeded */
	/** NULL, or told each frame that the device has received, and what it was before. */
	void (*heard)(struct site *, const struct can_msg *, enum nmt_state before, bool disk_waited);
	void (*saved)(struct site *); /* NULL, or told when a save has ended */
	unsigned disk_steps;	      /* that the present one has taken */
	const struct fault *faults[SITE_FAULTS];
	size_t fault_count;

	/* frames of the device since site_forget() */
	unsigned tpdos[4], heartbeats;
	struct {
		uint8_t data[8];
	} emcy[SITE_EMCYS];
	size_t emcy_count;  /* the first SITE_EMCYS are kept */
	uint16_t last_emcy; /* 0 after a boot-up */
	struct can_msg sdo; /* the last response */
};

/** What the signs of one fault need, and another one may take. */
enum {
	SAMPLES = 1 << 0,
	SENSOR_TIME = 1 << 1, /* that goes on as before */
	RECEPTION = 1 << 2,
	SENDING = 1 << 3,
	OPERATIONAL = 1 << 4,
	CONFIGURATION = 1 << 5, /* since the start */
	VALID_SET = 1 << 6,	/* of configuration objects: else the last one is used */
	SYNCS = 1 << 7,		/* as the master sends them */
	HEARTBEATS = 1 << 8,	/* a first one of node 5 */
	VELOCITIES = 1 << 9,	/* as the master sends them */
	CLIENTS = 1 << 10,	/* that wait for their turn */
	HOST_CLOCK = 1 << 11,
};

/** 2123h:2, the error LED; CiA 303-3. */
enum site_led { RED_OFF, RED_ON, RED_FLICKERING, RED_BLINKING, RED_SINGLE, RED_DOUBLE, RED_TRIPLE, RED_QUADRUPLE };

struct fault {
	const char *name;
	/** NULL: nothing happens then. `each`: before each sample. `sample` changes it; false: there is none. */
	void (*begin)(struct site *);
	void (*each)(struct site *);
	bool (*sample)(struct site *, struct imu_sample *);
	void (*end)(struct site *);
	/** Promises while it lasts, from `seen_s` after its beginning. */
	double seen_s;
	uint16_t code; /* of the EMCY; 0: none is sent */
	uint8_t error_register, info[5];
	uint16_t also[3];    /* codes of what it causes besides */
	uint16_t set, clear; /* bits of the status word */
	enum site_led led;
	bool pre_operational;	/* the device leaves operational */
	const char *log, *over; /* lines of the event log, parts of them: at its beginning, and after its end */
	bool brief;		/* code, status and LED are over before `seen_s` */
	/** How long after its end the error is over, and all is as before at the latest. These bits of the status word
	 * may stay for longer. */
	double over_s, recovered_s, lingering_s;
	uint16_t lingering;
	unsigned needs, takes; /* SAMPLES ...: what its signs need; what it takes from others */
};

extern const struct fault FAULTS[];
extern const size_t FAULT_COUNT;

/** A site that has been at rest for 12 s, operational. `s` is zeroed; `seed`: of the sensor's noise. */
void site_init(struct site *s, uint64_t seed);

void fault_begin(struct site *, const struct fault *);
void fault_end(struct site *, const struct fault *);

/** Time passes, in steps of 10 ms. */
void site_run(struct site *, double s);
void site_forget(struct site *);

/** A frame of another node, which the controller does not hear while it is bus-off or down. */
void site_send(struct site *, uint32_t id, size_t len, const void *data);
void site_send_msg(struct site *, const struct can_msg *);
/** Time passes without a sample, less than 10 ms. */
void site_wait(struct site *, uint64_t us);
/** A write as Modbus does it: in every NMT state. */
void site_set_real(struct site *, uint16_t index, uint8_t sub, float value);
/** Expedited upload: whether there was an answer, and that. */
bool site_read(struct site *, uint16_t index, uint8_t sub, uint32_t *value);

/** Whether the event log has this text. */
bool site_log_has(const struct site *, const char *text);

/** Lets a second pass and looks at communication alone: NULL, or what is wrong. */
const char *site_communicates(struct site *);
/** Lets a second pass and compares the device with what it was before all faults, but for these bits of the status
 * word. NULL, or what is not as before. */
const char *site_deviation(struct site *, unsigned but);

#endif
