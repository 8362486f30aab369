#!/bin/bash
# tools_calibrate.sh [BUS]: imu9-calibrate is interrupted at its question, and has a sensor without samples.
. "$(dirname "$0")/tools_common.bash"

start_gateway --imu sim:rest

mkfifo "$work/answer"
exec 3<>"$work/answer"
imu9-calibrate gyro <&3 >"$work/out" 2>"$work/err" &
calibrating=$!
for _ in {1..100}; do
	grep -q accept "$work/out" && break
	sleep 0.2
done
kill -TERM $calibrating
for _ in {1..20}; do
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

# ---- a sensor without samples
stop_gateway
printf 't,gx,gy,gz,ax,ay,az,mx,my,mz\n0.%02d,0,0,0,0,0,9.81,,,\n' 0 >"$work/short.imu.csv"
printf '0.%02d,0,0,0,0,0,9.81,,,\n' {1..5} >>"$work/short.imu.csv"
start_gateway --imu "replay:$work/short.imu.csv"
for _ in {1..20}; do
	grep -q "has ended" "$work/log" && break
	sleep 0.1
done
run imu9-calibrate gyro
check "without samples the calibration is refused with the reason" fails 1 "does the sensor give no samples"
finish
