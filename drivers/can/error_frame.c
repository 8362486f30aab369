#include "drivers/can/error_frame.h"

#include <linux/can.h>
#include <linux/can/error.h>

/* From linux/can/error.h of later kernels: data[6] and data[7] are the error counters. */
enum { ERROR_HAS_COUNTS = 0x200 };

static void set_bus_off(struct can_port *port)
{
	if (port->state != CAN_STATE_BUS_OFF)
		port->counters.bus_off++;
	port->state = CAN_STATE_BUS_OFF;
}

/* Some adapters (candleLight) report the return to error-active as a controller problem without any detail. */
static void set_controller_state(struct can_port *port, uint8_t controller)
{
	if ((controller & CAN_ERR_CRTL_RX_OVERFLOW) != 0)
		port->counters.rx_dropped++;
	if ((controller & (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)) != 0)
		port->state = CAN_STATE_PASSIVE;
	else if ((controller & (CAN_ERR_CRTL_RX_WARNING | CAN_ERR_CRTL_TX_WARNING)) != 0)
		port->state = CAN_STATE_WARNING;
	else if ((controller & CAN_ERR_CRTL_ACTIVE) != 0 || controller == CAN_ERR_CRTL_UNSPEC)
		port->state = CAN_STATE_ACTIVE;
}

void can_error_frame(struct can_port *port, uint32_t can_id, const uint8_t data[8])
{
	port->counters.errors++;
	if ((can_id & CAN_ERR_CRTL) != 0 && (can_id & CAN_ERR_BUSOFF) == 0)
		set_controller_state(port, data[1]);
	if ((can_id & (CAN_ERR_CRTL | ERROR_HAS_COUNTS)) != 0) {
		port->tx_errors = data[6];
		port->rx_errors = data[7];
	}
	if ((can_id & CAN_ERR_RESTARTED) != 0)
		port->state = CAN_STATE_ACTIVE;
	if ((can_id & CAN_ERR_BUSOFF) != 0)
		set_bus_off(port);
}
