/* tools/lib/cli_value.h
 * Text form of object addresses and values. */
#ifndef TOOLS_LIB_CLI_VALUE_H
#define TOOLS_LIB_CLI_VALUE_H

#include <stdbool.h>
#include <stddef.h>

#include "od/od.h"

enum { CLI_VALUE_TEXT_MAX = 4 * OD_VALUE_MAX };

/** "0x2000:1", "2000h:1" or "0x2000" (sub-index 0). */
bool cli_address(const char *text, uint16_t *index, uint8_t *sub);

/** "lever_arm.l (2000h:01)", or "2000h:01" when there is no entry. */
void cli_address_text(uint16_t index, uint8_t sub, const struct od_entry *entry, char *text, size_t capacity);

/** A value in wire form as a number; 0 for strings. */
double cli_number(const struct od_entry *entry, const void *wire);

/** "0.05 m", "rigid_body", "123 (0.615 m/s^2)", "1073742209 (0x40000181)"; bytes in hex when the size does not match
 * the type. `step` is the physical value of 1. */
void cli_value_text(
	const struct od_entry *entry, double step, const void *wire, size_t size, char *text, size_t capacity);

/** "05 00": the first 32 bytes at most. */
void cli_hex_text(const void *wire, size_t size, char *text, size_t capacity);

/** A value with its type: "u16:5", "i8:-1", "r32:0.5", "str:abc", "hex:0102FF". OD_BAD_VALUE for any other form. */
enum od_status cli_typed_value(const char *text, void *wire, size_t capacity, size_t *size);

#endif
