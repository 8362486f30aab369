#!/bin/bash
# tools_monitor.sh [BUS]: imu9-monitor with a gateway.
. "$(dirname "$0")/tools_common.bash"

# column NAME: the value in the last line of key=value columns
column() { grep '^t=' <<<"$out" | tail -1 | tr ' ' '\n' | sed -n "s/^$1=//p"; }
between() { awk "BEGIN { exit !($1 >= $2 && $1 <= $3) }"; }

run imu9-monitor -t 1.2
check "without a gateway it says so" fails 1 "nothing heard of node 16 on $IMU9_CAN: is the gateway running"
check "and shows no values" test -z "$out"
check "and says it once" test "$(wc -l <"$work/err")" = 1

start_gateway

# ---- hints
run imu9-monitor -t 1.3 # a heartbeat comes each second
check "before NMT start" fails 1 "no PDO yet: the node is pre-operational: imu9-sdo -n 16 nmt start"
imu9-sdo nmt start
run imu9-monitor -t 1.2
check "without a SYNC" fails 1 "no PDO yet: synchronous PDOs need a SYNC"
run imu9-monitor --once -t 1.3
check "--once without a SYNC" ends 1
check "prints the reason in place of the values" says "no PDO yet: synchronous PDOs need a SYNC"
imu9-sdo nmt preop

# ---- lines
run imu9-monitor --start --sync 100 --rate 5 -t 2
check "--start --sync gives values" ends 0
check "units are printed first" says "# units: acceleration.l[m/s^2]"
# a busy machine prints fewer
interval=$(sed -n 's/^t=\([0-9.]*\).*/\1/p' <<<"$out" | awk 'NR == 1 { first = $1 } END { print ($1 - first) / (NR - 1) }')
check "lines have at most the requested rate" between "$interval" 0.19 2
# compared with the SYNCs actually sent: a busy machine sends fewer than 100 a second
sync=$(column sync_hz)
for pdo in 1 2 3 4; do
	check "TPDO$pdo has the rate of SYNC" between "$(column tpdo${pdo}_hz)" "0.95 * ${sync:-0}" "1.05 * ${sync:-0}"
done
check "NMT state" test "$(column nmt)" = operational
check "values with their decimals" grep -qE '^-?[0-9]+\.[0-9]{3}$' <<<"$(column acceleration.l)"
check "the status in words" grep -qE '^[a-z_,]+$' <<<"$(column sample.status)"
check "no emergency" test "$(column emcy)" = 0000
check "each line has the same columns" \
	test "$(grep '^t=' <<<"$out" | sed 's/=[^ ]*//g' | sort -u | wc -l)" = 1
check "ends with a table" says "TPDO4     490h"
read -r received rate < <(sed -nE 's/^TPDO1 +190h +([0-9]+) +([0-9.]+) .*/\1 \2/p' <<<"$out")
check "with the number of PDOs" between "${received:-0}" 20 205
# over the time since the first of them, a little less than 2 s; a busy machine ends later
check "and their rate" between "${rate:-0}" "0.5 * ${received:-0} / 2" "1.2 * ${received:-0} / 2"

run imu9-monitor --sync 50 --once
check "--once" ends 0
check "has all PDOs" says "TPDO4  490h"
check "and the angles" grep -qE '^  angles\.pitch +-?[0-9]+\.[0-9]{2} +deg$' <<<"$out"
check "no rate before it was measured" test "${out/ 0.0 Hz/}" = "$out"
run imu9-monitor --passive --sync 50 --once
check "--passive uses the mapping of the EDS" says "default of the EDS"

# ---- mapping and resolution of the node instead of the EDS
printf 'resolution.acceleration = 100\ntpdo2_mapping.number_of_mapped_objects = 1\ntpdo2_mapping.object_1 = 0x21030120\n' >"$work/m.ini"
imu9-sdo -q load "$work/m.ini"
run imu9-monitor --sync 50 --once
check "a remapped PDO" grep -qE '^  quaternion\.w +-?[0-9.]+' <<<"$out"
check "a coarser step has fewer decimals" grep -qE '^  acceleration\.l +-?[0-9]+\.[0-9] +m' <<<"$out"

# ---- end
for signal in INT TERM; do
	(timeout --preserve-status -s $signal 3 imu9-monitor --line --sync 50; echo "status $?") >"$work/lines" 2>&1
	run cat "$work/lines"
	check "SIG$signal ends it with status 0" grep -q "^status 0$" "$work/lines"
	check "SIG$signal: the table" says "received"
done
if command -v script >/dev/null; then
	export TERM=xterm
	run timeout 20 script -qec "stty rows 24 cols 80; imu9-monitor --sync 50 -t 3" /dev/null
	check "in a terminal it uses the alternate screen" says $'\033[?1049h'
	check "shows values in place" says "acceleration.l"
	check "with their sigma, from SDO" says "+-"
	check "and restores the terminal" says $'\033[?1049l'
	run timeout 20 script -qec "stty rows 24 cols 80; (sleep 1; printf 't'; sleep 1; printf 'q') | script -qec 'imu9-monitor --sync 50' /dev/null" /dev/null
	check "t tares by SDO" says "tare: done"
	check "q ends it" ends 0
fi
for format in csv json; do
	run imu9-monitor --$format --sync 50 -t 2
	printf '%s\n' "$out" >"$work/$format"
	check "--$format" ends 0
done
check "--csv: units in the header" grep -q '^t \[s\],utc,nmt,sync \[Hz\],acceleration\.l \[m/s^2\],' "$work/csv"
check "--csv: a row within the first second" awk -F, 'NR == 2 { exit !($1 < 1) }' "$work/csv"
check "--csv: as many cells as columns" python3 -c '
import csv, sys
rows = list(csv.reader(open(sys.argv[1])))
sys.exit(len(rows) < 3 or len({len(row) for row in rows}) != 1)' "$work/csv"
run bash -c "imu9-monitor --line --sync 50 -t 5 | head -2 | wc -l"
check "a closed pipe ends it" prints 2

# ---- a node that restarts
imu9-monitor --start --sync 50 -t 4 >"$work/lines" 2>&1 &
monitor=$!
sleep 1
imu9-sdo nmt reset
wait $monitor
run cat "$work/lines"
check "PDOs are received again after a reset" between "$(column tpdo1_hz)" 5 55
check "with the default mapping" test -n "$(column angles.roll)"

# ---- wrong usage
for arguments in "-n 0" "-n 128" "-n" "--sync 0" "--sync x" "-t -1" "--rate 1e9" "--foo" "something" "--once --line" "--csv --json"; do
	run imu9-monitor $arguments
	check "wrong usage: '$arguments'" fails 2 "imu9-monitor: "
done
run imu9-monitor -i nosuchbus
check "an unknown bus" fails 1 "nosuchbus"
run imu9-monitor --help
check "help" says "Usage: imu9-monitor"
finish
