/* drivers/ports/sources.h
 * The kinds of BUS and SRC that can_open() and imu_open() accept, for --help: two lines each, the syntax and what it
 * is. The tables are in drivers/can/can.c and drivers/imu/imu.c; `make readme` copies them into drivers/README.md. */
#ifndef DRIVERS_PORTS_SOURCES_H
#define DRIVERS_PORTS_SOURCES_H

#include <stdio.h>

void can_print_sources(FILE *out);
void imu_print_sources(FILE *out);

#endif
