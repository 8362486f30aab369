/* gateway/cia309/help.h
 * The texts of the command help: lines end with LF, the last one with none. */
#ifndef GATEWAY_CIA309_HELP_H
#define GATEWAY_CIA309_HELP_H

extern const char cia309_help[], cia309_help_types[], cia309_help_lss[];

#endif
