/* gateway/modbus/options.h
 * The argument of --modbus: where the Modbus server listens, and for whom.
 *
 *	tcp:HOST[:PORT][,allow=NET]...[,write=NET]...[,clients=N][,idle=S][,rate=N]
 *	rtu:DEVICE[,baud=B][,parity=even|odd|none][,stop=1|2][,address=A][,write=yes]
 *
 * NET is an address, or an address and the number of bits that count: 192.168.1.0/24. HOST is a name or an address,
 * IPv6 in brackets. Pure, any thread. */
#ifndef GATEWAY_MODBUS_OPTIONS_H
#define GATEWAY_MODBUS_OPTIONS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { MODBUS_NETS_MAX = 8, MODBUS_CLIENTS_MAX = 32, MODBUS_WINDOWS_MAX = 4 };

/** IPv4 as IPv6 addresses that contain it (RFC 4291, 2.5.5.2). */
struct modbus_net {
	uint8_t address[16];
	uint8_t bits;
};

struct modbus_nets {
	struct modbus_net nets[MODBUS_NETS_MAX];
	unsigned count;
};

struct modbus_window {
	bool serial;
	/* TCP */
	char host[64], port[8];
	struct modbus_nets allow, write; /* who may read, and which of them may write */
	unsigned clients;		 /* open at the same time */
	unsigned idle_s;		 /* a client without a request for so long is disconnected */
	unsigned rate;			 /* requests a second of each client */
	/* RTU */
	char device[128];
	int baud, stop;
	char parity; /* N, E, O */
	uint8_t address;
	bool may_write;
};

/** 0; -EINVAL and a reason. */
int modbus_options_parse(struct modbus_window *window, const char *text, char *error, size_t error_size);

bool modbus_nets_have(const struct modbus_nets *nets, const uint8_t address[16]);

#endif
