#!/bin/bash
# tools_sdo_files.sh [BUS]: imu9-sdo with large objects: block transfers, event log, snapshots and DCFs.
. "$(dirname "$0")/tools_common.bash"

start_gateway

# ---- DOMAINs: by block and by segment, to and from files
imu9-sdo read eds -o "$work/eds"
check "a DOMAIN is read into a file by block transfer" cmp -s "$work/eds" eds/imu9-gateway.eds
run imu9-sdo -q read --block 1008h
check "a small value by block transfer" prints "IMU9 CANopen gateway"
run imu9-sdo write --block gravity 9.81
check "written by block transfer" ends 0
run imu9-sdo -q read gravity
check "and it is in the node" prints 9.81
run imu9-sdo read snapshot -o "$work/snapshot"
check "the snapshot of the configuration" ends 0
imu9-sdo read snapshot --no-block -o "$work/segmented"
check "the same by segments" cmp -s "$work/snapshot" "$work/segmented"
imu9-sdo write gravity 9.79
run imu9-sdo dcf compare "$work/snapshot"
check "compared with the node: a difference" fails 1 "1 differ"
check "is named" says "gravity (2003h:00)  node: D7 A3 1C 41  file: C3 F5 1C 41"
run imu9-sdo write snapshot "$work/snapshot"
check "written back" ends 0
run imu9-sdo -q read gravity
check "restores the value" prints 9.81
run imu9-sdo dcf compare "$work/snapshot"
check "no difference from the snapshot" ends 0
imu9-sdo write gravity 9.79
run imu9-sdo dcf apply "$work/snapshot"
check "a concise DCF is applied entry by entry" ends 0
run imu9-sdo dcf compare "$work/snapshot"
check "completely" ends 0
printf '\1\0\0\0\3\40\0\4\0\0\0\0\0\300\177' >"$work/bad"
run imu9-sdo write snapshot "$work/bad"
check "a snapshot with a value that is not allowed" fails 1 "this value is not allowed (abort 06090030h)"
run imu9-sdo write 0x2130 "file:$work/bad"
check "by index, as a file" fails 1 "abort 06090030h"
head -c 20000 /dev/zero >"$work/long"
run imu9-sdo write snapshot "$work/long"
check "a snapshot that is too long" fails 1 "too long"
run imu9-sdo write snapshot "$work/none"
check "a missing file" fails 1 "$work/none: No such file"
run imu9-sdo log
check "the event log starts with the start-up" says "0.000000 started with node-ID 16 on $IMU9_CAN"
check "and contains the refused write" says "configuration snapshot refused: 2003h:00: "
run imu9-sdo watch gravity lever_arm_model --rate 50 --count 3
check "watch" says "gravity = 9.81 m/s^2  lever_arm_model = rigid_body"
check "as many lines as asked for" test "$(wc -l <<<"$out")" = 3
run imu9-sdo -q watch lever_arm_model --rate 100 --count 2
check "watch with bare values" prints $'2\n2'

# ---- DCF
run imu9-sdo dcf save "$work/a.dcf"
check "dcf save" ends 0
run grep -c '^\[DeviceComissioning\]' "$work/a.dcf"
check "a DCF contains the node-ID" prints 1
run imu9-sdo dcf compare "$work/a.dcf"
check "the node has no difference from it" ends 0
imu9-sdo write gravity 9.5
imu9-sdo write tpdo2_communication.transmission_type 7
run imu9-sdo dcf compare "$work/a.dcf"
check "differences are reported" fails 1 "2 differ"
check "with both values" says "node: 9.5 m/s^2  file: 9.81"
run imu9-sdo dcf apply "$work/a.dcf"
check "dcf apply writes the values that differ" ends 0
run imu9-sdo -q dcf compare "$work/a.dcf"
check "and then there is no difference" prints ""
run imu9-sdo -e "$work/a.dcf" read gravity
check "a DCF can be used as EDS" prints "gravity = 9.81 m/s^2"
tr -d '\r' <"$work/eds" | grep -v '^$' >"$work/dense.eds"
imu9-sdo -q -e "$work/dense.eds" dcf save "$work/dense.dcf"
run grep -c '^ParameterValue=' "$work/dense.dcf"
check "an EDS without blank lines gives a DCF with the same number of values" prints \
	"$(grep -c '^ParameterValue=' "$work/a.dcf")"
run imu9-sdo dcf apply "$work/eds"
check "an EDS without values is refused" fails 1 "is it a DCF?"
sed 's/^ParameterValue=0x411CF5C3/ParameterValue=x/' "$work/a.dcf" >"$work/b.dcf"
run imu9-sdo dcf apply "$work/b.dcf"
check "a bad value is named" fails 1 "gravity: ParameterValue=x"

# ---- another vendor-ID
stop_gateway
start_gateway --vendor-id 0x1000ABC
imu9-sdo read eds -o "$work/vendor.eds"
run grep -c "^VendorNumber=0x01000ABC" "$work/vendor.eds"
check "the EDS of the node has its vendor-ID" prints 1
imu9-sdo -q dcf save "$work/vendor.dcf"
check "and so has its DCF" cmp -s <(grep '^VendorNumber=\|^DefaultValue=0x01' "$work/vendor.dcf") <(
	printf 'VendorNumber=0x01000ABC\r\nDefaultValue=0x01000ABC\r\n')
finish
