#!/bin/bash
# imu9-plot: figures of a log, a replay and a bus. Without gnuplot: skipped.
. "$(dirname "$0")/tools_common.bash"
command -v gnuplot >/dev/null || { echo "no gnuplot"; exit 77; }

# figures PREFIX FIGURE...: each is there, as a PNG and an SVG, and its CSV has numbers in the second column
figures() {
	local prefix=$1 figure
	shift
	for figure in "$@"; do
		[ "$(head -c 8 "${prefix}_$figure.png" | od -An -tx1 | tr -d ' \n')" = 89504e470d0a1a0a ] &&
			grep -q '</svg>' "${prefix}_$figure.svg" &&
			awk -F, 'NR > 1 && $2 != "" { n++ } END { exit !(n > 3) }' "${prefix}_$figure.csv" || return 1
	done
}

imu9-sim square --lever-arm 0.05,0,0.1 -d 8 -o "$work/a.imu.csv"
run imu9-plot --set lever_arm.l=0.05 --set lever_arm.t=0.1 -o "$work/a" "$work/a.imu.csv"
check "a log" ends 0
check "has all figures of a motion" figures "$work/a" attitude acceleration position trajectory spectrum
check "and no Allan deviation" test ! -e "$work/a_allan.png"
rms() { awk -F, -v c="$1" 'NR > 1 && $c != "" { s += $c * $c; n++ } END { print sqrt(s / n) }' "$work/a_acceleration.csv"; }
check "the correction of the lever arm takes most off the acceleration along s" \
	awk "BEGIN { exit !($(rms 3) < 0.3 * $(rms 6)) }"
imu9-sim rest -d 20 -o "$work/r.imu.csv"
run imu9-plot -f allan,spectrum -o "$work/r" "$work/r.imu.csv"
check "a log at rest: the figures that were asked for" figures "$work/r" allan spectrum
check "and no others" test ! -e "$work/r_attitude.png"
imu9-replay "$work/a.imu.csv" >"$work/replay.csv"
run imu9-plot -o "$work/p" - <"$work/replay.csv"
check "the output of imu9-replay" figures "$work/p" attitude acceleration position trajectory spectrum
start_gateway
imu9-monitor --start --sync 50 --rate 50 --csv -t 3 >"$work/bus.csv"
run imu9-plot -o "$work/b" "$work/bus.csv"
check "a live bus" figures "$work/b" attitude acceleration position trajectory spectrum

run imu9-plot -f allan -o "$work/x" "$work/a.imu.csv"
check "a figure that is not possible is refused" fails 1 "no figure allan: it needs a log at rest"
run imu9-plot -f cake "$work/a.imu.csv"
check "an unknown one, too" fails 2 "no figure 'cake'"
run imu9-plot
check "wrong usage" fails 2 "give one file"
run imu9-plot "$work/none.csv"
check "a file that is not there" fails 1 "none.csv"
finish
