#!/bin/bash
# tools_sdo_lss.sh [BUS]: imu9-sdo lists the nodes of a bus and assigns node-IDs by LSS.
. "$(dirname "$0")/tools_common.bash"

revision=$(sed -n 's/^RevisionNumber=0x\([0-9A-F]*\).*/\1/p' eds/imu9-gateway.eds)
start_gateway

# ---- the nodes on the bus
run imu9-sdo scan
check "scan finds the node, its state and identity" says " 16  pre-operational  type 0004019Ah  vendor 00494D55h"
for arguments in "lss" "lss scan x" "lss assign" "lss assign 0" "lss assign 255" "lss bit-rate 333" "lss --serial" "dcf apply" \
	"dcf frob x" \
	"watch" "watch gravity --rate 0" "read gravity 0x1017 -o x" "read --block --no-block gravity" \
	"write snapshot"; do
	run imu9-sdo $arguments
	check "wrong usage: '$arguments'" fails 2 "imu9-sdo: "
done
run imu9-sdo lss inquire
check "lss inquire" says "node-ID 16  vendor 00494D55h  product 00000009h  revision ${revision}h  serial "
serial=${out##*serial } serial=0x${serial%h}
run imu9-sdo lss inquire --serial 1
check "a missing node gives an error" fails 1 "no node with vendor 00494D55h"
run imu9-sdo lss node-id 18 --serial "$serial"
check "lss node-id, for the node with that serial number" ends 0
imu9-sdo nmt reset-comm
sleep 0.3
run imu9-sdo -q -n 18 read gravity
check "valid after reset communication" prints 9.81
run imu9-sdo lss node-id 16
imu9-sdo -n 18 nmt reset-comm
sleep 0.3
run imu9-sdo lss assign 19
check "no node to assign a node-ID to" fails 1 "no node without a node-ID"
on_a_listening_adapter() { # for slcan a terminal that is not read is an adapter
	python3 -c 'import os, pty, subprocess, sys
line = os.ttyname(pty.openpty()[1])
sys.exit(subprocess.call(["imu9-sdo", "-i", "slcan:%s,listen-only" % line] + sys.argv[1:]))' "$@"
}
run on_a_listening_adapter lss scan
check "a bus that cannot be sent on is an error" fails 1 "cannot send on slcan:"
check "which is reported once" test "$(wc -l <<<"$err")" = 1
on_an_adapter_that_is_removed() {
	python3 -c 'import os, pty, subprocess, sys, time
adapter, line = pty.openpty()
sdo = subprocess.Popen(["imu9-sdo", "-i", "slcan:" + os.ttyname(line)] + sys.argv[1:])
os.close(line)
time.sleep(0.4)
os.close(adapter)
sys.exit(sdo.wait())' "$@"
}
run on_an_adapter_that_is_removed -t 5000 read gravity
check "a removed adapter is reported" fails 1 "is the adapter plugged in?"
# with_a_malicious_node ARGUMENT...: imu9-sdo in a terminal, on a bus where node 5 sends control codes in each value
with_a_malicious_node() {
	python3 -c 'import os, pty, select, subprocess, sys
adapter, line = pty.openpty()
screen, terminal = pty.openpty()
sdo = subprocess.Popen(["imu9-sdo", "-i", "slcan:" + os.ttyname(line)] + sys.argv[1:], stdout=terminal)
os.close(terminal)
unread = b""
while sdo.poll() is None:
    ready = select.select([adapter, screen], [], [], 0.05)[0]
    if screen in ready:
        os.write(1, os.read(screen, 4096))
    if adapter not in ready:
        continue
    *frames, unread = (unread + os.read(adapter, 4096)).split(b"\r")
    for frame in frames:
        if frame[:5] == b"t6058":
            answer = b"43%s1B5B324A" if frame[5:7] == b"40" else b"80%s01000405"
            os.write(adapter, b"t5858" + answer % frame[7:13] + b"\r")
while select.select([screen], [], [], 0)[0]:
    try:
        os.write(1, os.read(screen, 4096))
    except OSError:
        break
sys.exit(sdo.returncode)' "$@"
}
for request in scan "-n 5 read 1008h" "-n 5 read 0x2131" "-n 5 log"; do
	run with_a_malicious_node $request
	check "$request replaces control codes" says "?[2J"
	check "$request prints no escape" test "${out/$'\e'/}" = "$out"
done

# ---- a node without a node-ID
stop_gateway
start_unconfigured() {
	imu9-gateway --imu sim --can "$IMU9_CAN" --node-id 255 --store "$work/store2" 2>"$work/log" &
	gateway=$!
	for _ in {1..100}; do
		imu9-sdo -t 300 lss inquire >/dev/null 2>&1 && return
	done
}
start_unconfigured
for _ in {1..10}; do # on a busy machine an answer may come too late
	run imu9-sdo lss scan
	[ -z "$out" ] || break
done
check "lss scan finds its identity bit by bit" prints \
	"vendor 00494D55h  product 00000009h  revision ${revision}h  serial ${serial#0x}h"
run imu9-sdo scan
check "scan does not find it and names lss scan" fails 1 "imu9-sdo lss scan"
run imu9-sdo lss assign 42 --store
check "lss assign gives it a node-ID" fails 0 "the node has node-ID 42 now"
run imu9-sdo -q -n 42 read 0x1018:4
check "valid immediately" ends 0
run imu9-sdo lss scan
check "and no node is without one" prints ""
stop_gateway
start_unconfigured
run imu9-sdo -t 1000 -n 42 read 0x1000
check "the stored node-ID is used after a restart" ends 0
run imu9-sdo lss node-id 255
check "and can be removed" ends 0
finish
