# bash completion of the programs: options from --help, objects by name from the EDS (imu9-sdo objects).

_imu9_objects() {
	COMPREPLY=($(compgen -W "$(imu9-sdo -q objects 2>/dev/null)" -- "$1"))
}

_imu9_interfaces() {
	COMPREPLY=($(compgen -W "$(cd /sys/class/net && ls) gs_usb slcan: udp" -- "$1"))
}

_imu9() {
	local program=$1 word=$2 before=$3 i command=
	local commands='read write watch dump objects log save load dcf store restore nmt scan lss'
	local groups='all communication application manufacturer'

	COMPREPLY=()
	[ "$word" = = ] && word=
	case $before in
	-i | --can) _imu9_interfaces "$word"; return ;;
	-n | --node-id) COMPREPLY=($(compgen -W "$(seq 1 127)" -- "$word")); return ;;
	--set | --change | --allow-writes) compopt -o nospace; _imu9_objects "$word"; return ;;
	--imu) compopt -o nospace; COMPREPLY=($(compgen -W 'sim replay: i2c:/dev/i2c- iio wt901:/dev/tty' -- "$word")); return ;;
	--cia309) compopt -o nospace; COMPREPLY=($(compgen -W 'unix: tcp:127.0.0.1:' -- "$word")); return ;;
	--modbus) compopt -o nospace; COMPREPLY=($(compgen -W 'tcp: rtu:/dev/tty' -- "$word")); return ;;
	--log-level) COMPREPLY=($(compgen -W 'error warning info debug' -- "$word")); return ;;
	--listen) compopt -o nospace; COMPREPLY=($(compgen -W '127.0.0.1:8410 [::1]:8410' -- "$word")); return ;;
	--format) COMPREPLY=($(compgen -W 'json sparkplug' -- "$word")); return ;;
	--broker) compopt -o nospace; COMPREPLY=($(compgen -W 'mqtt:// mqtts://' -- "$word")); return ;;
	-f | --figure) COMPREPLY=($(compgen -W 'attitude acceleration position trajectory spectrum allan' -- "$word")); return ;;
	-c | --config | -e | --eds | -o | --output | --answers | -r | --reference | --store | --record | --movements | --frames | --ca | --cert | --key | --credentials | --spool | --token-file)
		compopt -o filenames; COMPREPLY=($(compgen -f -- "$word")); return ;;
	esac
	if [[ $word == -* ]]; then
		COMPREPLY=($(compgen -W "$("$program" --help 2>/dev/null | grep -oE '(^|[ ,])--[a-z][a-z-]*' | sort -u)" -- "$word"))
		return
	fi
	case ${program##*/} in
	imu9-sdo)
		for ((i = 1; i < COMP_CWORD; i++)); do
			[[ " $commands " == *" ${COMP_WORDS[i]} "* ]] && command=${COMP_WORDS[i]} && break
		done
		case $command in
		'') COMPREPLY=($(compgen -W "$commands" -- "$word")) ;;
		read | watch) _imu9_objects "$word" ;;
		write)
			[ $((COMP_CWORD - i)) = 1 ] && _imu9_objects "$word"
			[ $((COMP_CWORD - i)) = 2 ] && COMPREPLY=($(compgen -W "$(imu9-sdo -q objects "$before" 2>/dev/null)" -- "$word"))
			;;
		objects) _imu9_objects "$word" ;;
		store | restore) COMPREPLY=($(compgen -W "$groups" -- "$word")) ;;
		nmt) COMPREPLY=($(compgen -W 'start stop preop reset reset-comm' -- "$word")) ;;
		lss) COMPREPLY=($(compgen -W 'scan assign inquire node-id bit-rate store' -- "$word")) ;;
		dcf)
			[ $((COMP_CWORD - i)) = 1 ] && COMPREPLY=($(compgen -W 'save apply compare' -- "$word")) && return
			compopt -o filenames; COMPREPLY=($(compgen -f -- "$word"))
			;;
		save | load) compopt -o filenames; COMPREPLY=($(compgen -f -- "$word")) ;;
		esac
		;;
	imu9-calibrate)
		[ "$COMP_CWORD" = 1 ] &&
			COMPREPLY=($(compgen -W 'gyro accelerometer magnetometer temperature lever-arm' -- "$word")) && return
		;;&
	imu9-calibrate | imu9-replay | imu9-allan | imu9-plot) compopt -o filenames; COMPREPLY=($(compgen -f -- "$word")) ;;
	imu9-sim)
		COMPREPLY=($(compgen -W "experiments $("$program" --list | awk '/^Signals/ {s = 1; next} /^[^ ]/ {s = 0} s {print $1}')" -- "$word")) ;;
	esac
}

complete -F _imu9 imu9-gateway imu9-sdo imu9-monitor imu9-calibrate imu9-commission imu9-web imu9-replay imu9-sim imu9-allan imu9-plot imu9-bench imu9-fleet
