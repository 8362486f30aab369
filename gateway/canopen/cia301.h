/* gateway/canopen/cia301.h
 * Numbers of CiA 301 (V4.2) that have no name in the generated od_index.h, for the core, the device and the tools: the
 * identifiers of the pre-defined connection set, the bits of a COB-ID, and the ranges of the PDO parameters. */
#ifndef GATEWAY_CANOPEN_CIA301_H
#define GATEWAY_CANOPEN_CIA301_H

#include <stdbool.h>
#include <stdint.h>

/** 11-bit identifiers (7.3.3, 7.3.5; LSS: CiA 305). The node-ID is added to those of SDO and of error control. */
#define CAN_ID_NMT	     0x000u
#define CAN_ID_SDO_RESPONSE  0x580u
#define CAN_ID_SDO_REQUEST   0x600u
#define CAN_ID_ERROR_CONTROL 0x700u /* boot-up, heartbeat, node guarding */
#define CAN_ID_LSS_RESPONSE  0x7E4u
#define CAN_ID_LSS_REQUEST   0x7E5u

/** A COB-ID as an object holds it. Bit 30 means something else in each object that has it. */
#define COB_ID_MASK	0x7FFu	   /* the 11-bit identifier; 29-bit ones are not supported */
#define COB_ID_INVALID	(1u << 31) /* PDO, SDO, EMCY: not in use */
#define COB_ID_NO_RTR	(1u << 30) /* PDO: no remote request */
#define COB_ID_PRODUCES (1u << 30) /* SYNC, TIME: this node sends it */
#define COB_ID_CONSUMES (1u << 31) /* TIME: this node uses it */

/** PDO parameters (7.5.2.35 to 7.5.2.38): four blocks of PDO_INDICES objects. The mapping of a PDO is PDO_MAPPING above
 * its communication parameter. */
enum {
	PDO_FIRST_RPDO = 0x1400,
	PDO_FIRST_TPDO = 0x1800,
	PDO_MAPPING = 0x200,
	PDO_INDICES = 0x200,
	PDO_LAST_OBJECT = PDO_FIRST_TPDO + PDO_MAPPING + PDO_INDICES - 1, /* 1BFFh */
};

/** 1400h to 1BFFh: a communication parameter or a mapping. */
static inline bool is_pdo_object(uint16_t index)
{
	return index >= PDO_FIRST_RPDO && index <= PDO_LAST_OBJECT;
}

/** 1600h to 17FFh, 1A00h to 1BFFh. */
static inline bool is_pdo_mapping(uint16_t index)
{
	return is_pdo_object(index) && (index & PDO_MAPPING);
}

/** 1400h to 15FFh, 1800h to 19FFh. */
static inline bool is_pdo_communication(uint16_t index)
{
	return is_pdo_object(index) && !(index & PDO_MAPPING);
}

#endif
