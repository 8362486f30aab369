#!/bin/bash
# tools_sdo.sh [BUS]: imu9-sdo with a gateway: values, files, storing.
. "$(dirname "$0")/tools_common.bash"

run imu9-sdo -t 100 read 0x1000
check "without a gateway: an error that says what to check" fails 1 \
	"no answer from node 16 on $IMU9_CAN within 100 ms: is the gateway running with --node-id 16"

start_gateway

# ---- read and write
run imu9-sdo read lever_arm.l
check "a value is read by its name, with its unit" prints "lever_arm.l = 0 m"
run imu9-sdo read 0x2000:2 2000h:3 lever_arm_model
check "by its index, and several at once" prints $'lever_arm.s = 0 m\nlever_arm.t = 0 m\nlever_arm_model = rigid_body'
run imu9-sdo read Lever_Arm
check "a whole record by its name, in any case" prints $'lever_arm.l = 0 m\nlever_arm.s = 0 m\nlever_arm.t = 0 m'
run imu9-sdo read 1008h
check "a string" prints "manufacturer_device_name = IMU9 CANopen gateway"
run imu9-sdo read 0x1800:1
check "a COB-ID also in hex" prints "tpdo1_communication.cob_id = 1073742224 (0x40000190)"
run imu9-sdo -q read 0x1017 1008h
check "bare values with -q" prints $'1000\nIMU9 CANopen gateway'
run imu9-sdo read 0x1021
printf '%s\n' "$out" | cmp -s - eds/imu9-gateway.eds
check "the EDS in the device is the file" test $? = 0

for value in 0.05 -0.05 5e-2 1; do
	run imu9-sdo write lever_arm.l $value
	check "writes $value without output" prints ""
done
run imu9-sdo -q read lever_arm.l
check "the last written value is kept" prints 1
run imu9-sdo write 0x1017 0x1F4
run imu9-sdo -q read 0x1017
check "writes hexadecimal" prints 500
run imu9-sdo write resolution.acceleration 10
run imu9-sdo read resolution.acceleration
check "a step is printed with its physical value" prints "resolution.acceleration = 10 (0.01 m/s^2)"
run imu9-sdo read acceleration.l
check "a scaled value uses its resolution object" says "m/s^2)"
raw=${out#*= } raw=${raw%% *} scaled=${out#*(} scaled=${scaled%% *}
check "and the right factor" awk "BEGIN { d = $raw * 0.01 - $scaled; exit !(d < 1e-9 && d > -1e-9) }"

# ---- words
run imu9-sdo write lever_arm_model linear
run imu9-sdo -q read lever_arm_model
check "a word is written as its value, and -q prints the value" prints 1
run imu9-sdo write lever_arm_model RIGID_BODY
run imu9-sdo read lever_arm_model
check "in any case" prints "lever_arm_model = rigid_body"
run imu9-sdo write slope_long16_operating_parameter inverted,offset
run imu9-sdo -q read 0x6011
check "bits by their words" prints 3
run imu9-sdo write 0x6011 none
run imu9-sdo read 0x6011
check "and none of them" prints "slope_long16_operating_parameter = none"
run imu9-sdo write lever_arm_model soft_body
check "an unknown word is refused with those that are known" fails 2 "none, linear, rigid_body, weighted"
run imu9-sdo -q objects lever_arm_model
check "objects lists them" prints $'none\nlinear\nrigid_body\nweighted'
run imu9-sdo write lever_arm 1
check "a write to a record is refused with its members" fails 2 "lever_arm is a record: write its members one by one: lever_arm.l, lever_arm.s, lever_arm.t"

# ---- refused
run imu9-sdo write lever_arm.l 11
check "above the limit: reason, abort code and range" fails 1 \
	"above the high limit (abort 06090031h); allowed: -10 to 10 m"
run imu9-sdo write sample.counter 1
check "read-only" fails 1 "can only be read (abort 06010002h)"
run imu9-sdo read position.reset
check "write-only" fails 1 "can only be written (abort 06010001h)"
run imu9-sdo read 0x4000:1
check "an object that the node does not have" fails 1 \
	"4000h:01: the node refused: no such object in the node (abort 06020000h)"
run imu9-sdo read lever_arm.l 0x2000:9 lever_arm.t
check "one failure of several is reported" fails 1 "no such sub-index (abort 06090011h)"
check "and the others are read" says "lever_arm.t = "
run imu9-sdo write 0x1017 u8:5
check "a value of the wrong size" fails 1 "abort 060700"
run imu9-sdo -q read lever_arm.l
check "the old value is kept" prints 1

# ---- wrong usage
for arguments in "" "frobnicate" "read" "write lever_arm.l" "dump x" "-n 0 read 0x1000" "-n 128 dump" "-n 5x dump" "-n" "-x" "--foo" \
	"--help=1" \
	"-t 0 dump" "read no_such_name" "read 0x10000" "read 0x1000:256" "read lever_arm.l -n" "write lever_arm.l nan" \
	"write lever_arm.l 1x" \
	"write lever_arm_model 0.5" "write 0x4000 5" "write 0x4000 u8:256" "write 0x4000 u99:1" "write 0x4000 hex:1" \
	"store everything" "nmt jump"; do
	run imu9-sdo $arguments
	check "wrong usage: '$arguments'" fails 2 "imu9-sdo: "
done
IMU9_NODE=x run imu9-sdo dump
check "a bad IMU9_NODE" fails 2 "IMU9_NODE x"
run imu9-sdo -i nosuchbus read 0x1000
check "an unknown bus" fails 1 "nosuchbus"
run imu9-sdo -e /nonexistent.eds dump
check "a missing EDS" fails 1 "/nonexistent.eds"
run imu9-sdo --help
check "help on standard output" says "Usage: imu9-sdo"
check "and no failure" ends 0
run imu9-sdo --version
check "version" says "imu9-sdo "

# ---- dump
run imu9-sdo dump
check "dump ends well" ends 0
check "dump has names, values, units" says "lever_arm.l                                  = 1 m"
check "and every part of the dictionary" says "6000h:00"
run imu9-sdo -e eds/imu9-gateway.eds dump
check "dump by an EDS file" says "2000h:01"

# ---- save, load, store, restore
imu9-sdo write lever_arm.s 0.25
imu9-sdo write tpdo2_communication.transmission_type 5
run imu9-sdo save "$work/a.ini"
check "save" ends 0
run grep -x "lever_arm.s = 0.25 ; m" "$work/a.ini"
check "the file is readable" ends 0
run imu9-sdo load "$work/a.ini"
check "loading an unchanged configuration writes nothing" test "${err/ 0 values written/}" != "$err"
sed -e 's/^lever_arm.s = .*/lever_arm.s = 0.5/' \
	-e 's/^tpdo1_mapping.number_of_mapped_objects = .*/tpdo1_mapping.number_of_mapped_objects = 2/' \
	-e 's/^tpdo1_mapping.object_2 = .*/tpdo1_mapping.object_2 = 0x21030120/' \
	-e 's/^cob_id_emcy = .*/cob_id_emcy = 0x99/' "$work/a.ini" >"$work/b.ini"
for state in start preop; do
	imu9-sdo nmt $state
	run imu9-sdo load "$work/a.ini"
	check "load ($state)" ends 0
	run imu9-sdo load "$work/b.ini"
	check "load remaps a PDO by the mapping procedure ($state)" ends 0
	run imu9-sdo -q read 0x1A00:0 0x1A00:2 0x1800:1 0x1014 lever_arm.s
	check "and all values are in the node ($state)" prints $'2\n553845024\n1073742224\n153\n0.5'
done
run imu9-sdo load "$work/a.ini"
check "load restores the previous configuration" ends 0
run imu9-sdo save "$work/c.ini"
check "which is the same" cmp -s "$work/a.ini" "$work/c.ini"

printf 'lever_arm.s = 99\nlever_arm.t = 0.125\ntpdo3_mapping.object_1 = 0x10000020\n' >"$work/d.ini"
run imu9-sdo load "$work/d.ini"
check "load reports each failure" fails 1 "lever_arm.s (2000h:02): the node refused"
check "every one of them" fails 1 "tpdo3_mapping.object_1 (1A02h:01): the node refused"
check "and the state of the PDO" fails 1 "1802h remains switched off"
run imu9-sdo -q read lever_arm.t
check "and writes the other values" prints 0.125
for line in "no_such = 1" "sample.counter = 1" "lever_arm.l = x" "rubbish"; do
	printf '# a comment\n%s\nlever_arm.t = 3\n' "$line" >"$work/e.ini"
	run imu9-sdo load "$work/e.ini"
	check "a bad line is named: '$line'" fails 1 "$work/e.ini:2: "
done
run imu9-sdo -q read lever_arm.t
check "and then nothing is written" prints 0.125

run imu9-sdo load "$work/a.ini"
run imu9-sdo store
check "store" ends 0
imu9-sdo write lever_arm.s 0.75
imu9-sdo nmt reset
sleep 0.5
run imu9-sdo -q read lever_arm.s
check "a stored value is restored after a reset" prints 0.25
run imu9-sdo restore manufacturer
check "restore" ends 0
imu9-sdo nmt reset
sleep 0.5
run imu9-sdo -q read lever_arm.s tpdo2_communication.transmission_type
check "after a reset that group has its defaults, the others their stored values" prints $'0\n5'

# ---- the configuration in another node, and in a gateway with -c
stop_gateway
IMU9_NODE=17
start_gateway -c "$work/b.ini"
run imu9-sdo -q read lever_arm.s 0x1A00:0
check "imu9-gateway -c reads a saved file" prints $'0.5\n2'
run imu9-sdo load "$work/a.ini"
check "load to another node" ends 0
run imu9-sdo -q read 0x1800:1 0x1014
check "adapts the COB-IDs that depend on the node-ID" prints $'1073742225\n145'
finish
