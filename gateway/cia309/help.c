#include "gateway/cia309/help.h"

const char cia309_help[] =
	"\n"
	"\"[\" SEQUENCE \"]\" and one of these, on one line; # begins a comment:\n"
	"\n"
	"[[NET] NODE] r[ead] INDEX SUB [TYPE]           SDO upload, without TYPE in hex\n"
	"[[NET] NODE] w[rite] INDEX SUB TYPE VALUE      SDO download\n"
	"[[NET] NODE] start | stop | preop[erational]   NMT, NODE 0: all\n"
	"[[NET] NODE] reset node | comm[unication]\n"
	"[[NET] NODE] r[ead] p[do] N                    the values that TPDO N of this device has now\n"
	"[[NET] NODE] w[rite] p[do] N COUNT VALUE...    this device receives RPDO N\n"
	"[NET] set network | node | sdo_timeout | sdo_block VALUE   (network 1; ms; 0 or 1)\n"
	"[NET] info version\n"
	"help [datatype | lss]\n"
	"log                                            the events since the start\n"
	"\n"
	"Answer: \"[\" SEQUENCE \"]\" OK, the value, or ERROR:CODE #TEXT; 0x........ is an SDO abort code.\n"
	"Without NODE: that of 'set node', which clients with the same rights share.";

const char cia309_help_types[] =
	"\n"
	"b                      0 or 1\n"
	"i8 i16 i32 i64         integer\n"
	"u8 u16 u32 u64         unsigned integer\n"
	"x8 x16 x32 x64         the same, printed as 0x...\n"
	"r32 r64                real number\n"
	"t td                   days and ms: time of day since 1984-01-01, time difference\n"
	"vs                     string, in \"quotes\" if it has blanks; a quote is written twice\n"
	"os us d                bytes as base64, in one line\n"
	"hex                    bytes as 01 02 FF";

const char cia309_help_lss[] =
	"\n"
	"[NET] lss_switch_glob 0 | 1                    waiting, configuration state of all nodes\n"
	"[NET] lss_switch_sel VENDOR PRODUCT REVISION SERIAL\n"
	"[NET] lss_set_node NODE                        255: none\n"
	"[NET] lss_conf_bitrate 0 INDEX                 0 1000, 1 800, 2 500, 3 250, 4 125, 6 50, 7 20, 8 10 kbit/s\n"
	"[NET] lss_activate_bitrate MS\n"
	"[NET] lss_store\n"
	"[NET] lss_inquire_addr [0 | 1 | 2 | 3]\n"
	"[NET] lss_get_node\n"
	"[NET] _lss_fastscan [MS]                       finds one node without a node-ID\n"
	"[NET] lss_allnodes [MS [NODE STORE [HOW VENDOR HOW PRODUCT HOW REVISION HOW SERIAL]]]\n"
	"                                               gives each of them a node-ID, from NODE (2) on\n"
	"                                               HOW: 0 find, 1 ignore, 2 is the value";
