# Sourced by tools_*.sh: starts a gateway and checks the results of commands. BUS is the first argument, or vcan0 if it
# exists, or the udp bus with a separate port, so that these tests also run by hand without CAN.
set -u
cd "$(dirname "$0")/../.." || exit 1
build=${BUILD:-build}
[ "$build" != "${build#/}" ] || build=$PWD/$build
PATH=$build:$PATH
export LC_ALL=C IMU9_NODE=16
if [ $# -gt 0 ]; then
	IMU9_CAN=$1
elif [ -e /sys/class/net/vcan0 ]; then
	IMU9_CAN=vcan0
else
	IMU9_CAN=udp:239.74.163.2:43777
fi
export IMU9_CAN
work=$(mktemp -d)
failures=0
gateway=
trap 'stop_gateway; rm -rf "$work"' EXIT

start_gateway() { # ARGUMENT...
	imu9-gateway --imu sim --can "$IMU9_CAN" --node-id $IMU9_NODE --store "$work/store" "$@" 2>"$work/log" &
	gateway=$!
	for _ in {1..100}; do
		imu9-sdo -t 300 read 0x1000 >/dev/null 2>&1 && return
	done
	echo "the gateway did not start:"
	cat "$work/log"
	exit 1
}

stop_gateway() {
	[ -n "$gateway" ] && kill "$gateway" 2>/dev/null && wait "$gateway" 2>/dev/null
	gateway=
}

# run COMMAND...: fills $out, $err and $rc
run() {
	out=$("$@" 2>"$work/err")
	rc=$?
	err=$(<"$work/err")
}

# check SENTENCE CONDITION...: the condition is a command about the last run
check() {
	local sentence=$1
	shift
	"$@" && return
	failures=$((failures + 1))
	printf 'FAILED  %s\n  status %s\n  output: %s\n  errors: %s\n' "$sentence" "$rc" "$out" "$err"
}

ends() { [ "$rc" = "$1" ]; }
prints() { [ "$out" = "$1" ] && [ "$rc" = 0 ]; }
says() { [[ $out == *"$1"* ]]; }
fails() { [ "$rc" = "$1" ] && [[ $err == *"$2"* ]] && [[ $err == imu9-* ]]; }

finish() {
	[ "$failures" = 0 ] || echo "$failures failed on $IMU9_CAN"
	[ "$failures" = 0 ]
	exit
}
