#!/bin/bash
# tools_calibrate.sh [BUS]: imu9-calibrate is interrupted at its question, and has a sensor without samples; imu9-allan
# refuses what is no noise.
. "$(dirname "$0")/tools_common.bash"

start_gateway --imu sim:rest

mkfifo "$work/answer"
exec 3<>"$work/answer"
imu9-calibrate gyro <&3 >"$work/out" 2>"$work/err" &
calibrating=$!
for _ in {1..600}; do
	grep -q accept "$work/out" && break
	sleep 0.2
done
kill -TERM $calibrating
for _ in {1..600}; do
	kill -0 $calibrating 2>/dev/null || break
	sleep 0.1
done
kill -KILL $calibrating 2>/dev/null
wait $calibrating
rc=$?
err=$(<"$work/err")
check "a signal at the question means no" test "$rc" = 1
out=$(tail -n 1 "$work/out")
check "and the result is discarded" says "discarded"

# ---- the lever arm, led
stop_gateway
start_gateway --imu sim:tumble --set lever_arm_identification.duration=12
for _ in {1..9}; do # a machine that stalls for 0.1 s loses samples, and the device says so
	run imu9-calibrate lever-arm --yes
	[[ $err == *"without gaps"* ]] || break
done
check "it says what to do and how long first" says "12 s, at most 36 s"
check "and what the sigma is on the way" says "; r = "
check "and is accepted" says "accepted and in use"
run imu9-sdo -q read lever_arm.l
check "the lever arm of the simulation is in 2000h" awk "BEGIN { exit !($out > 0.047 && $out < 0.053) }"
run imu9-sdo log
check "the event log has the result" says "lever arm identification accepted: "
run imu9-calibrate lever-arm --reference x.csv
check "a reference file needs a log" fails 2 "need a log; on the bus: --aided"

# ---- a sensor without samples
stop_gateway
printf 't,gx,gy,gz,ax,ay,az,mx,my,mz\n0.%02d,0,0,0,0,0,9.81,,,\n' 0 >"$work/short.imu.csv"
printf '0.%02d,0,0,0,0,0,9.81,,,\n' {1..5} >>"$work/short.imu.csv"
start_gateway --imu "replay:$work/short.imu.csv"
for _ in {1..600}; do
	grep -q "has ended" "$work/log" && break
	sleep 0.1
done
run imu9-calibrate gyro
check "without samples the calibration is refused with the reason" fails 1 "does the sensor give no samples"

# ---- logs that are no noise at rest
warns() { [ "$rc" = 0 ] && [[ $err == *"$1"* ]]; }
near() { awk -F= -v name="noise.$1" -v value="$2" '$1 == name {ok = $2 > 0.95 * value && $2 < 1.05 * value} END {exit !ok}' <<<"$out"; }
imu9-sim rest -d 40 -o "$work/rest.imu.csv"
imu9-sim turntable -d 40 -o "$work/turn.imu.csv"
imu9-sim pendulum -d 40 -o "$work/swing.imu.csv"
{ head -n 2001 "$work/rest.imu.csv"; tail -n +2 "$work/rest.imu.csv" | tail -n 2000 | awk -F, -v OFS=, '{$1 += 600; print}'; } >"$work/gap.imu.csv"
run imu9-allan "$work/swing.imu.csv"
check "imu9-allan refuses motion" fails 1 "moved or was shaken at 0.0 s"
run imu9-allan "$work/turn.imu.csv"
check "and a steady turn" fails 1 "it turns by 36"
run imu9-allan "$work/gap.imu.csv"
check "it tells a gap" warns "1 gap, 600 s in all"
check "and uses the parts on both sides: the density is that of the sensor" near gyro_density 0.03
check "a log of 40 s shows no bias instability" says "# noise.gyro_bias_instability: the log is too short"
finish
