#!/bin/bash
# tools_bench.sh [BUS]: imu9-bench with a gateway.
. "$(dirname "$0")/tools_common.bash"

run imu9-bench -t 100
check "without a gateway: an error that says what to check" fails 1 "no answer from node 16 on $IMU9_CAN within 100 ms"
run imu9-bench --json --bins
check "JSON has the bins anyway" fails 2 "--json has the bins"

start_gateway
count() { awk -v name="$1" 'index($0, name) == 1 {$0 = substr($0, length(name) + 1); print $1; exit}' <<<"$out"; }
until [ "$(imu9-sdo -q read stage_filter.count)" -gt 0 ]; do sleep 0.05; done

run imu9-bench
check "before the first SYNC there is none" test "$(count "SYNC to TPDO")" = 0
check "but samples were read" test "$(count "sample: read")" -gt 0

imu9-monitor --start --sync 100 -t 3600 --csv >/dev/null 2>&1 &
monitor=$!
trap 'kill $monitor 2>/dev/null; stop_gateway; rm -rf "$work"' EXIT
until [ "$(imu9-sdo -q read sync_to_tpdo.count)" -gt 20 ]; do sleep 0.05; done
run imu9-bench --bins
check "SYNCs are counted" test "$(count "SYNC to TPDO")" -gt 20
check "each bin has a line" says $'\nSYNC to TPDO, from us on\n'
bars=$(awk '/^SYNC to TPDO, from/ {on = 1; next} /^$/ {on = 0} on {n += $2} END {print n}' <<<"$out")
check "and the bins have all that were counted" test "$bars" = "$(count "SYNC to TPDO")"
ordered() {
	awk '/^SYNC to TPDO  / {found = 1; for (i = 5; i < 9; i++) if ($i > $(i + 1)) exit 1} END {exit !found}' <<<"$out"
}
check "minimum, median, 99 %, 99.9 % and maximum follow each other" ordered

kill $monitor
wait $monitor
run imu9-bench --reset
check "what is emptied afterwards is shown before" test "$(count "SYNC to TPDO")" -gt 20
run imu9-bench -s 0.1
check "and counts from 0 on: no SYNC came any more" test "$(count "SYNC to TPDO")" = 0
check "but turns of the loop" test "$(count "turn of the loop")" -gt 0
run imu9-sdo write sample_age.count 5
check "only 0 can be written" fails 1 06090031h
run imu9-sdo read sync_to_tpdo
check "reading the record leaves out the data of its bins" ends 0
check "and has its longest" says "sync_to_tpdo.maximum = "

finish
