#!/bin/bash
# bash completion: words that the programs accept, from the programs themselves.
. "$(dirname "$0")/tools_common.bash"
. tools/service/completion.bash
compopt() { :; } # of an interactive shell only

words() { # WORD...: what completion offers for the last one
	COMP_WORDS=("$@") COMP_CWORD=$(($# - 1))
	_imu9 "$1" "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD - 1]}"
	echo "${COMPREPLY[*]}"
}

offers() { # EXPECTED WORD...
	local expected=$1 got
	shift
	got=$(words "$@")
	[ "$got" = "$expected" ] && return
	echo "completion of '$*': '$got', expected '$expected'"
	failed=1
}

failed=0
offers "read restore" imu9-sdo r
offers "lever_arm.l lever_arm.s lever_arm.t" imu9-sdo -n 5 write lever_arm.
offers "lever_arm.l lever_arm.s lever_arm.t" imu9-gateway --set lever_arm.
offers "" imu9-sdo write lever_arm.l 0
offers "rigid_body" imu9-sdo write lever_arm_model r
offers "--json" imu9-sdo read lever_arm.l --j
offers "--imu" imu9-gateway --im
offers "trajectory" imu9-plot -f t
offers "turntable tumble" imu9-sim t
offers "accelerometer" imu9-calibrate a
offers "--answers" imu9-commission --a
offers "--token-file" imu9-web --t
offers "save apply compare" imu9-sdo dcf ""
exit $failed
